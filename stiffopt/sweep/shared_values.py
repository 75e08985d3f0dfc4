"""Values of several arms of one type: which are common to all, and which are each arm's own.

Every arm's fit gives a value with its standard deviation, less what was expected of all arms alike
before it. Their weighted mean is the joint fit of one value to all recordings; the weighted squares
of the distances from it test that there is one (Cochran 1954). Values that fail the test, at a
level that Holm (1979) divides among all of them, are each arm's own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

_Place = tuple[int | None, str, str]  # joint, parameter, case
# Chance that any value at all is called an arm's own where all are common.
_TEST_LEVEL = 0.05
# Largest deviation over the expected one of a value that the recordings tell.
_MAX_UNTOLD = 0.7


@dataclass(frozen=True, kw_only=True)
class SharedValue:
    """One value of several arms."""

    joint: int | None  # from 1; None for a value of the arm
    parameter: str
    case: str  # changed entries of the fits, which are compared with each other only; "" for none
    unit: str
    # Common to all arms, expected value included.
    value: float
    sd: float
    # (str, float, float) each arm's name, value and standard deviation.
    arms: tuple[tuple[str, float, float], ...]
    p: float  # chance of such differences where the value is common
    common: bool  # the differences are no larger than chance makes them, among all values tested


def shared_values(arms: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[SharedValue]:
    """Return all values that at least two arms tell, those that differ most first.

    `arms`: values by arm: `joint`, `parameter`, `case`, `unit`, `value`, `sd`, `expected`,
    `expected_sd`.
    """
    found: dict[_Place, dict[str, Mapping[str, Any]]] = {}
    for arm, values in arms.items():
        for own in values:
            if 0.0 < own["sd"] < _MAX_UNTOLD * own["expected_sd"]:
                place = own["joint"], own["parameter"], own["case"]
                found.setdefault(place, {})[arm] = own
    tested = [_test(place, own) for place, own in found.items() if len(own) > 1]
    tested.sort(key=lambda each: each.p)
    kept, common = [], False
    for k, each in enumerate(tested):
        common = common or each.p > _TEST_LEVEL / (len(tested) - k)
        kept.append(replace(each, common=common))
    return kept


def _test(place: _Place, own: Mapping[str, Mapping[str, Any]]) -> SharedValue:
    from scipy.special import chdtrc  # heavy, and needed after the solves only

    value, sd, expected, expected_sd = (
        np.array([each[key] for each in own.values()])
        for key in ("value", "sd", "expected", "expected_sd")
    )
    # What the recordings alone tell: the expected value counts once, not once an arm.
    weight = 1.0 / sd**2 - 1.0 / expected_sd**2
    alone = (value / sd**2 - expected / expected_sd**2) / weight
    mean = float(weight @ alone / weight.sum())
    squares = float(weight @ (alone - mean) ** 2)
    prior = 1.0 / float(np.mean(expected_sd)) ** 2
    total = float(weight.sum()) + prior
    return SharedValue(
        joint=place[0],
        parameter=place[1],
        case=place[2],
        unit=str(next(iter(own.values()))["unit"]),
        value=(float(weight.sum()) * mean + prior * float(np.mean(expected))) / total,
        sd=float(total**-0.5),
        arms=tuple((arm, float(v), float(s)) for arm, v, s in zip(own, value, sd, strict=True)),
        p=float(chdtrc(len(own) - 1, squares)),
        common=False,
    )
