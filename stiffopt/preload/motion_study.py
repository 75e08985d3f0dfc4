"""Joint optimisation of preloads and motion for the least tool deflection.

Alternates between the motion for fixed preloads and the preloads for the motion's worst instants,
each warm-started, and compares with one pass of both.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.certificate.assess import assess
from stiffopt.certificate.objective_value import objective_value
from stiffopt.errors import NoSolutionFound, ProblemError
from stiffopt.preload.load_case import LoadHistory
from stiffopt.preload.load_sources import motion_histories
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.optimise import optimise_preloads
from stiffopt.preload.problem import PreloadProblem
from stiffopt.preload.solution import PreloadSolution
from stiffopt.problem.objective import OBJECTIVES
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.provenance import inputs_hash
from stiffopt.result.solution import Solution
from stiffopt.result.status import ProgressCallback, SolveProgress, SolveStatus
from stiffopt.solver.family import ProblemFamily, WarmStart
from stiffopt.solver.monitor import Progress

# Relative change of the deflection that ends the alternation: a tenth of the reported digits.
_DEFLECTION_TOLERANCE = 1e-4


def motion_study(
    problem: PreloadProblem,
    trajectory_problem: TrajectoryProblem,
    rounds: int = 4,
    *,
    progress: ProgressCallback | None = None,
) -> MotionStudy:
    """Optimise preloads and motion together, in at most `rounds` rounds.

    Preloads within a connection are equal; the motion minimises the peak of one deflection, which
    is the objective of the preloads as well. After Ctrl-C the best so far is returned. Raises
    `ProblemError` where the motion's objective does not depend on preloads or the robots differ,
    `NoSolutionFound` without a feasible motion or preloads for it.
    """
    return _JointStudy(problem, trajectory_problem, progress).run(rounds)


def deflection_objective(problem: TrajectoryProblem) -> str:
    """Return the name of the tool deflection that a motion minimises.

    Raises `ProblemError`: the objective is not the peak of a tool deflection alone.
    """
    first = problem.objectives[0]
    if len(problem.objectives) == 1 and first.kind.deflection_part and first.measure == "peak":
        return first.name
    reason = "preloads are chosen for the instant of the largest deflection"
    if not any(objective.kind.deflection_part for objective in problem.objectives):
        reason = (
            "it does not depend on the preloads, or their optimum is at the limits for any motion"
        )
    asked = [f"{o.shown_measure} {o.name}".strip() for o in problem.objectives]
    deflections = [name for name, kind in OBJECTIVES.items() if kind.deflection_part]
    raise ProblemError(
        f"The motion minimises {' + '.join(asked)}, which cannot be studied together with the "
        f"preloads: {reason}. Minimise one of {', '.join(deflections)} alone, with measure = "
        "'peak', or leave [motion] out."
    )


@dataclass(frozen=True)
class _Design:
    """Certified motion with its preloads; `end` is the warm start of the next solve."""

    vector: np.ndarray
    motion: Solution
    deflection: float
    preloads: PreloadSolution | None = None
    end: WarmStart | None = None


class _JointStudy:
    """State of a joint study."""

    def __init__(
        self,
        problem: PreloadProblem,
        trajectory: TrajectoryProblem,
        progress: ProgressCallback | None,
    ) -> None:
        self.objective = deflection_objective(trajectory)
        if trajectory.robot.name != problem.robot.name:
            raise ProblemError(
                f"The study is of robot {problem.robot.name!r}, its motion of "
                f"{trajectory.robot.name!r}. Give both the same robot."
            )
        self.trajectory, self.progress = trajectory, progress
        self.problem = _motion_subproblem(problem)
        self.model = PreloadModel(self.problem)
        # Motions for other preloads share one programme with other parameters.
        self.family = ProblemFamily()
        self.begin, self.stage = time.perf_counter(), ""
        self.interrupted = self.converged = False
        self.remarks: list[str] = []

    def run(self, rounds: int) -> MotionStudy:
        self.stage = "motion with the present preloads"
        first = self._initial_design()
        separate = None if self.interrupted else self._optimise_preloads(first)
        if separate is None:
            return self._study_result(first, None, first, ())
        last, pairs = separate, []
        for number in range(1, rounds + 1):
            self.stage = f"round {number} of {rounds}"
            moved = self._optimise_motion(last.vector, last.end)
            tightened = self._optimise_preloads(moved) if self._is_usable(moved) else None
            if tightened is None:
                if not (self.interrupted or self._is_usable(moved)):
                    self.remarks.append(f"The rounds ended: {moved.motion.message}")
                break
            pairs.append((moved, tightened))
            self.converged = (
                abs(tightened.deflection / last.deflection - 1.0) < _DEFLECTION_TOLERANCE
            )
            last = tightened
            if self.converged:
                break
        best = min([separate, *(t for _, t in pairs)], key=lambda design: design.deflection)
        if best is separate and pairs:
            nearest = min(t.deflection for _, t in pairs) / separate.deflection - 1.0
            self.remarks.append(
                "No round came below the motion and preloads optimised one after another; the best "
                f"of them deflects {100 * nearest:.2f} % more."
            )
        first, separate = self._best_separate(first, separate, pairs)
        return self._study_result(first, separate, best, pairs)

    def _best_separate(
        self, first: _Design, separate: _Design, pairs: Sequence[tuple[_Design, _Design]]
    ) -> tuple[_Design, _Design]:
        """Return the best motion for the start preloads of all rounds, and its best preloads.

        More solves find better motions for any preloads; that must not count as a gain of the joint
        study.
        """
        found = [(first, separate)]
        found += [(self._certify_design(first.vector, moved.motion), best) for moved, best in pairs]
        best = min(found, key=lambda pair: pair[0].deflection)
        if best[0].deflection < first.deflection * (1.0 - _DEFLECTION_TOLERANCE):
            self.remarks.append(
                "A motion of the rounds suits the start preloads better than the one found for "
                f"them ({100 * (1.0 - best[0].deflection / first.deflection):.2f} %); it is "
                "used as the separately optimised motion."
            )
            return best
        return first, separate

    # ---- motion

    def _initial_design(self) -> _Design:
        """Optimise the motion at the present preloads, raised where a connection slips."""
        present = self.model.design
        floor = self.problem.requirements.least_preload
        vector = np.maximum(
            present, self.model.spread([floor * e.capacity for e in self.model.elements])
        )
        # Largest number of preload increases against slip under the motion.
        for _ in range(3):
            design = self._optimise_motion(vector)
            slips = self._slipping_connections(design)
            if self.interrupted or not slips:
                break
            least = self._least_preload(design)
            vector = np.maximum(vector, least)
        if slips and not self.interrupted:
            raise NoSolutionFound(
                f"Under the motion {' and '.join(slips)} slip at every preload tried. Give the "
                "motion more time, or the connections more or larger bolts.",
                design.motion,
            )
        if not (self._is_usable(design) or self.interrupted):
            raise NoSolutionFound(design.motion.message, design.motion)
        self._note_raised(vector)
        return design

    def _optimise_motion(self, vector: np.ndarray, warm: WarmStart | None = None) -> _Design:
        """Optimise the motion for these preloads, from a warm start if given.

        A warm start keeps the mesh, so that a gain is due to the preloads.
        """
        problem = self._with_preloads(vector)
        found, end = self.family.solve(problem, warm, progress=self._progress_callback())
        self.interrupted |= found.status is SolveStatus.INTERRUPTED
        if found.objective is None:
            raise NoSolutionFound(found.message, found)
        return _Design(vector, found, found.objective.value, end=end)

    def _is_usable(self, design: _Design) -> bool:
        return design.motion.status.usable and bool(np.isfinite(design.deflection))

    def _with_preloads(self, vector: np.ndarray) -> TrajectoryProblem:
        """Return the motion's problem at the least preloads in service."""
        robot = replace(self.trajectory.robot, chains=self.problem.robot.chains)
        return replace(
            self.trajectory, robot=robot.with_preloads(self._preloads_by_joint(vector, True))
        )

    def _preloads_by_joint(self, vector: np.ndarray, least: bool) -> dict[int, dict[str, float]]:
        """Return largest or least preloads by joint and element [N]."""
        found: dict[int, dict[str, float]] = {}
        for index, element in enumerate(self.model.elements):
            own = float(self.model.of_element(vector, index)[0])
            own = float(element.least(own)) if least else own
            found.setdefault(element.joint, {})[element.name] = own
        return found

    # ---- preloads

    def _motion_loads(self, design: _Design) -> tuple[LoadHistory, ...]:
        assert design.motion.assessment is not None
        problem = self._with_preloads(design.vector)
        return motion_histories(problem, design.motion.assessment, self.objective)

    def _preload_problem(
        self, design: _Design, objective: str, loads: tuple[LoadHistory, ...]
    ) -> PreloadProblem:
        """Return the preload problem under the loads of a motion, at its preloads."""
        return replace(
            self.problem,
            robot=self.problem.robot.with_preloads(self._preloads_by_joint(design.vector, False)),
            objective=objective,
            histories=(*self.problem.histories, *loads),
        )

    def _optimise_preloads(self, design: _Design) -> _Design | None:
        """Optimise the preloads for a motion; None if interrupted."""
        problem = self._preload_problem(design, "tool_deflection", self._motion_loads(design))
        found = optimise_preloads(problem, progress=self._progress_callback(), throw=False)
        if found.status is SolveStatus.INTERRUPTED:
            self.interrupted = True
            return None
        if not found.status.usable:
            raise NoSolutionFound(found.message, found)
        return replace(self._certify_design(found.vector, design.motion, found), end=design.end)

    def _certify_design(
        self, vector: np.ndarray, motion: Solution, preloads: PreloadSolution | None = None
    ) -> _Design:
        """Certify a motion with other preloads."""
        assert motion.trajectory is not None
        problem = self._with_preloads(vector)
        assessment = assess(problem, motion.trajectory)
        value = objective_value(problem, assessment)
        own = replace(
            motion, assessment=assessment, objective=value, inputs_hash=inputs_hash(problem)
        )
        return _Design(vector, own, value.value, preloads)

    def _slipping_connections(self, design: _Design) -> list[str]:
        """Return the free connections that slip under the motion at the least preload."""
        largest = np.max([np.abs(h.torque).max(axis=0) for h in self._motion_loads(design)], axis=0)
        return [
            element.key
            for index, element in enumerate(self.model.elements)
            if self.model.slip_torque(design.vector, index) <= largest[element.joint - 1]
        ]

    def _least_preload(self, design: _Design) -> np.ndarray:
        loads = tuple(replace(load, jacobian=None) for load in self._motion_loads(design))
        problem = self._preload_problem(design, "total_preload", loads)
        return optimise_preloads(problem, progress=self._progress_callback()).vector

    # ---- reporting

    def _preloads_by_key(self, vector: np.ndarray) -> dict[str, float]:
        return {
            e.key: float(self.model.of_element(vector, index)[0])
            for index, e in enumerate(self.model.elements)
        }

    def _note_raised(self, vector: np.ndarray) -> None:
        """Add a remark on present preloads that were raised."""
        present = self._preloads_by_key(self.model.design)
        raised = [
            f"{key} from {present[key]:.0f} to {preload:.0f} N"
            for key, preload in self._preloads_by_key(vector).items()
            if preload > present[key]
        ]
        if raised:
            self.remarks.append(
                "A connection slips or nearly slips at its present preload, so the start preload "
                f"is raised: {', '.join(raised)}."
            )

    def _progress_callback(self) -> Callable[[SolveProgress | Progress], object] | None:
        """Return a callback that reports the stage of the study with a solve's progress."""
        if self.progress is None:
            return None
        report, stage = self.progress, self.stage

        def forward(event: SolveProgress | Progress) -> None:
            part = event.stage if isinstance(event, SolveProgress) else "preloads"
            report(
                SolveProgress(
                    stage=f"{stage}, {part}",
                    iteration=event.iteration,
                    objective=event.objective,
                    violation=event.violation,
                    row=event.row,
                    elapsed=time.perf_counter() - self.begin,
                )
            )

        return forward

    def _study_result(
        self,
        first: _Design,
        separate: _Design | None,
        best: _Design,
        pairs: Sequence[tuple[_Design, _Design]],
    ) -> MotionStudy:
        status = SolveStatus.OPTIMAL if self.converged else SolveStatus.ACCEPTABLE
        if self.interrupted:
            status = SolveStatus.INTERRUPTED
        apart = separate or first
        known = float("nan") if separate is None else separate.deflection
        gain = 1.0 - best.deflection / known
        return MotionStudy(
            status=status,
            objective_name=self.objective,
            start=first.deflection,
            separate=known,
            joint=best.deflection,
            gain=gain,
            rounds=tuple(
                MotionRound(
                    deflection_before_preload=moved.deflection,
                    deflection_after=tightened.deflection,
                    preloads=self._preloads_by_key(tightened.vector),
                )
                for moved, tightened in pairs
            ),
            start_preloads=self._preloads_by_key(first.vector),
            separate_preloads=self._preloads_by_key(apart.vector),
            preloads=self._preloads_by_key(best.vector),
            trajectory=best.motion,
            separate_trajectory=apart.motion,
            preload_solution=best.preloads,
            note=" ".join([*self.remarks, describe_gain(status, gain)]),
            seconds=time.perf_counter() - self.begin,
        )


def _motion_subproblem(problem: PreloadProblem) -> PreloadProblem:
    """Return the study without stiffness and deflection requirements, for use with a motion."""
    needs = replace(problem.requirements, joint_stiffness={}, tool_deflection=None)
    return replace(
        problem,
        objective="total_preload",
        requirements=needs,
        individual=False,
        choose=None,
        load_cases=tuple(replace(case, jacobian=None) for case in problem.load_cases),
        histories=tuple(replace(history, jacobian=None) for history in problem.histories),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionRound:
    """Round of the alternation."""

    # Of the new motion, with the preloads before and after their optimisation [m].
    deflection_before_preload: float
    deflection_after: float
    preloads: Mapping[str, float]  # by element key: largest assembly preload after the round [N]


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionStudy:
    """Result of a joint optimisation of preloads and motion."""

    status: SolveStatus  # acceptable if the rounds ended before the deflection converged
    # Deflection whose peak is minimised, by the exact law at the least preloads.
    objective_name: str
    start: float  # of the motion optimised at the start preloads, with these [m]
    separate: float  # of the same motion with optimised preloads [m]; nan if interrupted before
    joint: float  # of both optimised together [m]; at most `separate`
    gain: float  # 1 - joint/separate
    rounds: tuple[MotionRound, ...]
    # By element key: largest assembly preload [N].
    start_preloads: Mapping[str, float]
    separate_preloads: Mapping[str, float]
    preloads: Mapping[str, float]
    trajectory: Solution  # the motion of `joint`, assessed with its preloads
    # The motion of `start` and `separate`, assessed with the preloads of `separate`.
    separate_trajectory: Solution
    preload_solution: PreloadSolution | None  # preload solution of `joint`
    note: str  # interpretation of the result
    seconds: float


def describe_gain(status: SolveStatus, gain: float) -> str:
    """Return the interpretation of the gain of a joint study."""
    if not np.isfinite(gain):
        return "Stopped by the user before the preloads were optimised."
    # Least relative gain that is reported, below the written digits.
    if gain < 5e-5:
        text = "Joint optimisation of preloads and motion does not lower the deflection"
    else:
        text = (
            f"Joint optimisation of preloads and motion lowers the deflection by {100 * gain:.2f} "
            "% against separate optimisation"
        )
    # Least relative gain that is worth a joint study.
    if gain < 0.01:
        text += ": a gain below 1 %, so the joint study is not worth it here"
    ends = {
        SolveStatus.INTERRUPTED: " Stopped by the user; this is the best so far.",
        SolveStatus.ACCEPTABLE: " The rounds ended before the deflection converged.",
    }
    return f"{text}.{ends.get(status, '')}"
