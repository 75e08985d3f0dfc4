"""A connection is one class: read from robot files; in schema, reference, figures, sources."""

import subprocess
import sys

from stiffopt.connection.connection import connection_kinds
from stiffopt.report.common.citations import cited

# In a process of its own, because a class cannot be taken back.
PROGRAM = """
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from stiffopt import load_robot
from stiffopt.connection import LinearConnection
from stiffopt.declaration import POSITIVE, Doc, Force, Length
from stiffopt.errors import InputError
from stiffopt.report.common.citations import robot_references
from stiffopt.report.common.robot import element_colour
from stiffopt.report.file_reference import reference_page
from stiffopt.robot.schema import robot_file_schema


@dataclass(frozen=True, kw_only=True)
class LeafSpring(LinearConnection):
    \"\"\"Leaf at the end of a lever.\"\"\"

    kind: ClassVar[str] = "leaf_spring"
    references: ClassVar[tuple[str, ...]] = ("Kelly2017",)
    force_at_break: Annotated[Force, POSITIVE, Doc("Force at which the leaf breaks.")]
    lever: Annotated[Length, POSITIVE, Doc("Lever of the leaf.")] = 0.1
    ends: Annotated[Literal["held", "free"], Doc("How the leaf is held.")] = "held"

    @property
    def compliance(self):
        return 1e-3 * self.lever**2


robot = '''
schema = 1
kind = "robot"
name = "one"
urdf = "one.urdf"
[[joint]]
name = "turn"
[[joint.element]]
name = "leaf"
type = "leaf_spring"
ratio = 2
force_at_break = "{force}"
lever = "50 mm"
'''
urdf = '''<robot name="one"><link name="base"/><link name="arm"><inertial><mass value="2"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="50" velocity="3"/></joint></robot>'''
open("one.urdf", "w").write(urdf)
open("one.toml", "w").write(robot.format(force="2 kN"))
leaf = load_robot("one.toml").chains[0].elements["leaf"]
assert leaf == LeafSpring(name="leaf", torque_max=25.0, force_at_break=2000.0, lever=0.05), leaf
assert [each.key for each in robot_references(load_robot("one.toml"))] == ["Kelly2017"]
assert element_colour("leaf_spring").startswith("#")

open("one.toml", "w").write(robot.format(force="-2 kN"))
for make in (lambda: load_robot("one.toml"), lambda: LeafSpring(torque_max=1, force_at_break=-2e3)):
    try:
        make()
    except InputError as error:
        sentence = "force_at_break = -2000 cannot be used; allowed is a finite number above 0."
        assert sentence in str(error), error
    else:
        raise AssertionError("accepted")

schema = robot_file_schema().model_json_schema()["$defs"]["LeafSpringSection"]
assert schema["description"] == "Leaf at the end of a lever."
assert schema["properties"]["lever"]["unit"] == "m"
assert schema["properties"]["lever"]["description"] == "Lever of the leaf."
assert schema["properties"]["lever"]["anyOf"][0]["exclusiveMinimum"] == 0.0
assert schema["properties"]["ends"]["enum"] == ["held", "free"]
assert "force_at_break" in schema["required"]

page = reference_page()
assert '### `[[joint.element]]`, `type = "leaf_spring"`' in page
row = "| `force_at_break` | number above 0 | N | up to 1e+07 | required | Force at which the leaf "
assert row in page
"""


def test_connection_is_added_by_one_class(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], cwd=tmp_path, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr


def test_sources_of_connections_are_in_the_bibliography():
    for cls in connection_kinds().values():
        assert [each.key for each in cited(cls.references)] == list(cls.references)
