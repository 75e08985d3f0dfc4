"""Of motions that are as good, the one that does best on arms that are not as modelled.

Many motions have nearly the least peak. They differ in how fast the deviation rises and falls,
which swings where springs are softer or stiffer than the model, and in the room that they leave the
drives for a command that leads by more than the nominal wind-up. So a solve ends with one more: the
peak may grow by a little, and the deviation changes as slowly as it can. Whichever motion's command
does better on the worst arm is taken.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stiffopt.certificate.objective_value import objective_value
from stiffopt.certificate.violations import CERTIFIED
from stiffopt.errors import NotSimulatedError
from stiffopt.solver.compensation import CommandOnArms, commands_on_arms
from stiffopt.solver.refinement import refined_within, stopped
from stiffopt.solver.simulation import PlannedMotion, elastic_arm
from stiffopt.solver.solve_run import SolveRun
from stiffopt.solver.stages import Outcome, solve_again
from stiffopt.solver.verdict import TRUE_OBJECTIVE
from stiffopt.solver.way_around import collisions
from stiffopt.transcription.nlp import Nlp

# Share by which the peak at the nodes may grow, and that on the fine grid.
_COST, _COST_CERTIFIED = 7e-3, 1e-2


def robust_plan(run: SolveRun, outcome: Outcome) -> Outcome:
    """The outcome, or one as good that is better on other arms, where there is any."""
    if not _asked(run, outcome):
        return outcome
    before = outcome.solver.nlp
    nlp, cost = _capped(outcome, before), np.inf
    try:
        found = solve_again(run, outcome, nlp, replace(outcome.smoothing, robust=1.0))
        if found.raw.converged:
            found = refined_within(run, found, nlp)
        if found.raw.status == "interrupted":
            outcome = stopped(outcome)
        else:
            cost = _cost(run, found, outcome)
        if cost <= _COST_CERTIFIED:
            own, least = _on_arms(run, found, outcome)
            better = own.at_worst < least.at_worst
            run.command = own if better else least
            if better:
                run.notes.append(_note(cost))
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
    return run.problem.chosen_for_other_arms and sound and run.avoidance is None


def _capped(outcome: Outcome, nlp: Nlp) -> Nlp:
    """The programme with the bound on the peak limited to a little more than it is."""
    upper, place = nlp.upper_x.copy(), outcome.transcription.statics.offset
    upper[place] = (1.0 + _COST) * outcome.raw.x[place]
    return replace(nlp, upper_x=upper)


def _note(cost: float) -> str:
    given = f"{100.0 * max(cost, 0.0):.1f} % of the objective is given"
    return (
        f"As [uncertainty] is stated, {given} for a motion whose command deviates less on the worst"
        " arm: it swings less there, and leaves the motors room to lead by more."
    )


def _on_arms(run: SolveRun, *outcomes: Outcome) -> list[CommandOnArms]:
    """The commands of outcomes on uncertain arms."""
    arm = elastic_arm(run.problem, run.motion.start)
    motions = [
        replace(PlannedMotion.of("optimised", each.assessment, True), motors=each.trajectory)
        for each in outcomes
    ]
    return commands_on_arms(run.problem, arm, motions, run.motors)


def _cost(run: SolveRun, found: Outcome, least: Outcome) -> float:
    """Share by which the objective is larger; infinite where the motion is not sound."""
    sound = found.raw.converged and found.assessment.feasible(CERTIFIED)
    if not sound or found.objective_gap > TRUE_OBJECTIVE or collisions(run, found):
        return np.inf
    own, best = (objective_value(run.problem, each.assessment).value for each in (found, least))
    return own / best - 1.0
