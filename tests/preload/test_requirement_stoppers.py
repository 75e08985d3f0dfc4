"""Why no combination of a catalogue meets a study: the row that is exceeded most of each owner."""

from types import SimpleNamespace

import numpy as np
import pytest

from stiffopt.preload.catalogue_table import requirement_stoppers

NAMES = (
    "joint stiffness, joint 2, hold",
    "joint stiffness, joint 2, peak",
    "joint stiffness, joint 3, peak",
    "tool deflection, press",
)


def programme(least, cap):
    least, cap = np.array(least), np.array(cap)
    return SimpleNamespace(
        names=NAMES,
        joints=(2, 2, 3, None),
        cap=cap,
        ends=cap,
        base=0.5 * least[:3],
        rest=0.25 * least[3] * np.array([[1.0, 0.0, 0.0]]),
        least_amounts=lambda: least,
    )


def test_most_exceeded_row_represents_its_requirement():
    # Joint 2 misses both cases: 10 % at hold, 50 % at peak though that is the smaller amount.
    stops = requirement_stoppers(programme([2.2, 1.5, 0.9, 0.9], [2.0, 1.0, 1.0, 1.0]), ())
    (stop,) = stops
    assert stop.limit == NAMES[1]
    assert stop.best == pytest.approx(1 / 1.5)
    assert stop.required == pytest.approx(1.0)
    assert "gain at most 50.0 %" in stop.remedy
    assert "the stiffest" in stop.against


def test_jointly_infeasible_rows_are_named():
    stops = requirement_stoppers(programme([0.5, 0.6, 0.9, 0.8], [1.0] * 4), (NAMES[3], NAMES[0]))
    assert [stop.limit for stop in stops] == [NAMES[3], NAMES[0]]
    assert (stops[0].best, stops[0].required, stops[0].unit) == (0.8, 1.0, "m")
    assert "gain at most 75.0 %" in stops[0].remedy
    assert all("not with the other requirements" in stop.against for stop in stops)
