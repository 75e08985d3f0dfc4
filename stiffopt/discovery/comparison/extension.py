"""What was found, beside the nominal model: calibrated values and effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from stiffopt.discovery.comparison.located_effect import LocatedEffect


@dataclass(frozen=True, kw_only=True, eq=False)
class EstimatedEffect:
    """An effect at a place, with its amplitudes.

    Parameters
    ----------
    located : LocatedEffect
    amplitudes : tuple of float
        In the amplitudes' own units.
    step : float
        Of the first amplitude, from what the fit found to what all moving samples say.
    """

    located: LocatedEffect
    amplitudes: tuple[float, ...]
    step: float = 0.0

    @property
    def fitted(self) -> EstimatedEffect:
        """The effect as the fit found it."""
        first, *others = self.amplitudes
        return replace(self, amplitudes=(first - self.step, *others), step=0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Extension:
    """Change of a nominal model.

    Parameters
    ----------
    calibration : mapping of str to float
        Change of nominal values by their names ("coulomb 3", "com 2 x", "body 2 mx"): relative,
        [m], [rad], or of the inertial parameters of a body.
    effects : tuple of EstimatedEffect
    """

    calibration: Mapping[str, float] = field(default_factory=dict)
    effects: tuple[EstimatedEffect, ...] = ()

    def plus(self, later: Extension) -> Extension:
        """Both in one."""
        names = {**self.calibration, **later.calibration}
        return Extension(
            calibration={
                name: self.calibration.get(name, 0.0) + later.calibration.get(name, 0.0)
                for name in names
            },
            effects=(*self.effects, *later.effects),
        )

    def minus(self, other: Extension) -> Extension:
        """What this one has beyond another."""
        names = {**self.calibration, **other.calibration}
        taken = (
            replace(e, amplitudes=tuple(-value for value in e.amplitudes)) for e in other.effects
        )
        return Extension(
            calibration={
                name: self.calibration.get(name, 0.0) - other.calibration.get(name, 0.0)
                for name in names
            },
            effects=(*self.effects, *taken),
        )

    @property
    def fitted(self) -> Extension:
        """The extension as the fit found it, without steps to all moving samples."""
        return replace(self, effects=tuple(each.fitted for each in self.effects))

    @property
    def empty(self) -> bool:
        """Whether nothing is changed."""
        return not self.effects and not any(self.calibration.values())


def with_amplitudes(
    effects: Sequence[LocatedEffect], scaled: np.ndarray, sizes: Sequence[np.ndarray]
) -> tuple[EstimatedEffect, ...]:
    """Effects with amplitudes given over their sizes, one effect's after another's."""
    out, begin = [], 0
    for located, size in zip(effects, sizes, strict=True):
        own = scaled[begin : begin + len(size)] * size
        out.append(EstimatedEffect(located=located, amplitudes=tuple(float(v) for v in own)))
        begin += len(size)
    return tuple(out)
