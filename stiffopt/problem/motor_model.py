"""Motion of the motors that makes the links of an elastic arm move as planned.

An arm with elastic joints is flat in the motion of its links: a link motion q(t) needs the spring
torques tau = ID(q, v, a), these the wind-ups phi(tau), and so the motors must be at q + phi(tau).
Planned poses hold at rest, where gravity's wind-up is calibrated away: the motors' plan is

    theta = q + phi(tau(q, v, a)) - phi(tau(q, 0, 0)).

Its derivatives follow by the chain rule; the motors' jerk holds the fifth derivative of q. Damping
of the joints would add 2 zeta / omega times the wind-up's rate (zeta the damping ratio, omega the
mode's angular frequency), 1 to 2 % of the wind-up, and is left out.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from stiffopt.problem.stage_model import StageModel
from stiffopt.result.trajectory import Trajectory
from stiffopt.symbolic import Quantity

if TYPE_CHECKING:
    from stiffopt.robot.robot import Robot

# Distance of the samples of the motors' motion [s], and their least number in an interval of the
# links': between them a polynomial of degree 7 is as good as exact.
_STEP = 2.5e-3
_LEAST = 4


class MotorModel(StageModel):
    """Stage model of a motion planned for the links: position to jerk are those of the motors.

    For the optimiser the torques' rates are those of the links' inertia times the links' jerk,
    snap and crackle at the present tangent compliance. What they leave out, the change of inertia,
    compliance and velocity torques within a rise of the acceleration, the certificate sees, and
    limits are tightened by it. Exact derivatives cost several times as much an iteration.

    Parameters
    ----------
    robot : Robot
    derivatives : list of SX (n,)
        Of the links: position, velocity, and so on up to the fifth.
    smoothing : SX or float
        Factor on every smoothing width of the stiffness model.
    sides : array (n,)
        As for `StageModel`.
    process_force : array_like (3,)
        Acts on the tool all the time, base axes [N].
    """

    def __init__(
        self,
        robot: Robot,
        derivatives: list[Quantity],
        smoothing: Quantity,
        sides: np.ndarray,
        process_force: object = (0.0, 0.0, 0.0),
    ) -> None:
        self.robot, self.smoothing, self.sides = robot, smoothing, sides
        self.process_force = np.asarray(process_force, dtype=float)
        self._derivatives = derivatives

    @property
    def link(self) -> tuple[Quantity, Quantity, Quantity]:
        """The links' own motion."""
        q, v, a = self._derivatives[:3]
        return q, v, a

    @cached_property
    def position(self) -> Quantity:
        """Of the motors (n,) [rad]."""
        torques = self.torques
        if not self.process_force.any():
            return self.link[0] + self.windup(torques.motion) - self.windup(torques.gravity)
        held = torques.gravity + torques.spring - torques.motion
        return self.link[0] + self.windup(torques.spring) - self.windup(held)

    @cached_property
    def velocity(self) -> Quantity:
        """Of the motors, nearly (n,) [rad/s]."""
        return self._ahead(1)

    @cached_property
    def acceleration(self) -> Quantity:
        """Of the motors, nearly (n,) [rad/s^2]."""
        return self._ahead(2)

    @cached_property
    def jerk(self) -> Quantity:
        """Of the motors, nearly (n,) [rad/s^3]."""
        return self._ahead(3)

    @cached_property
    def _softness(self) -> Quantity:
        """Wind-up by a change of the links' acceleration (n, n) [s^2]."""
        inertia = ca.jacobian(self.torques.motion, self.link[2])
        compliance = [
            0.0 if chain is None else self.compliance(j) for j, chain in enumerate(self.chains, 1)
        ]
        return ca.mtimes(ca.diag(ca.vertcat(*compliance)), inertia)

    def _ahead(self, order: int) -> Quantity:
        along = self._derivatives
        return along[order] + ca.mtimes(self._softness, along[order + 2])

    def exact_derivatives(self) -> list[Quantity]:
        """Position of the motors and its first three derivatives by time, each (n,)."""
        found, along = [self.position], self._derivatives
        for orders in range(3, 6):
            inputs, rates = ca.vertcat(*along[:orders]), ca.vertcat(*along[1 : orders + 1])
            found.append(ca.jtimes(found[-1], inputs, rates))
        return found


def motor_motion(
    robot: Robot, link: Trajectory, smoothing: float, process_force: object = (0.0, 0.0, 0.0)
) -> Trajectory:
    """Motion of the motors that makes the links move as given.

    Parameters
    ----------
    robot : Robot
    link : Trajectory
        At rest at both ends, with five derivatives.
    smoothing : float
        Factor on the smoothing widths: a law with corners would ask for jumps of the speed.
    process_force : array_like (3,)
        Acts on the tool all the time, base axes [N].
    """
    derivatives = [ca.SX.sym(f"d{k}", robot.n) for k in range(6)]
    model = MotorModel(robot, derivatives, smoothing, np.zeros(robot.n), process_force)
    outputs = [ca.densify(each) for each in model.exact_derivatives()]
    law = ca.Function("motors", derivatives, outputs)
    begins, ends = link.times[:-1], link.times[1:]
    counts = np.maximum(np.ceil((ends - begins) / _STEP).astype(int), _LEAST)
    parts = [np.linspace(*each, endpoint=False) for each in zip(begins, ends, counts, strict=True)]
    times = np.append(np.concatenate(parts), link.duration)
    found = law.map(len(times))(*(link(times, k).T for k in range(6)))
    return Trajectory.through(times, np.stack([each.full().T for each in found]), link)
