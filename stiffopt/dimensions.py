"""Dimensions of quantities: SI units, plausible magnitudes and usual mistakes in units."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from stiffopt.errors import ImplausibleError


class Range(Protocol):
    """Range that a number may have to lie in, such as `stiffopt.declaration.Bounds`."""

    def contains(self, number: float) -> bool:
        """Return whether a number lies within."""


@dataclass(frozen=True)
class Dimension:
    """A kind of quantity."""

    # Unit in SI; an example for messages.
    name: str
    unit: str
    example: str
    angle: int = 0  # power of angle
    # Magnitudes of a machine's quantity, from micro-gripper to crane, unless a field's `Bounds` say
    # otherwise; zero is always plausible.
    plausible: tuple[float, float] = (0.0, math.inf)
    # Units that a bare number is given in by mistake, the usual one first, and their factors.
    slips: Mapping[str, float] = dataclasses.field(default_factory=dict, compare=False)

    def ask(
        self,
        number: float,
        plausible: tuple[float, float],
        *,
        where: str = "",
        si_only: bool = False,
        bounds: Sequence[Range] = (),
    ) -> None:
        """Raise `ImplausibleError` for a bare number in SI whose magnitude is beyond `plausible`.

        `si_only`: the file accepts no texts with units, so the message suggests none. `bounds`:
        bounds of the field; a number that violates them in every unit is left to their message.
        """
        if _is_within(number, plausible) or not math.isfinite(number):
            return
        unit = self.unit and f" {self.unit}"
        shares = ((name, factor * number) for name, factor in self.slips.items())
        meant = next((name for name, share in shares if _is_within(share, plausible)), "")
        kept = all(bound.contains(number) for bound in bounds)
        if not (kept or meant):
            return
        if si_only:
            slip = f" ({number:g} {meant} meant?)" if meant else ""
            advice = f"Numbers of this file are in SI: correct it{slip}."
        else:
            advice = f'Write "{number:g} {meant}" if that is meant' if meant else "Correct it"
            if kept:
                advice += f', or write "{number:g}{unit}" to keep it'
            advice += "."
        place = f"{where}: " if where else ""
        raise ImplausibleError(
            f"{place}{number:g}{unit} is not plausible, {range_text(plausible)}{unit} is. {advice}"
        )


def _is_within(number: float, plausible: tuple[float, float]) -> bool:
    return number == 0.0 or plausible[0] <= abs(number) <= plausible[1]


def range_text(plausible: Sequence[float]) -> str:
    """Format a range of magnitudes.

    >>> range_text((0.001, 1.0)), range_text((0.0, 20.0))
    ('0.001 to 1', 'up to 20')
    """
    low, high = plausible
    return f"{low:g} to {high:g}" if low > 0.0 else f"up to {high:g}"


_RADIANS_PER_DEGREE = math.pi / 180.0
_ARC_MINUTES_PER_RADIAN = 10800.0 / math.pi

DIMENSIONS = {
    d.name: d
    for d in (
        Dimension("length", "m", "0.3 mm", 0, (0.0, 100.0), {"mm": 1e-3, "um": 1e-6}),
        Dimension("angle", "rad", "45 deg", 1, (0.0, 20.0), {"deg": _RADIANS_PER_DEGREE}),
        Dimension("mass", "kg", "1.5 kg", 0, (0.0, 2e4), {"g": 1e-3}),
        Dimension(
            "inertia", "kg*m^2", "0.3 kg*m^2", 0, (0.0, 1e5), {"kg*cm^2": 1e-4, "kg*mm^2": 1e-6}
        ),
        Dimension("force", "N", "12 kN", 0, (0.0, 1e7), {"mN": 1e-3}),
        Dimension("torque", "N*m", "45 N*m", 0, (0.0, 1e6), {"N*mm": 1e-3}),
        Dimension("energy", "J", "250 J", 0, (0.0, 1e7), {"kJ": 1e3}),
        Dimension("time", "s", "1.6 s", 0, (1e-7, 1e7), {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}),
        Dimension("frequency", "Hz", "20 Hz", 0, (1e-3, 1e6), {"kHz": 1e3, "mHz": 1e-3}),
        Dimension("pressure", "Pa", "0.1 MPa", 0, (1.0, 2e12), {"MPa": 1e6, "GPa": 1e9}),
        Dimension("area", "m^2", "1 cm^2", 0, (0.0, 10.0), {"mm^2": 1e-6}),
        Dimension("speed", "m/s", "1.5 m/s", 0, (0.0, 50.0), {"mm/s": 1e-3}),
        Dimension("acceleration", "m/s^2", "9.81 m/s^2", 0, (0.0, 1e4), {"mm/s^2": 1e-3}),
        Dimension("jerk", "m/s^3", "50 m/s^3", 0, (0.0, 1e7), {"mm/s^3": 1e-3}),
        Dimension(
            "angular velocity",
            "rad/s",
            "230 deg/s",
            1,
            (0.0, 100.0),
            {"deg/s": _RADIANS_PER_DEGREE},
        ),
        Dimension(
            "angular acceleration",
            "rad/s^2",
            "20 rad/s^2",
            1,
            (0.0, 1e5),
            {"deg/s^2": _RADIANS_PER_DEGREE},
        ),
        Dimension(
            "angular jerk",
            "rad/s^3",
            "400 rad/s^3",
            1,
            (0.0, 1e8),
            {"deg/s^3": _RADIANS_PER_DEGREE},
        ),
        Dimension(
            "stiffness",
            "N*m/rad",
            "5 N*m/arcmin",
            -1,
            (1e-3, 1e11),
            {"N*m/arcmin": _ARC_MINUTES_PER_RADIAN},
        ),
        Dimension("linear stiffness", "N/m", "20 N/um", 0, (1e-1, 1e12), {"N/mm": 1e3}),
        Dimension(
            *("stiffness per width", "N/m^2", "20 N/(mm*um)", 0),
            (1e5, 1e12),
            {"N/(mm*um)": 1e9},
        ),
        Dimension("viscous friction", "N*m*s/rad", "5 N*m*s/rad", -1, (0.0, 1e6)),
        Dimension("linear viscous friction", "N*s/m", "5 N*s/m", 0, (0.0, 1e7)),
        # The upper end excludes temperatures in kelvin.
        Dimension("temperature", "degC", "22 degC", 0, (0.0, 200.0)),
        Dimension("temperature difference", "K", "30 K", 0, (0.0, 200.0)),
        Dimension("ratio", "", "0.12", 0, (0.0, 1e12)),
    )
}

# Dimension of a prismatic joint by that of a revolute joint.
PRISMATIC = {
    "angle": "length",
    "angular velocity": "speed",
    "angular acceleration": "acceleration",
    "angular jerk": "jerk",
    "torque": "force",
    "stiffness": "linear stiffness",
    "viscous friction": "linear viscous friction",
    "inertia": "mass",
}
