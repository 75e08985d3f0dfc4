"""What else could stand in the place of a found effect, and how likely each is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import softmax

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.search.candidates import Candidate, Scorer, scan
from stiffopt.discovery.search.uncertainty import significance
from stiffopt.discovery.signals import RobotConstants
from stiffopt.discovery.thresholds import (
    CHANGES_ALIKE,
    DETERMINED_DEVIATIONS,
    NAMED_EVIDENCE,
    NEAR_CENTRE,
    ONE_THING,
    PARAMETER_LOG_PRICE,
    RIVAL_LOG_ODDS,
    SUSPECT_WIDTH,
    TEMPERED_MOST,
    TEMPERED_SHARE,
)

# Of an effect's own evidence, what a rival has whose shapes are fitted: those that a search starts
# from leave no three quarters of it to be found.
_WORTH = 0.25


@dataclass(frozen=True, eq=False)
class Selected:
    """An effect that was found, with its rivals.

    Parameters
    ----------
    located : LocatedEffect
    loss : float
        Log evidence that is lost without it.
    deviations : float
    probability : float
        Against its rivals.
    rivals : tuple of (LocatedEffect, float)
        What the data cannot tell apart from it, with probabilities.
    channel : int
        The channel that it changes most.
    """

    located: LocatedEffect
    loss: float
    deviations: float
    probability: float
    rivals: tuple[tuple[LocatedEffect, float], ...]
    channel: int


@dataclass(frozen=True, eq=False)
class Ranked:
    """A found effect among its rivals, and the likeliest of them all."""

    selected: Selected
    likeliest: LocatedEffect


def ranked_among_rivals(
    comparison: Comparison,
    effects: Sequence[LocatedEffect],
    located: LocatedEffect,
    catalogue: Sequence[Effect],
    *,
    tell: Callable[[str], object] = lambda _: None,
) -> Ranked | None:
    """Weigh a found effect against everything that could stand in its place.

    None where it has come to nothing, or to what cannot be, beside the others.
    """
    others = [e for e in effects if e is not located]
    scorer = Scorer(comparison, others)
    own = scorer.score(located)
    if own is None:
        return None
    worth = _WORTH * own.evidence
    every = scan(scorer, catalogue, worth=worth, about=located, tell=tell)
    found = [
        c for c in every if not c.located.same_place(located) and _agreed(comparison, others, c)
    ]
    if comparison.after_model:
        # Evidence is counted in large units there, in which what explains nothing is ahead by its
        # prior alone.
        found = [c for c in found if c.evidence >= CHANGES_ALIKE * own.evidence]
    width = float(np.clip(TEMPERED_SHARE * own.evidence, 1.0, TEMPERED_MOST))
    # What a model left open gives to some formula by chance is a unit that evidence counts in.
    width = max(width, SUSPECT_WIDTH * comparison.max_inherited_evidence)
    constants = comparison.constants
    priors = [_log_prior(c, constants, comparison.after_model) for c in (own, *found)]
    ahead = [_ahead(c, own) / width for c in found]
    odds = [a + prior - priors[0] for a, prior in zip(ahead, priors[1:], strict=True)]
    near = sorted(zip(odds, ahead, found, strict=True), key=lambda each: -each[0])[:3]
    # What fits alike is not told apart, however much plainer one of the two is.
    near = [each for each in near if max(each[:2]) > -RIVAL_LOG_ODDS]
    itself, *theirs = map(float, softmax([0.0, *(o for o, _, _ in near)]))
    rivals = tuple((c.located, p) for (_, _, c), p in zip(near, theirs, strict=True))
    selected = Selected(located, own.evidence, own.deviations, itself, rivals, own.channel)
    return Ranked(selected, near[0][2].located if near and near[0][0] > 0.0 else located)


def _ahead(candidate: Candidate, own: Candidate) -> float:
    """Log evidence of a candidate over that of another; of twins the log likelihood.

    An amplitude's prior costs evidence, a shape that does as much costs none: a counterbalance,
    three amplitudes and a shape, had 6 to 13 less than a cable, two and one, whose fit was worse.
    """
    if candidate.located.effect.is_twin(own.located.effect):
        return 0.5 * (candidate.deviations**2 - own.deviations**2)
    return candidate.evidence - own.evidence


def _agreed(comparison: Comparison, others: Sequence[LocatedEffect], candidate: Candidate) -> bool:
    """Whether stretches of the recordings agree on what only this effect has.

    An effect with more freedom than others is likelier than they are wherever a model is wrong.
    """
    if not candidate.located.effect.has_distinctive or candidate.evidence < NAMED_EVIDENCE:
        return True
    _, single = significance(comparison, [*others, candidate.located])
    return bool(single[-1] >= DETERMINED_DEVIATIONS)


def not_weighed(
    comparison: Comparison, effects: Sequence[LocatedEffect], located: LocatedEffect
) -> Selected | None:
    """A found effect that there was no time to weigh: as likely as all that may be in its place."""
    own = Scorer(comparison, [e for e in effects if e is not located]).score(located)
    if own is None:
        return None
    return Selected(located, own.evidence, own.deviations, 0.5, (), own.channel)


def _log_prior(candidate: Candidate, constants: RobotConstants, changed: bool) -> float:
    """Log prior odds: plainer effects, and those usual at their joint, are likelier.

    An amplitude counts as far as the data determine it. Where something has changed, a body is one
    thing, however many of its ten parameters show.
    """
    located = candidate.located
    size = len(located.effect.shapes) + float(np.sum(1.0 - np.diag(candidate.covariance)))
    if changed:
        size = min(size, ONE_THING) + _misplaced(candidate, constants)
    usual = located.effect.log_prior
    return (usual(located.constants(constants)) if usual else 0.0) - PARAMETER_LOG_PRICE * size


def _misplaced(candidate: Candidate, constants: RobotConstants) -> float:
    """How unlikely it is that a body has changed by a mass so far from its centre; 0 of others.

    Masses on neighbouring links can hardly be told apart; most sit on the body that they are near.
    """
    located = candidate.located
    if located.effect.family != "inertial" or located.joint is not None:
        return 0.0
    mass, *moment = (candidate.amplitudes * located.sizes(constants))[:4]
    if len(moment) < 3 or not mass:
        return 0.0
    body = len(constants.masses) - 1 if located.link is None else located.link
    sd = float(np.sqrt(candidate.covariance[0, 0]))
    known = max(1.0 - sd / abs(float(candidate.amplitudes[0])), 0.0)
    away = np.array(moment) / mass - constants.centres[body]
    unlikely = 0.5 * float(away @ away) / NEAR_CENTRE**2
    return known * min(unlikely, ONE_THING)
