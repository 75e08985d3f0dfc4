"""Loading of MJCFs (models of MuJoCo) as trees of links and joints in the terms of a URDF.

MuJoCo reads and compiles the file: default classes, includes, frames and compiler options are
resolved. Shapes are ignored, apart from those that give a body its mass.
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.errors import InputError, InputFileError, shortened
from stiffopt.robot.frames import rotation_about_axis, rpy_from_rotation

MJCF_ROOT = "mujoco"
# Link of the ground.
_WORLD = "world"
_INERTIA_KEYS = (("ixx", 0, 0), ("ixy", 0, 1), ("ixz", 0, 2),
                 ("iyy", 1, 1), ("iyz", 1, 2), ("izz", 2, 2))  # fmt: skip
# Elements that refer to shapes, or are none of a mechanism.
_UNUSED_ELEMENTS = (
    "sensors", "keys", "tuples", "texts", "numerics", "pairs", "excludes", "skins", "flexes",
    "cameras", "lights",
)  # fmt: skip
_UNUSED_ASSETS = ("hfields", "materials", "textures")


@dataclass(frozen=True, kw_only=True)
class MjcfActuator:
    """An actuator of MuJoCo that drives one joint, referred to the joint.

    Parameters
    ----------
    name, joint : str
    position_gain, velocity_gain : float
        `kp` [N m/rad] and `kv` [N m s/rad] of a servo; 0 of a motor.
    torque_max : float
        Largest torque at the joint [N m]; 0 for no limit.
    """

    name: str
    joint: str
    position_gain: float
    velocity_gain: float
    torque_max: float


@dataclass(frozen=True, kw_only=True)
class JointSpring:
    """A spring between the bodies of a joint: stiffness [N m/rad], offset [rad]."""

    stiffness: float
    offset: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Mjcf:
    """A compiled MJCF.

    Parameters
    ----------
    tree : Element
        `<robot>` with links and joints in the terms of a URDF. A joint's `<dynamics>` has
        `armature` besides `damping` and `friction`. Joints are of the kinds revolute, continuous,
        prismatic and fixed, or "free" and "ball", which an arm cannot have.
    actuators : tuple of MjcfActuator
    springs : mapping of joint name to JointSpring
    meshes : tuple of Path
        Files of the meshes that give bodies their mass.
    notes : tuple of str
        Parts of the model that a tree of joints cannot represent.
    """

    tree: ET.Element
    actuators: tuple[MjcfActuator, ...]
    springs: dict[str, JointSpring]
    meshes: tuple[Path, ...]
    notes: tuple[str, ...]


def is_mjcf(path: Path) -> bool:
    """Return whether a file is an MJCF, by its root element."""
    try:
        with path.open("rb") as stream:
            _, root = next(ET.iterparse(stream, events=("start",)))
    except (ET.ParseError, OSError, StopIteration, ValueError, LookupError):
        return False
    return root.tag == MJCF_ROOT


def mjcf_files(path: Path) -> list[Path]:
    """Files that an MJCF needs: itself, those that it includes, and meshes that give mass."""
    return [*mjcf_parts(path), *read_mjcf(path).meshes]


def read_mjcf(path: str | os.PathLike[str]) -> Mjcf:
    """Read an MJCF.

    Raises
    ------
    InputError
        The package `mujoco` is not installed.
    InputFileError
        MuJoCo refuses the file.
    """
    path = Path(path)
    stamps = tuple(file.stat().st_mtime_ns for file in mjcf_parts(path))
    return _read_mjcf(path.resolve(), path, stamps)


def mjcf_parts(path: Path) -> list[Path]:
    """Files that make up an MJCF: itself, and those that it includes."""
    found, waiting = [], [path]
    while waiting:
        file = waiting.pop(0)
        if file in found or not file.is_file():
            continue
        found.append(file)
        try:
            root = ET.parse(file).getroot()
        except ET.ParseError:
            continue
        # MuJoCo searches in the folder of the main file.
        waiting += [path.parent / each.get("file", "") for each in root.iter("include")]
    return found


def _import_mujoco() -> Any:
    try:
        import mujoco
    except ModuleNotFoundError as error:
        raise InputError(
            "reading an MJCF needs the package 'mujoco'. Install it with: "
            "pip install 'stiffopt[mjcf]'"
        ) from error
    return mujoco


@lru_cache(maxsize=8)
def _read_mjcf(_resolved: Path, path: Path, _stamps: tuple[int, ...]) -> Mjcf:
    mujoco = _import_mujoco()
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        notes = list(_reduce_to_mechanism(mujoco, spec))
        _name_elements(spec)
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise InputFileError(path, "", f"is refused by MuJoCo: {shortened(error)}.") from error
    folder = path.parent / spec.meshdir
    meshes = [mesh.file for mesh in spec.meshes if mesh.file]
    return _TreeBuilder(mujoco, model).build(notes, [folder / file for file in meshes])


def _reduce_to_mechanism(mujoco: Any, spec: Any) -> Iterator[str]:
    """Delete all but bodies, joints, their drives and couplings; yield what else has an effect.

    Meshes are large and often absent beside a copied file: those that give no mass are not loaded.
    """
    kinds = mujoco.mjtEq, mujoco.mjtTrn
    loops = [each for each in spec.equalities if each.type != kinds[0].mjEQ_JOINT]
    if loops:
        yield (
            f"{len(loops)} equality constraints (loops of bodies or tendons) are ignored: the"
            " joints form a tree."
        )
    indirect = [
        each
        for each in spec.actuators
        if each.trntype not in (kinds[1].mjTRN_JOINT, kinds[1].mjTRN_JOINTINPARENT)
    ]
    if indirect:
        names = ", ".join(shortened(each.name) for each in indirect)
        yield f"Actuators that drive no single joint are ignored: {names}."
    if len(spec.tendons):
        yield f"{len(spec.tendons)} tendons are ignored."
    always = spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    geoms = [
        geom
        for body in spec.bodies
        for geom in body.geoms
        if body.name == _WORLD or (body.explicitinertial and not always)
    ]
    unused = [each for name in _UNUSED_ELEMENTS for each in getattr(spec, name)]
    for each in [*unused, *loops, *indirect, *spec.tendons, *geoms]:
        spec.delete(each)
    for geom in spec.geoms:
        geom.material = ""
    needed = {geom.meshname for geom in spec.geoms}
    idle = [mesh for mesh in spec.meshes if mesh.name not in needed]
    for asset in [*idle, *(each for name in _UNUSED_ASSETS for each in getattr(spec, name))]:
        spec.delete(asset)


def _name_elements(spec: Any) -> None:
    """Name bodies and joints that have no name by their parents."""
    taken = {each.name for each in (*spec.bodies, *spec.joints)}
    for number, body in enumerate(spec.bodies):
        if not body.name:
            body.name = _free_name(f"body_{number}", taken)
    for joint in spec.joints:
        if not joint.name:
            joint.name = _free_name(f"{joint.parent.name}_joint", taken)


def _free_name(wanted: str, taken: set[str]) -> str:
    name, number = wanted, 1
    while name in taken:
        number += 1
        name = f"{wanted}_{number}"
    taken.add(name)
    return name


class _TreeBuilder:
    """Links and joints of a compiled model.

    A joint of MuJoCo turns about an anchor in its body's frame; several joints of a body act one
    after another. The frame of a URDF's link lies at its joint: each joint gets a link at its
    anchor, and where the anchor of the last is not the body's origin, the body is fixed to it.
    """

    def __init__(self, mujoco: Any, model: Any) -> None:
        self.mujoco, self.model = mujoco, model
        self.tree = ET.Element("robot", name="mjcf")
        self.taken = {model.body(b).name for b in range(model.nbody)}
        self.limits = self._torque_limits()

    def build(self, notes: Iterable[str], meshes: Iterable[Path]) -> Mjcf:
        """Return the tree with drives and springs, and what was told of the file."""
        model = self.model
        ET.SubElement(self.tree, "link", name=_WORLD)
        for b in range(1, model.nbody):
            self._add_body(b)
        self._add_sites()
        self._add_couplings()
        springs = {
            model.joint(j).name: JointSpring(
                stiffness=stiffness,
                offset=float(model.qpos_spring[model.jnt_qposadr[j]]),
            )
            for j in range(model.njnt)
            if self._kind(j) in ("hinge", "slide")
            and (stiffness := float(model.jnt_stiffness[j])) != 0.0
        }
        return Mjcf(
            tree=self.tree,
            actuators=tuple(self._actuators()),
            springs=springs,
            meshes=tuple(meshes),
            notes=tuple(notes),
        )

    def _kind(self, j: int) -> str:
        name: str = self.mujoco.mjtJoint(self.model.jnt_type[j]).name
        return name.removeprefix("mjJNT_").lower()

    def _add_body(self, b: int) -> None:
        model = self.model
        name, parent = model.body(b).name, model.body(model.body_parentid[b]).name
        place, turn = model.body_pos[b], _rotation(self.mujoco, model.body_quat[b])
        joints = range(model.body_jntadr[b], model.body_jntadr[b] + model.body_jntnum[b])
        before = np.zeros(3)
        for j in joints:
            anchor = np.array(model.jnt_pos[j])
            last = j == joints[-1] and not anchor.any()
            child = name if last else _free_name(f"{name}_{model.joint(j).name}", self.taken)
            self._add_joint(j, parent, child, place + turn @ (anchor - before), turn)
            if not last:
                ET.SubElement(self.tree, "link", name=child)
            parent, before, place, turn = child, anchor, np.zeros(3), np.eye(3)
        if parent != name:
            self._fix(parent, name, place - turn @ before, turn)
        self._add_link(b, name)

    def _add_link(self, b: int, name: str) -> None:
        model = self.model
        link = ET.SubElement(self.tree, "link", name=name)
        mass = float(model.body_mass[b])
        if mass == 0.0 and not model.body_inertia[b].any():
            return
        axes = _rotation(self.mujoco, model.body_iquat[b])
        tensor = axes @ np.diag(model.body_inertia[b]) @ axes.T
        inertial = ET.SubElement(link, "inertial")
        ET.SubElement(inertial, "origin", xyz=_numbers(model.body_ipos[b]))
        ET.SubElement(inertial, "mass", value=repr(mass))
        ET.SubElement(
            inertial, "inertia", {key: repr(float(tensor[a, b])) for key, a, b in _INERTIA_KEYS}
        )

    def _fix(self, parent: str, child: str, place: np.ndarray, turn: np.ndarray) -> None:
        joint = ET.SubElement(self.tree, "joint", name=f"{child}_fixed", type="fixed")
        self._connect(joint, parent, child, place, turn)

    @staticmethod
    def _connect(
        joint: ET.Element, parent: str, child: str, place: np.ndarray, turn: np.ndarray
    ) -> None:
        ET.SubElement(joint, "parent", link=parent)
        ET.SubElement(joint, "child", link=child)
        ET.SubElement(
            joint, "origin", xyz=_numbers(place), rpy=_numbers(rpy_from_rotation(np.array(turn)))
        )

    def _add_joint(
        self, j: int, parent: str, child: str, place: np.ndarray, turn: np.ndarray
    ) -> None:
        model, kind = self.model, self._kind(j)
        limited = bool(model.jnt_limited[j])
        joint = ET.SubElement(self.tree, "joint", name=model.joint(j).name, type=kind)
        if kind not in ("hinge", "slide"):
            self._connect(joint, parent, child, place, turn)
            return
        axis, dof = np.array(model.jnt_axis[j]), model.jnt_dofadr[j]
        # The body is as in the file where the joint is at its reference.
        reference = float(model.qpos0[model.jnt_qposadr[j]])
        if kind == "slide":
            joint.set("type", "prismatic")
            place = place - turn @ axis * reference
        else:
            joint.set("type", "revolute" if limited else "continuous")
            turn = turn @ rotation_about_axis(axis, -reference)
        self._connect(joint, parent, child, place, turn)
        ET.SubElement(joint, "axis", xyz=_numbers(axis))
        limit = ET.SubElement(joint, "limit", effort=repr(self.limits[j]), velocity="0.0")
        if limited:
            lower, upper = model.jnt_range[j]
            limit.set("lower", repr(float(lower)))
            limit.set("upper", repr(float(upper)))
        ET.SubElement(
            joint,
            "dynamics",
            damping=repr(float(model.dof_damping[dof])),
            friction=repr(float(model.dof_frictionloss[dof])),
            armature=repr(float(model.dof_armature[dof])),
        )

    def _add_sites(self) -> None:
        """Add named sites as links without mass: they are the usual frames of tools."""
        model = self.model
        for s in range(model.nsite):
            name = model.site(s).name
            if name and name not in self.taken:
                self.taken.add(name)
                ET.SubElement(self.tree, "link", name=name)
                turn = _rotation(self.mujoco, model.site_quat[s])
                self._fix(model.body(model.site_bodyid[s]).name, name, model.site_pos[s], turn)

    def _add_couplings(self) -> None:
        """Add equalities of two joints, to first order, as joints that follow another."""
        model = self.model
        joints = {each.get("name"): each for each in self.tree.findall("joint")}
        for e in range(model.neq):
            follower, leader = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
            if leader < 0 or not model.eq_active0[e]:
                continue
            at = [float(model.qpos0[model.jnt_qposadr[j]]) for j in (follower, leader)]
            constant, slope = (float(x) for x in model.eq_data[e][:2])
            ET.SubElement(
                joints[model.joint(follower).name],
                "mimic",
                joint=model.joint(leader).name,
                multiplier=repr(slope),
                offset=repr(at[0] + constant - slope * at[1]),
            )

    def _torque_limits(self) -> list[float]:
        """Return the largest torque of each joint by its actuators and own limit; 0 for none."""
        model = self.model
        limits = [0.0] * model.njnt
        for a in range(model.nu):
            limits[model.actuator_trnid[a, 0]] += self._actuator_torque(a)
        for j in range(model.njnt):
            if model.jnt_actfrclimited[j]:
                own = float(np.abs(model.jnt_actfrcrange[j]).max())
                limits[j] = min(limits[j] or own, own)
        return limits

    def _actuator_torque(self, a: int) -> float:
        """Return the largest torque of an actuator at its joint; 0 for no limit."""
        model = self.model
        ranges = []
        if model.actuator_forcelimited[a]:
            ranges.append(np.abs(model.actuator_forcerange[a]).max())
        if model.actuator_ctrllimited[a] and not model.actuator_biasprm[a].any():
            ranges.append(np.abs(model.actuator_ctrlrange[a] * model.actuator_gainprm[a, 0]).max())
        return float(min(ranges, default=0.0) * abs(model.actuator_gear[a, 0]))

    def _actuators(self) -> Iterator[MjcfActuator]:
        model = self.model
        for a in range(model.nu):
            # The force of a servo is gain * ctrl + bias[1] * length + bias[2] * velocity, its
            # length gear * q.
            gear, bias = float(model.actuator_gear[a, 0]), model.actuator_biasprm[a]
            yield MjcfActuator(
                name=model.actuator(a).name,
                joint=model.joint(model.actuator_trnid[a, 0]).name,
                position_gain=-float(bias[1]) * gear**2,
                velocity_gain=-float(bias[2]) * gear**2,
                torque_max=self._actuator_torque(a),
            )


def _rotation(mujoco: Any, quaternion: np.ndarray) -> np.ndarray:
    found = np.zeros(9)
    mujoco.mju_quat2Mat(found, quaternion)
    return found.reshape(3, 3)


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
