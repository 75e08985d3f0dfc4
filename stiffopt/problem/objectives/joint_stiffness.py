"""Maximisation of the lowest tangent stiffness of the joints over the motion."""

from __future__ import annotations

import numpy as np

from stiffopt.errors import ProblemError
from stiffopt.problem.objective import (
    ACCEPT_ADVICE,
    OBJECTIVES,
    Bound,
    Objective,
    ObjectiveKind,
    TermInputs,
)
from stiffopt.problem.rest_poses import gravity_torque, rest_poses, stiffness_at, torque_sign_change
from stiffopt.problem.stage_terms import (
    STIFFNESS_SMOOTHING,
    ObjectiveTerms,
    PathRows,
    StaticVariable,
)
from stiffopt.problem.trajectory import ResolvedMotion, TrajectoryProblem
from stiffopt.result.assessment import Assessment
from stiffopt.units import joint_unit

# Penalty of a sign change by torque_max, as a relative loss of stiffness.
_RELIEF_PRICE = 10.0


class LowestJointStiffness(ObjectiveKind):
    """Smallest k_j / weight_j over time and joints, maximised through a lower bound.

    A joint whose torque changes sign has its minimum at zero torque. Further rows keep torques on
    one side, as they could cross zero between nodes; motions too fast for that violate them by a
    penalised slack, the relief.
    """

    name = "joint_stiffness"
    unit = "N m/rad"
    description = (
        "MAXIMISES the smallest k_j / weight_j over time and `joints`, k_j the tangent stiffness "
        "of joint j and weight_j its entry of `joint_weights`."
    )
    phrase = "lowest weighted joint stiffness"
    maximised = True
    ends_motion = True
    smoothing = STIFFNESS_SMOOTHING

    def bounds(
        self, objective: Objective, problem: TrajectoryProblem, motion: ResolvedMotion
    ) -> list[Bound]:
        """Stiffness at zero torque where a torque must change sign, else that of a rest pose."""
        found = []
        for joint in objective.numbers(problem.joints):
            if problem.robot.chains[joint - 1] is None:
                raise ProblemError(
                    f"Joint {joint} of {problem.robot.name} has no drivetrain, so it has no "
                    "stiffness. Describe its elements in the robot file, or leave it out of "
                    "minimise.joints."
                )
            cause = torque_sign_change(problem, motion, joint)
            weight = objective.weight_of(joint)
            slides = bool(problem.robot.prismatic[joint - 1])
            unit = joint_unit("N m/rad", slides)
            if cause:
                value = stiffness_at(problem, joint, 0.0)
                text = (
                    f"The torque of joint {joint} must change sign ({cause}), so its lowest "
                    f"stiffness is the one at zero torque, {value:.4g} {unit}, whatever the "
                    f"motion. Leave joint {joint} out (minimise.joints), minimise "
                    f"'mean_compliance' or 'dynamic_deflection' instead{ACCEPT_ADVICE}"
                )
                found.append(Bound(self.name, value / weight, text, True))
                continue
            for pose in rest_poses(problem, motion):
                if pose.fixed:
                    torque = float(gravity_torque(problem, pose.angles)[joint - 1])
                    value = stiffness_at(problem, joint, torque)
                    load = f"{torque:.3g} {joint_unit('N m', slides)}"
                    text = (
                        f"The lowest stiffness of joint {joint} cannot exceed {value:.4g} {unit}, "
                        f"its value at rest in the {pose.name} pose ({load})."
                    )
                    found.append(Bound(self.name, value / weight, text, False))
        return found

    def static_variables(
        self, objective: Objective, problem: TrajectoryProblem, sides: np.ndarray
    ) -> tuple[StaticVariable, ...]:
        """Lower bound [N m/rad], and the relief [-] if any joint can keep its sign."""
        bound = StaticVariable(
            name="minimum joint stiffness",
            start=lambda motion: self.certified_value(objective, motion),
        )
        kept = _single_sided_joints(objective, problem, sides)
        if not kept:
            return (bound,)
        columns = np.array(kept) - 1

        def relief(motion: Assessment) -> float:
            turned = -sides[columns] * motion.spring_torque[:, columns]
            return float(max(np.max(turned / problem.robot.torque_max[columns]), 0.0))

        return bound, StaticVariable(name="torque on the other side", start=relief, scale=1.0)

    def terms(self, given: TermInputs) -> ObjectiveTerms:
        """Lower bound less the penalty of the relief."""
        bound = given.statics[0]
        joints = given.objective.numbers(given.problem.joints)
        stiff = PathRows(
            name="minimum joint stiffness",
            labels=tuple(f"joint {j}" for j in joints),
            # Compliance is smooth and bounded where stiffness is steep.
            expressions=tuple(
                bound * given.objective.weight_of(j) * given.model.compliance(j) - 1.0
                for j in joints
            ),
        )
        kept = _single_sided_joints(given.objective, given.problem, given.model.sides)
        if not kept:
            return ObjectiveTerms(value=lambda integrals, duration: bound, path_rows=(stiff,))
        relief = given.statics[1]
        torque, largest = given.model.torques.spring, given.problem.robot.torque_max
        one_sided = PathRows(
            name="torque on one side",
            labels=tuple(f"joint {j}" for j in kept),
            expressions=tuple(
                given.model.sides[j - 1] * torque[j - 1] / largest[j - 1] + relief for j in kept
            ),
            lower=0.0,
            upper=np.inf,
        )
        return ObjectiveTerms(
            value=lambda integrals, duration: bound - _RELIEF_PRICE * given.scale * relief,
            path_rows=(stiff, one_sided),
        )

    def certified_value(self, objective: Objective, motion: Assessment) -> float:
        """Lowest weighted stiffness on the fine grid [N m/rad]."""
        return min(
            motion.lowest_stiffness[j - 1].value / objective.weight_of(j)
            for j in objective.numbers(motion.position.shape[1])
        )


def _single_sided_joints(
    objective: Objective, problem: TrajectoryProblem, sides: np.ndarray
) -> tuple[int, ...]:
    """Joints (1-based) of the objective that can keep the sign of their spring torque."""
    return tuple(j for j in objective.numbers(problem.joints) if sides[j - 1] != 0)


OBJECTIVES.add(LowestJointStiffness())
