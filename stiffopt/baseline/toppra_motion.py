"""The toppra baseline: time-optimal on a joint path, then slowed uniformly to a duration.

Source: Pham, Pham (2018), "A new approach to time-optimal path parameterization based on
reachability analysis". Limits hold between the grid points to second order ("interpolation
scheme"), and the path acceleration is constant between them, so that the motion is piecewise
polynomial and followed exactly.
"""

from __future__ import annotations

import logging
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from itertools import pairwise
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from stiffopt.baseline.path_limits import PathLimits, path_limits
from stiffopt.result.joint_path import JointPath
from stiffopt.result.trajectory import Trajectory

if TYPE_CHECKING:
    from stiffopt.problem.limit import Limits
    from stiffopt.robot.robot import Robot

# Passes of the viscous friction bound, and relative gain in duration below which they end.
_MAX_FRICTION_PASSES = 12
_DURATION_TOLERANCE = 1e-5


@dataclass(frozen=True, kw_only=True)
class BaselineMotion:
    """Baseline motion, or the reason why there is none."""

    name: str  # "toppra" or "quintic"
    motion: Trajectory | None  # None where the baseline does not exist; `reason` then says why
    reason: str = ""  # a sentence, empty where there is a motion
    # Shortest duration on the path under the limits, where it is known [s].
    fastest: float | None = None
    law: Trajectory | None = None  # its time law, where it is known


def toppra_baseline(
    robot: Robot,
    limits: Limits,
    path: JointPath,
    duration: float | None = None,
    process_force: object = (0.0, 0.0, 0.0),
    intervals: int = 1000,
    *,
    eased: bool = False,
) -> BaselineMotion:
    """Return the time-optimal rest-to-rest motion along `path`, slowed uniformly to `duration`.

    Limits on joint velocity (with its map over position), acceleration, drive torque and tool speed
    are kept. Rotor inertia and dry friction are exact; viscous friction is bounded on the safe
    side, which costs a little speed where it helps to brake. Jerk, deflection and stiffness limits
    are beyond the method: the assessment of the motion shows them. `path`: the straight line, or
    the spline through the via points. `duration`: wanted duration; the shortest one if left out
    [s]. `process_force` (3,): acts on the tool, base axes [N]. `intervals`: of the path grid.
    `eased`: let the acceleration rise from zero at the start and fall to zero at the end, each
    within the first and the last interval of the grid. There is no motion, with the reason, where
    the path cannot be followed within the limits or not within `duration`.
    """
    force = np.asarray(process_force, dtype=float)
    grid = _path_grid(path.knots, intervals)
    rows = path_limits(robot, limits, path, grid, force)
    still = rows.violation_at_rest()
    if still:
        return _missing_baseline(f"No motion keeps the limits on this path. {still}")
    law = _fastest_law(rows, path.joints, eased=eased)
    if law is None:
        return _missing_baseline(
            "No motion along this path keeps all limits: toppra finds no time law that starts and "
            "ends at rest."
        )
    motion = path.follow(law)
    fastest = motion.duration
    if duration is None:
        return BaselineMotion(name="toppra", motion=motion, fastest=fastest, law=law)
    if duration < fastest:
        return _missing_baseline(
            f"The fastest motion along this path takes {fastest:.4g} s, longer than the "
            f"{duration:.4g} s asked for.",
            fastest,
        )
    return BaselineMotion(name="toppra", motion=motion.scaled_to(duration), fastest=fastest)


def _missing_baseline(reason: str, fastest: float | None = None) -> BaselineMotion:
    return BaselineMotion(name="toppra", motion=None, reason=reason, fastest=fastest)


def _path_grid(knots: np.ndarray, intervals: int) -> np.ndarray:
    """Return an even grid that contains the knots, graded at the ends.

    No interval contains a jump of the path's derivatives. From rest, time grows with the root of
    the distance: an ungraded first interval would be by far the longest one in time.
    """
    pieces = [
        np.linspace(low, high, max(2, int(np.ceil(intervals * (high - low)))) + 1)[:-1]
        for low, high in pairwise(knots)
    ]
    even = np.append(np.concatenate(pieces), knots[-1])
    graded = np.array([1.0 / 1024.0, 1.0 / 256.0, 1.0 / 64.0, 1.0 / 16.0, 1.0 / 4.0])
    return np.concatenate(
        [even[:1], even[1] * graded, even[1:-1], 1.0 - (1.0 - even[-2]) * graded[::-1], even[-1:]]
    )


def _fastest_law(rows: PathLimits, joints: int, *, eased: bool) -> Trajectory | None:
    """Return the fastest time law s(t); repeated passes tighten the viscous friction bound."""
    squared = rows.squared_speed_max
    law = None
    for _ in range(_MAX_FRICTION_PASSES if np.any(rows.loss) else 1):
        linear = rows.linearised(squared)
        speed = _path_speed(rows, linear, joints)
        if speed is not None and eased:
            speed = _eased_speed(rows, linear, joints, speed)
        if speed is None:
            break
        better = _time_law(rows.grid, speed, eased=eased)
        settled = (
            law is not None and law.duration - better.duration < _DURATION_TOLERANCE * law.duration
        )
        law = better if law is None or better.duration < law.duration else law
        if settled:
            break
        squared = speed**2
    return law


def _time_law(grid: np.ndarray, speed: np.ndarray, *, eased: bool) -> Trajectory:
    """Return the time law with path acceleration constant between grid points.

    With `eased` it is linear in the first and the last interval.
    """
    step = np.diff(grid)
    duration = 2.0 * step / (speed[:-1] + speed[1:])
    acceleration = np.zeros((len(step), 2 if eased else 1, 1))
    acceleration[:, 0, 0] = np.diff(speed**2) / (2.0 * step)
    if eased:
        # From rest at a rate r: s = r t^3 / 6 and ds/dt = r t^2 / 2, so that t = 3 s / (ds/dt).
        duration[[0, -1]] *= 1.5
        rate = 2.0 * speed[[1, -2]] / duration[[0, -1]] ** 2
        acceleration[[0, -1], :, 0] = [[0.0, rate[0]], [-rate[1] * duration[-1], rate[1]]]
    times = np.concatenate([[0.0], np.cumsum(duration)])
    return Trajectory.from_acceleration(times, acceleration, [0.0], speed[:1])


def _eased_speed(
    rows: PathLimits,
    linear: tuple[np.ndarray, np.ndarray, np.ndarray],
    joints: int,
    speed: np.ndarray,
) -> np.ndarray | None:
    """Return the path speed for an acceleration that ramps from zero and back to zero at the ends.

    A ramp over a distance s to the speed v ends at 4 v^2 / (6 s), a constant acceleration is
    v^2 / (2 s): for the same peak the squared speed after the ramp is three quarters. The path in
    between is time-optimal for these outer speeds.
    """
    outer = np.sqrt(0.75) * speed[[1, -2]]
    inner = _path_speed(rows, linear, joints, slice(1, -1), (outer[0], outer[1]))
    return None if inner is None else np.concatenate([speed[:1], inner, speed[-1:]])


def _path_speed(
    rows: PathLimits,
    linear: tuple[np.ndarray, np.ndarray, np.ndarray],
    joints: int,
    part: slice = slice(None),
    outer: tuple[float, float] = (0.0, 0.0),
) -> np.ndarray | None:
    """Return toppra's path speed ds/dt on a part of the grid, `outer` at its ends; None if none."""
    with _silence_logging(), _plots_on_demand():
        from toppra.algorithm import TOPPRA
        from toppra.constraint import DiscretizationType, LinearConstraint
        from toppra.constraint.linear_constraint import canlinear_colloc_to_interpolate

        grid, ceiling = rows.grid[part], rows.squared_speed_max[part]

        class Rows(LinearConstraint):  # type: ignore[misc]
            """Constraint rows in toppra's form."""

            def __init__(self) -> None:
                super().__init__()
                self.dof = joints
                self.identical = True
                self.set_discretization_type(DiscretizationType.Interpolation)

            def compute_constraint_params(self, path: Any, gridpoints: Any) -> tuple[Any, ...]:
                count = linear[0].shape[1]
                bounds = np.column_stack([np.zeros(len(grid)), ceiling])
                given = (each[part] for each in linear)
                return canlinear_colloc_to_interpolate(  # type: ignore[no-any-return]
                    *given, np.eye(count), np.ones(count), None, bounds, grid, identical=True
                )

        whole = _PathInterval(joints, (grid[0], grid[-1]))
        solver = TOPPRA([Rows()], whole, gridpoints=grid, solver_wrapper="seidel")
        _, speed, _ = solver.compute_parameterization(*outer)
    if speed is None or not np.all(np.isfinite(speed)) or np.any(speed[:-1] + speed[1:] <= 0):
        return None
    return np.asarray(speed, dtype=float)


class _PlotModule(ModuleType):
    """Stands for matplotlib.pyplot until something is drawn."""

    def __getattr__(self, name: str) -> Any:
        return getattr(import_module(self.__name__), name)


@contextmanager
def _plots_on_demand() -> Iterator[None]:
    """Let toppra import matplotlib when it plots: loading it takes longer than many a solve."""
    if "matplotlib.pyplot" in sys.modules:
        yield
        return
    plots, package = _PlotModule("matplotlib.pyplot"), ModuleType("matplotlib")
    package.pyplot = plots  # type: ignore[attr-defined]
    stand_ins = {"matplotlib": package, plots.__name__: plots}
    replaced = {name: sys.modules[name] for name in stand_ins if name in sys.modules}
    sys.modules |= stand_ins
    try:
        yield
    finally:
        for name, stand_in in stand_ins.items():
            if sys.modules.get(name) is stand_in:
                del sys.modules[name]
        sys.modules |= replaced


class _PathInterval:
    """Path interface of toppra for a problem whose rows are given: dof and interval."""

    def __init__(self, joints: int, within: tuple[float, float]) -> None:
        self.dof, self.path_interval = joints, within


@contextmanager
def _silence_logging() -> Iterator[None]:
    """Suppress toppra's warnings and log lines; the caller reports failures."""
    logger = logging.getLogger("toppra")
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.setLevel(level)
