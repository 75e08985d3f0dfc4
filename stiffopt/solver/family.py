"""Problem families: problems that differ in numbers share one programme, built once.

Start, end, fixed duration, payload, tool, process force, drivetrain and limits are parameters of a
programme; the number of intervals, the objectives, vias and the set of limits define another one.
"""

from __future__ import annotations

import functools
import json
import math
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.baseline.baselines import baselines
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.command.command_search import CommandChoice
from stiffopt.command.simulation import check_simulation
from stiffopt.interrupts import until_interrupted
from stiffopt.problem.bounds import shortest_duration
from stiffopt.problem.input_checks import check_clear_poses
from stiffopt.problem.limits.travel import with_bounded_travel
from stiffopt.problem.objective import Scales
from stiffopt.problem.resolve import resolve
from stiffopt.problem.stage_terms import Smoothing
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.assessment import Assessment
from stiffopt.result.solution import Solution
from stiffopt.result.status import ProgressCallback
from stiffopt.solver.active_set import ActiveSetSolver
from stiffopt.solver.exchange import interrupted_outcome
from stiffopt.solver.programme import (
    WARM_BOUND_PUSH,
    Outcome,
    Programme,
    build_programme,
    certify_outcome,
    solve_by_active_set,
    solve_stage,
)
from stiffopt.solver.refinement import refine
from stiffopt.solver.solve import (
    choose_for_arms,
    complete_solution,
    interrupted_solution,
    preliminary_notes,
    solve_with_state,
)
from stiffopt.solver.solve_run import SolveRun
from stiffopt.solver.stage_plan import SolveStage, solver_options
from stiffopt.solver.stationary_joints import fix_creeping_joints
from stiffopt.solver.verdict import MAX_OBJECTIVE_GAP
from stiffopt.transcription.build import adapt
from stiffopt.transcription.mesh import Mesh
from stiffopt.transcription.nlp import BlockScales, Nlp

# Programmes in memory, the most recently used ones.
_MAX_KEPT_PROGRAMMES = 4


@dataclass(frozen=True, eq=False)
class WarmStart:
    """End of a solve, from which the solve of a similar problem starts.

    A solve from here keeps all scales, so that the last digits of its answer do not depend on other
    solves.
    """

    # Of the last programme, unscaled.
    x: np.ndarray
    multipliers_x: np.ndarray
    multipliers_g: np.ndarray
    mesh: Mesh
    smoothing: Smoothing
    scales: Mapping[str, float]  # of its objectives, by name
    block_scales: BlockScales
    back_off: np.ndarray  # by which lower and upper bounds of rows were moved, unscaled (2, rows)
    method: str  # transcription and intervals of its problem
    command: CommandChoice | None = None

    def to_bytes(self) -> bytes:
        """Return a line of JSON, then all arrays as little-endian doubles."""
        of_x, of_g = self.block_scales.variables, self.block_scales.rows
        solved = [self.x, self.multipliers_x, self.multipliers_g, self.back_off.ravel()]
        groups = [*([each] for each in solved), self.mesh, of_x, of_g]
        head = {
            "sizes": [[len(each) for each in group] for group in groups],
            "smoothing": self.smoothing.parameters.tolist(),
            "scales": {name: float(value) for name, value in self.scales.items()},
            "method": self.method,
            "command": self.command,
        }
        numbers = np.concatenate([np.zeros(0), *(each for group in groups for each in group)])
        return json.dumps(head).encode() + b"\n" + numbers.astype("<f8").tobytes()

    @classmethod
    def from_bytes(cls, content: bytes) -> WarmStart | None:
        """Read bytes of `to_bytes`; None for another layout or what no solve writes."""
        try:
            return cls._parse_bytes(content)
        except (AttributeError, KeyError, TypeError, ValueError):
            return None

    @classmethod
    def _parse_bytes(cls, content: bytes) -> WarmStart:
        line, _, held = content.partition(b"\n")
        head = json.loads(line)
        numbers = np.frombuffer(held, "<f8").astype(float)
        sizes = [size for group in head["sizes"] for size in group]
        if sum(sizes) != len(numbers):
            raise ValueError("cut off")
        if not np.isfinite(numbers).all():
            raise ValueError("not finite")
        arrays = iter(np.split(numbers, np.cumsum(sizes)[:-1]))
        groups = [[next(arrays) for _ in group] for group in head["sizes"]]
        (x,), (multipliers_x,), (multipliers_g,), (back_off,), mesh, of_x, of_g = groups
        if not all((own > 0.0).all() and math.isclose(own.sum(), 1.0) for own in mesh):
            raise ValueError("no mesh")
        return cls(
            x,
            multipliers_x,
            multipliers_g,
            mesh,
            Smoothing(*map(float, head["smoothing"])),
            {str(name): float(value) for name, value in head["scales"].items()},
            BlockScales(tuple(of_x), tuple(of_g)),
            back_off.reshape(2, -1),
            head["method"],
            head["command"] and tuple(head["command"]),
        )


class ProblemFamily:
    """Solver of similar problems one after another, each optionally from another one's end.

    Examples
    --------
    >>> family = ProblemFamily()
    >>> light, end = family.solve(problem)  # doctest: +SKIP
    >>> heavy, _ = family.solve(heavier, end)  # doctest: +SKIP
    """

    def __init__(self) -> None:
        self._programmes: OrderedDict[tuple[str, bytes], Programme] = OrderedDict()

    def solve(
        self,
        problem: TrajectoryProblem,
        warm: WarmStart | None = None,
        *,
        compare: bool = True,
        start: int = 0,
        progress: ProgressCallback | None = None,
        guess: Callable[[], Assessment] | None = None,
        simulate: bool = False,
        beside_rivals: bool = True,
    ) -> tuple[Solution, WarmStart | None]:
        """Solve and certify a problem; without the warm start where that fails.

        `warm` is of a near problem, `guess` the initial guess of a solve without it. `compare`:
        with baselines, else `Solution.baselines` is empty after a warm solve. `beside_rivals`:
        simulate rivals too, and compare with baselines after a warm start. Others as of
        `solve`. The status may be any; the warm start is None where none can be started from.
        """
        if warm is not None and warm.method == _method_key(problem) and not start:
            motion = resolve(problem)
            if simulate:
                check_simulation(problem, motion)
            bounded = with_bounded_travel(problem, motion)
            run = SolveRun(bounded, motion, Scales(warm.scales), progress, at_rest=True)
            outcome = until_interrupted(
                functools.partial(self._solve_warm, run, warm),
                functools.partial(interrupted_outcome, run),
            )
            if outcome is not None:
                compare = compare and beside_rivals
                compared = baselines(bounded, motion) if compare else {}
                notes = preliminary_notes(bounded, motion, simulate=simulate)
                solution = until_interrupted(
                    functools.partial(
                        choose_for_arms, run, outcome, compared, notes, compare=compare
                    ),
                    functools.partial(interrupted_solution, run, compared, notes),
                )
                solution = complete_solution(
                    problem,
                    run,
                    solution,
                    simulate=simulate,
                    beside_rivals=beside_rivals,
                    choice=warm.command,
                )
                return solution, _warm_start_of(run, outcome, solution)
        solution, kept = solve_with_state(
            problem,
            progress=progress,
            guess=None if guess is None else guess(),
            simulate=simulate,
            start=start,
            compare=compare,
            beside_rivals=beside_rivals,
        )
        if kept is None or kept[0].end_modes or start or not solution.status.usable:
            return solution, None
        run, outcome = kept
        self._store_programme(Programme(outcome.transcription, outcome.solver))
        return solution, _warm_start_of(run, outcome, solution)

    def _solve_warm(self, run: SolveRun, warm: WarmStart) -> Outcome | None:
        """Return the outcome from a warm start, None where it is not a certified optimum."""
        problem = run.problem
        _ = problem.clearance_model
        check_clear_poses(problem, run.motion)
        if problem.duration[1] < shortest_duration(problem, run.motion)[0]:
            return None
        made = self._programme_for(run, warm)
        nlp = made.transcription.nlp
        if (len(warm.x), len(warm.multipliers_g)) != (len(nlp.lower_x), len(nlp.lower_g)):
            return None
        stage = SolveStage(sum(map(len, warm.mesh)), warm.smoothing)
        of_x, of_g = _nlp_scales(nlp)
        begin = replace(
            warm,
            x=np.clip(warm.x / of_x, nlp.lower_x, nlp.upper_x),
            multipliers_x=warm.multipliers_x * of_x,
            multipliers_g=warm.multipliers_g * of_g,
        )
        if warm.smoothing.creeping:
            # Joints that were fixed at rest stay so.
            standing = fix_creeping_joints(made.transcription, begin.x, problem)
            if standing is not None:
                made = replace(made, transcription=standing)
                made.solver.set_bounds(standing.nlp)
        plain, made = made.transcription, _backed_off(made, warm.back_off / of_g)
        raw = solve_by_active_set(run, made, stage, begin.x, begin)
        if raw is None:
            raw = solve_stage(run, made, stage, begin.x, begin, "warm", "adaptive", WARM_BOUND_PUSH)
        if not raw.converged:
            return None
        outcome = certify_outcome(run, made, raw, warm.smoothing)
        outcome = replace(outcome, transcription=plain)
        if problem.plans_links or not _is_certified_optimum(outcome):
            # A mesh that is fine enough for one problem may not be for another.
            outcome = refine(run, outcome)
            self._store_programme(Programme(outcome.transcription, outcome.solver))
        sound = _is_certified_optimum(outcome)
        if problem.avoids_collisions and outcome.collisions:
            # Collision avoidance needs a solve without the warm start.
            sound = False
        return outcome if sound else None

    def _programme_for(self, run: SolveRun, warm: WarmStart) -> Programme:
        """Return the programme on the mesh of a warm start, with a problem's bounds and numbers."""
        ocp = run.formulate()
        options = solver_options(run.problem)
        wanted = warm.block_scales.tobytes()
        for made in reversed(self._programmes.values()):
            first = made.transcription
            if (
                made.solver.options != options
                or not np.array_equal(np.concatenate(first.mesh), np.concatenate(warm.mesh))
                or BlockScales.of(first.nlp).tobytes() != wanted
            ):
                continue
            found = adapt(first, ocp)
            if found is not None:
                made.solver.set_bounds(found.nlp)
                near = made.near or ActiveSetSolver(made.solver)
                return self._store_programme(Programme(found, made.solver, near))
        made = build_programme(run, ocp, warm.mesh, scales=warm.block_scales)
        return self._store_programme(replace(made, near=ActiveSetSolver(made.solver)))

    def _store_programme(self, made: Programme) -> Programme:
        key = (made.transcription.structure, BlockScales.of(made.transcription.nlp).tobytes())
        self._programmes[key] = made
        self._programmes.move_to_end(key)
        while len(self._programmes) > _MAX_KEPT_PROGRAMMES:
            self._programmes.popitem(last=False)
        return made


def _is_certified_optimum(outcome: Outcome) -> bool:
    return (
        outcome.assessment.feasible(CERTIFICATE_TOLERANCE)
        and outcome.objective_gap <= MAX_OBJECTIVE_GAP
    )


def _warm_start_of(run: SolveRun, outcome: Outcome, solution: Solution) -> WarmStart:
    led = None if solution.compensation is None else solution.compensation.optimised
    of_x, of_g = _nlp_scales(outcome.transcription.nlp)
    return WarmStart(
        x=outcome.raw.x * of_x,
        multipliers_x=outcome.raw.multipliers_x / of_x,
        multipliers_g=outcome.raw.multipliers_g / of_g,
        mesh=outcome.transcription.mesh,
        smoothing=outcome.smoothing,
        scales=run.scales.values,
        block_scales=BlockScales.of(outcome.transcription.nlp),
        back_off=_moved_bounds(outcome.nlp, outcome.transcription.nlp) * of_g,
        method=_method_key(run.problem),
        command=None if led is None else (led.spacing, led.share, led.servo_share),
    )


def _moved_bounds(nlp: Nlp, before: Nlp) -> np.ndarray:
    """Return by how much the lower and the upper bounds of rows differ (2, rows)."""
    bounds, old = (np.stack([each.lower_g, each.upper_g]) for each in (nlp, before))
    moved: np.ndarray = np.subtract(bounds, old, out=np.zeros_like(old), where=bounds != old)
    return moved


def _backed_off(made: Programme, back_off: np.ndarray) -> Programme:
    """Return a programme with its bounds of rows moved, where a motion can keep them then."""
    nlp = made.transcription.nlp
    closer = replace(nlp, lower_g=nlp.lower_g + back_off[0], upper_g=nlp.upper_g + back_off[1])
    if not back_off.any() or np.any(closer.lower_g > closer.upper_g):
        return made
    made.solver.set_bounds(closer)
    return replace(made, transcription=replace(made.transcription, nlp=closer))


def _nlp_scales(nlp: Nlp) -> tuple[np.ndarray, np.ndarray]:
    """Return the scales of all variables and of all rows."""
    variables, rows = (
        np.concatenate([np.zeros(0), *(block.scales for block in blocks.items)])
        for blocks in (nlp.variables, nlp.rows)
    )
    return variables, rows


def _method_key(problem: TrajectoryProblem) -> str:
    method = problem.method
    return f"{method.transcription} {method.intervals} {len(problem.vias)} {problem.is_shaped}"
