"""Findings of a diagnosis as changes of attributes of the MJCF that describes the robot."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stiffopt.export.mjcf_source import MjcfElement, MjcfSource
from stiffopt.export.model_format import DiagnosedRobot
from stiffopt.robot.body_tree import realisable_inertia
from stiffopt.robot.mjcf import MjcfActuator, MjcfBody, MjcfJoint, read_mjcf
from stiffopt.units import joint_unit

# Relative change from which a value is another: robot files round to six digits.
_MIN_RELATIVE_CHANGE = 1e-5
_WRITTEN_DIGITS = 8
# Attribute of a joint, the robot's value, unit of a hinge.
_JOINT_VALUES = (
    ("frictionloss", "coulomb", "N m"),
    ("damping", "viscous", "N m s/rad"),
    ("armature", "rotor_inertia", "kg m^2"),
)
# Rows and columns of `fullinertia`, and the attributes that it replaces.
_FULL_ROWS, _FULL_COLUMNS = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
_OTHER_INERTIA_ATTRIBUTES = ("diaginertia", "quat", "axisangle", "xyaxes", "zaxis", "euler")


@dataclass(frozen=True, kw_only=True)
class AttributeChange:
    """Changed attribute of an element."""

    file: str
    line: int  # of the element, in the file as it was
    # Such as "joint", "elbow", "frictionloss".
    element: str
    name: str
    attribute: str
    # In the units of the file; the old value may be that of a default class or of shapes.
    old: str
    new: str
    unit: str


@dataclass(frozen=True, kw_only=True)
class ChangedMjcf:
    """Files of an MJCF with the findings."""

    # By path: of the file and its includes, in the folder that holds all of them.
    contents: dict[str, bytes]
    changes: tuple[AttributeChange, ...]
    left_out: tuple[str, ...]  # findings that the file cannot take, a sentence each


def change_mjcf(found: DiagnosedRobot, path: Path) -> ChangedMjcf:
    """Return an MJCF with the values of a diagnosed robot, comments and formatting kept."""
    editor = _Editor(found, path)
    for j, name in enumerate(found.robot.joint_names):
        editor.change_joint(j, editor.model.joints[name])
        editor.change_body(j, editor.model.joints[name])
        editor.change_drives(j, name)
    return ChangedMjcf(
        contents=editor.source.contents(),
        changes=tuple(editor.changes),
        left_out=tuple(editor.left_out),
    )


class _Editor:
    """Changes of one MJCF, and the table of them."""

    def __init__(self, found: DiagnosedRobot, path: Path) -> None:
        self.found = found
        self.model, self.source = read_mjcf(path), MjcfSource(path)
        self.changes: list[AttributeChange] = []
        self.left_out: list[str] = []

    def change_joint(self, j: int, joint: MjcfJoint) -> None:
        """Change friction, armature and reference of a joint."""
        element, robot = self.source.element("joint", joint.name), self.found.robot
        slides = joint.kind == "slide"
        rows = [
            (key, getattr(joint, key), float(getattr(robot, value)[j]), joint_unit(unit, slides))
            for key, value, unit in _JOINT_VALUES
        ]
        rows = [row for row in rows if _is_changed(row[1], row[2])]
        shift = -float(self.found.zeros[j])
        texts = {
            key: (_format_number(old), _format_number(new), unit) for key, old, new, unit in rows
        }
        if shift != 0.0:
            texts |= dict(self._shifted_positions(joint, shift))
        if element is None and texts:
            self._leave_out("joint", joint.name, texts)
        elif element is not None:
            self._apply_change(element, "joint", joint.name, texts)

    def _shifted_positions(
        self, joint: MjcfJoint, shift: float
    ) -> Iterator[tuple[str, tuple[str, str, str]]]:
        """Yield the positions of a joint with a zero that lies elsewhere.

        The joint stands as before at other readings: reference, end stops and relaxed spring move.
        """
        turns = joint.kind == "hinge"
        unit = ("deg" if self.model.degrees else "rad") if turns else "m"
        factor = math.degrees(1.0) if unit == "deg" else 1.0
        positions: dict[str, tuple[float, ...]] = {"ref": (joint.reference,)}
        if joint.limits is not None:
            positions["range"] = joint.limits
        if joint.stiffness != 0.0:
            positions["springref"] = (joint.spring_reference,)
        for key, values in positions.items():
            old, new = (
                " ".join(_format_number(factor * (value + by)) for value in values)
                for by in (0.0, shift)
            )
            yield key, (old, new, unit)

    def change_body(self, j: int, joint: MjcfJoint) -> None:
        """Add the change of all that a joint carries to its body."""
        before, after = (
            each.tree.bodies[j].inertial_parameters
            for each in (self.found.nominal, self.found.robot)
        )
        change = after - before
        if not (np.abs(change) > _MIN_RELATIVE_CHANGE * np.abs(before).max()).any():
            return
        body = next(each for each in self.model.bodies if each.name == joint.body)
        element = self.source.element("body", body.name)
        mass, centre, inertia = _add_inertia(body, change, joint.anchor)
        texts = {
            "mass": (_format_number(body.mass), _format_number(mass), "kg"),
            "pos": (_format_numbers(body.centre), _format_numbers(centre), "m"),
            "fullinertia": (
                _format_inertia(body.inertia),
                _format_inertia(realisable_inertia(inertia)),
                "kg m^2",
            ),
        }
        reason = ""
        if joint.name != body.joints[-1]:
            reason = "several joints move it, and the change is before the last"
        elif not mass > 0.0:
            reason = f"it would have {mass:.4g} kg: another part behind the joint has to change"
        elif self.model.shaped:
            reason = 'inertiafromgeom="true" of <compiler> takes its mass from shapes'
        if reason or element is None:
            self._leave_out("body", body.name, texts, reason)
            return
        inertial = self.source.element("inertial", body.name)
        self._record_change(inertial or element, "inertial", body.name, texts)
        new = {key: text for key, (_, text, _) in texts.items()}
        if inertial is None:
            self.source.add_inertial(element, new)
        else:
            self.source.change(inertial, new | dict.fromkeys(_OTHER_INERTIA_ATTRIBUTES))

    def change_drives(self, j: int, joint: str) -> None:
        """Set the gains of the drives of a joint, and multiply their torque by its error."""
        factor, kp, kv = (
            float(x[j]) for x in (self.found.gain, self.found.stiffness, self.found.damping)
        )
        for drive in self.model.actuators:
            if drive.joint != joint:
                continue
            element = self.source.element("actuator", drive.name)
            gains = tuple(
                factor * own if math.isnan(new) else new / drive.gear**2
                for own, new in ((-drive.bias[1], kp), (-drive.bias[2], kv))
            )
            tag = "" if element is None else element.tag
            pairs = _drive_attributes(drive, tag, factor, gains)
            texts = {
                key: (_format_numbers(old), _format_numbers(new), "")
                for key, (old, new) in pairs.items()
                if any(map(_is_changed, old, new))
            }
            if element is not None and texts:
                self._apply_change(element, tag, drive.name, texts)
                if "kv" in texts:
                    # The other way to give the velocity gain.
                    self.source.change(element, {"dampratio": None})
            if tag == "motor" and not math.isnan(kp):
                self.left_out.append(
                    f"the actuator {drive.name!r} is a motor: the gains of its controller, kp ="
                    f" {kp:.6g} and kv = {kv:.6g}, are outside the file"
                )
            elif factor != 1.0 and not pairs:
                self.left_out.append(
                    f"torque of the actuator {drive.name!r}: multiply it by {factor:.6g}"
                )

    def _apply_change(
        self, element: MjcfElement, kind: str, name: str, texts: dict[str, tuple[str, str, str]]
    ) -> None:
        self._record_change(element, kind, name, texts)
        self.source.change(element, {key: new for key, (_, new, _) in texts.items()})

    def _record_change(
        self, element: MjcfElement, kind: str, name: str, texts: dict[str, tuple[str, str, str]]
    ) -> None:
        self.changes += [
            AttributeChange(
                file=element.file,
                line=element.line,
                element=kind,
                name=name,
                attribute=key,
                old=old,
                new=new,
                unit=unit,
            )
            for key, (old, new, unit) in texts.items()
        ]

    def _leave_out(
        self, kind: str, name: str, texts: dict[str, tuple[str, str, str]], reason: str = ""
    ) -> None:
        values = ", ".join(
            f"{key} {old} -> {new} {unit}" for key, (old, new, unit) in texts.items()
        )
        reason = reason or "the file has no element of this name; give it one, or set it by hand"
        self.left_out.append(f"{kind} {name!r}, {values}: {reason}")


def _drive_attributes(
    drive: MjcfActuator, tag: str, factor: float, gains: tuple[float, ...]
) -> dict[str, tuple[tuple[float, ...], tuple[float, ...]]]:
    """Return old and new attributes of an actuator that set its torque or gains."""
    if tag == "motor":
        return {"gear": ((drive.gear,), (factor * drive.gear,))}
    kp, kv = gains
    found: dict[str, tuple[tuple[float, ...], tuple[float, ...]]] = {}
    if tag == "position":
        found = {"kp": ((drive.gain,), (kp,)), "kv": ((-drive.bias[2],), (kv,))}
    elif tag == "general" and drive.bias[1] == -drive.gain:
        # A position servo written out: force = kp ctrl - kp length - kv velocity.
        found = {
            "gainprm": ((drive.gain,), (kp,)),
            "biasprm": (drive.bias, (factor * drive.bias[0], -kp, -kv)),
        }
    if found and drive.force_range is not None:
        found["forcerange"] = drive.force_range, tuple(factor * x for x in drive.force_range)
    return found


def _add_inertia(
    body: MjcfBody, change: np.ndarray, anchor: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Return mass, centre and inertia of a body with inertial parameters (10,) added at a point."""
    added, first = float(change[0]), change[1:4]
    xx, xy, yy, xz, yz, zz = change[4:]
    about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    both = first @ anchor * np.eye(3)
    about = about + 2.0 * both - np.outer(first, anchor) - np.outer(anchor, first)
    about = about + added * _point_inertia(anchor)
    mass = body.mass + added
    if not mass > 0.0:
        return mass, body.centre, body.inertia
    centre = (body.mass * body.centre + first + added * anchor) / mass
    about = about + body.inertia + body.mass * _point_inertia(body.centre)
    return mass, centre, about - mass * _point_inertia(centre)


def _point_inertia(place: np.ndarray) -> np.ndarray:
    """Return the inertia about the origin of a unit mass at a place (3,)."""
    inertia: np.ndarray = place @ place * np.eye(3) - np.outer(place, place)
    return inertia


def _is_changed(old: float, new: float) -> bool:
    return abs(new - old) > _MIN_RELATIVE_CHANGE * max(abs(old), abs(new))


def _format_inertia(inertia: np.ndarray) -> str:
    return _format_numbers(inertia[_FULL_ROWS, _FULL_COLUMNS])


def _format_numbers(values: Iterable[float]) -> str:
    return " ".join(_format_number(value) for value in values)


def _format_number(value: float) -> str:
    return f"{float(value):.{_WRITTEN_DIGITS}g}"
