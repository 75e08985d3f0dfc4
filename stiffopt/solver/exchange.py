"""Exchange loop: an oracle objects to a solved motion, it is solved again, the better one is kept.

Every improvement of a motion after its first solve is an oracle: it finds an excess and returns
what to solve next, with other bounds, another mesh or other rows. All share the loop, the rule by
which motions are compared, the answer to Ctrl-C and the log that the result keeps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Generic, TypeVar

import numpy as np

from stiffopt.certificate.objective_value import is_maximised, objective_value
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE

if TYPE_CHECKING:
    from stiffopt.solver.programme import Outcome
    from stiffopt.solver.solve_run import SolveRun

Answer = TypeVar("Answer")
State = TypeVar("State")
# Sort key of motions, the better one first.
Rank = tuple[float, ...]


@dataclass(frozen=True)
class Proposal(Generic[State]):
    """Objection of an oracle to a motion, and the solve that removes it."""

    reason: str
    solve: Callable[[], State]


class Oracle(Generic[State]):
    """Judge of solved motions, which proposes what to solve next."""

    step: ClassVar[str]  # name in the log, and among the steps that the time limit left out
    rounds: int  # largest number of solves
    explores: ClassVar[bool] = True  # continue from a motion that is not accepted

    def propose(self, last: State, number: int) -> Proposal[State] | None:
        """Return what to solve after the motion of round `number`, None without an objection."""
        raise NotImplementedError

    def rank(self, found: State) -> Rank:
        """Return the sort key of a motion."""
        raise NotImplementedError

    def accepts(self, found: State, best: State) -> bool:
        """Return True where a motion replaces the best one so far."""
        return self.rank(found) <= self.rank(best)

    def restore(self, best: State) -> None:
        """Restore the programme of the motion that is kept."""


class OutcomeOracle(Oracle["Outcome"]):
    """Oracle of certified outcomes."""

    def __init__(self, run: SolveRun) -> None:
        self.run = run

    def rank(self, found: Outcome) -> Rank:
        """Return the rank by certificate and objective."""
        return rank_outcome(self.run, found)

    def accepts(self, found: Outcome, best: Outcome) -> bool:
        """Return True where an outcome ranks no lower and keeps all limits, or was solved."""
        sound = not found.failed or found.assessment.feasible(CERTIFICATE_TOLERANCE)
        return sound and self.rank(found) <= self.rank(best)

    def restore(self, best: Outcome) -> None:
        """Restore the bounds with which the outcome was solved."""
        best.solver.set_bounds(best.nlp)


def exchange(run: SolveRun, oracle: Oracle[State], start: State) -> State:
    """Return the best motion after an oracle's objections, the start where none is better."""
    best = last = start
    step, run.step = run.step, oracle.step
    for number in range(oracle.rounds):
        proposal = oracle.propose(last, number)
        if proposal is None:
            break
        if run.is_over:
            run.leave_out(oracle.step)
            break
        begun, solves, last = run.iterations, len(run.homotopy), proposal.solve()
        accepted = oracle.accepts(last, best)
        run.exchanges.append(
            {
                "step": oracle.step,
                "reason": proposal.reason,
                "iterations": run.iterations - begun,
                "accepted": accepted,
                "ended": run.homotopy[-1]["status"] if len(run.homotopy) > solves else "",
            }
        )
        best = last if accepted else best
        if oracle.step in run.left_out or not (accepted or oracle.explores):
            break
    run.step = step
    oracle.restore(best)
    return best


def rank_outcome(run: SolveRun, outcome: Outcome, excess: float | None = None) -> Rank:
    """Return the sort key of outcomes: excess of a limit, then convergence, then the objective.

    The excess is the certificate's, infinite for a collision once these are avoided.
    """
    if excess is None:
        excess = outcome.assessment.worst_violation.value
        if run.avoidance is not None and outcome.collisions:
            excess = np.inf
    value = objective_value(run.problem, outcome.assessment).value
    sign = -1.0 if is_maximised(run.problem) else 1.0
    ended = outcome.raw.converged and not outcome.raw.rough
    return max(excess, CERTIFICATE_TOLERANCE), not ended, sign * value


def keep_better(run: SolveRun, outcome: Outcome) -> Outcome:
    """Return the outcome; it is the answer to Ctrl-C from now on, where it is the best so far."""
    if run.best is None or rank_outcome(run, outcome) <= rank_outcome(run, run.best):
        run.best = outcome
    return outcome


def interrupted_outcome(run: SolveRun) -> Outcome:
    """Return the best outcome before Ctrl-C, that of the last stage where none was finished.

    Raises `KeyboardInterrupt` again where no stage has started yet.
    """
    outcome = run.best
    if outcome is None:
        if run.unfinished is None:
            raise KeyboardInterrupt
        outcome = run.unfinished()
    return replace(outcome, raw=replace(outcome.raw, status="interrupted", reason="Ctrl-C"))
