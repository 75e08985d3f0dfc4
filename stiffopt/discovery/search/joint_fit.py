"""Effects fitted together, and which of them a search may keep."""

from __future__ import annotations

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.located_effect import LocatedEffect, places
from stiffopt.discovery.search.candidates import Candidate, Scorer
from stiffopt.discovery.search.cross_validation import held_out_shares, select_predictive
from stiffopt.discovery.search.uncertainty import jackknife_significance
from stiffopt.discovery.thresholds import (
    CONFIRMED_DEVIATIONS,
    DETERMINED_DEVIATIONS,
    LOCAL_EVIDENCE_SHARE,
    MIN_HELD_OUT_SHARE,
    NAMED_DEVIATIONS,
    NAMED_EVIDENCE,
    NAMED_SHARE,
    PRIOR_RELIEF_SHARE,
    STRICT_DEVIATIONS,
)

STOPPED_MESSAGE = "stopped: what was found so far is weighed"


def passes_thresholds(candidate: Candidate, scorer: Scorer) -> bool:
    """Whether a candidate is worth a try: sure, and seen in what is left or in nominal values."""
    if candidate.evidence < NAMED_EVIDENCE or candidate.deviations < NAMED_DEVIATIONS:
        return False
    if candidate.explained >= NAMED_SHARE and candidate.gain > 0.0:
        return True
    return _prior_relief(candidate, scorer) > PRIOR_RELIEF_SHARE * candidate.evidence


def _prior_relief(candidate: Candidate, scorer: Scorer) -> float:
    """Log prior that the nominal values regain when they need not stand in for the effect."""
    _, sd, _ = scorer.comparison.nuisance
    count = len(sd)
    without = scorer.start.mean[:count] / sd
    within = scorer.nuisance_with(candidate.located) / sd
    return 0.5 * float(without @ without - within @ within)


def fit_jointly(
    start: Comparison, effects: list[LocatedEffect]
) -> tuple[Comparison, list[LocatedEffect]]:
    """Fit all effects together: their shapes in turn, then the noise that is left."""
    current = start.about(start.fit(effects))
    refined = list(effects)
    for i, located in enumerate(effects):
        if located.effect.shapes:
            others = [e for k, e in enumerate(refined) if k != i]
            scorer = Scorer(current, others)
            scored = scorer.score(refined[i]) or _best_initial_shapes(scorer, refined[i])
            if scored is not None:
                refined[i] = scorer.refine(scored).located
    return start.about(current.fit(refined)), refined


def _best_initial_shapes(scorer: Scorer, located: LocatedEffect) -> Candidate | None:
    """The best of the shapes that an effect starts from at its place; None where none can be.

    Shapes that were fitted beside another effect may ask for amplitudes that cannot be once that
    one has gone.
    """
    comparison = scorer.comparison
    runs = [run.name for run in comparison.runs]
    found = [
        scored
        for each in places(located.effect, comparison.constants, runs)
        if each.same_place(located) and (scored := scorer.score(each)) is not None
    ]
    return max(found, key=lambda each: each.evidence, default=None)


def prune_effects(comparison: Comparison, effects: list[LocatedEffect]) -> list[LocatedEffect]:
    """Effects without which something is lost, given all others."""
    kept = [
        e
        for e in effects
        if Scorer(comparison, [o for o in effects if o is not e]).score(e) is not None
    ]
    while kept:
        losses = comparison.fit(kept).losses()
        worst = int(np.argmin(losses))
        if losses[worst] >= NAMED_EVIDENCE:
            break
        kept.pop(worst)
    return kept


def confirm_effects(
    comparison: Comparison, effects: list[LocatedEffect], *, strict: bool
) -> list[LocatedEffect]:
    """Effects that no few seconds of the recordings are alone responsible for.

    Where a few seconds hold all there is, as of a drive at its limit, those count that take away
    most of a channel's residual, in recordings left out of the fit too. Where the model is wrong in
    many ways (`strict`), each of which does that somewhere, they need deviations as well, and an
    amplitude that is known by itself, save for what every joint has.
    """
    kept = list(effects)
    while kept:
        sure, single = jackknife_significance(comparison, kept)
        weak = [int(i) for i in np.argsort(sure) if sure[i] < CONFIRMED_DEVIATIONS]
        doubted = [
            int(i)
            for i in np.argsort(sure)
            if strict
            and not kept[i].effect.nominal
            and (sure[i] < STRICT_DEVIATIONS or single[i] < DETERMINED_DEVIATIONS)
        ]
        unproved = (i for i in weak if not _is_locally_supported(comparison, kept, i))
        lost = doubted[0] if doubted else next(unproved, None)
        if lost is None:
            break
        kept.pop(lost)
    return kept


def select_supported(
    comparison: Comparison, effects: list[LocatedEffect], *, strict: bool
) -> list[LocatedEffect]:
    """Effects that are confirmed and that recordings left out bear out.

    Where somebody vouches for the nominal model less is asked: to take away something there at all,
    or that nominal values would have to leave their tolerances to stand in for it, since what is
    left of recordings does not tell the two apart.
    """
    sure = confirm_effects(comparison, effects, strict=strict)
    if strict:
        return select_predictive(comparison, sure)
    shares = held_out_shares(comparison, sure)
    return [
        e
        for e, share in zip(sure, shares, strict=True)
        if e.run is not None
        or share >= MIN_HELD_OUT_SHARE
        or _is_supported_by_nominal(comparison, sure, e)
    ]


def _is_supported_by_nominal(
    comparison: Comparison, effects: list[LocatedEffect], located: LocatedEffect
) -> bool:
    """Whether most of the evidence for an effect is that nominal values stay where they belong."""
    scorer = Scorer(comparison, [e for e in effects if e is not located])
    own = scorer.score(located)
    return own is not None and _prior_relief(own, scorer) > PRIOR_RELIEF_SHARE * own.evidence


def _is_locally_supported(comparison: Comparison, effects: list[LocatedEffect], index: int) -> bool:
    others = [e for k, e in enumerate(effects) if k != index]
    own = Scorer(comparison, others).score(effects[index])
    if own is None or own.explained <= LOCAL_EVIDENCE_SHARE:
        return False
    return own.gain > LOCAL_EVIDENCE_SHARE * own.evidence
