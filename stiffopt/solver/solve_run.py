"""State of a solve in progress: clock, record, intermediate results."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from stiffopt.certificate.assess import drive_violations
from stiffopt.certificate.objective_value import is_maximised
from stiffopt.command.smoothing_width import TOLERABLE_KINK_EXCESS, narrowest_sufficient_width
from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.modes import Mode, modes
from stiffopt.elastic.smooth_motion import smooth_motion
from stiffopt.errors import NotSimulatedError
from stiffopt.problem.formulation import formulate, law_smoothing
from stiffopt.problem.motor_model import MotorLaw, round_lags
from stiffopt.problem.objective import Scales
from stiffopt.problem.trajectory import ResolvedMotion, TrajectoryProblem
from stiffopt.result.solution import Baseline
from stiffopt.result.status import ProgressCallback, SolveProgress
from stiffopt.solver.clearance_rows import ClearanceRows
from stiffopt.solver.ipopt import RawSolution
from stiffopt.solver.stage_plan import SolveStage
from stiffopt.transcription.ocp import OptimalControlProblem

if TYPE_CHECKING:
    from stiffopt.command.command_search import CommandOnArms
    from stiffopt.command.simulation import PlannedMotion
    from stiffopt.result.solution import Solution
    from stiffopt.solver.programme import Outcome

# Time limit of an NLP solve once the solve's own time is over [s].
MIN_SOLVE_TIME = 0.1
# Share of the iterations for a plan with residual vibration; then one that ends at rest is solved.
_FREE_ARRIVAL_ITERATION_SHARE = 0.4
# Smoothed quintic motion from which the initial smoothing width follows.
_QUINTIC_SPLINE_PIECES, _QUINTIC_SAMPLES = 30, 3001


@dataclass
class SolveRun:
    """State of one solve in progress.

    `quintic` is the baseline from which the smoothing width of the motor law follows; `at_rest`
    forbids residual vibration, whatever the limits allow; `avoidance` are the clearance rows, once
    needed; `avoidance_failure` says why collisions could not be avoided; `detour` is the motion
    along the first collision-free path; `strict` is the best baseline that keeps every limit, once
    known; `command` is its command on uncertain arms, where requested; `step` is what the solver
    works at, and `left_out` the steps that the time limit ended. The answer to Ctrl-C is
    `solution`, once there is one, else `best`, the best outcome so far, else that of `unfinished`,
    the last stage so far. A similar problem starts from `optimum`.
    """

    problem: TrajectoryProblem
    motion: ResolvedMotion
    scales: Scales
    progress: ProgressCallback | None
    quintic: Baseline | None = None
    at_rest: bool = False
    avoidance: ClearanceRows | None = None
    avoidance_failure: str = ""
    detour: Baseline | None = None
    strict: Baseline | None = None
    command: CommandOnArms | None = None
    # Duration for which the rivals were searched [s], those, and their commands.
    rivals: tuple[float, list[PlannedMotion], list[CommandOnArms]] | None = None
    begin: float = field(default_factory=time.perf_counter)
    build_s: float = 0.0
    solve_s: float = 0.0
    iterations: int = 0
    starts_made: int = 1
    solution: Solution | None = None
    best: Outcome | None = None
    unfinished: Callable[[], Outcome] | None = None
    optimum: Outcome | None = None
    homotopy: list[dict[str, Any]] = field(default_factory=list)
    exchanges: list[dict[str, Any]] = field(default_factory=list)
    step: str = "the first optimum"
    left_out: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    interrupted: bool = False  # by Ctrl-C, with a motion to keep

    def tell(self, stage: str) -> None:
        """Report a stage without iterations."""
        if self.progress is not None:
            self.progress(SolveProgress(stage, 0, math.nan, 0.0, "", self.elapsed))

    @property
    def elapsed(self) -> float:
        """Seconds since the solve began."""
        return time.perf_counter() - self.begin

    @property
    def remaining(self) -> float:
        """Seconds left of the time limit."""
        return max(self.problem.method.time_limit - self.elapsed, MIN_SOLVE_TIME)

    @property
    def is_over(self) -> bool:
        """True where the time limit is over."""
        return self.elapsed > self.problem.method.time_limit

    @property
    def max_iterations(self) -> int | None:
        """Largest number of iterations of a stage, below that of its solver's options."""
        if not self.end_modes:
            return None
        return math.ceil(_FREE_ARRIVAL_ITERATION_SHARE * self.problem.method.max_iterations)

    @cached_property
    def end_modes(self) -> tuple[Mode, ...]:
        """Elastic modes with residual vibration in the plan; none where it must end at rest.

        With a wide smoothing of the motor law the residual vibration exceeds the limits, and
        vibration suppression needs a plan that ends at rest.
        """
        problem = self.problem
        if self.at_rest or not problem.plans_links or problem.arrives_at_rest:
            return ()
        if self.motor_smoothing > 1.0:
            return ()
        return modes(self.arm, self.motion.end)

    @cached_property
    def arm(self) -> ElasticArm:
        """The problem's elastic arm."""
        return ElasticArm(self.problem.robot, self.motion.start, self.problem.process_force)

    @cached_property
    def motors(self) -> MotorLaw:
        """Law of the motors that lead the problem's links."""
        return MotorLaw(self.problem.robot, self.problem.process_force)

    @cached_property
    def motor_smoothing(self) -> float:
        """Initial factor on the smoothing widths of the motor law.

        As wide as the smoothed quintic motion needs. With a narrower one no motion of that duration
        keeps the limits, and rows do not show it, since kinks are passed between nodes.
        """
        problem = self.problem
        motion = None if self.quintic is None else self.quintic.trajectory
        if not problem.plans_links or motion is None:
            return 1.0
        smooth = smooth_motion(motion, motion.duration / _QUINTIC_SPLINE_PIECES)
        times = np.linspace(0.0, motion.duration, _QUINTIC_SAMPLES)

        def beyond(width: float) -> float:
            found = drive_violations(problem, self.motors.motion(smooth, width), times)
            return max((v.value for v in found if v.limit == "jerk"), default=-1.0)

        least = law_smoothing(problem)
        return narrowest_sufficient_width(beyond, least, TOLERABLE_KINK_EXCESS) / least

    def formulate(self, margins: Mapping[str, float] | None = None) -> OptimalControlProblem:
        """Return the optimal-control problem, with limits backed off by margins, as shares."""
        ocp = formulate(self.problem, self.motion, self.scales, margins, self.end_modes)
        if self.lag is not None:
            # By damping the links arrive before their motors.
            shortest, longest = (each - float(self.lag.max()) for each in ocp.duration)
            ocp = replace(ocp, duration=(shortest, longest))
        return ocp

    def require_rest_at_arrival(self) -> None:
        """Forbid residual vibration from now on."""
        self.at_rest = True
        for known in ("end_modes", "lag"):
            self.__dict__.pop(known, None)

    @cached_property
    def lag(self) -> np.ndarray | None:
        """Delay of the joints' wind-up behind their torque, by damping (n,) [s].

        None where the motors do not come to rest smoothly, or the arm cannot be simulated.
        """
        problem = self.problem
        smooth = problem.boundary_acceleration == "zero" and problem.rests_at_both_ends
        if not (problem.plans_links and smooth) or self.end_modes:
            return None
        with suppress(NotSimulatedError):
            return round_lags(self.arm.lag(self.motion.end))
        return None

    def reported_value(self, objective: float) -> float:
        """Return the objective of an NLP in its reported unit and sign."""
        first = self.problem.objectives[0]
        sign = -1.0 if is_maximised(self.problem) else 1.0
        return sign * objective * first.weight * self.scales.of(first.name)

    def leave_out(self, step: str) -> None:
        """Note that the time limit ended a step, or left it out."""
        if step not in self.left_out:
            self.left_out.append(step)

    def record(self, stage: SolveStage, raw: RawSolution) -> None:
        """Add one NLP solve to the record."""
        self.solve_s += raw.solve_s
        self.iterations += raw.iterations
        if raw.status == "time_limit":
            self.leave_out(self.step)
        self.homotopy.append(
            {
                "intervals": stage.intervals,
                "smoothing": stage.smoothing.stiffness,
                "iterations": raw.iterations,
                "status": raw.status,
                "objective": self.reported_value(raw.objective),
                "solve_s": round(raw.solve_s, 4),
            }
        )
