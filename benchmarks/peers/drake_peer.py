"""Torque squared and minimum time by drake, in an environment of its own; see peers/__main__.py.

Direct collocation as drake has it: Hermite-Simpson, torques linear between knots. IPOPT gets no
second derivatives from drake and approximates them.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import MultibodyForces
from pydrake.planning import DirectCollocation
from pydrake.solvers import IpoptSolver, SolverOptions
from pydrake.trajectories import PiecewisePolynomial

ITERATIONS = 1000


def plant_of(task: dict[str, Any]) -> MultibodyPlant:
    """The arm with a motor at every joint."""
    plant = MultibodyPlant(time_step=0.0)
    Parser(plant).AddModels(task["urdf"])
    if task["root"] != "world":
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(task["root"]))
    # Transmissions of the URDF are motors already.
    if not plant.num_actuators():
        for name in task["joints"]:
            plant.AddJointActuator(f"motor_{name}", plant.GetJointByName(name))
    plant.Finalize()
    return plant


def programme_of(task: dict[str, Any], plant: MultibodyPlant) -> DirectCollocation:
    """The problem as drake takes it."""
    free = task["kind"] == "minimum_time"
    count, n = task["intervals"], len(task["start"])
    step = task["duration"] / count
    widths = (0.2 * step, 3.0 * step) if free else (step, step)
    made = DirectCollocation(
        plant,
        plant.CreateDefaultContext(),
        num_time_samples=count + 1,
        minimum_time_step=widths[0],
        maximum_time_step=widths[1],
        input_port_index=plant.get_actuation_input_port().get_index(),
    )
    made.AddEqualTimeIntervalsConstraints()
    torque, speed = np.array(task["torque_max"]), np.array(task["velocity_max"])
    u, programme = made.input(), made.prog()
    for k in range(count + 1):
        programme.AddBoundingBoxConstraint(-torque, torque, made.input(k))
        programme.AddBoundingBoxConstraint(-speed, speed, made.state(k)[n:])
    rest = np.zeros(n)
    ends = ((made.initial_state(), task["start"]), (made.final_state(), task["end"]))
    for state, pose in ends:
        value = np.concatenate([pose, rest])
        programme.AddBoundingBoxConstraint(value, value, state)
    if free:
        made.AddFinalCost(made.time())
    else:
        made.AddRunningCost(sum((u[j] / torque[j]) ** 2 for j in range(n)))
    start, end = np.array(task["start"]), np.array(task["end"])
    moments = np.linspace(0.0, task["duration"], count + 1)
    way = (end - start) / task["duration"]
    states = [np.concatenate([start + t * way, way]) for t in moments]
    torques = [held(plant, state) for state in states]
    made.SetInitialTrajectory(
        PiecewisePolynomial.FirstOrderHold(moments, np.transpose(torques)),
        PiecewisePolynomial.FirstOrderHold(moments, np.transpose(states)),
    )
    return made


def held(plant: MultibodyPlant, state: np.ndarray) -> np.ndarray:
    """Torques of constant speed."""
    context = plant.CreateDefaultContext()
    plant.SetPositionsAndVelocities(context, state)
    forces = MultibodyForces(plant)
    plant.CalcForceElementsContribution(context, forces)
    return plant.CalcInverseDynamics(context, np.zeros(plant.num_velocities()), forces)


def main() -> None:
    """Read the task, solve it, once more where that took less than a minute, print the answer."""
    task = json.loads(Path(sys.argv[1]).read_text())
    begin = time.process_time()
    plant = plant_of(task)
    made = programme_of(task, plant)
    programme = made.prog()
    build = time.process_time() - begin
    options = SolverOptions()
    options.SetOption(IpoptSolver.id(), "max_iter", ITERATIONS)
    times = []
    guess = programme.initial_guess().copy()
    while len(times) < 2 and sum(times) < 60.0:
        begin = time.process_time()
        result = IpoptSolver().Solve(programme, guess, options)
        times.append(time.process_time() - begin)
    moments = np.ravel(made.GetSampleTimes(result))
    print(
        json.dumps(
            {
                "times": moments.tolist(),
                "torque": made.GetInputSamples(result).T.tolist(),
                "first_s": times[0],
                "second_s": times[-1],
                "build_s": build,
                "status": str(result.get_solver_details().ConvertStatusToString()),
            }
        )
    )


if __name__ == "__main__":
    main()
