"""Robust plan: among motions of nearly the same objective, the best one on uncertain arms.

Many motions have nearly the least peak. They differ in the rate of change of the deviation, which
excites vibration where springs differ from the model, and in the drive reserve for a command that
leads by more than the nominal wind-up. So a solve ends with one more: the peak may grow slightly
while the rate of the deviation is minimised. The motion whose command is better on the worst arm is
returned.

An input-shaped motion (`solver.input_shaping`) may cost more: it excites little residual vibration
whatever the springs. It is returned where it gains more on the worst arm than it costs as modelled.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from stiffopt.certificate.objective_value import objective_value
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.command.command_search import CommandOnArms
from stiffopt.command.compensation import commands_on_arms
from stiffopt.command.simulation import PlannedMotion, elastic_arm
from stiffopt.errors import NotSimulatedError
from stiffopt.result.solution import Solution, SolverRecord
from stiffopt.result.status import SolveStatus
from stiffopt.solver.arrival import refine_within_mesh
from stiffopt.solver.exchange import OutcomeOracle, Proposal, exchange
from stiffopt.solver.input_shaping import Window, windows_for_arms
from stiffopt.solver.programme import Outcome, solve_again
from stiffopt.solver.solve_run import SolveRun
from stiffopt.solver.verdict import MAX_OBJECTIVE_GAP
from stiffopt.transcription.nlp import Nlp

# Shares by which the peak may grow at the nodes and on the fine grid; less where stated.
_MAX_NODE_COST, _MAX_CERTIFIED_COST = 7e-3, 1e-2

SolveShaped = Callable[[tuple[Window, ...]], Solution]


def robust_plan(run: SolveRun, outcome: Outcome) -> Outcome:
    """Return the outcome, or one of nearly the same objective that is better on uncertain arms."""
    return exchange(run, UncertainArmsOracle(run), outcome)


class UncertainArmsOracle(OutcomeOracle):
    """Uncertain arms: the peak may grow slightly while the rate of the deviation is minimised."""

    step = "the motion for uncertain arms"
    rounds = 1

    def propose(self, last: Outcome, number: int) -> Proposal[Outcome] | None:
        """Return a solve with the objective capped; None where no uncertainty is stated."""
        if not _is_requested(self.run, last):
            return None
        nlp = _cap_objective(last, self.run.problem.uncertainty.price)
        return Proposal("drives have reserve for uncertain arms", lambda: self._solve(last, nlp))

    def _solve(self, last: Outcome, nlp: Nlp) -> Outcome:
        found = solve_again(self.run, last, nlp, replace(last.smoothing, robust=1.0))
        return refine_within_mesh(self.run, found) if found.raw.converged else found

    def accepts(self, found: Outcome, best: Outcome) -> bool:
        """Return True where the motion costs little and its command is better on uncertain arms."""
        run = self.run
        cost = _relative_cost(run, found, best)
        if not cost <= min(_MAX_CERTIFIED_COST, run.problem.uncertainty.price):
            return False
        try:
            own, least = _commands_on_arms(run, found, best)
        except NotSimulatedError:
            return False
        better = own.worst_case_peaks < least.worst_case_peaks
        run.command = own if better else least
        if better:
            why = "it vibrates less there and leaves drive reserve for more lead"
            run.notes.append(_cost_note(cost, why))
        return better


def _is_requested(run: SolveRun, outcome: Outcome) -> bool:
    sound = outcome.raw.converged and outcome.assessment.feasible(CERTIFICATE_TOLERANCE)
    # Separating planes hold only for the motion that was found.
    return run.problem.chosen_for_robustness and sound and run.avoidance is None


def _cap_objective(outcome: Outcome, price: float) -> Nlp:
    """Return the programme with the peak bounded to slightly more than its optimum."""
    upper, place = outcome.nlp.upper_x.copy(), outcome.transcription.statics.offset
    upper[place] = (
        1.0 + min(_MAX_NODE_COST, _MAX_NODE_COST / _MAX_CERTIFIED_COST * price)
    ) * outcome.raw.x[place]
    return replace(outcome.nlp, upper_x=upper)


def choose_shaped_motion(
    run: SolveRun, solution: Solution, least: Outcome, shaped: SolveShaped
) -> Solution:
    """Return the solution, or a shaped motion that gains more on the worst arm than it costs.

    The command of the `solution` found so far is the run's, where it is known; `least` is the
    optimum before any cost for uncertain arms, `shaped` solves the problem shaped over given
    windows.
    """
    problem, price = run.problem, run.problem.uncertainty.price
    if not solution.status.usable or solution.objective is None or not _is_requested(run, least):
        return solution
    best, own = objective_value(problem, least.assessment).value, run.command
    try:
        for window in windows_for_arms(problem, run.motion, price):
            tried = shaped((window,))
            if tried.status is SolveStatus.INTERRUPTED:
                raise KeyboardInterrupt
            if tried.solver.left_out or tried.status is SolveStatus.TIME_LIMIT:
                run.leave_out("input shaping for uncertain arms")
            if tried.status not in (SolveStatus.OPTIMAL, solution.status):
                continue
            if tried.assessment is None or tried.trajectory is None:
                continue
            value = objective_value(problem, tried.assessment)
            if value.value > (1.0 + price) * best:
                continue
            own = own or _command_on_arms(run, solution)
            other = _command_on_arms(run, tried)
            if (
                other.worst_case_peaks * value.value
                >= own.worst_case_peaks * solution.objective.value
            ):
                continue
            run.command = other
            note = _cost_note(value.value / best - 1.0, "its residual vibration is smaller there")
            return replace(
                tried,
                objective=value,
                notes=(*tried.notes, note),
                solver=_add_records(solution.solver, tried.solver),
                inputs_hash=solution.inputs_hash,
            )
    except NotSimulatedError:
        pass
    return solution


def _add_records(first: SolverRecord, second: SolverRecord) -> SolverRecord:
    """Return the combined record of two solves."""
    return replace(
        second,
        iterations=first.iterations + second.iterations,
        build_s=first.build_s + second.build_s,
        solve_s=first.solve_s + second.solve_s,
        homotopy=(*first.homotopy, *second.homotopy),
        exchanges=(*first.exchanges, *second.exchanges),
    )


def _cost_note(cost: float, why: str) -> str:
    given = f"{100.0 * max(cost, 0.0):.1f} % of the objective is given"
    return (
        f"As [uncertainty] is stated, {given} for a motion whose command deviates less on the "
        f"worst arm: {why}."
    )


def _command_on_arms(run: SolveRun, solution: Solution) -> CommandOnArms:
    """Return the command of a solution on uncertain arms."""
    (found,) = _commands_on_arms(run, solution)
    return found


def _commands_on_arms(run: SolveRun, *outcomes: Outcome | Solution) -> list[CommandOnArms]:
    """Return the commands of motions on uncertain arms."""
    arm = elastic_arm(run.problem, run.motion.start)
    motions = [
        PlannedMotion.of_solution(each.assessment, each.trajectory)
        for each in outcomes
        if each.assessment is not None
    ]
    return commands_on_arms(run.problem, arm, motions, run.motors)


def _relative_cost(run: SolveRun, found: Outcome, least: Outcome) -> float:
    """Return the relative increase of the objective; infinite where the motion is not certified."""
    sound = found.raw.converged and found.assessment.feasible(CERTIFICATE_TOLERANCE)
    if not sound or found.objective_gap > MAX_OBJECTIVE_GAP or found.collisions:
        return np.inf
    own, best = (objective_value(run.problem, each.assessment).value for each in (found, least))
    return own / best - 1.0
