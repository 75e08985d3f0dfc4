"""The catalogue: physics that a nominal model of a robot may lack, one family a file.

Signs: terms add to the drive torque, to the torque in the spring, or to motor angle minus link
angle, as `stiffopt.discovery.effect.Term` says.
"""

from __future__ import annotations

from stiffopt.discovery.catalogue.contacts import CONTACTS
from stiffopt.discovery.catalogue.elastic import ELASTIC
from stiffopt.discovery.catalogue.friction import FRICTION
from stiffopt.discovery.catalogue.inertial import INERTIAL
from stiffopt.discovery.catalogue.periodic import PERIODIC
from stiffopt.discovery.catalogue.sensors import SENSORS
from stiffopt.discovery.catalogue.springs import SPRINGS
from stiffopt.discovery.effect import Effect
from stiffopt.errors import InputError, nearest

CATALOGUE: tuple[Effect, ...] = (
    *FRICTION,
    *ELASTIC,
    *PERIODIC,
    *INERTIAL,
    *SPRINGS,
    *SENSORS,
    *CONTACTS,
)

# Effects that ordinary motions separate poorly.
confusion_groups: tuple[frozenset[str], ...] = (
    frozenset({"stiffness_linear", "belt_creep", "preload_loss"}),
    frozenset({"k1_softening", "preload_loss", "backlash"}),
    frozenset({"asym_friction", "torque_offset"}),
    frozenset({"torque_gain", "payload", "inertial_error"}),
    frozenset({"payload", "base_tilt", "encoder_offset"}),
    frozenset({"stribeck", "hysteresis", "coulomb"}),
    frozenset({"coulomb", "position_friction"}),
    frozenset({"viscous", "thermal_friction", "time_delay"}),
    frozenset({"gravity_spring", "cable_spring"}),
    frozenset({"encoder_offset", "encoder_zero_change"}),
)


def effect(name: str) -> Effect:
    """Entry of the catalogue by its name.

    Raises
    ------
    InputError
        No entry has this name; the message lists those there are.
    """
    for entry in CATALOGUE:
        if entry.name == name:
            return entry
    names = [entry.name for entry in CATALOGUE]
    raise InputError(f"The catalogue has no effect {name!r}. {nearest(name, names)}")
