"""Motion of the motors that makes the links of an elastic arm move as planned.

An arm with elastic joints is flat in the motion of its links: a link motion q(t) needs the spring
torques tau, these the wind-ups phi(tau), and so the motors must be at q + phi(tau). Planned poses
hold at rest, where the wind-up under weight and process force is calibrated away: the motors' plan
is

    theta = q + phi(tau(q, v, a)) - phi(tau(q, 0, 0)).

Its derivatives follow by the chain rule; the motors' jerk holds the fifth derivative of q. Damping
of the joints bears part of the torque while the wind-up changes: the wind-up lags by damping over
stiffness, a few tenths of a millisecond, by which the motors arrive later than the links
(`MotorLaw`).

phi is the law of the drivetrain with its corners wider than the deflection's formula has them: a
corner of the stiffness is a kink of the motors' speed, and a narrow one exceeds any jerk between
two nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from stiffopt.dynamics.deflection import Deflection
from stiffopt.problem.stage_model import StageModel
from stiffopt.problem.stage_terms import WINDUP_SMOOTHING
from stiffopt.result.trajectory import Trajectory
from stiffopt.symbolic import Quantity
from stiffopt.transcription.point_function import PointFunction

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.robot.robot import Robot

# Smoothing widths of the motors' law over those of the deflection.
WIDER = 2.0
# Share of the nominal wind-up by which a command leads beyond it, on arms that are not as modelled.
LEADS_MORE = 0.03
# Distance of the samples of the motors' motion [s], and their least number in an interval of the
# links': between them a polynomial of degree 7 is as good as exact.
_STEP = 2.5e-3
_LEAST = 4
# Lags are rounded to multiples of this [s].
_LAGS = 2e-5
# Instants nearer to each other are one [s].
_SLACK = 1e-3 * _LAGS
# The place where links hang has settled when it moves by no more [rad]; found in so many rounds.
_SETTLED, _ROUNDS = 1e-10, 30


class MotorModel(StageModel):
    """Stage model of a motion planned for the links: position to jerk are those of the motors.

    Parameters
    ----------
    robot : Robot
    derivatives : list of SX (n,)
        Of the links: position, velocity, and so on up to the fifth; fewer where no derivative of
        the motors is asked.
    smoothing : SX or float
        Factor on every smoothing width of the stiffness model.
    sides : array (n,)
        As for `StageModel`.
    process_force : array_like (3,)
        Acts on the tool all the time, base axes [N].
    wider : SX or float
        Smoothing widths of the motors' law over those of the deflection.
    robust : SX or float
        From 0 to 1, how much of the room that a command takes (`LEADS_MORE`) is kept to the
        drives' limits.
    """

    def __init__(
        self,
        robot: Robot,
        derivatives: list[Quantity],
        smoothing: Quantity,
        sides: np.ndarray,
        process_force: object = (0.0, 0.0, 0.0),
        wider: Quantity = WIDER,
        robust: Quantity = 0.0,
    ) -> None:
        self.robot, self.smoothing, self.sides, self.wider = robot, smoothing, sides, wider
        # Of the wind-up, kept to the drives' limits beyond what the motors lead by.
        self._room = LEADS_MORE * robust
        self.process_force = np.asarray(process_force, dtype=float)
        self._derivatives = derivatives

    @property
    def link(self) -> tuple[Quantity, Quantity, Quantity]:
        """The links' own motion."""
        q, v, a = self._derivatives[:3]
        return q, v, a

    @property
    def snap(self) -> Quantity:
        """Fourth derivative of the links' position (n,) [rad/s^4]."""
        return self._derivatives[4]

    @cached_property
    def position(self) -> Quantity:
        """Of the motors (n,) [rad]."""
        return self.hung + self.lead

    @cached_property
    def lead(self) -> Quantity:
        """Wind-up by which the motors are ahead (n,) [rad]."""
        return self.windup_of_motors(self.torques.spring)

    @cached_property
    def hung(self) -> Quantity:
        """The links' position less the wind-up that is calibrated away (n,) [rad]."""
        return self.link[0] - self.sag

    @cached_property
    def sag(self) -> Quantity:
        """Wind-up under weight and process force (n,) [rad]."""
        return self.windup_of_motors(self.torques.held)

    @cached_property
    def velocity(self) -> Quantity:
        """Of the motors (n,) [rad/s]."""
        moved = self._rate(self.position, 3)
        return moved + self._room * (moved - self.link[1])

    @cached_property
    def deviation_rate(self) -> Quantity:
        """How fast the tool's deviation changes by that of the wind-up, nearly (3,) [m/s]."""
        return ca.mtimes(self.jacobian, self._rate(self.lead, 3))

    @cached_property
    def acceleration(self) -> Quantity:
        """Of the motors (n,) [rad/s^2]."""
        return self._rate(self.velocity, 4)

    @cached_property
    def jerk(self) -> Quantity:
        """Of the motors (n,) [rad/s^3]."""
        return self._rate(self.acceleration, 5)

    @cached_property
    def deflection(self) -> Deflection:
        """Deflection of the tool, the dynamic part from where it hangs under weight and force."""
        held, spring = self.windup(self.torques.held), self.windup(self.torques.spring)
        gravity = held
        if self.torques.gravity is not self.torques.held:
            gravity = self.windup(self.torques.gravity)

        def at_tool(angles: Quantity) -> Quantity:
            moved: Quantity = ca.mtimes(self.jacobian, angles)
            return -moved

        return Deflection(
            static=at_tool(gravity), dynamic=at_tool(spring - held), process=at_tool(held - gravity)
        )

    def windup_of_motors(self, torque: Quantity) -> Quantity:
        """Wind-up (n,) [rad] by which the motors are ahead."""
        angles = [
            0.0 if chain is None else chain.windup(torque[j], smoothing=self.wider * self.smoothing)
            for j, chain in enumerate(self.chains)
        ]
        return ca.vertcat(*angles)

    def _rate(self, value: Quantity, orders: int) -> Quantity:
        return _rate(value, self._derivatives, orders)


class NearMotorModel(MotorModel):
    """What the optimiser sees: derivatives of the motors that are nearly exact, and cheap.

    The law is differentiated exactly, the spring torques' first rate too; the second and third are
    those of the links' inertia times the links' snap and crackle, and the rate of the wind-up at
    rest is left out. That misses a motor's jerk by 1 to 2 % of its limit; rows are tightened by it
    (`transcription.constraint_back_off`). Exact derivatives cost three times as much an iteration.
    """

    @cached_property
    def velocity(self) -> Quantity:
        """Of the motors, nearly (n,) [rad/s]."""
        return self.link[1] + self._lead[0] + self._room * self._lead[0]

    @cached_property
    def acceleration(self) -> Quantity:
        """Of the motors, nearly (n,) [rad/s^2]."""
        return self.link[2] + self._lead[1] + self._room * self._lead[1]

    @cached_property
    def jerk(self) -> Quantity:
        """Of the motors, nearly (n,) [rad/s^3]."""
        return self._derivatives[3] + self._lead[2] + self._room * self._lead[2]

    @cached_property
    def deviation_rate(self) -> Quantity:
        """How fast the tool's deviation changes by that of the wind-up, nearly (3,) [m/s]."""
        return ca.mtimes(self.jacobian, self._lead[0])

    @property
    def computed_torques(self) -> Quantity:
        """Torques of gravity and motion and the spring torques' rates, as far as asked for."""
        parts = [super().computed_torques]
        if "_torque_rates" in self.__dict__:
            parts += self._torque_rates
        return ca.vertcat(*parts)

    @cached_property
    def _torque_rates(self) -> list[Quantity]:
        """First three rates of the spring torques (n,), nearly."""
        q, v, a, *along = self._derivatives
        torque = self.torques.spring
        first = ca.jtimes(torque, ca.vertcat(q, v, a), ca.vertcat(v, a, along[0]))
        inertia = ca.jacobian(self.torques.motion, a)
        return [first, *(ca.mtimes(inertia, each) for each in along[1:])]

    @cached_property
    def _lead(self) -> list[Quantity]:
        """First three rates of the wind-up by which the motors are ahead, (n,) each."""
        first, second, third = self._torque_rates
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


def law_smoothing(problem: TrajectoryProblem) -> float:
    """Factor on the smoothing widths of the law by which the motors lead a problem's links."""
    return WINDUP_SMOOTHING[-1] * (WIDER if problem.plans_links else 1.0)


def rounded_lag(lag: np.ndarray) -> np.ndarray:
    """Lags as `MotorLaw` takes them [s]: alike, or well apart."""
    return np.asarray(_LAGS * np.round(lag / _LAGS))


class MotorLaw:
    """Motors that lead the links of a robot, as a formula prepared for many motions.

    Parameters
    ----------
    robot : Robot
    process_force : array_like (3,)
        Acts on the tool all the time, base axes [N].
    """

    def __init__(self, robot: Robot, process_force: object = (0.0, 0.0, 0.0)) -> None:
        n = robot.n
        motion, torque = [ca.SX.sym(f"d{k}", n) for k in range(3)], ca.SX.sym("torque", n)
        smoothing = ca.SX.sym("smoothing")
        model = MotorModel(robot, motion, smoothing, np.zeros(n), process_force, 1.0)
        # What acts on the springs does not depend on how wide corners are: most of the cost, once.
        self._spring = _law(motion, model.torques.spring)
        # All that motors need of it; each further rate costs twice the one before.
        self._held = _law(motion[:1], model.torques.held)
        self._windup = _law([torque], model.windup_of_motors(torque), smoothing)
        self._last: tuple[Trajectory, np.ndarray, np.ndarray, np.ndarray] | None = None

    def motion(
        self,
        link: Trajectory,
        smoothing: float,
        lag: np.ndarray | None = None,
        *,
        sagged: bool = False,
    ) -> Trajectory:
        """Motion of the motors that makes the links move as given.

        Parameters
        ----------
        link : Trajectory
            With five derivatives.
        smoothing : float
            Factor on the law's smoothing widths: corners would ask for jumps of the speed.
        lag : array (n,), optional
            Of each joint's wind-up behind its spring torque [s]: its damping over its stiffness.
            The motors arrive so much later than the links, which have to be at rest then.
        sagged : bool
            The springs carry the links where they hang, at p = q - phi(tau(p, 0, 0)) and moving as
            p does, in place of where they are planned. Their weight differs there, and the motion
            of the sag has its own acceleration.
        """
        moves = _sampled(link)
        if sagged:
            plan = np.stack([link(moves, k) for k in range(6)])
            place = self._hanging(link, moves, plan, smoothing)
            spring = _of(self._spring, place)
        else:
            plan, spring, weight = self._torques(link, moves)
            place = plan[:4] - _of(self._windup, weight, smoothing)
        lead = _of(self._windup, spring, smoothing)
        if lag is None:
            return Trajectory.through(moves, place[:4] + lead, link)
        # The wind-up as a motion of its own, which begins and ends later than the rest.
        windup = Trajectory.through(moves, lead, link)
        hanging = Trajectory.through(moves, place[:4], link)
        held = link.held_for(float(np.max(lag)))
        # Where a wind-up begins and ends, its third rate jumps: intervals have either side of it.
        times = np.union1d(_sampled(held), np.concatenate([lag, link.duration + np.asarray(lag)]))
        times = times[np.concatenate([[True], np.diff(times) > _SLACK])]
        sides = []
        for at, beside in ((times, _SLACK), (times[1:], -_SLACK)):
            motors = _late(hanging, at, beside)
            for own in np.unique(lag):
                joints = lag == own
                motors[:, :, joints] += _late(windup, at - own, beside)[:, :, joints]
            sides.append(motors)
        return Trajectory.through(times, sides[0], held, sides[1])

    def _torques(
        self, link: Trajectory, moves: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The links' plan (6, K, n), torques of springs and at rest with three rates (4, K, n).

        Those of the last plan are kept: it is tried with corners of several widths.
        """
        if self._last is None or self._last[0] is not link:
            plan = np.stack([link(moves, k) for k in range(6)])
            self._last = link, plan, _of(self._spring, plan), _of(self._held, plan[:4])
        return self._last[1:]

    def _hanging(
        self, link: Trajectory, moves: np.ndarray, plan: np.ndarray, smoothing: float
    ) -> np.ndarray:
        """Where links hang under their own weight there, with five derivatives (6, K, n)."""
        place, sag = plan[:4], np.zeros_like(plan[:4])
        # The sag changes little with itself.
        for _ in range(_ROUNDS):
            before, sag = sag, _of(self._windup, _of(self._held, place), smoothing)
            place = plan[:4] - sag
            if np.max(np.abs(sag[0] - before[0])) < _SETTLED:
                break
        # Between two instants it is a polynomial of degree 7: formulas for two further rates would
        # be fifteen times as long.
        along = Trajectory.through(moves, sag, link)
        return np.concatenate([place, plan[4:] - np.stack([along(moves, k) for k in (4, 5)])])


def _rate(value: Quantity, along: Sequence[Quantity], orders: int) -> Quantity:
    """Derivative by time of a value that depends on so many of a motion's derivatives."""
    return ca.jtimes(value, ca.vertcat(*along[:orders]), ca.vertcat(*along[1 : orders + 1]))


def _law(given: list[Quantity], value: Quantity, *numbers: Quantity) -> PointFunction:
    """A value and its first three rates, for many instants and of numbers alike at all of them.

    Given is what it depends on: something that moves, its first derivative and so on.
    """
    n, orders, empty = value.numel(), len(given), ca.SX(0, 1)
    inputs: list[Quantity] = [ca.vertcat(*given), empty, empty, ca.vertcat(empty, *numbers)]

    def rates(known: Quantity, found: Quantity) -> tuple[Quantity, Quantity]:
        along = [*ca.vertsplit(known, n), *(ca.SX.sym(f"r{k}", n) for k in range(3))]
        values = [found]
        for k in range(3):
            values.append(_rate(values[-1], along, orders + k))
        # Nothing is computed twice.
        return ca.vertcat(*along), ca.vertcat(*ca.cse(values))

    return PointFunction(ca.Function("law", inputs, [value]), rates)


def _of(law: PointFunction, rates: np.ndarray, *numbers: float) -> np.ndarray:
    """A law's values (m, K, n) along what has so many rates (k, K, n), and of further numbers."""
    orders, count, n = rates.shape
    values = law(rates.swapaxes(0, 1).reshape(count, orders * n).T, np.array(numbers))
    return values.reshape(-1, n, count).swapaxes(1, 2)


def _sampled(motion: Trajectory) -> np.ndarray:
    """Times between which a polynomial of degree 7 is as good as what leads a motion."""
    begins, ends = motion.times[:-1], motion.times[1:]
    counts = np.maximum(np.ceil((ends - begins) / _STEP).astype(int), _LEAST)
    inside = [np.linspace(*each, endpoint=False) for each in zip(begins, ends, counts, strict=True)]
    return np.append(np.concatenate(inside), motion.duration)


def _late(motion: Trajectory, at: np.ndarray, beside: float) -> np.ndarray:
    """A motion and its first three rates (4, K, n) just `beside` times; at rest around it."""
    inside = np.clip(at, 0.0, motion.duration)
    values = np.stack([motion(inside, k) for k in range(4)])
    values[1:, (at + beside < 0.0) | (at + beside > motion.duration)] = 0.0
    return values
