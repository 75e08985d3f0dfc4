"""The UR10's problems by rockit, in an environment of its own; see peers/__main__.py.

The states are position and velocity, the control is the acceleration, constant in each interval;
collocation of degree 4, as is rockit's default.
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
import time
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from rockit import DirectCollocation, FreeTime, Ocp


def ocp_of(task: dict[str, Any]) -> tuple[Ocp, Any]:
    """The problem as rockit takes it, and its acceleration."""
    names: dict[str, Any] = {}
    exec(task["dynamics"], names)
    n = len(task["start"])
    start, end = np.array(task["start"]), np.array(task["end"])
    velocity_max, torque_max = np.array(task["velocity_max"]), np.array(task["torque_max"])
    free = task["kind"] == "minimum_time"
    ocp = Ocp(T=FreeTime(task["duration"]) if free else task["duration"])
    q, v, a = ocp.state(n), ocp.state(n), ocp.control(n)
    ocp.set_der(q, v)
    ocp.set_der(v, a)
    symbols = [ca.SX.sym(name, n) for name in ("q", "v", "a")]
    torque = ca.vertcat(*names["inverse_dynamics"](*symbols, ca.sin, ca.cos))
    ratio = ca.Function("inverse_dynamics", symbols, [torque])(q, v, a) / torque_max
    ocp.add_objective(ocp.T if free else ocp.integral(ca.sumsqr(ratio)))
    ocp.subject_to(-velocity_max <= (v <= velocity_max))
    ocp.subject_to(-np.ones(n) <= (ratio <= 1))
    ocp.subject_to(ocp.at_t0(q) == start)
    ocp.subject_to(ocp.at_tf(q) == end)
    ocp.subject_to(ocp.at_t0(v) == 0)
    ocp.subject_to(ocp.at_tf(v) == 0)
    ocp.set_initial(q, start + (end - start) * ocp.t / task["duration"])
    ocp.set_initial(v, (end - start) / task["duration"])
    ocp.solver("ipopt", {"print_time": False, "ipopt.print_level": 0, "ipopt.sb": "yes"})
    ocp.method(DirectCollocation(N=task["intervals"]))
    return ocp, a


def main() -> None:
    """Read the task, solve it twice, print the answer."""
    task = json.loads(Path(sys.argv[1]).read_text())
    times = []
    with contextlib.redirect_stdout(io.StringIO()):
        begin = time.process_time()
        ocp, a = ocp_of(task)
        ocp._transcribe()
        build = time.process_time() - begin
        for _ in range(2):
            begin = time.process_time()
            solution = ocp.solve()
            times.append(time.process_time() - begin)
    at, acceleration = solution.sample(a, grid="control")
    statistics = solution.stats
    print(
        json.dumps(
            {
                "times": at.tolist(),
                "acceleration_held": acceleration[:-1].tolist(),
                "first_s": times[0],
                "second_s": times[1],
                "build_s": build,
                "iterations": statistics["iter_count"],
                "status": statistics["return_status"],
            }
        )
    )


if __name__ == "__main__":
    main()
