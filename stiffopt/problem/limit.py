"""What limits a motion: the values of all limits, and what each kind of limit must know.

A kind is one class in one file of `problem/limits/`; schema, optimiser, certificate, report and
reference ask the registry, so that a new limit is a new file and nothing else.
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
    """One key of [limits] and the attribute of `Limits` that holds its value.

    Parameters
    ----------
    key : str
        In files.
    form : type
        What may stand there, as an annotation of pydantic; None where it is left out.
    description : str
        One sentence, with the unit of a bare number.
    attribute : str
        Of `Limits`; "" where it is the key.
    value : callable
        Value where it is left out, from the robot.
    of_robot : bool
        Whether `value` needs the robot.
    scaled : bool
        Whether limits.scale has a factor for it.
    """

    key: str
    form: Any
    description: str
    attribute: str = ""
    value: Callable[[Any], Any]
    of_robot: bool = False
    scaled: bool = False

    @property
    def name(self) -> str:
        """Attribute of `Limits`."""
        return self.attribute or self.key


class LimitKind(ABC):
    """All that is known about one kind of limit.

    Attributes
    ----------
    name : str
        In certificates, margins and results.
    keys : tuple of LimitKey
    smoothing : tuple of float
        Factors on the smoothing widths of the stiffness model, stage by stage, where it is active.
    order : int or None
        Of the derivative of the joint positions that it bounds; None where it bounds another
        quantity.
    of_arrival : bool
        Whether it is about what swings on after arrival: the links' motion is then planned, and
        simulated where it is judged.
    """

    name: str
    keys: tuple[LimitKey, ...]
    smoothing: tuple[float, ...] = UNSMOOTHED
    order: int | None = None
    of_arrival = False

    @abstractmethod
    def active(self, limits: Limits) -> bool:
        """Whether these limits hold one of this kind."""

    @abstractmethod
    def read(self, section: Section, joints: JointLists) -> dict[str, Any]:
        """Attributes of `Limits` from the section of a file; [limits] is `section`."""

    @abstractmethod
    def rows(self, problem: TrajectoryProblem, model: StageModel, margin: float) -> list[PathRows]:
        """Rows of the optimiser, tightened by the share `margin`; only asked where active."""

    @abstractmethod
    def violations(self, limits: Limits, motion: Assessment) -> list[Violation]:
        """Worst excess on the fine grid, relative to the limit; only asked where active."""

    def bounds(self, limits: Limits, margin: float) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bound (n,) of the derivative of that `order`, tightened by `margin`."""
        raise NotImplementedError(f"{self.name} bounds no derivative of the joint positions")

    def arrival_rows(self, limits: Limits, arrival: ArrivalModes) -> list[PathRows]:
        """Rows on what swings on after arrival; only asked where active and `of_arrival`."""
        return []

    def overshoot(self, limits: Limits, swing: SimulatedMotion) -> float:
        """Share by which the tool swings further than `arrival_rows` allow."""
        return 0.0

    def check(self, problem: TrajectoryProblem, motion: ResolvedMotion) -> None:
        """Raise `ProblemError` where no motion can meet it; only asked where active."""
        return None

    def statements(self, limits: Limits, robot: Robot) -> list[tuple[str, float, str]]:
        """Phrase, value [SI] and unit of what is not in a report's table of joint limits."""
        return []


class DriveLimit(LimitKind):
    """A limit on what the drives do, whatever that does to the tool."""

    @abstractmethod
    def violations(self, limits: Limits, motion: DriveHistory) -> list[Violation]:
        """As of `LimitKind`, of the drives alone."""


LIMITS: Registry[LimitKind] = Registry("stiffopt.problem.limits")


@dataclass(frozen=True, init=False)
class Limits:
    """Limits of the motion by name: `limits.torque`; the names are those of all `LimitKey`.

    Parameters
    ----------
    **values
        position_lower, position_upper, velocity, acceleration, jerk and torque, arrays (n,), are
        required (see `Limits.of`), inf where there is none; the others are absent if left out.

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
        """The robot's own limits."""
        keys = [key for kind in LIMITS.values() for key in kind.keys]
        return cls({key.name: key.value(robot) for key in keys})

    @cached_property
    def kinds(self) -> tuple[LimitKind, ...]:
        """The kinds of limit that are active."""
        return tuple(kind for kind in LIMITS.values() if kind.active(self))


def derivative_bounds(
    limits: Limits, order: int, margins: Mapping[str, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bound (n,) of a derivative of the joint positions, of all limits on it."""
    pairs = [
        kind.bounds(limits, margins.get(kind.name, 0.0))
        for kind in LIMITS.values()
        if kind.order == order
    ]
    return (
        np.max([lower for lower, _ in pairs], axis=0),
        np.min([upper for _, upper in pairs], axis=0),
    )
