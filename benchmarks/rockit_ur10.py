"""The UR10's minimum of squared torque through rockit, as a process of its own.

Runs in the environment of rockit_environment.sh and knows nothing of stiffopt:

    .rockit-venv/bin/python rockit_ur10.py PROBLEM.json DYNAMICS.casadi [INTERVALS]

DYNAMICS is a saved `casadi.Function` (q, v, a) -> tau. The states are position and velocity, the
control is the acceleration, constant in each interval; collocation of degree 4, as is rockit's
default. Prints one JSON object.
"""

import contextlib
import io
import json
import sys
import time
from pathlib import Path

import casadi as ca
import numpy as np
from rockit import DirectCollocation, Ocp

numbers = json.loads(Path(sys.argv[1]).read_text())
inverse_dynamics = ca.Function.load(sys.argv[2])
intervals = int(sys.argv[3]) if len(sys.argv) > 3 else 100
start, end = np.array(numbers["start"]), np.array(numbers["end"])
velocity_max, torque_max = np.array(numbers["velocity_max"]), np.array(numbers["torque_max"])
duration = numbers["duration"]

begin = time.perf_counter()
ocp = Ocp(T=duration)
q, v, a = ocp.state(6), ocp.state(6), ocp.control(6)
ocp.set_der(q, v)
ocp.set_der(v, a)
torque_ratio = inverse_dynamics(q, v, a) / torque_max
ocp.add_objective(ocp.integral(ca.sumsqr(torque_ratio)))
ocp.subject_to(-velocity_max <= (v <= velocity_max))
ocp.subject_to(-np.ones(6) <= (torque_ratio <= 1))
ocp.subject_to(ocp.at_t0(q) == start)
ocp.subject_to(ocp.at_tf(q) == end)
ocp.subject_to(ocp.at_t0(v) == 0)
ocp.subject_to(ocp.at_tf(v) == 0)
ocp.set_initial(q, start + (end - start) * ocp.t / duration)
ocp.set_initial(v, (end - start) / duration)
ocp.solver("ipopt", {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"})
ocp.method(DirectCollocation(N=intervals))
with contextlib.redirect_stdout(io.StringIO()):
    ocp._transcribe()
    build = time.perf_counter() - begin
    begin = time.perf_counter()
    solution = ocp.solve()
    solve = time.perf_counter() - begin
times, ratio = solution.sample(torque_ratio, grid="integrator", refine=20)
statistics = solution.stats
print(
    json.dumps(
        {
            "objective": float(solution.value(ocp.objective)),
            "objective_on_fine_grid": float(np.trapezoid(np.sum(ratio**2, axis=1), times)),
            "build_s": build,
            "solve_s": solve,
            "iterations": statistics["iter_count"],
            "status": statistics["return_status"],
        }
    )
)
