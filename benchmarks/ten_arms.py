"""Tool error of the commanded arm with tilting bearings and servo, on arms of many kinds.

Six-axis arms with strain-wave and with RV reducers, a SCARA, a seven-axis arm and a palletiser with
output bearings of catalogue size, and an arm of planetary gearheads. Motion and best rival have
their best commands; each is put on its own worst arms in flight and after arrival by a simulation
that has every bearing as joints of its own in pinocchio, spring tables of `elastic_simulation`, and
the servo that `tool_error` integrates. Say arms and the number of motions:
`python ten_arms.py scara ur10 2`.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from common import Row, main
from elastic_simulation import Springs
from scipy.integrate import odeint
from scipy.interpolate import CubicHermiteSpline
from tool_error import STANDSTILL, Held, Motors, judge

from stiffopt.command.command_search import CommandOnArms
from stiffopt.drivetrain import catalogue
from stiffopt.drivetrain.bearing import OutputBearing
from stiffopt.problem.trajectory import Method, Target, TrajectoryProblem
from stiffopt.robot.files import load_robot
from stiffopt.robot.robot import Robot

sys.path.append(str(Path(__file__).parents[1] / "tests" / "elastic"))
from tilting_arms import TiltingArm, tilting_arm

TITLE = "Tool error with tilting bearings and servo, commanded arm against the best rival"
SEED, MOTIONS = 7, 3
DAMPING = 0.02  # of critical, of every spring
# Travel of a motion about the middle pose [rad or, for a slide, m].
TRAVEL, SLIDE_TRAVEL = 0.8, 0.08
# Duration over the least one of the quintic motion: its command needs some more than its links.
SLACK = 1.05


@dataclass(frozen=True)
class Arm:
    """An arm of links along given offsets: axis, offset [m], mass [kg], reducer, bearing, torque.

    An axis "z slide" is a slide; motions go about the pose `middle`. A reducer is one of the
    catalogue or a stiffness [N m/rad].
    """

    joints: tuple[tuple[str, tuple[float, float, float], float, str | float, str, float], ...]
    tool: tuple[float, float, float]
    middle: tuple[float, ...]
    payload: float
    acceleration: float


ARMS = {
    "scara": Arm(
        joints=(
            ("z", (0.0, 0.0, 0.4), 9.0, "harmonic_32_100", "csf_2uh_32", 150.0),
            ("z", (0.35, 0.0, 0.0), 6.0, "harmonic_25_100", "csf_2uh_25", 80.0),
            ("z slide", (0.3, 0.0, 0.0), 1.5, "", "", 300.0),
            ("z", (0.0, 0.0, -0.1), 0.8, "harmonic_14_100", "csf_2uh_14", 12.0),
        ),
        tool=(0.0, 0.0, -0.1),
        middle=(0.3, 0.8, 0.05, 0.2),
        payload=2.0,
        acceleration=25.0,
    ),
    "seven axes": Arm(
        joints=(
            ("z", (0.0, 0.0, 0.16), 5.0, "harmonic_32_100", "csf_2uh_32", 180.0),
            ("y", (0.0, 0.0, 0.18), 5.0, "harmonic_32_100", "csf_2uh_32", 180.0),
            ("z", (0.0, 0.0, 0.21), 4.0, "harmonic_25_100", "csf_2uh_25", 90.0),
            ("y", (0.0, 0.0, 0.19), 3.5, "harmonic_25_100", "csf_2uh_25", 90.0),
            ("z", (0.0, 0.0, 0.2), 2.5, "harmonic_20_100", "csf_2uh_20", 55.0),
            ("y", (0.0, 0.0, 0.2), 2.0, "harmonic_17_100", "csf_2uh_17", 35.0),
            ("z", (0.0, 0.0, 0.08), 0.5, "harmonic_14_100", "csf_2uh_14", 18.0),
        ),
        tool=(0.0, 0.03, 0.1),
        middle=(0.2, 0.6, 0.1, 1.0, 0.2, 0.8, 0.0),
        payload=2.0,
        acceleration=15.0,
    ),
    "palletiser": Arm(
        joints=(
            ("z", (0.0, 0.0, 0.6), 250.0, "rv_160e_129", "rv_160e", 3900.0),
            ("y", (0.3, 0.0, 0.2), 120.0, "rv_160e_129", "rv_160e", 3900.0),
            ("y", (0.0, 0.0, 1.1), 80.0, "rv_80e_121", "rv_80e", 1960.0),
            ("y", (1.2, 0.0, 0.0), 20.0, "rv_20e_121", "rv_20e", 412.0),
        ),
        tool=(0.2, 0.0, -0.2),
        middle=(0.2, 0.2, 0.3, -0.5),
        payload=25.0,
        acceleration=4.0,
    ),
    # Gearheads of assumed stiffness, of the size of catalogues' 3 to 20 N m/arcmin; no play.
    "planetary gearheads": Arm(
        joints=(
            ("z", (0.0, 0.0, 0.3), 12.0, 7e4, "", 220.0),
            ("y", (0.0, 0.0, 0.1), 9.0, 7e4, "", 220.0),
            ("y", (0.0, 0.0, 0.4), 6.0, 3.5e4, "", 110.0),
            ("x", (0.25, 0.0, 0.0), 2.0, 1e4, "", 35.0),
            ("y", (0.15, 0.0, 0.0), 1.0, 1e4, "", 35.0),
        ),
        tool=(0.12, 0.0, 0.0),
        middle=(0.2, 0.3, 0.4, 0.2, -0.8),
        payload=2.0,
        acceleration=12.0,
    ),
    "RV reducers": Arm(
        joints=(
            ("z", (0.0, 0.0, 0.5), 90.0, "rv_110e_111", "rv_110e", 2690.0),
            ("y", (0.25, 0.0, 0.15), 60.0, "rv_110e_111", "rv_110e", 2690.0),
            ("y", (0.0, 0.0, 0.8), 45.0, "rv_40e_121", "rv_40e", 1029.0),
            ("x", (0.4, 0.0, 0.15), 15.0, "rv_20e_121", "rv_20e", 412.0),
            ("y", (0.4, 0.0, 0.0), 8.0, "rv_20e_121", "rv_20e", 412.0),
            ("x", (0.12, 0.0, 0.0), 2.0, "rv_6e_79", "rv_6e", 117.0),
        ),
        tool=(0.15, 0.05, 0.0),
        middle=(0.2, 0.2, 0.2, 0.3, -0.9, 0.1),
        payload=15.0,
        acceleration=8.0,
    ),
}
SHIPPED = {
    "er3a_c60": (
        ("csf_2uh_20", "csf_2uh_25", "csf_2uh_20", "csf_2uh_14", "csf_2uh_14", "csf_2uh_14"),
        (0.0, 0.3, -0.3, 0.0, -0.9, 0.0),
    ),
    "ur10": (
        ("csf_2uh_40", "csf_2uh_40", "csf_2uh_32", "csf_2uh_20", "csf_2uh_20", "csf_2uh_20"),
        (0.0, -1.2, 1.4, -1.7, -1.5, 0.0),
    ),
}


def write_arm(name: str, arm: Arm, folder: Path) -> Robot:
    """Write URDF and robot file of an arm of slender links, and load it."""
    parts = [f'<robot name="{name}"><link name="base"/>']
    text = ["schema = 1", 'kind = "robot"', f'name = "{name}"', f'urdf = "{folder / "arm.urdf"}"']
    text += ['tool = { link = "tip" }', 'flange = { link = "tip" }']
    before = "base"
    offsets = [np.array(joint[1]) for joint in arm.joints[1:]] + [np.array(arm.tool)]
    for j, ((axis, offset, mass, reducer, bearing, torque), ahead) in enumerate(
        zip(arm.joints, offsets, strict=True), start=1
    ):
        slide = axis.endswith("slide")
        length = max(float(np.linalg.norm(ahead)), 0.1)
        inertia = mass * (length**2 / 12.0 + 0.25 * 0.06**2)
        centre = " ".join(f"{x:g}" for x in 0.5 * ahead)
        moments = " ".join(
            f'{key}="{value:g}"'
            for key, value in zip(
                ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"),
                (inertia, 0, 0, inertia, 0, inertia),
                strict=True,
            )
        )
        parts.append(
            f'<link name="link_{j}"><inertial><origin xyz="{centre}"/><mass value="{mass}"/>'
            f"<inertia {moments}/></inertial></link>"
        )
        direction = " ".join("1" if each == axis[0] else "0" for each in "xyz")
        place = " ".join(f"{x:g}" for x in offset)
        reach = (-0.2, 0.2) if slide else (-3.0, 3.0)
        parts.append(
            f'<joint name="joint_{j}" type="{"prismatic" if slide else "revolute"}">'
            f'<parent link="{before}"/><child link="link_{j}"/><origin xyz="{place}"/>'
            f'<axis xyz="{direction}"/><limit lower="{reach[0]}" upper="{reach[1]}" '
            f'effort="{torque}" velocity="{1.0 if slide else 3.0}"/></joint>'
        )
        before = f"link_{j}"
        size = 0.2 * arm.acceleration if slide else arm.acceleration
        text += ["[[joint]]", f'name = "joint_{j}"', f"torque_max = {torque}"]
        text += [f"acceleration_max = {size}", f"jerk_max = {30.0 * size}"]
        if bearing:
            text.append(f'bearing = {{ catalogue = "{bearing}" }}')
        if isinstance(reducer, float):
            text += ["[[joint.element]]", 'name = "gearhead"', 'type = "constant"']
            text.append(f"stiffness = {reducer}")
        elif reducer:
            text += ["[[joint.element]]", 'name = "reducer"', 'type = "reducer"']
            text.append(f'catalogue = "{reducer}"')
    place = " ".join(f"{x:g}" for x in arm.tool)
    parts.append(
        f'<link name="tip"/><joint name="end" type="fixed"><parent link="{before}"/>'
        f'<child link="tip"/><origin xyz="{place}"/></joint></robot>'
    )
    (folder / "arm.urdf").write_text("\n".join(parts))
    (folder / "arm.toml").write_text("\n".join(text) + "\n")
    return load_robot(folder / "arm.toml")


def robots() -> Iterator[tuple[str, Robot, np.ndarray]]:
    """Names, robots with payload and bearings, and the poses about which they move."""
    for name, (bearings, middle) in SHIPPED.items():
        robot = load_robot(name).with_payload(1.0, (0.0, 0.0, 0.05), (1e-3, 1e-3, 1e-3))
        own = tuple(OutputBearing(**catalogue.bearing(each)) for each in bearings)
        yield name, replace(robot, bearings=own), np.array(middle)
    for name, arm in ARMS.items():
        with tempfile.TemporaryDirectory() as folder:
            robot = write_arm(name, arm, Path(folder))
        size = 2e-3 * arm.payload
        robot = robot.with_payload(arm.payload, (0.0, 0.0, 0.0), (size, size, size))
        yield name, robot, np.array(arm.middle)


def motions(robot: Robot, middle: np.ndarray, count: int) -> Iterator[TrajectoryProblem]:
    """Random motions about a pose, a little slower than the fastest quintic one."""
    random = np.random.default_rng(SEED)
    width = np.where(robot.prismatic, SLIDE_TRAVEL, TRAVEL)
    low, high = robot.position_lower + 0.02, robot.position_upper - 0.02
    for _ in range(count):
        ends = [np.clip(middle + width * random.uniform(-1, 1, robot.n), low, high) for _ in "ab"]
        far = np.abs(ends[1] - ends[0])
        least = np.max(
            [
                1.875 * far / robot.velocity_max,
                np.sqrt(5.7735 * far / robot.acceleration_max),
                np.cbrt(60.0 * far / robot.jerk_max),
            ]
        )
        duration = SLACK * float(least)
        yield TrajectoryProblem(
            robot=robot,
            start=Target(joints=ends[0]),
            end=Target(joints=ends[1]),
            duration=(duration, duration),
            method=Method(collisions="check"),
        )


class Simulation:
    """An uncertain arm whose bearings are joints, driven by motors through spring tables."""

    def __init__(self, robot: Robot, departure: dict[str, Any]) -> None:
        robot = robot.with_payload_times(departure["payload"])
        robot = robot.with_bearings_times(np.array(departure["bearings"]))
        self.arm: TiltingArm = tilting_arm(robot)
        self._springs, self._factor = Springs(robot), np.array(departure["stiffness"])
        self._robot, self._damping = robot, departure["damping"]
        self._free = ~self._springs.rigid

    def torque(self, windup: np.ndarray) -> np.ndarray:
        with np.errstate(invalid="ignore"):
            return np.where(
                self._free, self._factor * self._springs.torque(np.where(self._free, windup, 0)), 0
            )

    def resting(self, motor: np.ndarray) -> np.ndarray:
        """Equilibrium (m,) with the motors held."""
        q = np.array(motor, dtype=float)
        for _ in range(60):
            x = self.arm.static_position(q, np.zeros(3))
            data = self.arm.model.createData()
            weight = pin.computeGeneralizedGravity(self.arm.model, data, x)[self.arm.driven]
            new = motor - np.where(self._free, self._springs.windup(weight / self._factor), 0.0)
            if np.max(np.abs(new - q)) < 1e-12:
                break
            q = new
        return x

    def tool_error(self, motors: Motors, plan: Held, times: np.ndarray) -> np.ndarray:
        """Distance (K,) [m] of the tool from where it rests at the planned positions."""
        arm, model = self.arm, self.arm.model
        data, n = model.createData(), model.nq
        start = self.resting(motors(np.zeros(1), 0)[0])
        inertia = np.diag(pin.crba(model, data, start))
        weight = pin.computeGeneralizedGravity(model, data, start)[arm.driven]
        stiffness = arm.stiffness.copy()
        stiffness[arm.driven] = self._springs.stiffness(weight, self._robot)
        damping = 2.0 * DAMPING * np.sqrt(stiffness * inertia)
        damping[arm.driven] *= self._damping
        rigid = arm.driven[~self._free]
        others = np.setdiff1d(np.arange(n), rigid)
        grid = motors.times
        place = CubicHermiteSpline(grid, motors(grid, 0), motors(grid, 1))
        # With a continuous speed the integrator takes steps longer than the servo's.
        motor_at = [place, place.derivative(), place.derivative(2)]

        def slope(t: float, state: np.ndarray) -> np.ndarray:
            x, v = state[:n].copy(), state[n:].copy()
            motor, speed = motor_at[0](t), motor_at[1](t)
            x[rigid], v[rigid] = motor[~self._free], speed[~self._free]
            torque = -arm.stiffness * x - damping * v
            own = self.torque(motor - x[arm.driven])
            torque[arm.driven] = own + damping[arm.driven] * (speed - v[arm.driven])
            if not rigid.size:
                return np.concatenate([v, pin.aba(model, data, x, v, torque)])
            a = np.zeros(n)
            a[rigid] = motor_at[2](t)[~self._free]
            left = (torque - pin.rnea(model, data, x, v, a))[others]
            mass = pin.crba(model, data, x)
            mass = np.triu(mass) + np.triu(mass, 1).T
            a[others] = np.linalg.solve(mass[np.ix_(others, others)], left)
            return np.concatenate([v, a])

        state = np.concatenate([start, np.zeros(n)])
        found = odeint(slope, state, times, tfirst=True, rtol=1e-8, atol=1e-10, mxstep=200000)
        away = np.empty(len(times))
        for k, t in enumerate(times):
            x = found[k, :n].copy()
            x[rigid] = place(t)[~self._free]
            rest = arm.tool_pose(self.resting(plan(np.array([t]), 0)[0]))
            away[k] = np.linalg.norm(arm.tool_pose(x).translation - rest.translation)
        return away


def worst_errors(problem: TrajectoryProblem, found: CommandOnArms) -> np.ndarray:
    """Peaks [m] in flight and after arrival, each on the package's worst arm for it."""
    servos = problem.servo, problem.uncertainty.worst_servo(problem.servo)
    peaks, arrival = [], float(found.motion.time[-1])
    for phase in ("flight", "after"):
        departure = getattr(found.compensated, phase).worst_arm
        motors = Motors(found.motors, servos, departure["servo"])
        plan = Held(found.motion.planned_path, motors.duration)
        times = np.linspace(0.0, motors.duration - STANDSTILL, 401)
        away = Simulation(problem.robot, departure).tool_error(motors, plan, times)
        flying = times < arrival
        peaks.append(away[flying].max() if phase == "flight" else away[~flying].max())
    return np.array(peaks)


def run() -> list[Row]:
    """Arms that the command line names, else all."""
    words = [word for word in sys.argv[1:] if not word.isdigit()]
    count = next((int(word) for word in sys.argv[1:] if word.isdigit()), MOTIONS)
    rows = []
    for name, robot, middle in robots():
        if words and not any(word in name for word in words):
            continue
        for number, problem in enumerate(motions(robot, middle, count), start=1):
            rows += judge(f"{name}, motion {number}", problem, worst_errors)
            print(*rows[-2:], sep="\n", file=sys.stderr, flush=True)
    return rows


if __name__ == "__main__":
    main(TITLE, run)
