"""Effects in each other's place: rivals that are likelier, and what comes back once they went."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.search.candidates import Scorer
from stiffopt.discovery.search.joint_fit import (
    confirmed,
    fitted_jointly,
    passes,
    pruned,
)
from stiffopt.discovery.search.left_out import borne_out
from stiffopt.discovery.search.pace import Pace
from stiffopt.discovery.search.rivals import Ranked, ranked_among_rivals
from stiffopt.discovery.thresholds import (
    EXCHANGES,
    NAMED_EVIDENCE,
)


def exchanged(
    comparison: Comparison,
    current: Comparison,
    effects: list[LocatedEffect],
    catalogue: Sequence[Effect],
    tell: Callable[[str], object],
    before: Sequence[Ranked] = (),
) -> tuple[Comparison, list[Ranked]]:
    """Effects among their rivals, each in the place of the likeliest."""
    ranked = _ranked(current, effects, catalogue, tell, before)
    for _ in range(EXCHANGES):
        likelier = _distinct([r.likeliest for r in ranked])
        if likelier == effects:
            break
        current, effects = fitted_jointly(comparison, likelier)
        ranked = _ranked(current, effects, catalogue, tell, ranked)
    else:
        # Explanations that go on taking each other's place explain nothing.
        kept = [r.selected.located for r in ranked if r.likeliest is r.selected.located]
        if len(kept) < len(effects):
            current, effects = fitted_jointly(comparison, kept)
            ranked = _ranked(current, effects, catalogue, tell)
    if len(ranked) < len(effects):
        current, effects = fitted_jointly(comparison, [r.selected.located for r in ranked])
        ranked = _ranked(current, effects, catalogue, tell, ranked)
    return current, ranked


def _ranked(
    comparison: Comparison,
    effects: list[LocatedEffect],
    catalogue: Sequence[Effect],
    say: Callable[[str], object],
    before: Sequence[Ranked] = (),
) -> list[Ranked]:
    """Effects among their rivals, without those that have come to nothing beside the others.

    What was weighed before stays where nothing near it has changed.
    """
    known = {r.selected.located.key[:-1]: r for r in before}
    places = {e.key[:-1] for e in effects}
    changed = [e for e in effects if e.key[:-1] not in known]
    changed += [r.selected.located for key, r in known.items() if key not in places]
    found = []
    pace = Pace(len(effects))
    for number, located in enumerate(effects):
        old = known.get(located.key[:-1])
        if old is not None and not any(located.is_adjacent(other) for other in changed):
            stays = old.likeliest.same_place(located)
            found.append(
                Ranked(replace(old.selected, located=located), located if stays else old.likeliest)
            )
            continue
        what = f"weigh {located.label} against what could stand in its place"
        say(f"{what} ({pace.words(number)})")
        new = ranked_among_rivals(comparison, effects, located, catalogue, tell=say)
        if new is not None:
            found.append(new)
    return found


def added_again(
    comparison: Comparison,
    current: Comparison,
    effects: list[LocatedEffect],
    lost: list[LocatedEffect],
) -> tuple[Comparison, list[LocatedEffect]]:
    """Effects with those of the lost that are borne out one by one, the likeliest first.

    Of two that stand in for each other neither is missed, until the other has gone.
    """
    waiting = list(lost)
    while waiting:
        scorer = Scorer(current, effects)
        scored = [(c, e) for e in waiting if (c := scorer.score(e)) is not None]
        passing = [(c, e) for c, e in scored if passes(c, scorer)]
        if not passing:
            break
        best = max(passing, key=lambda pair: pair[0].evidence)[1]
        waiting = [e for _, e in passing if e is not best]
        wider, tried = fitted_jointly(comparison, [*effects, best])
        judged = borne_out(wider, confirmed(wider, tried, strict=True))
        if any(best.same_place(other) for other in judged):
            current, effects = wider, tried
    return current, effects


def restored(
    comparison: Comparison,
    current: Comparison,
    ranked: list[Ranked],
    lost: list[LocatedEffect],
    catalogue: Sequence[Effect],
    tell: Callable[[str], object],
) -> tuple[Comparison, list[Ranked]]:
    """Effects with what every joint has, where what stood in its place has gone meanwhile.

    What comes to nothing beside it stood in its place still.
    """
    effects = [r.selected.located for r in ranked]
    while lost:
        wider, found = fitted_jointly(comparison, [*effects, *lost])
        found = borne_out(wider, pruned(wider, found))
        found = confirmed(wider, found, strict=True)
        kept = [e for e in lost if any(e.same_place(other) for other in found)]
        if len(kept) == len(lost):
            scorer = Scorer(wider, found)
            for each in effects:
                if not any(each.same_place(other) for other in found):
                    beside = scorer.score(each)
                    if beside is not None and beside.evidence > NAMED_EVIDENCE:
                        found.append(each)
            wider, found = fitted_jointly(comparison, found)
            weighed = _ranked(wider, found, catalogue, tell, ranked)
            unlikely = [
                r.selected.located for r in weighed if r.likeliest is not r.selected.located
            ]
            kept = [e for e in lost if not any(e.same_place(other) for other in unlikely)]
            if len(kept) == len(lost):
                return wider, weighed
        lost = kept
    return current, ranked


def _distinct(effects: Sequence[LocatedEffect]) -> list[LocatedEffect]:
    """Each place once: one effect may be likelier than several that stood in for it."""
    kept: list[LocatedEffect] = []
    for located in effects:
        if not any(located.same_place(other) for other in kept):
            kept.append(located)
    return kept
