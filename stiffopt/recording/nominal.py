"""Nominal values beside the robot: drives, counterbalances, tolerances and sensor noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from stiffopt.declaration import NOT_NEGATIVE, Bounds, Doc, Unit, check_fields

if TYPE_CHECKING:
    from stiffopt.symbolic import Quantity

_RelativeDeviation = Annotated[float, Unit("ratio", bare=True), NOT_NEGATIVE]
# Relative standard deviation of a stiffness, which must stay positive.
_StiffnessDeviation = Annotated[float, Unit("ratio", bare=True), Bounds(least=0.0, most=1.0)]
_LengthDeviation = Annotated[float, Unit("length", bare=True), NOT_NEGATIVE]
_PositionDeviation = Annotated[float, Unit("angle", joint=True, bare=True), NOT_NEGATIVE]


@dataclass(frozen=True, kw_only=True, eq=False)
class Counterbalance:
    """A known element that carries part of a joint's weight.

    The torque relieves the drive: it adds to the drive torque in the joint's torque equation. A
    spring pulls towards its offset.
    """

    joint: int  # index of the joint in the set, from 0
    # Of a spring: [N m/rad], [rad].
    stiffness: float | None = None
    offset: float | None = None
    # (m,) of a table: [rad], [N m].
    angle: np.ndarray | None = None
    torque: np.ndarray | None = None

    def at(self, position: Quantity) -> Quantity:
        """Torque on the joint at a joint position: (...) [rad] -> (...) [N m].

        A table is interpolated linearly and held constant beyond its ends.
        """
        if self.angle is not None and self.torque is not None:
            return np.interp(position, self.angle, self.torque)
        return -(self.stiffness or 0.0) * (position - (self.offset or 0.0))


@dataclass(frozen=True, kw_only=True, eq=False)
class Nominal:
    """Nominal values of a set that are no fields of `Robot`; None where not given."""

    gear_ratio: np.ndarray | None = None  # (n,) turns of the motor for one of the joint
    # Temperature at which the nominal friction was identified [degC].
    friction_temperature: float | None = None
    torque_rated: np.ndarray | None = None  # (n,) [N m]
    pole_pairs: float | None = None
    joint_damping: np.ndarray | None = None  # (n,) of the elastic joint [N m s/rad]
    # (n,) elements of each drivetrain, such as "belt+key+bolts".
    connections: tuple[str, ...] | None = None
    counterbalance: tuple[Counterbalance, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Tolerance:
    """One standard deviation of the nominal values; wide defaults apply where none is given."""

    mass: Annotated[_RelativeDeviation | None, Doc("Of masses, relative.")] = None
    com: Annotated[_LengthDeviation | None, Doc("Of each coordinate of a centre of mass.")] = None
    rotor_inertia: Annotated[_RelativeDeviation | None, Doc("Of rotor inertias, relative.")] = None
    coulomb: Annotated[_RelativeDeviation | None, Doc("Of Coulomb friction, relative.")] = None
    viscous: Annotated[_RelativeDeviation | None, Doc("Of viscous friction, relative.")] = None
    stiffness: Annotated[_StiffnessDeviation | None, Doc("Of stiffnesses, relative.")] = None
    joint_damping: Annotated[
        _RelativeDeviation | None, Doc("Of the damping of joints, relative.")
    ] = None
    torque_constant: Annotated[_RelativeDeviation | None, Doc("Of torque constants, relative.")] = (
        None
    )
    encoder_zero: Annotated[_PositionDeviation | None, Doc("Of the zero of an encoder.")] = None

    def __post_init__(self) -> None:
        check_fields(self, "tolerance")


@dataclass(frozen=True, kw_only=True, eq=False)
class Noise:
    """One standard deviation of the sensors' noise; None where not given."""

    # (n,) [N m], [rad/s], [rad].
    torque: np.ndarray | None = None
    velocity: np.ndarray | None = None
    link_position: np.ndarray | None = None
    # (n,) one count of the encoder [rad].
    position_resolution: np.ndarray | None = None
    link_position_resolution: np.ndarray | None = None
