"""Tool error of the commanded arm as smooth functions of the links' state, for the optimiser.

Where the command leads the nominal arm exactly, the error left on an arm with other parameters is
that of the parameters alone (`elastic.led_error`). In flight it is quasi-static: a joint
whose stiffness is off by a share misses by that share of its dynamic wind-up (at a kink of a
reducer by more or less, and with many local optima), the payload by the
wind-up under its own inertia, an output bearing by that share of its deflection beyond that at
rest, the servo by its lag, a multiple of speed and acceleration. What
rings is the content of the torques at the elastic modes. Three integrations by parts turn it into
that of their third rate, whose spectrum is taken as flat up to the mode:

    |integral f exp(i w t) dt|^2 = |integral f''' exp(i w t) dt|^2 / w^6
                                 ~ pi/w integral f'''^2 dt / w^6.

That counts the content about a mode rather than at it, as the mode is uncertain too.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
import scipy

from stiffopt.dynamics.bearings import dynamic_bearing_displacements
from stiffopt.elastic.servo import Servo
from stiffopt.problem.stage_terms import squared_length

if TYPE_CHECKING:
    from stiffopt.elastic.uncertainty import Uncertainty
    from stiffopt.problem.motor_model import MotorModel
    from stiffopt.symbolic import Quantity

# Least ringing of a joint by the third rate of its acceleration, over that of the worst one: wrist
# joints hardly ring, and would use up their jerk for nothing.
_MIN_RINGING_SHARE = 0.1
# Rate about which the servo's response is expanded [1/s]: slow beside any bandwidth.
_SLOW_RATE = 1e-2
# Speed of the tool below which its path has hardly a direction [m/s]: with a tenth of it corners
# that are passed slowly leave the solver at its looser tolerance.
_REST_SPEED = 0.1


class CommandedError:
    """Errors of one stage model with each parameter at its bound.

    `model`: with its rest poses. `servo`: nominal one, whose lag the command leads.
    """

    def __init__(self, model: MotorModel, uncertainty: Uncertainty, servo: Servo) -> None:
        self._model, self._uncertainty, self._servo = model, uncertainty, servo
        self._bounds = uncertainty.shares(model.robot.n)

    @property
    def quasi_static(self) -> Quantity:
        """Sum of the squared quasi-static errors of all parameters but the servo's [m^2]."""
        return sum(squared_length(each) for each in self._quasi_static_errors)

    @property
    def lateness(self) -> Quantity:
        """Squared error of the worst servo [m^2]."""
        return squared_length(self._late)

    @property
    def quasi_static_across(self) -> Quantity:
        """Sum of the squared quasi-static errors across the tool's path [m^2]."""
        return sum(self._square_across(each) for each in self._quasi_static_errors)

    @property
    def lateness_across(self) -> Quantity:
        """Squared error of the worst servo across the tool's path [m^2]."""
        return self._square_across(self._late)

    @cached_property
    def _quasi_static_errors(self) -> list[Quantity]:
        """Quasi-static errors of the tool (3,) by each parameter but the servo's [m]."""
        model, joints = self._model, range(self._model.robot.n)
        found = [self._at_tool({j: self._bounds[j] * model.dynamic_windup[j]}) for j in joints]
        bearings = dynamic_bearing_displacements(model.robot, *model.link)
        found += [self._uncertainty.bearing_stiffness * away[:3] for away in bearings.values()]
        if model.robot.payload is not None:
            compliance = np.mean([_compliance(model, pose) for pose in model.rest_poses], axis=0)
            load = model.payload_torque
            found.append(
                self._at_tool(
                    {j: self._uncertainty.payload * compliance[j] * load[j] for j in joints}
                )
            )
        return found

    @cached_property
    def _late(self) -> Quantity:
        """Error of the tool (3,) by the worst servo [m]."""
        return self._at_tool(dict(enumerate(self._servo_lag)))

    def _at_tool(self, angles: dict[int, Quantity]) -> Quantity:
        """Return the displacement of the tool (3,) by angles of joints [rad]."""
        jacobian = self._model.jacobian
        return ca.vertcat(
            *(sum(jacobian[i, j] * angle for j, angle in angles.items()) for i in range(3))
        )

    def _square_across(self, error: Quantity) -> Quantity:
        """Return the square of an error (3,) across the tool's path; zero where the tool rests."""
        speed = self._at_tool(dict(enumerate(ca.vertsplit(self._model.link[1]))))
        square = squared_length(speed) + _REST_SPEED**2
        return squared_length(ca.cross(error, speed)) / square

    @property
    def ringing_rate(self) -> Quantity:
        """Rate whose integral is the summed squared ringing of all parameters [m^2/s]."""
        third = self._model.torque_rates[2]
        return sum((gain * third[j]) ** 2 for j, gain in enumerate(self._ringing_gains))

    @property
    def _servo_lag(self) -> list[Quantity]:
        """Motors' error with the worst servo, to the second rate of the links' motion [rad]."""
        unsure, s = self._uncertainty, np.array([1j * _SLOW_RATE])
        worst, led = unsure.worst_servo(self._servo), unsure.led_servo(self._servo)
        late = complex((worst.transfer(s) / led.transfer(s))[0]) - 1.0
        first, second = late.imag / _SLOW_RATE, -late.real / _SLOW_RATE**2
        _, v, a = self._model.link
        return [first * v[j] + second * a[j] for j in range(self._model.robot.n)]

    @property
    def _ringing_gains(self) -> np.ndarray:
        """Ringing of the tool (n,) over the root of the integral of a torque's squared third rate.

        Of each joint's stiffness at its bound, as root mean square of the rest poses.
        """
        model, n = self._model, self._model.robot.n
        bodies, squares, inertias = model.robot.rigid_bodies(), np.zeros(n), np.zeros(n)
        for pose in model.rest_poses:
            compliance = _compliance(model, pose)
            free, inertia = np.flatnonzero(compliance > 0.0), bodies.inertia_matrix(pose)
            rates, shapes = scipy.linalg.eigh(
                np.diag(1.0 / compliance[free]), inertia[np.ix_(free, free)]
            )
            tool = np.sum((bodies.jacobian(model.robot.tool, pose)[:3, free] @ shapes) ** 2, axis=0)
            squares[free] += np.pi * shapes**2 @ (tool / np.sqrt(rates) ** 9)
            inertias += np.diag(inertia)
        gains = self._bounds * np.sqrt(squares / len(model.rest_poses))
        inertias /= len(model.rest_poses)
        least = _MIN_RINGING_SHARE * np.max(gains * inertias)
        return np.asarray(np.maximum(gains, least / inertias))


def _compliance(model: MotorModel, pose: np.ndarray) -> np.ndarray:
    """Tangent compliance of the joints (n,) [rad/(N m)] at rest in a pose (n,); 0 if rigid."""
    weight = model.robot.rigid_bodies().gravity_torque(pose)
    return np.array(
        [
            0.0 if chain is None else float(chain.tangent_compliance(float(weight[j])))
            for j, chain in enumerate(model.chains)
        ]
    )
