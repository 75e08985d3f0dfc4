"""Find missing effects: forward selection, pruning, confirmation, and comparison with rivals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison, Fit
from stiffopt.discovery.comparison.located_effect import Extension, LocatedEffect
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.progress import Say, throttle_progress
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
    Selected,
    exchange_rivals,
    rank_effects,
    unranked,
)
from stiffopt.discovery.search.tournament import (
    CATALOGUE_MODEL,
    SINGLE_BODY,
    Contender,
    hold_tournament,
)
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
    """Result of a search."""

    selected: tuple[Selected, ...]  # in decreasing order of loss
    # Linearised about the effects found, with the noise estimated beside them.
    comparison: Comparison
    fit: Fit
    rigid: RigidStage | None  # re-identified rigid model; None if its tolerances are stated
    # before, calibrated, after (2 n,): normalised residual of every channel: of the nominal model,
    # with nominal values fitted within tolerance, and with the effects.
    before: np.ndarray
    calibrated: np.ndarray
    after: np.ndarray
    # (m,) residual of the nominal model over the stated noise: the rows of `before`.
    target: np.ndarray
    # Models that competed in the prediction of stretches left out, the best first.
    contenders: tuple[Contender, ...] = ()
    stopped: bool = False  # by Ctrl-C, before the search was complete
    weighed: bool = True  # True if all findings were compared with their rivals
    hurried: bool = False  # True if Ctrl-C came after the search

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
    report: Say | None = None,
) -> SearchResult:
    """Search the catalogue for missing effects.

    `comparison`: with the nominal or an extended model. `start`: values that the nominal model does
    not state: fitted together before any other effect. `most`: maximum number of effects beside
    those. `together`: effects that are added per round before all are compared again.
    `reidentify`: re-identify the rigid model first. `about`: extension found by another
    comparison, to linearise about; its effects are tried first. `report`: called with a sentence at
    every step.
    """
    say = report or (lambda _: None)
    target = comparison.target * comparison.inflation[comparison.rows.channel]
    before = comparison.channel_ratio(target)
    calibrated = comparison.channel_ratio(comparison.fit().residual)
    so_far = _Search(comparison, comparison, catalogue, most, together, say)
    try:
        so_far.run(start, about, reidentify=reidentify)
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
class _Search:
    """A search and its state, from which Ctrl-C makes a result."""

    # start, current: comparison that fits start from, and the one linearised about the effects.
    start: Comparison
    current: Comparison
    catalogue: Sequence[Effect]
    most: int  # largest number of effects beside those that the search starts with
    together: int  # effects that are added per round
    say: Say
    effects: list[LocatedEffect] = field(default_factory=list)
    ranked: list[Selected] = field(default_factory=list)  # effects ranked last
    # Labels of effects that stretches left out did not support.
    refuted: set[str] = field(default_factory=set)
    rigid: RigidStage | None = None
    contenders: tuple[Contender, ...] = ()
    stopped: bool = False

    def __post_init__(self) -> None:
        self.tell = throttle_progress(self.say)
        self.unstated: Sequence[LocatedEffect] = ()

    def run(
        self, unstated: Sequence[LocatedEffect], about: Extension | None, *, reidentify: bool
    ) -> None:
        """Run the stages of `search`."""
        self.unstated = unstated
        self._fit_unstated(unstated, prune=not reidentify)
        if reidentify:
            self.say("re-identify the rigid model")
            self.rigid = reidentify_rigid_model(
                self.current, self.effects, self.catalogue, self.tell
            )
            self.start = self.start.with_bodies(self.rigid.bodies(self.start))
            # Fit again: wrong masses may have hidden unstated values.
            single = () if self.rigid.single is None else (self.rigid.single.located,)
            self._fit_unstated([*unstated, *single], prune=True)
            if self.start.bodies is not None:
                # Tilt and joint zeros act on the weight of these bodies, not of the nominal ones.
                self.start = self.start.about_bodies(self.current.fit(self.effects))
                self._fit(self.effects)
        if about is not None:
            # A linearisation about the nominal motion would lead away from it.
            self.start = self.start.with_extension(about)
            self._fit_and_prune([each.located for each in about.effects])
        most = self.most + len(self.effects)
        if self.current.after_model:
            self.stopped = find_changes(
                self.start,
                self.current,
                self.effects,
                self.catalogue,
                self.most,
                self.say,
                self.tell,
                keep=self._set_fitted,
            )
        else:
            self._add_forward(most)
        if self.effects:
            self.say(f"confirm {len(self.effects)} findings on stretches left out")
        self._confirm(most)
        self._set_ranked(
            claim_outside_values(
                self.start, self.current, self.ranked, self.catalogue, self.most, self.tell
            )
        )
        if reidentify:
            self._adopt_best_model()

    def _confirm(self, most: int) -> None:
        """Keep effects that stretches left out support, and exchange them for likelier rivals.

        An effect that is not supported has taken the place of another: that one is sought without
        it, since nothing but the supported effects was beside it until then.
        """
        for number in range(1 + MAX_EXCHANGES):
            kept = select_predictive(self.current, self.effects)
            refuted = {each.label for each in self.effects if each not in kept}
            if refuted:
                self.refuted |= refuted
                self._fit(kept)
                if number < MAX_EXCHANGES and not (self.stopped or self.current.after_model):
                    self._add_forward(most)
            elif number:
                return
            self._set_ranked(
                exchange_rivals(
                    self.start,
                    self.current,
                    self.effects,
                    self.catalogue,
                    self.tell,
                    self.ranked,
                    refuted=self.refuted,
                )
            )

    def selected(self) -> tuple[tuple[Selected, ...], bool]:
        """Return effects in decreasing order of loss, and True if all of them are ranked."""
        known = {each.located.key: each for each in self.ranked}
        found, weighed = [], True
        for located in self.effects:
            own = known.get(located.key)
            if own is None:
                # For lack of time not ranked.
                others = [each for each in self.effects if each is not located]
                found_alone, weighed = Scorer(self.current, others).score(located), False
                own = None if found_alone is None else unranked(found_alone, 0.5)
            if own is not None:
                found.append(own)
        return tuple(sorted(found, key=lambda each: -each.loss)), weighed

    def _set_fitted(self, found: tuple[Comparison, list[LocatedEffect]]) -> None:
        """Set jointly fitted effects."""
        self.current, self.effects = found

    def _set_ranked(self, found: tuple[Comparison, list[Selected]]) -> None:
        """Set effects that are ranked among their rivals."""
        self.current, ranked = found
        self.ranked = [replace(r, located=self._as_unstated(r.located)) for r in ranked]
        self.effects = [each.located for each in self.ranked]

    def _as_unstated(self, located: LocatedEffect) -> LocatedEffect:
        """Return an effect as the value that the nominal model does not state, if it is one.

        Such a value may leave its bounds beside what is missing, and come again beside that.
        """
        unstated = next((e for e in self.unstated if e.same_place(located)), located)
        return replace(unstated, shapes=located.shapes)

    def _fit(self, effects: list[LocatedEffect]) -> None:
        self._set_fitted(fit_jointly(self.start, effects))

    def _fit_and_prune(self, effects: list[LocatedEffect]) -> None:
        current, tried = fit_jointly(self.start, effects)
        self._set_fitted((current, prune_effects(current, tried)))

    def _fit_unstated(self, unstated: Sequence[LocatedEffect], *, prune: bool) -> None:
        """Fit values that the nominal model does not state.

        `prune`: drop unsupported ones; beside wrong masses all of them could seem to be.
        """
        if not unstated:
            plain = self.start.fit(boxed=False)
            self._set_fitted((self.start.linearised_at(plain), []))
            return
        self.say(f"fit {len(unstated)} values that the nominal model does not state")
        current, effects = fit_jointly(self.start, list(unstated))
        self._fit(prune_effects(current, effects) if prune else effects)

    def _add_forward(self, most: int) -> None:
        """Add the best candidates, several per round, up to `most` effects or Ctrl-C.

        Effects that replace one another in turn end it as well: the same ones come again.
        """
        fitted: set[frozenset[str]] = set()
        while len(self.effects) < most:
            effects = self.effects
            fitted.add(frozenset(each.label for each in effects))
            scorer = Scorer(self.current, effects)
            room = min(self.together, most - len(effects))
            try:
                scanned = scan(scorer, self.catalogue, tell=self.tell)
                tried = [each for each in scanned if each.located.label not in self.refuted]
                best = _select_best(tried, scorer, room)
                if not best:
                    break
                for each in best:
                    self.say(f"found {each.located.label} (log evidence {each.evidence:.0f})")
                self._fit_and_prune([*effects, *(self._as_unstated(e.located) for e in best)])
            except KeyboardInterrupt:
                if not effects:  # there is no result
                    raise
                self.say(STOPPED_MESSAGE)
                self.stopped = True
                break
            now = frozenset(each.label for each in self.effects)
            if best[0].located.label not in now or now in fitted:
                break
        self._fit(self.effects)

    def _adopt_best_model(self) -> None:
        """Adopt a plainer model where it predicts stretches left out better than the effects."""
        calibrated = [each for each in self.effects if each.calibrated]
        assert self.rigid is not None
        single = None if self.rigid.nearest is None else self.rigid.nearest.located
        self.contenders = hold_tournament(self.current, calibrated, single, self.effects)
        winner = self.contenders[0]
        if winner.name == CATALOGUE_MODEL:
            return
        bodies, effects = winner.comparison.bodies, list(winner.effects)
        found = [e for e in self.effects if single is not None and e.same_place(single)]
        if winner.name == SINGLE_BODY and found:
            # It stays a finding: of a free body nobody is told.
            bodies, effects = None, [*calibrated, *found]
        self.start = self.start.with_bodies(bodies)
        self.rigid = self.rigid.adopting(self.start)
        self._fit(effects)
        ranked = rank_effects(self.current, self.effects, self.catalogue, self.tell, self.ranked)
        self._set_ranked((self.current, ranked))


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


def _select_best(candidates: Sequence[Candidate], scorer: Scorer, most: int) -> list[Candidate]:
    """Return the best passing candidates, one per channel: others may have the same cause."""
    found: list[Candidate] = []
    for candidate in candidates:
        if len(found) == most or candidate.evidence < NAMED_EVIDENCE:
            break
        new = candidate.channel not in [c.channel for c in found]
        if new and passes_thresholds(candidate, scorer):
            found.append(candidate)
    return found
