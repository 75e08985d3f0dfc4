"""Find missing effects: forward selection, pruning, confirmation, and comparison with rivals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison, Fit
from stiffopt.discovery.comparison.located_effect import Extension, LocatedEffect
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.progress import throttle_progress
from stiffopt.discovery.search.candidates import Candidate, Scorer, scan
from stiffopt.discovery.search.joint_fit import (
    STOPPED_MESSAGE,
    fit_jointly,
    passes_thresholds,
    prune_effects,
)
from stiffopt.discovery.search.left_out_gain import select_predictive
from stiffopt.discovery.search.model_changes import find_changes
from stiffopt.discovery.search.nominal_values import claim_outside_values
from stiffopt.discovery.search.rigid_model import RigidStage, reidentify_rigid_model
from stiffopt.discovery.search.rivals import (
    RankedEffect,
    Selected,
    exchange_rivals,
    rank_effects,
    select_unranked,
)
from stiffopt.discovery.search.tournament import CATALOGUE_MODEL, Contender, hold_tournament
from stiffopt.discovery.thresholds import (
    LINEARISATION_DEVIATIONS,
    LINEARISATION_TOLERANCE,
    MAX_EXCHANGES,
    MAX_LINEARISATIONS,
    NAMED_EVIDENCE,
)
from stiffopt.interrupts import complete_step


@dataclass(frozen=True, eq=False)
class SearchResult:
    """Result of a search.

    Parameters
    ----------
    selected : tuple of Selected
        In decreasing order of loss.
    comparison : Comparison
        Linearised about the effects found, with the noise estimated beside them.
    fit : Fit
    rigid : RigidStage or None
        Re-identified rigid model; None if its tolerances are stated.
    before, calibrated, after : array (2 n,)
        Normalised residual of every channel: of the nominal model, with nominal values fitted
        within tolerance, and with the effects.
    target : array (m,)
        Residual of the nominal model over the stated noise: the rows of `before`.
    contenders : tuple of Contender
        Models that competed in the prediction of stretches left out, the best first.
    stopped : bool
        By Ctrl-C, before the search was complete.
    weighed : bool
        True if all findings were compared with their rivals.
    hurried : bool
        True if Ctrl-C came after the search.
    """

    selected: tuple[Selected, ...]
    comparison: Comparison
    fit: Fit
    rigid: RigidStage | None
    before: np.ndarray
    calibrated: np.ndarray
    after: np.ndarray
    target: np.ndarray
    contenders: tuple[Contender, ...] = ()
    stopped: bool = False
    weighed: bool = True
    hurried: bool = False

    @property
    def effects(self) -> tuple[LocatedEffect, ...]:
        """Effects found."""
        return tuple(s.located for s in self.selected)


def search(
    comparison: Comparison,
    catalogue: Sequence[Effect],
    *,
    start: Sequence[LocatedEffect] = (),
    most: int = 3,
    together: int = 1,
    reidentify: bool = False,
    about: Extension | None = None,
    report: Callable[[str], object] | None = None,
) -> SearchResult:
    """Search the catalogue for missing effects.

    Parameters
    ----------
    comparison : Comparison
        With the nominal or an extended model.
    catalogue : sequence of Effect
    start : sequence of LocatedEffect
        Values that the nominal model does not state: fitted together before any other effect.
    most : int
        Maximum number of effects beside those.
    together : int
        Effects that are added per round before all are compared again.
    reidentify : bool
        Re-identify the rigid model first.
    about : Extension, optional
        Extension found by another comparison, to linearise about; its effects are tried first.
    report : callable, optional
        Called with a sentence at every step.
    """
    say = report or (lambda _: None)
    target = comparison.target * comparison.inflation[comparison.rows.channel]
    before = comparison.channel_ratio(target)
    calibrated = comparison.channel_ratio(comparison.fit().residual)
    so_far = _SearchState(comparison, comparison)
    try:
        _run_stages(so_far, catalogue, start, most, together, reidentify, about, say)
    except KeyboardInterrupt:
        if not so_far.effects:  # there is no result
            raise
        say(STOPPED_MESSAGE)
        so_far.stopped = True

    def answer() -> tuple[tuple[Selected, ...], bool, Comparison, Fit]:
        selected, weighed = so_far.selected()
        located = tuple(each.located for each in selected)
        return selected, weighed, *_relinearise_fit(so_far.start, so_far.current, located)

    (selected, weighed, current, fit), hurried = complete_step(answer)
    return SearchResult(
        selected,
        current,
        fit,
        so_far.rigid,
        before,
        calibrated,
        current.channel_ratio(fit.residual),
        target,
        so_far.contenders,
        so_far.stopped,
        weighed,
        hurried,
    )


@dataclass(eq=False)
class _SearchState:
    """State of a search, from which Ctrl-C makes a result.

    Parameters
    ----------
    start, current : Comparison
        Comparison that fits start from, and the one linearised about the effects.
    effects : list of LocatedEffect
    ranked : list of Ranked
        Effects ranked last.
    rigid : RigidStage or None
    contenders : tuple of Contender
    stopped : bool
    """

    start: Comparison
    current: Comparison
    effects: list[LocatedEffect] = field(default_factory=list)
    ranked: list[RankedEffect] = field(default_factory=list)
    rigid: RigidStage | None = None
    contenders: tuple[Contender, ...] = ()
    stopped: bool = False

    def fitted(self, found: tuple[Comparison, list[LocatedEffect]]) -> None:
        """Set jointly fitted effects."""
        self.current, self.effects = found

    def weighed(self, found: tuple[Comparison, list[RankedEffect]]) -> None:
        """Set effects that are ranked among their rivals."""
        self.current, self.ranked = found
        self.effects = [each.selected.located for each in self.ranked]

    def selected(self) -> tuple[tuple[Selected, ...], bool]:
        """Return effects in decreasing order of loss, and True if all of them are ranked."""
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
    together: int,
    reidentify: bool,
    about: Extension | None,
    say: Callable[[str], object],
) -> None:
    """Run the stages of `search`."""
    tell = throttle_progress(say)
    so_far.fitted(_fit_unstated(so_far.start, list(start), say))
    if reidentify:
        say("re-identify the rigid model")
        so_far.rigid = reidentify_rigid_model(so_far.current, so_far.effects, catalogue, tell)
        so_far.start = so_far.start.with_bodies(so_far.rigid.bodies(so_far.start))
        # Fit again: wrong masses may have hidden unstated values.
        single = () if so_far.rigid.single is None else (so_far.rigid.single.located,)
        so_far.fitted(_fit_unstated(so_far.start, [*start, *single], say))
    if about is not None:
        # A linearisation about the nominal motion would lead away from it.
        so_far.start = so_far.start.with_extension(about)
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
        _add_forward(so_far, catalogue, most, together, say, tell)
    if so_far.effects:
        say(f"confirm {len(so_far.effects)} findings on stretches left out")
    sure = select_predictive(so_far.current, so_far.effects)
    if len(sure) < len(so_far.effects):
        so_far.fitted(fit_jointly(so_far.start, sure))
    so_far.weighed(exchange_rivals(so_far.start, so_far.current, so_far.effects, catalogue, tell))
    for _ in range(MAX_EXCHANGES):
        effects = so_far.effects
        kept = select_predictive(so_far.current, effects)
        if len(kept) == len(effects):
            break
        so_far.fitted(fit_jointly(so_far.start, kept))
        so_far.weighed(
            exchange_rivals(
                so_far.start, so_far.current, so_far.effects, catalogue, tell, so_far.ranked
            )
        )
    so_far.weighed(
        claim_outside_values(so_far.start, so_far.current, so_far.ranked, catalogue, most, tell)
    )
    if reidentify:
        _adopt_best_model(so_far, catalogue, tell)


def _adopt_best_model(
    so_far: _SearchState, catalogue: Sequence[Effect], tell: Callable[[str], object]
) -> None:
    """Adopt a plainer model where it predicts stretches left out better than the effects."""
    calibrated = [each for each in so_far.effects if each.calibrated]
    best = None if so_far.rigid is None else so_far.rigid.nearest
    single = None if best is None else best.located
    so_far.contenders = hold_tournament(so_far.current, calibrated, single, so_far.effects)
    winner = so_far.contenders[0]
    if winner.name == CATALOGUE_MODEL:
        return
    so_far.start = so_far.start.with_bodies(winner.comparison.bodies)
    so_far.fitted(fit_jointly(so_far.start, list(winner.effects)))
    ranked = rank_effects(so_far.current, so_far.effects, catalogue, tell, so_far.ranked)
    so_far.weighed((so_far.current, ranked))


def _relinearise_fit(
    start: Comparison, current: Comparison, effects: Sequence[LocatedEffect]
) -> tuple[Comparison, Fit]:
    """Repeat fit and linearisation until convergence: other linearisation points bias the fit."""
    fit = current.fit(effects)
    for _ in range(MAX_LINEARISATIONS if effects else 0):
        again = start.linearised_at(fit, LINEARISATION_TOLERANCE)
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
    """Fit values that the nominal model does not state; drop unsupported ones."""
    if not start:
        return comparison.linearised_at(comparison.fit(boxed=False)), []
    say(f"fit {len(start)} values that the nominal model does not state")
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
    """Add the best candidates, several per round, until none passes or Ctrl-C."""
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
            if not effects:  # there is no result
                raise
            say(STOPPED_MESSAGE)
            so_far.stopped = True
            break
        if best[0].located.label not in [e.label for e in so_far.effects]:
            break
    so_far.fitted(fit_jointly(so_far.start, so_far.effects))


def _select_best(candidates: Sequence[Candidate], scorer: Scorer, most: int) -> list[Candidate]:
    """Return the best passing candidates, one per channel: others may have the same cause."""
    found: list[Candidate] = []
    for candidate in candidates:
        if len(found) == most or candidate.evidence < NAMED_EVIDENCE:
            break
        if candidate.channel not in [c.channel for c in found] and passes_thresholds(
            candidate, scorer
        ):
            found.append(candidate)
    return found
