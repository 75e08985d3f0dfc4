"""Probability that a bolt is too loose: the closed form against drawn tightenings and by hand."""

import numpy as np
import pytest
from preload_studies import TESTED, er3a
from scipy import integrate, stats

from stiffopt.drivetrain import catalogue
from stiffopt.fastening.flange_load import FlangeLoads
from stiffopt.fastening.tightening import Tightening, preload_at_torque
from stiffopt.fastening.verification import Verification
from stiffopt.preload.bolt_sheet import SlipProbability, slip_probability

FLANGE = er3a().chains[1].elements["flexspline_flange"]


def steps_for(torque, tightening=TESTED, tilting=0.0):
    values = np.array([[0.0, 0.0, 0.0, tilting, 0.0, torque]])
    loads = FlangeLoads(names=("load",), values=values)
    return Verification(FLANGE, tightening, loads)


@pytest.mark.parametrize("share", [0.55, 0.7, 0.8, 0.9, 1.1])
@pytest.mark.parametrize("scatter", [1.2, 1.6, 2.0])
def test_random_draws_confirm_closed_form(share, scatter):
    tightening = Tightening(scatter=scatter, embedding=3e-6)
    steps = steps_for(60.0, tightening)
    # From a design that slips nearly always to one that hardly ever does.
    found = slip_probability(steps, share * steps.least_preload)
    assert found.draws == 1000
    assert found.agrees, (found.stated, found.drawn)


def test_closed_form_by_integrating_over_friction():
    steps = steps_for(60.0)
    preload = 0.8 * steps.least_preload
    bolt = catalogue.bolt("M5")
    pitch, thread, head = 0.8e-3 / (2 * np.pi), 4.48e-3 / (2 * np.cos(np.pi / 6)), 6.765e-3 / 2
    setting = preload * (pitch + 0.12 * (thread + head))
    high = ((1.6 * setting / preload) - pitch) / (thread + head)
    assert preload_at_torque(bolt, setting, high, high) == pytest.approx(preload / 1.6)
    mean, deviation = (0.12 + high) / 2, (high - 0.12) / 4
    needed = 60.0 / (0.15 * 9 * 2 / 3 * (20e-3**3 - 10e-3**3) / (20e-3**2 - 10e-3**2)) + steps.loss

    def too_loose(mu_thread, mu_head):
        turned = needed * (pitch + thread * mu_thread + head * mu_head)
        friction = stats.norm.pdf([mu_thread, mu_head], mean, deviation).prod()
        return friction * stats.norm.cdf(turned, setting, 0.025 * setting)

    ends = (mean - 6 * deviation, mean + 6 * deviation)
    expected, _ = integrate.dblquad(too_loose, *ends, *ends, epsabs=1e-7)
    assert slip_probability(steps, preload).stated == pytest.approx(expected, rel=1e-5)


def test_design_rules_leave_little_to_chance():
    # At alpha_A and slip safety of the study a bolt is too loose once in very many times.
    for tilting in (0.0, 20.0):
        steps = steps_for(60.0, tilting=tilting)
        found = slip_probability(steps, steps.least_preload)
        assert found.stated < 1e-3
        assert found.drawn <= 2e-3
        assert found.least < steps.least_preload / 1.6 < found.largest
    assert slip_probability(steps, 0.5 * steps.least_preload).stated > 0.5


def test_disagreeing_draws_are_reported():
    numbers = {"draws": 1000, "needed": 1e3, "least": 0.0, "largest": 2e3}
    # Four standard deviations of 1000 draws at a half are 6.3 %.
    assert SlipProbability(stated=0.5, drawn=0.55, **numbers).agrees
    assert not SlipProbability(stated=0.5, drawn=0.58, **numbers).agrees
    assert not SlipProbability(stated=1e-6, drawn=0.01, **numbers).agrees
