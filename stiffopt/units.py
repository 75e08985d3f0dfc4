"""Units at the file boundary: "45 deg" or "12 kN" become SI floats here and nowhere deeper.

A bare number is SI already. Angles count as a dimension of their own, so that a torque is not
mistaken for a stiffness per radian.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable
from typing import Any

from stiffopt.declaration import Unit
from stiffopt.dimensions import DIMENSIONS, PRISMATIC, Dimension
from stiffopt.errors import UnitError, shortened

# Far above any modulus or stiffness, and products of a few such numbers do not overflow.
MAX_MAGNITUDE = 1e15
# Length of a number with its unit [characters]; parsing may take its cube.
MAX_NUMBER_LENGTH = 200

_NUMBER_AND_UNIT = re.compile(r"^\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*$")
_ANGLE_UNITS = (
    "radian",
    "degree",
    "arcminute",
    "arcsecond",
    "turn",
    "revolution",
    "revolutions_per_minute",
)


def number_and_unit(value: object) -> tuple[float, str | None]:
    """Split a value of a file into number and unit: "" for a bare number, None for other values.

    >>> number_and_unit("0.4 s"), number_and_unit(2), number_and_unit("fast")
    ((0.4, 's'), (2.0, ''), (nan, None))
    """
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value), ""
    short = isinstance(value, str) and len(value) <= MAX_NUMBER_LENGTH
    match = _NUMBER_AND_UNIT.match(str(value)) if short else None
    return (float(match[1]), match[2]) if match else (math.nan, None)


@functools.cache
def _unit_registry() -> Any:
    import pint

    registry: Any = pint.UnitRegistry()
    registry.define("newton_meter = newton * meter = Nm")
    return registry


# Names joined by "*" and "/", each with a power of one digit: pint would evaluate any arithmetic.
_NAME_PATTERN = r"(?:1|[^\W\d]\w*|[%°])"
_POWER_PATTERN = r"(?:\s*(?:\*\*|\^)\s*(?:-?\d|\(-?\d\)))?"
_UNIT_PATTERN = re.compile(
    rf"[\s(]*{_NAME_PATTERN}[\s)]*{_POWER_PATTERN}(?:(?:\s*[*/]\s*|\s+)[\s(]*{_NAME_PATTERN}[\s)]*{_POWER_PATTERN})*"
)
_MAX_UNIT_LENGTH = 60


def _parse_unit(unit: str) -> Any:
    """Unit as an object of pint; raises ValueError with the reason."""
    import pint

    if len(unit) > _MAX_UNIT_LENGTH or not _UNIT_PATTERN.fullmatch(unit):
        raise ValueError(f"the unit {shortened(unit)} cannot be read")
    try:
        return _unit_registry().parse_units(unit)
    except (pint.UndefinedUnitError, pint.errors.DefinitionSyntaxError) as error:
        raise ValueError(f"the unit {unit!r} is not known") from error
    except Exception as error:  # pint's parser lets Python's tokenizer errors through
        raise ValueError(f"the unit {unit!r} cannot be read") from error


# Factors of common units by dimension: importing pint takes half a second and is avoided for them.
# A test compares each with pint.
_FACTORS_WITHOUT_PINT = {
    "length": {"m": 1.0, "mm": 1e-3, "um": 1e-6},
    "angle": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0},
    "mass": {"kg": 1.0, "g": 1e-3},
    "inertia": {"kg*m^2": 1.0},
    "force": {"N": 1.0, "kN": 1e3},
    "torque": {"N*m": 1.0, "Nm": 1.0},
    "time": {"s": 1.0, "ms": 1e-3},
    "frequency": {"Hz": 1.0},
    "pressure": {"Pa": 1.0, "MPa": 1e6, "GPa": 1e9},
    "speed": {"m/s": 1.0, "mm/s": 1e-3},
    "acceleration": {"m/s^2": 1.0},
    "jerk": {"m/s^3": 1.0},
    "angular velocity": {
        "rad/s": 1.0,
        "deg/s": math.pi / 180.0,
        "rpm": math.pi / 30.0,
    },
    "angular acceleration": {"rad/s^2": 1.0, "deg/s^2": math.pi / 180.0},
    "angular jerk": {"rad/s^3": 1.0, "deg/s^3": math.pi / 180.0},
    "stiffness": {"N*m/rad": 1.0, "Nm/rad": 1.0, "N*m/arcmin": 10800.0 / math.pi},
    "viscous friction": {"N*m*s/rad": 1.0},
    "temperature difference": {"K": 1.0},
}


@functools.lru_cache(maxsize=1024)
def _conversion_factor(unit: str, dimension: Dimension) -> float:
    """Factor from `unit` to the SI unit of `dimension`; raises ValueError with the reason."""
    usual = _FACTORS_WITHOUT_PINT.get(dimension.name, {}).get(unit)
    return _pint_factor(unit, dimension) if usual is None else usual


def _pint_factor(unit: str, dimension: Dimension) -> float:
    parsed = _parse_unit(unit)
    if dimension.unit in ("degC", "K") and unit != dimension.unit:
        raise ValueError(f"{dimension.name}s are given in {dimension.unit}, not in {unit!r}")
    angle = sum(power for name, power in parsed._units.items() if str(name).endswith(_ANGLE_UNITS))
    target = _unit_registry().parse_units(dimension.unit)
    if parsed.dimensionality != target.dimensionality or angle != dimension.angle:
        raise ValueError(f"the unit {unit!r} is not one of {dimension.name}")
    return float(_unit_registry().Quantity(1.0, parsed).to(target).magnitude)


def to_si(value: object, dimension: str, where: str = "") -> float:
    """Convert an entry of a file, a bare number or text such as "45 deg", to SI.

    `dimension` is a name in `stiffopt.dimensions.DIMENSIONS`, `where` the key, for messages. Raises
    `UnitError` for an unknown unit or one of another dimension, and what is no finite number.
    """
    kind = DIMENSIONS[dimension]
    unit = f" [{kind.unit}]" if kind.unit else ""
    allowed = f"Give a number{unit} or a text such as {kind.example!r}."
    place = f"{where}: " if where else ""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise UnitError(f"{place}expected {kind.name}, got {shortened(value)}. {allowed}")
    if isinstance(value, str):
        match = _NUMBER_AND_UNIT.match(value) if len(value) <= MAX_NUMBER_LENGTH else None
        if match is None:
            raise UnitError(f"{place}expected {kind.name}, got {shortened(value)}. {allowed}")
        if not match[2] and kind.unit:
            raise UnitError(f"{place}{shortened(value)} has no unit. {allowed}")
        try:
            number = float(match[1]) * (_conversion_factor(match[2], kind) if match[2] else 1.0)
        except ValueError as error:
            raise UnitError(f"{place}got {shortened(value)}, but {error}. {allowed}") from error
    else:
        # Python integers may exceed the range of a float.
        number = float(max(min(value, 10**300), -(10**300)) if isinstance(value, int) else value)
    if not math.isfinite(number):
        got = shortened(value)
        raise UnitError(f"{place}{kind.name} must be a finite number, got {got}. {allowed}")
    if abs(number) > MAX_MAGNITUDE:
        got = shortened(value)
        raise UnitError(f"{place}{got} is beyond any machine, at most {MAX_MAGNITUDE:g}. {allowed}")
    return number


def convert(value: float, unit: str, target: str) -> float:
    """Convert a value to another unit of the same dimension.

    Raises `UnitError`: one of the units is unknown, or their dimensions differ.
    """
    if unit == target:
        return value
    for usual in _FACTORS_WITHOUT_PINT.values():
        if unit in usual and target in usual:
            return value * (usual[unit] / usual[target])
    import pint

    try:
        held = _unit_registry().Quantity(1.0, _parse_unit(_spell_for_pint(unit)))
        factor = float(held.to(_parse_unit(_spell_for_pint(target))).magnitude)
    except (pint.PintError, TypeError, ValueError, ArithmeticError) as error:
        reason = shortened(error)
        raise UnitError(f"{unit!r} cannot be converted to {shortened(target)}: {reason}") from error
    return value * factor


def _spell_for_pint(unit: str) -> str:
    """Unit as pint reads it, of a displayed one such as "N m/rad"."""
    return unit.replace("N m", "N*m")


class JointNumber(float):
    """Number of a joint whose kind is not known yet, with the dimension of its written unit.

    `dimension` is "" for a bare number, which fits either kind of joint.
    """

    dimension: str

    def __new__(cls, value: float, dimension: str = "") -> JointNumber:
        """Create a float with the attribute `dimension`."""
        number = super().__new__(cls, value)
        number.dimension = dimension
        return number


def joint_to_si(value: object, dimension: str, where: str = "") -> JointNumber:
    """Convert a quantity of a revolute joint, or its counterpart of a prismatic one, to SI."""
    if not isinstance(value, str):
        return JointNumber(to_si(value, dimension, where))
    try:
        return JointNumber(to_si(value, dimension, where), dimension)
    except UnitError as error:
        other = PRISMATIC.get(dimension)
        if other is None:  # same dimension for both kinds of joint
            raise
        try:
            return JointNumber(to_si(value, other, where), other)
        except UnitError:
            raise error from None


def fit_joint(value: float, prismatic: bool, dimension: str, where: str = "") -> float:
    """Check that the unit of a value fits the kind of joint, and return a plain float."""
    written = getattr(value, "dimension", None)
    wanted = PRISMATIC[dimension] if prismatic else dimension
    if written and written != wanted:
        kind = "prismatic" if prismatic else "revolute"
        place = f"{where}: " if where else ""
        raise UnitError(
            f"{place}the joint is {kind} and needs {wanted}, got {written}. "
            f"Give a number [{DIMENSIONS[wanted].unit}] or a text such as "
            f"{DIMENSIONS[wanted].example!r}."
        )
    if written == "":
        DIMENSIONS[wanted].ask(float(value), DIMENSIONS[wanted].plausible, where=where)
    return float(value)


def entry_reader(declared: Unit) -> Callable[[object], float]:
    """Conversion of entries of a declared quantity to SI; raises UnitError."""
    convert = joint_to_si if declared.joint else to_si
    return lambda value: convert(value, declared.dimension)


# Unit of a prismatic joint by that of a revolute joint.
_PRISMATIC_UNITS = {
    "N m": "N",
    "N m s/rad": "N s/m",
    "kg m^2": "kg",
    "rad": "m",
    "mrad": "mm",
    "deg": "mm",
    "rad/s": "m/s",
    "rad/(N m)": "m/N",
    "N m/rad": "N/m",
    "N m/rad^3": "N/m^3",
    "N m s^2/rad^2": "N s^2/m^2",
    "N m/K": "N/K",
}


def joint_unit(unit: str, prismatic: bool) -> str:
    """Unit of a revolute joint, or its counterpart where the joint is prismatic."""
    return _PRISMATIC_UNITS.get(unit, unit) if prismatic else unit
