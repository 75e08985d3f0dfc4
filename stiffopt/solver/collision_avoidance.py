"""Collision avoidance: a solve whose motion collides is repeated with clearance rows.

A slight overlap is resolved from the motion itself. Otherwise a collision-free path is searched
from pose to pose, and the solve starts from a motion along it. Where the certificate still finds
too small a distance between two nodes, the clearance of that pair is increased.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.baseline.baselines import detour_baseline
from stiffopt.dynamics.inverse_kinematics import solve_pose
from stiffopt.errors import ProblemError
from stiffopt.path.path_search import FreeSpace
from stiffopt.problem.input_checks import located_targets
from stiffopt.result.assessment import Violation
from stiffopt.result.joint_path import JointPath
from stiffopt.result.status import SolveProgress
from stiffopt.solver.clearance_rows import ClearanceRows
from stiffopt.solver.exchange import OutcomeOracle, Proposal, exchange, rank_outcome
from stiffopt.solver.initial_guess import guess_from_motion
from stiffopt.solver.programme import Outcome, solve_again
from stiffopt.solver.refinement import refine
from stiffopt.solver.solve_run import SolveRun
from stiffopt.solver.stage_plan import SolveStage, plan_stages
from stiffopt.solver.stages import run_stages
from stiffopt.transcription.mesh import Mesh
from stiffopt.transcription.ocp import Guess

# Overlap, as a share of the arm's length, up to which no path is searched.
_GRAZING_ARM_SHARE = 0.02
# Increases of a pair's clearance: number, factor on the missing distance, least and largest [m].
_MAX_CLEARANCE_INCREASES = 4
_CLEARANCE_INCREASE_FACTOR, _MIN_CLEARANCE_INCREASE, _MAX_CLEARANCE_INCREASE = 1.2, 2e-5, 0.01
# Inverse kinematics starts for a tool position whose first pose collides.
_ALTERNATIVE_POSES = 100
# Updates of the planes after back-off corrections, and relative gain below which they end.
_MAX_CORRECTED_ROUNDS, _MIN_CORRECTED_GAIN = 5, 1e-3
_AVOIDANCE_TIMED_OUT = "The time limit ended the collision avoidance; raise method.time_limit."


@dataclass(frozen=True)
class _CollisionFreeStart:
    """Stages and guess of a solve with clearance rows; `mesh` None for a uniform one."""

    plan: tuple[SolveStage, ...]
    guess: Guess
    mesh: Mesh | None = None

    def finer(self) -> _CollisionFreeStart:
        """Return the start with halved intervals, which sweep smaller volumes each."""
        plan = tuple(replace(stage, intervals=2 * stage.intervals) for stage in self.plan)
        mesh = None if self.mesh is None else [np.repeat(0.5 * part, 2) for part in self.mesh]
        return replace(self, plan=plan, mesh=mesh)


def avoid_collisions(run: SolveRun, plain: Outcome, *, searches: int = 1) -> Outcome:
    """Return the outcome where it does not collide, else the best collision-free one found.

    `plain` was solved without regard to collisions; `searches` counts path searches. The run's
    `avoidance_failure` is set to the reason of a failure, its `detour` to the first path found.
    """
    best: Outcome | None = None
    hits = plain.collisions
    if not hits or not plain.raw.converged:
        return plain
    for start in _candidate_starts(run, plain, hits, searches):
        for tried in (start, start.finer()):
            run.avoidance = ClearanceRows(run.problem, [hit.pair for hit in hits if hit.pair])
            found = _solve_clear(run, tried)
            if best is None or rank_outcome(run, found) < rank_outcome(run, best):
                best = found
            if found.raw.status != "infeasible":
                break
        ended = found.raw.status == "time_limit"
        # A resolved slight overlap needs no path search.
        if ended or (start.mesh is not None and found.clear):
            break
    if best is None or not best.clear:
        if best is not None and found.raw.status == "time_limit":
            run.avoidance_failure = _AVOIDANCE_TIMED_OUT
        return plain
    run.avoidance_failure = ""
    return best


def _candidate_starts(
    run: SolveRun, plain: Outcome, hits: list[Violation], searches: int
) -> Iterator[_CollisionFreeStart]:
    problem = run.problem
    names = " and ".join(hits[0].pair or ())
    shallow = -_GRAZING_ARM_SHARE * problem.clearance_model.arm
    if all((hit.distance or 0.0) > shallow for hit in hits):
        before = plain.transcription
        stage = SolveStage(len(before.intervals), plain.smoothing)
        yield _CollisionFreeStart((stage,), before.guess_from(plain.raw.x), before.mesh)
    tried = 0
    for number in range(searches):
        _report_search(run, f"searching a path around {names}", plain)
        space = FreeSpace(problem, problem.method.seed + number, run.remaining)
        points = _collision_free_points(run, space)
        blocked = [located_targets(problem)[k][0] for k in space.blocked(points)]
        if blocked:
            run.avoidance_failure = (
                f"No pose free of collisions was found for {' and '.join(blocked)}."
            )
            return
        poses = space.path(points)
        tried += space.tried
        if poses is None:
            run.avoidance_failure = f"No collision-free path was found in {tried} trial poses."
            if space.timed_out:
                run.avoidance_failure = _AVOIDANCE_TIMED_OUT
            continue
        run.avoidance_failure = (
            "A collision-free path was found, but no motion along it that keeps every limit."
        )
        detour = detour_baseline(problem, JointPath.through(poses, "chord"))
        assert detour.assessment is not None
        run.detour = run.detour or detour
        guess = guess_from_motion(problem, run.motion, detour.assessment)
        yield _CollisionFreeStart(
            plan_stages(problem, problem.method.intervals, run.motor_smoothing), guess
        )


def _collision_free_points(run: SolveRun, space: FreeSpace) -> np.ndarray:
    """Return start, vias and end (k, n), collision-free where only positions are given."""
    problem, points = run.problem, run.motion.points.copy()
    random = np.random.default_rng(problem.method.seed)
    for k, (_, target) in enumerate(located_targets(problem)):
        if target.fixes_pose or space.gap(points[k]) > 0.0:
            continue
        for near in space.poses(_ALTERNATIVE_POSES, random):
            with suppress(ProblemError):
                pose = solve_pose(problem.robot, target.position, None, near)
                if space.gap(pose) > 0.0:
                    points[k] = pose
                    break
    return np.asarray(points)


def _solve_clear(run: SolveRun, start: _CollisionFreeStart) -> Outcome:
    """Solve from a start, increasing clearances while the certificate finds pairs too near."""
    avoidance = run.avoidance
    assert avoidance is not None
    found = refine(run, run_stages(run, start.plan, start.guess, {}, start.mesh))
    found = exchange(run, CorrectedPlanes(run, avoidance), found)
    return exchange(run, Clearances(run, avoidance), found)


class Clearances(OutcomeOracle):
    """Clearances of pairs that the certificate finds too near between two nodes."""

    step = "clearance"

    def __init__(self, run: SolveRun, rows: ClearanceRows) -> None:
        super().__init__(run)
        self._rows, self.rounds = rows, _MAX_CLEARANCE_INCREASES

    def propose(self, last: Outcome, number: int) -> Proposal[Outcome] | None:
        """Return a solve with increased clearances; None without a collision."""
        if not last.collisions or not last.raw.converged:
            return None
        for hit in last.collisions:
            assert hit.pair is not None
            assert hit.distance is not None
            missing = self.run.problem.stated_cell.clearance - hit.distance
            more = _CLEARANCE_INCREASE_FACTOR * missing + _MIN_CLEARANCE_INCREASE
            self._rows.increase_clearance(hit.pair, min(more, _MAX_CLEARANCE_INCREASE))
        before = last.transcription
        stage = SolveStage(len(before.intervals), last.smoothing)
        guess = before.guess_from(last.raw.x)

        def solve() -> Outcome:
            again = run_stages(self.run, (stage,), guess, {}, before.mesh)
            return refine(self.run, again)

        return Proposal(last.collisions[0].describe(), solve)


class CorrectedPlanes(OutcomeOracle):
    """Planes of a motion whose links corrections have moved, with the corrected bounds."""

    step = "separating planes"
    explores = False

    def __init__(self, run: SolveRun, rows: ClearanceRows) -> None:
        super().__init__(run)
        self._rows, self._before = rows, np.inf
        self.rounds = _MAX_CORRECTED_ROUNDS if run.problem.plans_links else 0

    def propose(self, last: Outcome, number: int) -> Proposal[Outcome] | None:
        """Return a solve with planes of the last motion; None where that gains nothing."""
        gain = 1.0 - last.raw.objective / self._before
        self._before = last.raw.objective
        if not (last.clear and last.raw.converged) or gain < _MIN_CORRECTED_GAIN:
            return None
        transcription, same = self._rows.update_planes(last.transcription, last.raw.x)
        if not same:
            return None
        corrected, anew, own = last.nlp, transcription.nlp, self._rows.base_row_count
        nlp = replace(
            anew,
            lower_g=np.append(corrected.lower_g[:own], anew.lower_g[own:]),
            upper_g=np.append(corrected.upper_g[:own], anew.upper_g[own:]),
        )
        before = replace(last, transcription=replace(transcription, nlp=nlp))
        return Proposal(
            "planes of this motion",
            lambda: refine(self.run, solve_again(self.run, before, nlp, last.smoothing)),
        )


def _report_search(run: SolveRun, stage: str, plain: Outcome) -> None:
    if run.progress is not None:
        value = run.reported_value(plain.raw.objective)
        run.progress(SolveProgress(stage, 0, value, 0.0, "", run.elapsed))
