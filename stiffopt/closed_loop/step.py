"""One step of the equation of motion of a loop, with dry friction, in symbols.

The integrator is the linearly implicit two-stage method ROS2 of Verwer et al. (1999), which is of
second order for any approximation of the Jacobian and L-stable: stiff gains on light links need no
shorter steps. Its Jacobian here holds the actuators and viscous friction alone. Dry friction is a
constant share of its level over the step: that which the linear response of the step asks for, and
a step of Newton's method about it. Only the latter is derived by: by the theorem of implicit
functions its derivative is that of the friction.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from stiffopt.closed_loop.balance import Balance
from stiffopt.closed_loop.dry_friction import (
    friction_error,
    friction_share,
    friction_torque,
    mean_friction,
)
from stiffopt.closed_loop.physics import factorize, solve

_STAGE_WEIGHT = 1.0 + 1.0 / np.sqrt(2.0)

# Changes of places and of speeds.
_Changes = tuple[ca.SX, ca.SX]


@dataclass(frozen=True, eq=False)
class LoopStep:
    """Places and speeds after a step, of symbols that are not derived by, and what these are."""

    place: ca.SX
    speed: ca.SX
    held: ca.SX
    values: ca.SX


def take_step(
    balance: Callable[[ca.SX, ca.SX], Balance], place: ca.SX, speed: ca.SX, h: ca.SX
) -> LoopStep:
    """Return the step `h` from some places and speeds."""
    here = balance(place, speed)
    (force, damping), rates, slopes = here.force, here.rates, here.slopes
    n, size = here.n, place.shape[0]
    shift = _STAGE_WEIGHT * h
    implicit = here.factorize(here.mass + shift * damping + shift**2 * ca.mtimes(slopes, rates))

    def stage(rate: ca.SX, right: ca.SX) -> _Changes:
        """Solve (1 - gamma h J) k = (rate, right / mass)."""
        second = solve(implicit, right - shift * ca.mtimes(slopes, rate))
        return rate + shift * ca.mtimes(rates, second), second

    def combine(first: _Changes, second: _Changes) -> _Changes:
        moved, gained = (h * (1.5 * a + 0.5 * b) for a, b in zip(first, second, strict=True))
        return moved, gained

    def respond(rate: ca.SX, right: ca.SX) -> _Changes:
        """Return the changes by rates and forces as far as the Jacobian goes."""
        first = stage(rate, right)
        change = h * (ca.mtimes(damping, first[1]) + ca.mtimes(slopes, first[0]))
        return combine(
            first,
            stage(
                rate + h * ca.mtimes(rates, first[1]) - 2.0 * first[0],
                right - change - 2.0 * ca.mtimes(here.mass, first[1]),
            ),
        )

    motors, before, creep = ca.SX(here.of_motor), here.motor_speed, here.own["creep"]
    response = ca.vertcat(*respond(ca.SX(size, n), -motors))
    mobility = -ca.mtimes(motors.T, response[size:, :])
    share = ca.SX.sym("share", n)
    correction = ca.SX.sym("correction", *response.shape)

    # What is not derived by.
    levels = here.friction_levels(ca.sign(before))
    free = before + ca.mtimes(motors.T, respond(ca.mtimes(rates, speed), force)[1])
    friction = mean_friction(before, free, mobility, levels, creep)
    matrix, _ = friction_error(
        before, free - ca.mtimes(mobility, friction), friction, mobility, levels, creep
    )
    values = (
        friction_share(friction, before, levels),
        solve(factorize(matrix.T, symmetric=False), response.T).T,
    )

    levels = here.friction_levels(share)
    friction = friction_torque(share, levels)
    first = stage(ca.mtimes(rates, speed), force - ca.mtimes(motors, friction))
    ahead = balance(place + h * first[0], speed + h * first[1])
    acceleration = ahead.acceleration(friction_torque(share, ahead.friction_levels(share)))
    second = stage(
        ca.mtimes(ahead.rates, ahead.speed) - 2.0 * first[0],
        ca.mtimes(here.mass, acceleration - 2.0 * first[1]),
    )
    moved, gained = combine(first, second)
    after = before + ca.mtimes(motors.T, gained)
    _, error = friction_error(before, after, friction, mobility, levels, creep)
    more = -ca.mtimes(correction, error)
    held = ca.vertcat(share, ca.vec(correction))
    return LoopStep(
        place=place + moved + more[:size],
        speed=speed + gained + more[size:],
        held=held,
        values=ca.vertcat(*(ca.vec(each) for each in values)),
    )
