"""Closed loop of an arm and its actuators as one step of an integrator, with exact derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, partial

import casadi as ca
import numpy as np

from stiffopt import native
from stiffopt.actuator.law import ActuatorLaw
from stiffopt.closed_loop.balance import Balance
from stiffopt.closed_loop.parameters import BODY_PARAMETERS, JOINT_PARAMETERS
from stiffopt.closed_loop.physics import LoopPhysics
from stiffopt.closed_loop.step import take_step
from stiffopt.dynamics.newton_euler import own_bodies, torque_of_bodies
from stiffopt.interpreter.batched import read_batch
from stiffopt.robot.body_tree import BodyTree
from stiffopt.symbolic import BufferedFunction

# Inputs of a step that all lanes share: parameters.
_SHARED_INPUTS = (2,)


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
    its spring and the speed of the side that the encoder does not read, then the integral part over
    the gain of every joint whose controller integrates.
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
        self.integrating = np.flatnonzero(law.integral > 0.0).tolist()
        # Places of the speeds of links and motors among those of readings and other sides.
        self.link_sides, self.motor_sides = np.arange(self.n), np.arange(self.n)
        for k, joint in enumerate(self.elastic):
            at_output = self.physics.springs[joint].encoder_at_output
            (self.motor_sides if at_output else self.link_sides)[joint] = self.n + k
        self._steps: dict[bytes | None, tuple[ca.Function, ca.Function]] = {}
        self._lanes: dict[bytes | None, BufferedFunction] = {}

    @property
    def size(self) -> int:
        """Number of states."""
        return 2 * (self.n + len(self.elastic)) + len(self.integrating)

    def begin(
        self,
        position: np.ndarray,
        velocity: np.ndarray,
        values: np.ndarray,
        before: Sequence[np.ndarray],
        free: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the state with these readings and speeds (n,), in which springs carry the weight.

        And its slopes by some parameters (indices). `values` (p,) are the parameters. `before`
        (n,) each: readings and position errors at the beginning of the run, at which integral parts
        carry the weight, and the integral of the errors since.
        """
        if not (self.elastic or self.integrating):
            return np.concatenate([position, velocity]), np.zeros(())
        load, wound, slopes = map(np.asarray, self._carrying(position, *before, values))
        found = [position, velocity, load[:, 0], np.asarray(velocity)[self.elastic], wound[:, 0]]
        by_free = np.zeros((self.size, 0 if free is None else len(free)))
        if free is not None and self.integrating:
            by_free[-len(self.integrating) :] = slopes[:, free]
        return np.concatenate(found), by_free

    @cached_property
    def _carrying(self) -> ca.Function:
        """Return the torques of springs and the integral parts that carry the weight.

        Of the arguments of `begin`; with slopes of the latter by all parameters.
        """
        q, first, error, since = (ca.SX.sym(name, self.n) for name in ("q", "q0", "e0", "s"))
        parameters, still = ca.SX.sym("p", self._parameter_count), ca.SX.zeros(self.n)
        own, bodies = self._split(parameters)
        there, begun = (
            torque_of_bodies(self.tree, self.tree.gravity, x - own["zero"], still, still, *bodies)
            for x in (q, first)
        )
        gain = ca.DM(self.law.stiffness) * (1.0 + own["gain"])
        wound = (begun - own["offset"]) / gain - error + own["integral"] * since
        found = [_entries(there, self.elastic), _entries(wound, self.integrating)]
        found.append(ca.jacobian(found[1], parameters))
        return ca.Function("begin", [q, first, error, since, parameters], [*map(ca.densify, found)])

    def step_function(self, free: np.ndarray | None = None) -> ca.Function:
        """Return one step with derivatives by some parameters (indices) and the delay; or without.

        (state and sensitivities (size (1 + m),), command and its slope (2 n,), parameters, step) ->
        the same state after the step. The last sensitivity is that by the delay.
        """
        return self._both_steps(free)[0]

    def lanes(self, free: np.ndarray | None) -> tuple[int, BufferedFunction]:
        """Return a number of lanes and a step of all of them, side by side.

        States, commands and steps of the lanes follow one another; parameters are the same in all
        lanes.
        """
        step, key = self._both_steps(free)[1], _key(free)
        if key not in self._lanes:
            self._lanes[key] = BufferedFunction(step)
        return int(step.size2_in(0)), self._lanes[key]

    def _both_steps(self, free: np.ndarray | None) -> tuple[ca.Function, ca.Function]:
        """Return a step of one lane, and of as many as the compiled core has."""
        key = _key(free)
        if key not in self._steps:
            step, path = self._build_step(free), native.library()
            several = None if path is None else read_batch(step, _SHARED_INPUTS).load(path)
            self._steps[key] = step, several or step
        return self._steps[key]

    def _build_step(self, free: np.ndarray | None) -> ca.Function:
        state, command, parameters, h, following, held, values = self._symbols()
        slope = ca.SX.sym("slope", self.n)
        known = ca.vertcat(command, slope)
        if free is not None:
            sensitivity = ca.SX.sym("S", self.size, len(free) + 1)
            # Backward from few states: all derivatives together cost hardly more than one kind.
            whole = ca.jacobian(following, ca.vertcat(state, command, parameters))
            ends = np.cumsum([0, self.size, self.n, self._parameter_count]).tolist()
            by_state, by_command, by_parameter = ca.horzsplit(whole, ends)
            by_parameter = ca.densify(by_parameter)
            late = list(JOINT_PARAMETERS).index("lateness") * self.n
            by_parameter[:, late : late + self.n] = ca.mtimes(by_command, ca.diag(slope))
            after = ca.mtimes(by_state, sensitivity) + ca.horzcat(
                by_parameter[:, [int(k) for k in free]], ca.mtimes(by_command, slope)
            )
            state = ca.vertcat(state, ca.vec(sensitivity))
            following = ca.vertcat(following, ca.vec(after))
        (found,) = ca.substitute([following], [held], [values])
        return ca.Function("step", [state, known, parameters, h], [ca.densify(found)])

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
        """Return one step in symbols, and what it depends on.

        State (2 n,), command (n,), parameters (p,), step and next state; then symbols in this that
        are not derived by, and what they are.
        """
        n, elastic = self.n, len(self.elastic)
        state, command = ca.SX.sym("x", self.size), ca.SX.sym("u", n)
        parameters, h = ca.SX.sym("p", self._parameter_count), ca.SX.sym("h")
        own, bodies = self._split(parameters)
        reading, rate, load, other, wound = ca.vertsplit(
            state, [0, n, 2 * n, 2 * n + elastic, 2 * (n + elastic), self.size]
        )
        # An integral part acts like a change of the command; its mean over the step is explicit.
        growth, wanted = own["integral"] * (command - reading), ca.SX(command)
        for k, joint in enumerate(self.integrating):
            wanted[joint] += wound[k] + 0.5 * h * growth[joint]
        balance = partial(Balance, self, own, bodies, wanted)
        place, speed = ca.vertcat(reading, load), ca.vertcat(rate, other)
        step = take_step(balance, place, speed, h)
        q, s = ca.vertsplit(step.place, [0, n, n + elastic])
        v, w = ca.vertsplit(step.speed, [0, n, n + elastic])
        growth -= 0.5 * own["integral"] * (q - reading)
        wound += h * _entries(growth, self.integrating)
        after, values = ca.vertcat(q, v, s, w, wound), step.values
        unknown = self.physics.amplitudes.symbols
        if unknown.numel():
            places = slice(self._parameter_count - 1 - unknown.numel(), self._parameter_count - 1)
            after, values = ca.substitute([after, values], [unknown], [parameters[places]])
        return state, command, parameters, h, after, step.held, values

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


def _entries(vector: ca.SX, places: Sequence[int]) -> ca.SX:
    return ca.vertcat(ca.SX(0, 1), *(vector[k] for k in places))


def _key(free: np.ndarray | None) -> bytes | None:
    return None if free is None else free.tobytes()
