"""What else could stand in the place of a found effect, and how likely each is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.comparison.signals import RobotConstants
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.search.candidates import Candidate, Scorer, scan
from stiffopt.discovery.thresholds import (
    PARAMETER_LOG_PRICE,
    RIVAL_LOG_ODDS,
    TEMPERED_MOST,
    TEMPERED_SHARE,
)


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
    every = scan(scorer, catalogue, about=located, tell=tell)
    found = [c for c in every if not c.located.same_place(located)]
    width = float(np.clip(TEMPERED_SHARE * own.evidence, 1.0, TEMPERED_MOST))
    constants = comparison.constants
    own_prior = _log_prior(own, constants)
    odds = [
        (c.evidence - own.evidence) / width + _log_prior(c, constants) - own_prior for c in found
    ]
    near = sorted(zip(odds, found, strict=True), key=lambda pair: -pair[0])[:3]
    near = [(o, c) for o, c in near if o > -RIVAL_LOG_ODDS]
    weights = np.exp([o for o, _ in near])
    total = 1.0 + float(np.sum(weights))
    rivals = tuple((c.located, float(w) / total) for (_, c), w in zip(near, weights, strict=True))
    selected = Selected(located, own.evidence, own.deviations, 1.0 / total, rivals, own.channel)
    return Ranked(selected, near[0][1].located if near and near[0][0] > 0.0 else located)


def _log_prior(candidate: Candidate, constants: RobotConstants) -> float:
    """Log prior odds: plainer effects, and those usual at their joint, are likelier.

    An amplitude counts as far as the data determine it.
    """
    located = candidate.located
    size = len(located.effect.shapes) + float(np.sum(1.0 - np.diag(candidate.covariance)))
    usual = located.effect.log_prior
    return (usual(located.constants(constants)) if usual else 0.0) - PARAMETER_LOG_PRICE * size
