"""Units of file entries."""

import math

import pytest

from stiffopt.dimensions import DIMENSIONS
from stiffopt.errors import UnitError
from stiffopt.units import _FACTORS_WITHOUT_PINT, _pint_factor, fit_joint, joint_to_si, to_si


@pytest.mark.parametrize(
    ("text", "dimension", "value"),
    [
        ("45 deg", "angle", math.pi / 4),
        ("0.3 mm", "length", 0.3e-3),
        ("3 um", "length", 3e-6),
        ("12 kN", "force", 12e3),
        ("5 N*m/arcmin", "stiffness", 5 * 60 * 180 / math.pi),
        ("45 Nm", "torque", 45.0),
        ("230 deg/s", "angular velocity", 230 * math.pi / 180),
        ("60 rpm", "angular velocity", 2 * math.pi),
        ("400 deg/s^2", "angular acceleration", 400 * math.pi / 180),
        ("0.1 MPa", "pressure", 1e5),
        ("1.6 s", "time", 1.6),
        ("2 mrad", "angle", 2e-3),
        ("500 g", "mass", 0.5),
        ("0.12", "ratio", 0.12),
        ("50 K", "temperature difference", 50.0),
        ("-100 N", "force", -100.0),
        ("1e-3 kg*m^2", "inertia", 1e-3),
        (7, "length", 7.0),
        (-2.5, "angle", -2.5),
    ],
)
def test_values(text, dimension, value):
    assert to_si(text, dimension) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize("dimension", DIMENSIONS)
def test_every_example_is_valid(dimension):
    assert math.isfinite(to_si(DIMENSIONS[dimension].example, dimension))


@pytest.mark.parametrize(
    ("text", "dimension", "parts"),
    [
        ("50 degC", "temperature difference", ["differences are given in K", "'30 K'"]),
        ("300 K", "temperature", ["temperatures are given in degC"]),
        ("45 mm", "angle", ["joint[j1].x", "'45 mm'", "not one of angle", "'45 deg'"]),
        ("5 N*m", "stiffness", ["not one of stiffness", "'5 N*m/arcmin'"]),
        ("5 N*m/rad", "torque", ["not one of torque", "'45 N*m'"]),
        ("3 1/s", "angular velocity", ["not one of angular velocity"]),
        ("45 degg", "angle", ["'degg' is not known"]),
        ("45 deg deg(", "angle", ["cannot be read"]),
        ("45", "angle", ["no unit", "[rad]"]),
        ("fast", "speed", ["expected speed, got 'fast'"]),
        ("nan m", "length", ["expected length, got 'nan m'"]),
        (float("nan"), "length", ["finite"]),
        (float("inf"), "length", ["finite"]),
        ("1e999 m", "length", ["finite"]),
        (True, "length", ["got True"]),
        ([1], "length", ["got [1]"]),
    ],
)
def test_messages(text, dimension, parts):
    with pytest.raises(UnitError) as error:
        to_si(text, dimension, "joint[j1].x")
    for part in [*parts, "joint[j1].x"]:
        assert part in str(error.value)


def test_joint_quantities_fit_the_kind_of_joint():
    sliding = joint_to_si("200 mm", "angle")
    turning = joint_to_si("90 deg", "angle")
    bare = joint_to_si(0.5, "angle")
    assert fit_joint(sliding, True, "angle") == pytest.approx(0.2)
    assert fit_joint(turning, False, "angle") == pytest.approx(math.pi / 2)
    assert fit_joint(bare, True, "angle") == fit_joint(bare, False, "angle") == 0.5
    with pytest.raises(UnitError, match=r"q\[1\]: the joint is revolute and needs angle"):
        fit_joint(sliding, False, "angle", "q[1]")
    with pytest.raises(UnitError, match="prismatic and needs length, got angle"):
        fit_joint(turning, True, "angle", "q[1]")
    with pytest.raises(UnitError, match="not one of angle"):
        joint_to_si("3 kg", "angle")


def test_usual_units_are_what_pint_says():
    for name, units in _FACTORS_WITHOUT_PINT.items():
        for unit, factor in units.items():
            assert factor == pytest.approx(_pint_factor(unit, DIMENSIONS[name]), rel=3e-16), unit
