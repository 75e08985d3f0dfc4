"""One solve in progress: its clock, its record, what it found so far, what displays are told."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from stiffopt.certificate.assess import drive_violations
from stiffopt.certificate.objective_value import is_maximised
from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.modes import Mode, modes
from stiffopt.elastic.smooth_motion import smooth_motion
from stiffopt.errors import NotSimulatedError
from stiffopt.problem.formulation import Scales, law_smoothing
from stiffopt.problem.motor_model import MotorLaw, round_lags
from stiffopt.problem.trajectory import ResolvedMotion, TrajectoryProblem
from stiffopt.result.solution import Baseline
from stiffopt.solver.avoidance import Avoidance
from stiffopt.solver.corners import CORNERS_TAKE, narrowest
from stiffopt.solver.ipopt import RawSolution
from stiffopt.solver.plan import SolveStage

if TYPE_CHECKING:
    from stiffopt.solver.compensation import CommandOnArms

# Of a solve once its time is over [s]: it ends with what it has.
LEAST_TIME = 0.1
# Of the time limit: if links that may swing on end in no motion by then, they are brought to rest.
_OF_FREE_END = 0.4
# Of the smooth quintic motion: pieces and instants.
_PIECES, _INSTANTS = 30, 3001


@dataclass(frozen=True)
class SolveProgress:
    """One iteration, for displays.

    Attributes
    ----------
    stage : str
        Which of how many, intervals and smoothing.
    iteration : int
    objective : float
        In SI, of the smoothed model at the nodes.
    violation : float
        Worst row, relative to its scale.
    row : str
        Its name; empty when nothing is violated.
    elapsed : float
        Since the solve began [s].
    """

    stage: str
    iteration: int
    objective: float
    violation: float
    row: str
    elapsed: float


ProgressCallback = Callable[[SolveProgress], object]


@dataclass
class SolveRun:
    """One solve in progress: its clock, its record and what it found so far.

    `quintic` is the baseline by which corners of the motors' law are made wide enough;
    `at_rest` says that nothing may swing on after arrival, whatever limits allow; `avoidance`, once
    it is there, keeps the motion clear of collisions; `unavoided` says what was tried in vain,
    `detour` is the motion along a path around; `strict` is the best baseline that keeps every
    limit, once it is known; `command` is its command on uncertain arms, where
    that has been asked for.
    """

    problem: TrajectoryProblem
    motion: ResolvedMotion
    scales: Scales
    progress: ProgressCallback | None
    quintic: Baseline | None = None
    at_rest: bool = False
    avoidance: Avoidance | None = None
    unavoided: str = ""
    detour: Baseline | None = None
    strict: Baseline | None = None
    command: CommandOnArms | None = None
    begin: float = field(default_factory=time.perf_counter)
    build_s: float = 0.0
    solve_s: float = 0.0
    iterations: int = 0
    starts_made: int = 1
    homotopy: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @property
    def elapsed(self) -> float:
        """Seconds since the solve began."""
        return time.perf_counter() - self.begin

    @property
    def remaining(self) -> float:
        """Seconds left of the time limit, or of the share of it in which links may swing on."""
        share = _OF_FREE_END if self.end_modes else 1.0
        return max(share * self.problem.method.time_limit - self.elapsed, LEAST_TIME)

    @cached_property
    def end_modes(self) -> tuple[Mode, ...]:
        """Modes in which the links may swing on after arrival; none where they may not.

        Where corners of the motors' law are wide, what they leave is more than limits allow, and
        only links that a plan brings to rest can be calmed.
        """
        problem = self.problem
        if self.at_rest or not problem.plans_links or problem.arrives_at_rest:
            return ()
        if self.corners > 1.0:
            return ()
        return modes(self.arm, self.motion.end)

    @cached_property
    def arm(self) -> ElasticArm:
        """The problem's elastic arm."""
        return ElasticArm(self.problem.robot, self.motion.start, self.problem.process_force)

    @cached_property
    def motors(self) -> MotorLaw:
        """Motors that lead the problem's links."""
        return MotorLaw(self.problem.robot, self.problem.process_force)

    @cached_property
    def corners(self) -> float:
        """Factor on the widths of the motors' law with which a solve begins.

        As wide as the quintic motion needs, smoothed. Through narrower corners no motion in that
        time gets within the limits, and rows do not see it: a corner is passed between nodes.
        """
        problem = self.problem
        motion = None if self.quintic is None else self.quintic.trajectory
        if not problem.plans_links or motion is None:
            return 1.0
        smooth = smooth_motion(motion, motion.duration / _PIECES)
        times = np.linspace(0.0, motion.duration, _INSTANTS)

        def beyond(width: float) -> float:
            found = drive_violations(problem, self.motors.motion(smooth, width), times)
            return max((v.value for v in found if v.limit == "jerk"), default=-1.0)

        least = law_smoothing(problem)
        return narrowest(beyond, least, CORNERS_TAKE) / least

    def hold_at_rest(self) -> None:
        """Let nothing swing on after arrival from now on."""
        self.at_rest = True
        for known in ("end_modes", "lag"):
            self.__dict__.pop(known, None)

    @cached_property
    def lag(self) -> np.ndarray | None:
        """Of the joints' wind-up behind their torque, by damping (n,) [s].

        None where the motors do not come to rest smoothly, or the links cannot swing.
        """
        problem = self.problem
        smooth = problem.boundary_acceleration == "zero" and not np.any(problem.boundary_velocity)
        if not (problem.plans_links and smooth) or self.end_modes:
            return None
        with suppress(NotSimulatedError):
            return round_lags(self.arm.lag(self.motion.end))
        return None

    def in_si(self, objective: float) -> float:
        """The objective of an NLP in the unit that people see."""
        first = self.problem.objectives[0]
        sign = -1.0 if is_maximised(self.problem) else 1.0
        return sign * objective * first.weight * self.scales.of(first.name)

    def record(self, stage: SolveStage, raw: RawSolution) -> None:
        """Add one NLP solve to the record."""
        self.solve_s += raw.solve_s
        self.iterations += raw.iterations
        self.homotopy.append(
            {
                "intervals": stage.intervals,
                "smoothing": stage.smoothing.stiffness,
                "iterations": raw.iterations,
                "status": raw.status,
                "solve_s": round(raw.solve_s, 4),
            }
        )
