"""Closed loop of an arm and its actuators as one step of an integrator, with exact derivatives.

The integrator is the linearly implicit two-stage method ROS2 of Verwer et al. (1999), which is of
second order for any approximation of the Jacobian and L-stable: stiff gains on light links need no
shorter steps. Its Jacobian here holds the actuators and viscous friction alone. Dry friction is a
torque of the whole step, which `mean_friction` solves by the response of the step to it.
"""

from __future__ import annotations

from functools import cached_property, partial

import casadi as ca
import numpy as np

from stiffopt import native
from stiffopt.actuator.law import ActuatorLaw
from stiffopt.closed_loop.balance import Balance
from stiffopt.closed_loop.dry_friction import friction_torque, mean_friction, sliding_share
from stiffopt.closed_loop.factors import solve
from stiffopt.closed_loop.parameters import BODY_PARAMETERS, JOINT_PARAMETERS
from stiffopt.closed_loop.physics import LoopPhysics
from stiffopt.dynamics.newton_euler import own_bodies, torque_of_bodies
from stiffopt.interpreter.batched import read_batch
from stiffopt.robot.body_tree import BodyTree

# Inputs of a step that all lanes share: parameters.
_SHARED_INPUTS = (2,)
_STAGE_WEIGHT = 1.0 + 1.0 / np.sqrt(2.0)


class CommandedArm:
    """Arm with actuators that follow commands.

    Parameters
    ----------
    tree : BodyTree
    law : ActuatorLaw
        In the joint order of the tree; unknown gains count as none.
    middle : array (n,)
        Positions about which dry friction changes [rad].
    physics : LoopPhysics, optional
        Beyond rigid bodies, friction and rotors.

    Notes
    -----
    The state holds readings and their speeds (n,) each, then for every elastic joint the torque of
    its spring and the speed of the side that the encoder does not read.
    """

    def __init__(
        self,
        tree: BodyTree,
        law: ActuatorLaw,
        middle: np.ndarray,
        physics: LoopPhysics | None = None,
    ) -> None:
        self.tree, self.law, self.middle = tree, law, np.asarray(middle, dtype=float)
        self.physics = physics or LoopPhysics()
        self.n, self.elastic = tree.n, sorted(self.physics.springs)
        # Places of the speeds of links and motors among those of readings and other sides.
        self.link_sides, self.motor_sides = np.arange(self.n), np.arange(self.n)
        for k, joint in enumerate(self.elastic):
            at_output = self.physics.springs[joint].encoder_at_output
            (self.motor_sides if at_output else self.link_sides)[joint] = self.n + k
        self._steps: dict[bytes, tuple[ca.Function, ca.Function]] = {}
        self._lanes: dict[tuple[bytes, int], ca.Function] = {}

    @property
    def size(self) -> int:
        """Number of states."""
        return 2 * (self.n + len(self.elastic))

    def begin(self, position: np.ndarray, velocity: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return the state with these readings and speeds (n,), in which springs carry the weight.

        `values` (p,) are the parameters.
        """
        if not self.elastic:
            return np.concatenate([position, velocity])
        weight = np.asarray(self._weight(position, values))[:, 0]
        return np.concatenate(
            [position, velocity, weight[self.elastic], np.asarray(velocity)[self.elastic]]
        )

    @cached_property
    def _weight(self) -> ca.Function:
        """Return the torques (n,) at rest, of readings and parameters."""
        q, parameters = ca.SX.sym("q", self.n), ca.SX.sym("p", self._parameter_count)
        own, bodies = self._split(parameters)
        still = ca.SX.zeros(self.n)
        found = torque_of_bodies(
            self.tree, self.tree.gravity, q - own["zero"], still, still, *bodies
        )
        return ca.Function("weight", [q, parameters], [ca.densify(found)])

    def step_function(self, free: np.ndarray) -> ca.Function:
        """Return one step with derivatives by some parameters (indices), and by the delay.

        (state and sensitivities (size (1 + m),), command and its slope (2 n,), parameters, step) ->
        the same state after the step. The last sensitivity is that by the delay.
        """
        return self._both_steps(free)[0]

    def lanes(self, free: np.ndarray, count: int) -> tuple[int, ca.Function]:
        """Return a number of lanes and `count` steps of all of them, side by side.

        States, commands and steps of the lanes are columns, those of a step together; parameters
        are the same in all lanes.
        """
        step, key = self._both_steps(free)[1], (free.tobytes(), count)
        if key not in self._lanes:
            self._lanes[key] = step.mapaccum(count)
        return int(step.size2_in(0)), self._lanes[key]

    def _both_steps(self, free: np.ndarray) -> tuple[ca.Function, ca.Function]:
        """Return a step of one lane, and of as many as the compiled core has."""
        key = free.tobytes()
        if key not in self._steps:
            step, path = self._build_step(free), native.library()
            several = None if path is None else read_batch(step, _SHARED_INPUTS).load(path)
            self._steps[key] = step, several or step
        return self._steps[key]

    def _build_step(self, free: np.ndarray) -> ca.Function:
        state, command, parameters, h, following = self._symbols()
        n, m = self.n, len(free)
        sensitivity, slope = ca.SX.sym("S", self.size, m + 1), ca.SX.sym("slope", n)
        by_state, by_command = (ca.jacobian(following, each) for each in (state, command))
        by_parameter = ca.densify(ca.jacobian(following, parameters))
        late = list(JOINT_PARAMETERS).index("lateness") * n
        by_parameter[:, late : late + n] = ca.mtimes(by_command, ca.diag(slope))
        after = ca.mtimes(by_state, sensitivity) + ca.horzcat(
            by_parameter[:, [int(k) for k in free]], ca.mtimes(by_command, slope)
        )
        return ca.Function(
            "step",
            [
                ca.vertcat(state, ca.vec(sensitivity)),
                ca.vertcat(command, slope),
                parameters,
                h,
            ],
            [ca.densify(ca.vertcat(following, ca.vec(after)))],
        )

    @property
    def _parameter_count(self) -> int:
        own = (len(JOINT_PARAMETERS) + len(BODY_PARAMETERS)) * self.n
        return own + self.physics.amplitudes.symbols.numel() + 1

    def _split(self, parameters: ca.SX) -> tuple[dict[str, ca.SX], tuple[ca.SX, ...]]:
        """Return the parameters of joints (n,) by name, and the bodies."""
        n, joints = self.n, len(JOINT_PARAMETERS) * self.n
        bodies = joints + len(BODY_PARAMETERS) * n
        columns = ca.horzsplit(ca.reshape(parameters[:joints], n, -1))
        own = dict(zip(JOINT_PARAMETERS, columns, strict=True))
        return own, self._bodies(parameters[joints:bodies])

    def _symbols(self) -> tuple[ca.SX, ...]:
        """Return one step of ROS2 in symbols, and what it depends on.

        State (2 n,), command (n,), parameters (p,), step and next state.
        """
        n, elastic = self.n, len(self.elastic)
        state, command = ca.SX.sym("x", self.size), ca.SX.sym("u", n)
        parameters, h = ca.SX.sym("p", self._parameter_count), ca.SX.sym("h")
        balance = partial(Balance, self, *self._split(parameters), command)
        reading, rate, load, other = ca.vertsplit(
            state, [0, n, 2 * n, 2 * n + elastic, 2 * (n + elastic)]
        )
        place, speed = ca.vertcat(reading, load), ca.vertcat(rate, other)
        here = balance(place, speed)
        (force, slope), rates, slopes = here.force, here.rates, here.slopes
        # Negative slopes stay explicit.
        shift = _STAGE_WEIGHT * h
        implicit = here.factorize(
            here.mass + ca.diag(shift * ca.fmax(slope, 0)) + shift**2 * ca.mtimes(slopes, rates)
        )

        def stage(rate: ca.SX, right: ca.SX) -> tuple[ca.SX, ca.SX]:
            """Solve (1 - gamma h J) k = (rate, right / mass)."""
            second = solve(implicit, right - shift * ca.mtimes(slopes, rate))
            return rate + shift * ca.mtimes(rates, second), second

        def combine(first: tuple[ca.SX, ca.SX], second: tuple[ca.SX, ca.SX]) -> list[ca.SX]:
            """Return the changes of places and speeds over the step."""
            return [h * (1.5 * one + 0.5 * two) for one, two in zip(first, second, strict=True)]

        # Response of the step to friction of each motor.
        motors = here.of_motor
        first = stage(ca.SX(*motors.shape), -motors)
        change = -motors - h * (ca.mtimes(ca.diag(slope), first[1]) + ca.mtimes(slopes, first[0]))
        second = stage(
            h * ca.mtimes(rates, first[1]) - 2.0 * first[0],
            change - 2.0 * ca.mtimes(here.mass, first[1]),
        )
        of_place, of_speed = combine(first, second)
        mobility = -ca.mtimes(motors.T, of_speed)
        stopping = 1.0 / ca.diag(mobility)

        levels = here.friction_levels(stopping)
        share = sliding_share(here.motor_speed, stopping, levels)
        friction = friction_torque(share, levels)
        first = stage(ca.mtimes(rates, speed), force - ca.mtimes(motors, friction))
        ahead = balance(place + h * first[0], speed + h * first[1])
        acceleration = ahead.acceleration(
            friction_torque(share, ahead.friction_levels(stopping, share))
        )
        second = stage(
            ca.mtimes(ahead.rates, ahead.speed) - 2.0 * first[0],
            ca.mtimes(here.mass, acceleration - 2.0 * first[1]),
        )
        moved, gained = combine(first, second)
        found = mean_friction(
            here.motor_speed,
            here.motor_speed + ca.mtimes(motors.T, gained),
            friction,
            mobility,
            levels,
        )
        more = found - friction
        q, s = ca.vertsplit(place + moved + ca.mtimes(of_place, more), [0, n, n + elastic])
        v, w = ca.vertsplit(speed + gained + ca.mtimes(of_speed, more), [0, n, n + elastic])
        unknown = self.physics.amplitudes.symbols
        places = slice(self._parameter_count - 1 - unknown.numel(), self._parameter_count - 1)
        (after,) = ca.substitute([ca.vertcat(q, v, s, w)], [unknown], [parameters[places]])
        return state, command, parameters, h, after

    def _bodies(self, changes: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return masses, first moments and inertias with changes (7 n,), body by body."""
        n = self.n
        each = ca.reshape(changes, len(BODY_PARAMETERS), n)
        mass, first, inertia = own_bodies(self.tree)
        factor = 1.0 + each[0, :]
        about = ca.horzcat(*(ca.diag(each[4:, i]) for i in range(n)))
        return (
            mass * factor.T,
            first * ca.repmat(factor, 3, 1) + each[1:4, :],
            inertia * ca.kron(factor, ca.DM.ones(3, 3)) + about,
        )
