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
    """Return the friction torque of the drive, with the sign of the velocity.

    Parameters
    ----------
    velocity : float, array, SX or MX (..., n)
        Of the joints. [rad/s] or [m/s]
    coulomb : array (n,)
        Dry friction, independent of the speed. [N m] or [N]
    viscous : array (n,)
        Slope with the speed. [N m s/rad] or [N s/m]
    width : array (n,)
        Speed at which the dry part reaches 76 % (tanh 1) of `coulomb`; it makes the law smooth
        at standstill, where the sharp law jumps. [rad/s] or [m/s]

    Returns
    -------
    same kind and shape as `velocity`
        [N m] or [N]
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
    """Return the drive torque at the output side, which torque limits bound.

    The spring sits between drive and link, so that rotor inertia and friction load the drive but
    not the spring.

    Parameters
    ----------
    spring_torque : array, SX or MX (..., n)
        Torque of links, payload and process force in the joints' springs. [N m] or [N]
    velocity, acceleration : array, SX or MX (..., n)
        [rad/s, rad/s^2] or [m/s, m/s^2]
    rotor_inertia : array (n,)
        Reflected to the output. [kg m^2] or [kg]
    coulomb, viscous : array (n,)
        As for `friction_torque`.
    velocity_max : array (n,)
        Sets the smoothing width of dry friction, 1 % of it; where it is infinite, of 1 rad/s or
        1 m/s. [rad/s] or [m/s]
    """
    width: Quantity = DRY_FRICTION_WIDTH_SHARE * np.where(
        np.isfinite(velocity_max), velocity_max, 1.0
    )
    if isinstance(velocity, ca.SX | ca.MX):
        rotor_inertia, coulomb, viscous, width = (
            ca.DM(np.asarray(x, dtype=float)) for x in (rotor_inertia, coulomb, viscous, width)
        )
    friction = friction_torque(velocity, coulomb=coulomb, viscous=viscous, width=width)
    return spring_torque + rotor_inertia * acceleration + friction
