"""Error budget of a motion: bounds at every instant, and the share of each source."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from stiffopt.budget.elasticity import elastic_errors, hysteresis_sources, servo_errors
from stiffopt.budget.sources import (
    GROUPS,
    ErrorSource,
    KnownError,
    States,
    ToolJacobians,
    geometric_sources,
)
from stiffopt.elastic.uncertainty import Uncertainty
from stiffopt.robot.robot import Robot
from stiffopt.robot.tolerances import Tolerances

# Confidence of every bound.
CONFIDENCE = 0.95


def semi_axes(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return semi-axes of the ellipsoids that hold 95 % of the errors about their mean.

    `covariance` (K, 3, 3). `lengths` (K, 3): the longest first. `directions` (K, 3, 3): as columns.
    """
    squares, axes = np.linalg.eigh(covariance)
    lengths = np.sqrt(float(_chi_squared_quantile(3.0)) * np.maximum(squares, 0.0))
    return lengths[:, ::-1], axes[:, :, ::-1]


def magnitude_bound(mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the 95 % quantile (K,) of the length of errors of this mean and covariance.

    `mean` (K, 3). `covariance` (K, 3, 3). The squared length is a quadratic form of normal
    variables. A shifted chi-squared variable takes its first three cumulants (Pearson 1959, Imhof
    1961); the 95 % quantile of the length then has an error below 1 %.
    """
    squares, axes = np.linalg.eigh(covariance)
    squares = np.maximum(squares, 0.0)
    along = np.square(np.einsum("kij,ki->kj", axes, mean))
    first = np.sum(squares + along, axis=1)
    second = 2.0 * np.sum(squares**2 + 2.0 * squares * along, axis=1)
    third = 8.0 * np.sum(squares**3 + 3.0 * squares**2 * along, axis=1)
    # Without spread the length is that of the mean.
    spread = second > 0.0
    safe_second, safe_third = np.where(spread, second, 1.0), np.where(spread, third, 1.0)
    freedom = 8.0 * safe_second**3 / safe_third**2
    quantile = (_chi_squared_quantile(freedom) - freedom) / np.sqrt(2.0 * freedom)
    square = first + np.where(spread, np.sqrt(safe_second) * quantile, 0.0)
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def _chi_squared_quantile(freedom: float | np.ndarray) -> np.ndarray:
    # Loading scipy.stats takes longer than many a solve.
    return np.asarray(2.0 * scipy.special.gammaincinv(0.5 * freedom, CONFIDENCE))


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorModel:
    """An arm with everything about it that is not exactly known."""

    robot: Robot  # with payload and tool
    tolerances: Tolerances
    uncertainty: Uncertainty
    process_force: np.ndarray  # (3,) on the tool, base axes [N]
    compensated: bool = False  # the motors lead by the wind-up of their joints

    def errors(self, states: States) -> tuple[list[ErrorSource], list[KnownError]]:
        """Return the sources of error and the mean errors; the same sources in any states."""
        tool = ToolJacobians(self.robot, states.position)
        found = [
            *geometric_sources(tool, self.tolerances),
            *elastic_errors(
                tool,
                states,
                self.uncertainty,
                self.process_force,
                compensated=self.compensated,
            ),
            *hysteresis_sources(tool),
            *servo_errors(tool, states),
        ]
        sources = [each for each in found if isinstance(each, ErrorSource)]
        return sources, [each for each in found if isinstance(each, KnownError)]


@dataclass(frozen=True, kw_only=True, eq=False)
class ErrorBudget:
    """Error of the tool in K states."""

    states: States
    place: np.ndarray  # (K, 3) of the tool [m]
    sources: tuple[ErrorSource, ...]
    known: tuple[KnownError, ...]

    @property
    def mean(self) -> np.ndarray:
        """Mean error (K, 6)."""
        return _sum_effects(self.known, len(self.place))

    @property
    def covariance(self) -> np.ndarray:
        """Covariance (K, 6, 6) of displacement [m] and rotation [rad]."""
        effects = np.array([source.effect for source in self.sources])
        return np.asarray(np.einsum("ski,skj->kij", effects, effects))

    def bound(self, rows: slice) -> np.ndarray:
        """Return the 95 % bound (K,) of the displacement or of the rotation.

        `rows`: `POSITION` or `ORIENTATION`.
        """
        return magnitude_bound(self.mean[:, rows], self.covariance[:, rows, rows])

    def shares(self, rows: slice) -> dict[str, np.ndarray]:
        """Return the share (K,) of each group in the mean square of the error; they sum to 1.

        A mean error against the sum of all means has a negative share.
        """
        mean = self.mean[:, rows]
        total = {
            group: np.sum(
                _sum_effects([k for k in self.known if k.group == group], len(mean))[:, rows]
                * mean,
                axis=1,
            )
            + sum(
                (
                    np.sum(source.effect[:, rows] ** 2, axis=1)
                    for source in self.sources
                    if source.group == group
                ),
                np.zeros(len(mean)),
            )
            for group in GROUPS
        }
        whole = sum(total.values(), np.zeros(len(mean)))
        safe = np.where(whole > 0.0, whole, 1.0)
        return {group: part / safe for group, part in total.items() if np.any(part != 0.0)}


POSITION, ORIENTATION = slice(0, 3), slice(3, 6)


def error_budget(model: ErrorModel, states: States) -> ErrorBudget:
    """Return the error budget of an arm along a motion, or in poses at rest."""
    sources, known = model.errors(states)
    if model.tolerances.reference == "start":
        sources = [
            ErrorSource(name=s.name, group=s.group, effect=s.effect - s.effect[:1]) for s in sources
        ]
        known = [KnownError(group=k.group, effect=k.effect - k.effect[:1]) for k in known]
    return ErrorBudget(
        states=states,
        place=ToolJacobians(model.robot, states.position).place,
        sources=tuple(sources),
        known=tuple(known),
    )


def _sum_effects(errors: Sequence[KnownError], count: int) -> np.ndarray:
    return sum((each.effect for each in errors), np.zeros((count, 6)))


def list_assumptions(model: ErrorModel, *, solved: bool) -> tuple[str, ...]:
    """Return the assumptions of a budget; `solved`: of a solved motion."""
    found = [
        "Errors are small: their effects on the tool are linear and add up.",
        "Sources are independent; uncertain parameters lie evenly between their bounds, geometric "
        "tolerances are 95 % bounds: those of [tolerances], with typical defaults.",
        "Output bearings and links yield where the robot file says so, and are rigid elsewhere."
        if model.robot.tilts
        else "Bearings and links are rigid: joints yield about their axes only.",
        "Springs carry the torque of the motion without vibration: `stiffopt simulate` adds it.",
        *model.uncertainty.statements(model.robot.payload is not None),
    ]
    if not solved:
        found.append("The motion is the quintic one at the least duration that the problem allows.")
    if model.compensated:
        found.append("The command leads by the wind-up: only its uncertain part is an error.")
    elif model.robot.yields:
        found.append("Motors follow the plan: the wind-up is an error, known as it is.")
    if model.robot.hysteresis is None or not np.any(model.robot.hysteresis):
        found.append("No joint states its hysteresis: loops of typical width are assumed.")
    return tuple(found)
