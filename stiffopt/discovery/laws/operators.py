"""Operators with memory: linear lags, a sprung mass, and the stop element of hysteresis.

Each takes a signal (K,) at equal time steps. Parameters may be floats or complex numbers (for
derivatives). `before`: the signal before its first sample, zero before that; None: that sample's.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.linalg import get_lapack_funcs

from stiffopt.symbolic import Quantity

# Operators that formulas of laws may name.
OPERATOR_NAMES = ("lag", "sprung", "mode", "stop", "speed_before", "acceleration_before")


def speed_before(speed: np.ndarray, acceleration: np.ndarray, dt: float) -> np.ndarray:
    """Return the speed of a joint before a recording that begins in motion.

    It has started from rest: by the first acceleration, if that leads to the first speed.
    """
    count = len(acceleration_before(speed, acceleration, dt))
    return np.asarray(speed[0] * np.arange(count) / max(count, 1))


def acceleration_before(speed: np.ndarray, acceleration: np.ndarray, dt: float) -> np.ndarray:
    """Return the acceleration of a joint before a recording that begins in motion."""
    if speed[0] * acceleration[0] <= 0.0:
        return np.zeros(0)
    count = round(min(speed[0] / (acceleration[0] * dt), len(speed)))
    return np.full(count, acceleration[0])


def lag(x: Quantity, T: Quantity, dt: float, before: np.ndarray | None = None) -> Quantity:
    """Return the first-order lag y of a signal, T dy/dt = x - y [unit of x]."""
    kept = np.exp(-dt / T)
    return _filter_linear([1.0 - kept], [1.0, -kept], x, before)


def sprung(
    x: Quantity, f: Quantity, zeta: Quantity, dt: float, before: np.ndarray | None = None
) -> Quantity:
    """Return the acceleration of a mass on a spring and damper whose base accelerates by x.

    With w = 2 pi f the transfer function is (2 zeta w s + w^2) / (s^2 + 2 zeta w s + w^2), here by
    the bilinear transform with exact frequency [unit of x].
    """
    return _filter_by_mode(x, f, zeta, dt, before, by_damper=True)


def mode(
    x: Quantity, f: Quantity, zeta: Quantity, dt: float, before: np.ndarray | None = None
) -> Quantity:
    """Return the mode y of a hidden mass that x pushes against a spring and a damper.

    As `sprung`, with the transfer function w^2 / (s^2 + 2 zeta w s + w^2) [unit of x].
    """
    return _filter_by_mode(x, f, zeta, dt, before, by_damper=False)


def _filter_by_mode(
    x: Quantity,
    f: Quantity,
    zeta: Quantity,
    dt: float,
    before: np.ndarray | None,
    *,
    by_damper: bool,
) -> Quantity:
    over = np.tan(np.pi * f * dt)  # half step of the angular frequency, prewarped
    damped, square = 2.0 * zeta * over, over * over
    through = damped if by_damper else 0.0 * damped
    b0, b1, b2 = through + square, 2.0 * square, square - through
    a0, a1, a2 = 1.0 + damped + square, 2.0 * square - 2.0, 1.0 - damped + square
    numerator, denominator = [b0 / a0, b1 / a0, b2 / a0], [a1 / a0, a2 / a0]
    return _filter_linear(numerator, [1.0, *denominator], x, before)


def stop(x: Quantity, r: Quantity) -> Quantity:
    """Return the stop element: follows x, and slides where it would leave -r to r [unit of x]."""
    left = []
    play = x[0]
    # Comparisons of floats: calls of min and max take three times as long.
    for value in x.tolist():
        low, high = value - r, value + r
        if play < low:
            play = low
        elif play > high:
            play = high
        left.append(value - play)
    return np.array(left)


def _filter_linear(
    b: Sequence[Any], a: Sequence[Any], x: np.ndarray, before: np.ndarray | None
) -> np.ndarray:
    """Filter a signal with what it has been before its first sample; the gain at rest is 1.

    As `scipy.signal.lfilter`, whose import takes half a second: its recurrence is a triangular
    system with as many diagonals as coefficients.
    """
    start, past = (x[0], np.zeros(0)) if before is None else (0.0, np.atleast_1d(before))
    whole = np.concatenate([past, x - start])
    driven = np.convolve(whole, b)[: len(whole)]
    diagonals = np.repeat(np.array(a)[:, None], len(whole), axis=1)
    (solve,) = get_lapack_funcs(("tbtrs",), (diagonals, driven))
    return np.asarray(start + solve(diagonals, driven, uplo="L")[0][len(past) :])
