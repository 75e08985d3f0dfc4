"""Cost of the models: inverse dynamics against pinocchio, graph sizes, build against solve."""

from __future__ import annotations

import time

import casadi as ca
import numpy as np
import pinocchio as pin
from common import Row, deflection_problem, loaded_ur10, main, torque_squared_problem

from stiffopt.drivetrain.compact import CompactChain
from stiffopt.dynamics.newton_euler import inverse_dynamics
from stiffopt.problem.trajectory import Method
from stiffopt.solver.solve import solve

TITLE = "Cost of the models"
# Short batches, many rounds: the fastest one had the processor to itself.
POINTS = 200
ROUNDS = 300


def run() -> list[Row]:
    """Measure all of them on the UR10 with 5 kg."""
    return [inverse_dynamics_time(), *graph_sizes(), *build_against_solve()]


def inverse_dynamics_time() -> Row:
    """Seconds a point of the mapped function against a Python loop over pin.rnea."""
    robot = loaded_ur10()
    model = robot.model
    data = model.createData()
    random = np.random.default_rng(3)
    q, v, a = (random.normal(size=(model.nv, POINTS)) for _ in range(3))
    rows = [np.ascontiguousarray(x.T) for x in (q, v, a)]
    buffer, trigger = inverse_dynamics(robot.tree).map(POINTS).buffer()
    # Kept in a list: the buffer does not own what it reads and writes.
    flat = [x.ravel(order="F") for x in (q, v, a)]
    torque = np.zeros(model.nv * POINTS)
    for index, values in enumerate(flat):
        buffer.set_arg(index, memoryview(values))
    buffer.set_res(0, memoryview(torque))
    ours, pins = [], []
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        trigger()
        ours.append(time.perf_counter() - begin)
        begin = time.perf_counter()
        for k in range(POINTS):
            pin.rnea(model, data, rows[0][k], rows[1][k], rows[2][k])
        pins.append(time.perf_counter() - begin)
    expected = pin.rnea(model, data, rows[0][-1], rows[1][-1], rows[2][-1])
    assert np.allclose(torque[-model.nv :], expected, rtol=1e-10, atol=1e-10)
    mine, theirs = (1e6 * min(x) / POINTS for x in (ours, pins))
    ratio = mine / theirs
    return Row(
        "inverse dynamics a point: mapped / pin.rnea called from Python",
        f"{mine:.2f} us / {theirs:.2f} us = {ratio:.2f}",
        "1.8",
        "below 3",
        bool(ratio < 3),
    )


def graph_sizes() -> list[Row]:
    """Operations of the symbolic models; exact counts, the same on every computer."""
    robot = loaded_ur10()
    dynamics = inverse_dynamics(robot.tree)
    jacobian = dynamics.jacobian()
    rows = [
        Row("inverse dynamics: graph nodes", f"{dynamics.n_nodes()}", "490"),
        Row("inverse dynamics with its Jacobian: graph nodes", f"{jacobian.n_nodes()}", "2943"),
    ]
    torque, smoothing = ca.SX.sym("torque"), ca.SX.sym("smoothing")
    sizes = {"compact form": [], "all elements": []}
    for j, chain in enumerate(robot.chains):
        assert chain is not None
        compact = CompactChain(chain, float(robot.torque_max[j]))
        for name, law in (("compact form", compact), ("all elements", chain)):
            windup = law.windup(torque, smoothing=smoothing)
            sizes[name].append(ca.Function("windup", [torque, smoothing], [windup]).n_nodes())
    for name, counts in sizes.items():
        ratio = max(counts) / dynamics.n_nodes()
        wanted = name == "compact form"
        rows.append(
            Row(
                f"wind-up of one joint, {name}: graph nodes / of inverse dynamics",
                f"{min(counts)} to {max(counts)}, {ratio:.2f}",
                "",
                "below 1" if wanted else "",
                bool(ratio < 1) if wanted else None,
            )
        )
    return rows


def build_against_solve() -> list[Row]:
    """NLP build against solve, by the default method."""
    robot, rows = loaded_ur10(), []
    for name, problem in (
        ("torque squared, N = 60", torque_squared_problem(robot)),
        ("dynamic deflection, N = 30", deflection_problem(robot, Method(intervals=30))),
    ):
        record = solve(problem, throw=False).solver
        ratio = record.build_s / record.solve_s
        rows.append(
            Row(
                f"{name}: build / solve",
                f"{record.build_s:.2f} s / {record.solve_s:.2f} s = {ratio:.2f}",
                "",
                "below 10",
                bool(ratio < 10),
            )
        )
    return rows


if __name__ == "__main__":
    main(TITLE, run)
