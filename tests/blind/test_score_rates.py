"""Intervals of rates and calibration of probabilities."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from benchmarks.blind.wilson import Z95, Rate, calibration_error, wilson


@pytest.mark.parametrize(("hits", "total"), [(12, 12), (0, 100), (3, 150), (102, 120), (1, 2)])
def test_bounds_are_where_the_score_test_rejects(hits: int, total: int) -> None:
    share = hits / total

    def score(p: float) -> float:
        return (share - p) ** 2 * total - Z95**2 * p * (1 - p)

    low, high = wilson(hits, total)
    if hits:
        assert low == pytest.approx(brentq(score, 1e-9, share - 1e-9 if share < 1 else 1 - 1e-9))
    else:
        assert low == 0.0
    if hits < total:
        assert high == pytest.approx(brentq(score, share + 1e-9, 1 - 1e-9))
    else:
        assert high == 1.0


def test_published_interval() -> None:
    # Twelve of twelve still allows a true rate of 76 %; none of a hundred one of 3.7 %.
    assert wilson(12, 12)[0] == pytest.approx(0.7575, abs=1e-4)
    assert wilson(0, 100)[1] == pytest.approx(0.0370, abs=1e-4)


def test_rate_leaves_out_what_does_not_apply() -> None:
    rate = Rate.of([True, False, None, True])
    assert (rate.hits, rate.total) == (2, 3)
    assert str(rate).startswith("2 of 3 = 66.7%")
    assert str(Rate.of([None])) == "none counted"


def test_honest_probabilities_have_no_calibration_error() -> None:
    probability = np.repeat([0.25, 0.75], 400)
    right = np.concatenate([np.arange(400) < 100, np.arange(400) < 300])
    error, lines = calibration_error(list(probability), list(right))
    assert error == pytest.approx(0.0, abs=1e-12)
    assert [count for _, _, count in lines] == [400, 400]
    assert calibration_error([0.9, 0.9], [False, False])[0] == pytest.approx(0.9)
