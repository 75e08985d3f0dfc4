"""Agreement of the optimiser's prediction with the exact model."""

from dataclasses import replace

import numpy as np
import pytest
from small_arms import (
    joint,
    load,
    on_one_element,
    reducer,
    small_flange,
    write_problem,
    write_robot,
)

from stiffopt.certificate.agreement import find_disagreements
from stiffopt.problem.files import load_problem
from stiffopt.problem.prediction import predict_motion
from stiffopt.problem.stage_terms import Smoothing
from stiffopt.result.trajectory import Trajectory


def swing(problem, duration=0.5):
    """Rest-to-rest motion in 20 pieces of linear acceleration, some of them backwards."""
    way = problem.end.joints - problem.start.joints
    t = np.linspace(0.0, duration, 21)
    s = t / duration
    profile = 6.0 * (1.0 - 2.0 * s) + 20.0 * np.sin(4.0 * np.pi * s)
    acceleration = profile[:, None] * way / duration**2
    return Trajectory.piecewise_linear_acceleration(
        t, acceleration, problem.start.joints, np.zeros(len(way))
    )


@pytest.fixture
def rubbing(tmp_path):
    """The planar arm with dry friction."""
    path = write_problem(tmp_path, "planar")
    friction = {"coulomb": 3.0, "viscous": 0.5}
    joints = [joint(name, reducer(), **friction) for name in ("shoulder", "elbow")]
    write_robot(tmp_path, "planar", joints)
    return load_problem(path).problem


def test_smoothing_is_within_tolerance(rubbing):
    motion = swing(rubbing)
    assert np.min(motion(np.linspace(0.0, 0.5, 200), 1) * (rubbing.end.joints > 0)) < 0.0
    found = find_disagreements(
        rubbing, motion, predict_motion(rubbing, motion, Smoothing(0.25), elastic=True)
    )
    assert {d.quantity for d in found if d.joint} == {"spring torque", "drive torque", "wind-up"}
    assert found[0].excess < 1.0


@pytest.mark.parametrize(
    ("name", "quantity"),
    [("coulomb", "drive torque"), ("viscous", "drive torque"), ("rotor_inertia", "drive torque")],
)
def test_wrong_numbers_are_detected(rubbing, name, quantity):
    motion = swing(rubbing)
    other = replace(rubbing.robot, **{name: getattr(rubbing.robot, name) + 0.01})
    believed = predict_motion(replace(rubbing, robot=other), motion, Smoothing(0.25), elastic=True)
    found = [d.quantity for d in find_disagreements(rubbing, motion, believed) if d.excess > 1.0]
    assert set(found) == {quantity}


def test_slipping_connection_is_a_disagreement(tmp_path):
    """The smooth law goes on beyond slip, the true one has no end there."""
    problem = on_one_element(load(tmp_path, "pendulum"), small_flange(200.0))
    motion = swing(problem)
    found = find_disagreements(
        problem, motion, predict_motion(problem, motion, Smoothing(0.25), elastic=True)
    )
    wrong = {d.quantity for d in found if d.excess > 1.0}
    assert "wind-up" in wrong
    assert "total deflection" in wrong
    assert np.isinf(found[0].value)
