"""Shortest time on the straight joint line by toppra: what a free path is compared with."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import numpy as np
import pinocchio as pin
import toppra
from toppra import algorithm, constraint

toppra.setup_logging("ERROR")


def main() -> None:
    """Read the task, time the straight line twice, print the answer."""
    task = json.loads(Path(sys.argv[1]).read_text())
    model = pin.buildModelFromUrdf(task["urdf"])
    data = model.createData()
    speed, torque = np.array(task["velocity_max"]), np.array(task["torque_max"])
    path = toppra.SplineInterpolator([0.0, 1.0], np.array([task["start"], task["end"]]))
    times = []
    for _ in range(2):
        begin = time.process_time()
        limits = [
            constraint.JointVelocityConstraint(np.stack([-speed, speed], axis=1)),
            constraint.JointTorqueConstraint(
                lambda q, v, a: np.array(pin.rnea(model, data, q, v, a)),
                np.stack([-torque, torque], axis=1),
                np.zeros(len(speed)),
                discretization_scheme=constraint.DiscretizationType.Interpolation,
            ),
        ]
        made = algorithm.TOPPRA(
            limits,
            path,
            gridpoints=np.linspace(0.0, 1.0, task["intervals"] + 1),
            parametrizer="ParametrizeConstAccel",
        )
        motion = made.compute_trajectory()
        times.append(time.process_time() - begin)
    at = np.linspace(0.0, motion.duration, 50 * task["intervals"] + 1)
    middle = 0.5 * (at[:-1] + at[1:])
    print(
        json.dumps(
            {
                "times": at.tolist(),
                "acceleration_held": motion(middle, 2).tolist(),
                "first_s": times[0],
                "second_s": times[1],
                "build_s": 0.0,
                "iterations": 1,
                "status": "solved",
            }
        )
    )


if __name__ == "__main__":
    main()
