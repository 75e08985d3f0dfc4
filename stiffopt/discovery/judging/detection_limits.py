"""Detection limits: least sizes of effects that the recordings would have shown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.catalogue.common import WEIGHT
from stiffopt.discovery.comparison.located_effect import LocatedEffect, effect_places
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.search.candidates import Scorer
from stiffopt.discovery.thresholds import NAMED_EVIDENCE


@dataclass(frozen=True)
class DetectionLimit:
    """Least value of a parameter that would have been found."""

    effect: Effect
    joint: int | None  # 1-based
    parameter: str
    value: float
    unit: str
    relative: float | None = None  # value over the nominal value that it changes, if there is one

    def __str__(self) -> str:
        place = f" on joint {self.joint}" if self.joint else ""
        share = f" ({100 * self.relative:.2g} %)" if self.relative is not None else ""
        unit = f" {self.unit}" if self.unit else ""
        return (
            f"{self.effect.title}{place}: {self.parameter} above "
            f"{self.value:.3g}{unit}{share} is detectable"
        )


def detection_limits(
    scorer: Scorer, catalogue: Sequence[Effect], seen: Sequence[LocatedEffect] = ()
) -> tuple[DetectionLimit, ...]:
    """Return the limits of every effect with a single amplitude, at every place.

    `scorer`: beside the findings. `seen`: effects found by the search, including dropped findings,
    which get no limit.

    The log evidence of an effect of amplitude a is a^2/(2 sd^2) less the price of its prior and
    shapes; sd is its standard deviation with nominal values profiled out.
    """
    single = (e for e in catalogue if len(e.amplitudes) == 1 and e.amplitudes[0] is not WEIGHT)
    return tuple(limit for effect in single for limit in _effect_limits(scorer, effect, seen))


def _effect_limits(
    scorer: Scorer, effect: Effect, seen: Sequence[LocatedEffect]
) -> Iterator[DetectionLimit]:
    constants = scorer.comparison.constants
    runs = [run.name for run in scorer.comparison.runs]
    by_place: dict[tuple[int | None, str | None], list[LocatedEffect]] = {}
    for located in effect_places(effect, constants, runs):
        if not any(located.same_place(other) for other in (*scorer.base, *seen)):
            by_place.setdefault((located.joint, located.run), []).append(located)
    for (joint, run), tried in by_place.items():
        if run is not None:
            continue
        middle = tried[len(tried) // 2]
        sd = scorer.deviation(middle)
        if sd is None or not sd < 1.0:
            continue
        size = float(middle.sizes(constants)[0])
        price = np.log(len(tried)) - np.log(sd)
        least = size * sd * float(np.sqrt(2.0 * (NAMED_EVIDENCE + price)))
        amplitude = effect.amplitudes[0]
        base = None
        if effect.nominal and joint is not None:
            base = getattr(constants.joints[joint], effect.nominal) or None
        name, value = amplitude.name, least
        if effect.report is not None:
            values = effect.parameters([least], middle.shapes, middle.constants(constants))
            name = next(iter(values))
            value = values[name]
        yield DetectionLimit(
            effect=effect,
            joint=None if joint is None else joint + 1,
            parameter=name,
            value=float(value),
            unit=middle.unit_of(name, constants),
            relative=None if base is None else least / base,
        )
