"""Tool error of the commanded arm by linear propagation of its uncertain parameters.

A command for the nominal arm leads its links exactly along the plan. On an arm whose parameters
differ slightly, the links miss the plan by the sum of the responses z to one torque f a parameter,

    M z'' + C z' + K z = f(t):

of a joint's stiffness its dynamic spring torque, of the damping its rate of wind-up, of the payload
its inertial torque, of the servo the inertial torque of the motors' error, on which the links ride.
Static torques are left out: a calibrated arm rests where it should. Elastic bearings are joints of
their own (`BearingJoints`); the command leads by what the driven joints can correct of their
deflection, and the rest is the mean error.

Parameters are independent and uniform within their bounds, the servo between the nominal and the
worst one. Their mean square is then a third of the bound's, and the bound is a multiple of the root
mean square error.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.elastic.bearing_joints import BearingJoints
from stiffopt.elastic.bearing_lead import uncorrected_deflection
from stiffopt.elastic.modes import modes
from stiffopt.elastic.response import ElasticResponse
from stiffopt.elastic.uncertain_arms import LinearizedBodies
from stiffopt.result.tool_error import UNIFORM_MEAN_SQUARE, PropagatedError
from stiffopt.robot.batched_kinematics import tool_jacobians

if TYPE_CHECKING:
    from stiffopt.elastic.arm import ElasticArm
    from stiffopt.elastic.servo import Servo
    from stiffopt.elastic.uncertainty import Uncertainty
    from stiffopt.result.trajectory import JointMotion

# Between samples [s].
_TIME_STEP = 1e-3
# Periods of the lowest mode after arrival, at most so long [s]: the first peak is the largest.
_PERIODS_AFTER_ARRIVAL, _MAX_TIME_AFTER_ARRIVAL = 1.5, 1.0
# Least relative change of a stiffness by which the change of a wind-up is found.
_MIN_STIFFNESS_STEP = 1e-6
# Rate at which the servo's response to a constant speed is evaluated [1/s].
_SLOW_RATE = 1e-3


def propagate_error(
    arm: ElasticArm, plan: JointMotion, uncertainty: Uncertainty, servo: Servo
) -> PropagatedError:
    """Propagate the uncertainty of an arm to the tool error of the command for a plan.

    Parameters
    ----------
    arm : ElasticArm
    plan : JointMotion
        Motion of the links, at rest at both ends.
    uncertainty : Uncertainty
    servo : Servo
        Nominal one, whose lag the command leads.
    """
    bounds, driven, mean = uncertainty.shares(arm.robot.n), np.arange(arm.robot.n), None
    if arm.robot.tilts:
        joints = BearingJoints(arm, plan(np.zeros(1))[0])
        bounds, driven = joints.spread(bounds, uncertainty.bearing_stiffness), joints.driven
        along = _MotionSamples(joints.arm, joints.links(plan), driven)
        mean = along.extend_at_rest(uncorrected_deflection(arm, plan, along.flight))
        arm = joints.arm
    else:
        along = _MotionSamples(arm, plan, driven)
    torques = dict(along.disturbances(uncertainty, bounds))
    motors = np.zeros_like(along.q)
    if (worst := uncertainty.worst_servo(servo)) != servo:
        motors, torques["servo"] = along.servo_disturbance(servo, worst)
    free = np.flatnonzero(arm.elastic)
    among = np.ix_(np.arange(len(along.time)), free, free)
    jacobian = tool_jacobians(arm.robot.tree, arm.robot.tool, along.q)[1]
    loads = np.stack([each[:, free] for each in torques.values()], axis=2) if torques else None
    shares: dict[str, list[np.ndarray]] = {name: [] for name in torques}
    for side in (-1.0, 1.0):
        # Two nodes of Gauss quadrature over the stiffness of all joints: what rings depends on it.
        factor = 1.0 + side * np.sqrt(UNIFORM_MEAN_SQUARE) * bounds[free]
        springs = along.stiffness[:, free] * factor
        response = ElasticResponse(
            along.inertia[among],
            along.by_v[among] + np.diag(arm.damping[free]),
            along.by_q[among] + springs[:, :, None] * np.eye(len(free)),
            along.step,
        )
        moved = None if loads is None else response(loads)[0]
        for k, name in enumerate(torques):
            assert moved is not None
            links = motors.copy() if name == "servo" else np.zeros_like(motors)
            links[:, free] += moved[:, :, k]
            shares[name].append(np.einsum("kxj,kj->kx", jacobian, links))
    return PropagatedError(
        time=along.time,
        duration=plan.duration,
        shares={name: np.stack(own) for name, own in shares.items()},
        mean=np.zeros_like(along.q[:, :3]) if mean is None else mean,
    )


class _MotionSamples:
    """Matrices and torques of an arm along a plan and in the rest after it, evenly in time."""

    def __init__(self, arm: ElasticArm, plan: JointMotion, driven: np.ndarray) -> None:
        self._arm, self._driven = arm, driven
        numbers = np.searchsorted(driven, np.arange(arm.robot.n), side="right")
        self._names = np.array(
            [
                f"{'stiffness' if j in driven else 'bearing'} of joint {number}"
                for j, number in enumerate(numbers)
            ]
        )
        slowest = min((mode.frequency for mode in modes(arm, plan(np.zeros(1))[0])), default=1.0)
        count = int(np.ceil(plan.duration / _TIME_STEP))
        self.step = plan.duration / count
        window = min(_PERIODS_AFTER_ARRIVAL / slowest, _MAX_TIME_AFTER_ARRIVAL)
        self._rest = int(np.ceil(window / self.step))
        self.time = self.step * np.arange(count + self._rest + 1)
        self.time[count] = plan.duration
        self.flight = np.linspace(0.0, plan.duration, count + 1)
        q, v, a = (np.array(plan(self.flight, k)) for k in range(3))
        v[-1] = a[-1] = 0.0
        bodies, still = LinearizedBodies(arm, q, v, a), np.zeros_like(q)
        self.q = self.extend_at_rest(q)
        self.inertia, self.by_v, self.by_q = (
            self.extend_at_rest(each[0]) for each in (bodies.inertia, bodies.by_v, bodies.by_q)
        )
        held = LinearizedBodies(arm, q, still, still)
        # First of all bodies, then of the payload.
        self._torque, self._weight = self._extend_all(bodies.torque), self._extend_all(held.torque)
        self._windup = arm.windup(self._torque[0])
        self.stiffness = self._spring_stiffness(self._torque[0])
        self._finite_stiffness = np.where(arm.elastic, self.stiffness, 0.0)

    def disturbances(
        self, uncertainty: Uncertainty, bounds: np.ndarray
    ) -> Iterator[tuple[str, np.ndarray]]:
        """Torques (K, n) [N m] of the parameters of the arm at their bounds."""
        arm = self._arm
        away = self._windup_departure(self._torque[0], bounds)
        away -= self._windup_departure(self._weight[0], bounds)
        uncertain = arm.elastic & (bounds > 0.0)
        # All components of a bearing are soft or stiff together.
        for name in dict.fromkeys(self._names[uncertain].tolist()):
            own = uncertain & (self._names == name)
            yield name, np.where(own, self._finite_stiffness * away, 0.0)
        if uncertainty.damping and arm.damping.any():
            rate = np.gradient(self._windup, self.step, axis=0)
            yield "damping", uncertainty.damping * arm.damping * rate
        if len(self._torque) > 1 and uncertainty.payload:
            away = self._payload_departure(self._torque, uncertainty.payload)
            away -= self._payload_departure(self._weight, uncertainty.payload)
            yield "payload", self._finite_stiffness * away

    def servo_disturbance(self, servo: Servo, worst: Servo) -> tuple[np.ndarray, np.ndarray]:
        """Motors' error (K, n) [rad] with the worst servo, and the torque (K, n) that it costs.

        By the transfer function in the frequency domain, padded by as long a rest.
        """
        velocity = np.zeros_like(self.q)
        driven = self._driven
        velocity[:, driven] = np.gradient((self.q + self._windup)[:, driven], self.step, axis=0)
        count = 2 * len(velocity)
        s = 2j * np.pi * np.fft.rfftfreq(count, self.step)
        s[0] = _SLOW_RATE
        spectrum = np.fft.rfft(velocity, count, axis=0)
        spectrum *= ((worst.transfer(s) / servo.transfer(s) - 1.0) / s)[:, None]
        s[0] = 0.0
        error, speed, bend = (
            np.fft.irfft(spectrum * s[:, None] ** k, count, axis=0)[: len(velocity)]
            for k in range(3)
        )
        parts = zip((self.by_q, self.by_v, self.inertia), (error, speed, bend), strict=True)
        return error, -sum(np.einsum("kij,kj->ki", by, moved) for by, moved in parts)

    def _windup_departure(self, torque: np.ndarray, bounds: np.ndarray) -> np.ndarray:
        """Change of the wind-ups (K, n) [rad] at torques (K, n) by the bounds of the stiffness.

        Between two stiffnesses, which blurs the kinks of a reducer as uncertain arms do.
        """
        step = np.maximum(np.sqrt(UNIFORM_MEAN_SQUARE) * bounds, _MIN_STIFFNESS_STEP)
        softer, stiffer = (self._arm.windup(torque / (1.0 + h)) for h in (-step, step))
        return np.asarray(0.5 * bounds / step * (softer - stiffer))

    def _payload_departure(self, torques: list[np.ndarray], bound: float) -> np.ndarray:
        """Change of the wind-ups (K, n) [rad] at torques by a payload heavier by the bound."""
        whole, payload = torques
        return np.asarray(self._arm.windup(whole) - self._arm.windup(whole + bound * payload))

    def _spring_stiffness(self, torque: np.ndarray) -> np.ndarray:
        """Tangent stiffnesses (K, n) [N m/rad] at torques (K, n); infinite for rigid joints."""
        found = np.full_like(torque, np.inf)
        for j, spring in enumerate(self._arm.springs):
            if spring is not None:
                found[:, j] = 1.0 / spring.compliance(torque[:, j])
        return found

    def _extend_all(self, values: np.ndarray) -> list[np.ndarray]:
        return [self.extend_at_rest(each) for each in values]

    def extend_at_rest(self, values: np.ndarray) -> np.ndarray:
        """Append the last values of the flight for the rest after it."""
        return np.concatenate([values, np.repeat(values[-1:], self._rest, axis=0)])
