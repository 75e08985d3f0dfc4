"""Splines of integrator chains: values, derivatives and fit."""

import casadi as ca
import numpy as np
import pytest
from numpy.polynomial import Polynomial
from small_arms import ROOT

from stiffopt.problem.files import load_problem
from stiffopt.problem.formulation import formulate
from stiffopt.problem.objective import Scales
from stiffopt.problem.resolve import resolve
from stiffopt.transcription.build import transcribe
from stiffopt.transcription.chain_splines import ChainSplines
from stiffopt.transcription.mesh import uniform_mesh
from stiffopt.transcription.nlp import Places

# Two joints, states up to snap joint by joint, two phases of unequal intervals.
CHAINS = tuple((*(2 * k + j for k in range(5)), j) for j in range(2))
MESH = [np.array([0.5, 0.3, 0.2]), np.array([0.4, 0.6])]
DURATIONS = np.array([0.8, 0.3])
EACH_DURATION = ca.MX(ca.DM(np.repeat(DURATIONS, [3, 2])))  # of each interval's phase
PLACES = Places(np.array([0, 0, 0, 0, 1, 1]), np.array([0.0, 0.5, 0.8, 1.0, 0.4, 1.0]))
FREE = 'motion.duration={ lower = "0.5 s", upper = "2 s" }'
POLYNOMIALS = (Polynomial([1, -2, 0.5, 3, 1, -4, 2]), Polynomial([0, 1, 1, -1, 2, 0, 5]))


@pytest.fixture
def splines():
    return ChainSplines(MESH, CHAINS)


def polynomial_values():
    """States and controls of one polynomial of degree 6 a joint, over both phases."""
    begins = np.array([0.0, DURATIONS[0]])
    t = begins[PLACES.phase] + PLACES.fraction * DURATIONS[PLACES.phase]
    orders = [[p.deriv(k)(t) if k else p(t) for p in POLYNOMIALS] for k in range(6)]
    return np.stack([each for order in orders for each in order], axis=1)


def test_splines_reproduce_a_polynomial_in_all_derivatives(splines):
    values = polynomial_values()
    found = splines.fit(PLACES, values, np.ones(12), DURATIONS)
    assert splines.evaluate(PLACES, found, DURATIONS) == pytest.approx(values, rel=1e-8, abs=1e-7)
    symbolic = splines.at(PLACES, ca.MX(ca.DM(found)), EACH_DURATION)
    shown = np.array(ca.evalf(symbolic)).T
    assert shown == pytest.approx(values, rel=1e-8, abs=1e-7)
    jerk = splines.at(PLACES, ca.MX(ca.DM(found)), EACH_DURATION, (3,))
    found_jerk = np.array(ca.evalf(jerk)).T
    assert found_jerk == pytest.approx(values[:, 6:8], rel=1e-8, abs=1e-7)


def test_nonzero_basis_functions_give_the_values(splines):
    c = np.random.default_rng(1).normal(size=splines.size)
    rows, basis = splines.nonzero_basis(PLACES)
    own = c.reshape(-1, len(CHAINS))[rows]
    moved = np.einsum("pki,pij->pkj", basis, own)
    moved /= DURATIONS[PLACES.phase][:, None, None] ** np.arange(splines.orders)[:, None]
    found = np.zeros((len(PLACES), splines.values))
    for j, chain in enumerate(splines.places):
        found[:, chain] = moved[:, :, j]
    assert found == pytest.approx(splines.evaluate(PLACES, c, DURATIONS), rel=1e-10, abs=1e-9)


def test_coefficients_that_are_alike_are_at_rest():
    alone = ChainSplines(MESH[:1], CHAINS)
    places = Places(np.zeros(2, dtype=int), np.array([0.0, 1.0]))
    ends = alone.at(places, ca.MX.ones(alone.size), ca.MX(ca.DM([2.0, 2.0, 2.0])))
    # All coefficients alike: at rest there.
    assert np.array(ca.evalf(ends))[:2] == pytest.approx(1.0)
    assert np.array(ca.evalf(ends))[2:] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("method", ["piecewise_linear_acceleration", "hermite_simpson"])
def test_motion_basis_spans_the_feasible_motions(method):
    changes = [f'method.transcription="{method}"', "method.intervals=7"]
    problem = load_problem(ROOT / "problems" / "two_link.toml", changes).problem
    ocp = formulate(problem, resolve(problem), Scales())
    made = transcribe(ocp, method, [np.linspace(1.0, 2.0, 7) / 10.5])
    basis = made.motion_basis()
    own = np.concatenate([np.full(b.size, b.structural) for b in made.nlp.rows.items])
    point = np.zeros(made.nlp.x.numel())
    _, slopes = made.nlp.derivatives["jac_g"](point, made.nlp.parameters(ocp.parameters))
    equations = slopes.full()[own]
    assert np.abs(equations @ basis).max() < 1e-10 * np.abs(equations).max() * abs(basis).max()
    assert basis.shape == (len(point), len(point) - np.linalg.matrix_rank(equations))
    assert np.linalg.matrix_rank(basis.toarray()) == basis.shape[1]


@pytest.mark.parametrize("change", ['method.transcription="radau"', FREE])
def test_motion_basis_is_none_for_nonlinear_equations_or_control_jumps(change):
    problem = load_problem(ROOT / "problems" / "two_link.toml", [change]).problem
    ocp = formulate(problem, resolve(problem), Scales())
    assert transcribe(ocp, problem.method.transcription, uniform_mesh(5)).motion_basis() is None
