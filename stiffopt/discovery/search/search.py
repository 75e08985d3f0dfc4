"""Find the effects that are missing: forward, backward, and what they are confused with."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison, Fit
from stiffopt.discovery.comparison.extension import with_amplitudes
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.search.candidates import Candidate, Scorer, scan
from stiffopt.discovery.search.rivals import Ranked, Selected, ranked_among_rivals
from stiffopt.discovery.search.uncertainty import significance
from stiffopt.discovery.thresholds import (
    BORNE_OUT_SHARE,
    CONFIRMED_DEVIATIONS,
    EXCHANGES,
    NAMED_DEVIATIONS,
    NAMED_EVIDENCE,
    NAMED_SHARE,
    RELIEF_SHARE,
)


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
    before, calibrated, after : array (2 n,)
        Residual over noise in every channel: of the nominal model, with nominal values moved
        within tolerance, and with the effects.
    """

    selected: tuple[Selected, ...]
    comparison: Comparison
    fit: Fit
    before: np.ndarray
    calibrated: np.ndarray
    after: np.ndarray

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
    report : callable, optional
        Called with a sentence at every step.
    """
    say = report or (lambda _: None)
    tell = paced(say)
    before = comparison.channel_ratio(comparison.target)
    calibrated = comparison.channel_ratio(comparison.fit().residual)
    current = _about(comparison, comparison.fit(boxed=False))
    effects: list[LocatedEffect] = []
    if start:
        say(f"fit what the nominal model does not state ({len(start)} values)")
        current, effects = _fitted_jointly(comparison, list(start))
        effects = _pruned(current, effects)
        current, effects = _fitted_jointly(comparison, effects)
    most += len(effects)
    while len(effects) < most:
        scorer = Scorer(current, effects)
        found = scan(scorer, catalogue, tell=tell)
        best = next((c for c in found if _passes(c, scorer)), None)
        if best is None:
            break
        say(f"found {best.located.label} (log evidence {best.evidence:.0f})")
        effects.append(best.located)
        current, effects = _fitted_jointly(comparison, effects)
        kept = _pruned(current, effects)
        if best.located.label not in [e.label for e in kept]:
            effects = kept
            break
        effects = kept
    current, effects = _fitted_jointly(comparison, effects)
    if effects:
        say(f"confirm what was found ({len(effects)}) on stretches left out")
    confirmed = _confirmed(current, effects)
    if len(confirmed) < len(effects):
        current, effects = _fitted_jointly(comparison, confirmed)
    if effects:
        say("weigh what was found against what else it could be")
    ranked = _ranked(current, effects, catalogue)
    for _ in range(EXCHANGES):
        likelier = _distinct([r.likeliest for r in ranked])
        if likelier == effects:
            break
        current, effects = _fitted_jointly(comparison, likelier)
        ranked = _ranked(current, effects, catalogue)
    else:
        # Explanations that go on taking each other's place explain nothing.
        kept = [r.selected.located for r in ranked if r.likeliest is r.selected.located]
        if len(kept) < len(effects):
            current, effects = _fitted_jointly(comparison, kept)
            ranked = _ranked(current, effects, catalogue)
    kept = [r.selected.located for r in ranked]
    if len(kept) < len(effects):
        current, effects = _fitted_jointly(comparison, kept)
    selected = sorted((r.selected for r in ranked), key=lambda s: -s.loss)
    fit = current.fit(tuple(s.located for s in selected))
    return SearchResult(
        tuple(selected), current, fit, before, calibrated, current.channel_ratio(fit.residual)
    )


def paced(say: Callable[[str], object], seconds: float = 5.0) -> Callable[[str], object]:
    """Pass on a sentence when the last one is some seconds old: many small steps, few lines."""
    last = time.monotonic()

    def tell(sentence: str) -> None:
        nonlocal last
        if time.monotonic() - last >= seconds:
            last = time.monotonic()
            say(sentence)

    return tell


def _ranked(
    comparison: Comparison, effects: list[LocatedEffect], catalogue: Sequence[Effect]
) -> list[Ranked]:
    """Effects among their rivals, without those that have come to nothing beside the others."""
    found = (ranked_among_rivals(comparison, effects, e, catalogue) for e in effects)
    return [each for each in found if each is not None]


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


def _about(comparison: Comparison, fit: Fit) -> Comparison:
    """The comparison about a fit: joints wound up as found, with the noise left in each channel."""
    left = np.nan_to_num(comparison.channel_ratio(fit.residual), nan=1.0)
    return Comparison(
        comparison.robot,
        comparison.nominal_runs,
        comparison.noise,
        comparison.tolerance,
        link_torque=_link_torque(comparison, fit),
        inflation=np.maximum(1.0, left),
        box=comparison.box,
    )


def _link_torque(comparison: Comparison, fit: Fit) -> list[np.ndarray] | None:
    """Torque (K, n) that the effects of a fit put into the joints of every run."""
    sizes = [located.sizes(comparison.constants) for located in fit.effects]
    effects = with_amplitudes(fit.effects, fit.amplitudes(), sizes)
    per_run = [
        [each.located.contribution(run, each.amplitudes).link_torque for each in effects]
        for run in comparison.nominal_runs
    ]
    if all(part is None for parts in per_run for part in parts):
        return None
    return [
        sum((p for p in parts if p is not None), np.zeros_like(run.signals.spring_torque))
        for run, parts in zip(comparison.nominal_runs, per_run, strict=True)
    ]


def _fitted_jointly(
    start: Comparison, effects: list[LocatedEffect]
) -> tuple[Comparison, list[LocatedEffect]]:
    """Fit all effects together: their shapes in turn, then the noise that is left."""
    current = _about(start, start.fit(effects))
    refined = list(effects)
    for i, located in enumerate(effects):
        if located.effect.shapes:
            others = [e for k, e in enumerate(refined) if k != i]
            scorer = Scorer(current, others)
            scored = scorer.score(refined[i])
            if scored is not None:
                refined[i] = scorer.refine(scored).located
    return _about(start, current.fit(refined)), refined


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


def _confirmed(comparison: Comparison, effects: list[LocatedEffect]) -> list[LocatedEffect]:
    """Effects that no few seconds of the recordings are alone responsible for.

    Where a few seconds hold all there is, as of a drive at its limit, those count that take away
    most of a channel's residual, in recordings left out of the fit too.
    """
    kept = list(effects)
    while kept:
        sure = significance(comparison, kept)
        weak = [int(i) for i in np.argsort(sure) if sure[i] < CONFIRMED_DEVIATIONS]
        lost = next((i for i in weak if not _borne_out(comparison, kept, i)), None)
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
