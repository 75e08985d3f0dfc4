"""Transcribed problems: names, bounds, and conversion between NLP vectors and motions."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.polynomial import polynomial
from textbook import CASES, block_move, bryson_denham, guess, minimum_time

from stiffopt.errors import ProblemError
from stiffopt.result.trajectory import Trajectory
from stiffopt.solver.ipopt import IpoptSolver
from stiffopt.transcription import SCHEMES, Guess, Rows, Waypoint, transcribe, uniform_mesh
from stiffopt.transcription.constraint_back_off import back_off_states

INF = np.inf


def solved(ocp, method, mesh, start):
    made = transcribe(ocp, method, mesh)
    found = IpoptSolver(made.nlp).solve(made.pack(start))
    assert found.status == "optimal", found.reason
    return made, found


def with_rows():
    """Block move with a power row and a speed row (second without bounds)."""
    case = block_move()
    x, u, p, z = ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("p", 0), ca.SX.sym("z", 0)
    stage = ca.Function("stage", [x, u, z, p], [u**2, ca.vertcat(x[1] * u, x[1])])
    rows = Rows.make("power", ["motor", "none"], [-5.0, -INF], [5.0, INF], 5.0, "W")
    return replace(case.ocp, stage=stage, path_rows=(rows,)), case.guess


@pytest.mark.parametrize("method", SCHEMES)
def test_pack_and_unpack_are_inverse(method):
    scaled = {"state_scale": np.array([10.0, 0.5]), "control_scale": np.array([4.0])}
    case = minimum_time(**scaled)
    made = transcribe(case.ocp, method, uniform_mesh(7))
    start = guess(lambda s: [s**2, 0.3 + s], [0.25], 2.5)
    motion = made.unpack(made.pack(start))
    inner = slice(1, -1)
    s = motion.times / 2.5
    assert motion.duration == pytest.approx(2.5)
    assert motion.states[inner] == pytest.approx(start.states(s)[inner])
    assert motion.controls == pytest.approx(0.25)
    assert motion.states[0] == pytest.approx([0.0, 0.0])  # moved into the boundary values
    assert motion.states[-1] == pytest.approx([1.0, 0.0])
    assert motion.breaks == pytest.approx(np.linspace(0, 2.5, 8))


@pytest.mark.parametrize("method", SCHEMES)
def test_scaling_does_not_change_the_optimum(method):
    plain = block_move()
    scaled = block_move(state_scale=np.array([100.0, 0.01]), control_scale=np.array([30.0]))
    values = [
        solved(case.ocp, method, uniform_mesh(10), case.guess)[1].objective
        for case in (plain, scaled)
    ]
    assert values[0] == pytest.approx(values[1], rel=1e-7)


def test_rows_are_named_with_unit_and_place():
    ocp, _ = with_rows()
    made = transcribe(ocp, "piecewise_linear_acceleration", [np.array([0.25, 0.75])])
    names = {(made.nlp.rows.entry(i).name, made.nlp.rows.entry(i).label)
             for i in range(made.nlp.rows.size)}  # fmt: skip
    assert ("power", "motor") in names
    assert ("power", "none") not in names  # a row without bounds is left out
    power = [made.nlp.rows.entry(i) for i in range(made.nlp.rows.size)]
    power = [entry for entry in power if entry.name == "power"]
    assert [entry.fraction for entry in power] == pytest.approx([0, 0.25, 1, 0.125, 0.625])
    assert power[0].unit == "W"
    assert str(power[1]) == "power, motor (at 25 %)"
    first = made.nlp.variables.entry(0)
    assert (first.name, first.label, first.fraction) == ("state", "x", 0.0)


def test_rows_hold_between_the_nodes():
    ocp, start = with_rows()
    made, found = solved(ocp, "piecewise_linear_acceleration", uniform_mesh(8), start)
    fine = made.guess_from(found.x)
    s = np.linspace(0, 1, 801)
    assert np.abs(fine.states(s)[:, 1] * fine.controls(s)[:, 0]).max() < 5.0 * 1.02


def test_worst_rows_are_relative_to_the_scale_and_unique():
    ocp, _ = with_rows()
    made = transcribe(ocp, "piecewise_linear_acceleration", uniform_mesh(4))
    g = np.zeros(made.nlp.rows.size)
    index = [i for i in range(made.nlp.rows.size) if made.nlp.rows.entry(i).name == "power"]
    g[index[1]], g[index[3]] = 1.5, -1.2  # scaled: bounds are at -1 and 1
    g[0] = 1e-3
    power, defect = made.nlp.worst_rows(g, n=5)
    assert (power.entry.name, power.entry.fraction) == ("power", 0.25)
    assert (power.value, power.bound) == (7.5, 5.0)
    assert power.relative == pytest.approx(0.5)
    assert "7.5 W against 5 W (50 % of its scale)" in str(power)
    assert defect.entry.name == "velocity step"
    assert made.nlp.worst_rows(g, tolerance=0.1) == [power]
    assert [v.relative for v in made.nlp.worst_rows(g * np.nan)] == []


def test_velocity_bounds_hold_at_every_instant():
    case = minimum_time()
    ocp = replace(case.ocp, state_upper=np.array([INF, 0.7]))
    made, found = solved(ocp, "piecewise_linear_acceleration", uniform_mesh(9), case.guess)
    speed = made.guess_from(found.x).states(np.linspace(0, 1, 901))[:, 1]
    assert speed.max() <= 0.7 * (1 + 1e-7)
    assert found.objective == pytest.approx(1 / 0.7 + 0.7, rel=0.03)  # trapezoidal speed


@pytest.mark.parametrize("method", SCHEMES)
def test_exported_acceleration_reproduces_the_states(method):
    case = minimum_time()
    made, found = solved(case.ocp, method, uniform_mesh(10), case.guess)
    motion = made.unpack(found.x)
    breaks, coefficients, q, v = made.acceleration_polynomials(found.x)
    assert breaks[-1] == pytest.approx(motion.duration)
    borders = motion.states[:: len(made.scheme.state_nodes) - 1]
    for k, local in enumerate(np.diff(breaks)):
        once = polynomial.polyint(coefficients[k, :, 0], k=v[0])
        twice = polynomial.polyint(once, k=q[0])
        q[0], v[0] = polynomial.polyval(local, twice), polynomial.polyval(local, once)
        assert (q[0], v[0]) == pytest.approx(tuple(borders[k + 1]), abs=1e-8)


@pytest.mark.parametrize("method", SCHEMES)
@pytest.mark.parametrize("name", ["block_move", "robot_arm"])
def test_a_solution_is_its_own_guess(method, name):
    case = CASES[name]
    made, found = solved(case.ocp, method, uniform_mesh(20), case.guess)
    assert made.pack(made.guess_from(found.x)) == pytest.approx(found.x, abs=1e-6)


def test_mesh_continuation_saves_iterations():
    case = CASES["cart_pole"]
    coarse, found = solved(case.ocp, "hermite_simpson", uniform_mesh(20), case.guess)
    cold = solved(case.ocp, "hermite_simpson", uniform_mesh(60), case.guess)[1]
    warm = solved(case.ocp, "hermite_simpson", uniform_mesh(60), coarse.guess_from(found.x))[1]
    assert warm.objective == pytest.approx(cold.objective, rel=1e-7)
    assert warm.iterations < 0.6 * cold.iterations


def test_invalid_guesses_are_refused():
    made = transcribe(block_move().ocp, "radau", uniform_mesh(5))
    flat = Guess(states=lambda s: s, controls=lambda s: s[:, None], duration=1.0)
    with pytest.raises(ProblemError, match=r"state callable returned shape \(16,\)"):
        made.pack(flat)
    broken = guess(lambda s: [s, np.nan], [0.0], 1.0)
    with pytest.raises(ProblemError, match=r"state, dx .* is not a finite number"):
        made.pack(broken)


def test_start_outside_the_limits_is_named():
    case = block_move(position_bounds=[(0.5, 2.0)])
    with pytest.raises(ProblemError, match=r"state, x .at 0 %. must be at least 0.5 and at most 0"):
        transcribe(case.ocp, "piecewise_linear_acceleration", uniform_mesh(5))


def via(position: float, **further):
    x = ca.SX.sym("x", 2)
    rows = (Rows.make("via position", [""], position, position, unit="m"),)
    return Waypoint(function=ca.Function("via", [x], [x[0]]), rows=rows)


@pytest.mark.parametrize("method", SCHEMES)
def test_out_and_back_through_a_via(method):
    """Rest at 0, through 1, rest at 0 in T = 2: by symmetry two block moves, 12 each, t1 = 1."""
    case = block_move()
    ocp = replace(
        case.ocp, duration=(2.0, 2.0), vias=(via(1.0),),
        final_lower=np.zeros(2), final_upper=np.zeros(2),
    )  # fmt: skip
    start = replace(
        guess(lambda s: [np.sin(np.pi * s), 0 * s], [0.0], 2.0),
        phase_fractions=np.array([0.4, 0.6]),
    )
    made, found = solved(ocp, method, uniform_mesh(60, 2, shares=[1, 2]), start)
    tolerance = 0.2 if method == "piecewise_linear_acceleration" else 1e-6
    motion = made.unpack(found.x)
    assert found.objective == pytest.approx(24.0, abs=tolerance)
    assert motion.phase_durations == pytest.approx([1.0, 1.0], abs=5e-3)
    assert motion.duration == pytest.approx(2.0)
    border = int(np.argmin(np.abs(motion.times - motion.phase_durations[0])))
    assert motion.states[border, 0] == pytest.approx(1.0)


def test_derivatives_by_phase_durations_are_exact_and_couple_no_other_phase():
    case = minimum_time()
    ocp = replace(case.ocp, duration=(0.1, 20.0), vias=(via(1.0), via(0.5)))
    nlp = transcribe(ocp, "piecewise_linear_acceleration", uniform_mesh(9, 3)).nlp
    random = np.random.default_rng(1)
    x, multipliers = random.uniform(0.5, 1.5, nlp.x.numel()), random.normal(size=nlp.g.numel())
    weights = ca.MX.sym("weights", nlp.g.numel())
    exact = ca.hessian(nlp.f + ca.dot(weights, nlp.g), nlp.x)[0]
    p = nlp.parameters(ocp.parameters)
    wanted = ca.Function("exact", [nlp.x, nlp.p, weights], [exact])(x, p, multipliers)
    found = nlp.derivatives["hess_lag"](x, p, 1.0, multipliers)
    assert np.triu(wanted.full()) == pytest.approx(found.full(), abs=1e-10)
    _, slope = nlp.derivatives["jac_g"](x, p)
    own = ca.Function("slope", [nlp.x, nlp.p], [ca.jacobian(nlp.g, nlp.x)])(x, p)
    assert slope.full() == pytest.approx(own.full(), abs=1e-12)
    first, *_, last = np.flatnonzero([e.name == "duration" for e in _entries(nlp.variables)])
    assert not found.sparsity().has_nz(int(first), int(last))


def test_state_bounds_are_backed_off_beside_the_nodes_between_which_they_are_exceeded():
    case = bryson_denham()
    ocp = case.ocp
    made = transcribe(ocp, "piecewise_linear_acceleration", uniform_mesh(5))
    solver, at = IpoptSolver(made.nlp), np.linspace(0.0, 1.0, 1001)

    def excess(found):
        return float((made.guess_from(found.x).states(at) - ocp.state_upper).max())

    before = solver.solve(made.pack(case.guess))
    assert excess(before) > 1e-3
    closer = back_off_states(made.nlp, made, before.x)
    assert np.array_equal(closer.lower_x, made.nlp.lower_x)
    nodes = made.states.take(closer.upper_x)
    # Ends are given.
    assert np.array_equal(nodes[[0, -1]], made.states.take(made.nlp.upper_x)[[0, -1]])
    solver.set_bounds(closer)
    after = solver.solve(before.x)
    assert after.converged
    assert excess(after) < 0.1 * excess(before)


def _entries(blocks):
    return [blocks.entry(k) for k in range(blocks.size)]


def test_minimum_time_through_a_via_and_names_of_phases():
    """Out and back with |u| <= 1 takes 1 + 2 + 1."""
    case = minimum_time()
    ocp = replace(
        case.ocp, duration=(0.1, 20.0), vias=(via(1.0),), final_lower=np.zeros(2),
        final_upper=np.zeros(2),
    )  # fmt: skip
    start = guess(lambda s: [np.sin(np.pi * s), 0 * s], [0.0], 5.0)
    # Radau's control may jump between intervals, and the switches lie on nodes.
    made, found = solved(ocp, "radau", uniform_mesh(16, 2), start)
    assert found.objective == pytest.approx(4.0, abs=1e-6)
    _, continuous = solved(ocp, "hermite_simpson", uniform_mesh(16, 2), start)
    # A continuous control that stays within its bounds everywhere needs an interval to switch.
    assert 4.0 < continuous.objective < 4.03
    entries = [made.nlp.rows.entry(i) for i in range(made.nlp.rows.size)]
    assert str(next(e for e in entries if e.name == "via position")) == "via position (at 100 %)"
    assert any("of phase 2" in str(e) for e in entries)
    least = made.nlp.lower_x[made.durations.offset]
    assert least == pytest.approx(0.02 * 20.0)


def test_jerk_limited_minimum_time():
    """From rest to rest with zero end acceleration: T = (32 distance/jerk)^(1/3)."""
    zero = np.zeros(1)
    ocp = replace(
        minimum_time().ocp,
        control_lower=np.array([-INF]), control_upper=np.array([INF]),
        control_rate_lower=np.array([-32.0]), control_rate_upper=np.array([32.0]),
        initial_control_lower=zero, initial_control_upper=zero,
        final_control_lower=zero, final_control_upper=zero,
    )  # fmt: skip
    start = guess(lambda s: [s, 0.5], [0.0], 1.5)
    for method in ("piecewise_linear_acceleration", "hermite_simpson"):
        _, found = solved(ocp, method, uniform_mesh(16), start)
        assert found.objective == pytest.approx(1.0, abs=1e-6)


def test_rate_bounds_give_continuous_radau_controls():
    """With free end acceleration T = (12 distance/jerk)^(1/3), by a linear acceleration."""
    ocp = replace(
        minimum_time().ocp,
        control_lower=np.array([-INF]), control_upper=np.array([INF]),
        control_rate_lower=np.array([-12.0]), control_rate_upper=np.array([12.0]),
    )  # fmt: skip
    start = guess(lambda s: [s, 0.5], [0.0], 1.5)
    made, found = solved(ocp, "radau", uniform_mesh(5), start)
    assert found.objective == pytest.approx(1.0, abs=1e-7)
    motion = made.unpack(found.x)
    times = made.times_of(made.scheme.control_places(made.intervals), found.x)
    assert motion.controls[:, 0] == pytest.approx(6 - 12 * times, abs=1e-3)


def test_statics_bound_a_peak():
    """Smallest peak control of the block move is 4: half at +4, half at -4."""
    case = block_move()
    x, u, p, z = ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("p", 0), ca.SX.sym("z", 1)
    ends = [ca.SX.sym("I", 0), ca.SX.sym("T"), z, ca.SX.sym("a", 2), ca.SX.sym("b", 2), p]
    ocp = replace(
        case.ocp,
        stage=ca.Function("stage", [x, u, z, p], [ca.SX(0, 1), ca.vertcat(z - u, z + u)]),
        path_rows=(Rows.make("peak", ["above", "below"], 0.0, INF),),
        objective=ca.Function("objective", ends, [z]),
        statics=("peak",), static_lower=np.zeros(1), static_upper=np.full(1, INF),
        static_scale=np.ones(1),
    )  # fmt: skip
    made, found = solved(ocp, "hermite_simpson", uniform_mesh(20), replace(
        case.guess, statics=np.array([5.0])))  # fmt: skip
    assert found.objective == pytest.approx(4.0, abs=1e-6)
    assert made.unpack(found.x).statics == pytest.approx([4.0], abs=1e-6)


def test_parameters_change_without_rebuilding():
    q, u, p, z = ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("p"), ca.SX.sym("z", 0)
    ends = [ca.SX.sym("I"), ca.SX.sym("T"), z, ca.SX.sym("a", 2), ca.SX.sym("b", 2), p]
    case = block_move()
    ocp = replace(
        case.ocp,
        stage=ca.Function("stage", [q, u, z, p], [(u / p) ** 2, ca.SX(0, 1)]),
        objective=ca.Function("objective", ends, [ends[0]]),
        parameters=np.array([1.0]),
    )
    made = transcribe(ocp, "radau", uniform_mesh(6))
    solver = IpoptSolver(made.nlp)
    for gain in (1.0, 2.0):
        found = solver.solve(made.pack(case.guess), np.array([gain]))
        assert found.objective == pytest.approx(12.0 / gain**2)
        assert made.unpack(found.x, np.array([gain])).integrals == pytest.approx([12 / gain**2])


def test_a_chain_of_five_integrators_is_exact():
    """A position of degree 7 meets every row, is exported, resampled and evaluated midway."""
    coefficients = np.array([0.3, -0.2, 0.5, 1.0, -0.7, 0.4, 0.8, -0.9])
    position = np.polynomial.Polynomial(coefficients)
    x, u, p, z = ca.SX.sym("x", 5), ca.SX.sym("u"), ca.SX.sym("p", 0), ca.SX.sym("z", 0)
    case = block_move()
    free = np.full(5, INF)
    rows = Rows.make("all", [str(k) for k in range(5)], -1e9, 1e9)
    ocp = replace(
        case.ocp,
        states=("q", "v", "a", "j", "s"),
        stage=ca.Function("stage", [x, u, z, p], [u**2, x]),
        objective=ca.Function(
            "objective", [ca.SX.sym("I"), ca.SX.sym("T"), z, x, ca.SX.sym("xf", 5), p], [x[0]]
        ),
        path_rows=(rows,),
        state_lower=-free, state_upper=free, state_scale=np.ones(5),
        initial_lower=-free, initial_upper=free,
        final_lower=-free, final_upper=free, chains=((0, 1, 2, 3, 4, 0),), duration=(1.5, 1.5),
        control_lower=np.array([-INF]), control_upper=np.array([INF]),
    )  # fmt: skip
    made = transcribe(ocp, "piecewise_linear_acceleration", [np.array([0.2, 0.5, 0.3])])

    def of(derivatives):
        return lambda s: np.stack([position.deriv(k)(1.5 * s) for k in derivatives], axis=1)

    # The fifth derivative is quadratic: between nodes the chain has its chord, so take degree 6.
    position = position.cutdeg(6)
    start = Guess(states=of(range(5)), controls=of([5]), duration=1.5)
    packed = made.pack(start)
    values = np.asarray(
        ca.Function("g", [made.nlp.x, made.nlp.p], [made.nlp.g])(packed, made.nlp.parameters())
    ).ravel()
    midway = 1.5 * np.array([0.1, 0.45, 0.85])
    nodes = 1.5 * np.array([0.0, 0.2, 0.7, 1.0])
    found = values.reshape(-1, 5)
    for k in range(5):
        wanted = position.deriv(k)(np.append(nodes, midway))
        assert np.sort(found[:, k]) == pytest.approx(np.sort(wanted), rel=1e-8, abs=1e-8)
    motion = Trajectory.from_acceleration(*made.acceleration_polynomials(packed))
    times = np.linspace(0.0, 1.5, 31)
    for k in range(6):
        assert motion(times, k)[:, 0] == pytest.approx(position.deriv(k)(times), rel=1e-9, abs=1e-9)
    again = made.guess_from(packed)
    assert again.states(times / 1.5) == pytest.approx(start.states(times / 1.5), rel=1e-9, abs=1e-9)
    with pytest.raises(ProblemError, match="piecewise_linear_acceleration"):
        transcribe(ocp, "radau", uniform_mesh(3))
