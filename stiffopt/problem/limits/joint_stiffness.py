"""Lowest tangent stiffness allowed, joint by joint."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from stiffopt.declaration import POSITIVE, JointStiffness
from stiffopt.errors import ProblemError
from stiffopt.problem.limit import LIMITS, LimitKey, LimitKind, Limits
from stiffopt.problem.rest_poses import gravity_torque, rest_poses, stiffness_at, torque_sign_change
from stiffopt.problem.stage_terms import STIFFNESS_SMOOTHING, PathRows
from stiffopt.result.assessment import Assessment, Violation
from stiffopt.units import joint_unit

if TYPE_CHECKING:
    from stiffopt.problem.joint_lists import JointLists
    from stiffopt.problem.stage_model import StageModel
    from stiffopt.problem.trajectory import ResolvedMotion, TrajectoryProblem
    from stiffopt.robot.robot import Robot
    from stiffopt.symbolic import Quantity
    from stiffopt.validation import Section


class JointStiffnessFloor(LimitKind):
    """Lower bound of the tangent stiffness, as a torque bound where one torque separates the two.

    The stiffness of a reducer jumps at two torques. A bound on the torque is smooth and exact; one
    on the smoothed stiffness is flat, then steep, and approximates the jump.
    """

    name = "joint_stiffness"
    smoothing = STIFFNESS_SMOOTHING
    keys = (
        LimitKey(
            key="joint_stiffness",
            form=dict[int, Annotated[JointStiffness, POSITIVE]] | None,
            description="Lowest tangent stiffness allowed, by joint number from 1 [N m/rad, N/m].",
            value=lambda robot: {},
        ),
    )

    def active(self, limits: Limits) -> bool:
        """Return True if any joint has a lower bound."""
        return bool(limits.joint_stiffness)

    def read(self, section: Section, joints: JointLists) -> dict[str, Any]:
        """Read lower bounds by joint number."""
        floors = getattr(section, self.name) or {}
        for joint in floors:
            joints.check_number(joint, "limits.joint_stiffness")
        return {"joint_stiffness": dict(floors)}

    def rows(self, problem: TrajectoryProblem, model: StageModel, margin: float) -> list[PathRows]:
        """One row per joint with a lower bound."""
        labels, expressions = [], []
        for j, floor in sorted(problem.active_limits.joint_stiffness.items()):
            labels.append(f"joint {j}")
            needed = _torque_of_stiffness(model, j, floor)
            if needed and model.sides[j - 1]:
                share = model.sides[j - 1] * model.torques.spring[j - 1] / needed
                # Back off beyond the torque at which the stiffness jumps: rounding must not cross
                # it.
                expressions.append(1.0 + 2e-3 + margin - share)
            else:
                # Compliance is bounded where stiffness is steep.
                expressions.append(floor * model.compliance(j) - (1.0 - margin))
        return [PathRows(name=self.name, labels=tuple(labels), expressions=tuple(expressions))]

    def violations(self, limits: Limits, motion: Assessment) -> list[Violation]:
        """One violation per joint with a lower bound."""
        found = []
        for joint, floor in limits.joint_stiffness.items():
            low = motion.lowest_stiffness[joint - 1]
            found.append(Violation(1.0 - low.value / floor, self.name, joint, low.time))
        return found

    def check(self, problem: TrajectoryProblem, motion: ResolvedMotion) -> None:
        """Raise `ProblemError` where a sign change or a rest pose rules a bound out."""
        floors = problem.active_limits.joint_stiffness
        for joint, floor in floors.items():
            if not 1 <= joint <= problem.joints:
                raise ProblemError(
                    f"limits.joint_stiffness names joint {joint}; allowed: 1 to {problem.joints}."
                )
            unit = _stiffness_unit(problem.robot, joint)
            cause = torque_sign_change(problem, motion, joint)
            value = stiffness_at(problem, joint, 0.0)
            if cause and value < floor:
                raise ProblemError(
                    f"limits.joint_stiffness: joint {joint} cannot stay above {floor:.4g} {unit}, "
                    f"because its torque must change sign ({cause}) and its stiffness at zero "
                    f"torque is {value:.4g} {unit}. Lower the limit or leave the joint out."
                )
        for pose in rest_poses(problem, motion):
            if not pose.fixed:
                continue
            torque = gravity_torque(problem, pose.angles)
            for joint, floor in floors.items():
                value = stiffness_at(problem, joint, float(torque[joint - 1]))
                if value < floor:
                    unit = _stiffness_unit(problem.robot, joint)
                    raise ProblemError(
                        f"limits.joint_stiffness: joint {joint} has {value:.4g} {unit} at rest in "
                        f"the {pose.name} pose, below the limit {floor:.4g} {unit}, whatever the "
                        "motion. Lower the limit, choose another pose, or set "
                        'motion.boundary_acceleration = "free".'
                    )

    def statements(self, limits: Limits, robot: Robot) -> list[tuple[str, float, str]]:
        """One statement per joint with a lower bound."""
        return [
            (f"stiffness of joint {joint} at least", floor, _stiffness_unit(robot, joint))
            for joint, floor in limits.joint_stiffness.items()
        ]


def _stiffness_unit(robot: Robot, joint: int) -> str:
    return joint_unit("N m/rad", bool(robot.prismatic[joint - 1]))


def _torque_of_stiffness(model: StageModel, joint: int, floor: float) -> float | None:
    """Torque [N m] above which a joint is at least as stiff as `floor` [N m/rad].

    None without such a torque: the stiffness falls again within 1.5 times the joint's largest
    torque, or the joint is rigid.
    """
    chain = model.robot.chains[joint - 1]
    if chain is None:
        return None

    def stiff(torque: Quantity) -> Quantity:
        # Factor on the smoothing widths that makes a reducer's step a jump.
        return chain.tangent_stiffness(torque, smoothing=1e-6) >= floor

    largest = 1.5 * float(model.robot.torque_max[joint - 1])
    torques = np.array([0.0, *np.geomspace(1e-4 * largest, largest, 1000)])
    enough = stiff(torques)
    first = int(np.argmax(enough))
    if not np.all(enough[first:]):
        return None
    if first == 0:
        return 0.0
    low, high = torques[first - 1], torques[first]
    while high - low > 1e-9 * largest:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if stiff(middle) else (middle, high)
    return float(high)


LIMITS.add(JointStiffnessFloor())
