"""Random problems: four arms, all objectives; those that can be met have a baseline that does."""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.baseline.baselines import baselines
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.errors import ProblemError
from stiffopt.problem.bounds import check_bounds
from stiffopt.problem.limit import Limits
from stiffopt.problem.objective import Objective
from stiffopt.problem.resolve import resolve
from stiffopt.problem.trajectory import Method, Target, TrajectoryProblem
from stiffopt.robot.files import load_robot
from stiffopt.robot.robot import Robot

HERE = Path(__file__).parent
TWO_LINK = HERE.parents[1] / "problems" / "two_link_robot.toml"
TIME_LIMIT = 300.0
SEED = 14

# Name, what goes with it, and whether the duration is free.
OBJECTIVES: tuple[tuple[str, dict[str, Any], bool], ...] = (
    ("dynamic_deflection", {"measure": "peak"}, False),
    ("torque_squared", {}, False),
    ("duration", {}, True),
    ("tool_deviation", {"measure": "peak"}, False),
    ("acceleration_squared", {}, False),
    ("dynamic_deflection", {"measure": "rms"}, False),
    ("process_deflection", {"measure": "rms"}, False),
    ("mean_compliance", {}, False),
    ("total_deflection", {"measure": "rms"}, False),
    ("joint_stiffness", {}, False),
    ("shaped_deviation", {"measure": "peak"}, False),
    ("residual_vibration", {}, False),
    # No motion is below what the force does in the given poses: how it ends where that is accepted.
    ("process_deflection", {"measure": "peak", "accept_bound": True}, False),
    ("tool_deviation", {"measure": "rms"}, False),
)
# Those about a force at the tool.
FORCED = ("process_deflection", "total_deflection")


@dataclass(frozen=True)
class Arm:
    """An arm to draw motions for: a middle pose, payloads [kg], joints that gravity loads.

    Without such joints its springs are linear: no motion changes their stiffness.
    """

    load: Callable[[], Robot]
    middle: tuple[float, ...]
    payload: float
    loaded: tuple[int, ...]


def seven_axis() -> Robot:
    """An arm of seven joints, 14 kg, in turn about z and y, with constant joint stiffness."""
    lengths = (0.34, 0.0, 0.4, 0.0, 0.4, 0.0, 0.126)
    masses = (3.4, 3.5, 4.0, 3.5, 3.5, 1.2, 1.2)
    torque = (176.0, 176.0, 110.0, 110.0, 110.0, 40.0, 40.0)
    velocity = (1.7, 1.7, 1.75, 2.3, 2.3, 3.1, 3.1)
    stiffness = (3e4, 3e4, 2e4, 2e4, 1e4, 7e3, 7e3)
    urdf = ['<robot name="seven"><link name="base"/>']
    toml = ['schema = 1\nkind = "robot"\nname = "seven_axis"\nurdf = "seven.urdf"']
    toml.append('tool = { link = "link_7", offset = [0.0, 0.0, 0.1] }')
    for j in range(7):
        parent = "base" if j == 0 else f"link_{j}"
        axis = "0 0 1" if j % 2 == 0 else "0 1 0"
        size = 4e-3 * masses[j]
        urdf.append(
            f'<link name="link_{j + 1}"><inertial><origin xyz="0 0.02 0.1"/>'
            f'<mass value="{masses[j]}"/><inertia ixx="{size}" iyy="{size}" izz="{size / 2}" '
            'ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="joint_{j + 1}" type="revolute"><parent link="{parent}"/>'
            f'<child link="link_{j + 1}"/><origin xyz="0 0 {lengths[j]}"/><axis xyz="{axis}"/>'
            f'<limit lower="-2.9" upper="2.9" effort="{torque[j]}" velocity="{velocity[j]}"/>'
            "</joint>"
        )
        toml.append(
            f'[[joint]]\nname = "joint_{j + 1}"\ntorque_max = {torque[j]}\n'
            f"velocity_max = {velocity[j]}\nacceleration_max = {5.0 * velocity[j]}\n"
            f'jerk_max = {80.0 * velocity[j]}\nprovenance = "estimated"\nsource = "drawn up"\n'
            '[[joint.element]]\nname = "spring"\ntype = "constant"\nratio = 1.0\n'
            f'stiffness = {stiffness[j]}\nprovenance = "estimated"\nsource = "drawn up"'
        )
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "seven.urdf").write_text("\n".join([*urdf, "</robot>"]))
        Path(folder, "seven.toml").write_text("\n".join(toml))
        return load_robot(Path(folder, "seven.toml"))


ARMS = {
    "ur10": Arm(
        functools.partial(load_robot, "ur10"), (0.0, -1.2, 1.4, -1.7, -1.5, 0.0), 8.0, (2, 3)
    ),
    "er3a_c60": Arm(
        functools.partial(load_robot, "er3a_c60"), (0.0, 0.3, -0.3, 0.0, -0.9, 0.0), 3.0, (2, 3)
    ),
    "two_link": Arm(functools.partial(load_robot, TWO_LINK), (0.0, 0.8), 2.0, ()),
    "seven_axis": Arm(seven_axis, (0.0, 0.6, 0.0, -1.2, 0.0, 0.9, 0.0), 5.0, ()),
}


@functools.cache
def _robot(name: str) -> Robot:
    return ARMS[name].load()


def feasible(number: int, seed: int = SEED) -> TrajectoryProblem:
    """The problem of a number; the quintic motion keeps all its limits."""
    random = np.random.default_rng([seed, number])
    name = tuple(ARMS)[number % len(ARMS)]
    objective, options, free = OBJECTIVES[(number // len(ARMS)) % len(OBJECTIVES)]
    if objective == "joint_stiffness":
        options = {"joints": ARMS[name].loaded}
    if objective in ("joint_stiffness", "mean_compliance") and not ARMS[name].loaded:
        objective, options = "torque_squared", {}
    while True:
        base = _met(name, random, forced=objective in FORCED)
        duration = random.uniform(1.0, 2.0) * base.duration[0]
        slow = replace(base, duration=(duration, duration))
        if not _keeps(slow):
            continue
        found = replace(
            slow,
            duration=(0.1 * duration, 3.0 * duration) if free else slow.duration,
            objectives=(Objective(name=objective, **options),),
            title=f"{number} {name} {objective} {options.get('measure', '')}".strip(),
        )
        try:
            check_bounds(found, resolve(found))
        except ProblemError:
            # Degenerate: no motion changes the objective.
            continue
        return found


# What is asked too much of, the word that must be in the answer, and how.
IMPOSSIBLE = ("velocity", "acceleration", "torque", "dynamic_deflection", "tool_speed", "jerk")


def infeasible(number: int) -> tuple[TrajectoryProblem, str]:
    """A problem that no motion meets, and the limit that forbids it.

    The duration or the limit is a third of what the rows of one joint, or of the tool, need by
    themselves.
    """
    random = np.random.default_rng([41, number])
    name = tuple(ARMS)[number % len(ARMS)]
    kind = IMPOSSIBLE[(number // len(ARMS)) % len(IMPOSSIBLE)]
    objective, options, _ = OBJECTIVES[int(random.integers(0, 2))]
    base = _met(name, random, forced=False)
    motion = resolve(base)
    limits, duration = base.active_limits, base.duration[0]
    path = np.abs(motion.end - motion.start)
    quintic = baselines(base, motion)["quintic"].assessment
    assert quintic is not None
    if kind == "torque":
        # Half of what holds the arm in the end pose; a third of the peak where nothing hangs.
        held, peak = np.abs(quintic.torque[-1]), np.abs(quintic.torque).max(axis=0)
        asked = 0.5 * held if np.any(held > 0.05 * limits.torque) else peak / 3.0
        limits = replace(limits, torque=np.maximum(asked, 0.02 * limits.torque))
    elif kind == "dynamic_deflection":
        limits = replace(limits, dynamic_deflection=1e-9)
    elif kind == "tool_speed":
        straight = float(np.linalg.norm(quintic.tool[-1] - quintic.tool[0]))
        limits = replace(limits, tool_speed=max(straight, 1e-3) / duration / 3.0)
    elif kind == "velocity":
        limits = replace(limits, velocity=np.maximum(path / duration / 3.0, 1e-3))
    elif kind == "acceleration":
        limits = replace(limits, acceleration=np.maximum(4.0 * path / duration**2 / 3.0, 1e-3))
    else:
        limits = replace(limits, jerk=np.maximum(32.0 * path / duration**3 / 3.0, 1e-3))
    found = replace(
        base,
        limits=limits,
        objectives=(Objective(name=objective, **options),),
        title=f"{number} {name} without {kind}",
    )
    return found, kind


def _met(name: str, random: np.random.Generator, *, forced: bool) -> TrajectoryProblem:
    """A drawn motion in nearly the shortest time in which the quintic one keeps all limits."""
    while True:
        drawn = _drawn(name, random, forced=forced)
        for _ in range(20):
            if _keeps(drawn):
                return drawn
            longer = 1.15 * drawn.duration[0]
            drawn = replace(drawn, duration=(longer, longer))


def _keeps(problem: TrajectoryProblem) -> bool:
    try:
        quintic = baselines(problem, resolve(problem))["quintic"].assessment
    except ProblemError:
        # A pose that the drives cannot hold.
        return False
    return quintic is not None and quintic.feasible(CERTIFICATE_TOLERANCE)


def _drawn(name: str, random: np.random.Generator, *, forced: bool) -> TrajectoryProblem:
    """A motion between poses around the middle one, in about the time that its limits need."""
    arm = ARMS[name]
    robot = _robot(name)
    mass = float(random.uniform(0.0, arm.payload))
    robot = robot.with_payload(mass, [0.0, 0.0, 0.03], [1e-3 * (1.0 + mass)] * 3)
    low, high = robot.position_lower + 0.05, robot.position_upper - 0.05
    reach = random.uniform(0.2, 0.8)
    ends = [
        np.clip(arm.middle + random.uniform(-reach, reach, robot.n), low, high) for _ in range(2)
    ]
    limits = Limits.of(robot)
    path = np.abs(ends[1] - ends[0])
    needed = [1.875 * path / limits.velocity]
    needed += [np.sqrt(5.78 * path / limits.acceleration), np.cbrt(60.0 * path / limits.jerk)]
    duration = max(float(np.max(needed)), 0.1)
    force = np.zeros(3)
    if forced:
        force = random.normal(size=3)
        force *= 30.0 / np.linalg.norm(force)
    return TrajectoryProblem(
        robot=robot,
        start=Target(joints=ends[0]),
        end=Target(joints=ends[1]),
        duration=(duration, duration),
        objectives=(Objective(name="torque_squared"),),
        limits=limits,
        process_force=force,
        method=Method(time_limit=TIME_LIMIT),
    )
