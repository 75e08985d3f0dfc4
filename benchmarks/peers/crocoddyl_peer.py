"""Least torque squared by crocoddyl, in an environment of its own; see peers/__main__.py.

Control-limited DDP, RK4; velocity limits and the goal are penalties, as it has no others.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import crocoddyl
import numpy as np
import pinocchio as pin

GOAL, LIMIT = 1e4, 1e3


def problem_of(task: dict[str, Any]) -> crocoddyl.ShootingProblem:
    """The problem as crocoddyl takes it."""
    model = pin.buildModelFromUrdf(task["urdf"])
    n, intervals = model.nv, task["intervals"]
    h = task["duration"] / intervals
    state = crocoddyl.StateMultibody(model)
    actuation = crocoddyl.ActuationModelFull(state)
    torque = np.array(task["torque_max"])
    target = np.concatenate([task["end"], np.zeros(n)])
    speed = np.array(task["velocity_max"])
    far = np.full(n, 1e3)
    bounds = crocoddyl.ActivationBounds(
        np.concatenate([-far, -speed]), np.concatenate([far, speed])
    )
    barrier = crocoddyl.ActivationModelQuadraticBarrier(bounds)
    running, terminal = (crocoddyl.CostModelSum(state, n) for _ in range(2))
    effort = crocoddyl.ActivationModelWeightedQuad(2.0 / torque**2)
    running.addCost(
        "torque",
        crocoddyl.CostModelResidual(state, effort, crocoddyl.ResidualModelControl(state, n)),
        1.0,
    )
    limit = crocoddyl.ResidualModelState(state, np.zeros(2 * n), n)
    running.addCost("limit", crocoddyl.CostModelResidual(state, barrier, limit), LIMIT)
    goal = crocoddyl.ResidualModelState(state, target, n)
    terminal.addCost("goal", crocoddyl.CostModelResidual(state, goal), GOAL)
    actions = []
    for cost, step in ((running, h), (terminal, 0.0)):
        differential = crocoddyl.DifferentialActionModelFreeFwdDynamics(state, actuation, cost)
        # Without an armature, however small, gravity is left out (crocoddyl 3.2.1 with pin 4.1).
        differential.armature = np.full(n, 1e-12)
        differential.u_lb, differential.u_ub = -torque, torque
        action = crocoddyl.IntegratedActionModelRK(
            differential,
            crocoddyl.ControlParametrizationModelPolyZero(n),
            crocoddyl.RKType.four,
            step,
        )
        action.u_lb, action.u_ub = -torque, torque
        actions.append(action)
    begin = np.concatenate([task["start"], np.zeros(n)])
    return crocoddyl.ShootingProblem(begin, [actions[0]] * intervals, actions[1])


def main() -> None:
    """Read the task, solve it twice and once more from its end, print the answer."""
    task = json.loads(Path(sys.argv[1]).read_text())
    begin = time.process_time()
    problem = problem_of(task)
    build = time.process_time() - begin
    model = pin.buildModelFromUrdf(task["urdf"])
    data, n, count = model.createData(), model.nv, task["intervals"]
    start, end = np.array(task["start"]), np.array(task["end"])
    speed = (end - start) / task["duration"]
    states, torques, times = [], [], []
    for k in range(count + 1):
        q = start + (end - start) * k / count
        states.append(np.concatenate([q, np.zeros(n) if k == 0 else speed]))
        if k < count:
            torques.append(np.array(pin.rnea(model, data, q, speed, np.zeros(n))))
    for _ in range(2):
        solver = crocoddyl.SolverBoxFDDP(problem)
        begin = time.process_time()
        done = solver.solve(states, torques, 1000, False)
        times.append(time.process_time() - begin)
    iterations = solver.iter
    found, moved = list(solver.us), list(solver.xs)
    begin = time.process_time()
    crocoddyl.SolverBoxFDDP(problem).solve(moved, found, 100, False)
    print(
        json.dumps(
            {
                "times": np.linspace(0.0, task["duration"], count + 1).tolist(),
                "torque_held": [u.tolist() for u in found],
                "first_s": times[0],
                "second_s": times[1],
                "warm_s": time.process_time() - begin,
                "build_s": build,
                "iterations": int(iterations),
                "status": "converged" if done else "not converged",
            }
        )
    )


if __name__ == "__main__":
    main()
