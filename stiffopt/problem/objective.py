"""What can be minimised: the statement of one term, and what each kind of objective must know.

A kind is one class in one file of `problem/objectives/`; schema, optimiser, certificate, report and
reference ask the registry, so that a new objective is a new file and nothing else.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
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
    """A value that the objective cannot beat.

    Parameters
    ----------
    objective : str
    value : float
        In the objective's SI unit; inf where it has no optimum.
    text : str
        A sentence with the value and its cause.
    degenerate : bool
        Whether the objective is pinned to it, so that the motion is left undetermined.
    """

    objective: str
    value: float
    text: str
    degenerate: bool


# Share of a typical value down to which one is lowered, however negligible it is.
_MIN_TARGET_SHARE = 1.0 / 3.0


class ObjectiveKind(ABC):
    """All that is known about the objectives of one name.

    Attributes
    ----------
    name : str
        In files and results.
    unit : str
        SI unit of the value.
    description : str
        One sentence, for the file reference.
    phrase : str
        As people say it, without the measure.
    prefixed : bool
        Whether its unit is read with a prefix, such as mm; not where it stands for an integral.
    maximised : bool
        Whether a larger value is better.
    measured : bool
        Whether it is a peak or a root mean square over time.
    ends_motion : bool
        Whether it has an optimum with a free duration; False: a slower motion is always better.
    smoothing : tuple of float
        Factors on the smoothing widths, stage by stage.
    deflection_part : str
        Part of the tool's deflection that it is about; "" for none.
    plans_links : bool
        Whether the links' motion is planned, with the motors ahead of it by the wind-up.
    of_arrival : bool
        Whether it is about what swings on after arrival, so that the certificate simulates it.
    comparable : bool
        Whether the optimiser's value is to agree with the certified one.
    of_drives : bool
        Whether it holds the drives' torque, and so their dry friction.
    shaped : bool
        Whether the motion is averaged over a swing of the arm's lowest mode.
    chosen_for_other_arms : bool
        Whether `terms` says what to prefer, of motions about as good, on arms not as modelled.
    negligible : float
        Value that need not be lowered, in `unit`; such a kind has one static variable, a bound on
        its value.
    comparatives : (str, str)
        Of a smaller and of a larger value.
    compared_as_ratio : bool
        Whether "3 times less" is said of a large change; else always a percentage.
    """

    name: str
    unit: str
    description: str
    phrase: str
    maximised = False
    prefixed = True
    measured = False
    ends_motion = False
    smoothing: tuple[float, ...] = UNSMOOTHED
    deflection_part = ""
    plans_links = False
    of_arrival = False
    comparable = True
    of_drives = False
    shaped = False
    chosen_for_robustness = False
    negligible = 0.0
    comparatives = ("less", "more")
    compared_as_ratio = True

    def target_value(self, typical: float) -> float:
        """Value down to which it is minimised, where a typical one is known."""
        return min(self.negligible, _MIN_TARGET_SHARE * typical)

    def check(self, objective: Objective, problem: TrajectoryProblem) -> None:
        """Raise `ProblemError` where the problem has nothing for this objective to change."""
        return None

    def bounds(
        self, objective: Objective, problem: TrajectoryProblem, motion: ResolvedMotion
    ) -> list[Bound]:
        """Values that no motion can beat, known before solving."""
        return []

    def static_variables(
        self, objective: Objective, problem: TrajectoryProblem, sides: np.ndarray
    ) -> tuple[StaticVariable, ...]:
        """Static variables in the order in which `terms` gets them.

        `sides` (n,) is the sign of the spring torque of joints that need not change it.
        """
        return ()

    @abstractmethod
    def terms(
        self,
        objective: Objective,
        problem: TrajectoryProblem,
        model: StageModel,
        statics: tuple[Quantity, ...],
        scale: float,
    ) -> ObjectiveTerms:
        """Pieces of the optimal-control problem; `scale` is a typical value in SI."""

    @abstractmethod
    def certified_value(self, objective: Objective, motion: Assessment) -> float:
        """The value [SI] on the fine grid of an assessed motion."""

    def joint_integrals(self, robot: Robot, motion: Assessment) -> np.ndarray | None:
        """Integrals over an assessed motion, one a joint (n,), where it is a sum of such."""
        return None


OBJECTIVES: Registry[ObjectiveKind] = Registry("stiffopt.problem.objectives")


@dataclass(frozen=True, kw_only=True)
class Objective:
    """One term of the objective; `name` is that of a kind in `problem/objectives/`."""

    name: str = "tool_deviation"
    measure: Annotated[
        Literal["peak", "rms"], Doc("Largest value over time, or root mean square; of deflections.")
    ] = "peak"
    weight: Annotated[Ratio, POSITIVE, Doc("Weight in the sum of all terms.")] = 1.0
    joints: Annotated[
        tuple[Annotated[int, Bounds(least=1)], ...], Doc("Joints that count; default all.")
    ] = ()
    joint_weights: Annotated[
        Mapping[int, Annotated[Ratio, POSITIVE]],
        Doc("For joint_stiffness, by joint number: stiffness over weight is compared; default 1."),
    ] = field(default_factory=dict)
    accept_bound: Annotated[
        bool,
        Doc("Solve even where the objective cannot get past a value that no motion changes."),
    ] = False

    def __post_init__(self) -> None:
        if self.name not in OBJECTIVES:
            raise ProblemError(f"Unknown objective {self.name!r}. {nearest(self.name, OBJECTIVES)}")
        check_fields(self, self.name, ProblemError)

    @property
    def kind(self) -> ObjectiveKind:
        """What is known about objectives of this name."""
        return OBJECTIVES[self.name]

    @property
    def maximised(self) -> bool:
        """Whether a larger value is better."""
        return self.kind.maximised

    @property
    def unit(self) -> str:
        """SI unit of the value."""
        return self.kind.unit

    @property
    def shown_measure(self) -> str:
        """The measure where the kind has one, else ""."""
        return self.measure if self.kind.measured else ""

    def numbers(self, joints: int) -> tuple[int, ...]:
        """Numbers (1-based) of the joints that count, of an arm with so many."""
        return tuple(self.joints) or tuple(range(1, joints + 1))

    def weight_of(self, joint: int) -> float:
        """Weight of a joint (1-based) in joint_stiffness."""
        return float(self.joint_weights.get(joint, 1.0))
