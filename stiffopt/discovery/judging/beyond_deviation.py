"""Findings whose own deviations say that they may be nothing: no findings.

Likelihood has found them, and what is not quite right with the law is known only once values are
asked in other ways: from stretches and runs left out, from half the band, from what a model left of
its own recordings. Where these leave a value within its own uncertainty, nobody can use it, and a
data sheet or one more recording refutes it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.search.uncertainty import Estimate
from stiffopt.discovery.thresholds import (
    NOTHING_DEVIATIONS,
    NOTHING_SHARE,
    UNSTATED_DEVIATIONS,
)

Found = tuple[tuple[Selected, ...], Estimate]


def beyond_deviation(
    selected: Sequence[Selected],
    estimated: Callable[[Sequence[Selected]], Found],
    explained: Callable[[Sequence[Selected]], Sequence[float]] | None = None,
) -> Found:
    """What was found and how sure it is, without what may be nothing: one after another.

    Parameters
    ----------
    selected : sequence of Selected
    estimated : callable
        -> those of some findings that are borne out, and all that is known of their values.
    explained : callable, optional
        -> share of its channel that each takes away in recordings left out; what takes nothing
        that can be told explains nothing.

    Notes
    -----
    What every joint has and the nominal model does not give needs no more than to be larger than
    its deviation: nobody doubts that it is there.
    """
    while True:
        kept, parameters = estimated(selected)
        excess = [_excess(each, parameters, k) for k, each in enumerate(kept)]
        if explained is not None and kept and min(excess) >= 0.0:
            # Of what every joint has nobody doubts that it is there.
            excess = [
                0.0 if each.located.effect.nominal else share - NOTHING_SHARE
                for each, share in zip(kept, explained(kept), strict=True)
            ]
        if not excess or min(excess) >= 0.0:
            return kept, parameters
        least = excess.index(min(excess))
        selected = [each for k, each in enumerate(kept) if k != least]


def _excess(selected: Selected, parameters: Estimate, index: int) -> float:
    """Deviations from nothing beyond those that a finding has to have."""
    asked = UNSTATED_DEVIATIONS if selected.located.effect.nominal else NOTHING_DEVIATIONS
    return parameters.from_nothing(index) - asked
