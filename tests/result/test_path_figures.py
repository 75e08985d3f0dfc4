"""Figures of a path after ISO 9283 on a corner with a known error."""

import numpy as np
import pytest

from stiffopt.result.path_figures import distances_to_path, path_figures

SIDE = np.linspace(0.0, 0.2, 2001)
COMMAND = np.vstack(
    [
        np.stack([SIDE, 0 * SIDE, 0 * SIDE], axis=1),
        np.stack([0 * SIDE[1:] + 0.2, SIDE[1:], 0 * SIDE[1:]], axis=1),
    ]
)


def test_distance_is_that_from_the_path_not_from_the_simultaneous_place():
    late = COMMAND[:-50] + np.array([0.0, 0.0, 1e-3])
    np.testing.assert_allclose(distances_to_path(late, COMMAND), 1e-3, rtol=1e-9)


def test_corner_is_rounded_inside_and_overshot_behind():
    actual = COMMAND.copy()
    behind = np.arange(len(COMMAND)) > 2000
    way = SIDE[1:]
    # Cut by 3 mm at the corner, then swinging out by 0.4 mm.
    actual[~behind, 1] += 3e-3 * np.exp(-((0.2 - SIDE) / 5e-3))
    actual[behind, 0] += 4e-4 * np.sin(np.pi * np.minimum(way / 0.02, 2.0)) * (way < 0.02)
    found = path_figures(COMMAND, actual, np.array([[0.2, 0.0, 0.0]]), 0.05)
    assert found.rounding[0] < 3e-3
    assert found.overshoot[0] == pytest.approx(4e-4, rel=0.02)
    assert found.settling_time == 0.05
