"""Ctrl-C in a diagnosis: what is done in spite of it, what is left out, what is said of that."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from stiffopt.discovery.search.search import SearchResult
from stiffopt.interrupts import complete_step

Answer = TypeVar("Answer")

_STOPPED = (
    "Stopped by the user: what was found until then is told, and more may be missing than that."
)
_HURRIED = (
    "Stopped by the user when the search was over: the findings are all there, and what takes"
    " longer beside them was left out."
)
_NOT_WEIGHED = (
    "Stopped by the user: what stands at a half was not weighed against what could stand in its"
    " place."
)
FITTED = "Stopped by the user: friction is that of the fit, without samples near standstill."
NO_LIMITS = "Stopped by the user: what would have been seen of other effects was not calculated."
NO_BURSTS = "Stopped by the user: nobody looked for bursts above the filter's band."
ONE_BAND = "Stopped by the user: standard deviations count nothing of what half the band says."
NO_EXPERIMENT = "Stopped by the user: no experiment was designed."
NO_ROD = "Stopped by the user: no black box was fitted to measure by."
NO_SUSPECTS = "Stopped by the user: what is left open was not asked for suspects."


def stopped_in(result: SearchResult) -> list[str]:
    """What is said of a search that Ctrl-C ended, or that it came behind."""
    stopped = [_STOPPED] if result.stopped else []
    if not result.weighed:
        stopped.append(_NOT_WEIGHED)
    return stopped or ([_HURRIED] if result.hurried else [])


def even_if_stopped(stopped: list[str], step: Callable[[], Answer]) -> Answer:
    """What a short step behind the search answers: Ctrl-C ends what comes later."""
    answer, hurried = complete_step(step)
    if hurried and not stopped:
        stopped.append(_HURRIED)
    return answer


def unless_stopped(stopped: list[str], what: str, step: Callable[[], Answer]) -> Answer | None:
    """What a step answers that can be left out: Ctrl-C does, in it or before, and `what` tells."""
    if not stopped:
        try:
            return step()
        except KeyboardInterrupt:
            pass
    stopped.append(what)
    return None
