"""Laws beyond the catalogue in a planner's robot: optimiser and certificate, refusals, export."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from small_arms import load

from stiffopt import SolveStatus, solve
from stiffopt.certificate.assess import assess
from stiffopt.discovery.laws.law import Factor, Law
from stiffopt.discovery.laws.robot_change import law_change
from stiffopt.discovery.laws.sources import LawSource
from stiffopt.problem.stage_model import StageModel

PLACE, TIMES = (0, 1), np.array([0.0, 0.2])


def factor(kind, joint, form="linear", *shapes):
    return Factor(LawSource(kind, joint), form, shapes, ((-9.0, 9.0),) * len(shapes))


class Ramp:
    """Motion of constant acceleration, which is known at every instant."""

    duration = 1.0

    def __init__(self, q, v, a):
        self._terms = q, v, a

    def __call__(self, times, order=0):
        q, v, a = self._terms
        t = np.asarray(times)[:, None]
        values = (q + v * t + 0.5 * a * t**2, v + a * t, a + 0.0 * t, 0.0 * a + 0.0 * t)
        return values[order] + 0.0 * t


LAWS = {
    "speed and angle": Law(0, "drive_torque", (factor("speed", 0), factor("position", 1))),
    "friction by load": Law(
        1, "drive_torque", (factor("direction", 1), factor("load", 0, "saturating", 4.0))
    ),
    "hose": Law(0, "link_torque", (factor("position", 1, "bend", 0.2, 0.5),)),
    "ripple": Law(1, "link_torque", (factor("position", 0, "harmonic", 5.0),)),
    "offset": Law(1, "drive_torque", ()),
}


@pytest.mark.parametrize("name", LAWS)
def test_optimiser_and_certificate_have_the_same_law(name, tmp_path):
    law, plain = LAWS[name], load(tmp_path, "planar")
    amplitudes = (3.0, -1.5)[: law.amplitude_count]
    changed = law_change(plain.robot, law, amplitudes, PLACE, name)
    problem = replace(plain, robot=changed.robot)
    symbols = [ca.SX.sym(each, 2) for each in "qva"]
    model = StageModel(problem.robot, *symbols, np.zeros(3), 1e-3, np.zeros(2))
    parts = [model.drive_torque, model.windup(model.torques.spring), model.deflection.static]
    optimised = ca.Function("stage", symbols, parts)
    q, v, a = np.array([0.3, -0.4]), np.array([0.9, -1.1]), np.array([2.0, 1.0])
    motion = Ramp(q, v, a)
    certified = assess(problem, motion, times=TIMES)
    without = assess(plain, motion, times=TIMES)
    assert not np.allclose(certified.torque, without.torque, atol=0.1)
    for k, t in enumerate(TIMES):
        state = (q + v * t + 0.5 * a * t**2, v + a * t, a)
        drive, windup, static = (np.ravel(each) for each in optimised(*state))
        np.testing.assert_allclose(drive, certified.torque[k], rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(windup, certified.windup[k], rtol=1e-3)
        np.testing.assert_allclose(static, certified.deflection["static"][k], rtol=1e-3, atol=1e-9)


def test_a_torque_on_the_link_winds_up_its_joint_and_one_on_the_drive_does_not(tmp_path):
    plain = load(tmp_path, "planar")
    motion = Ramp(np.array([0.3, 0.6]), np.zeros(2), np.zeros(2))
    windups = []
    for place in ("drive_torque", "link_torque"):
        law = replace(LAWS["hose"], place=place)
        robot = law_change(plain.robot, law, (3.0,), PLACE, "hose").robot
        windups.append(assess(replace(plain, robot=robot), motion, times=TIMES).windup)
    before = assess(plain, motion, times=TIMES).windup
    np.testing.assert_allclose(windups[0], before)
    assert abs(windups[1][0, 0] - before[0, 0]) > 1e-5


def test_a_plan_leaves_torque_for_the_law(tmp_path):
    pieces = {
        "duration": "{ lower = 0.1, upper = 3.0 }",
        "minimise": 'objective = "duration"',
        "method": "intervals = 12",
    }
    plain = load(tmp_path, "swivel", **pieces)
    # At the end of the way all of the 60 N m would go into the drag at 1.7 rad/s.
    law = Law(0, "drive_torque", (factor("speed", 0), factor("position", 0, "offset", -0.2)))
    robot = law_change(plain.robot, law, (30.0,), (0,), "drag").robot
    fast, slow = solve(plain), solve(replace(plain, robot=robot))
    assert slow.status is SolveStatus.OPTIMAL
    assert slow.assessment.worst_violation.value < 5e-3
    assert slow.duration > 1.1 * fast.duration
    carried = assess(replace(plain, robot=robot), fast.trajectory)
    assert max(v.value for v in carried.violations if v.limit == "torque") > 0.05


@pytest.mark.parametrize(
    ("law", "reason"),
    [
        (Law(0, "deflection", (factor("load", 0),)), "deflection"),
        (Law(0, "drive_torque", (factor("temperature", 0),)), "temperature of joint 1"),
        (Law(0, "link_torque", (factor("speed", 0, "slip", 0.2),)), "past speed of joint 1"),
        (Law(0, "drive_torque", (factor("speed", 1, "signed_power", 0.5),)), "steep"),
        (Law(0, "drive_torque", (factor("speed", 1, "peaked+power", 0.1, 2.0, 0.5),)), "steep"),
    ],
)
def test_what_a_plan_cannot_contain_is_refused_in_a_sentence(law, reason, tmp_path):
    found = law_change(load(tmp_path, "planar").robot, law, (1.0,), PLACE, "law")
    assert found.robot is None
    assert reason in found.sentence


@pytest.mark.parametrize(
    ("kind", "value"),
    [("direction", "coulomb"), ("speed", "viscous"), ("acceleration", "rotor_inertia")],
)
def test_a_law_that_a_joint_has_a_value_for_changes_that_value(kind, value, tmp_path):
    robot = load(tmp_path, "planar").robot
    found = law_change(robot, Law(1, "drive_torque", (factor(kind, 1),)), (0.7,), PLACE, "law")
    assert found.robot.added_torques == ()
    np.testing.assert_allclose(getattr(found.robot, value) - getattr(robot, value), [0.0, 0.7])
