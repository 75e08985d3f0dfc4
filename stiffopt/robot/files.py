"""Loading of robots: shipped ones by name, robot TOML files, URDFs, MJCFs."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from stiffopt.declaration import bounds, unit
from stiffopt.drivetrain import catalogue
from stiffopt.drivetrain.bearing import ElasticMount, OutputBearing
from stiffopt.drivetrain.tables import OwnEntries
from stiffopt.errors import InputError, InputFileError, nearest
from stiffopt.files import apply_changes, check_header, load_toml
from stiffopt.robot.body_tree import body_tree
from stiffopt.robot.elements import Cited, ElementBuilder, locate_errors
from stiffopt.robot.frames import LinkFrame, link_frame, link_names
from stiffopt.robot.joint_load import supporting_joints
from stiffopt.robot.link_shapes import read_link_shapes
from stiffopt.robot.mjcf import MJCF_ENDINGS, is_mjcf
from stiffopt.robot.robot import Robot, Source
from stiffopt.robot.schema import JointSection, PlaceSection, RobotFile, robot_file_schema
from stiffopt.robot.urdf import UNLIMITED, LinkBody, load_urdf
from stiffopt.units import fit_joint
from stiffopt.validation import validate

# Usual names of the link at the mechanical interface; the first match is used. Where a URDF of
# ROS-Industrial has both, tool0 has the axes of the controller, z outward; x is it of its flange.
_FLANGE_LINKS = ("tool0", "flange", "ee_link")


def shipped_robots() -> list[str]:
    """Names of the robots of the package."""
    folder = resources.files("stiffopt.robot").joinpath("data")
    return sorted(p.name for p in folder.iterdir() if p.joinpath("robot.toml").is_file())


def robot_path(source: str | os.PathLike[str]) -> Path:
    """Return the file of a robot given by a shipped name or a path.

    Raises `InputError`: neither a shipped robot nor a file.
    """
    if str(source) in shipped_robots():
        source = str(resources.files("stiffopt.robot").joinpath("data", str(source), "robot.toml"))
    path = Path(source)
    if path.suffix == "" and not path.exists():
        raise InputError(
            f"no robot {str(source)!r}: neither a shipped robot nor a file. "
            f"{nearest(str(source), shipped_robots())} Or give the path of a robot TOML or URDF."
        )
    return path


def load_robot(
    source: str | os.PathLike[str],
    drivetrain: str | os.PathLike[str] | None = None,
    *,
    keep: Collection[str] = (),
    changes: Sequence[str] = (),
) -> Robot:
    """Load a robot by name or from files.

    Parameters
    ----------
    source : str or path
        A shipped robot ("er3a_c60"), a robot TOML, a URDF or an MJCF.
    drivetrain : path, optional
        Robot TOML for a URDF given as `source`; its own `urdf` key is then not needed. Without
        it, the joints of a URDF are rigid and only its limits apply.
    keep : collection of str
        Joints that are not fixed although they do not lead to the tool.
    changes : sequence of str
        Entries of the TOML to be changed, such as "joint[1].damping=3".

    Returns
    -------
    Robot
        Limits, friction and rotor inertia that the TOML omits are those of the URDF or MJCF;
        omitted limits of acceleration and jerk, and those that an MJCF omits, are infinite.
    """
    path = robot_path(source)
    bare = path.suffix.lower() in (".urdf", *MJCF_ENDINGS)
    if bare and drivetrain is None:
        if changes:
            raise InputFileError(path, "--set", "a URDF has no entries to change: give a TOML.")
        document = RobotFile(schema=1, kind="robot", name=path.stem)
        return _assemble_robot(document, path, path, keep)
    own = Path(drivetrain) if bare and drivetrain is not None else path
    data = apply_changes(load_toml(own), changes, own)
    entries = _read_own_entries(data, own)
    with catalogue.with_own(entries):
        document = _validate_document(data, own)
        if not bare and document.urdf is None:
            raise InputFileError(
                own, "urdf", "this key is required and missing: path of the URDF or MJCF."
            )
        urdf = path if bare else own.parent / str(document.urdf)
        return replace(_assemble_robot(document, own, urdf, keep), own=entries)


def _read_own_entries(data: Mapping[str, Any], path: Path) -> OwnEntries:
    """Read the user's catalogue named by a robot file; empty without one."""
    named = data.get("catalogue")
    if not isinstance(named, str):
        return {}
    # Imported here, since its sections load slowly and few robots have a catalogue.
    from stiffopt.robot.own_catalogue import read_own_catalogue

    return read_own_catalogue(path.parent / named)


def load_own_entries(source: object, folder: Path) -> OwnEntries:
    """Load the user's catalogue of a robot that another file names.

    Empty for a shipped robot, or one that cannot be read, which `load_robot` reports.
    """
    if not isinstance(source, str) or source in shipped_robots():
        return {}
    path = folder / source
    if path.suffix.lower() != ".toml" or not path.is_file():
        return {}
    return _read_own_entries(load_toml(path), path)


def _validate_document(data: Mapping[str, Any], path: Path) -> RobotFile:
    check_header(data, path, "robot")
    return validate(robot_file_schema(), data, path)


def _assemble_robot(document: RobotFile, path: Path, urdf: Path, keep: Collection[str]) -> Robot:
    loaded = load_urdf(
        urdf,
        lock=document.lock,
        tip=None if document.tool is None else document.tool.link,
        keep={*keep, *(section.name for section in document.joint)},
        limited=None
        if is_mjcf(urdf)
        else {
            section.name
            for section in document.joint
            if section.position_lower is not None and section.position_upper is not None
        },
        bodies=_stated_bodies(document, path),
    )
    model, moving = loaded.model, loaded.joints
    names = tuple(model.names)[1:]
    prismatic = body_tree(model).prismatic
    sections = _joint_sections(document, names, path)
    limits = [
        _joint_numbers(section, bool(prismatic[j]), moving[names[j]], path, loaded.format)
        for j, section in enumerate(sections)
    ]
    columns: dict[str, Any] = {key: np.array([row[key] for row in limits]) for key in limits[0]}
    lower, upper = _position_limits(model, sections, prismatic, path)
    builder = ElementBuilder(path, document.assembly, document.surface)
    chains = tuple(
        builder.chain(section, float(columns["torque_max"][j]), bool(prismatic[j]))
        for j, section in enumerate(sections)
    )
    bearings = tuple(_build_bearing(section, path) for section in sections)
    with locate_errors(path, "tool"):
        place = document.tool or PlaceSection(link=default_tool_link(model))
        tool = link_frame(model, place.link, place.offset, place.rpy)
    with locate_errors(path, "flange"):
        flange = _flange_frame(model, document.flange, place.link)
    links = tuple(_build_link(s, j, model, flange, path) for j, s in enumerate(sections))
    model.name = document.name
    return Robot(
        name=document.name,
        title=document.title or document.name,
        model=model,
        position_lower=lower,
        position_upper=upper,
        chains=chains,
        bearings=bearings if any(bearings) else (),
        links=links if any(links) else (),
        tool=tool,
        flange=flange,
        sources=tuple(_list_sources(document)),
        shapes=read_link_shapes(urdf),
        urdf=urdf,
        held=loaded.held,
        **columns,
    )


def _build_bearing(section: JointSection, path: Path) -> OutputBearing | None:
    if section.bearing is None:
        return None
    with locate_errors(path, f"joint[{section.name}].bearing"):
        return section.bearing.bearing()


def _build_link(
    section: JointSection, joint: int, model: pin.Model, flange: LinkFrame, path: Path
) -> ElasticMount | None:
    """Return the springs of a bending link, up to the next joint towards the flange."""
    if section.beam is None:
        return None
    with locate_errors(path, f"joint[{section.name}].beam"):
        number = flange.joint
        while number > 0 and model.parents[number] != joint + 1:
            number = model.parents[number]
        if number == 0:
            raise InputError(
                "no joint follows towards the flange: a beam is the link from a joint to the next."
            )
        bodies = body_tree(model).bodies
        return section.beam.beam().mount(
            bodies[joint].axis, bodies[number - 1].translation, number - 1
        )


def _stated_bodies(document: RobotFile, path: Path) -> dict[str, LinkBody]:
    """Bodies of links that the file gives."""
    found: dict[str, LinkBody] = {}
    for section in document.link:
        if section.name in found:
            raise InputFileError(path, f"link[{section.name}]", "is given twice. Keep one.")
        moments = np.sort(section.inertia)
        if moments[0] < 0.0 or moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-9):
            raise InputFileError(
                path,
                f"link[{section.name}].inertia",
                f"{list(section.inertia)} belongs to no body: none may be below 0, none above the"
                " sum of the other two.",
            )
        found[section.name] = LinkBody(
            mass=section.mass, com=np.array(section.com), inertia=np.diag(section.inertia)
        )
    return found


def _joint_sections(document: RobotFile, names: tuple[str, ...], path: Path) -> list[JointSection]:
    """One section per moving joint in the model's order; an empty one where the file has none."""
    given: dict[str, JointSection] = {}
    for section in document.joint:
        where = f"joint[{section.name}]"
        if section.name not in names and section.name in document.lock:
            problem = "`lock` holds this joint. Remove it there to let it move, or this section."
            raise InputFileError(path, f"{where}.name", problem)
        if section.name not in names:
            raise InputFileError(
                path,
                f"{where}.name",
                f"the robot has no moving joint {section.name!r}. {nearest(section.name, names)}",
            )
        if section.name in given:
            raise InputFileError(path, where, "this joint is given twice. Keep one.")
        given[section.name] = section
    return [given.get(name, JointSection(name=name)) for name in names]


# Key, attribute of the URDF, default value; None: required.
_JOINT_NUMBERS: tuple[tuple[str, str, float | None], ...] = (
    ("torque_max", "effort", None),
    ("velocity_max", "velocity", None),
    ("acceleration_max", "", np.inf),
    ("jerk_max", "", np.inf),
    ("rotor_inertia", "armature", 0.0),
    ("coulomb", "friction", 0.0),
    ("viscous", "damping", 0.0),
    ("damping", "", np.nan),
    ("hysteresis", "", 0.0),
)


def _joint_numbers(
    section: JointSection, prismatic: bool, urdf: dict[str, float], path: Path, format_: str
) -> dict[str, float]:
    values = {}
    for key, fallback, default in _JOINT_NUMBERS:
        with locate_errors(path, f"joint[{section.name}].{key}"):
            given = getattr(section, key)
            if given is not None:
                values[key] = fit_joint(given, prismatic, unit(JointSection, key).dimension)
            elif number := urdf.get(fallback, 0.0):
                bounds(JointSection, key).check(key, number)
                values[key] = number
            elif default is None and format_ == "MJCF":
                # MuJoCo has no limits of velocity, and drives without limit.
                values[key] = np.inf
            elif default is None:
                raise InputError(
                    f"is missing, and the URDF has no {fallback} for it. Give {key} in a robot file"
                    f" (`stiffopt init robot {path.name}` estimates it for one)."
                    if path.suffix != ".toml"
                    else f"is missing, and the URDF has no {fallback} for it. Give {key}."
                )
            else:
                values[key] = default
    return values


def _position_limits(
    model: pin.Model, sections: list[JointSection], prismatic: np.ndarray, path: Path
) -> tuple[np.ndarray, np.ndarray]:
    lower = np.array(model.lowerPositionLimit, dtype=float)
    upper = np.array(model.upperPositionLimit, dtype=float)
    lower[lower <= -UNLIMITED], upper[upper >= UNLIMITED] = -np.inf, np.inf
    for j, section in enumerate(sections):
        for key, limits in (("position_lower", lower), ("position_upper", upper)):
            given = getattr(section, key)
            if given is not None:
                with locate_errors(path, f"joint[{section.name}].{key}"):
                    limits[j] = fit_joint(given, bool(prismatic[j]), "angle")
        if not lower[j] < upper[j]:
            raise InputFileError(
                path,
                f"joint[{section.name}]",
                f"position_lower = {lower[j]:g} must be below position_upper = {upper[j]:g}.",
            )
    return lower, upper


def default_tool_link(model: pin.Model) -> str:
    """Last link of the longest chain, the default for payloads and tools."""
    end = max(range(1, model.njoints), key=lambda j: (len(supporting_joints(model, j)), j))
    moving = [f.name for f in model.frames if f.parentJoint == end]
    links = [name for name in link_names(model) if name in moving]
    return next((name for name in _FLANGE_LINKS if name in links), links[0])


def _flange_frame(model: pin.Model, section: PlaceSection | None, tool_link: str) -> LinkFrame:
    if section is not None:
        return link_frame(model, section.link, section.offset, section.rpy)
    named = [name for name in _FLANGE_LINKS if name in link_names(model)]
    return link_frame(model, named[0] if named else tool_link)


def _list_sources(document: RobotFile) -> Iterable[Source]:
    yield from _section_sources(document.assembly, "", "assembly")
    for name, surface in document.surface.items():
        yield from _section_sources(surface, "", f"surface {name}")
    for name in sorted(_surfaces_used(document) - set(document.surface)):
        entry = catalogue.surface_entry(name)
        yield Source("", f"surface {name}", "", entry.provenance, entry.source)
    for link in document.link:
        yield from _section_sources(link, "", f"link {link.name}")
    for joint in document.joint:
        yield from _section_sources(joint, joint.name, "")
        if joint.bearing is not None:
            yield from _section_sources(joint.bearing, joint.name, "bearing")
        if joint.beam is not None:
            yield from _section_sources(joint.beam, joint.name, "beam")
        for element in joint.element:
            yield from _section_sources(element, joint.name, element.name)


def _surfaces_used(document: RobotFile) -> set[str]:
    elements = [element for joint in document.joint for element in joint.element]
    return {str(e.surface) for e in elements if hasattr(e, "surface")}


def _section_sources(section: Cited, joint: str, element: str) -> Iterable[Source]:
    """Sources of a section: as a whole, then keys that are estimates."""
    provenance: str = section.provenance
    source, estimated = section.source, section.estimated
    name = getattr(section, "catalogue", None)
    if name is not None and "provenance" not in section.model_fields_set:
        entry = catalogue.entry(name)
        provenance, source, estimated = entry.provenance, entry.source, entry.estimated
    keys = sorted(
        section.model_fields_set
        - {"name", "type", "element", "bearing", "beam", "provenance", "source"}
    )
    if keys:
        yield Source(joint, element, ", ".join(keys), provenance, source)
    for key in estimated:
        yield Source(joint, element, key, "estimated", source)
