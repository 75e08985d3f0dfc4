"""Ends of IPOPT solves: limits, Ctrl-C, errors, best iterate."""

import os
import signal
import threading
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

import stiffopt.symbolic  # noqa: F401 - CasADi conventions
from stiffopt.solver import ipopt
from stiffopt.solver.ipopt import IpoptOptions, IpoptSolver
from stiffopt.solver.programme import predict_rise
from stiffopt.transcription import Guess, OptimalControlProblem, Rows, transcribe, uniform_mesh
from stiffopt.transcription.constraint_back_off import back_off_uniformly

INF = np.inf


def pendulum(stage_row=None, torque: float = 20.0, duration: float = 1.5):
    """Swing-up with minimum torque squared; gravity is a parameter.

    The torque is a control beside the acceleration, whose integrals have no effect.
    """
    x, u, p, z = ca.SX.sym("x", 4), ca.SX.sym("u", 2), ca.SX.sym("p"), ca.SX.sym("z", 0)
    balance = u[0] - u[1] + p * np.sin(x[0])
    row = ca.SX(0, 1) if stage_row is None else stage_row(x, u[1])
    rows = (Rows.make("dynamics", ["pendulum"], 0.0, 0.0),)
    ends = [ca.SX.sym("I"), ca.SX.sym("T"), z, ca.SX.sym("a", 4), ca.SX.sym("b", 4), p]
    ocp = OptimalControlProblem(
        name="pendulum", states=("angle", "rate", "second integral", "integral"),
        controls=("acceleration", "torque"), chains=((0, 1, 0), (2, 3, 1)),
        stage=ca.Function("stage", [x, u, z, p], [u[1] ** 2, ca.vertcat(balance, row)]),
        path_rows=rows if stage_row is None else (*rows, Rows.make("row", ["test"], -INF, 1.0)),
        objective=ca.Function("objective", ends, [ends[0]]),
        duration=(duration, duration), parameters=np.array([9.81]),
        state_lower=np.full(4, -INF), state_upper=np.full(4, INF),
        control_lower=np.array([-INF, -torque]), control_upper=np.array([INF, torque]),
        state_scale=np.ones(4), control_scale=np.ones(2),
        initial_lower=np.zeros(4), initial_upper=np.zeros(4),
        final_lower=np.array([np.pi, 0, -INF, -INF]), final_upper=np.array([np.pi, 0, INF, INF]),
    )  # fmt: skip
    start = Guess(
        states=lambda s: np.stack([np.pi * s, *(np.full_like(s, v) for v in (2.0, 0, 0))], axis=1),
        controls=lambda s: np.zeros((len(s), 2)),
        duration=duration,
    )
    made = transcribe(ocp, "hermite_simpson", uniform_mesh(25))
    return made, made.pack(start)


def solver(made, **options):
    return IpoptSolver(made.nlp, IpoptOptions(**options))


GRAVITY = np.array([9.81])


def test_an_optimal_end_reports_progress_and_stays_silent(capfd):
    made, x0 = pendulum()
    seen = []
    found = solver(made).solve(x0, GRAVITY, report=seen.append)
    assert found.status == "optimal"
    assert found.converged
    assert found.violation < 1e-8
    assert [event.iteration for event in seen] == list(range(found.iterations + 1))
    assert seen[0].row.startswith("dynamics, ")
    assert seen[0].violation > 0.01
    assert seen[-1].objective == pytest.approx(found.objective)
    assert 0.0 <= seen[0].elapsed <= seen[-1].elapsed <= found.solve_s
    assert found.history == seen
    assert capfd.readouterr() == ("", "")


def test_ctrl_c_keeps_the_best_iterate():
    made, x0 = pendulum()
    before = signal.getsignal(signal.SIGINT)

    def press(event):
        if event.iteration == 4:
            os.kill(os.getpid(), signal.SIGINT)

    found = solver(made).solve(x0, GRAVITY, report=press)
    assert found.status == "interrupted"
    assert not found.converged
    assert found.iterations == 4
    assert found.violation == min(event.violation for event in found.history)
    assert found.history[found.iteration].objective == pytest.approx(found.objective)
    assert signal.getsignal(signal.SIGINT) is before
    again = solver(made).solve(x0, GRAVITY)
    assert again.status == "optimal"  # nothing lingers


def test_among_feasible_iterates_the_lowest_objective_is_kept():
    made, x0 = pendulum()
    ready = solver(made)
    optimum = ready.solve(x0, GRAVITY)
    found = ready.solve(
        x0, GRAVITY, report=lambda event: event.violation < 1e-9 and os.kill(os.getpid(), 2)
    )
    feasible = [e.objective for e in found.history if e.violation < 1e-6]
    assert found.status == "interrupted"
    assert found.objective == pytest.approx(min(feasible))
    assert found.objective >= optimum.objective - 1e-6


def test_solving_outside_the_main_thread():
    made, x0 = pendulum()
    results = []
    thread = threading.Thread(target=lambda: results.append(solver(made).solve(x0, GRAVITY)))
    thread.start()
    thread.join()
    assert results[0].status == "optimal"


def test_limits_on_time_and_iterations():
    made, x0 = pendulum()
    found = solver(made, max_iterations=3).solve(x0, GRAVITY)
    assert (found.status, found.iterations) == ("iteration_limit", 3)
    assert found.worst_rows[0].relative == found.violation > 0.0
    late = solver(made).solve(x0, GRAVITY, max_seconds=0.0)
    assert late.status == "time_limit"


def test_an_error_in_the_report_comes_through():
    made, x0 = pendulum()

    def fail(event):
        raise KeyError("display")

    with pytest.raises(KeyError, match="display"):
        solver(made).solve(x0, GRAVITY, report=fail)


def test_an_infeasible_end_names_what_conflicts():
    made, x0 = pendulum(torque=1.0, duration=0.5)
    found = solver(made).solve(x0, GRAVITY)
    assert found.status == "infeasible"
    assert found.violation > 1e-3
    assert found.worst_rows[0].entry.name == "position step"
    named = {(entry.name, entry.label) for entry in found.conflicts}
    assert ("state", "angle") in named  # boundary values
    assert ("control", "torque") in named
    assert all(entry.name != "position step" for entry in found.conflicts)


def test_a_row_without_value_is_named(capfd):
    made, x0 = pendulum(lambda x, u: np.sqrt(u - 0.5))
    found = solver(made).solve(x0, GRAVITY)
    assert found.status == "invalid_number"
    assert "no finite value of row: row, test (at 0 %)" in found.reason
    assert capfd.readouterr() == ("", "")


def test_a_row_without_slope_is_named():
    # At the guess u = 0, where the root has a value but no slope.
    made, x0 = pendulum(lambda x, u: np.sqrt(u * u) * np.sqrt(np.sqrt(u * u)))
    found = solver(made).solve(x0, GRAVITY)
    assert found.status == "invalid_number"
    assert "no finite slope of row: row, test (at 0 %)" in found.reason


def test_a_warm_start_saves_iterations():
    made, x0 = pendulum()
    ready = solver(made)
    first = ready.solve(x0, GRAVITY)
    cold = ready.solve(first.x, GRAVITY * 1.01)
    warm = ready.solve(first.x, GRAVITY * 1.01, warm=first)
    assert warm.status == "optimal"
    assert warm.objective == pytest.approx(cold.objective, rel=1e-7)
    assert warm.iterations < cold.iterations


def test_iterates_that_full_newton_steps_do_not_move_are_optimal_however_ipopt_ends():
    """The gradient's rounding is above the tolerance that IPOPT is asked for."""
    made, x0 = pendulum()
    exact = dict.fromkeys(("tol", "dual_inf_tol", "acceptable_tol", "compl_inf_tol"), 1e-30)
    best = solver(made).solve(x0, GRAVITY)
    for most in (40, 200):
        found = solver(made, max_iterations=most, extra=exact).solve(x0, GRAVITY)
        assert found.reason != "Solve_Succeeded"
        assert found.status == "optimal"
        assert found.objective == pytest.approx(best.objective, rel=1e-9)
    assert solver(made, max_iterations=3, extra=exact).solve(x0, GRAVITY).status != "optimal"


def test_a_feasible_iterate_is_never_called_infeasible(monkeypatch):
    monkeypatch.setitem(ipopt._STATUS_BY_RETURN_STATUS, "Maximum_Iterations_Exceeded", "infeasible")
    made, x0 = pendulum()
    best = solver(made).solve(x0, GRAVITY)
    near = solver(made, max_iterations=1).solve(best.x, GRAVITY)
    assert near.violation <= 1e-6
    assert near.status == "stalled"
    far = solver(made, max_iterations=1).solve(x0, GRAVITY)
    assert far.violation > 1e-6
    assert far.status == "infeasible"


def test_one_solve_may_have_fewer_iterations_than_the_options_allow():
    made, x0 = pendulum()
    one = solver(made)
    assert one.solve(x0, GRAVITY, max_iterations=3).status == "iteration_limit"
    assert one.solve(x0, GRAVITY).status == "optimal"


def test_rise_of_the_objective_by_a_back_off_follows_from_the_multipliers():
    made, x0 = pendulum(stage_row=lambda x, u: u / 9.0)
    one = solver(made)
    before = one.solve(x0, GRAVITY)
    closer = back_off_uniformly(made.nlp, {"row": 1e-3})
    one.set_bounds(closer)
    after = one.solve(before.x, GRAVITY)
    assert before.converged
    assert after.converged
    rise = predict_rise(SimpleNamespace(raw=before, nlp=made.nlp), closer)
    assert rise == pytest.approx(after.objective - before.objective, rel=0.05)
