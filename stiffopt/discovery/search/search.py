"""Find the effects that are missing: forward, backward, and what they are confused with."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison, Fit
from stiffopt.discovery.comparison.extension import Extension
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.progress import throttle_progress
from stiffopt.discovery.search.candidates import Candidate, Scorer, scan
from stiffopt.discovery.search.joint_fit import (
    STOPPED_MESSAGE,
    fit_jointly,
    passes_thresholds,
    prune_effects,
    select_supported,
)
from stiffopt.discovery.search.model_changes import find_changes
from stiffopt.discovery.search.rigid_model import RigidStage, reidentify_rigid_model
from stiffopt.discovery.search.rivals import (
    RankedEffect,
    Selected,
    exchange_rivals,
    restore_lost,
    restore_unstated,
    select_unranked,
)
from stiffopt.discovery.thresholds import (
    LINEARISATION_DEVIATIONS,
    LINEARISATION_TOLERANCE,
    MAX_EFFECTS_PER_ROUND,
    MAX_EXCHANGES,
    MAX_LINEARISATIONS,
    NAMED_EVIDENCE,
)
from stiffopt.interrupts import finished


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
    weighed : bool
        Whether everything was weighed against what could stand in its place.
    hurried : bool
        Whether Ctrl-C came when the search was over.
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
    weighed: bool = True
    hurried: bool = False

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
    target = comparison.target * comparison.inflation[comparison.rows.channel]
    before = comparison.channel_ratio(target)
    calibrated = comparison.channel_ratio(comparison.fit().residual)
    so_far = _SearchState(comparison, comparison)
    try:
        _run_stages(so_far, catalogue, start, most, strict, reidentify, about, say)
    except KeyboardInterrupt:
        if not so_far.effects:  # there is nothing to tell
            raise
        say(STOPPED_MESSAGE)
        so_far.stopped = True

    def answer() -> tuple[tuple[Selected, ...], bool, Comparison, Fit]:
        selected, weighed = so_far.selected()
        located = tuple(each.located for each in selected)
        return selected, weighed, *_relinearise(so_far.start, so_far.current, located)

    (selected, weighed, current, fit), hurried = finished(answer)
    return SearchResult(
        selected,
        current,
        fit,
        so_far.rigid,
        before,
        calibrated,
        current.channel_ratio(fit.residual),
        target,
        so_far.stopped,
        weighed,
        hurried,
    )


@dataclass(eq=False)
class _SearchState:
    """How far a search has come: what Ctrl-C leaves.

    Parameters
    ----------
    start, current : Comparison
        That fits begin from, and about what was found.
    effects : list of LocatedEffect
    ranked : list of Ranked
        Those that were weighed last.
    rigid : RigidStage or None
    stopped : bool
    """

    start: Comparison
    current: Comparison
    effects: list[LocatedEffect] = field(default_factory=list)
    ranked: list[RankedEffect] = field(default_factory=list)
    rigid: RigidStage | None = None
    stopped: bool = False

    def fitted(self, found: tuple[Comparison, list[LocatedEffect]]) -> None:
        """Go on from effects that are fitted jointly."""
        self.current, self.effects = found

    def weighed(self, found: tuple[Comparison, list[RankedEffect]]) -> None:
        """Go on from effects that are weighed among their rivals."""
        self.current, self.ranked = found
        self.effects = [each.selected.located for each in self.ranked]

    def selected(self) -> tuple[tuple[Selected, ...], bool]:
        """Effects by falling loss, and whether all of them are weighed among their rivals."""
        known = {each.selected.located.key: each.selected for each in self.ranked}
        found, weighed = [], True
        for located in self.effects:
            own = known.get(located.key)
            if own is None:
                own, weighed = select_unranked(self.current, self.effects, located), False
            if own is not None:
                found.append(own)
        return tuple(sorted(found, key=lambda each: -each.loss)), weighed


def _run_stages(
    so_far: _SearchState,
    catalogue: Sequence[Effect],
    start: Sequence[LocatedEffect],
    most: int,
    strict: bool,
    reidentify: bool,
    about: Extension | None,
    say: Callable[[str], object],
) -> None:
    """All that `search` does, one step after another."""
    tell = throttle_progress(say)
    so_far.fitted(_fit_unstated(so_far.start, list(start), say))
    if reidentify:
        say("re-identify the rigid model")
        so_far.rigid = reidentify_rigid_model(so_far.current, so_far.effects, catalogue, tell)
        so_far.start = so_far.start.with_bodies(so_far.rigid.bodies(so_far.start))
        # All of it again: what a wrong mass had hidden is seen now.
        single = () if so_far.rigid.single is None else (so_far.rigid.single.located,)
        so_far.fitted(_fit_unstated(so_far.start, [*start, *single], say))
    if about is not None:
        # Slopes about the nominal motion lead away from it.
        so_far.start = so_far.start.moved(about)
        current, tried = fit_jointly(so_far.start, [each.located for each in about.effects])
        so_far.fitted((current, prune_effects(current, tried)))
    if so_far.current.after_model:
        so_far.stopped = find_changes(
            so_far.start,
            so_far.current,
            so_far.effects,
            catalogue,
            most,
            say,
            tell,
            keep=so_far.fitted,
        )
    else:
        _add_forward(so_far, catalogue, most, MAX_EFFECTS_PER_ROUND if strict else 1, say, tell)
    if so_far.effects:
        say(f"confirm what was found ({len(so_far.effects)}) on stretches left out")
    sure = select_supported(so_far.current, so_far.effects, strict=strict)
    if len(sure) < len(so_far.effects):
        lost = [e for e in so_far.effects if e not in sure]
        so_far.fitted(fit_jointly(so_far.start, sure))
        if strict:
            so_far.fitted(restore_lost(so_far.start, so_far.current, so_far.effects, lost))
    so_far.weighed(exchange_rivals(so_far.start, so_far.current, so_far.effects, catalogue, tell))
    for _ in range(MAX_EXCHANGES):
        effects = so_far.effects
        kept = select_supported(so_far.current, effects, strict=strict)
        if len(kept) == len(effects):
            break
        so_far.fitted(fit_jointly(so_far.start, kept))
        so_far.weighed(
            exchange_rivals(
                so_far.start, so_far.current, so_far.effects, catalogue, tell, so_far.ranked
            )
        )
    if strict:
        lost = [e for e in start if not any(e.same_place(other) for other in so_far.effects)]
        so_far.weighed(
            restore_unstated(so_far.start, so_far.current, so_far.ranked, lost, catalogue, tell)
        )


def _relinearise(
    start: Comparison, current: Comparison, effects: Sequence[LocatedEffect]
) -> tuple[Comparison, Fit]:
    """Fit taken about itself until it stays: slopes about another motion bias what is found."""
    fit = current.fit(effects)
    for _ in range(MAX_LINEARISATIONS if effects else 0):
        again = start.about(fit, LINEARISATION_TOLERANCE)
        if again.columns is current.columns:
            break
        before, fit, current = fit, again.fit(effects), again
        moved = (fit.amplitudes() - before.amplitudes()) ** 2
        own = np.diag(fit.posterior.covariance)[fit.nuisance :]
        if np.all(moved < LINEARISATION_DEVIATIONS**2 * own):
            break
    return current, fit


def _fit_unstated(
    comparison: Comparison, start: list[LocatedEffect], say: Callable[[str], object]
) -> tuple[Comparison, list[LocatedEffect]]:
    """Fit what the nominal model does not state, without what the recordings do not bear out."""
    if not start:
        return comparison.about(comparison.fit(boxed=False)), []
    say(f"fit what the nominal model does not state ({len(start)} values)")
    current, effects = fit_jointly(comparison, start)
    return fit_jointly(comparison, prune_effects(current, effects))


def _add_forward(
    so_far: _SearchState,
    catalogue: Sequence[Effect],
    most: int,
    together: int,
    say: Callable[[str], object],
    tell: Callable[[str], object],
) -> None:
    """Add the best of the catalogue, some at once, until nothing more passes, or Ctrl-C."""
    most += len(so_far.effects)
    while len(so_far.effects) < most:
        effects = so_far.effects
        scorer = Scorer(so_far.current, effects)
        room = min(together, most - len(effects))
        try:
            best = _select_best(scan(scorer, catalogue, tell=tell), scorer, room)
            if not best:
                break
            for each in best:
                say(f"found {each.located.label} (log evidence {each.evidence:.0f})")
            wider, tried = fit_jointly(so_far.start, [*effects, *(e.located for e in best)])
            so_far.fitted((wider, prune_effects(wider, tried)))
        except KeyboardInterrupt:
            if not effects:  # there is nothing to tell
                raise
            say(STOPPED_MESSAGE)
            so_far.stopped = True
            break
        if best[0].located.label not in [e.label for e in so_far.effects]:
            break
    so_far.fitted(fit_jointly(so_far.start, so_far.effects))


def _select_best(candidates: Sequence[Candidate], scorer: Scorer, most: int) -> list[Candidate]:
    """The best that pass, at most one for every channel: others may have the same cause."""
    found: list[Candidate] = []
    for candidate in candidates:
        if len(found) == most or candidate.evidence < NAMED_EVIDENCE:
            break
        if candidate.channel not in [c.channel for c in found] and passes_thresholds(
            candidate, scorer
        ):
            found.append(candidate)
    return found
