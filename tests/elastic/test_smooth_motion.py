"""Smoothing of a plan: distance, ends, continuity."""

from __future__ import annotations

import numpy as np
import pytest

from stiffopt.elastic.smooth_motion import smooth_motion
from stiffopt.result.trajectory import Trajectory


def jerky(jerk=200.0, step=0.1):
    """Rest to rest with a jerk of constant size that jumps: the hardest plan of limited jerk."""
    signs = np.array([1.0, -1.0, -1.0, 1.0]) * jerk
    nodes = np.concatenate([[0.0], np.cumsum(signs * step)])
    return Trajectory.piecewise_linear_acceleration(
        step * np.arange(5), nodes[:, None], [0.1], [0.0]
    )


@pytest.mark.parametrize("spacing", [0.005, 0.01])
def test_smooth_motion_is_near_the_plan_and_rests_at_both_ends(spacing):
    plan = jerky()
    found = smooth_motion(plan, spacing)
    assert found.duration == pytest.approx(plan.duration)
    t = np.linspace(0.0, plan.duration, 2001)
    off = np.max(np.abs(found(t) - plan(t)))
    assert off < 0.2 * 200.0 * spacing**3
    for order in range(1, 5):
        ends = np.abs(found([0.0, plan.duration], order))
        assert np.max(ends) < 1e-8 * np.max(np.abs(found(t, order)))


def test_smooth_motion_has_a_continuous_fifth_derivative():
    found = smooth_motion(jerky(), 0.01)
    breaks = found.times[1:-1]
    before, after = found(breaks - 1e-9, 5), found(breaks + 1e-9, 5)
    assert np.max(np.abs(after - before)) < 1e-4 * np.max(np.abs(after))


def test_polynomial_of_the_spline_degree_is_reproduced():
    # x^5 (1 - x)^2 has rest up to the fourth derivative at one end only: shift both.
    t = np.linspace(0.0, 1.0, 201)
    shape = np.polynomial.Polynomial([0, 0, 0, 0, 0, 126, -420, 540, -315, 70])

    class Plan:
        duration = 1.0

        def __call__(self, times, order=0):
            return shape(np.asarray(times))[:, None]

    found = smooth_motion(Plan(), 0.02)
    assert np.max(np.abs(found(t)[:, 0] - shape(t))) < 1e-10
