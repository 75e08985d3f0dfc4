"""Of motions that are as good, the one that does best on arms that are not as modelled.

Many motions have nearly the least peak. They differ in how fast the deviation rises and falls,
which swings where springs are softer or stiffer than the model, and in the room that they leave the
drives for a command that leads by more than the nominal wind-up. So a solve ends with one more: the
peak may grow by a little, and the deviation changes as slowly as it can. Whichever motion's command
does better on the worst arm is taken.

More may be given for a motion that is averaged over some of a swing (`solver.shaping`): whatever
the springs, little swings on after it. It is taken where it gains more on the worst arm than it
costs as modelled.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from stiffopt.certificate.objective_value import objective_value
from stiffopt.certificate.violations import CERTIFIED
from stiffopt.errors import NotSimulatedError
from stiffopt.result.solution import Solution, SolverRecord
from stiffopt.result.status import SolveStatus
from stiffopt.solver.compensation import CommandOnArms, commands_on_arms
from stiffopt.solver.refinement import refined_within, stopped
from stiffopt.solver.shaping import Window, interrupted, windows_for_arms
from stiffopt.solver.simulation import PlannedMotion, elastic_arm
from stiffopt.solver.solve_run import SolveRun
from stiffopt.solver.stages import Outcome, solve_again
from stiffopt.solver.verdict import TRUE_OBJECTIVE
from stiffopt.solver.way_around import collisions
from stiffopt.transcription.nlp import Nlp

# Share by which the peak at the nodes may grow, and that on the fine grid, where no less is stated.
_COST, _COST_CERTIFIED = 7e-3, 1e-2

ShapedOver = Callable[[tuple[Window, ...]], Solution]


def robust_plan(run: SolveRun, outcome: Outcome) -> Outcome:
    """The outcome, or one as good that is better on other arms, where there is any."""
    if not _asked(run, outcome):
        return outcome
    before, price = outcome.solver.nlp, run.problem.uncertainty.price
    nlp, cost = _capped(outcome, before, price), np.inf
    try:
        found = solve_again(run, outcome, nlp, replace(outcome.smoothing, robust=1.0))
        if found.raw.converged:
            found = refined_within(run, found, nlp)
        if found.raw.status == "interrupted":
            outcome = stopped(outcome)
        else:
            cost = _cost(run, found, outcome)
        if cost <= min(_COST_CERTIFIED, price):
            own, least = _on_arms(run, found, outcome)
            better = own.at_worst < least.at_worst
            run.command = own if better else least
            if better:
                run.notes.append(
                    _note(cost, "it swings less there, and leaves the motors room to lead by more")
                )
                return found
    except NotSimulatedError:
        pass
    except KeyboardInterrupt:
        outcome = stopped(outcome)
    outcome.solver.rebound(before)
    return outcome


def _asked(run: SolveRun, outcome: Outcome) -> bool:
    sound = outcome.raw.converged and outcome.assessment.feasible(CERTIFIED)
    # Planes around what it must not touch are of the motion that was found.
    return run.problem.chosen_for_robustness and sound and run.avoidance is None


def _capped(outcome: Outcome, nlp: Nlp, price: float) -> Nlp:
    """The programme with the bound on the peak limited to a little more than it is."""
    upper, place = nlp.upper_x.copy(), outcome.transcription.statics.offset
    upper[place] = (1.0 + min(_COST, _COST / _COST_CERTIFIED * price)) * outcome.raw.x[place]
    return replace(nlp, upper_x=upper)


def shaped_for_arms(
    run: SolveRun, solution: Solution, least: Outcome, shaped: ShapedOver
) -> Solution:
    """The solution, or a shaped motion that gains more on the worst arm than it costs.

    Parameters
    ----------
    run : SolveRun
    solution : Solution
        Found so far; its command on uncertain arms is the run's, where that is known.
    least : Outcome
        Before anything was given for other arms.
    shaped : callable
        Solves the run's problem shaped over given windows.
    """
    problem, price = run.problem, run.problem.uncertainty.price
    if not solution.status.usable or solution.objective is None or not _asked(run, least):
        return solution
    best, own = objective_value(problem, least.assessment).value, run.command
    try:
        for window in windows_for_arms(problem, run.motion, price):
            tried = shaped((window,))
            if tried.status is SolveStatus.INTERRUPTED:
                return interrupted(solution)
            if tried.status not in (SolveStatus.OPTIMAL, solution.status):
                continue
            if tried.assessment is None or tried.trajectory is None:
                continue
            value = objective_value(problem, tried.assessment)
            if value.value > (1.0 + price) * best:
                continue
            own = own or _command(run, solution)
            other = _command(run, tried)
            if other.at_worst * value.value >= own.at_worst * solution.objective.value:
                continue
            run.command = other
            note = _note(value.value / best - 1.0, "it swings on less there")
            return replace(
                tried,
                objective=value,
                notes=(*tried.notes, note),
                solver=_both(solution.solver, tried.solver),
                inputs_hash=solution.inputs_hash,
            )
    except NotSimulatedError:
        pass
    except KeyboardInterrupt:
        return interrupted(solution)
    return solution


def _both(first: SolverRecord, second: SolverRecord) -> SolverRecord:
    """What the solver did one after the other."""
    return replace(
        second,
        iterations=first.iterations + second.iterations,
        build_s=first.build_s + second.build_s,
        solve_s=first.solve_s + second.solve_s,
        homotopy=(*first.homotopy, *second.homotopy),
    )


def _note(cost: float, why: str) -> str:
    given = f"{100.0 * max(cost, 0.0):.1f} % of the objective is given"
    return (
        f"As [uncertainty] is stated, {given} for a motion whose command deviates less on the "
        f"worst arm: {why}."
    )


def _command(run: SolveRun, solution: Solution) -> CommandOnArms:
    """The command of a solution on uncertain arms."""
    (found,) = _on_arms(run, solution)
    return found


def _on_arms(run: SolveRun, *outcomes: Outcome | Solution) -> list[CommandOnArms]:
    """The commands of motions on uncertain arms."""
    arm = elastic_arm(run.problem, run.motion.start)
    motions = [
        replace(PlannedMotion.of("optimised", each.assessment, True), motors=each.trajectory)
        for each in outcomes
        if each.assessment is not None
    ]
    return commands_on_arms(run.problem, arm, motions, run.motors)


def _cost(run: SolveRun, found: Outcome, least: Outcome) -> float:
    """Share by which the objective is larger; infinite where the motion is not sound."""
    sound = found.raw.converged and found.assessment.feasible(CERTIFIED)
    if not sound or found.objective_gap > TRUE_OBJECTIVE or collisions(run, found):
        return np.inf
    own, best = (objective_value(run.problem, each.assessment).value for each in (found, least))
    return own / best - 1.0
