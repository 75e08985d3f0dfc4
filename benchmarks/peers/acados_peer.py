"""Torque squared and minimum time by acados, in an environment of its own; see peers/__main__.py.

States are position, velocity and acceleration, the control is jerk, integrated exactly; HPIPM.
Torque squared: Gauss-Newton on the torques. Minimum time: the duration is a state that stays, and
its square the cost, beside which a little jerk is weighed: without it no iteration ends. What is
generated and compiled is not counted as solving.
"""

from __future__ import annotations

import ctypes
import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import acados
import casadi as ca
import numpy as np
from acados.acados_template import AcadosModel, AcadosOcp, AcadosOcpSolver

# Of the jerk's square beside the duration's [s^6/rad^2]; 1e-8 costs 0.6 % of the UR10's time, 1e-10
# takes eight times as many iterations.
JERK = 1e-9


def ocp_of(task: dict[str, Any]) -> AcadosOcp:
    """The problem as acados takes it."""
    names: dict[str, Any] = {}
    exec(task["dynamics"], names)
    free = task["kind"] == "minimum_time"
    n, intervals = len(task["start"]), task["intervals"]
    x, u = ca.SX.sym("x", 3 * n + free), ca.SX.sym("u", n)
    q, v, a = x[:n], x[n : 2 * n], x[2 * n : 3 * n]
    duration = x[3 * n] if free else task["duration"]
    h = duration / intervals
    torque = ca.vertcat(*names["inverse_dynamics"](q, v, a, ca.sin, ca.cos))
    ratio = torque / np.array(task["torque_max"])
    model = AcadosModel()
    model.name = "arm"
    model.x, model.u = x, u
    moved = (q + h * v + h**2 / 2 * a + h**3 / 6 * u, v + h * a + h**2 / 2 * u, a + h * u)
    model.disc_dyn_expr = ca.vertcat(*moved, *([duration] if free else []))
    model.con_h_expr = model.con_h_expr_e = ratio
    ocp = AcadosOcp()
    ocp.model = model
    ocp.dims.N = intervals
    # acados halves squares and weighs nodes by the step, the last by one: the trapezoidal rule.
    step = task["duration"] / intervals
    costs = {"_0": (ratio, 1.0), "": (ratio, 2.0), "_e": (ratio, step)}
    if free:
        costs = {"_0": (u, JERK), "": (u, JERK), "_e": (duration, 1.0)}
    for at, (residual, weight) in costs.items():
        size = residual.numel()
        setattr(model, f"cost_y_expr{at}", residual)
        setattr(ocp.cost, f"cost_type{at}", "NONLINEAR_LS")
        setattr(ocp.cost, f"yref{at}", np.zeros(size))
        setattr(ocp.cost, f"W{at}", weight * np.eye(size))
        if at != "_0":
            setattr(ocp.constraints, f"lh{at}", -np.ones(n))
            setattr(ocp.constraints, f"uh{at}", np.ones(n))
    ends = 2 * n
    for at, pose in (("_0", task["start"]), ("_e", task["end"])):
        value = np.concatenate([pose, np.zeros(n)])
        setattr(ocp.constraints, f"idxbx{at}", np.arange(ends))
        setattr(ocp.constraints, f"lbx{at}", value)
        setattr(ocp.constraints, f"ubx{at}", value)
    speed, span = task["velocity_max"], [0.2 * task["duration"], 3.0 * task["duration"]]
    ocp.constraints.idxbx = np.concatenate([np.arange(n, ends), np.arange(3 * n, 3 * n + free)])
    ocp.constraints.lbx = np.concatenate([-np.array(speed), span[:free]])
    ocp.constraints.ubx = np.concatenate([np.array(speed), span[1 : 1 + free]])
    options = ocp.solver_options
    options.tf = task["duration"]
    options.integrator_type = "DISCRETE"
    options.nlp_solver_type = "SQP"
    options.qp_solver = "PARTIAL_CONDENSING_HPIPM"
    options.hessian_approx = "GAUSS_NEWTON"
    options.nlp_solver_max_iter = 500
    options.qp_solver_iter_max = 200
    options.globalization = "MERIT_BACKTRACKING"
    options.print_level = 0
    return ocp


def solved(solver: AcadosOcpSolver, task: dict[str, Any]) -> tuple[float, int, int]:
    """CPU seconds, status and iterations of a solve from the straight line."""
    n, intervals = len(task["start"]), task["intervals"]
    start, end = np.array(task["start"]), np.array(task["end"])
    solver.reset()
    duration = [task["duration"]] * (task["kind"] == "minimum_time")
    for k in range(intervals + 1):
        speed = (end - start) / task["duration"]
        at = start + (end - start) * k / intervals
        solver.set(k, "x", np.concatenate([at, speed, np.zeros(n), duration]))
        if k < intervals:
            solver.set(k, "u", np.zeros(n))
    begin = time.process_time()
    status = solver.solve()
    return time.process_time() - begin, status, int(np.ravel(solver.get_stats("sqp_iter"))[0])


def source_tree(folder: Path) -> None:
    """What acados expects of its sources, made of what its package brings."""
    package = Path(acados.__file__).parent
    templates = folder / "interfaces" / "acados_template"
    templates.mkdir(parents=True)
    (templates / "acados_template").symlink_to(package / "acados_template")
    for part in ("bin", "include", "lib"):
        (folder / part).symlink_to(package / "install" / part)
    os.environ["ACADOS_SOURCE_DIR"] = str(folder)
    os.environ["TERA_PATH"] = str(folder / "bin" / "t_renderer")
    for library in ("libblasfeo.so", "libqpOASES_e.so.3.1", "libhpipm.so", "libacados.so"):
        ctypes.CDLL(str(folder / "lib" / library), mode=ctypes.RTLD_GLOBAL)


def main() -> None:
    """Read the task, solve it three times, print the answer."""
    task = json.loads(Path(sys.argv[1]).read_text())
    begin = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        source_tree(Path(folder, "acados"))
        os.chdir(folder)
        ocp = ocp_of(task)
        ocp.code_export_directory = folder + "/generated"
        solver = AcadosOcpSolver(ocp, json_file="ocp.json", verbose=False)
        build = time.process_time() - begin
        first = solved(solver, task)
        second = solved(solver, task)
        begin = time.process_time()
        solver.solve()
        again = time.process_time() - begin
        n, intervals = len(task["start"]), task["intervals"]
        states = np.array([solver.get(k, "x") for k in range(intervals + 1)])
    end = states[-1, -1] if task["kind"] == "minimum_time" else task["duration"]
    print(
        json.dumps(
            {
                "times": np.linspace(0.0, end, intervals + 1).tolist(),
                "acceleration": states[:, 2 * n : 3 * n].tolist(),
                "first_s": first[0],
                "second_s": second[0],
                "warm_s": again,
                "build_s": build,
                "iterations": second[2],
                "status": f"{second[1]}",
            }
        )
    )


if __name__ == "__main__":
    main()
