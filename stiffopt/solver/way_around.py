"""A solve whose motion collides, solved again clear of collisions.

A motion that only grazes something is pushed off it. Else a free path is sought from pose to pose,
and the solve begins with a motion along it. The certificate judges what comes out; where it still
finds too little distance between two nodes, the pair is kept further apart.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.baseline.baselines import detour_baseline
from stiffopt.certificate.collisions import LIMIT as COLLISION
from stiffopt.certificate.collisions import with_collisions
from stiffopt.certificate.objective_value import is_maximised, objective_value
from stiffopt.certificate.violations import CERTIFIED
from stiffopt.dynamics.inverse_kinematics import solve_pose
from stiffopt.errors import ProblemError
from stiffopt.problem.input_checks import located_targets
from stiffopt.result.assessment import Violation
from stiffopt.result.joint_path import JointPath
from stiffopt.result.solution import Baseline
from stiffopt.solver.avoidance import Avoidance
from stiffopt.solver.free_path import FreeSpace
from stiffopt.solver.guess import guess_along
from stiffopt.solver.plan import SolveStage, stages
from stiffopt.solver.refinement import refined, stopped
from stiffopt.solver.solve_run import SolveProgress, SolveRun
from stiffopt.solver.stages import Outcome, run_stages, solve_again
from stiffopt.transcription.mesh import Mesh
from stiffopt.transcription.ocp import Guess

# Overlaps up to this share of the arm's length are pushed apart as they are.
_GRAZED = 0.02
# How often pairs are kept further apart; by more than the certificate misses, up to this [m].
_WIDENED = 4
_MORE, _LEAST, _MOST = 1.2, 2e-5, 0.01
# Poses tried for a place of the tool whose first pose collides.
_OTHER_POSES = 100
# How often planes are laid anew after corrections; the objective has settled when it falls by less.
_RELAID, _SETTLED = 5, 1e-3
# Of the time that is left, for one search of a free path, and seconds at most.
_SHARE, _SECONDS = 0.2, 20.0
_OUT_OF_TIME = "The time limit came before a way around was found; raise method.time_limit."


@dataclass(frozen=True)
class _Start:
    """Where a solve clear of collisions begins; `mesh` None for a uniform one."""

    plan: tuple[SolveStage, ...]
    guess: Guess
    mesh: Mesh | None = None

    def finer(self) -> _Start:
        """The same in half the steps: what is swept in one leaves no room, it may in two."""
        plan = tuple(replace(stage, intervals=2 * stage.intervals) for stage in self.plan)
        mesh = None if self.mesh is None else [np.repeat(0.5 * part, 2) for part in self.mesh]
        return replace(self, plan=plan, mesh=mesh)


def led_around(
    run: SolveRun, plain: Outcome, rival: Baseline | None, *, searches: int = 1
) -> Outcome:
    """The outcome itself where it does not collide, else the best one found clear of collisions.

    Parameters
    ----------
    run : SolveRun
        Says in `unavoided` what was tried in vain; `detour` is the first path that was found.
    plain : Outcome
        Solved without regard to collisions.
    rival : Baseline or None
    searches : int
        Paths that are tried.
    """
    best: Outcome | None = None
    try:
        hits = collisions(run, plain)
        if not hits or not plain.raw.converged:
            return plain
        for start in _starts(run, plain, hits, searches):
            for tried in (start, start.finer()):
                run.avoidance = Avoidance(run.problem, [hit.pair for hit in hits if hit.pair])
                found = _kept_clear(run, tried, rival)
                if best is None or _rank(run, found) < _rank(run, best):
                    best = found
                if found.raw.status != "infeasible":
                    break
            ended = found.raw.status in ("interrupted", "time_limit")
            # One that was pushed off what it grazed needs no search.
            if ended or (start.mesh is not None and _is_good(run, found)):
                break
    except KeyboardInterrupt:
        return stopped(plain if best is None else best)
    if best is None or not (_is_good(run, best) or best.raw.status == "interrupted"):
        if best is not None and found.raw.status == "time_limit":
            run.unavoided = _OUT_OF_TIME
        return plain
    run.unavoided = ""
    return best


def collisions(run: SolveRun, outcome: Outcome) -> list[Violation]:
    """What the certificate finds too near, the worst first."""
    motion = with_collisions(run.problem, outcome.assessment)
    return [v for v in motion.violations if v.limit == COLLISION and v.value > CERTIFIED]


def _starts(
    run: SolveRun, plain: Outcome, hits: list[Violation], searches: int
) -> Iterator[_Start]:
    problem = run.problem
    names = " and ".join(hits[0].pair or ())
    shallow = -_GRAZED * problem.clearance_model.arm
    if all((hit.distance or 0.0) > shallow for hit in hits):
        before = plain.transcription
        stage = SolveStage(len(before.intervals), plain.smoothing)
        yield _Start((stage,), before.guess_from(plain.raw.x), before.mesh)
    tried = 0
    for number in range(searches):
        _tell(run, f"seeking a way around {names}", plain)
        seconds = min(_SECONDS, _SHARE * run.remaining)
        space = FreeSpace(problem, problem.method.seed + number, seconds)
        points = _clear_points(run, space)
        blocked = [located_targets(problem)[k][0] for k in space.blocked(points)]
        if blocked:
            run.unavoided = f"No pose free of collisions was found for {' and '.join(blocked)}."
            return
        poses = space.path(points)
        tried += space.tried
        if poses is None:
            run.unavoided = f"No way around was found in {tried} poses that were tried."
            if seconds < _SECONDS:
                run.unavoided = _OUT_OF_TIME
            continue
        run.unavoided = "A way around was found, but no motion along it that keeps every limit."
        detour = detour_baseline(problem, JointPath.through(poses, "chord"))
        assert detour.assessment is not None
        run.detour = run.detour or detour
        guess = guess_along(problem, run.motion, detour.assessment)
        yield _Start(stages(problem, problem.method.intervals, run.corners), guess)


def _clear_points(run: SolveRun, space: FreeSpace) -> np.ndarray:
    """Start, vias and end (k, n); where only the tool's place is given, poses that are free."""
    problem, points = run.problem, run.motion.points.copy()
    random = np.random.default_rng(problem.method.seed)
    for k, (_, target) in enumerate(located_targets(problem)):
        if target.fixes_pose or space.gap(points[k]) > 0.0:
            continue
        for near in space.poses(_OTHER_POSES, random):
            with suppress(ProblemError):
                pose = solve_pose(problem.robot, target.position, None, near)
                if space.gap(pose) > 0.0:
                    points[k] = pose
                    break
    return np.asarray(points)


def _kept_clear(run: SolveRun, start: _Start, rival: Baseline | None) -> Outcome:
    """Solved from a start, pairs kept further apart while the certificate finds them too near."""
    avoidance = run.avoidance
    assert avoidance is not None
    found = refined(run, run_stages(run, start.plan, start.guess, {}, start.mesh), rival)
    if run.problem.plans_links:
        found = _after_corrections(run, avoidance, found)
    for _ in range(_WIDENED):
        hits = collisions(run, found)
        if not hits or not found.raw.converged:
            break
        for hit in hits:
            assert hit.pair is not None
            assert hit.distance is not None
            missing = run.problem.stated_cell.clearance - hit.distance
            avoidance.widen(hit.pair, min(_MORE * missing + _LEAST, _MOST))
        before = found.transcription
        stage = SolveStage(len(before.intervals), found.smoothing)
        guess = before.guess_from(found.raw.x)
        try:
            again = refined(run, run_stages(run, (stage,), guess, {}, before.mesh), rival)
        except KeyboardInterrupt:
            return stopped(found)
        if not again.raw.converged and again.raw.status not in ("interrupted", "time_limit"):
            break
        found = again
    return found


def _after_corrections(run: SolveRun, avoidance: Avoidance, found: Outcome) -> Outcome:
    """Planes laid anew where corrections have led the links away from them, bounds as corrected."""
    for _ in range(_RELAID):
        if not _is_good(run, found) or not found.raw.converged:
            break
        transcription, same = avoidance.renewed(found.transcription, found.raw.x)
        if not same:
            break
        corrected, anew = found.solver.nlp, transcription.nlp
        own = avoidance.rows_before
        nlp = replace(
            anew,
            lower_g=np.append(corrected.lower_g[:own], anew.lower_g[own:]),
            upper_g=np.append(corrected.upper_g[:own], anew.upper_g[own:]),
        )
        before = replace(found, transcription=replace(transcription, nlp=nlp))
        try:
            again = refined(run, solve_again(run, before, nlp, found.smoothing), None)
        except KeyboardInterrupt:
            return stopped(found)
        if not _is_good(run, again) or _rank(run, again) >= _rank(run, found):
            break
        gain = 1.0 - again.raw.objective / found.raw.objective
        found = again
        if gain < _SETTLED:
            break
    return found


def _rank(run: SolveRun, outcome: Outcome) -> tuple[bool, float]:
    value = objective_value(run.problem, outcome.assessment).value
    return not _is_good(run, outcome), -value if is_maximised(run.problem) else value


def _is_good(run: SolveRun, outcome: Outcome) -> bool:
    return outcome.assessment.feasible(CERTIFIED) and not collisions(run, outcome)


def _tell(run: SolveRun, stage: str, plain: Outcome) -> None:
    if run.progress is not None:
        value = run.in_si(plain.raw.objective)
        run.progress(SolveProgress(stage, 0, value, 0.0, "", run.elapsed))
