"""A small made-up robot, its problem and a solution: for tests of files and pages."""

from types import SimpleNamespace

import numpy as np

from stiffopt.connection import Reducer, Shaft
from stiffopt.drivetrain.chain import Chain, Stage
from stiffopt.problem.limit import Limits
from stiffopt.problem.objective import Objective
from stiffopt.problem.trajectory import Target, TrajectoryProblem
from stiffopt.result.assessment import Assessment, LowestStiffness, Violation
from stiffopt.result.solution import Baseline, ObjectiveValue, Solution, SolverRecord
from stiffopt.result.status import SolveStatus
from stiffopt.robot.body_tree import Body, BodyTree
from stiffopt.robot.frames import LinkFrame


class ClampedShaft(Shaft):
    """A shaft in a clamp that slips at 45 N m."""

    def slip_torque(self, preload=None):
        return 45.0


def two_element_chain():
    """A reducer and a shaft that share the compliance 3 : 1."""
    wave = Reducer(
        name="wave",
        torque_max=30.0,
        K1=1e4,
        K2=1e4,
        K3=1e4,
        T1=5.0,
        T2=10.0,
    )
    # Length for 3e4 N m/rad.
    length = 80e9 * np.pi * 0.02**4 / 32 / 3e4
    shaft = ClampedShaft(name="shaft", torque_max=30.0, diameter=0.02, length=length)
    return Chain((Stage(wave), Stage(shaft)))


def body(number, prismatic):
    """A weightless link of 0.3 m along x, about y."""
    return Body(
        name=f"axis_{number + 1}",
        parent=number,
        prismatic=bool(prismatic),
        axis=np.array([0.0, 1.0, 0.0]),
        rotation=np.eye(3),
        translation=np.array([0.3, 0.0, 0.0]),
        mass=0.0,
        centre=np.zeros(3),
        inertia=np.zeros((3, 3)),
    )


def robot(joints=2):
    prismatic = np.zeros(joints, dtype=bool)
    prismatic[1::2] = True
    return SimpleNamespace(
        name="made_up",
        title="",
        joint_names=tuple(f"axis_{j}" for j in range(1, joints + 1)),
        prismatic=prismatic,
        chains=(two_element_chain(),) * (joints - 1) + (None,),
        torque_max=np.full(joints, 30.0),
        tree=BodyTree(tuple(body(j, prismatic[j]) for j in range(joints)), np.zeros(3)),
        tool=LinkFrame(joints, np.array([0.2, 0.0, 0.0]), np.eye(3)),
        joint_shapes=lambda purpose: [],
        rigid_bodies=lambda: SimpleNamespace(gravity_torque=np.zeros_like),
        estimated=lambda: [
            SimpleNamespace(joint="axis_1", element="key", key="width", source="a guess"),
            SimpleNamespace(joint="axis_1", element="key", key="length", source="a guess"),
        ],
    )


def problem(joints=2, title="a made-up motion", objective="dynamic_deflection", **changes):
    limits = Limits(
        position_lower=np.full(joints, -2.0),
        position_upper=np.full(joints, 2.0),
        velocity=np.full(joints, 3.0),
        acceleration=np.full(joints, 20.0),
        jerk=np.full(joints, np.inf),
        torque=np.full(joints, 30.0),
        joint_stiffness={1: 5e3},
    )
    stated = {
        "robot": robot(joints),
        "start": Target(joints=np.zeros(joints)),
        "vias": (Target(position=np.array([0.1, 0.0, 0.2])),),
        "end": Target(position=np.array([0.3, 0.1, 0.2]), rpy=np.zeros(3)),
        "duration": (0.5, 0.5),
        "objectives": (Objective(name=objective),),
        "limits": limits,
        "title": title,
    }
    return TrajectoryProblem(**{**stated, **changes})


def assessment(joints=2, duration=0.5, size=1e-4, excess=-0.02, times=None):
    time = np.linspace(0.0, duration, 6001) if times is None else times
    s = time / duration
    wave = np.sin(np.pi * s)[:, None] * np.arange(1, joints + 1)
    along = np.stack([0.3 * s, 0.1 * s, 0.2 + 0.02 * np.sin(np.pi * s)], axis=1)
    static = np.tile([0.0, 0.0, -4e-4], (len(time), 1))
    dynamic = size * np.sin(2 * np.pi * s)[:, None] * np.array([1.0, 0.0, 1.0])
    stiffness = 1e4 + 1e3 * wave
    return Assessment(
        time=time,
        position=wave,
        velocity=2 * wave,
        acceleration=3 * wave,
        jerk=4 * wave,
        torque=10 * wave,
        spring_torque=9 * wave,
        stiffness=stiffness,
        windup=1e-3 * wave,
        tool=along,
        tool_speed=np.ones(len(time)),
        deflection={
            "dynamic": dynamic,
            "static": static,
            "process": np.zeros_like(static),
            "total": dynamic + static,
        },
        violations=(
            Violation(excess, "torque", 2 if joints > 1 else 1, 0.21),
            Violation(-0.3, "tool_speed", None, 0.1),
        ),
        lowest_stiffness=tuple(
            LowestStiffness(float(stiffness[:, j].min()), j + 1, 0.0) for j in range(joints)
        ),
        integrals={"torque_squared_1": 0.4},
    )


def solution(joints=2, **changes):
    value = ObjectiveValue(name="dynamic_deflection", measure="peak", value=1.414e-4, unit="m")
    found = {
        "status": SolveStatus.OPTIMAL,
        "message": SolveStatus.OPTIMAL.sentence,
        "trajectory": None,
        "assessment": assessment(joints),
        "objective": value,
        "baselines": {
            "toppra": Baseline(
                name="toppra",
                assessment=assessment(joints, size=4e-4),
                objective=5.656e-4,
                feasible=True,
                reason="",
            ),
            "quintic": Baseline(
                name="quintic",
                assessment=assessment(joints, size=2e-4, excess=0.4),
                objective=2.828e-4,
                feasible=False,
                reason="Exceeds torque.",
            ),
        },
        "ratio_to_better_baseline": 0.25,
        "solver": SolverRecord(
            iterations=46,
            build_s=0.2,
            solve_s=1.6,
            transcription="piecewise_linear_acceleration",
            intervals=60,
            homotopy=({"intervals": 30, "smoothing": np.float64(4.0), "status": "optimal"},),
            exchanges=(
                {
                    "step": "finer meshes",
                    "reason": "jerk by 3.20%",
                    "iterations": 12,
                    "accepted": True,
                },
            ),
        ),
        "notes": ("The sag at the end is 0.4 mm.",),
        "inputs_hash": "0123abcd",
        "versions": {"numpy": "2.4"},
    }
    return Solution(**{**found, **changes})


def no_motion():
    return solution(
        status=SolveStatus.INFEASIBLE,
        message=SolveStatus.INFEASIBLE.sentence + " Rows that conflict: torque of joint 2.",
        assessment=None,
        objective=None,
        ratio_to_better_baseline=None,
        baselines={
            "toppra": Baseline(
                name="toppra", assessment=None, objective=None, feasible=False, reason="Too slow."
            )
        },
    )


def trajectory_columns(joints: int) -> list[str]:
    """Return the header of trajectory.csv of an arm whose motors and links move alike."""
    quantities = ("q", "qd", "qdd", "tau", "tau_spring", "k", "windup")
    names = ["t", *(f"{each}{joint}" for each in quantities for joint in range(1, joints + 1))]
    vectors = ("tool", "deflection", "deflection_dynamic")
    return [*names, *(f"{vector}_{axis}" for vector in vectors for axis in "xyz")]
