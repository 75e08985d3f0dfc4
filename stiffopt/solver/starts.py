"""Starts of a solve: several initial guesses, and a baseline better than the motion found."""

from __future__ import annotations

import numpy as np

from stiffopt.certificate.objective_value import is_maximised, objective_value
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.solution import Baseline
from stiffopt.solver.exchange import OutcomeOracle, Proposal, exchange
from stiffopt.solver.initial_guess import guess_from_motion, perturb_guess
from stiffopt.solver.programme import Outcome
from stiffopt.solver.refinement import refine
from stiffopt.solver.solve_run import SolveRun
from stiffopt.solver.stage_plan import plan_stages
from stiffopt.solver.stages import run_stages
from stiffopt.solver.verdict import find_better_baseline
from stiffopt.transcription.ocp import Guess

# Relative difference of objectives within which two optima count as the same.
_SAME_OBJECTIVE_SHARE = 0.01


def best_of_starts(run: SolveRun, guess: Guess) -> Outcome:
    """Return the best outcome of the problem's number of starts."""
    first = _solve_and_refine(run, guess)
    others = OtherStarts(run, guess, first)
    best = exchange(run, others, first)
    if len(others.made) > 1:
        run.notes.append(_describe_spread(run.problem, others.made))
    return best


class OtherStarts(OutcomeOracle):
    """Initial guesses with random smooth detours."""

    step = "other starts"

    def __init__(self, run: SolveRun, guess: Guess, first: Outcome) -> None:
        super().__init__(run)
        self.made, self._guess = [first], guess
        self._random = np.random.default_rng(run.problem.method.seed)
        self.rounds = run.problem.method.starts - 1

    def propose(self, last: Outcome, number: int) -> Proposal[Outcome]:
        """Return the solve from another guess."""
        guess = perturb_guess(self._guess, self.run.problem, self._random)
        return Proposal(f"start {number + 2} of {self.rounds + 1}", lambda: self._solve(guess))

    def _solve(self, guess: Guess) -> Outcome:
        self.made.append(_solve_and_refine(self.run, guess))
        self.run.starts_made = len(self.made)
        return self.made[-1]

    def accepts(self, found: Outcome, best: Outcome) -> bool:
        """Return True for a better motion, even where neither solve has converged."""
        return self.rank(found) < self.rank(best)


class BetterBaseline(OutcomeOracle):
    """Baseline that keeps every limit and is better than the motion: the solve starts from it."""

    step = "the start from a better baseline"
    rounds = 1

    def __init__(self, run: SolveRun, compared: dict[str, Baseline]) -> None:
        super().__init__(run)
        self._compared = compared

    def propose(self, last: Outcome, number: int) -> Proposal[Outcome] | None:
        """Return the solve from a better baseline, None without one."""
        above = find_better_baseline(self.run.problem, last, self._compared)
        if above is None or above.assessment is None:
            return None
        guess = guess_from_motion(self.run.problem, self.run.motion, above.assessment)
        reason = f"the {above.name} motion is better"
        return Proposal(reason, lambda: _solve_and_refine(self.run, guess))

    def accepts(self, found: Outcome, best: Outcome) -> bool:
        """Return True for a better motion, even where neither solve has converged."""
        return self.rank(found) < self.rank(best)


def _describe_spread(problem: TrajectoryProblem, made: list[Outcome]) -> str:
    """Return a note on the spread of the optima of several starts."""
    found = [
        objective_value(problem, each.assessment).value
        for each in made
        if each.raw.converged and each.assessment.feasible(CERTIFICATE_TOLERANCE)
    ]
    kept = f"Of {len(made)} starts {len(found)} ended in a certified optimum"
    if len(found) < 2:
        return f"{kept}."
    best = max(found) if is_maximised(problem) else min(found)
    off = [abs(value - best) / (abs(best) or 1.0) for value in found]
    near = sum(each <= _SAME_OBJECTIVE_SHARE for each in off)
    share = f"{100 * _SAME_OBJECTIVE_SHARE:g} %"
    return f"{kept}: {near} within {share} of the best, the furthest {100 * max(off):.2g} % off."


def _solve_and_refine(run: SolveRun, guess: Guess) -> Outcome:
    """Solve in stages, then refine until the certificate passes."""
    plan = plan_stages(run.problem, run.problem.method.intervals, run.motor_smoothing)
    found = refine(run, run_stages(run, plan, guess, {}))
    if run.end_modes and not _is_certified_optimum(found):
        # Residual vibration of the motor law exceeds the limits, or there was no optimum in time: a
        # plan that ends at rest has less.
        run.require_rest_at_arrival()
        resting = refine(run, run_stages(run, plan, guess, {}))
        if _is_certified_optimum(resting) or not found.assessment.feasible(CERTIFICATE_TOLERANCE):
            found = resting
            if found.assessment.feasible(CERTIFICATE_TOLERANCE):
                run.notes.append(
                    "No motion was found that uses the residual vibration allowed by the limits: "
                    "this one brings the links to rest, which takes slightly longer."
                )
    return found


def _is_certified_optimum(outcome: Outcome) -> bool:
    """Return True for an optimum that keeps all limits."""
    return outcome.raw.converged and outcome.assessment.feasible(CERTIFICATE_TOLERANCE)
