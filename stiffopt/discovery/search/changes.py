"""What has changed since an extended model was made: one thing after another, each borne out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.search.candidates import Candidate, Scorer, scan
from stiffopt.discovery.search.joint_fit import STOPPED, confirmed, fitted_jointly, passes
from stiffopt.discovery.search.left_out import borne_out
from stiffopt.discovery.thresholds import (
    CHANGES_ALIKE,
    CHANGES_REFINED,
    CHANGES_TRIED,
    SPARSE_LEFT,
    SPARSE_SHARE,
)

Found = tuple[Comparison, list[LocatedEffect]]


def changes(
    comparison: Comparison,
    current: Comparison,
    start: Sequence[LocatedEffect],
    catalogue: Sequence[Effect],
    most: int,
    say: Callable[[str], object],
    tell: Callable[[str], object],
    *,
    keep: Callable[[Found], object],
) -> bool:
    """Tell what has changed, and return whether Ctrl-C ended the search for it.

    Where one change predicts recordings left out nearly as well as several, it is that one.

    Parameters
    ----------
    comparison : Comparison
        With an extended model.
    current : Comparison
        About what is given.
    start : sequence of LocatedEffect
        Given: what the model says nothing of.
    catalogue : sequence of Effect
    most : int
        Changes at most.
    say, tell : callable
        Called with a sentence at every finding, before every try.
    keep : callable
        Called with what was found so far, and the comparison about it, whenever that changes.
    """
    effects = list(start)
    first: list[Candidate] = []
    nothing, most = current, most + len(effects)
    try:
        while len(effects) < most:
            scorer = Scorer(current, effects)
            found = scan(scorer, catalogue, refined=CHANGES_REFINED, tell=tell)
            first = first or found
            ways = _ways(comparison, effects, [c for c in found if passes(c, scorer)])
            better = [w for w in ways if _left(w[0]) < _left(current)]
            if not better:
                break
            current, effects, best = min(better, key=lambda way: _left(way[0]))
            keep((current, effects))
            say(f"found {best.located.label} (log evidence {best.evidence:.0f})")
        if len(effects) > len(start) + 1:
            single = _single_change(comparison, nothing, current, start, effects, first)
            if single is not None:
                say(f"one change does nearly as well: {single[1][-1].label}")
                keep(single)
    except KeyboardInterrupt:
        if not effects:
            raise
        say(STOPPED)
        return True
    return False


def _ways(
    comparison: Comparison, effects: list[LocatedEffect], passing: Sequence[Candidate]
) -> Iterator[tuple[Comparison, list[LocatedEffect], Candidate]]:
    """Ways to go on, each with one of the likeliest candidates; what it makes needless goes.

    Beside a noise that holds the change itself, evidence of all that takes most of it is alike: of
    those the one is right that leaves least once it is fitted.
    """
    likeliest = sorted(passing, key=lambda c: -c.evidence)[:CHANGES_TRIED]
    alike = CHANGES_ALIKE * max((c.evidence for c in likeliest), default=0.0)
    one = False
    for candidate in likeliest:
        if one and candidate.evidence < alike:
            break
        new = candidate.located
        wider, tried = fitted_jointly(comparison, [*effects, new])
        kept = _borne_out(wider, tried)
        if not any(new.same_place(other) for other in kept):
            continue
        if len(kept) < len(tried):
            wider, kept = fitted_jointly(comparison, kept)
            if len(_borne_out(wider, kept)) < len(kept):
                continue
        one = True
        yield wider, kept, candidate


def _left(comparison: Comparison) -> float:
    """Negative log likelihood at the noise that is left, but for a constant."""
    rows = comparison.rows
    used = rows.counts > 0
    return float(rows.counts[used] @ np.log(comparison.inflation[used]))


def _single_change(
    comparison: Comparison,
    nothing: Comparison,
    current: Comparison,
    start: Sequence[LocatedEffect],
    effects: list[LocatedEffect],
    first: Sequence[Candidate],
) -> Found | None:
    """The one change that does nearly as well as several, beside what is given, or None.

    Gains are over the noise that no change leaves, beside which a smaller change is nothing: what
    is left once it is fitted decides.
    """
    alone, all_ = Scorer(nothing, start), Scorer(nothing, effects)
    gained = float(np.sum(all_.by_block) - np.sum(alone.by_block))
    best = max(first[:CHANGES_REFINED], key=lambda c: c.gain)
    if best.gain <= SPARSE_SHARE * gained or not passes(best, alone):
        return None
    only, single = fitted_jointly(comparison, [*start, best.located])
    if np.any(only.inflation > SPARSE_LEFT * current.inflation):
        return None
    return (only, single) if len(_borne_out(only, single)) == len(single) else None


def _borne_out(comparison: Comparison, effects: list[LocatedEffect]) -> list[LocatedEffect]:
    """Those that are certain, within their bounds, and help in recordings left out."""
    kept = borne_out(comparison, confirmed(comparison, effects, strict=True))
    return [e for e in kept if _within_bounds(comparison, kept, e)]


def _within_bounds(
    comparison: Comparison, effects: Sequence[LocatedEffect], located: LocatedEffect
) -> bool:
    others = [e for e in effects if e is not located]
    return Scorer(comparison, others).score(located) is not None
