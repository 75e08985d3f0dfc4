"""Bolts, set screws and hub materials of a robot file."""

import pytest

from stiffopt import load_robot
from stiffopt.connection import Bolt, SetScrew
from stiffopt.errors import InputError

URDF = """<robot name="one"><link name="base"/><link name="arm"><inertial><mass value="2"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="50" velocity="3"/></joint></robot>"""

ROBOT = """schema = 1
kind = "robot"
name = "one"
urdf = "one.urdf"
[[joint]]
name = "turn"
[[joint.element]]
name = "pins"
type = "clamping_pins"
ratio = 50
count = 2
shaft_diameter = "8 mm"
tip_diameter = "2 mm"
preload = "1.5 kN"
surface = "fine_steel"
{screw}
[[joint.element]]
name = "key"
type = "key"
ratio = 50
shaft_diameter = "14 mm"
width = "5 mm"
height = "5 mm"
length = "20 mm"
surface = "fine_steel"
{hub}
[[joint.element]]
name = "flange"
type = "bolted_flange"
{flange}
surface = "fine_steel"
"""
GIVEN = """inner_radius = "10 mm"
outer_radius = "20 mm"
preload = "7 kN"
bolt = {{ size = "M5", count = 9, circle_diameter = "30 mm"{more} }}"""


@pytest.fixture
def load(tmp_path):
    def read(*, screw="", hub="", flange='pattern = "flexspline_25"'):
        (tmp_path / "one.urdf").write_text(URDF)
        path = tmp_path / "one.toml"
        path.write_text(ROBOT.format(screw=screw, hub=hub, flange=flange))
        return load_robot(path).chains[0].elements

    return read


def test_omitted_fasteners_have_defaults(load):
    elements = load()
    assert elements["pins"].screw is None
    assert elements["key"].hub_material == "steel"
    # A pattern of the catalogue has the maker's 12.9 screws.
    assert elements["flange"].bolt == Bolt(size="M5", grade="12.9")
    # It is bought: its holes are where they are, and its preload is what remains of the maker's.
    assert elements["flange"].fixed_pattern
    assert elements["flange"].preload_is == "net"
    assert elements["flange"].tightening_torque == 9.0


def test_given_fasteners_are_used(load):
    more = (
        ', grade = "10.9", clamp_length = "8 mm", engagement = "10 mm",'
        ' head_material = "aluminium", thread_material = "iron"'
    )
    elements = load(
        screw='screw = { size = "M5", length = "8 mm", shaft_material = "steel_45" }',
        hub='hub_material = "iron"',
        flange=GIVEN.format(more=more),
    )
    assert elements["pins"].screw == SetScrew(size="M5", length=8e-3, shaft_material="steel_45")
    assert elements["key"].hub_material == "iron"
    assert elements["flange"].bolt == Bolt(
        size="M5",
        grade="10.9",
        clamp_length=8e-3,
        engagement=10e-3,
        head_material="aluminium",
        thread_material="iron",
    )
    assert elements["flange"].sectors == 1


@pytest.mark.parametrize(
    ("where", "changes", "text"),
    [
        ("flange", {"more": ', grade = "12.8"'}, "no bolt grade '12.8'.*Did you mean '12.9'"),
        ("flange", {"more": ', head_material = "alu"'}, "no clamped material 'alu'.*aluminium"),
        ("flange", {"more": ', thread_material = "stel"'}, "Did you mean 'steel'"),
        ("flange", {"more": ', clamp_length = "-8 mm"'}, "clamp_length = -0.008 cannot be used"),
        ("flange", {"more": ', clamp_lenght = "8 mm"'}, "clamp_length"),
        ("flange", {"more": ', engagement = "8 N"'}, "engagement"),
        ("pins", {"screw": 'screw = { size = "M7" }'}, "no set screw 'M7'.*M6"),
        (
            "pins",
            {"screw": 'screw = { size = "M4", shaft_material = "hardened" }'},
            "Did you mean 'hardened_steel'",
        ),
        ("pins", {"screw": 'screw = { length = "6 mm" }'}, "size"),
        ("key", {"hub": 'hub_material = "aluminum"'}, "Did you mean 'aluminium'"),
        (
            "key",
            {"hub": 'shaft_flank_height = "3 mm"\nhub_flank_height = "2.3 mm"'},
            "5.3 mm together, the key is 5 mm high",
        ),
        ("flange", {"more": ', rolled = "never"'}, "rolled"),
    ],
)
def test_wrong_fasteners_are_refused(load, where, changes, text):
    more = changes.pop("more", None)
    if more is not None:
        changes["flange"] = GIVEN.format(more=more)
    with pytest.raises(InputError, match=rf"(?s)one\.toml.*{where}.*{text}"):
        load(**changes)


def test_unknown_bolt_size_lists_known_ones(load):
    flange = GIVEN.format(more="").replace("M5", "M7")
    with pytest.raises(InputError, match=r"no bolt 'M7' in the catalogue.*M3, M4, M5, M6, M8"):
        load(flange=flange)


@pytest.mark.parametrize("name", ["er3a_c60", "er3a_c60_contact"])
def test_pins_of_the_shipped_robots_name_their_screws(name):
    chains = load_robot(name).chains
    screws = [e.screw for c in chains for e in c.elements.values() if e.kind == "clamping_pins"]
    assert screws == 3 * [SetScrew(size="M4")]
