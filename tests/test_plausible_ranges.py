"""Bare numbers beyond what machines have are asked about; with their unit they are meant."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stiffopt.dimensions import DIMENSIONS, PRISMATIC
from stiffopt.errors import ImplausibleError, InputFileError, RobotError
from stiffopt.fastening.tightening import Tightening
from stiffopt.files import load_toml, read_table
from stiffopt.problem.input_checks import slack_belts
from stiffopt.problem.schema import problem_file
from stiffopt.recording.clock import read_clock
from stiffopt.recording.readers.csv import read as read_run
from stiffopt.recording.schema import RecordingsFile
from stiffopt.recording.signals import Signals
from stiffopt.report.file_reference import explain_key, file_models, file_schema
from stiffopt.robot.elements import BoltsSection
from stiffopt.robot.files import load_robot
from stiffopt.robot.own_catalogue import CatalogueFile
from stiffopt.robot.schema import SurfaceSection, robot_file_schema
from stiffopt.units import JointNumber, fit_joint
from stiffopt.validation import Section, validate

PROBLEMS = Path(__file__).resolve().parents[1] / "problems"


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
    model = robot_file_schema().model_fields["surface"].annotation.__args__[1]
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
    read(robot_file_schema(), **robot({"position_upper": 90}))
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
    assert any("[m], plausible 1e-05 to 0.5" in line for line in explain_key("clamp_length"))


def test_explain_names_the_type_of_an_element():
    lines = list(explain_key("prepressure"))
    assert 'joint.element.prepressure (robot, type = "key")' in lines
    assert 'joint.element.prepressure (robot, type = "gear_pair")' in lines


ARM = """<robot name="r"><link name="base"/><link name="arm"><inertial><mass value="2"/>
<inertia ixx="{ixx}" ixy="{ixy}" ixz="0" iyy="{iyy}" iyz="0" izz="{izz}"/></inertial></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="50" velocity="3"/></joint></robot>"""


def one_joint(folder, elements="", **inertia):
    tensor = {"ixx": 0.02, "ixy": 0.0, "iyy": 0.02, "izz": 0.03} | inertia
    (folder / "one.urdf").write_text(ARM.format(**tensor))
    (folder / "one.toml").write_text(
        'schema = 1\nkind = "robot"\nname = "one"\nurdf = "one.urdf"\n'
        f'[[joint]]\nname = "turn"\ntorque_max = 50.0\n{elements}'
    )
    return folder / "one.toml"


def test_a_product_of_inertia_above_both_moments_belongs_to_no_body(tmp_path):
    with pytest.raises(RobotError, match=r"'arm': its principal .*-0\.03.* place of ixy"):
        load_robot(one_joint(tmp_path, ixy=0.05))
    # Beside unlike moments it may well be larger than one of them.
    load_robot(one_joint(tmp_path, ixx=0.002, ixy=0.004, iyy=0.02, izz=0.02))


REDUCER = """[[joint.element]]
name = "gear"
type = "reducer"
catalogue = "harmonic_25_100"
"""
SHAFT = """[[joint.element]]
name = "input"
type = "shaft"
diameter = "14 mm"
length = "60 mm"
ratio = {ratio}
"""
BELT = """[[joint.element]]
name = "belt"
type = "timing_belt"
profile = "HTD5M"
teeth = 20
teeth_driven = 40
width = "15 mm"
span_length = "150 mm"
ratio = {ratio}
preload = "{tension} N"
"""


def test_an_element_before_a_reducer_turns_with_its_input(tmp_path):
    wrong = one_joint(tmp_path, SHAFT.format(ratio=50.0) + REDUCER)
    with pytest.raises(InputFileError, match=r"input\]\.ratio = 50, .* 100 times .* ratio = 100"):
        load_robot(wrong)
    for ratio in (100.0, 101.0):
        load_robot(one_joint(tmp_path, SHAFT.format(ratio=ratio) + REDUCER))
    load_robot(one_joint(tmp_path, BELT.format(ratio=200.0, tension=100) + REDUCER))
    load_robot(one_joint(tmp_path, REDUCER + SHAFT.format(ratio=1.0)))


def test_a_belt_that_goes_slack_below_the_largest_torque_is_named(tmp_path):
    tight = load_robot(one_joint(tmp_path, BELT.format(ratio=1.0, tension=2000)))
    assert slack_belts(tight) == ()
    (told,) = slack_belts(load_robot(one_joint(tmp_path, BELT.format(ratio=1.0, tension=1000))))
    # 2 F R with R = 20 teeth of 5 mm over 2 pi.
    assert "slack at 31.8 N m on the pulley, below the 50 N m" in told
    assert "Give it 1.57e+03 N" in told


def test_a_row_with_an_extra_field_is_refused(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t,q,tau\n0.0,1.0,2.0\n0.1,1,5,2.0\n0.2,1.0,2.0\n")
    signals = Signals(time="t", position=("q",), velocity=None, link_position=None, torque=("tau",))
    with pytest.raises(InputFileError, match="row 2: has 4 cells, the header names 3"):
        read_run(path, signals)
    with pytest.raises(InputFileError, match="row 2: has 4 cells, the header names 3"):
        read_table(path, ["t", "q"])
    path.write_text("t, q\n0.0,1.0,2.0\n0.1,1.5,2.0\n")
    with pytest.raises(InputFileError, match=r"columns t, tau\. It has t, q\.$"):
        read_table(path, ["t", "tau"])
    # A separator at the end of each line is no field.
    path.write_text("t,q,tau\n0.0,1.0,2.0,\n0.1,1.5,2.0,\n")
    assert read_run(path, signals)["q"].tolist() == [1.0, 1.5]
    assert read_table(path, ["q"]) == {"q": [1.0, 1.5]}


def test_times_in_picoseconds_are_refused(tmp_path):
    for unit in (1e-12, 1e-9):
        with pytest.raises(InputFileError, match=r"no motion of a robot .* signals\.scale\.time"):
            read_clock(np.arange(2000) * 4e-3 * unit, tmp_path / "run.csv", "t")
    assert read_clock(np.arange(2000) * 4e-3, tmp_path / "run.csv", "t").step == pytest.approx(4e-3)


def test_a_clock_of_a_microsecond_is_kept(tmp_path):
    assert len(read_clock(np.arange(2000) * 1.1e-6, tmp_path / "run.csv", "t").rows) == 2000


def bolts(size: str, **keys: Any) -> dict[str, Any]:
    return {"bolt": {"size": size, "count": 8, **keys}}


JOINTS = {
    "micro gantry: slide of 5 mm": {
        "torque_max": 0.2, "velocity_max": 0.05, "acceleration_max": 20.0, "rotor_inertia": 1e-3,
        "position_lower": -0.0025, "position_upper": 0.0025, "coulomb": 1e-4, "hysteresis": 1e-8,
    },
    "gantry of 40 m": {
        "torque_max": 3e4, "velocity_max": 4.0, "position_lower": -20.0, "position_upper": 20.0,
        "rotor_inertia": 800.0, "viscous": 2e4,
    },
    "palletiser of 500 kg": {
        "torque_max": 2e4, "velocity_max": 1.5, "acceleration_max": 3.0, "jerk_max": 20.0,
        "rotor_inertia": 900.0, "coulomb": 400.0, "viscous": 1500.0, "damping": 3000.0,
    },
    "crane-like arm": {"torque_max": 4e5, "velocity_max": 0.2, "rotor_inertia": 4e4},
    "SCARA, quill": {"torque_max": 8.0, "velocity_max": 60.0, "acceleration_max": 2000.0},
    "delta": {"torque_max": 12.0, "velocity_max": 25.0, "acceleration_max": 1500.0},
    "UR-like": {"torque_max": 330.0, "velocity_max": 2.09, "position_lower": -6.2832,
                "position_upper": 6.2832},
    "wrist of two turns": {"torque_max": 9.0, "position_lower": -12.6, "position_upper": 12.6},
    "soft arm": {"torque_max": 0.05, "velocity_max": 3.0, "damping": 1e-3, "hysteresis": 0.15},
    "micro manipulator": {"torque_max": 1e-5, "rotor_inertia": 1e-10, "coulomb": 1e-7},
    "dental arm": {"torque_max": 0.4, "velocity_max": 0.5, "jerk_max": 40.0},
}  # fmt: skip
ELEMENTS = {
    "soft arm: a tendon": {"type": "constant", "stiffness": 0.02},
    "series elastic": {"type": "constant", "stiffness": 5.0},
    "slewing ring": {"type": "constant", "stiffness": 5e8},
    "reducer of a micro drive": {
        "type": "reducer", "K1": 1.2, "K2": 1.6, "K3": 2.0, "T1": 0.004, "T2": 0.012,
    },
    "reducer of a palletiser": {
        "type": "reducer", "K1": 2e6, "K2": 4e6, "K3": 5e6, "T1": 300.0, "T2": 12000.0,
    },
    "shaft of 1 mm": {"type": "shaft", "diameter": 1e-3, "length": 0.01},
    "shaft of a gantry, 1.4 m": {"type": "shaft", "diameter": 0.05, "length": 1.4},
    "shaft of PEEK": {
        "type": "shaft", "diameter": 0.01, "length": 0.1, "shear_modulus": 1.3e9,
    },
    "shaft of silicone": {
        "type": "shaft", "diameter": 0.02, "length": 0.05, "shear_modulus": 3e5,
    },
    "belt of 3 mm pitch, 6 mm wide": {
        "type": "timing_belt", "profile": "HTD3M", "teeth": 12, "width": 0.006,
        "span_length": 0.02, "preload": 2.0, "ratio": 3.0,
    },
    "watch gears of module 0.1": {
        "type": "gear_pair", "module": 1e-4, "teeth": 12, "teeth_driven": 60, "face_width": 5e-4,
        "surface": "fine_steel", "ratio": 500.0,
    },
    "slewing gear of module 20": {
        "type": "gear_pair", "module": 0.02, "teeth": 15, "teeth_driven": 140, "face_width": 0.2,
        "surface": "fine_steel", "ratio": 9.3,
    },
    "servo of 1 in 1000": {"type": "constant", "stiffness": 3.0, "ratio": 1000.0},
    "M3": {
        "type": "bolted_flange", "inner_radius": 0.004, "outer_radius": 0.009,
        "surface": "fine_steel", "preload": 900.0,
        **bolts("M3", circle_diameter=0.013, clamp_length=0.0015, engagement=0.002),
    },
    "M20 in a ring of 1.2 m": {
        "type": "bolted_flange", "inner_radius": 0.5, "outer_radius": 0.7,
        "surface": "fine_steel", "preload": 2e5, "friction": 0.6,
        **bolts("M20", circle_diameter=1.2, clamp_length=0.18),
    },
}  # fmt: skip
OTHERS = {
    "oiled and molybdenum": {"tightening": {"thread_friction": 0.04, "head_friction": 0.03}},
    "unlubricated stainless": {"tightening": {"thread_friction": 0.35, "friction_highest": 0.6}},
    "rough castings settle": {"tightening": {"embedding": 6e-5, "scatter": 4.0}},
    "lapped faces hardly settle": {"tightening": {"embedding": 1e-7, "temperature_change": 0}},
    "a cryogenic cell": {"tightening": {"temperature_change": 190}},
}


@pytest.mark.parametrize("name", JOINTS)
def test_unusual_joints_are_taken(name):
    sliding = "gantry" in name
    joint = read(robot_file_schema(), **robot(JOINTS[name])).joint[0]
    for key, dimension in {
        "torque_max": "torque", "velocity_max": "angular velocity",
        "acceleration_max": "angular acceleration", "jerk_max": "angular jerk",
        "position_upper": "angle", "rotor_inertia": "inertia", "viscous": "viscous friction",
    }.items():  # fmt: skip
        value = getattr(joint, key)
        if value is not None:
            assert fit_joint(value, sliding, dimension, key) == JOINTS[name].get(key, 0.0)


@pytest.mark.parametrize("name", ELEMENTS)
def test_unusual_elements_are_taken(name):
    element = {"name": "one", **ELEMENTS[name]}
    (joint,) = read(robot_file_schema(), **robot({"element": [element]})).joint
    assert joint.element[0].name == "one"


@pytest.mark.parametrize("name", OTHERS)
def test_unusual_tightening_is_taken(name):
    assert read(Parts, **OTHERS[name]).tightening is not None


def test_a_bolt_of_ones_own_from_m1_to_m64_is_taken():
    part = CatalogueFile.model_fields["bolt"].annotation.__args__[0]
    m1 = dict(zip(("diameter", "pitch", "head_diameter", "bearing_diameter", "hole"),
                  (1e-3, 2.5e-4, 2e-3, 1.8e-3, 1.1e-3), strict=True))  # fmt: skip
    m64 = {key: 64.0 * value for key, value in m1.items()} | {"pitch": 6e-3}
    for size, lengths in {"M1": m1, "M64": m64}.items():
        assert read(part, size=size, **lengths).entry()["stress_area"] > 0.0


@pytest.mark.parametrize("path", sorted(PROBLEMS.rglob("*.toml")), ids=lambda path: path.stem)
def test_shipped_files_are_taken(path):
    content = load_toml(path)
    kind = content.get("kind", "recordings")
    validate(file_models()[kind], content, path)
