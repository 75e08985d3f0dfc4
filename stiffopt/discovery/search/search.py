"""Find the effects that are missing: forward, backward, and what they are confused with."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison, Fit
from stiffopt.discovery.comparison.extension import with_amplitudes
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.comparison.signals import RobotConstants
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.search.candidates import Candidate, Scorer, scan
from stiffopt.discovery.search.uncertainty import significance

Report = Callable[[str], object]

# An effect is named from this log evidence and this many standard deviations on.
EVIDENCE = 12.0
CHI = 5.0
# And, unless the nominal values would have to leave their tolerances without it, only if it takes
# away this share of a channel's squared residual.
EXPLAINED = 0.02
_PULL = 0.5
# Jackknife deviations from nothing of its amplitudes.
CONFIRMED = 3.5
_MOST = 0.5
# How often a likelier explanation takes the place of what was found.
_EXCHANGES = 3
# Log evidences are too sure where formulas differ from nature: a difference counts against this
# share of the winner's own, within bounds.
_TEMPER = 0.01
_WIDEST = 30.0
_GROUP = 3.0
# Log prior odds for every further parameter: of two that fit alike the plainer is right.
_PLAINER = 1.0


@dataclass(frozen=True, eq=False)
class Selected:
    """An effect that was found, with its rivals.

    Parameters
    ----------
    located : LocatedEffect
    loss : float
        Log evidence that is lost without it.
    chi : float
    probability : float
        Against its rivals.
    rivals : tuple of (LocatedEffect, float)
        What the data cannot tell apart from it, with probabilities.
    channel : int
        The channel that it changes most.
    """

    located: LocatedEffect
    loss: float
    chi: float
    probability: float
    rivals: tuple[tuple[LocatedEffect, float], ...]
    channel: int


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
    report: Report | None = None,
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
        found = scan(scorer, catalogue)
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
    confirmed = _confirmed(current, effects)
    if len(confirmed) < len(effects):
        current, effects = _fitted_jointly(comparison, confirmed)
    ranked = [_ranked(current, effects, e, catalogue) for e in effects]
    for _ in range(_EXCHANGES):
        likelier = _distinct([j.likeliest for j in ranked])
        if likelier == effects:
            break
        current, effects = _fitted_jointly(comparison, likelier)
        ranked = [_ranked(current, effects, e, catalogue) for e in effects]
    else:
        # Explanations that go on taking each other's place explain nothing.
        kept = [j.selected.located for j in ranked if j.likeliest is j.selected.located]
        if len(kept) < len(effects):
            current, effects = _fitted_jointly(comparison, kept)
            ranked = [_ranked(current, effects, e, catalogue) for e in effects]
    selected = sorted((j.selected for j in ranked), key=lambda s: -s.loss)
    fit = current.fit(tuple(s.located for s in selected))
    return SearchResult(
        tuple(selected), current, fit, before, calibrated, current.channel_ratio(fit.residual)
    )


def _passes(candidate: Candidate, scorer: Scorer) -> bool:
    if candidate.evidence < EVIDENCE or candidate.chi < CHI:
        return False
    if candidate.explained >= EXPLAINED:
        return candidate.gain > 0.0 or _relief(candidate, scorer) > _PULL * candidate.evidence
    return _relief(candidate, scorer) > _PULL * candidate.evidence


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
        if losses[worst] >= EVIDENCE:
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
        weak = [int(i) for i in np.argsort(sure) if sure[i] < CONFIRMED]
        lost = next((i for i in weak if not _borne_out(comparison, kept, i)), None)
        if lost is None:
            break
        kept.pop(lost)
    return kept


def _borne_out(comparison: Comparison, effects: list[LocatedEffect], index: int) -> bool:
    others = [e for k, e in enumerate(effects) if k != index]
    own = Scorer(comparison, others).score(effects[index])
    return own is not None and own.explained > _MOST and own.gain > _MOST * own.evidence


def _distinct(effects: Sequence[LocatedEffect]) -> list[LocatedEffect]:
    """Each place once: one effect may be likelier than several that stood in for it."""
    kept: list[LocatedEffect] = []
    for located in effects:
        if not any(located.same_place(other) for other in kept):
            kept.append(located)
    return kept


@dataclass(frozen=True, eq=False)
class _Ranked:
    """A found effect among its rivals, and the likeliest of them all."""

    selected: Selected
    likeliest: LocatedEffect


def _ranked(
    comparison: Comparison,
    effects: Sequence[LocatedEffect],
    located: LocatedEffect,
    catalogue: Sequence[Effect],
) -> _Ranked:
    """Judge a found effect against everything that could stand in its place."""
    others = [e for e in effects if e is not located]
    scorer = Scorer(comparison, others)
    own = scorer.score(located)
    assert own is not None
    found = [c for c in scan(scorer, catalogue, about=located) if not c.located.same_place(located)]
    width = float(np.clip(_TEMPER * own.evidence, 1.0, _WIDEST))
    constants = comparison.constants
    own_prior = _log_prior(own, constants)
    odds = [
        (c.evidence - own.evidence) / width + _log_prior(c, constants) - own_prior for c in found
    ]
    near = sorted(zip(odds, found, strict=True), key=lambda pair: -pair[0])[:3]
    near = [(o, c) for o, c in near if o > -_GROUP]
    weights = np.exp([o for o, _ in near])
    total = 1.0 + float(np.sum(weights))
    rivals = tuple((c.located, float(w) / total) for (_, c), w in zip(near, weights, strict=True))
    selected = Selected(located, own.evidence, own.chi, 1.0 / total, rivals, own.channel)
    return _Ranked(selected, near[0][1].located if near and near[0][0] > 0.0 else located)


def _log_prior(candidate: Candidate, constants: RobotConstants) -> float:
    """Log prior odds: plainer effects, and those usual at their joint, are likelier.

    An amplitude counts as far as the data determine it.
    """
    located = candidate.located
    size = len(located.effect.shapes) + float(np.sum(1.0 - np.diag(candidate.covariance)))
    usual = located.effect.log_prior
    return (usual(located.constants(constants)) if usual else 0.0) - _PLAINER * size
