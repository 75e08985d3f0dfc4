"""Steps of a diagnosis that Ctrl-C ends or skips, and the sentences that say so."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from stiffopt.discovery.search.search import SearchResult
from stiffopt.interrupts import complete_step

Answer = TypeVar("Answer")

_SEARCH_STOPPED = (
    "Stopped by the user: only findings up to then are reported; more effects may be missing."
)
_EXTRAS_SKIPPED = (
    "Stopped by the user after the search: the findings are complete, longer calculations after"
    " it were left out."
)
_RIVALS_NOT_RANKED = (
    "Stopped by the user: findings with probability 0.5 were not compared with their rivals."
)
FRICTION_NOT_REFITTED = (
    "Stopped by the user: friction is that of the fit, without samples near standstill."
)
NO_LIMITS = "Stopped by the user: detection limits were not calculated."
NO_BURSTS = "Stopped by the user: torque bursts above the filter's band were not searched for."
BANDS_NOT_CHOSEN = "Stopped by the user: predicted torques follow the band of the fit."
BAND_NOT_VARIED = "Stopped by the user: standard deviations do not include a fit in half the band."
NOT_PERTURBED = "Stopped by the user: findings were not fitted again to perturbed runs."
NO_SIMULATION = "Stopped by the user: no simulation from commands was fitted."
NO_LAWS = "Stopped by the user: no law beyond the catalogue was searched for."
NO_EXPERIMENT = "Stopped by the user: no experiment was designed."
NO_NOISE_CEILING = "Stopped by the user: no noise ceiling was fitted."
NO_SUSPECTS = "Stopped by the user: the open residual was not searched for suspects."


def describe_stop(result: SearchResult) -> list[str]:
    """List the sentences about Ctrl-C during or after a search."""
    stopped = [_SEARCH_STOPPED] if result.stopped else []
    if not result.weighed:
        stopped.append(_RIVALS_NOT_RANKED)
    return stopped or ([_EXTRAS_SKIPPED] if result.hurried else [])


def finish_step(stopped: list[str], step: Callable[[], Answer]) -> Answer:
    """Return the result of a short step, in spite of Ctrl-C, which skips later steps."""
    answer, hurried = complete_step(step)
    if hurried and not stopped:
        stopped.append(_EXTRAS_SKIPPED)
    return answer


def skip_if_stopped(stopped: list[str], note: str, step: Callable[[], Answer]) -> Answer | None:
    """Return the result of an optional step; after Ctrl-C skip it and add the note."""
    if not stopped:
        try:
            return step()
        except KeyboardInterrupt:
            pass
    stopped.append(note)
    return None
