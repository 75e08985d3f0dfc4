"""Tables of a diagnosis beside its findings: detection limits, moved values, hidden effects.

All values are SI.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.answer import MIN_LISTED_PROBABILITY
from stiffopt.discovery.comparison.inertial_parameters import INERTIAL_PARAMETER_NAMES
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.diagnosis import Diagnosis, Finding
from stiffopt.discovery.identifiable import EffectCheck
from stiffopt.discovery.judging.detection_limits import DetectionLimit
from stiffopt.discovery.names import ValueName
from stiffopt.report.common.text import MAX_LISTED, percent

_INERTIAL_UNITS = ("kg", *("kg m",) * 3, *("kg m^2",) * 6)


@dataclass(frozen=True)
class MovedValue:
    """A nominal value that was moved within its tolerance."""

    name: ValueName
    unit: str  # "" for a relative change
    # The tolerance is one standard deviation.
    change: float
    tolerance: float


@dataclass(frozen=True)
class MovedBody:
    """A link of a re-identified rigid model."""

    link: str
    # (name, change, sd, unit) identifiable inertial parameters, with standard deviations of the
    # linear model.
    shown: tuple[tuple[str, float, float, str], ...]
    # Number of parameters that are not identifiable and remain near their nominal values.
    hidden: int


@dataclass(frozen=True)
class UndetectableEffects:
    """Effects that are not identifiable at joints (from 1; none: the robot), with reasons."""

    joints: tuple[int, ...]
    lacks: tuple[str, ...]
    effects: tuple[str, ...]


def candidates(finding: Finding) -> list[tuple[LocatedEffect, float]]:
    """Return a finding and its rivals, the most probable first."""
    every = [(finding.located, finding.probability)]
    every += [(rival.located, rival.probability) for rival in finding.rivals]
    shown = [pair for pair in every if pair[1] >= MIN_LISTED_PROBABILITY]
    return sorted(shown, key=lambda pair: -pair[1])


def limits_by_effect(
    diagnosis: Diagnosis,
) -> dict[tuple[str, str], dict[int | None, DetectionLimit]]:
    """Return detection limits by effect and parameter, then joint (None: robot)."""
    found: dict[tuple[str, str], dict[int | None, DetectionLimit]] = {}
    for limit in _lasting_limits(diagnosis):
        found.setdefault((limit.effect.title, limit.parameter), {})[limit.joint] = limit
    return found


def _lasting_limits(diagnosis: Diagnosis) -> list[DetectionLimit]:
    """Return the limits of effects that act in all runs."""
    return [limit for limit in diagnosis.detection_limits if not limit.effect.only_in]


def sharpest_limits(diagnosis: Diagnosis) -> list[str]:
    """Return sentences on the smallest detectable relative changes."""
    known = [limit for limit in _lasting_limits(diagnosis) if limit.relative is not None]
    best: dict[str, DetectionLimit] = {}
    for limit in sorted(known, key=lambda each: each.relative or 0.0):
        best.setdefault(limit.effect.nominal_words, limit)
    return [
        f"A change of {name} by more than {percent(limit.relative)} at joint {limit.joint} would "
        "have been detected."
        for name, limit in best.items()
    ]


def moved_values(diagnosis: Diagnosis) -> list[MovedValue]:
    """Return the nominal values that moved most relative to their tolerances."""
    names, sd = diagnosis.search.comparison.priors
    moved = diagnosis.search.fit.posterior.mean[: len(names)]
    units = {"com": "m", "encoder_zero": "rad"}
    order = [k for k in np.argsort(-np.abs(moved / sd)) if names[k].kind != "body"]
    return [
        MovedValue(names[k], units.get(names[k].kind, ""), float(moved[k]), float(sd[k]))
        for k in order[:MAX_LISTED]
    ]


def moved_bodies(diagnosis: Diagnosis) -> list[MovedBody]:
    """Return the links of a re-identified rigid model with their identifiable changes."""
    comparison, posterior = diagnosis.search.comparison, diagnosis.search.fit.posterior
    if comparison.bodies is None:
        return []
    found = []
    for body, prior in enumerate(comparison.bodies):
        own = slice(10 * body, 10 * body + 10)
        spread = np.sqrt(np.diag(posterior.covariance)[own])
        change = posterior.mean[own]
        # Identifiable where the standard deviation is below this share of the prior's.
        shown = [
            (name, float(value), float(sd), unit)
            for name, value, sd, wide, unit in zip(
                INERTIAL_PARAMETER_NAMES, change, spread, prior, _INERTIAL_UNITS, strict=True
            )
            if sd < 0.3 * wide
        ]
        link = diagnosis.training.constants.links[body]
        if shown:
            found.append(MovedBody(link=link, shown=tuple(shown), hidden=10 - len(shown)))
    return found


def undetectable_effects(checks: Sequence[EffectCheck]) -> list[UndetectableEffects]:
    """Return effects that are not identifiable, grouped by joints and reasons."""
    joints: dict[tuple[str, tuple[str, ...]], tuple[int, ...]] = {}
    for check in checks:
        if not check.possible:
            reason = check.effect.title, check.lacks
            joints[reason] = joints.get(reason, ()) + ((check.joint,) if check.joint else ())
    effects: dict[tuple[tuple[int, ...], tuple[str, ...]], list[str]] = {}
    for (effect, lacks), where in joints.items():
        effects.setdefault((where, lacks), []).append(effect)
    return [UndetectableEffects(*place, tuple(names)) for place, names in effects.items()]
