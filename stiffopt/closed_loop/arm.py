"""Closed loop of an arm and its actuators as one step of an integrator, with exact derivatives.

The integrator is the linearly implicit two-stage method ROS2 of Verwer et al. (1999), which is of
second order for any approximation of the Jacobian and L-stable: stiff gains and dry friction on
light links need no shorter steps. Its Jacobian here holds the actuators and friction alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from stiffopt import native
from stiffopt.actuator.law import ActuatorLaw
from stiffopt.closed_loop.parameters import BODY_PARAMETERS, JOINT_PARAMETERS
from stiffopt.dynamics.newton_euler import own_bodies, torque_of_bodies
from stiffopt.interpreter.batched import read_batch
from stiffopt.robot.body_tree import BodyTree

# Rounding of the magnitude of the torque that load friction goes with [N m].
_LOAD_WIDTH = 0.1
# Inputs of a step that all lanes share: parameters.
_SHARED_INPUTS = (2,)
_STAGE_WEIGHT = 1.0 + 1.0 / np.sqrt(2.0)


@dataclass(frozen=True, eq=False)
class LoopSymbols:
    """Symbols of one step: state (2 n,), command (n,), parameters (p,), width, step, next state.

    At the width, a speed [rad/s], dry friction reaches 76 % (tanh 1).
    """

    state: ca.SX
    command: ca.SX
    parameters: ca.SX
    width: ca.SX
    step: ca.SX
    next: ca.SX


LoopTorque = Callable[[ca.SX, ca.SX, ca.SX, ca.SX], ca.SX]


class CommandedArm:
    """Arm with actuators that follow commands.

    Parameters
    ----------
    tree : BodyTree
    law : ActuatorLaw
        In the joint order of the tree; unknown gains count as none.
    middle : array (n,)
        Positions about which dry friction changes [rad].
    added : callable, optional
        Torques that further physics takes, of reading, velocity, direction and actuator torque.
    """

    def __init__(
        self,
        tree: BodyTree,
        law: ActuatorLaw,
        middle: np.ndarray,
        added: LoopTorque | None = None,
    ) -> None:
        self.tree, self.law, self.middle = tree, law, np.asarray(middle, dtype=float)
        self.added = added
        self.n = tree.n
        self._steps: dict[bytes, tuple[ca.Function, ca.Function]] = {}
        self._lanes: dict[tuple[bytes, int], ca.Function] = {}

    def step_function(self, free: np.ndarray) -> ca.Function:
        """Return one step with derivatives by some parameters (indices), and by the delay.

        (state and sensitivities (2 n (1 + m),), command and its slope (2 n,), parameters and width
        of dry friction, step) -> the same state after the step. The last sensitivity is that by the
        delay.
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
        s = self._symbols()
        n, m = self.n, len(free)
        sensitivity, slope = ca.SX.sym("S", 2 * n, m + 1), ca.SX.sym("slope", n)
        by_state, by_command = ca.jacobian(s.next, s.state), ca.jacobian(s.next, s.command)
        by_parameter = ca.densify(ca.jacobian(s.next, s.parameters))[:, [int(k) for k in free]]
        after = ca.mtimes(by_state, sensitivity) + ca.horzcat(
            by_parameter, ca.mtimes(by_command, slope)
        )
        return ca.Function(
            "step",
            [
                ca.vertcat(s.state, ca.vec(sensitivity)),
                ca.vertcat(s.command, slope),
                ca.vertcat(s.parameters, s.width),
                s.step,
            ],
            [ca.densify(ca.vertcat(s.next, ca.vec(after)))],
        )

    def _symbols(self) -> LoopSymbols:
        """Return one step of ROS2 in symbols."""
        n = self.n
        count = (len(JOINT_PARAMETERS) + len(BODY_PARAMETERS)) * n + 1
        state, command = ca.SX.sym("x", 2 * n), ca.SX.sym("u", n)
        parameters, width, h = ca.SX.sym("p", count), ca.SX.sym("width"), ca.SX.sym("h")
        own = dict(
            zip(
                JOINT_PARAMETERS,
                ca.horzsplit(ca.reshape(parameters[: len(JOINT_PARAMETERS) * n], n, -1)),
                strict=True,
            )
        )
        bodies = self._bodies(parameters[len(JOINT_PARAMETERS) * n : count - 1])
        stiffness = np.where(np.isfinite(self.law.stiffness), self.law.stiffness, 0.0)
        kp = ca.DM(stiffness) * (1.0 + own["gain"])
        kd = ca.DM(self.law.damping) * (1.0 + own["damping"])

        def inertia(q: ca.SX) -> ca.SX:
            still, none = ca.SX.zeros(n), np.zeros(3)
            angle = q - own["zero"]
            columns = [
                torque_of_bodies(self.tree, none, angle, still, ca.SX(ca.DM.eye(n)[:, i]), *bodies)
                for i in range(n)
            ]
            return ca.horzcat(*columns) + ca.diag(own["armature"])

        def balance(q: ca.SX, v: ca.SX) -> tuple[ca.SX, ca.SX]:
            """Return torque that accelerates, and the slope of all losses by the velocity."""
            drive = _clip(kp * (command - q), self.law.drive_max)
            torque = _clip(drive - kd * v, self.law.torque_max)
            direction = ca.tanh(v / width)
            dry = (
                own["coulomb"]
                + own["friction_slope"] * (q - ca.DM(self.middle))
                + own["load_friction"] * (ca.sqrt(torque**2 + _LOAD_WIDTH**2) - _LOAD_WIDTH)
            )
            losses = dry * direction + own["viscous"] * v + own["drag"] * v * ca.fabs(v)
            bias = torque_of_bodies(
                self.tree, self.tree.gravity, q - own["zero"], v, ca.SX.zeros(n), *bodies
            )
            slope = kd + own["viscous"] + dry / width * (1.0 - direction**2)
            if self.added is not None:
                # Velocity and direction are one: both give the slope by which stages are stable.
                speed = ca.SX.sym("v", n)
                way = ca.tanh(speed / width)
                more = self.added(q, speed, way, torque)
                by_speed = ca.diag(ca.jacobian(more, speed))
                more, by_speed = ca.substitute([more, by_speed], [speed], [v])
                losses, slope = losses + more, slope + by_speed
            return torque + own["offset"] - losses - bias, slope

        q, v = state[:n], state[n:]
        mass, (torque, slope) = inertia(q), balance(q, v)
        # Negative slopes, as of dry friction that a fit drives below zero, stay explicit.
        implicit = _factorize(
            mass + ca.diag(_STAGE_WEIGHT * h * ca.fmax(slope, 0) + (_STAGE_WEIGHT * h) ** 2 * kp)
        )

        def stage(rate: ca.SX, force: ca.SX) -> tuple[ca.SX, ca.SX]:
            """Solve (1 - gamma h J) k = (rate, force / mass)."""
            second = _solve(implicit, force - _STAGE_WEIGHT * h * kp * rate)
            return rate + _STAGE_WEIGHT * h * second, second

        first = stage(v, torque)
        ahead_q, ahead_v = q + h * first[0], v + h * first[1]
        acceleration = _solve(_factorize(inertia(ahead_q)), balance(ahead_q, ahead_v)[0])
        second = stage(ahead_v - 2.0 * first[0], ca.mtimes(mass, acceleration - 2.0 * first[1]))
        after = state + h * (1.5 * ca.vertcat(*first) + 0.5 * ca.vertcat(*second))
        return LoopSymbols(state, command, parameters, width, h, after)

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


def _clip(value: ca.SX, largest: np.ndarray) -> ca.SX:
    """Return a value within plus and minus `largest`, untouched where that is infinite."""
    return ca.vertcat(
        *(
            ca.fmax(ca.fmin(value[i], most), -most) if np.isfinite(most) else value[i]
            for i, most in enumerate(largest)
        )
    )


def _factorize(matrix: ca.SX) -> list[list[ca.SX]]:
    """Return the Cholesky factor of a symmetric matrix (n, n) as scalar expressions."""
    n = matrix.shape[0]
    factor: list[list[ca.SX]] = [[ca.SX(0)] * n for _ in range(n)]
    for i in range(n):
        for j in range(i + 1):
            rest = matrix[i, j] - sum(factor[i][k] * factor[j][k] for k in range(j))
            factor[i][j] = ca.sqrt(rest) if i == j else rest / factor[j][j]
    return factor


def _solve(factor: list[list[ca.SX]], right: ca.SX) -> ca.SX:
    """Solve with a Cholesky factor."""
    n = len(factor)
    forward: list[ca.SX] = []
    for i in range(n):
        rest = right[i] - sum(factor[i][k] * forward[k] for k in range(i))
        forward.append(rest / factor[i][i])
    found: list[ca.SX] = [ca.SX(0)] * n
    for i in reversed(range(n)):
        rest = forward[i] - sum(factor[k][i] * found[k] for k in range(i + 1, n))
        found[i] = rest / factor[i][i]
    return ca.vertcat(*found)
