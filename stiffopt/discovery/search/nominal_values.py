"""Nominal values outside their stated tolerances, as effects that compete like any other.

A nominal value that is fitted far outside its tolerance is an effect of the catalogue under another
name: dry friction that has grown by a fifth is the effect `coulomb`, a torque constant that is off
is `torque_gain`. One at a time such values gain too little evidence for a search of thousands of
shapes, which they are not: place and form are known before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.comparison.nuisance import MIN_TOLERANCES_OUTSIDE, OutsideValue
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.progress import Say
from stiffopt.discovery.search.candidates import Candidate, Scorer
from stiffopt.discovery.search.joint_fit import fit_jointly
from stiffopt.discovery.search.rivals import Selected, rank_rivals
from stiffopt.discovery.thresholds import NAMED_EVIDENCE, UNEXPLAINED_RATIO
from stiffopt.recording.nominal import Tolerance

# Largest standard deviation of a value outside its tolerance, in tolerances: a less determined one
# follows others.
_MAX_DEVIATION_OUTSIDE = 0.5


def values_outside_tolerance(
    comparison: Comparison, effects: Sequence[LocatedEffect]
) -> tuple[OutsideValue, ...]:
    """Return the nominal values outside their tolerances beside effects, the furthest first.

    Without bounds: bounded values push others, which take over their part, to their bounds.
    """
    posterior = comparison.fit(effects, boxed=False).posterior
    names, tolerances = comparison.priors
    known = {field.name for field in fields(Tolerance)}
    found = [
        OutsideValue(name, float(change), float(sd), float(tolerance))
        for name, tolerance, change, sd in zip(
            names, tolerances, posterior.mean, np.sqrt(np.diag(posterior.covariance)), strict=False
        )
        if name.kind in known
        and abs(change) > MIN_TOLERANCES_OUTSIDE * tolerance
        and sd < _MAX_DEVIATION_OUTSIDE * tolerance
    ]
    return tuple(sorted(found, key=lambda each: -abs(each.change) / each.tolerance))


def claim_outside_values(
    start: Comparison,
    current: Comparison,
    ranked: list[Selected],
    catalogue: Sequence[Effect],
    most: int,
    tell: Say,
) -> tuple[Comparison, list[Selected]]:
    """Add the effects of nominal values outside their tolerances, and rank all effects anew.

    Only where nominal values and effects explain the recordings: beside a residual they stand for
    an effect that is missing. More than `most` values at once stand for one as well. A default
    tolerance says little of this robot: its values need the evidence of any other effect.
    """
    effects = [each.located for each in ranked]
    stated = current.robot.recordings.tolerance
    outside = values_outside_tolerance(current, effects)
    if not outside or len(outside) > most:
        return current, ranked
    left = current.channel_ratio(current.fit(effects, boxed=False).residual)
    if not np.nanmax(left / current.least) < UNEXPLAINED_RATIO:
        return current, ranked
    wanted, scorer = list(effects), Scorer(current, effects)
    for value in outside:
        located = _locate_effect(value, catalogue, current)
        if located is None or any(located.same_place(other) for other in wanted):
            continue
        by_default = getattr(stated, value.name.kind) is None
        if by_default and not _is_evident(scorer.score(located)):
            continue
        wanted.append(located)
    if len(wanted) == len(effects):
        return current, ranked
    wider, found = fit_jointly(start, wanted)
    # The search has tried to exchange them: rivals that gained enough are among the effects.
    again = (rank_rivals(wider, found, each, catalogue, tell=tell) for each in found)
    return wider, [each for each in again if each is not None]


def _is_evident(found: Candidate | None) -> bool:
    return found is not None and found.evidence > NAMED_EVIDENCE


def _locate_effect(
    value: OutsideValue, catalogue: Sequence[Effect], comparison: Comparison
) -> LocatedEffect | None:
    """Return the effect of the catalogue that changes a nominal value; None where none does."""
    constants, last = comparison.constants, comparison.robot.n - 1
    for effect in catalogue:
        if value.name.kind not in effect.tolerances:
            continue
        of_last = effect.scope == "robot"
        if value.of_body and of_last != (value.name.place == last):
            continue
        located = LocatedEffect(
            effect=effect,
            joint=value.name.place if effect.scope == "joint" else None,
            link=value.name.place if effect.scope == "link" else None,
        )
        own = located.constants(constants)
        if effect.applies is None or effect.applies(own):
            return located
    return None
