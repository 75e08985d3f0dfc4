"""Limits of the duty on a path: kept by its timing, and refused where no speed keeps them."""

import numpy as np
import pytest

from stiffopt.errors import InputError
from stiffopt.path import path_duty
from stiffopt.path.path_duty import describe_duty, motion_duty, slowing_within_duty
from stiffopt.path.timed_path import timed_motion
from stiffopt.problem.files import load_problem
from stiffopt.result.duty import Duty, DutyLimits, JointDuty, LifeRating

PROBLEM = """schema = 1
kind = "trajectory"
robot = "ur10"

[motion]
duration = {{ lower = "{lower}", upper = "{upper}" }}

[path]
start = {{ position = ["600 mm", "-300 mm", "300 mm"], rpy = ["180 deg", 0, 0] }}

[[path.segment]]
type = "lin"
to = {{ position = ["600 mm", "300 mm", "300 mm"] }}

[[minimise]]
objective = "{objective}"

{duty}
"""


@pytest.fixture
def load(tmp_path):
    def load(duty="", upper="60 s", objective="duration", lower="0.1 s"):
        file = tmp_path / "problem.toml"
        changed = {"duty": duty, "upper": upper, "objective": objective, "lower": lower}
        file.write_text(PROBLEM.format(**changed))
        return load_problem(file).problem

    return load


def test_path_is_slowed_until_its_duty_is_just_kept(load):
    free = load()
    fastest = timed_motion(free)
    duty = motion_duty(free.robot, fastest.assessment)
    energy = 0.7 * duty.energy
    found = timed_motion(load(f'[duty]\nenergy = "{energy} J"'))
    slower = motion_duty(free.robot, found.assessment)
    assert 0.98 * energy < slower.energy <= energy
    assert 1.0 < found.objective / fastest.objective < 2.0
    kept = timed_motion(load(f'[duty]\nenergy = "{1.01 * duty.energy} J"'))
    assert kept.objective == pytest.approx(fastest.objective, rel=1e-12)


def test_duty_that_no_speed_keeps_is_named_with_its_value(load):
    free = load()
    fastest = timed_motion(free)
    energy = 0.7 * motion_duty(free.robot, fastest.assessment).energy
    limits = "[duty]\nrms_torque = [300, 20, 150, 56, 56, 56]"
    with pytest.raises(InputError, match=r"rms torque of j2, .* duty\.rms_torque 20 N m however"):
        timed_motion(load(limits))
    with pytest.raises(InputError, match=r"duty\.energy .* J at motion\.duration"):
        timed_motion(load(f'[duty]\nenergy = "{energy} J"', f"{1.02 * fastest.objective} s"))


def test_fastest_law_is_kept_where_an_averaged_one_has_no_time_for_the_duty(load):
    fastest = timed_motion(load())
    # The average over the widest window takes all of it, and accelerates more than a slow motion.
    upper = fastest.objective + 0.08
    slowest = timed_motion(load(lower=f"{upper} s"))
    energy = 1.01 * motion_duty(load().robot, slowest.assessment).energy
    led = load(f'[uncertainty]\nstiffness = 0.1\n[duty]\nenergy = "{energy} J"', f"{upper} s")
    assert led.leads_on_path
    found = timed_motion(led)
    assert fastest.objective < found.objective <= upper
    assert motion_duty(led.robot, found.assessment).energy <= energy


def test_duty_belongs_to_a_path_that_is_timed(load):
    with pytest.raises(InputError, match=r"duty: its limits are kept by"):
        load('[duty]\nenergy = "20 J"', objective="torque_squared")


def test_note_gives_a_slide_newtons_and_a_reducer_at_rest_no_life(monkeypatch):
    rating = LifeRating(torque=100.0, speed=1.0, life=1e7, exponent=3.0)
    still = {"peak_torque": 0.0, "peak_speed": 0.0, "peak_power": 0.0, "mean_speed": 0.0,
             "energy": 0.0, "regenerated": 0.0, "mean_torque": 0.0, "rating": rating}  # fmt: skip
    rail = JointDuty(name="rail", prismatic=True, rms_torque=300.0, torque_max=1000.0, **still)
    turn = JointDuty(name="turn", prismatic=False, rms_torque=1.0, torque_max=100.0, **still)
    duty = Duty(duration=1.0, joints=(rail, turn))
    monkeypatch.setattr(path_duty, "motion_duty", lambda robot, motion: duty)
    told = describe_duty(None, None)
    assert told.endswith("with an rms torque of 300 N in rail, 30% of its limit.")


def test_slowing_of_inertia_alone_is_that_of_the_closed_form(monkeypatch):
    # Of a joint without weight the rms torque falls with the square of the duration.
    rms = 10.0

    class OfInertia:
        def __init__(self, factor):
            self.joints, self.energy = (), 0.0
            self.factor = factor

    monkeypatch.setattr(path_duty, "motion_duty", lambda robot, factor: OfInertia(factor))

    class Limits(DutyLimits):
        def uses(self, duty):
            share = (rms / duty.factor**2 / 4.0) ** 2
            return [type("Use", (), {"share": share, "text": "over"})()]

    found = slowing_within_duty(None, Limits(), lambda factor: factor, 60.0)
    assert found == pytest.approx(np.sqrt(rms / 4.0), rel=2e-3)
    assert found >= np.sqrt(rms / 4.0)
