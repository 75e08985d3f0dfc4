"""Files of a bolted flange without a URDF: a one-joint robot and its preload study."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from stiffopt.declaration import PART
from stiffopt.drivetrain import catalogue
from stiffopt.drivetrain.tables import with_own
from stiffopt.errors import InputError, InputFileError, nearest
from stiffopt.robot.own_catalogue import read_own_catalogue
from stiffopt.starter.writing import relative_path, toml_number, toml_string, write_new


def write_flange(
    folder: Path,
    *,
    torque: float,
    size: str,
    grade: str,
    count: int,
    circle: float,
    nut: bool = False,
    axial_force: float = 0.0,
    shear_force: float = 0.0,
    tilting_moment: float = 0.0,
    own: Path | None = None,
) -> list[Path]:
    """Write flange.urdf, flange_robot.toml and flange.toml into a folder.

    Loads are the torque on the flange, forces along and across the axis of the bolt circle, and the
    tilting moment, magnitudes [N m], [N]; `own` is a user catalogue whose bolts take precedence.
    """
    beside_torque = {
        "axial_force": axial_force,
        "shear_force": shear_force,
        "tilting_moment": tilting_moment,
    }
    for name, value in beside_torque.items():
        if not value >= 0.0:
            raise InputError(f"--{name.replace('_', '-')} is a magnitude, got {value:g}.")
    if folder.exists() and not folder.is_dir():
        raise InputFileError(folder, "", "is a file. Give a folder as --out.")
    if tilting_moment > 0.0 and count < 3:
        raise InputError(
            f"--count: {count} bolts carry no tilting moment about every axis; give three or more."
        )
    line = "" if own is None else f"catalogue = {toml_string(relative_path(own, folder))}\n"
    with with_own({} if own is None else read_own_catalogue(own)):
        texts = _file_texts(torque, size, grade, count, circle, nut, beside_torque, line)
    return [write_new(folder / name, text) for name, text in texts.items()]


def _file_texts(
    torque: float,
    size: str,
    grade: str,
    count: int,
    circle: float,
    nut: bool,
    beside_torque: Mapping[str, float],
    catalogue_line: str,
) -> dict[str, str]:
    """Return the text of each file by its name."""
    if size not in catalogue.bolt_sizes():
        raise InputError(f"--size: no bolt {size!r}. {nearest(size, catalogue.bolt_sizes())}")
    if grade not in catalogue.bolt_grades():
        raise InputError(f"--grade: no grade {grade!r}. {nearest(grade, catalogue.bolt_grades())}")
    data = catalogue.bolt(size)
    bolt = data.diameter
    for name, value in (("--torque", torque), ("--circle", circle)):
        if not value > 0.0:
            raise InputError(f"{name} must be above 0, got {value:g}.")
    PART.check("--circle", circle)
    if count < 2:
        raise InputError("--count: one bolt presses one side of a ring only; give two or more.")
    room = circle * math.sin(math.pi / count)
    corners = catalogue.hexagon(size).corners if nut else 0.0
    wide = max(data.head_diameter, corners)
    if room < wide:
        raise InputError(
            f"--count: {count} {'heads' if wide > corners else 'nuts'} of {1e3 * wide:g} mm do not"
            f" fit on a circle of {1e3 * circle:g} mm: {1e3 * room:.3g} mm from bolt to bolt."
            " Fewer or smaller bolts, or a larger circle."
        )
    if circle <= 4.0 * bolt:
        raise InputError(f"--circle: {circle:g} m is too small for {count} bolts {size}.")
    # Widest ring for which the formulas assume uniform pressure.
    half = math.floor(min(15e3 * bolt, 7.4e3 * data.bearing_diameter)) / 1e4
    inner, outer = circle / 2.0 - half, circle / 2.0 + half
    loads = "\n".join(
        f"{name} = [{toml_number(value)}]{' ' * (17 - len(name))}# {_LOAD_COMMENTS[name]}"
        for name, value in beside_torque.items()
        if value > 0.0
    )
    return {
        "flange.urdf": _URDF_TEMPLATE.format(torque=f"{torque:g}"),
        "flange_robot.toml": _ROBOT_TEMPLATE.format(
            catalogue=catalogue_line,
            torque=toml_number(torque),
            inner=toml_number(inner),
            outer=toml_number(outer),
            size=toml_string(size),
            grade=toml_string(grade),
            count=count,
            circle=toml_number(circle),
            nut=", nut = true" if nut else "",
            # Initial guess below the capacity of the bolt; the study replaces it.
            preload=toml_number(round(0.4 * catalogue.proof_stress(grade) * data.stress_area, -1)),
        ),
        "flange.toml": _STUDY_TEMPLATE.format(
            torque=toml_number(torque), loads=loads or _NO_LOADS_TEXT
        ),
    }


_LOAD_COMMENTS = {
    "axial_force": "[N] along the axis, taken to open the joint",
    "shear_force": "[N] across the axis",
    "tilting_moment": "[N m] about axes across the flange's: opens one side",
}
_NO_LOADS_TEXT = "\n".join(
    f"# {name} = [0.0]{' ' * (15 - len(name))}# {said}" for name, said in _LOAD_COMMENTS.items()
)
_URDF_TEMPLATE = """<!-- One joint that carries the flange. -->
<robot name="flange">
<link name="base"/>
<link name="part"><inertial><mass value="1.0"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
<joint name="flange" type="revolute"><parent link="base"/><child link="part"/>
<axis xyz="0 0 1"/><limit lower="-3.14" upper="3.14" effort="{torque}" velocity="1"/></joint>
</robot>
"""
_ROBOT_TEMPLATE = """\
# The flange, written by `stiffopt init flange`. Replace values marked estimated by yours.
schema = 1
kind = "robot"
name = "flange"
urdf = "flange.urdf"
{catalogue}
[[joint]]
name = "flange"
torque_max = {torque}           # [N m], torque on the flange

[[joint.element]]
name = "flange"
type = "bolted_flange"
ratio = 1.0
inner_radius = {inner}       # [m] of the contact ring; estimated: symmetric about
outer_radius = {outer}       # the bolt circle
bolt = {{ size = {size}, grade = {grade}, count = {count}, circle_diameter = {circle}{nut} }}
surface = "fine_steel"          # `stiffopt catalogue surfaces`; estimated
friction = 0.15                 # of the faces; estimated
preload = {preload}             # [N] of one bolt, initial guess of the study
preload_is = "assumed"          # "assembly" for the present preload
provenance = "estimated"
source = "init flange"
"""
_STUDY_TEMPLATE = """# How tight must the bolts of the flange be? Written by `stiffopt init flange`.
schema = 1
kind = "preload"
title = "Flange"
robot = "flange_robot.toml"
joints = [1]

[[load_case]]
name = "largest torque"
torque = [{torque}]             # [N m], one entry a joint
{loads}

[tightening]
method = "torque_wrench"        # or angle, yield
thread_friction = 0.12
head_friction = 0.12

[[minimise]]
objective = "total_preload"

[require]
slip_safety = 1.2
bolt_utilisation = 1.0
"""
