"""Signals read at other instants: delayed, ahead, or on a clock of another rate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from stiffopt.discovery.effect import Term
from stiffopt.discovery.signals import RobotSignals
from stiffopt.symbolic import Quantity, is_symbolic

# Shortest shift [s] whose slope rounding errors leave exact.
_SHORTEST_SHIFT = 1e-9


def shift_slope(
    values: Quantity, dt: float, shift: Quantity, longest: float, *, growth: Any = 1.0
) -> Quantity:
    """Return (values(t - shift) - values(t))/shift (K, n), per unit of the shift.

    Parameters
    ----------
    values : array (K, n)
        At uniform instants.
    dt : float
        [s]
    shift : float or symbol
        [s], or relative where it grows with the time.
    longest : float
        Largest size of the shift at any instant [s].
    growth : float or array (K,)
        Factor on the shift at every instant: 1, or the time [s].
    """
    if not is_symbolic(shift) and abs(shift) < _SHORTEST_SHIFT:
        shift = _SHORTEST_SHIFT
    reach = int(longest / dt) + 1
    return (shift_samples(values, shift / dt * growth, -reach, reach) - values) / shift


def delay_term(
    longest: float,
    signals: RobotSignals,
    amplitudes: Sequence[Quantity],
    shapes: Sequence[Quantity],
) -> Term:
    """Return tau(t - d) - tau(t) of all joints, linear in d about the delay of the shape.

    Parameters
    ----------
    longest : float
        Largest size of the delay [s].
    signals : RobotSignals
    amplitudes, shapes : sequence
        The delay d, and the one that the term is linear about [s].
    """
    slope = shift_slope(signals.drive_torque, signals.dt, shapes[0], longest)
    return Term(drive_torque=amplitudes[0] * slope)


def shift_samples(values: Quantity, samples: Any, least: int, most: int) -> Quantity:
    """Return values (K, n) of earlier instants, by cubic convolution; constant beyond the ends.

    Parameters
    ----------
    values : array (K, n)
        At uniform instants.
    samples : float or array (K,), or symbol
        Delay in samples; negative for later instants.
    least, most : int
        Range of the delay, for symbols, whose taps cannot be selected.
    """
    if is_symbolic(samples) or is_symbolic(values):
        taps = range(least - 2, most + 3)
        return sum(
            (_cubic_weight(samples - k) * _shift_whole_samples(values, k) for k in taps), 0.0
        )
    places = np.arange(len(values)) - np.asarray(samples, dtype=float)
    before = np.floor(places).astype(int)
    found = np.zeros_like(values)
    for tap in range(-1, 3):
        rows = np.clip(before + tap, 0, len(values) - 1)
        found += _cubic_weight(places - before - tap)[:, None] * values[rows]
    return found


def _cubic_weight(away: Quantity) -> Quantity:
    """Return the weight of a sample at a distance in samples (Keys 1981)."""
    near, far = np.fmin(np.abs(away), 1.0), np.fmin(np.fmax(np.abs(away), 1.0), 2.0)
    inner = 1.5 * near**3 - 2.5 * near**2 + 1.0
    return inner - 0.5 * far**3 + 2.5 * far**2 - 4.0 * far + 2.0


def _shift_whole_samples(values: Quantity, samples: int) -> Quantity:
    places = np.clip(np.arange(values.shape[0]) - samples, 0, values.shape[0] - 1)
    return values[places.tolist(), :]
