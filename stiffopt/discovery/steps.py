"""Steps of a diagnosis that Ctrl-C ends or skips, and the sentences that say so."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar

from stiffopt.discovery.progress import Say
from stiffopt.discovery.search.search import SearchResult
from stiffopt.interrupts import complete_step

Answer = TypeVar("Answer")

_SEARCH_STOPPED = "only findings up to then are reported; more effects may be missing."
_EXTRAS_SKIPPED = (
    "Stopped by the user after the search: the findings are complete, longer calculations after"
    " it were left out."
)
_RIVALS_NOT_RANKED = "findings with probability 0.5 were not compared with their rivals."


class Step(NamedTuple):
    """An optional step: what a diagnosis says of it, and of its absence after Ctrl-C."""

    sentence: str
    skipped: str


BANDS = Step(
    "choose how fast a motion predictions follow", "predicted torques follow the band of the fit."
)
LAWS = Step("", "no law beyond the catalogue was searched for.")
HALF_BAND = Step(
    "fit the parameters again in half the band",
    "standard deviations do not include a fit in half the band.",
)
ENSEMBLE = Step(
    "fit the findings again to perturbed runs and models",
    "findings were not fitted again to perturbed runs.",
)
LIMITS = Step("", "detection limits were not calculated.")
BURSTS = Step(
    "look for bursts above the filter's band",
    "torque bursts above the filter's band were not searched for.",
)
EXPERIMENT = Step("", "no experiment was designed.")
SIMULATION = Step("", "no simulation from commands was fitted.")
NOISE_CEILING = Step("", "no noise ceiling was fitted.")
SUSPECTS = Step(
    "search the open residual for suspects", "the open residual was not searched for suspects."
)


def _by_user(consequence: str) -> str:
    return f"Stopped by the user: {consequence}"


class OptionalSteps:
    """Steps after a search; `stopped` are sentences on what Ctrl-C ended or skipped."""

    def __init__(self, result: SearchResult, say: Say) -> None:
        self.say = say
        self.stopped = [_by_user(_SEARCH_STOPPED)] if result.stopped else []
        if not result.weighed:
            self.stopped.append(_by_user(_RIVALS_NOT_RANKED))
        if not self.stopped and result.hurried:
            self.stopped.append(_EXTRAS_SKIPPED)

    def finish(self, step: Callable[[], Answer]) -> Answer:
        """Return the result of a short step, in spite of Ctrl-C, which skips later steps."""
        answer, hurried = complete_step(step)
        if hurried and not self.stopped:
            self.stopped.append(_EXTRAS_SKIPPED)
        return answer

    def run(self, step: Step, calculate: Callable[[], Answer]) -> Answer | None:
        """Return the result of an optional step; after Ctrl-C skip it and say so."""
        if not self.stopped:
            try:
                if step.sentence:
                    self.say(step.sentence)
                return calculate()
            except KeyboardInterrupt:
                pass
        self.stopped.append(_by_user(step.skipped))
        return None
