"""Fair rivals: limits kept, S-curves against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from small_arms import load

from stiffopt.baseline import rivals
from stiffopt.baseline.rivals import baseline_path, fair_rivals, s_curve_law
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.problem.resolve import resolve

LIMITS = "velocity = [3.0, 6.0]\nacceleration = [30.0, 40.0]\njerk = [600.0, 900.0]"


def test_rivals_keep_every_limit_and_are_no_slower_than_needed(tmp_path):
    problem = load(tmp_path, limits=LIMITS)
    motion, duration = resolve(problem), problem.duration[0]
    found = {rival.name: (rival, each) for rival, each in fair_rivals(problem, motion, duration)}
    assert set(found) == {"quintic", "S-curve", "toppra"}
    jerk = np.array(problem.active_limits.jerk)
    for rival, each in found.values():
        assert each.feasible(CERTIFICATE_TOLERANCE)
        times = np.linspace(0.0, each.duration, 4001)
        # Independent of the certificate: differences of the acceleration.
        rates = np.diff(rival.at(each.duration)(times, 2), axis=0) / times[1]
        assert np.all(np.abs(rates) <= (1.0 + CERTIFICATE_TOLERANCE) * jerk)
        if each.duration > 1.01 * duration:
            shorter = rival.at(each.duration * 0.99)
            sizes = (np.abs(shorter(0.99 * times, k)).max(axis=0) for k in (1, 2, 3))
            limits = problem.active_limits
            shares = [
                np.max(size / limit)
                for size, limit in zip(
                    sizes, (limits.velocity, limits.acceleration, jerk), strict=True
                )
            ]
            assert max(shares) > 0.99


def test_s_curve_takes_the_time_of_its_seven_phases(tmp_path):
    problem = load(tmp_path, limits=LIMITS)
    path = baseline_path(problem, resolve(problem))
    slope = np.abs(path(np.zeros(1), 1)[0])
    limits = problem.active_limits
    speed, acceleration, jerk = (
        float(np.min(limit / slope))
        for limit in (limits.velocity, limits.acceleration, limits.jerk)
    )
    law = s_curve_law(problem, path, 0.5)
    # Phases: t_j = a / j, t_a = v / a, cruise 1 / v; all are reached where t_a > t_j and 1 / v is
    # longer than the acceleration.
    assert speed / acceleration > acceleration / jerk
    if 1.0 / speed > speed / acceleration + acceleration / jerk:
        expected = 1.0 / speed + speed / acceleration + acceleration / jerk
        assert law.duration == pytest.approx(expected, rel=1e-9)
    else:
        assert np.max(law(np.linspace(0, law.duration, 2001), 1)) < speed
    assert law(np.array([law.duration]))[0, 0] == pytest.approx(1.0, abs=1e-9)


def test_rivals_of_the_same_inputs_are_searched_once(tmp_path, monkeypatch):
    problem = load(tmp_path)
    motion = resolve(problem)
    first = fair_rivals(problem, motion, problem.duration[0])
    assert fair_rivals(problem, motion, problem.duration[0]) is first
    searched = []
    monkeypatch.setattr(rivals, "_search_rivals", lambda *_: searched.append(1) or iter(()))
    assert fair_rivals(problem, motion, 1.1 * problem.duration[0]) == ()
    assert searched
