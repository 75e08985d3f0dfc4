"""Linear elastic response along a motion against closed forms and a general integrator."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

from stiffopt import native
from stiffopt.elastic.response import ElasticResponse

STEP, COUNT = 0.004, 500
TIME = STEP * np.arange(COUNT)


def _one(mass, damping, spring):
    return ElasticResponse(
        *(np.full((COUNT, 1, 1), float(x)) for x in (mass, damping, spring)), STEP
    )


@pytest.mark.parametrize("spring", [200.0, 8e4, 5e7])
def test_torque_step_gives_the_response_of_one_mass(spring):
    mass, damping = 2.0, 0.04 * np.sqrt(2.0 * spring)
    torque = np.ones((COUNT, 1))
    z, velocity, acceleration = _one(mass, damping, spring)(torque)
    rate = np.sqrt(spring / mass)
    share = damping / (2.0 * mass * rate)
    damped = rate * np.sqrt(1.0 - share**2)
    fall = np.exp(-share * rate * TIME)
    expected = 1.0 - fall * (np.cos(damped * TIME) + share * rate / damped * np.sin(damped * TIME))
    np.testing.assert_allclose(z[:, 0] * spring, expected, atol=1e-9)
    np.testing.assert_allclose(
        mass * acceleration + damping * velocity + spring * z, torque, atol=1e-9
    )


@pytest.mark.parametrize("compiled", [True, False])
def test_torques_within_steps_equal_those_at_samples(monkeypatch, compiled):
    if not compiled:
        monkeypatch.setattr(native, "loaded", lambda: None)
    torque = np.random.default_rng(2).normal(size=(COUNT, 1))
    within = np.stack([torque[:-1], torque[1:]], axis=1)
    response, still = _one(2.0, 9.0, 8e4), np.zeros(1)
    expected = response.driven(torque, still, still)
    for parts in ((0.0, 1.0), (0.4, 0.6)):
        z, velocity, _ = response.driven(parts[0] * torque, still, still, parts[1] * within)
        np.testing.assert_allclose(z, expected[0], atol=1e-12 * np.max(np.abs(expected[0])))
        np.testing.assert_allclose(velocity, expected[1], atol=1e-12 * np.max(np.abs(expected[1])))


def test_free_response_without_damping_keeps_its_energy():
    z, velocity, _ = _one(3.0, 0.0, 1.2e4).free(np.array([[1e-3], [0.02]]))
    energy = 0.5 * 3.0 * velocity[:, 0, 0] ** 2 + 0.5 * 1.2e4 * z[:, 0, 0] ** 2
    np.testing.assert_allclose(energy, energy[0], rtol=1e-10)


def test_two_coupled_joints_whose_matrices_change_follow_a_general_integrator():
    random = np.random.default_rng(1)
    base = np.array([[8.0, 1.5], [1.5, 2.0]])
    damping = np.array([[14.0, 2.0], [-2.0, 5.0]])

    def matrices(t):
        return base * (1.0 + 0.2 * np.sin(2.0 * t)), damping, np.diag([4e4, 3e4]) * (1 + 0.1 * t)

    torque = random.normal(size=(2, 2)) @ np.array([np.sin(40.0 * TIME), np.cos(11.0 * TIME)])
    along = [np.array(part) for part in zip(*(matrices(t) for t in TIME), strict=True)]
    z, *_ = ElasticResponse(*along, STEP)(torque.T)

    def slope(t, state):
        inertia, rate, stiffness = matrices(t)
        pull = np.array([np.interp(t, TIME, row) for row in torque])
        pull = pull - rate @ state[2:] - stiffness @ state[:2]
        return np.append(state[2:], np.linalg.solve(inertia, pull))

    solved = solve_ivp(
        slope, (0.0, 1.0), np.zeros(4), t_eval=TIME[TIME <= 1.0], max_step=STEP / 2, rtol=1e-8,
        atol=1e-13,
    )  # fmt: skip
    assert np.max(np.abs(solved.y[:2].T - z[: solved.t.size])) < 1e-4 * np.max(np.abs(z))


def test_load_cases_side_by_side_equal_single_ones():
    response = _one(1.0, 3.0, 9e3)
    torque = np.random.default_rng(0).normal(size=(COUNT, 1, 3))
    together = response(torque)[0]
    for i in range(3):
        np.testing.assert_array_equal(together[..., i], response(torque[..., i])[0])


def test_no_torque_gives_no_response():
    assert _one(1.0, 3.0, 9e3).free(np.zeros((2, 0)))[0].shape == (COUNT, 1, 0)


def test_modes_at_the_start_are_those_of_the_first_matrices():
    frequencies, shapes = _one(2.0, 0.0, 2.0 * (2.0 * np.pi * 9.0) ** 2).modes(0)
    assert frequencies[0] == pytest.approx(9.0)
    assert abs(shapes[0, 0]) == pytest.approx(2.0**-0.5)


def test_modes_equal_the_generalised_eigenproblem_also_for_indefinite_inertia():
    random = np.random.default_rng(4)
    inertia, stiffness = (
        (root @ root.T + 0.1 * np.eye(3)) * size
        for root, size in ((random.normal(size=(3, 3)), 2.0), (random.normal(size=(3, 3)), 9e4))
    )
    squares, shapes = eigh(stiffness, inertia)
    many = [np.stack([each] * 2) for each in (inertia, np.zeros((3, 3)), stiffness)]
    frequencies, found = ElasticResponse(*many, 1e-3).modes(0)
    assert 2.0 * np.pi * frequencies == pytest.approx(np.sqrt(squares), rel=1e-9)
    assert np.abs(found) == pytest.approx(np.abs(shapes), rel=1e-7)
    # As a fit on its way may have it: one mass below nothing.
    values, axes = np.linalg.eigh(inertia)
    many[0] = np.stack([axes @ np.diag([-0.01, *values[1:]]) @ axes.T] * 2)
    frequencies, found = ElasticResponse(*many, 1e-4).modes(0)
    assert frequencies[0] == 0.0
    assert not np.any(found[:, 0])
    assert np.all(np.isfinite(found))
    assert np.all(frequencies[1:] > 0.0)


def test_response_without_acceleration_equals_a_call():
    random = np.random.default_rng(2)
    grown = 1.0 + 0.3 * np.sin(3.0 * TIME)[:, None, None]
    response = ElasticResponse(
        grown * np.array([[8.0, 1.5], [1.5, 2.0]]),
        grown * np.array([[14.0, 2.0], [-2.0, 5.0]]),
        grown * np.diag([4e4, 3e4]),
        STEP,
    )
    for torque in (random.normal(size=(COUNT, 2)), random.normal(size=(COUNT, 2)) * [0.0, 1.0]):
        z, velocity, _ = response(torque)
        (again,), (rate,) = response.moved(torque[None])
        np.testing.assert_allclose(again, z, atol=1e-12 * np.max(np.abs(z)))
        np.testing.assert_allclose(rate, velocity, atol=1e-12 * np.max(np.abs(velocity)))
