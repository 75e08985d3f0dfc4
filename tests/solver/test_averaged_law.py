"""Averages of time laws: rates, ends, and the distance covered."""

import numpy as np
import pytest

from stiffopt.path.averaged_law import averaged_law
from stiffopt.result.trajectory import Trajectory

# Jerk 60, -60, 60 for a quarter, a half and a quarter of the time: from 0 to 1 and rest to rest.
LAW = Trajectory.from_acceleration(
    [0.0, 0.25, 0.75, 1.0],
    [[[0.0], [32.0]], [[8.0], [-32.0]], [[-8.0], [32.0]]],
    [0.0],
    [0.0],
)


def test_law_is_one_of_rest_to_rest():
    assert LAW(np.array([1.0]))[0, 0] == pytest.approx(1.0)


def test_average_is_that_of_a_double_window():
    law = averaged_law(LAW, 0.1)
    assert law.duration == pytest.approx(1.2, rel=1e-3)
    np.testing.assert_allclose(law(np.array([0.0, law.duration]))[:, 0], [0.0, 1.0], atol=1e-9)
    fine = np.linspace(0.0, law.duration, 24001)
    window = round(0.1 / fine[1])
    whole = np.interp(fine, np.linspace(0, 1, 20001), LAW(np.linspace(0, 1, 20001))[:, 0])
    kernel = np.ones(window) / window
    once = np.convolve(whole, kernel)[: len(fine)]
    twice = np.convolve(once, kernel)[: len(fine)]
    np.testing.assert_allclose(law(fine)[:, 0], twice, atol=2e-4)


def test_no_rate_grows_and_the_jerk_is_continuous():
    law = averaged_law(LAW, 0.1)
    time = np.linspace(0.0, law.duration, 20001)
    for order in (1, 2, 3):
        largest = np.abs(LAW(np.linspace(0, 1, 2001), order)).max()
        assert np.abs(law(time, order)).max() <= (1.0 + 1e-6) * largest
    assert np.abs(np.diff(law(time, 3)[:, 0])).max() < 0.05
    np.testing.assert_allclose(law(time[[0, -1]], 3), 0.0, atol=1e-6)
