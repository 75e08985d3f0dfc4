"""Limits of a motion: their values, and the interface of each kind of limit.

A kind is a class in a file of `problem/limits/`. Schema, optimiser, certificate, report and
file reference use the registry, so that a new limit needs only a new file.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from stiffopt.errors import ProblemError, nearest
from stiffopt.problem.registry import Registry
from stiffopt.problem.stage_terms import UNSMOOTHED, PathRows
from stiffopt.result.assessment import Violation

if TYPE_CHECKING:
    from stiffopt.problem.arrival_modes import ArrivalModes
    from stiffopt.problem.joint_lists import JointLists
    from stiffopt.problem.stage_model import StageModel
    from stiffopt.problem.trajectory import ResolvedMotion, TrajectoryProblem
    from stiffopt.result.assessment import Assessment, DriveHistory
    from stiffopt.result.simulation import SimulatedMotion
    from stiffopt.robot.robot import Robot
    from stiffopt.validation import Section


@dataclass(frozen=True, kw_only=True)
class LimitKey:
    """One key of [limits] and the attribute of `Limits` that holds its value."""

    key: str  # key in files
    form: Any  # type of the entry as a pydantic annotation; includes None for an omitted key
    description: str  # one sentence, with the unit of a bare number
    attribute: str = ""  # attribute of `Limits`; "" for the same name as the key
    value: Callable[[Any], Any]  # default value, from the robot
    of_robot: bool = False  # True if `value` needs the robot
    scaled: bool = False  # True if limits.scale has a factor for the key

    @property
    def name(self) -> str:
        """Attribute of `Limits`."""
        return self.attribute or self.key


class LimitKind(ABC):
    """Interface of one kind of limit."""

    name: str  # name in certificates, back-offs and results
    keys: tuple[LimitKey, ...]
    # Factors on the smoothing widths of the stiffness model, stage by stage, while active.
    smoothing: tuple[float, ...] = UNSMOOTHED
    # Order of the derivative of the joint positions that is bounded; None for other quantities.
    order: int | None = None
    # True for limits on residual vibration: the links' motion is then planned, and simulated for
    # the certificate.
    of_arrival = False

    @abstractmethod
    def active(self, limits: Limits) -> bool:
        """Return True if `limits` include this kind."""

    def read(self, section: Section, joints: JointLists) -> dict[str, Any]:
        """Read attributes of `Limits` from the section [limits] of a file, with their defaults."""
        given = {key: getattr(section, key.key) for key in self.keys}
        return {
            key.name: key.value(joints.robot) if value is None else value
            for key, value in given.items()
        }

    def rows(self, problem: TrajectoryProblem, model: StageModel, margin: float) -> list[PathRows]:
        """Constraint rows, backed off by the share `margin`; called only while active."""
        return []

    @abstractmethod
    def violations(self, limits: Limits, motion: Assessment) -> list[Violation]:
        """Largest violations on the fine grid, relative to the limit; called only while active."""

    def bounds(self, limits: Limits, margin: float) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bound (n,) of the derivative `order`, backed off by `margin`."""
        raise NotImplementedError(f"{self.name} bounds no derivative of the joint positions")

    def arrival_rows(self, limits: Limits, arrival: ArrivalModes) -> list[PathRows]:
        """Rows on residual vibration; called only while active and `of_arrival`."""
        return []

    def overshoot(self, limits: Limits, simulated: SimulatedMotion) -> float:
        """Relative excess of the simulated residual vibration over the bound of `arrival_rows`."""
        return 0.0

    def check(self, problem: TrajectoryProblem, motion: ResolvedMotion) -> None:
        """Raise `ProblemError` where no motion can meet the limit; called only while active."""
        return None

    def statements(self, limits: Limits, robot: Robot) -> list[tuple[str, float, str]]:
        """Phrase, value [SI] and unit of limits outside a report's table of joint limits."""
        return []


class DriveLimit(LimitKind):
    """Limit on quantities of the drives alone."""

    @abstractmethod
    def violations(self, limits: Limits, motion: DriveHistory) -> list[Violation]:
        """Largest violations from a drive history."""


LIMITS: Registry[LimitKind] = Registry("stiffopt.problem.limits")


@dataclass(frozen=True, init=False)
class Limits:
    """Limits of a motion as attributes, such as `limits.torque`; names are those of `LimitKey`.

    Parameters
    ----------
    **values
        position_lower, position_upper, velocity, acceleration, jerk and torque, arrays (n,), are
        required (see `Limits.of`), inf for no limit; the others are optional.

    Examples
    --------
    >>> import dataclasses
    >>> from stiffopt import Limits, load_robot
    >>> own = Limits.of(load_robot("er3a_c60"))
    >>> float(dataclasses.replace(own, tool_speed=1.5).tool_speed)
    1.5
    """

    values: Mapping[str, Any]

    def __init__(self, values: Mapping[str, Any] | None = None, **given: Any) -> None:
        found = {**(values or {}), **given}
        known = {key.name: key for kind in LIMITS.values() for key in kind.keys}
        for name in found:
            if name not in known:
                raise ProblemError(f"Unknown limit {name!r}. {nearest(name, known)}")
        for name, key in known.items():
            if name not in found:
                if key.of_robot:
                    raise ProblemError(
                        f"Limits lack {name!r}, which a robot always has; start from "
                        "Limits.of(robot)."
                    )
                found[name] = key.value(None)
        object.__setattr__(self, "values", found)

    def __getattr__(self, name: str) -> Any:
        try:
            return self.__dict__["values"][name]
        except KeyError:
            raise AttributeError(f"no limit {name!r}") from None

    @classmethod
    def of(cls, robot: Robot) -> Limits:
        """Limits of a robot."""
        keys = [key for kind in LIMITS.values() for key in kind.keys]
        return cls({key.name: key.value(robot) for key in keys})

    @cached_property
    def kinds(self) -> tuple[LimitKind, ...]:
        """Active kinds of limit."""
        return tuple(kind for kind in LIMITS.values() if kind.active(self))


def derivative_bounds(
    limits: Limits, order: int, margins: Mapping[str, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Intersect the bounds (n,) of all limits on one derivative of the joint positions."""
    pairs = [
        kind.bounds(limits, margins.get(kind.name, 0.0))
        for kind in LIMITS.values()
        if kind.order == order
    ]
    return (
        np.max([lower for lower, _ in pairs], axis=0),
        np.min([upper for _, upper in pairs], axis=0),
    )
