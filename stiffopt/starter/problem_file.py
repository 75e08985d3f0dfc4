"""First trajectory problem of a robot: a feasible motion about the middle of its ranges."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stiffopt.baseline.rivals import quintic_law
from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.modes import modes
from stiffopt.errors import NotSimulatedError, RobotError
from stiffopt.robot.cell import Cell
from stiffopt.robot.clearance import ClearanceModel
from stiffopt.robot.robot import Robot
from stiffopt.starter.writing import relative_path, toml_list, toml_number, toml_string


def problem_text(robot: Robot, file: str | Path, folder: Path) -> str:
    """Return the text of a trajectory problem file.

    `file`: name of a shipped robot, or path of a robot file. `folder`: folder of the problem file.
    Raises `RobotError`: no feasible motion was found.
    """
    motion = first_motion(robot)
    named = relative_path(file, folder) if isinstance(file, Path) else file
    if not motion.yields:
        objective = '"torque_squared"'
        why = "a rigid tool: least heat. With joints that yield, minimise tool_error"
    elif motion.rigid_joint:
        objective = '"torque_squared"'
        why = (
            f"least heat: {motion.rigid_joint}, the strongest, is rigid here. Give its elements,"
            " then minimise tool_error"
        )
    else:
        objective = '"tool_error"'
        why = "least error of the tool with a command, in flight and after arrival"
    cell = (
        "collisions between links are checked; add obstacles"
        if motion.checked
        else "collisions between links are not checked: their shapes are not known"
    )
    lines = [
        f"# First problem for {robot.name}, written by `stiffopt init problem`: poses about the",
        "# middle of the joints' ranges. Obstacles of your cell are not included.",
        "schema = 1",
        'kind = "trajectory"',
        f"title = {toml_string(f'First motion of {robot.name}')}",
        f"robot = {toml_string(named)}",
        "",
        "# [payload]",
        "# mass = 1.0                  # [kg], at the flange",
        '# com = ["0 mm", "0 mm", "50 mm"]',
        "# inertia = [1e-3, 1e-3, 1e-3]",
        "",
        f"# [cell]                       # {cell}",
        '# floor = "0 mm"               # height, base frame',
        '# clearance = "20 mm"',
        "",
        "[motion]",
        f"start = {{ joints = {_format_pose(robot, motion.start)} }}",
        f"end = {{ joints = {_format_pose(robot, motion.end)} }}",
        f'duration = "{motion.duration:.3g} s"',
        "",
        "[[minimise]]",
        f"objective = {objective}     # {why}",
        "",
        "[method]",
        "intervals = 40",
    ]
    return "\n".join(lines) + "\n"


def _format_pose(robot: Robot, pose: np.ndarray) -> str:
    return toml_list(
        toml_number(value) if slides else toml_string(f"{np.degrees(value):.1f} deg")
        for value, slides in zip(pose, robot.prismatic, strict=True)
    )


# Range of a joint without limits [rad].
_ENDLESS_RANGE = 0.6
_MAX_TRIES = 200
# Largest share of the torque limits that weight takes in a preferred pose.
_MAX_WEIGHT_SHARE = 0.7
# Samples of the path, and factor on the duration of a motion beyond the limits.
_PATH_SAMPLES, _SLOWDOWN_FACTOR = 21, 1.2
_QUINTIC_LAW = quintic_law(1.0)
# Peak speed, acceleration and jerk of the quintic law of unit duration, within 0.02 %.
_PEAK_SPEED, _PEAK_ACCELERATION, _PEAK_JERK = (
    float(np.abs(_QUINTIC_LAW(np.linspace(0.0, 1.0, 101), order)).max()) for order in (1, 2, 3)
)


@dataclass(frozen=True, eq=False)
class FirstMotion:
    """Feasible motion: poses (n,) [rad] and duration [s]."""

    # (n,).
    start: np.ndarray
    end: np.ndarray
    duration: float
    yields: bool  # the tool deflects along the path and the arm has an elastic mode
    # Strongest revolute joint, if it has no spring though others have; else "". The deviation is
    # then not meaningful as an objective.
    rigid_joint: str
    checked: bool  # there are links with collision shapes; otherwise collisions were not checked


def first_motion(robot: Robot) -> FirstMotion:
    """Find a motion within the drives' limits, free of collisions, above the base if possible.

    Collisions are checked for links with shapes in the URDF, see `ClearanceModel`. Raises
    `RobotError`: no pose within the drives' limits, none without a collision, or no feasible
    duration.
    """
    shapes = ClearanceModel(robot, Cell())
    start, end = _find_poses(robot, shapes)
    yields = robot.tool_yields(_path_poses(start, end))
    swing = _lowest_mode_period(robot, start) if yields else None
    return FirstMotion(
        start,
        end,
        _choose_duration(robot, start, end, swing or 0.0),
        yields=swing is not None,
        rigid_joint=_rigid_strongest_joint(robot) if swing is not None else "",
        checked=bool(shapes.pairs),
    )


def _rigid_strongest_joint(robot: Robot) -> str:
    """Return the name of the strongest revolute joint if it has no spring, else ""."""
    strongest = int(np.argmax(np.where(robot.prismatic, 0.0, robot.torque_max)))
    chain = robot.chains[strongest]
    return "" if chain is not None and chain.stages else robot.joint_names[strongest]


def _path_poses(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return poses along the straight path (_PATH_SAMPLES, n)."""
    return np.asarray(start + np.linspace(0.0, 1.0, _PATH_SAMPLES)[:, None] * (end - start))


def _find_poses(robot: Robot, shapes: ClearanceModel) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends of the motion, preferably with torque to spare."""
    low, high = robot.position_lower, robot.position_upper
    finite = np.isfinite(high - low)
    low, high = np.where(finite, low, 0.0), np.where(finite, high, 0.0)
    middle = 0.5 * (low + high)
    # The motion covers 15 % of each range.
    half = np.where(finite, 0.5 * 0.15 * (high - low), 0.5 * _ENDLESS_RANGE)
    half = np.minimum(half, np.where(robot.prismatic, np.inf, 0.5 * _ENDLESS_RANGE))
    random = np.random.default_rng(1)
    bodies, friction = robot.rigid_bodies(), np.nan_to_num(robot.coulomb)
    least, least_joint, needed, met, held = np.inf, 0, 0.0, ("", ""), 0
    found: dict[tuple[bool, bool], tuple[np.ndarray, np.ndarray]] = {}
    for trial in range(_MAX_TRIES):
        centre = middle
        if trial:
            span = np.where(finite, 0.3 * (high - low), 1.0)
            centre = middle + random.uniform(-1.0, 1.0, robot.n) * span
        start, end = np.round(centre - half, 3), np.round(centre + half, 3)
        way = _path_poses(start, end)
        weight = np.max([np.abs(bodies.gravity_torque(pose)) for pose in way], axis=0)
        share = (weight + friction) / robot.torque_max
        if share.max() < least:
            least, least_joint = float(share.max()), int(np.argmax(share))
            needed = float((weight + friction)[least_joint])
        # Largest share of weight and friction in any pose.
        if share.max() > 0.9 or (weight / robot.torque_max).max() > _MAX_WEIGHT_SHARE:
            continue
        held += 1
        distances = [shapes.distances(pose) for pose in way]
        worst = min(distances, key=lambda each: float(each.min(initial=np.inf)))
        if worst.min(initial=np.inf) <= 0.0:
            met = shapes.pairs[int(np.argmin(worst))]
            continue
        below = min(bodies.pose(robot.tool, pose)[0][2] for pose in way) <= 0.0
        rank = (bool(share.max() > _MAX_WEIGHT_SHARE), bool(below))
        if not any(rank):
            return start, end
        found.setdefault(rank, (start, end))
    if found:
        return found[min(found)]
    if held:
        raise RobotError(
            f"{robot.name}: of {_MAX_TRIES} motions its drives hold {held}, and links collide in"
            f" each; in the last one {met[0]} is in {met[1]}. Correct the collision shapes"
            " of the URDF, or write the problem by hand with method.collisions = 'check'."
        )
    also = " and Coulomb friction" if friction[least_joint] > 0.0 else ""
    raise RobotError(
        f"{robot.name}: in none of {_MAX_TRIES} poses do its drives hold its weight{also}:"
        f" {robot.joint_names[least_joint]} has {robot.torque_max[least_joint]:g} N m and needs"
        f" {needed:.3g} at least, and room to move. Correct torque_max of the robot file, or its"
        f" masses{also and ' and friction'}."
    )


def _lowest_mode_period(robot: Robot, pose: np.ndarray) -> float | None:
    """Return the period of the lowest elastic mode [s]; None for a rigid arm."""
    try:
        found = modes(ElasticArm(robot, pose), pose)
    except NotSimulatedError:
        return None
    return 1.0 / found[0].frequency if found else None


def _choose_duration(robot: Robot, start: np.ndarray, end: np.ndarray, swing: float) -> float:
    """Return a duration within all limits, with margin and two vibration periods [s]."""
    way = np.abs(end - start)
    times = (
        (_PEAK_SPEED * way / robot.velocity_max).max(),
        np.sqrt(_PEAK_ACCELERATION * way / robot.acceleration_max).max(),
        np.cbrt(_PEAK_JERK * way / robot.jerk_max).max(),
        0.2,
    )
    # Twice the shortest of the quintic motion.
    duration = float(2.0 * max(times) + 2.0 * swing)
    # Static share; if it is large, the motion may use half of the remainder.
    still = _torque_share(robot, start, end, np.inf).max()
    allowed = 0.8 if still <= _MAX_WEIGHT_SHARE else 0.5 * (1.0 + still)
    for _ in range(30):
        share = _torque_share(robot, start, end, duration)
        if share.max() <= allowed:
            return float(np.ceil(10.0 * duration) / 10.0)
        duration *= _SLOWDOWN_FACTOR
    worst = int(np.argmax(share))
    raise RobotError(
        f"{robot.name}: a first motion of {duration / _SLOWDOWN_FACTOR:.3g} s still takes"
        f" {100 * share[worst]:.0f} % of the torque of {robot.joint_names[worst]}. Correct its"
        " torque_max, masses, coulomb or viscous in the robot file."
    )


def _torque_share(robot: Robot, start: np.ndarray, end: np.ndarray, duration: float) -> np.ndarray:
    """Return the largest torque of the quintic motion over each limit (n,), with friction."""
    bodies, way = robot.rigid_bodies(), end - start
    places = np.linspace(0.0, 1.0, _PATH_SAMPLES)
    place, speed, rate = (_QUINTIC_LAW(places, order) / duration**order for order in range(3))
    rows = zip(start + place * way, speed * way, rate * way, strict=True)
    torque = np.max([np.abs(bodies.torque(q, v, a)) for q, v, a in rows], axis=0)
    torque = (
        torque
        + np.nan_to_num(robot.coulomb)
        + np.nan_to_num(robot.viscous) * np.abs(way) * _PEAK_SPEED / duration
    )
    return np.asarray(torque / robot.torque_max)
