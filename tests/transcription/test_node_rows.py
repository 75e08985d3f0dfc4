"""Rows at single nodes: derivatives, numbers that change without a new programme, names."""

import casadi as ca
import numpy as np
import pytest
from small_arms import load

from stiffopt import native
from stiffopt.baseline.baselines import baselines
from stiffopt.problem.formulation import formulate
from stiffopt.problem.objective import Scales
from stiffopt.problem.resolve import resolve
from stiffopt.solver.initial_guess import initial_guess
from stiffopt.transcription.build import transcribe
from stiffopt.transcription.mesh import uniform_mesh
from stiffopt.transcription.node_rows import NodeRows, renumber_node_rows, with_node_rows
from stiffopt.transcription.ocp import Rows


def bowl(centre):
    """Squared distance from points at three nodes, at most 2; the last one's is free."""
    q, numbers = ca.SX.sym("q", 2), ca.SX.sym("numbers", 2)
    return NodeRows(
        rows=Rows.make("bowl", ["arm"], -np.inf, 2.0, 0.5),
        function=ca.Function("bowl", [q, numbers], [ca.sumsqr(q - numbers) + q[0] ** 3]),
        states=[0, 1],
        columns=np.array([1, 3, 3]),
        numbers=np.array([centre, [1.0, 2.0], [0.0, 0.0]]),
        kept=np.array([True, True, False]),
    )


@pytest.fixture
def programme(tmp_path, monkeypatch):
    # CasADi's own derivatives are the oracle.
    monkeypatch.setattr(native, "library", lambda: None)
    problem = load(tmp_path)
    motion = resolve(problem)
    ocp = formulate(problem, motion, Scales())
    plain = transcribe(ocp, "piecewise_linear_acceleration", uniform_mesh(6, 1, (1.0,)))
    x = plain.pack(initial_guess(problem, motion, baselines(problem, motion)))
    return plain, x


def test_node_rows_have_derivatives_and_names(programme):
    plain, x = programme
    block = bowl([0.3, -0.2])
    made = with_node_rows(plain, [block])
    nlp, before = made.nlp, len(plain.nlp.lower_g)
    p = nlp.parameters(plain.ocp.parameters)
    states = plain.states.take(x)[block.columns][:, :2]
    value = ca.Function("value", [nlp.x, nlp.p], [nlp.f, nlp.g])
    g = value(x, p)[1].full().ravel()
    expected = np.sum((states - block.numbers) ** 2, axis=1) + states[:, 0] ** 3
    assert g[before:] == pytest.approx(expected / 0.5, rel=1e-12)
    assert nlp.upper_g[before:].tolist() == [4.0, 4.0, np.inf]
    assert str(nlp.rows.entry(before + 1)) == "bowl, arm (at 50 %)"

    free = nlp.casadi
    oracle = ca.jacobian(free["g"], free["x"])
    slope = ca.Function("slope", [nlp.x, nlp.p], [oracle])(x, p)
    assert np.allclose(nlp.derivatives["jac_g"](x, p)[1].full(), slope.full(), atol=1e-8)
    weights = np.zeros(len(g))
    weights[before:] = [0.7, -1.3, 0.4]
    lagrangian = ca.dot(ca.DM(weights), free["g"])
    bent = ca.Function("bent", [nlp.x, nlp.p], [ca.hessian(lagrangian, free["x"])[0]])(x, p)
    found = nlp.derivatives["hess_lag"](x, p, 0.0, weights)
    assert np.allclose(found.full(), np.triu(bent.full()), atol=1e-8)


def test_other_numbers_keep_the_programme(programme):
    plain, x = programme
    made = with_node_rows(plain, [bowl([0.3, -0.2])])
    again = renumber_node_rows(made, plain, [bowl([1.5, 0.0])])
    assert again.nlp.x is made.nlp.x
    value = ca.Function("value", [made.nlp.x, made.nlp.p], [made.nlp.g])
    before = len(plain.nlp.lower_g)
    one, other = (
        value(x, each.nlp.parameters(plain.ocp.parameters)).full().ravel() for each in (made, again)
    )
    assert np.array_equal(one[:before], other[:before])
    assert one[before] != other[before]
    # The outputs of the transcription know nothing of the rows.
    assert made.unpack(x).duration == plain.unpack(x).duration
