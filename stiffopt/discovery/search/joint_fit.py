"""Fit effects together, and remove those without evidence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.located_effect import LocatedEffect, effect_places
from stiffopt.discovery.search.candidates import Candidate, Scorer
from stiffopt.discovery.thresholds import NAMED_EVIDENCE, NAMED_SHARE, PRIOR_RELIEF_SHARE

STOPPED_MESSAGE = "stopped: the findings up to now are assessed"


def passes_thresholds(candidate: Candidate, scorer: Scorer) -> bool:
    """True if a candidate is significant and improves the residual or nominal values enough."""
    if candidate.evidence < NAMED_EVIDENCE:
        return False
    if candidate.explained >= NAMED_SHARE:
        return True
    return scorer.prior_relief(candidate.located) > PRIOR_RELIEF_SHARE * candidate.evidence


def fit_jointly(
    start: Comparison, effects: list[LocatedEffect]
) -> tuple[Comparison, list[LocatedEffect]]:
    """Fit all effects together: their shapes in turn, then the noise."""
    current = start.linearised_at(start.fit(effects))
    refined = list(effects)
    for i, located in enumerate(effects):
        if located.effect.shapes:
            others = [e for k, e in enumerate(refined) if k != i]
            scorer = Scorer(current, others)
            scored = scorer.score(refined[i]) or _best_initial_shapes(scorer, refined[i])
            if scored is not None:
                refined[i] = scorer.refine(scored).located
    return start.linearised_at(current.fit(refined)), refined


def _best_initial_shapes(scorer: Scorer, located: LocatedEffect) -> Candidate | None:
    """Return the best initial shapes of an effect at its place; None if none is possible.

    Shapes fitted beside another effect may need impossible amplitudes after its removal.
    """
    comparison = scorer.comparison
    runs = [run.name for run in comparison.runs]
    found = [
        scored
        for each in effect_places(located.effect, comparison.constants, runs)
        if each.same_place(located) and (scored := scorer.score(each)) is not None
    ]
    return max(found, key=lambda each: each.evidence, default=None)


def within_bounds(comparison: Comparison, effects: Sequence[LocatedEffect]) -> list[LocatedEffect]:
    """Return the effects that are within their bounds beside all others."""
    return [
        e
        for e in effects
        if Scorer(comparison, [o for o in effects if o is not e]).score(e) is not None
    ]


def prune_effects(comparison: Comparison, effects: list[LocatedEffect]) -> list[LocatedEffect]:
    """Remove effects without which the evidence hardly falls, the least first.

    Calibrated values are removed only outside their bounds.
    """
    kept = within_bounds(comparison, effects)
    while not all(e.calibrated for e in kept):
        losses = comparison.fit(kept).evidence_losses()
        losses[[e.calibrated for e in kept]] = np.inf
        worst = int(np.argmin(losses))
        if losses[worst] >= NAMED_EVIDENCE:
            break
        kept.pop(worst)
    return kept
