"""Optimisation of the preloads of a study, with proof or reason of infeasibility.

The smooth law is corrected to the exact one at each solution and solved again until converged, so
the optimum is that of the exact law.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.errors import NoSolutionFound
from stiffopt.preload.flange_loads import critical_instants
from stiffopt.preload.infeasibility import Stopper, find_stoppers
from stiffopt.preload.load_case import LoadCase, LoadHistory
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.nlp import Levels, PreloadNlp
from stiffopt.preload.problem import PreloadProblem
from stiffopt.preload.solution import PreloadSolution, evaluate_design
from stiffopt.preload.utilisation import utilisation_rows
from stiffopt.result.status import SolveStatus
from stiffopt.solver.ipopt import IpoptOptions, IpoptSolver, RawSolution, kkt_residual
from stiffopt.solver.monitor import Progress

ProgressReport = Callable[[Progress], object]

_IPOPT_OPTIONS = IpoptOptions(
    tol=1e-10, acceptable_tol=1e-8, max_iterations=300, extra={"bound_relax_factor": 0.0}
)
# Largest number of updates of a motion's worst instants; one or two suffice.
WORST_INSTANT_ROUNDS = 6


@dataclass(frozen=True, eq=False)
class Optimum:
    """Result of one optimisation under fixed load cases."""

    preloads: np.ndarray
    raw: RawSolution
    kkt_residual: float
    iterations: int

    @property
    def proved(self) -> bool:
        """True if the solver converged and the recomputed KKT residual is small."""
        # Largest KKT residual of an optimum [-], with rows and multipliers of order one: IPOPT ends
        # between 1e-12 and 1e-8, and rows are satisfied to 1e-6.
        return self.raw.converged and self.kkt_residual <= 1e-6

    @property
    def status(self) -> SolveStatus:
        """Status of the result; not optimal without proof."""
        if self.raw.converged and not self.proved:
            return SolveStatus.ITERATION_LIMIT
        return _STATUS_BY_RESULT.get(self.raw.status, SolveStatus.ITERATION_LIMIT)


def optimise_preloads(
    problem: PreloadProblem, *, progress: ProgressReport | None = None, throw: bool = True
) -> PreloadSolution:
    """Find the optimum preloads of a study.

    Parameters
    ----------
    progress : callable, optional
        Called with a `Progress` in every iteration.
    throw : bool
        Raise `NoSolutionFound` unless the status is usable or interrupted.

    Raises
    ------
    NoSolutionFound
        No preload meets the requirements; `solution` has the reasons and the best reachable.
    """
    cases = with_worst_instants(problem, problem.load_cases, PreloadModel(problem).design)
    solution = _solve_under_cases(PreloadModel(problem, cases), progress)
    try:
        for _ in range(WORST_INSTANT_ROUNDS - 1):
            if not solution.status.usable:
                break
            more = with_worst_instants(problem, cases, solution.vector)
            if len(more) == len(cases):
                break
            cases = more
            solution = _solve_under_cases(PreloadModel(problem, cases), progress)
    except KeyboardInterrupt:
        solution = replace(
            solution,
            status=SolveStatus.INTERRUPTED,
            message="Stopped by the user; the best preloads so far are kept. They are not checked "
            "against every instant of the motion.",
        )
    if throw and not (solution.status.usable or solution.status is SolveStatus.INTERRUPTED):
        raise NoSolutionFound(solution.message, solution)
    return solution


def with_worst_instants(
    problem: PreloadProblem, cases: tuple[LoadCase, ...], preloads: np.ndarray
) -> tuple[LoadCase, ...]:
    """Add the worst instants of the study's motions at these preloads."""
    model = PreloadModel(problem, cases)
    found = {case.name: case for case in cases}
    for history in problem.histories:
        for case in _worst_instants(model, history, preloads):
            found.setdefault(case.name, case)
    return tuple(found.values())


def _worst_instants(
    model: PreloadModel, history: LoadHistory, preloads: np.ndarray
) -> tuple[LoadCase, ...]:
    """Return the worst instants for bolts, slip, stiffness and deflection, in order of time."""
    found: set[int] = set()
    for element in model.elements:
        tightening = model.problem.tightening
        found |= critical_instants(element.stage, element.joint, history, tightening)
    for joint in model.problem.joints:
        torque = history.torque[:, joint - 1]
        found.add(int(np.argmax(np.abs(torque))))
        found.add(int(np.argmax(model.exact_compliance(preloads, joint, torque))))
    if history.jacobian is not None:
        found.add(int(np.argmax(model.deflection_sizes(history, preloads))))
    return tuple(history.at(index) for index in sorted(found))


def objective_levels(model: PreloadModel) -> Levels:
    """Return weights of the stiffnesses and scale of the deflection at the largest preloads.

    At the largest preloads no connection slips unless it must, so these stiffnesses compare joints
    of different size.
    """
    upper = model.spread([e.capacity for e in model.elements])
    stiffness = model.exact_stiffness(upper).min(axis=1)
    weights = {
        joint: float(model.problem.joint_weights.get(joint, own if own > 0.0 else 1.0))
        for joint, own in zip(model.problem.joints, stiffness, strict=True)
    }
    deflection = np.linalg.norm(model.exact_deflection(upper), axis=1)
    posed = deflection[np.isfinite(deflection)]
    largest = float(posed.max()) if posed.size else 0.0
    return Levels(weights, largest if largest > 0.0 else 1.0)


def optimum(
    model: PreloadModel,
    objective: str,
    *,
    levels: Levels | None = None,
    progress: ProgressReport | None = None,
) -> Optimum:
    """Optimise one objective under the model's load cases, by the exact law.

    Minimax objectives leave some preloads undetermined; of the optimal designs the one of least
    total preload is returned.
    """
    levels = levels or objective_levels(model)
    first = _exact_optimum(PreloadNlp(model, objective, levels), progress)
    if objective not in ("bolt_utilisation", "tool_deflection") or not first.proved:
        return first
    # Relative loss of an objective allowed for less preload [-].
    ceiling = (objective, first.raw.objective * (1.0 + 1e-9))
    least = PreloadNlp(model, "total_preload", levels, ceiling=ceiling)
    second = _exact_optimum(least, progress, first.preloads)
    if not second.proved:
        return first
    return replace(second, iterations=first.iterations + second.iterations)


def _exact_optimum(
    nlp: PreloadNlp, progress: ProgressReport | None, start: np.ndarray | None = None
) -> Optimum:
    """Solve and correct the smooth law until its optimum is that of the exact law."""
    solver = IpoptSolver(nlp.nlp, _IPOPT_OPTIONS)
    size = nlp.model.size
    lower, upper = nlp.bounds()
    preloads = lower + 0.7 * (upper - lower) if start is None else start
    x0 = np.concatenate([preloads / nlp.scale, np.full(nlp.nlp.x.numel() - size, 2.0)])
    shifted = nlp.depends_on_stiffness or nlp.depends_on_deflection
    parameters = nlp.parameters(preloads)
    iterations = 0
    # Corrections of the smooth law, until preloads change by less than IPOPT's accuracy.
    for _ in range(20):
        raw = solver.solve(x0, parameters, report=progress)
        iterations += raw.iterations
        found = nlp.model.without_rounding(raw.x[:size] * nlp.scale)
        step = float(np.max(np.abs(found - preloads) / nlp.scale))
        preloads = found
        if shifted:
            parameters = nlp.parameters(preloads)
        # Of the exact law at the point found, so that corrections that do not settle prove nothing.
        result = Optimum(preloads, raw, kkt_residual(nlp.nlp, raw, parameters), iterations)
        if not (raw.converged and shifted) or (step < 1e-8 and result.proved):
            break
    return result


def _solve_under_cases(model: PreloadModel, progress: ProgressReport | None) -> PreloadSolution:
    problem = model.problem
    nlp = PreloadNlp(model, problem.objective, objective_levels(model))
    stoppers = find_stoppers(nlp)
    _, upper = nlp.bounds()
    if stoppers:
        return evaluate_design(model, upper, SolveStatus.INFEASIBLE, stoppers=stoppers)
    if problem.requirements.tool_deflection is not None:
        stoppers = _deflection_stopper(model, progress)
        if stoppers:
            return evaluate_design(model, upper, SolveStatus.INFEASIBLE, stoppers=stoppers)
    found = optimum(model, problem.objective, progress=progress)
    status = found.status
    if status is SolveStatus.INFEASIBLE and all(
        row.satisfied for row in utilisation_rows(model, upper)
    ):
        status = SolveStatus.ITERATION_LIMIT
    return evaluate_design(
        model,
        found.preloads,
        status,
        kkt_residual=found.kkt_residual,
        iterations=found.iterations,
    )


_STATUS_BY_RESULT = {
    "optimal": SolveStatus.OPTIMAL,
    "acceptable": SolveStatus.ACCEPTABLE,
    "infeasible": SolveStatus.INFEASIBLE,
    "stalled": SolveStatus.INFEASIBLE,
    "interrupted": SolveStatus.INTERRUPTED,
    "time_limit": SolveStatus.TIME_LIMIT,
}


def _deflection_stopper(
    model: PreloadModel, progress: ProgressReport | None
) -> tuple[Stopper, ...]:
    """Return the stopper if the least deflection within all other limits is too large."""
    needs = model.problem.requirements
    allowed = needs.tool_deflection
    assert allowed is not None
    free = PreloadModel(
        replace(model.problem, requirements=replace(needs, tool_deflection=None)), model.cases
    )
    least = _exact_optimum(PreloadNlp(free, "tool_deflection", objective_levels(free)), progress)
    if not least.proved:
        return ()
    sizes = np.linalg.norm(model.exact_deflection(least.preloads), axis=1)
    worst = int(np.nanargmax(sizes))
    if sizes[worst] <= allowed * (1 + 1e-9):
        return ()
    return (
        Stopper(
            limit=f"tool deflection, {model.cases[worst].name}",
            best=float(sizes[worst]),
            required=allowed,
            unit="m",
            against="bolts and pins are at their largest preloads",
            remedy="a smaller load, another pose, larger bolts, or stiffer reducers",
        ),
    )
