"""Signals read at other instants: delayed, ahead, or on a clock of another rate."""

from __future__ import annotations

import numpy as np

from stiffopt.discovery.effect import Term, Values
from stiffopt.discovery.signals import RobotSignals

# Shortest shift [s] whose slope rounding errors leave exact.
_SHORTEST_SHIFT = 1e-9


def shift_slope(
    values: np.ndarray, dt: float, shift: float, growth: np.ndarray | float = 1.0
) -> np.ndarray:
    """Return (values(t - shift) - values(t))/shift (K, n), per unit of the shift.

    Parameters
    ----------
    values : array (K, n)
        At uniform instants.
    dt : float
        [s]
    shift : float
        [s], or relative where it grows with the time.
    growth : float or array (K,)
        Factor on the shift at every instant: 1, or the time [s].
    """
    shift = shift if abs(shift) >= _SHORTEST_SHIFT else _SHORTEST_SHIFT
    return np.asarray((shift_samples(values, shift / dt * growth) - values) / shift)


def delay_term(signals: RobotSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return tau(t - d) - tau(t) of all joints, linear in d about the delay of the shape."""
    slope = shift_slope(signals.drive_torque, signals.dt, shapes[0])
    return Term(drive_torque=amplitudes[0] * slope)


def shift_samples(values: np.ndarray, samples: np.ndarray | float) -> np.ndarray:
    """Return values (K, n) of earlier instants, by cubic convolution; constant beyond the ends.

    Parameters
    ----------
    values : array (K, n)
        At uniform instants.
    samples : float or array (K,)
        Delay in samples; negative for later instants.
    """
    places = np.arange(len(values)) - np.asarray(samples, dtype=float)
    before = np.floor(places).astype(int)
    found = np.zeros_like(values)
    for tap in range(-1, 3):
        rows = np.clip(before + tap, 0, len(values) - 1)
        found += _cubic_weight(places - before - tap)[:, None] * values[rows]
    return found


def _cubic_weight(away: np.ndarray) -> np.ndarray:
    """Return the weight of a sample at a distance in samples (Keys 1981)."""
    near, far = np.fmin(np.abs(away), 1.0), np.fmin(np.fmax(np.abs(away), 1.0), 2.0)
    inner = 1.5 * near**3 - 2.5 * near**2 + 1.0
    return np.asarray(inner - 0.5 * far**3 + 2.5 * far**2 - 4.0 * far + 2.0)
