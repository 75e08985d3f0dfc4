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
from stiffopt.certificate.collisions import COLLISION_LIMIT, with_collisions
from stiffopt.certificate.objective_value import is_maximised, objective_value
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.dynamics.inverse_kinematics import solve_pose
from stiffopt.errors import ProblemError
from stiffopt.problem.input_checks import located_targets
from stiffopt.result.assessment import Violation
from stiffopt.result.joint_path import JointPath
from stiffopt.result.solution import Baseline
from stiffopt.solver.clearance_rows import ClearanceRows
from stiffopt.solver.initial_guess import guess_from_motion
from stiffopt.solver.path_search import FreeSpace
from stiffopt.solver.refinement import mark_interrupted, refine
from stiffopt.solver.solve_run import SolveProgress, SolveRun
from stiffopt.solver.stage_plan import SolveStage, plan_stages
from stiffopt.solver.stages import Outcome, run_stages, solve_again
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
_MAX_PLANE_UPDATES, _MIN_RELATIVE_GAIN = 5, 1e-3
# Time of one path search: share of the remaining time, and largest [s].
_SEARCH_TIME_SHARE, _MAX_SEARCH_SECONDS = 0.2, 20.0
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


def avoid_collisions(
    run: SolveRun, plain: Outcome, rival: Baseline | None, *, searches: int = 1
) -> Outcome:
    """Return the outcome where it does not collide, else the best collision-free one found.

    Parameters
    ----------
    run : SolveRun
        Its `avoidance_failure` is set to the reason of a failure, `detour` to the first path found.
    plain : Outcome
        Solved without regard to collisions.
    rival : Baseline or None
    searches : int
        Number of path searches.
    """
    best: Outcome | None = None
    try:
        hits = find_collisions(run, plain)
        if not hits or not plain.raw.converged:
            return plain
        for start in _candidate_starts(run, plain, hits, searches):
            for tried in (start, start.finer()):
                run.avoidance = ClearanceRows(run.problem, [hit.pair for hit in hits if hit.pair])
                found = _solve_clear(run, tried, rival)
                if best is None or _rank_clear(run, found) < _rank_clear(run, best):
                    best = found
                if found.raw.status != "infeasible":
                    break
            ended = found.raw.status in ("interrupted", "time_limit")
            # A resolved slight overlap needs no path search.
            if ended or (start.mesh is not None and _is_certified_and_clear(run, found)):
                break
    except KeyboardInterrupt:
        return mark_interrupted(plain if best is None else best)
    if best is None or not (_is_certified_and_clear(run, best) or best.raw.status == "interrupted"):
        if best is not None and found.raw.status == "time_limit":
            run.avoidance_failure = _AVOIDANCE_TIMED_OUT
        return plain
    run.avoidance_failure = ""
    return best


def find_collisions(run: SolveRun, outcome: Outcome) -> list[Violation]:
    """Return the certificate's collision violations, worst first."""
    motion = with_collisions(run.problem, outcome.assessment)
    return [
        v
        for v in motion.violations
        if v.limit == COLLISION_LIMIT and v.value > CERTIFICATE_TOLERANCE
    ]


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
        seconds = min(_MAX_SEARCH_SECONDS, _SEARCH_TIME_SHARE * run.remaining)
        space = FreeSpace(problem, problem.method.seed + number, seconds)
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
            if seconds < _MAX_SEARCH_SECONDS:
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


def _solve_clear(run: SolveRun, start: _CollisionFreeStart, rival: Baseline | None) -> Outcome:
    """Solve from a start, increasing clearances while the certificate finds pairs too near."""
    avoidance = run.avoidance
    assert avoidance is not None
    found = refine(run, run_stages(run, start.plan, start.guess, {}, start.mesh), rival)
    if run.problem.plans_links:
        found = _update_planes(run, avoidance, found)
    for _ in range(_MAX_CLEARANCE_INCREASES):
        hits = find_collisions(run, found)
        if not hits or not found.raw.converged:
            break
        for hit in hits:
            assert hit.pair is not None
            assert hit.distance is not None
            missing = run.problem.stated_cell.clearance - hit.distance
            avoidance.increase_clearance(
                hit.pair,
                min(
                    _CLEARANCE_INCREASE_FACTOR * missing + _MIN_CLEARANCE_INCREASE,
                    _MAX_CLEARANCE_INCREASE,
                ),
            )
        before = found.transcription
        stage = SolveStage(len(before.intervals), found.smoothing)
        guess = before.guess_from(found.raw.x)
        try:
            again = refine(run, run_stages(run, (stage,), guess, {}, before.mesh), rival)
        except KeyboardInterrupt:
            return mark_interrupted(found)
        if not again.raw.converged and again.raw.status not in ("interrupted", "time_limit"):
            break
        found = again
    return found


def _update_planes(run: SolveRun, avoidance: ClearanceRows, found: Outcome) -> Outcome:
    """Update the planes after corrections have moved the links, with the corrected bounds."""
    for _ in range(_MAX_PLANE_UPDATES):
        if not _is_certified_and_clear(run, found) or not found.raw.converged:
            break
        transcription, same = avoidance.update_planes(found.transcription, found.raw.x)
        if not same:
            break
        corrected, anew = found.solver.nlp, transcription.nlp
        own = avoidance.base_row_count
        nlp = replace(
            anew,
            lower_g=np.append(corrected.lower_g[:own], anew.lower_g[own:]),
            upper_g=np.append(corrected.upper_g[:own], anew.upper_g[own:]),
        )
        before = replace(found, transcription=replace(transcription, nlp=nlp))
        try:
            again = refine(run, solve_again(run, before, nlp, found.smoothing), None)
        except KeyboardInterrupt:
            return mark_interrupted(found)
        if not _is_certified_and_clear(run, again) or _rank_clear(run, again) >= _rank_clear(
            run, found
        ):
            break
        gain = 1.0 - again.raw.objective / found.raw.objective
        found = again
        if gain < _MIN_RELATIVE_GAIN:
            break
    return found


def _rank_clear(run: SolveRun, outcome: Outcome) -> tuple[bool, float]:
    value = objective_value(run.problem, outcome.assessment).value
    return not _is_certified_and_clear(run, outcome), -value if is_maximised(run.problem) else value


def _is_certified_and_clear(run: SolveRun, outcome: Outcome) -> bool:
    return outcome.assessment.feasible(CERTIFICATE_TOLERANCE) and not find_collisions(run, outcome)


def _report_search(run: SolveRun, stage: str, plain: Outcome) -> None:
    if run.progress is not None:
        value = run.reported_value(plain.raw.objective)
        run.progress(SolveProgress(stage, 0, value, 0.0, "", run.elapsed))
