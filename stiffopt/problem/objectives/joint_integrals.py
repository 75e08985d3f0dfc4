"""Sums over the joints of integrals over time: torque, acceleration, compliance."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.problem.objective import OBJECTIVES, Objective, ObjectiveKind, TermInputs
from stiffopt.problem.stage_terms import STIFFNESS_SMOOTHING, ObjectiveTerms
from stiffopt.result.duty import life_rating

if TYPE_CHECKING:
    from collections.abc import Sequence

    from stiffopt.result.assessment import Assessment
    from stiffopt.robot.robot import Robot
    from stiffopt.symbolic import Quantity

# Share of its rated value below which a torque is smoothed at zero.
_SMOOTH_TORQUE_SHARE = 2e-2
# Share of the usual motion's mean below which a speed [rad/s] or power [W] is smoothed at zero: a
# share of the rated value would cover slow motions. And names of those means among the scales.
_SMOOTH_SHARE = 5e-3
_MEAN_SPEED, _MEAN_POWER = "mean speed of the fastest joint", "mean power of a drive"


class JointIntegral(ObjectiveKind):
    """Integral or mean over time, summed over the joints of the objective."""

    mean = False

    @abstractmethod
    def integrand(self, given: TermInputs, joint: int) -> Quantity:
        """Integrand of a joint (1-based), symbolic."""

    @abstractmethod
    def certified_integrand(self, robot: Robot, motion: Assessment) -> np.ndarray:
        """Integrand on the fine grid, (K, n)."""

    def terms(self, given: TermInputs) -> ObjectiveTerms:
        """Integral of the sum over the joints."""
        joints = given.objective.numbers(given.problem.joints)
        total = sum(self.integrand(given, joint) for joint in joints)
        if self.mean:
            return ObjectiveTerms(
                value=lambda integrals, duration: integrals[0] / duration, integrands=(total,)
            )
        return ObjectiveTerms(value=lambda integrals, duration: integrals[0], integrands=(total,))

    def certified_value(self, objective: Objective, motion: Assessment) -> float:
        """Sum of the joints' integrals."""
        numbers = objective.numbers(motion.position.shape[1])
        return float(sum(motion.integrals[f"{self.name}_{j}"] for j in numbers))

    def joint_integrals(self, robot: Robot, motion: Assessment) -> np.ndarray:
        """Integrals (n,) by the trapezoidal rule, joint by joint for least rounding."""
        over = motion.duration if self.mean else 1.0
        integrand = self.certified_integrand(robot, motion) / over
        return np.array([np.trapezoid(column, motion.time) for column in integrand.T])


class TorqueSquared(JointIntegral):
    """Integral of the sum of (torque / largest torque)^2."""

    name = "torque_squared"
    unit = "s"
    description = "Integral over time of the sum over `joints` of (drive torque / torque_max)^2."
    phrase = "time integral of the joints' squared (torque / largest torque)"
    prefixed = False
    of_drives = True

    def integrand(self, given: TermInputs, joint: int) -> Quantity:
        """Squared ratio of drive torque to largest torque."""
        largest = given.problem.robot.torque_max[joint - 1]
        return given.model.squared_drive_torque[joint - 1] / largest**2

    def certified_integrand(self, robot: Robot, motion: Assessment) -> np.ndarray:
        """Squared ratio from the certificate's torques."""
        return np.asarray((motion.torque / robot.torque_max) ** 2)


class AccelerationSquared(JointIntegral):
    """Integral of the sum of squared accelerations."""

    name = "acceleration_squared"
    unit = "rad^2/s^3"
    description = "Integral over time of the sum over `joints` of the squared acceleration."
    phrase = "time integral of the joints' squared accelerations"
    prefixed = False

    def integrand(self, given: TermInputs, joint: int) -> Quantity:
        """Squared acceleration."""
        return given.model.acceleration[joint - 1] ** 2

    def certified_integrand(self, robot: Robot, motion: Assessment) -> np.ndarray:
        """Squared acceleration on the fine grid."""
        return np.asarray(motion.acceleration**2)


class MeanCompliance(JointIntegral):
    """Time average of the summed tangent compliance."""

    name = "mean_compliance"
    unit = "rad/(N m)"
    description = "Average over time of the tangent compliance, summed over `joints`."
    phrase = "mean joint compliance"
    smoothing = STIFFNESS_SMOOTHING
    mean = True

    def integrand(self, given: TermInputs, joint: int) -> Quantity:
        """Tangent compliance at the spring torque."""
        return given.model.compliance(joint)

    def certified_integrand(self, robot: Robot, motion: Assessment) -> np.ndarray:
        """Tangent compliance by the exact law."""
        with np.errstate(divide="ignore"):
            return np.asarray(1.0 / motion.stiffness)


class ReducerLoad(JointIntegral):
    """Time at rated torque and speed that takes as much of the reducers' life."""

    name = "reducer_load"
    unit = "s"
    description = (
        "Time at rated torque and speed that takes as much life of the reducers of `joints`, "
        "summed: the integral of (speed / rated) (torque / rated)^p."
    )
    phrase = "time at the reducers' rated torque and speed"
    prefixed = False
    has_kink = True

    def integrand(self, given: TermInputs, joint: int) -> Quantity:
        """Smooth at rest."""
        rating, model = life_rating(given.problem.robot, joint - 1), given.model
        slow = _SMOOTH_SHARE * given.scales.of(_MEAN_SPEED) * model.kinks
        torque = model.torques.spring[joint - 1] / rating.torque
        turning = (np.sqrt(model.link[1][joint - 1] ** 2 + slow**2) - slow) / rating.speed
        return turning * (torque**2 + _SMOOTH_TORQUE_SHARE**2) ** (0.5 * rating.exponent)

    def scales(self, objective: Objective, motions: Sequence[Assessment]) -> dict[str, float]:
        """Return the typical value, and the mean speed of the fastest joint."""
        speed = float(np.abs(motions[0].velocity).mean(axis=0).max())
        return super().scales(objective, motions) | {_MEAN_SPEED: speed}

    def certified_integrand(self, robot: Robot, motion: Assessment) -> np.ndarray:
        """Return the integrand of the certificate's spring torques."""
        ratings = [life_rating(robot, j) for j in range(robot.n)]
        torque, speed, exponent = np.array([(r.torque, r.speed, r.exponent) for r in ratings]).T
        return np.asarray(
            np.abs(motion.velocity) / speed * (np.abs(motion.spring_torque) / torque) ** exponent
        )


class DriveWork(JointIntegral):
    """Mechanical work that the drives give."""

    name = "drive_work"
    unit = "J"
    description = "Mechanical work that the drives of `joints` give, nothing regenerated."
    phrase = "work of the drives"
    of_drives = True
    has_kink = True

    def integrand(self, given: TermInputs, joint: int) -> Quantity:
        """Positive part of the power, smooth at zero."""
        model = given.model
        width = _SMOOTH_SHARE * given.scales.of(_MEAN_POWER) * model.kinks
        power = model.drive_torque[joint - 1] * model.velocity[joint - 1]
        return 0.5 * (power + np.sqrt(power**2 + width**2) - width)

    def scales(self, objective: Objective, motions: Sequence[Assessment]) -> dict[str, float]:
        """Return the typical value, and the mean power of a drive."""
        joints = len(objective.numbers(motions[0].position.shape[1]))
        work = self.certified_value(objective, motions[0])
        return {self.name: work, _MEAN_POWER: work / joints / motions[0].duration}

    def certified_integrand(self, robot: Robot, motion: Assessment) -> np.ndarray:
        """Positive part of the certificate's power."""
        return np.asarray(np.maximum(motion.torque * motion.velocity, 0.0))


OBJECTIVES.add(TorqueSquared())
OBJECTIVES.add(ReducerLoad())
OBJECTIVES.add(DriveWork())
OBJECTIVES.add(AccelerationSquared())
OBJECTIVES.add(MeanCompliance())
