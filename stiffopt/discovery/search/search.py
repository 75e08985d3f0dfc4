"""Find the effects that are missing: forward, backward, and what they are confused with."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison, Fit
from stiffopt.discovery.comparison.extension import Extension
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.search.candidates import Candidate, Scorer, scan
from stiffopt.discovery.search.left_out import borne_out
from stiffopt.discovery.search.pace import Pace, paced
from stiffopt.discovery.search.rigid import RigidStage, rigid_stage
from stiffopt.discovery.search.rivals import Ranked, Selected, ranked_among_rivals
from stiffopt.discovery.search.uncertainty import significance
from stiffopt.discovery.thresholds import (
    AT_ONCE,
    BORNE_OUT_SHARE,
    CHANGES_REFINED,
    CHANGES_TRIED,
    CONFIRMED_DEVIATIONS,
    DETERMINED_DEVIATIONS,
    EXCHANGES,
    NAMED_DEVIATIONS,
    NAMED_EVIDENCE,
    NAMED_SHARE,
    RELIEF_SHARE,
    SETTLED,
    SETTLED_DEVIATIONS,
    SETTLING_ROUNDS,
    SPARSE_LEFT,
    SPARSE_SHARE,
    STRICT_DEVIATIONS,
)

_STOPPED = "stopped: what was found so far is weighed"


@dataclass(frozen=True, eq=False)
class SearchResult:
    """End of a search.

    Parameters
    ----------
    selected : tuple of Selected
        By falling loss.
    comparison : Comparison
        About the effects found, with the noise that they leave.
    fit : Fit
    rigid : RigidStage or None
        What the rigid model needed; None where its tolerances are stated.
    before, calibrated, after : array (2 n,)
        Residual over noise in every channel: of the nominal model, with nominal values moved
        within tolerance, and with the effects.
    target : array (m,)
        What the nominal model leaves, over the stated noise: the rows of `before`.
    stopped : bool
        By Ctrl-C, before everything was searched for.
    """

    selected: tuple[Selected, ...]
    comparison: Comparison
    fit: Fit
    rigid: RigidStage | None
    before: np.ndarray
    calibrated: np.ndarray
    after: np.ndarray
    target: np.ndarray
    stopped: bool = False

    @property
    def effects(self) -> tuple[LocatedEffect, ...]:
        """The effects found."""
        return tuple(s.located for s in self.selected)


def search(
    comparison: Comparison,
    catalogue: Sequence[Effect],
    *,
    start: Sequence[LocatedEffect] = (),
    most: int = 3,
    strict: bool = False,
    reidentify: bool = False,
    about: Extension | None = None,
    report: Callable[[str], object] | None = None,
) -> SearchResult:
    """Name what is missing.

    Parameters
    ----------
    comparison : Comparison
        With the nominal model.
    catalogue : sequence of Effect
    start : sequence of LocatedEffect
        Tried together before anything else: what the nominal model does not state.
    most : int
        Effects at most beside those.
    strict : bool
        Whether nobody vouches for the nominal model: only what recordings left out bear out stays.
    reidentify : bool
        Whether the rigid model is re-identified first.
    about : Extension, optional
        Found otherwise: links move with it at first, and its effects are judged before others.
    report : callable, optional
        Called with a sentence at every step.
    """
    say = report or (lambda _: None)
    tell = paced(say)
    target = comparison.target * comparison.inflation[comparison.rows.channel]
    before = comparison.channel_ratio(target)
    calibrated = comparison.channel_ratio(comparison.fit().residual)
    current, effects = _not_stated(comparison, list(start), say)
    rigid = None
    if reidentify:
        say("re-identify the rigid model")
        rigid = rigid_stage(current, effects, catalogue)
        comparison = comparison.with_bodies(rigid.bodies(comparison))
        # All of it again: what a wrong mass had hidden is seen now.
        single = () if rigid.single is None else (rigid.single.located,)
        current, effects = _not_stated(comparison, [*start, *single], say)
    if about is not None:
        # Slopes about the nominal motion lead away from it.
        comparison = comparison.moved(about)
        current, effects = _fitted_jointly(comparison, [each.located for each in about.effects])
        effects = _pruned(current, effects)
    if comparison.after_model:
        current, effects, stopped = _changes(comparison, current, catalogue, most, say, tell)
    else:
        together = AT_ONCE if strict else 1
        current, effects, stopped = _forward(
            comparison, current, effects, catalogue, most, together, say, tell
        )
    if effects:
        say(f"confirm what was found ({len(effects)}) on stretches left out")
    confirmed = _confirmed(current, effects, strict=strict)
    if strict:
        confirmed = borne_out(current, confirmed)
    if len(confirmed) < len(effects):
        lost = [e for e in effects if e not in confirmed]
        current, effects = _fitted_jointly(comparison, confirmed)
        if strict:
            current, effects = _added_again(comparison, current, effects, lost)
    current, ranked = _exchanged(comparison, current, effects, catalogue, tell)
    for _ in range(EXCHANGES if strict else 0):
        effects = [r.selected.located for r in ranked]
        kept = borne_out(current, _confirmed(current, effects, strict=True))
        if len(kept) == len(effects):
            break
        current, kept = _fitted_jointly(comparison, kept)
        current, ranked = _exchanged(comparison, current, kept, catalogue, tell, ranked)
    if strict:
        effects = [r.selected.located for r in ranked]
        lost = [e for e in start if not any(e.same_place(other) for other in effects)]
        current, ranked = _restored(comparison, current, ranked, lost, catalogue, tell)
    selected = sorted((r.selected for r in ranked), key=lambda s: -s.loss)
    current, fit = _relinearised(comparison, current, tuple(s.located for s in selected))
    return SearchResult(
        tuple(selected),
        current,
        fit,
        rigid,
        before,
        calibrated,
        current.channel_ratio(fit.residual),
        target,
        stopped,
    )


def _relinearised(
    start: Comparison, current: Comparison, effects: Sequence[LocatedEffect]
) -> tuple[Comparison, Fit]:
    """Fit taken about itself until it stays: slopes about another motion bias what is found."""
    fit = current.fit(effects)
    for _ in range(SETTLING_ROUNDS if effects else 0):
        again = start.about(fit, SETTLED)
        if again.columns is current.columns:
            break
        before, fit, current = fit, again.fit(effects), again
        moved = (fit.amplitudes() - before.amplitudes()) ** 2
        own = np.diag(fit.posterior.covariance)[fit.nuisance :]
        if np.all(moved < SETTLED_DEVIATIONS**2 * own):
            break
    return current, fit


def _not_stated(
    comparison: Comparison, start: list[LocatedEffect], say: Callable[[str], object]
) -> tuple[Comparison, list[LocatedEffect]]:
    """Fit what the nominal model does not state, without what the recordings do not bear out."""
    if not start:
        return comparison.about(comparison.fit(boxed=False)), []
    say(f"fit what the nominal model does not state ({len(start)} values)")
    current, effects = _fitted_jointly(comparison, start)
    return _fitted_jointly(comparison, _pruned(current, effects))


def _added_again(
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
        passing = [(c, e) for c, e in scored if _passes(c, scorer)]
        if not passing:
            break
        best = max(passing, key=lambda pair: pair[0].evidence)[1]
        waiting = [e for _, e in passing if e is not best]
        wider, tried = _fitted_jointly(comparison, [*effects, best])
        judged = borne_out(wider, _confirmed(wider, tried, strict=True))
        if any(best.same_place(other) for other in judged):
            current, effects = wider, tried
    return current, effects


def _restored(
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
        wider, found = _fitted_jointly(comparison, [*effects, *lost])
        found = borne_out(wider, _pruned(wider, found))
        found = _confirmed(wider, found, strict=True)
        kept = [e for e in lost if any(e.same_place(other) for other in found)]
        if len(kept) == len(lost):
            scorer = Scorer(wider, found)
            for each in effects:
                if not any(each.same_place(other) for other in found):
                    beside = scorer.score(each)
                    if beside is not None and beside.evidence > NAMED_EVIDENCE:
                        found.append(each)
            wider, found = _fitted_jointly(comparison, found)
            weighed = _ranked(wider, found, catalogue, tell, ranked)
            unlikely = [
                r.selected.located for r in weighed if r.likeliest is not r.selected.located
            ]
            kept = [e for e in lost if not any(e.same_place(other) for other in unlikely)]
            if len(kept) == len(lost):
                return wider, weighed
        lost = kept
    return current, ranked


def _forward(
    comparison: Comparison,
    current: Comparison,
    effects: list[LocatedEffect],
    catalogue: Sequence[Effect],
    most: int,
    together: int,
    say: Callable[[str], object],
    tell: Callable[[str], object],
) -> tuple[Comparison, list[LocatedEffect], bool]:
    """Add the best of the catalogue, some at once, until nothing more passes, or Ctrl-C."""
    most += len(effects)
    stopped = False
    while len(effects) < most:
        scorer = Scorer(current, effects)
        room = min(together, most - len(effects))
        try:
            best = _best(scan(scorer, catalogue, tell=tell), scorer, room)
            if not best:
                break
            for each in best:
                say(f"found {each.located.label} (log evidence {each.evidence:.0f})")
            wider, tried = _fitted_jointly(comparison, [*effects, *(e.located for e in best)])
            current, effects = wider, _pruned(wider, tried)
        except KeyboardInterrupt:
            if not effects:  # there is nothing to tell
                raise
            say(_STOPPED)
            stopped = True
            break
        if best[0].located.label not in [e.label for e in effects]:
            break
    return *_fitted_jointly(comparison, effects), stopped


def _changes(
    comparison: Comparison,
    current: Comparison,
    catalogue: Sequence[Effect],
    most: int,
    say: Callable[[str], object],
    tell: Callable[[str], object],
) -> tuple[Comparison, list[LocatedEffect], bool]:
    """What has changed since the model was made: one thing after another, each borne out.

    Where one change predicts recordings left out nearly as well as several, it is that one.
    """
    effects: list[LocatedEffect] = []
    first: list[Candidate] = []
    nothing = current
    try:
        while len(effects) < most:
            scorer = Scorer(current, effects)
            found = scan(scorer, catalogue, refined=CHANGES_REFINED, tell=tell)
            first = first or found
            passing = [c for c in found if _passes(c, scorer)]
            for candidate in sorted(passing, key=lambda c: -c.evidence)[:CHANGES_TRIED]:
                wider, tried = _fitted_jointly(comparison, [*effects, candidate.located])
                if _all_borne_out(wider, tried):
                    say(f"found {candidate.located.label} (log evidence {candidate.evidence:.0f})")
                    current, effects = wider, tried
                    break
            else:
                break
        if len(effects) > 1:
            single = _single_change(comparison, nothing, current, effects, first)
            if single is not None:
                say(f"one change does nearly as well: {single[1][0].label}")
                current, effects = single
    except KeyboardInterrupt:
        if not effects:
            raise
        say(_STOPPED)
        return current, effects, True
    return current, effects, False


def _single_change(
    comparison: Comparison,
    nothing: Comparison,
    current: Comparison,
    effects: list[LocatedEffect],
    first: Sequence[Candidate],
) -> tuple[Comparison, list[LocatedEffect]] | None:
    """The one change that does nearly as well as several, or None.

    Gains are over the noise that no change leaves, beside which a smaller change is nothing: what
    is left once it is fitted decides.
    """
    alone, all_ = Scorer(nothing), Scorer(nothing, effects)
    gained = float(np.sum(all_.by_block) - np.sum(alone.by_block))
    best = max(first[:CHANGES_REFINED], key=lambda c: c.gain)
    if best.gain <= SPARSE_SHARE * gained or not _passes(best, alone):
        return None
    only, single = _fitted_jointly(comparison, [best.located])
    if np.any(only.inflation > SPARSE_LEFT * current.inflation):
        return None
    return (only, single) if _all_borne_out(only, single) else None


def _all_borne_out(comparison: Comparison, effects: list[LocatedEffect]) -> bool:
    kept = borne_out(comparison, _confirmed(comparison, effects, strict=True))
    return len(kept) == len(effects)


def _exchanged(
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
        current, effects = _fitted_jointly(comparison, likelier)
        ranked = _ranked(current, effects, catalogue, tell, ranked)
    else:
        # Explanations that go on taking each other's place explain nothing.
        kept = [r.selected.located for r in ranked if r.likeliest is r.selected.located]
        if len(kept) < len(effects):
            current, effects = _fitted_jointly(comparison, kept)
            ranked = _ranked(current, effects, catalogue, tell)
    if len(ranked) < len(effects):
        current, effects = _fitted_jointly(comparison, [r.selected.located for r in ranked])
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
        if old is not None and not any(located.near(other) for other in changed):
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


def _best(candidates: Sequence[Candidate], scorer: Scorer, most: int) -> list[Candidate]:
    """The best that pass, at most one for every channel: others may have the same cause."""
    found: list[Candidate] = []
    for candidate in candidates:
        if len(found) == most or candidate.evidence < NAMED_EVIDENCE:
            break
        if candidate.channel not in [c.channel for c in found] and _passes(candidate, scorer):
            found.append(candidate)
    return found


def _passes(candidate: Candidate, scorer: Scorer) -> bool:
    if candidate.evidence < NAMED_EVIDENCE or candidate.deviations < NAMED_DEVIATIONS:
        return False
    if candidate.explained >= NAMED_SHARE and candidate.gain > 0.0:
        return True
    return _relief(candidate, scorer) > RELIEF_SHARE * candidate.evidence


def _relief(candidate: Candidate, scorer: Scorer) -> float:
    """Log prior that the nominal values regain when they need not stand in for the effect."""
    _, sd, _ = scorer.comparison.nuisance
    count = len(sd)
    without = scorer.start.mean[:count] / sd
    within = scorer.nuisance_beside(candidate.located) / sd
    return 0.5 * float(without @ without - within @ within)


def _fitted_jointly(
    start: Comparison, effects: list[LocatedEffect]
) -> tuple[Comparison, list[LocatedEffect]]:
    """Fit all effects together: their shapes in turn, then the noise that is left."""
    current = start.about(start.fit(effects))
    refined = list(effects)
    for i, located in enumerate(effects):
        if located.effect.shapes:
            others = [e for k, e in enumerate(refined) if k != i]
            scorer = Scorer(current, others)
            scored = scorer.score(refined[i])
            if scored is not None:
                refined[i] = scorer.refine(scored).located
    return start.about(current.fit(refined)), refined


def _pruned(comparison: Comparison, effects: list[LocatedEffect]) -> list[LocatedEffect]:
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


def _confirmed(
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
        sure, single = significance(comparison, kept)
        weak = [int(i) for i in np.argsort(sure) if sure[i] < CONFIRMED_DEVIATIONS]
        doubted = [
            int(i)
            for i in np.argsort(sure)
            if strict
            and not kept[i].effect.nominal
            and (sure[i] < STRICT_DEVIATIONS or single[i] < DETERMINED_DEVIATIONS)
        ]
        unproved = (i for i in weak if not _borne_out(comparison, kept, i))
        lost = doubted[0] if doubted else next(unproved, None)
        if lost is None:
            break
        kept.pop(lost)
    return kept


def _borne_out(comparison: Comparison, effects: list[LocatedEffect], index: int) -> bool:
    others = [e for k, e in enumerate(effects) if k != index]
    own = Scorer(comparison, others).score(effects[index])
    if own is None or own.explained <= BORNE_OUT_SHARE:
        return False
    return own.gain > BORNE_OUT_SHARE * own.evidence


def _distinct(effects: Sequence[LocatedEffect]) -> list[LocatedEffect]:
    """Each place once: one effect may be likelier than several that stood in for it."""
    kept: list[LocatedEffect] = []
    for located in effects:
        if not any(located.same_place(other) for other in kept):
            kept.append(located)
    return kept
