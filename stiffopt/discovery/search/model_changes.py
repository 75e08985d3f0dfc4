"""Find changes since an extended model was made, one after another, each cross-validated."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.progress import Say
from stiffopt.discovery.search.candidates import Candidate, Scorer, scan
from stiffopt.discovery.search.joint_fit import (
    STOPPED_MESSAGE,
    fit_jointly,
    passes_thresholds,
    within_bounds,
)
from stiffopt.discovery.search.left_out_gain import select_predictive
from stiffopt.discovery.thresholds import (
    EQUIVALENT_EVIDENCE_SHARE,
    MAX_REFINED_CHANGES,
    MAX_SINGLE_CHANGE_RATIO,
    MAX_TRIED_CHANGES,
    SINGLE_CHANGE_SHARE,
)

Found = tuple[Comparison, list[LocatedEffect]]


def find_changes(
    comparison: Comparison,
    current: Comparison,
    start: Sequence[LocatedEffect],
    catalogue: Sequence[Effect],
    most: int,
    say: Say,
    tell: Say,
    *,
    keep: Callable[[Found], object],
) -> bool:
    """Find changes since an extended model; return True if Ctrl-C ended the search.

    A single change is preferred where it predicts recordings left out nearly as well as several.

    `comparison`: with the extended model. `current`: linearised about `start`. `start`: effects in
    channels that the model has no recordings of. `most`: maximum number of changes. `say`, `tell`:
    called with a sentence at every finding, and before every candidate. `keep`: called with
    comparison and effects whenever they change.
    """
    effects = list(start)
    first: list[Candidate] = []
    nothing, most = current, most + len(effects)
    try:
        while len(effects) < most:
            scorer = Scorer(current, effects)
            found = scan(scorer, catalogue, refined=MAX_REFINED_CHANGES, tell=tell)
            first = first or found
            ways = _extend_by_candidates(
                comparison, effects, [c for c in found if passes_thresholds(c, scorer)]
            )
            better = [
                w
                for w in ways
                if _negative_log_likelihood(w[0]) < _negative_log_likelihood(current)
            ]
            if not better:
                break
            current, effects, best = min(better, key=lambda way: _negative_log_likelihood(way[0]))
            keep((current, effects))
            say(f"found {best.located.label} (log evidence {best.evidence:.0f})")
        if len(effects) > len(start) + 1:
            single = _find_single_change(comparison, nothing, current, start, effects, first)
            if single is not None:
                say(f"one change does nearly as well: {single[1][-1].label}")
                keep(single)
    except KeyboardInterrupt:
        if not effects:
            raise
        say(STOPPED_MESSAGE)
        return True
    return False


def _extend_by_candidates(
    comparison: Comparison, effects: list[LocatedEffect], passing: Sequence[Candidate]
) -> Iterator[tuple[Comparison, list[LocatedEffect], Candidate]]:
    """Yield joint fits with one of the likeliest candidates each, without superseded effects.

    The noise contains the change itself, so that the evidence of all good candidates is similar:
    the smallest residual after the fit decides.
    """
    likeliest = sorted(passing, key=lambda c: -c.evidence)[:MAX_TRIED_CHANGES]
    alike = EQUIVALENT_EVIDENCE_SHARE * max((c.evidence for c in likeliest), default=0.0)
    one = False
    for candidate in likeliest:
        if one and candidate.evidence < alike:
            break
        new = candidate.located
        wider, tried = fit_jointly(comparison, [*effects, new])
        kept = _select_certain(wider, tried)
        if not any(new.same_place(other) for other in kept):
            continue
        if len(kept) < len(tried):
            wider, kept = fit_jointly(comparison, kept)
            if len(_select_certain(wider, kept)) < len(kept):
                continue
        one = True
        yield wider, kept, candidate


def _negative_log_likelihood(comparison: Comparison) -> float:
    """Return the negative log likelihood at the estimated noise, up to a constant."""
    rows = comparison.rows
    used = rows.counts > 0
    return float(rows.counts[used] @ np.log(comparison.inflation[used]))


def _find_single_change(
    comparison: Comparison,
    nothing: Comparison,
    current: Comparison,
    start: Sequence[LocatedEffect],
    effects: list[LocatedEffect],
    first: Sequence[Candidate],
) -> Found | None:
    """Return a single change that does nearly as well as several, or None.

    Gains are relative to the noise without any change, which hides smaller ones: the residual
    after the fit must be similar as well.
    """
    alone, all_ = Scorer(nothing, start), Scorer(nothing, effects)
    gained = float(np.sum(all_.by_block) - np.sum(alone.by_block))
    best = max(first[:MAX_REFINED_CHANGES], key=lambda c: c.gain)
    if best.gain <= SINGLE_CHANGE_SHARE * gained or not passes_thresholds(best, alone):
        return None
    only, single = fit_jointly(comparison, [*start, best.located])
    if np.any(only.inflation > MAX_SINGLE_CHANGE_RATIO * current.inflation):
        return None
    return (only, single) if len(_select_certain(only, single)) == len(single) else None


def _select_certain(comparison: Comparison, effects: list[LocatedEffect]) -> list[LocatedEffect]:
    """Select effects that are within bounds and help in recordings left out."""
    return within_bounds(comparison, select_predictive(comparison, effects))
