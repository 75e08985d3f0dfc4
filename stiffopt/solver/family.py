"""Problems that differ in numbers: their programme is built once and solved many times.

Start, end, fixed duration, payload, tool, process force, drivetrain and limits are numbers; number
of intervals, objectives, vias and which limits there are make another programme, which is built
anew.
"""

from __future__ import annotations

import json
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.baseline.baselines import baselines
from stiffopt.certificate.violations import CERTIFIED
from stiffopt.problem.bounds import shortest_duration
from stiffopt.problem.clear_poses import check_clear_poses
from stiffopt.problem.formulation import Scales, formulate
from stiffopt.problem.resolve import resolve
from stiffopt.problem.smoothing import Smoothing
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.solution import Solution
from stiffopt.solver.near_optimum import NearOptimum
from stiffopt.solver.plan import SolveStage, solver_options
from stiffopt.solver.refinement import refined
from stiffopt.solver.solve import notes_before, solution_of, solve_keeping
from stiffopt.solver.solve_run import ProgressCallback, SolveRun
from stiffopt.solver.stages import (
    Outcome,
    Programme,
    build_programme,
    outcome_of,
    solve_near,
    solve_stage,
)
from stiffopt.solver.verdict import TRUE_OBJECTIVE
from stiffopt.solver.way_around import collisions
from stiffopt.transcription.build import adapt
from stiffopt.transcription.mesh import Mesh
from stiffopt.transcription.nlp import BlockScales, Nlp

# Programmes that are kept; those used last stay.
_KEPT = 4


@dataclass(frozen=True, eq=False)
class WarmStart:
    """Where a solve ended, for the solve of another problem to start from.

    Parameters
    ----------
    x, multipliers_x, multipliers_g : array
        Of the last programme, in units.
    mesh : list of array
    smoothing : Smoothing
    scales : mapping of objective name to float
        Its programme was scaled by.
    block_scales : BlockScales
        Likewise. What starts from here keeps all scales: so the last digits of its answer do not
        depend on what else has been solved.
    method : str
        Transcription and intervals that its problem asked for.
    """

    x: np.ndarray
    multipliers_x: np.ndarray
    multipliers_g: np.ndarray
    mesh: Mesh
    smoothing: Smoothing
    scales: Mapping[str, float]
    block_scales: BlockScales
    method: str

    def to_bytes(self) -> bytes:
        """As a line of JSON and the numbers of all arrays, one after another."""
        of_x, of_g = self.block_scales.variables, self.block_scales.rows
        groups = [[self.x], [self.multipliers_x], [self.multipliers_g], self.mesh, of_x, of_g]
        head = {
            "sizes": [[len(each) for each in group] for group in groups],
            "smoothing": self.smoothing.parameters.tolist(),
            "scales": {name: float(value) for name, value in self.scales.items()},
            "method": self.method,
        }
        numbers = np.concatenate([np.zeros(0), *(each for group in groups for each in group)])
        return json.dumps(head).encode() + b"\n" + numbers.astype("<f8").tobytes()

    @classmethod
    def from_bytes(cls, content: bytes) -> WarmStart | None:
        """Read what `to_bytes` wrote; None of bytes of another shape, as of an older version."""
        try:
            return cls._read(content)
        except (KeyError, TypeError, ValueError):
            return None

    @classmethod
    def _read(cls, content: bytes) -> WarmStart:
        line, _, held = content.partition(b"\n")
        head = json.loads(line)
        numbers = np.frombuffer(held, "<f8").astype(float)
        sizes = [size for group in head["sizes"] for size in group]
        if sum(sizes) != len(numbers):
            raise ValueError("cut off")
        arrays = iter(np.split(numbers, np.cumsum(sizes)[:-1]))
        groups = [[next(arrays) for _ in group] for group in head["sizes"]]
        (x,), (multipliers_x,), (multipliers_g,), mesh, of_x, of_g = groups
        return cls(
            x,
            multipliers_x,
            multipliers_g,
            mesh,
            Smoothing(*head["smoothing"]),
            head["scales"],
            BlockScales(tuple(of_x), tuple(of_g)),
            head["method"],
        )


class ProblemFamily:
    """Solves problems one after another, each from where another one ended, if that is given.

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
    ) -> tuple[Solution, WarmStart | None]:
        """Solve and certify a problem; from the beginning where the warm start does not lead there.

        Parameters
        ----------
        problem : TrajectoryProblem
        warm : WarmStart, optional
            Of a near problem.
        compare : bool
            With baselines; without, `Solution.baselines` is empty after a warm solve.
        start : int
            As of `solve`.
        progress : callable, optional

        Returns
        -------
        Solution
            Of any status.
        WarmStart or None
            None where it cannot be started from.
        """
        if warm is not None and warm.method == _method(problem) and not start:
            run, outcome = self._warm(problem, warm, progress)
            if outcome is not None:
                beside = baselines(problem, run.motion) if compare else {}
                notes = notes_before(problem, run.motion)
                solution = solution_of(run, outcome, beside, notes, compare=compare)
                return solution, _end(run, outcome)
        solution, kept = solve_keeping(problem, progress=progress, start=start, compare=compare)
        if kept is None or problem.plans_links or start or not solution.status.usable:
            return solution, None
        run, outcome = kept
        self._keep(Programme(outcome.transcription, outcome.solver))
        return solution, _end(run, outcome)

    def _warm(
        self, problem: TrajectoryProblem, warm: WarmStart, progress: ProgressCallback | None
    ) -> tuple[SolveRun, Outcome | None]:
        """The outcome from a warm start; None where it is none to rely on."""
        motion = resolve(problem)
        _ = problem.clearance_model
        check_clear_poses(problem, motion)
        run = SolveRun(problem, motion, Scales(warm.scales), progress)
        if problem.duration[1] < shortest_duration(problem, motion)[0]:
            return run, None
        made = self._programme(run, warm)
        nlp = made.transcription.nlp
        if (len(warm.x), len(warm.multipliers_g)) != (len(nlp.lower_x), len(nlp.lower_g)):
            return run, None
        stage = SolveStage(sum(map(len, warm.mesh)), warm.smoothing)
        of_x, of_g = _scales(nlp)
        begin = replace(
            warm,
            x=np.clip(warm.x / of_x, nlp.lower_x, nlp.upper_x),
            multipliers_x=warm.multipliers_x * of_x,
            multipliers_g=warm.multipliers_g * of_g,
        )
        raw = solve_near(run, made, stage, begin.x, begin)
        if raw is None:
            raw = solve_stage(run, made, stage, begin.x, begin, "warm", "adaptive")
        ended = raw.status == "interrupted"
        if not (raw.converged or ended):
            return run, None
        outcome = outcome_of(run, made, raw, warm.smoothing)
        if not (ended or _is_sound(outcome)):
            # A mesh that is fine enough for one problem may not be for another.
            outcome = refined(run, outcome, None)
            self._keep(Programme(outcome.transcription, outcome.solver))
        if outcome.raw.status == "interrupted":
            # Who stopped it does not want it solved from the beginning.
            return run, outcome
        sound = _is_sound(outcome)
        if problem.avoids_collisions and collisions(run, outcome):
            # A way around is sought from the beginning.
            sound = False
        return run, outcome if sound else None

    def _programme(self, run: SolveRun, warm: WarmStart) -> Programme:
        """The programme on the mesh of a warm start, with the bounds and numbers of a problem."""
        ocp = formulate(run.problem, run.motion, run.scales)
        options = solver_options(run.problem)
        wanted = warm.block_scales.tobytes()
        for made in reversed(self._programmes.values()):
            first = made.transcription
            if (
                made.solver.options != options
                or not _equal(first.mesh, warm.mesh)
                or BlockScales.of(first.nlp).tobytes() != wanted
            ):
                continue
            found = adapt(first, ocp)
            if found is not None:
                made.solver.rebound(found.nlp)
                near = made.near or NearOptimum(made.solver)
                return self._keep(Programme(found, made.solver, near))
        made = build_programme(run, ocp, warm.mesh, scales=warm.block_scales)
        return self._keep(replace(made, near=NearOptimum(made.solver)))

    def _keep(self, made: Programme) -> Programme:
        key = (made.transcription.structure, BlockScales.of(made.transcription.nlp).tobytes())
        self._programmes[key] = made
        self._programmes.move_to_end(key)
        while len(self._programmes) > _KEPT:
            self._programmes.popitem(last=False)
        return made


def _is_sound(outcome: Outcome) -> bool:
    return outcome.assessment.feasible(CERTIFIED) and outcome.objective_gap <= TRUE_OBJECTIVE


def _end(run: SolveRun, outcome: Outcome) -> WarmStart:
    of_x, of_g = _scales(outcome.transcription.nlp)
    return WarmStart(
        x=outcome.raw.x * of_x,
        multipliers_x=outcome.raw.multipliers_x / of_x,
        multipliers_g=outcome.raw.multipliers_g / of_g,
        mesh=outcome.transcription.mesh,
        smoothing=outcome.smoothing,
        scales=run.scales.values,
        block_scales=BlockScales.of(outcome.transcription.nlp),
        method=_method(run.problem),
    )


def _scales(nlp: Nlp) -> tuple[np.ndarray, np.ndarray]:
    """Scales of all variables and rows."""
    variables, rows = (
        np.concatenate([np.zeros(0), *(block.scales for block in blocks.items)])
        for blocks in (nlp.variables, nlp.rows)
    )
    return variables, rows


def _method(problem: TrajectoryProblem) -> str:
    method = problem.method
    return f"{method.transcription} {method.intervals} {len(problem.vias)} {problem.is_shaped}"


def _equal(one: Mesh, other: Mesh) -> bool:
    return len(one) == len(other) and all(map(np.array_equal, one, other))
