"""Feedforward lead of the motors that makes the links of an elastic arm move as planned.

An arm with elastic joints is flat in the motion of its links: a link motion q(t) needs the spring
torques tau, these the wind-ups phi(tau), and so the motors must be at q + phi(tau). Planned poses
hold at rest, where the wind-up under weight and process force is calibrated away: the motors' plan
is

    theta = q + phi(tau(q, v, a)) - phi(tau(q, 0, 0)).

Its derivatives follow by the chain rule; the motors' jerk contains the fifth derivative of q. Joint
damping carries part of the torque while the wind-up changes, so that the wind-up lags by damping
over stiffness, a few tenths of a millisecond, and the motors arrive later than the links
(`MotorLaw`).

phi is the drivetrain law with wider smoothing than in the deflection: a kink of the stiffness is a
kink of the motors' speed, and narrow smoothing exceeds any jerk limit between two nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import casadi as ca
import numpy as np

from stiffopt.dynamics.deflection import Deflection
from stiffopt.dynamics.kinematics import point_jacobian
from stiffopt.elastic.servo import Servo
from stiffopt.elastic.uncertainty import Uncertainty
from stiffopt.problem.commanded_error import CommandedError
from stiffopt.problem.stage_model import StageModel, windups
from stiffopt.result.trajectory import Trajectory
from stiffopt.robot.robot import Robot
from stiffopt.symbolic import Quantity
from stiffopt.transcription.point_function import PointFunction

# Smoothing widths of the feedforward-lead law over those of the deflection.
LAW_SMOOTHING_FACTOR = 2.0
# Lead beyond the nominal wind-up that a robust command may use, as a share of it.
ROBUST_LEAD_SHARE = 0.03
# Resolution of lags [s].
_LAG_STEP = 2e-5
# Times closer together are equal [s].
_TIME_TOLERANCE = 1e-3 * _LAG_STEP


class MotorModel(StageModel):
    """Stage model with planned links; position to jerk are those of the motors.

    Parameters
    ----------
    derivatives : list of SX (n,)
        Position of the links and its derivatives up to the fifth; fewer if no derivative of the
        motors is used.
    smoothing : SX or float
        Factor on every smoothing width of the stiffness model.
    sides : array (n,)
        As for `StageModel`.
    process_force : array_like (3,)
        Constant force on the tool, base axes [N].
    wider : SX or float
        Factor on the smoothing widths of the feedforward-lead law.
    robust : SX or float
        From 0 to 1, share of the back-off for a robust command (`ROBUST_LEAD_SHARE`).
    rest_poses : sequence of array (n,)
        Start and end, where the error of the command is asked for.
    """

    def __init__(
        self,
        robot: Robot,
        derivatives: list[Quantity],
        smoothing: Quantity,
        sides: np.ndarray,
        process_force: object = (0.0, 0.0, 0.0),
        wider: Quantity = LAW_SMOOTHING_FACTOR,
        robust: Quantity = 0.0,
        rest_poses: Sequence[np.ndarray] = (),
    ) -> None:
        self.robot, self.smoothing, self.sides, self.wider = robot, smoothing, sides, wider
        # Additional lead, as a share of the wind-up, that the drives' limits must allow.
        self._lead_margin = ROBUST_LEAD_SHARE * robust
        self.process_force = np.asarray(process_force, dtype=float)
        self._derivatives = derivatives
        self.rest_poses = rest_poses

    @property
    def link(self) -> tuple[Quantity, Quantity, Quantity]:
        """Position, velocity and acceleration of the links."""
        q, v, a = self._derivatives[:3]
        return q, v, a

    @property
    def snap(self) -> Quantity:
        """Fourth derivative of the links' position (n,) [rad/s^4]."""
        return self._derivatives[4]

    @cached_property
    def position(self) -> Quantity:
        """Motor position (n,) [rad]."""
        return self.sagged_position + self.lead

    @cached_property
    def lead(self) -> Quantity:
        """Lead of the motors (n,) [rad]."""
        return self.windup_of_motors(self.torques.spring)

    @cached_property
    def sagged_position(self) -> Quantity:
        """Link position less the calibrated sag (n,) [rad]."""
        return self.link[0] - self.sag

    @cached_property
    def sag(self) -> Quantity:
        """Wind-up under weight and process force (n,) [rad]."""
        return self.windup_of_motors(self.torques.held)

    @cached_property
    def velocity(self) -> Quantity:
        """Motor velocity (n,) [rad/s]."""
        moved = self._time_derivative(self.position, 3)
        return moved + self._lead_margin * (moved - self.link[1])

    @cached_property
    def deviation_rate(self) -> Quantity:
        """Approximate rate of the tool's deviation by the rate of the wind-up (3,) [m/s]."""
        return ca.mtimes(self.jacobian, self._time_derivative(self.lead, 3))

    @cached_property
    def acceleration(self) -> Quantity:
        """Motor acceleration (n,) [rad/s^2]."""
        return self._time_derivative(self.velocity, 4)

    @cached_property
    def jerk(self) -> Quantity:
        """Motor jerk (n,) [rad/s^3]."""
        return self._time_derivative(self.acceleration, 5)

    @cached_property
    def dynamic_windup(self) -> Quantity:
        """Wind-up beyond the sag (n,) [rad]."""
        return self.windup(self.torques.spring) - self.windup(self.torques.held)

    @cached_property
    def payload_torque(self) -> Quantity:
        """Torque by the acceleration of the payload, as a point mass (n,) [N m]."""
        robot, (q, v, a) = self.robot, self.link
        assert robot.payload is not None
        mass, moment = float(robot.payload[0]), robot.payload[1:4]
        flange = robot.flange
        place = flange.offset + flange.rotation @ (moment / mass)
        jacobian = point_jacobian(robot.tree, flange.joint, place, q)
        velocity = ca.mtimes(jacobian, v)
        acceleration = ca.mtimes(jacobian, a) + ca.jtimes(velocity, q, v)
        return mass * ca.mtimes(jacobian.T, acceleration)

    def commanded_error(self, uncertainty: Uncertainty, servo: Servo) -> CommandedError:
        """Errors that the command leaves on an uncertain arm."""
        return CommandedError(self, uncertainty, servo)

    @cached_property
    def deflection(self) -> Deflection:
        """Tool deflection, the dynamic part relative to the sag under weight and process force."""
        held, spring = self.windup(self.torques.held), self.windup(self.torques.spring)
        gravity = held
        if self.torques.gravity is not self.torques.held:
            gravity = self.windup(self.torques.gravity)

        def at_tool(angles: Quantity) -> Quantity:
            moved: Quantity = ca.mtimes(self.jacobian, angles)
            return -moved

        return self._with_bearings(
            Deflection(
                static=at_tool(gravity),
                dynamic=at_tool(spring - held),
                process=at_tool(held - gravity),
            )
        )

    @cached_property
    def torque_rates(self) -> list[Quantity]:
        """Approximate first three rates of the spring torques, (n,) each."""
        q, v, a, *along = self._derivatives
        torque = self.torques.spring
        first = ca.jtimes(torque, ca.vertcat(q, v, a), ca.vertcat(v, a, along[0]))
        inertia = ca.jacobian(self.torques.motion, a)
        return [first, *(ca.mtimes(inertia, each) for each in along[1:])]

    def windup_of_motors(self, torque: Quantity) -> Quantity:
        """Wind-up (n,) [rad] of the feedforward-lead law at spring torques (n,)."""
        return windups(self.chains, torque, self.wider * self.smoothing)

    def _time_derivative(self, value: Quantity, orders: int) -> Quantity:
        return _time_derivative(value, self._derivatives, orders)


class ApproximateMotorModel(MotorModel):
    """Motor model with cheap approximate derivatives, for the optimiser.

    The lead law and the first rate of the spring torques are differentiated exactly; second and
    third rates are the links' inertia times snap and crackle, and the rate of the sag is neglected.
    The motor jerk is off by 1 to 2 % of its limit, by which rows are backed off
    (`transcription.constraint_back_off`). Exact derivatives make
    an iteration three times as expensive.
    """

    @cached_property
    def velocity(self) -> Quantity:
        """Approximate motor velocity (n,) [rad/s]."""
        return self.link[1] + self._lead_rates[0] + self._lead_margin * self._lead_rates[0]

    @cached_property
    def acceleration(self) -> Quantity:
        """Approximate motor acceleration (n,) [rad/s^2]."""
        return self.link[2] + self._lead_rates[1] + self._lead_margin * self._lead_rates[1]

    @cached_property
    def jerk(self) -> Quantity:
        """Approximate motor jerk (n,) [rad/s^3]."""
        return self._derivatives[3] + self._lead_rates[2] + self._lead_margin * self._lead_rates[2]

    @cached_property
    def deviation_rate(self) -> Quantity:
        """Approximate rate of the tool's deviation by the rate of the wind-up (3,) [m/s]."""
        return ca.mtimes(self.jacobian, self._lead_rates[0])

    @property
    def computed_torques(self) -> Quantity:
        """Torques of gravity and motion and the rates of the spring torques, as far as built."""
        parts = [super().computed_torques]
        if "torque_rates" in self.__dict__:
            parts += self.torque_rates
        return ca.vertcat(*parts)

    @cached_property
    def _lead_rates(self) -> list[Quantity]:
        """First three rates of the lead, (n,) each."""
        first, second, third = self.torque_rates
        torque = ca.SX.sym("torque", self.robot.n)
        law, one = [self.windup_of_motors(torque)], np.ones(self.robot.n)
        for _ in range(3):
            law.append(ca.jtimes(law[-1], torque, one))
        *_, steep, bent, twisted = ca.substitute(law, [torque], [self.torques.spring])
        return [
            steep * first,
            steep * second + bent * first**2,
            steep * third + 3.0 * bent * first * second + twisted * first**3,
        ]


def round_lags(lag: np.ndarray) -> np.ndarray:
    """Round lags [s] to the resolution of `MotorLaw`: equal or clearly distinct."""
    return np.asarray(_LAG_STEP * np.round(lag / _LAG_STEP))


class MotorLaw:
    """Feedforward-lead law of a robot, built once for many motions.

    `process_force` (3,): constant force on the tool, base axes [N].
    """

    def __init__(self, robot: Robot, process_force: object = (0.0, 0.0, 0.0)) -> None:
        n = robot.n
        motion, torque = [ca.SX.sym(f"d{k}", n) for k in range(3)], ca.SX.sym("torque", n)
        smoothing = ca.SX.sym("smoothing")
        model = MotorModel(robot, motion, smoothing, np.zeros(n), process_force, 1.0)
        # Torques do not depend on the smoothing: the expensive part is evaluated once.
        self._spring = _compile_rates(motion, model.torques.spring)
        # Three rates suffice; each further one costs twice the previous.
        self._held = _compile_rates(motion[:1], model.torques.held)
        self._windup = _compile_rates([torque], model.windup_of_motors(torque), smoothing)
        self._last: tuple[Trajectory, np.ndarray, np.ndarray, np.ndarray] | None = None

    def motion(
        self,
        link: Trajectory,
        smoothing: float,
        lag: np.ndarray | None = None,
        *,
        sagged: bool = False,
    ) -> Trajectory:
        """Motor motion that makes the links move as planned.

        `link`: link motion with five derivatives. `smoothing`: factor on the law's smoothing
        widths: kinks would require jumps of the speed. `lag` (n,): lag of each joint's wind-up
        behind its spring torque [s]: damping over stiffness. The motors arrive later by the lag;
        the links have to be at rest then. `sagged`: evaluate the spring torques at the sagged
        links, p = q - phi(tau(p, 0, 0)), in place of the plan: the weight differs there, and the
        sag has an acceleration of its own.
        """
        moves = _sample_times(link)
        if sagged:
            plan = np.stack([link(moves, k) for k in range(6)])
            place = self._sagged_motion(link, moves, plan, smoothing)
            spring = _evaluate_rates(self._spring, place)
        else:
            plan, spring, weight = self._evaluate_torques(link, moves)
            place = plan[:4] - _evaluate_rates(self._windup, weight, smoothing)
        lead = _evaluate_rates(self._windup, spring, smoothing)
        if lag is None:
            return Trajectory.through(moves, place[:4] + lead, link)
        # The wind-up is a separate motion that starts and ends later by the lag.
        windup = Trajectory.through(moves, lead, link)
        hanging = Trajectory.through(moves, place[:4], link)
        held = link.held_for(float(np.max(lag)))
        # The third rate jumps where a wind-up starts or ends: sample both sides.
        times = np.union1d(
            _sample_times(held), np.concatenate([lag, link.duration + np.asarray(lag)])
        )
        times = times[np.concatenate([[True], np.diff(times) > _TIME_TOLERANCE])]
        sides = []
        for at, beside in ((times, _TIME_TOLERANCE), (times[1:], -_TIME_TOLERANCE)):
            motors = _evaluate_beside(hanging, at, beside)
            for own in np.unique(lag):
                joints = lag == own
                motors[:, :, joints] += _evaluate_beside(windup, at - own, beside)[:, :, joints]
            sides.append(motors)
        return Trajectory.through(times, sides[0], held, sides[1])

    def _evaluate_torques(
        self, link: Trajectory, moves: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Link plan (6, K, n), spring torques and static torques with three rates (4, K, n).

        Cached for the last plan, which is evaluated for several smoothing widths.
        """
        if self._last is None or self._last[0] is not link:
            plan = np.stack([link(moves, k) for k in range(6)])
            self._last = (
                link,
                plan,
                _evaluate_rates(self._spring, plan),
                _evaluate_rates(self._held, plan[:4]),
            )
        return self._last[1:]

    def _sagged_motion(
        self, link: Trajectory, moves: np.ndarray, plan: np.ndarray, smoothing: float
    ) -> np.ndarray:
        """Sagged link motion with five derivatives (6, K, n)."""
        place, sag = plan[:4], np.zeros_like(plan[:4])
        # Fixed-point iteration: the sag depends only weakly on itself.
        for _ in range(30):
            before, sag = (
                sag,
                _evaluate_rates(self._windup, _evaluate_rates(self._held, place), smoothing),
            )
            place = plan[:4] - sag
            if np.max(np.abs(sag[0] - before[0])) < 1e-10:
                break
        # Two further rates come from polynomials of degree 7: their formulas would be fifteen times
        # as long.
        along = Trajectory.through(moves, sag, link)
        return np.concatenate([place, plan[4:] - np.stack([along(moves, k) for k in (4, 5)])])


def _time_derivative(value: Quantity, along: Sequence[Quantity], orders: int) -> Quantity:
    """Time derivative of a value that depends on the first `orders` derivatives of a motion."""
    return ca.jtimes(value, ca.vertcat(*along[:orders]), ca.vertcat(*along[1 : orders + 1]))


def _compile_rates(given: list[Quantity], value: Quantity, *numbers: Quantity) -> PointFunction:
    """Compile a value and its first three rates for many instants.

    `given` are a motion and its derivatives that the value depends on; `numbers` are constant over
    all instants.
    """
    n, orders, empty = value.numel(), len(given), ca.SX(0, 1)
    inputs: list[Quantity] = [ca.vertcat(*given), empty, empty, ca.vertcat(empty, *numbers)]

    def rates(known: Quantity, found: Quantity) -> tuple[Quantity, Quantity]:
        along = [*ca.vertsplit(known, n), *(ca.SX.sym(f"r{k}", n) for k in range(3))]
        values = [found]
        for k in range(3):
            values.append(_time_derivative(values[-1], along, orders + k))
        # Share common subexpressions of the rates.
        return ca.vertcat(*along), ca.vertcat(*ca.cse(values))

    return PointFunction(ca.Function("law", inputs, [value]), rates)


def _evaluate_rates(law: PointFunction, rates: np.ndarray, *numbers: float) -> np.ndarray:
    """Evaluate a compiled law (m, K, n) along a motion with rates (k, K, n)."""
    orders, count, n = rates.shape
    values = law(rates.swapaxes(0, 1).reshape(count, orders * n).T, np.array(numbers))
    return values.reshape(-1, n, count).swapaxes(1, 2)


def _sample_times(motion: Trajectory) -> np.ndarray:
    """Sampling times of the motors for a motion of the links."""
    begins, ends = motion.times[:-1], motion.times[1:]
    # Largest sampling step of the motors' motion [s], and least number of samples per interval of
    # the links' motion: polynomials of degree 7 between samples are then accurate to rounding.
    counts = np.maximum(np.ceil((ends - begins) / 2.5e-3).astype(int), 4)
    inside = [np.linspace(*each, endpoint=False) for each in zip(begins, ends, counts, strict=True)]
    return np.append(np.concatenate(inside), motion.duration)


def _evaluate_beside(motion: Trajectory, at: np.ndarray, beside: float) -> np.ndarray:
    """Motion with three rates (4, K, n) one `beside` away from times; at rest outside it."""
    inside = np.clip(at, 0.0, motion.duration)
    values = np.stack([motion(inside, k) for k in range(4)])
    values[1:, (at + beside < 0.0) | (at + beside > motion.duration)] = 0.0
    return values
