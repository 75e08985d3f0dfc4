"""Objectives of a motion: one term of a problem, and the interface of each kind.

A kind is one class in one file of `problem/objectives/`. Schema, optimiser, certificate, report and
file reference use the registry, so that a new objective needs only a new file.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np

from stiffopt.declaration import POSITIVE, Bounds, Doc, Ratio, check_fields
from stiffopt.errors import ProblemError, nearest
from stiffopt.problem.registry import Registry
from stiffopt.problem.stage_terms import UNSMOOTHED, ObjectiveTerms, StaticVariable

if TYPE_CHECKING:
    from stiffopt.problem.stage_model import StageModel
    from stiffopt.problem.trajectory import ResolvedMotion, TrajectoryProblem
    from stiffopt.result.assessment import Assessment
    from stiffopt.robot.robot import Robot
    from stiffopt.symbolic import Quantity

ACCEPT_ADVICE = ", or set minimise.accept_bound = true."


@dataclass(frozen=True)
class Bound:
    """Bound of an objective over all motions."""

    objective: str
    value: float  # bound in the objective's SI unit; inf without an optimum
    text: str  # sentence with the value and its cause
    degenerate: bool  # True if every motion attains the bound, so that the motion is undetermined


# Share of a typical value down to which an objective is minimised even where it is negligible.
_MIN_TARGET_SHARE = 1.0 / 3.0


class ObjectiveKind(ABC):
    """Interface of one kind of objective."""

    name: str  # name in files and results
    unit: str  # SI unit of the value
    description: str  # one sentence, for the file reference
    phrase: str  # name in sentences, without the measure
    maximised = False  # True if a larger value is better
    prefixed = True  # True if reports use prefixes of the unit, such as mm; False for integrals
    measured = False  # True for a peak or root mean square over time
    # True if it has an optimum for a free duration; False: a slower motion is always better.
    ends_motion = False
    smoothing: tuple[float, ...] = UNSMOOTHED  # factors on the smoothing widths, stage by stage
    deflection_part = ""  # part of the tool's deflection that is minimised; "" for none
    # True if the links' motion is planned and the motors lead it by the wind-up.
    plans_links = False
    # True if it depends on residual vibration, which the certificate then simulates.
    of_arrival = False
    comparable = True  # True if the optimiser's value has to agree with the certified one
    # True if it depends on the error of uncertain arms, which the certificate then propagates.
    of_uncertain_arms = False
    of_drives = False  # True if it depends on the drive torque, and so on dry friction
    # True if its integrand has a kink at zero, whose smoothing width the stages narrow.
    has_kink = False
    shaped = False  # True if the motion is averaged over a period of the lowest elastic mode
    # True if `terms` gives a robust value that selects among motions of about equal value.
    chosen_for_robustness = False
    # Value below which there is no benefit, in `unit`; such a kind has one static variable, an
    # upper bound of its value.
    negligible = 0.0
    comparatives = ("less", "more")  # words for a smaller and a larger value
    # True if large changes are stated as "3 times less"; else as percentages.
    compared_as_ratio = True

    def target_value(self, typical: float) -> float:
        """Value down to which it is minimised, from a typical one."""
        return min(self.negligible, _MIN_TARGET_SHARE * typical)

    def check(self, objective: Objective, problem: TrajectoryProblem) -> None:
        """Raise `ProblemError` where the problem gives the objective no freedom."""
        return None

    def bounds(
        self, objective: Objective, problem: TrajectoryProblem, motion: ResolvedMotion
    ) -> list[Bound]:
        """Bounds over all motions, known before solving."""
        return []

    def static_variables(
        self, objective: Objective, problem: TrajectoryProblem, sides: np.ndarray
    ) -> tuple[StaticVariable, ...]:
        """Static variables, in the order of `TermInputs.statics`.

        `sides` (n,) is the sign of the spring torque of joints that can keep it.
        """
        return ()

    @abstractmethod
    def terms(self, given: TermInputs) -> ObjectiveTerms:
        """Contributions to the optimal-control problem."""

    @abstractmethod
    def certified_value(self, objective: Objective, motion: Assessment) -> float:
        """Value [SI] on the fine grid of an assessed motion."""

    def scales(self, objective: Objective, motions: Sequence[Assessment]) -> dict[str, float]:
        """Return typical values by name, of motions of which the first is the usual one."""
        return {self.name: self.certified_value(objective, motions[0])}

    def joint_integrals(self, robot: Robot, motion: Assessment) -> np.ndarray | None:
        """Integral of each joint (n,) over an assessed motion; None for other kinds."""
        return None


@dataclass(frozen=True)
class Scales:
    """Typical objective values that scale the NLP without changing its solution."""

    # A typical value of each objective, in its SI unit.
    values: Mapping[str, float] = field(default_factory=dict)

    def of(self, name: str) -> float:
        """Typical value of an objective; 1 where unknown."""
        value = self.values.get(name, 1.0)
        return value if np.isfinite(value) and value > 0 else 1.0


@dataclass(frozen=True)
class TermInputs:
    """Problem, symbols and scale from which an objective forms its terms."""

    objective: Objective
    problem: TrajectoryProblem
    model: StageModel
    statics: tuple[Quantity, ...]  # those of `ObjectiveKind.static_variables`
    scales: Scales  # typical values

    @property
    def scale(self) -> float:
        """Typical value of the objective [SI]."""
        return self.scales.of(self.objective.name)


OBJECTIVES: Registry[ObjectiveKind] = Registry("stiffopt.problem.objectives")


@dataclass(frozen=True, kw_only=True)
class Objective:
    """One term of the objective; `name` is a kind of `problem/objectives/`."""

    name: str = "tool_error"
    measure: Annotated[
        Literal["peak", "rms"], Doc("Largest value over time, or root mean square; of deflections.")
    ] = "peak"
    weight: Annotated[Ratio, POSITIVE, Doc("Weight in the sum of all terms.")] = 1.0
    joints: Annotated[
        tuple[Annotated[int, Bounds(least=1)], ...], Doc("Joints of the term; default all.")
    ] = ()
    joint_weights: Annotated[
        Mapping[int, Annotated[Ratio, POSITIVE]],
        Doc("For joint_stiffness, by joint number: stiffness over weight is compared; default 1."),
    ] = field(default_factory=dict)
    accept_bound: Annotated[
        bool,
        Doc("Solve even where every motion attains the objective's bound."),
    ] = False

    def __post_init__(self) -> None:
        if self.name not in OBJECTIVES:
            raise ProblemError(f"Unknown objective {self.name!r}. {nearest(self.name, OBJECTIVES)}")
        check_fields(self, self.name, ProblemError)

    @property
    def kind(self) -> ObjectiveKind:
        """Kind of the objective."""
        return OBJECTIVES[self.name]

    @property
    def maximised(self) -> bool:
        """True if a larger value is better."""
        return self.kind.maximised

    @property
    def unit(self) -> str:
        """SI unit of the value."""
        return self.kind.unit

    @property
    def shown_measure(self) -> str:
        """Measure of kinds that have one, else ""."""
        return self.measure if self.kind.measured else ""

    def numbers(self, joints: int) -> tuple[int, ...]:
        """Joint numbers (1-based) of the term, for an arm of `joints` joints."""
        return tuple(self.joints) or tuple(range(1, joints + 1))

    def weight_of(self, joint: int) -> float:
        """Weight of a joint (1-based) in joint_stiffness."""
        return float(self.joint_weights.get(joint, 1.0))
