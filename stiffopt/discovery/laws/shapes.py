"""Shapes of the forms of laws: units, initial values and bounds over the range of a signal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

ShapeUnit = Literal["signal", "per signal", "s", "Hz", ""]


@dataclass(frozen=True, kw_only=True)
class SignalRange:
    """Range of a signal in the recordings."""

    low: float
    high: float
    duration: float  # of the longest recording [s], or the whole range of a clock
    rate: float  # rate up to which recordings resolve a motion [Hz]
    # Likeliest frequencies of the residual over a clock [Hz], or orders over an angle beyond those
    # of the grid [1/rad].
    peaks: tuple[float, ...] = ()

    @property
    def size(self) -> float:
        """Largest magnitude."""
        return max(abs(self.low), abs(self.high), 1e-12)

    @property
    def span(self) -> float:
        """Difference of the ends."""
        return max(self.high - self.low, 1e-12)

    def at(self, *shares: float) -> tuple[float, ...]:
        """Return values at shares of the range."""
        return tuple(self.low + share * (self.high - self.low) for share in shares)


@dataclass(frozen=True)
class FormShape:
    """Shape of a form."""

    name: str
    unit: ShapeUnit  # "signal" and "per signal" stand for the unit of the signal
    starts: Callable[[SignalRange], Sequence[float]]  # range of the signal -> initial values
    # Range of the signal -> lowest and highest value.
    bounds: Callable[[SignalRange], tuple[float, float]]
    # True for a periodic form's: the recordings tell it to within its lower bound, so that as many
    # values are tried as that fits into the upper one.
    periodic: bool = False

    def unit_of(self, signal: str) -> str:
        """Return its unit for a signal of a unit."""
        if self.unit == "signal":
            return signal
        if self.unit == "per signal":
            return f"1/({signal})" if "/" in signal else f"1/{signal}" if signal else ""
        return self.unit


def scale(name: str, *shares: float, least: float = 0.02, most: float = 5.0) -> FormShape:
    """Return a scale, with starts and bounds as shares of the largest magnitude."""
    return FormShape(
        name,
        "signal",
        lambda r: tuple(share * r.size for share in shares),
        lambda r: (least * r.size, most * r.size),
    )


def width(name: str, *shares: float, least: float = 0.01, most: float = 1.5) -> FormShape:
    """Return a width, with starts and bounds as shares of the span."""
    return FormShape(
        name,
        "signal",
        lambda r: tuple(share * r.span for share in shares),
        lambda r: (least * r.span, most * r.span),
    )


def centre(name: str, *shares: float, beyond: float = 0.1) -> FormShape:
    """Return a place, with starts at shares of the range, and bounds a share of it beyond."""

    def bounds(r: SignalRange) -> tuple[float, float]:
        low, high = r.at(-beyond, 1.0 + beyond)
        return low, high

    return FormShape(name, "signal", lambda r: r.at(*shares), bounds)


def fixed(
    name: str, unit: ShapeUnit, starts: Sequence[float], low: float, high: float
) -> FormShape:
    """Return a shape with starts and bounds whatever the range."""
    return FormShape(name, unit, lambda r: tuple(starts), lambda r: (low, high))


# Orders of an angle up to the first value are tried in steps that the range tells apart, with any
# carrier; higher ones, of gears and motors, where the residual has peaks [1/rad]. Fewer waves than
# the second value within the range are no period.
MAX_GRID_ORDER, _MIN_WAVES = 60.0, 0.6
_ORDERS_PER_WAVE = 3.0


def _orders(r: SignalRange) -> tuple[float, ...]:
    """Return orders that the range tells apart."""
    step = 2.0 * np.pi / r.span / _ORDERS_PER_WAVE
    low, high = _order_bounds(r)
    grid = np.arange(low, min(high, MAX_GRID_ORDER), step)
    return (*(grid.tolist() or [low]), *r.peaks)


def _order_bounds(r: SignalRange) -> tuple[float, float]:
    low = 2.0 * np.pi * _MIN_WAVES / r.span
    return low, max(MAX_GRID_ORDER, 2.0 * low, *(1.1 * order for order in r.peaks))


def _frequency_bounds(r: SignalRange) -> tuple[float, float]:
    low = 2.0 / r.duration
    return low, max(0.4 * r.rate, 2.0 * low)


# Ratio of neighbouring frequencies of a mode that are tried: between them a fit finds its way.
_MODE_RATIO = 1.2


def _mode_bounds(r: SignalRange) -> tuple[float, float]:
    """Return the frequencies of hidden modes that ring in a recording and that its rows show."""
    low = 1.5 / r.duration
    return low, max(0.4 * r.rate, 2.0 * low)


def _mode_frequencies(low: float, high: float) -> tuple[float, ...]:
    count = 1 + int(np.log(high / low) / np.log(_MODE_RATIO))
    return tuple(np.geomspace(low, high, count))


SCALE_SHAPE = scale("s", 0.1, 0.3, 1.0)
# Shares of the range at which places are tried, up to near its ends: a fit moves a sharp step by
# little more than its width, since beyond it the rows say nothing of it.
_PLACE_STARTS = tuple(np.linspace(0.04, 0.96, 9).tolist())
PLACE_SHAPE = centre("c", *_PLACE_STARTS)
ORDER_SHAPE = FormShape("k", "per signal", _orders, _order_bounds, periodic=True)
FREQUENCY_SHAPE = FormShape("f", "Hz", lambda r: r.peaks, _frequency_bounds, periodic=True)
MODE_SHAPES = (
    FormShape("f", "Hz", lambda r: _mode_frequencies(*_mode_bounds(r)), _mode_bounds),
    fixed("zeta", "", (0.03, 0.2), 0.002, 1.5),
)
LAG_SHAPE = fixed("T", "s", (0.05, 0.2, 1.0), 0.01, 10.0)
PLAY_SHAPE = width("r", 0.01, 0.05, least=1e-3, most=0.5)
HINGE_POWER_SHAPE = fixed("n", "", (1.5, 3.0), 1.0, 5.0)
