from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from formula_checks import (
    CheckFailed,
    check_derivative,
    check_monotone,
    check_odd,
    check_smoothed_against_exact,
)

from stiffopt.errors import StiffoptError

POINTS = np.linspace(-2.0, 2.0, 9)


def test_correct_formulas_pass() -> None:
    assert check_derivative(np.sin, np.cos, POINTS, scale=1.0) < 1e-9
    assert check_odd(np.sinh, POINTS) == 0.0
    assert check_monotone(lambda x: 3 * x, POINTS) == pytest.approx(1.5)


def test_wrong_derivative_is_located() -> None:
    with pytest.raises(CheckFailed, match="derivative against differences") as caught:
        check_derivative(np.sin, lambda x: np.cos(x) + 1e-3 * (x > 1.7), POINTS, scale=1.0)
    assert caught.value.where == 2.0
    assert caught.value.found == pytest.approx(1e-3 / abs(np.cos(2.0)), rel=1e-3)
    assert caught.value.allowed == 1e-6


def test_failures_are_assertion_and_stiffopt_errors() -> None:
    with pytest.raises(AssertionError):
        check_odd(np.cosh, POINTS)
    with pytest.raises(StiffoptError, match="value at zero"):
        check_odd(np.cosh, POINTS)
    with pytest.raises(CheckFailed, match="relative mismatch"):
        check_odd(lambda x: x + 1e-6 * x**2, POINTS)
    with pytest.raises(CheckFailed, match="monotone"):
        check_monotone(np.cos, POINTS)
    with pytest.raises(CheckFailed, match="nan"):
        check_monotone(lambda x: np.full_like(x, np.nan), POINTS)
    with pytest.raises(CheckFailed):
        check_derivative(np.sin, lambda x: np.full_like(x, np.nan), POINTS, scale=1.0)


@dataclass
class Stepped:
    """Compliance 1 below a torque of 2 and 3 above it; a wind-up too large by `error`."""

    torque_max: float = 10.0
    error: float = 0.0

    def windup(self, torque: object) -> object:
        return (1 + self.error) * (torque + 2 * np.maximum(torque - 2.0, 0.0))

    def exact_tangent_compliance(self, torque: np.ndarray, *, preload: object = None) -> np.ndarray:
        return np.where(np.abs(torque) < 2.0, 1.0, 3.0)

    def breakpoints(self) -> tuple[float, ...]:
        return (2.0,)


def test_smoothed_against_exact_handles_jumps() -> None:
    assert check_smoothed_against_exact(Stepped(), 1e-12) < 1e-12
    assert check_smoothed_against_exact(Stepped(), 1e-12, from_torque=1.0) < 1e-12
    with pytest.raises(CheckFailed) as caught:
        check_smoothed_against_exact(Stepped(error=0.02), 0.01)
    assert caught.value.found == pytest.approx(0.02)
