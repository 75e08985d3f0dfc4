"""Bare numbers beyond what machines have are asked about; with their unit they are meant."""

import math
from collections.abc import Iterator
from typing import Any

import pytest

from stiffopt.declaration import DIMENSIONS, PRISMATIC
from stiffopt.errors import ImplausibleError, InputFileError
from stiffopt.fastening.tightening import Tightening
from stiffopt.problem.schema import problem_file
from stiffopt.recording.schema import RecordingsFile
from stiffopt.report.explain import explained
from stiffopt.report.file_reference import file_models, file_schema
from stiffopt.robot.element_sections import BoltsSection
from stiffopt.robot.schema import SurfaceSection, robot_file
from stiffopt.units import JointNumber, fit_joint
from stiffopt.validation import Section, validate


class Parts(Section):
    """Some sections that files have."""

    bolt: BoltsSection | None = None
    tightening: Tightening | None = None


def read(model: type[Section], **keys: Any) -> Any:
    return validate(model, keys, "some.toml")


def bolt(**keys: Any) -> dict[str, Any]:
    return {"bolt": {"size": "M5", "count": 6, "circle_diameter": "60 mm", **keys}}


def robot(joint: dict[str, Any]) -> dict[str, Any]:
    return {"schema": 1, "kind": "robot", "name": "r", "joint": [{"name": "j1", **joint}]}


@pytest.mark.parametrize(
    ("content", "where", "sentence"),
    [
        (
            bolt(clamp_length=16),
            "bolt.clamp_length",
            '16 m is not plausible, 1e-05 to 0.5 m is. Write "16 mm" if that is meant.',
        ),
        (
            {"tightening": {"embedding": 8}},
            "tightening.embedding",
            '8 m is not plausible, 1e-08 to 0.0003 m is. Write "8 um" if that is meant.',
        ),
        (
            {"tightening": {"thread_friction": 15}},
            "tightening.thread_friction",
            "thread_friction = 15 is outside the validity range 0 to 1.",
        ),
        (
            {"tightening": {"scatter": 16}},
            "tightening.scatter",
            '16 is not plausible, 1 to 10 is. Correct it, or write "16" to keep it.',
        ),
        (
            {"tightening": {"temperature_change": 250}},
            "tightening.temperature_change",
            '250 is not plausible, up to 200 is. Correct it, or write "250" to keep it.',
        ),
        (
            bolt(circle_diameter=2.5),
            "bolt.circle_diameter",
            'Write "2.5 mm" if that is meant, or write "2.5 m" to keep it.',
        ),
    ],
)
def test_a_bare_number_beyond_its_range_is_asked_about(content, where, sentence):
    with pytest.raises(InputFileError) as told:
        read(Parts, **content)
    assert told.value.where == where
    assert sentence in told.value.reason


@pytest.mark.parametrize("friction", [15, "15"])
def test_a_friction_of_15_is_refused_however_it_is_written(friction):
    surface = {"first": "steel", "second": "steel", "fractal_dimension": 2.5,
               "fractal_roughness": 1e-11, "friction": friction}  # fmt: skip
    model = robot_file().model_fields["surface"].annotation.__args__[1]
    assert issubclass(model, SurfaceSection)
    with pytest.raises(InputFileError, match=r"at most 5\..* Metals have 0\.05 to 0\.3"):
        read(model, **surface)
    assert read(model, **surface | {"friction": "0.15"}).friction == 0.15


def test_with_its_unit_a_number_is_meant_up_to_the_bounds():
    assert read(Parts, **bolt(circle_diameter="2.5 m")).bolt.circle_diameter == 2.5
    assert read(Parts, tightening={"temperature_change": "250"}).tightening is not None
    with pytest.raises(InputFileError, match="at most 3"):
        read(Parts, **bolt(clamp_length="16 m"))


def test_joints_are_asked_when_it_is_known_whether_they_turn():
    read(robot_file(), **robot({"position_upper": 90}))
    with pytest.raises(ImplausibleError, match=r'upper: 90 rad is .*Write "90 deg" if that is mea'):
        fit_joint(JointNumber(90.0), False, "angle", "upper")
    assert fit_joint(JointNumber(90.0), True, "angle", "upper") == 90.0
    assert fit_joint(JointNumber(90.0, "angle"), False, "angle", "upper") == 90.0
    with pytest.raises(ImplausibleError, match='Write "230 deg/s"'):
        fit_joint(JointNumber(230.0), False, "angular velocity")


def test_recordings_hold_si_numbers_only():
    section = RecordingsFile.model_fields["runs"].annotation.__args__[0]
    run = {"file": "a.csv", "role": "train"}
    with pytest.raises(InputFileError, match=r"295 degC is .* are in SI: correct it\."):
        read(section, **run, housing_temperature=295)
    assert read(section, **run, housing_temperature=22).housing_temperature == 22


def test_degrees_for_radians_in_a_problem():
    target = problem_file().model_fields["motion"].annotation.model_fields["start"].annotation
    model = target.__args__[0]
    with pytest.raises(InputFileError, match=r'rpy\[1\]: 180 rad .*Write "180 deg"'):
        read(model, position=[0.3, 0.0, 0.4], rpy=[180, 0, 0])


def _quantities(schema: Any, place: str) -> Iterator[tuple[str, dict[str, Any]]]:
    if isinstance(schema, dict):
        if "unit" in schema and not isinstance(schema["unit"], dict):
            yield place, schema
        for key, value in schema.items():
            yield from _quantities(value, f"{place}.{key}")
    elif isinstance(schema, list):
        for number, value in enumerate(schema):
            yield from _quantities(value, f"{place}[{number}]")


@pytest.mark.parametrize("kind", list(file_models()))
def test_every_quantity_of_every_file_has_a_finite_range(kind):
    for place, schema in _quantities(file_schema(kind), kind):
        number = schema.get("anyOf", [schema])[0]
        low, high = number["plausible"]
        assert 0.0 <= low < high < math.inf, place
        low, high = max(low, number.get("minimum", low)), min(high, number.get("maximum", high))
        assert low < high, f"{place}: nothing plausible within the bounds"
        assert ("plausible_prismatic" in schema) == ("unit_prismatic" in schema), place


def test_every_kind_of_quantity_has_a_range_that_holds_its_example():
    from stiffopt.units import to_si

    for kind in DIMENSIONS.values():
        kind.ask(to_si(kind.example, kind.name), kind.plausible)
        assert kind.plausible[1] < math.inf, kind.name
    assert set(PRISMATIC) | set(PRISMATIC.values()) <= set(DIMENSIONS)


def test_every_slip_is_a_unit_of_its_kind():
    from stiffopt.units import to_si

    for kind in DIMENSIONS.values():
        for unit, factor in kind.slips.items():
            assert to_si(f"1 {unit}", kind.name) == pytest.approx(factor, rel=1e-12)


def test_explain_names_the_range():
    assert any("[m], plausible 1e-05 to 0.5" in line for line in explained("clamp_length"))
