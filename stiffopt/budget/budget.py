"""Error budget of a motion: bounds at every instant, and the share of each source."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.budget.elasticity import elastic_errors, hysteresis_sources, servo_errors
from stiffopt.budget.ellipsoids import magnitude_bound
from stiffopt.budget.geometry import geometric_sources
from stiffopt.budget.sources import GROUPS, ErrorSource, KnownError, States, ToolJacobians
from stiffopt.elastic.uncertainty import Uncertainty
from stiffopt.robot.robot import Robot
from stiffopt.robot.tolerances import Tolerances


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
