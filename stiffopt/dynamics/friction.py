"""Friction of the joints and the torque that the drives have to deliver."""

from __future__ import annotations

import casadi as ca
import numpy as np

from stiffopt.symbolic import Quantity

# Smoothing width of dry friction about standstill, as a share of the velocity limit: at 2 % of the
# limit the smooth law has 96 % of the sharp one, at 4 % 99.9 %.
DRY_FRICTION_WIDTH_SHARE = 0.01


def friction_torque(
    velocity: Quantity, *, coulomb: Quantity, viscous: Quantity, width: Quantity
) -> Quantity:
    """Return the friction torque of the drive [N m] or [N], with the sign of the velocity (..., n).

    `coulomb` (n,) is independent of the speed, `viscous` (n,) the slope with it. At the speed
    `width` (n,) the dry part reaches 76 % (tanh 1) of `coulomb`: the law is smooth at standstill,
    where the sharp law jumps.
    """
    return coulomb * np.tanh(velocity / width) + viscous * velocity


def dry_friction_width(velocity_max: Quantity) -> Quantity:
    """Return the smoothing width of dry friction (n,), 1 % of the velocity limit, else 0.01."""
    return DRY_FRICTION_WIDTH_SHARE * np.where(np.isfinite(velocity_max), velocity_max, 1.0)


def drive_torque(
    spring_torque: Quantity,
    velocity: Quantity,
    acceleration: Quantity,
    *,
    rotor_inertia: Quantity,
    coulomb: Quantity,
    viscous: Quantity,
    velocity_max: Quantity,
) -> Quantity:
    """Return the drive torque at the output side (..., n) [N m] or [N], which torque limits bound.

    The spring sits between drive and link, so that rotor inertia (reflected to the output) and
    friction load the drive but not the spring. Dry friction is smoothed within 1 % of
    `velocity_max`; where that is infinite, of 1 rad/s or 1 m/s.
    """
    width: Quantity = dry_friction_width(velocity_max)
    if isinstance(velocity, ca.SX | ca.MX):
        rotor_inertia, coulomb, viscous, width = (
            ca.DM(np.asarray(x, dtype=float)) for x in (rotor_inertia, coulomb, viscous, width)
        )
    friction = friction_torque(velocity, coulomb=coulomb, viscous=viscous, width=width)
    return spring_torque + rotor_inertia * acceleration + friction
