"""Loads that an optimised motion puts on the joints, as its deflection objective sees them."""

from __future__ import annotations

import numpy as np

from stiffopt.certificate.rigid_body import rigid_body_history
from stiffopt.errors import ProblemError
from stiffopt.preload.load_case import LoadHistory
from stiffopt.problem.objectives import DEFLECTIONS
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.result.assessment import Assessment


def deflection_objective(problem: TrajectoryProblem) -> str:
    """Name of the deflection that a motion minimises, which preloads must be able to change.

    Raises
    ------
    ProblemError
        The objective is not the peak of a tool deflection alone.
    """
    asked = [
        f"{o.measure} {o.name}" if o.name in DEFLECTIONS else o.name for o in problem.objectives
    ]
    peaks = [f"peak {name}" for name in DEFLECTIONS]
    if len(asked) == 1 and asked[0] in peaks:
        return problem.objectives[0].name
    reason = "preloads are chosen for the instant of the largest deflection"
    if all(o.name not in DEFLECTIONS for o in problem.objectives):
        reason = "preloads do not change it, or are best at their limits whatever the motion"
    raise ProblemError(
        f"The motion minimises {' + '.join(asked)}, which cannot be studied together with the "
        f"preloads: {reason}. Minimise one of {', '.join(DEFLECTIONS)} alone, with measure = "
        "'peak', or leave [motion] out."
    )


def load_histories(problem: TrajectoryProblem, motion: Assessment) -> tuple[LoadHistory, ...]:
    """Torques and poses along a motion; pinocchio's, on the certificate's grid.

    Parameters
    ----------
    problem : TrajectoryProblem
        Robot, process force and objective.
    motion : Assessment

    Returns
    -------
    tuple of LoadHistory
        First the one whose wind-up is the deflection that the problem minimises. With a process
        force that does not count in it, a second one for the springs' full torque.
    """
    body = rigid_body_history(problem.robot, motion.position, motion.velocity, motion.acceleration)
    # Dynamic: beyond the sag, without the force. Process: what the force adds. Total: all of it.
    torque, reference = {
        "dynamic_deflection": (body.link_torque, body.gravity_torque),
        "process_deflection": (motion.spring_torque, body.link_torque),
        "total_deflection": (motion.spring_torque, None),
    }[deflection_objective(problem)]
    found = [
        LoadHistory(
            name="motion",
            time=motion.time,
            torque=torque,
            reference_torque=reference,
            jacobian=body.jacobian,
            source="motion of this study",
        )
    ]
    if np.any(problem.process_force) and torque is body.link_torque:
        found.append(
            LoadHistory(
                name="motion under the process force",
                time=motion.time,
                torque=motion.spring_torque,
                source="motion of this study",
            )
        )
    return tuple(found)
