"""Rank found effects among their rivals, and exchange them for likelier ones."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import softmax

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.progress import RoundProgress, Say
from stiffopt.discovery.search.candidates import Candidate, Scorer, scan
from stiffopt.discovery.search.joint_fit import fit_jointly
from stiffopt.discovery.signals import RobotConstants
from stiffopt.discovery.thresholds import (
    ADDED_MASS_OFFSET,
    EQUIVALENT_EVIDENCE_SHARE,
    MAX_CHANGE_PARAMETERS,
    MAX_TEMPERING,
    PARAMETER_LOG_PRICE,
    RIVAL_LOG_ODDS,
    SUSPECT_EVIDENCE_UNITS,
    TEMPERING_SHARE,
)

# Least evidence, over the effect's own, of a rival whose shapes are fitted: fitting gains less than
# the other three quarters.
_MIN_REFINED_SHARE = 0.25


@dataclass(frozen=True, eq=False)
class Selected:
    """A found effect with its rivals."""

    located: LocatedEffect
    loss: float  # log evidence lost without it
    deviations: float
    probability: float  # against its rivals
    # Effects that the data do not tell apart from it, with probabilities.
    rivals: tuple[tuple[LocatedEffect, float], ...]
    channel: int  # channel that it changes most
    likelier: LocatedEffect | None = None  # rival that is likelier


def unranked(own: Candidate, probability: float) -> Selected:
    """Return a found effect without rivals."""
    return Selected(own.located, own.evidence, own.deviations, probability, (), own.channel)


def rank_rivals(
    comparison: Comparison,
    effects: Sequence[LocatedEffect],
    located: LocatedEffect,
    catalogue: Sequence[Effect],
    *,
    tell: Say = lambda _: None,
) -> Selected | None:
    """Rank a found effect among all possible rivals.

    None if it has become insignificant or left its bounds beside the other effects.
    """
    others = [e for e in effects if e is not located]
    scorer = Scorer(comparison, others)
    own = scorer.score(located)
    if own is None:
        return None
    if located.calibrated:
        return unranked(own, 1.0)
    worth = _MIN_REFINED_SHARE * own.evidence
    every = scan(scorer, catalogue, worth=worth, about=located, tell=tell)
    found = [c for c in every if not c.located.same_place(located)]
    if comparison.after_model:
        # Tempered evidence is flat there: a rival without any evidence could win by its prior.
        found = [c for c in found if c.evidence >= EQUIVALENT_EVIDENCE_SHARE * own.evidence]
    width = tempering_width(own.evidence)
    # Evidence that the open residual of the model gives by chance is the unit of differences.
    width = max(width, SUSPECT_EVIDENCE_UNITS * comparison.max_inherited_evidence)
    constants = comparison.constants
    priors = [_log_prior(c, constants, comparison.after_model) for c in (own, *found)]
    ahead = [_evidence_lead(c, own) / width for c in found]
    odds = [a + prior - priors[0] for a, prior in zip(ahead, priors[1:], strict=True)]
    near = sorted(zip(odds, ahead, found, strict=True), key=lambda each: -each[0])[:3]
    # Equal fits are not told apart, even if one of the two is simpler.
    near = [each for each in near if max(each[:2]) > -RIVAL_LOG_ODDS]
    itself, *theirs = map(float, softmax([0.0, *(o for o, _, _ in near)]))
    rivals = tuple((c.located, p) for (_, _, c), p in zip(near, theirs, strict=True))
    likelier = near[0][2].located if near and near[0][0] > 0.0 else None
    return Selected(located, own.evidence, own.deviations, itself, rivals, own.channel, likelier)


def tempering_width(evidence: float) -> float:
    """Return the unit of differences to rivals of an effect with some log evidence."""
    return float(np.clip(TEMPERING_SHARE * evidence, 1.0, MAX_TEMPERING))


def _evidence_lead(candidate: Candidate, own: Candidate) -> float:
    """Return the log evidence of a candidate less that of another; of twins the log likelihood.

    The prior of an amplitude costs evidence, a shape costs none: a counterbalance, three amplitudes
    and a shape, had 6 to 13 less than a worse fitting cable with two and one.
    """
    if candidate.located.effect.is_twin(own.located.effect):
        return candidate.log_likelihood - own.log_likelihood
    return candidate.evidence - own.evidence


def _log_prior(candidate: Candidate, constants: RobotConstants, changed: bool) -> float:
    """Return log prior odds: simpler effects, and those usual at their joint, are likelier.

    An amplitude counts as far as the data determine it. The count of a changed body is limited,
    since its ten parameters change together.
    """
    located = candidate.located
    size = len(located.effect.shapes) + float(np.sum(1.0 - np.diag(candidate.covariance)))
    if changed:
        size = min(size, MAX_CHANGE_PARAMETERS) + _misplacement_penalty(candidate, constants)
    usual = located.effect.log_prior
    return (usual(located.constants(constants)) if usual else 0.0) - PARAMETER_LOG_PRICE * size


def _misplacement_penalty(candidate: Candidate, constants: RobotConstants) -> float:
    """Return the log price of a mass added far from the centre of its body; 0 of other effects.

    Masses on neighbouring links are nearly confounded; an added mass is usually close to its body.
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
    unlikely = 0.5 * float(away @ away) / ADDED_MASS_OFFSET**2
    return known * min(unlikely, MAX_CHANGE_PARAMETERS)


def exchange_rivals(
    comparison: Comparison,
    current: Comparison,
    effects: list[LocatedEffect],
    catalogue: Sequence[Effect],
    tell: Say,
    before: Sequence[Selected] = (),
    *,
    refuted: Collection[str] = (),
) -> tuple[Comparison, list[Selected]]:
    """Replace effects by their likeliest rivals until nothing changes; return them ranked.

    `refuted`: labels of effects that stretches left out did not support; they replace nothing.
    """
    ranked = rank_effects(current, effects, catalogue, tell, before)
    seen = [_places(effects)]
    while (likelier := _exchange_apart(ranked, refuted)) != effects:
        if _places(likelier) in seen:
            # Effects that replace each other in turns are dropped.
            kept = [r.located for r in ranked if _replacement(r, refuted) is None]
            current, effects = fit_jointly(comparison, kept)
            ranked = rank_effects(current, effects, catalogue, tell)
            break
        seen.append(_places(likelier))
        current, effects = fit_jointly(comparison, likelier)
        ranked = rank_effects(current, effects, catalogue, tell, ranked)
    if len(ranked) < len(effects):
        current, effects = fit_jointly(comparison, [r.located for r in ranked])
        ranked = rank_effects(current, effects, catalogue, tell, ranked)
    return current, ranked


def rank_effects(
    comparison: Comparison,
    effects: list[LocatedEffect],
    catalogue: Sequence[Effect],
    say: Say,
    before: Sequence[Selected] = (),
) -> list[Selected]:
    """Rank effects among their rivals, without those that have become insignificant.

    An earlier ranking is reused if no possible rival has changed.
    """
    known = {r.located.key[:-1]: r for r in before}
    places = {e.key[:-1] for e in effects}
    changed = [e for e in effects if e.key[:-1] not in known]
    changed += [r.located for key, r in known.items() if key not in places]
    found = []
    pace = RoundProgress(len(effects))
    for number, located in enumerate(effects):
        old = known.get(located.key[:-1])
        if old is not None and not any(located.is_adjacent(other) for other in changed):
            found.append(replace(old, located=located))
            continue
        say(f"compare {located.label} with its rivals ({pace.words(number)})")
        new = rank_rivals(comparison, effects, located, catalogue, tell=say)
        if new is not None:
            found.append(new)
    return found


def _replacement(each: Selected, refuted: Collection[str]) -> LocatedEffect | None:
    """Return the rival that takes the place of an effect, if any."""
    likelier = each.likelier
    return None if likelier is None or likelier.label in refuted else likelier


def _exchange_apart(ranked: Sequence[Selected], refuted: Collection[str]) -> list[LocatedEffect]:
    """Return the effects with the surest exchanges that do not touch each other.

    Each rival is judged with all other effects kept: of several exchanges at neighbouring places
    only one may be made before the others are judged again. A new load is a likelier rival of
    every friction at the joints that carry it, and would replace them all.
    """
    made: dict[int, LocatedEffect] = {}
    touched: list[LocatedEffect] = []
    for each in sorted(ranked, key=lambda r: r.probability):
        likelier = _replacement(each, refuted)
        if likelier is None:
            continue
        pair = (each.located, likelier)
        if not any(own.is_adjacent(other) for own in pair for other in touched):
            made[id(each)] = likelier
            touched += pair
    kept: list[LocatedEffect] = []
    for each in ranked:
        located = made.get(id(each), each.located)
        # One effect may be the likeliest rival of several.
        if not any(located.same_place(other) for other in kept):
            kept.append(located)
    return kept


def _places(effects: Sequence[LocatedEffect]) -> set[tuple[object, ...]]:
    return {each.key[:-1] for each in effects}
