"""Reading of MJCFs (models of MuJoCo): bodies, joints, drives and couplings.

MuJoCo reads and compiles the file: default classes, includes, frames and compiler options are
resolved. Shapes are ignored, apart from those that give a body its mass.
"""

from __future__ import annotations

import os
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.errors import InputError, InputFileError, shortened
from stiffopt.robot.xml_files import parse_xml

MJCF_ROOT, MJCF_ENDINGS = "mujoco", (".xml", ".mjcf")
# Body that is the ground.
WORLD = "world"
# Elements that refer to shapes, or are none of a mechanism.
_UNUSED_ELEMENTS = (
    "sensors", "keys", "tuples", "texts", "numerics", "pairs", "excludes", "skins", "flexes",
    "cameras", "lights",
)  # fmt: skip
_UNUSED_ASSETS = ("hfields", "materials", "textures")


@dataclass(frozen=True, kw_only=True, eq=False)
class MjcfBody:
    """A body of MuJoCo, or a site, which is one without mass."""

    name: str
    parent: str
    place: np.ndarray  # (3,) origin in the parent's frame [m]
    rotation: np.ndarray  # (3, 3) axes in the parent's frame
    joints: tuple[str, ...] = ()  # joints to the parent, which act one after another
    mass: float = 0.0  # [kg]
    centre: np.ndarray  # (3,) centre of mass in the body's frame [m]
    inertia: np.ndarray  # (3, 3) about the centre of mass, in the body's axes [kg m^2]


@dataclass(frozen=True, kw_only=True, eq=False)
class MjcfJoint:
    """A joint of MuJoCo."""

    name: str
    body: str
    kind: str  # "hinge", "slide", "ball" or "free"
    # (3,) in the body's frame.
    anchor: np.ndarray
    axis: np.ndarray
    reference: float  # position at which the body stands as in the file [rad] or [m]
    limits: tuple[float, float] | None  # least and largest position
    # [N m], [N m s/rad], [kg m^2].
    frictionloss: float
    damping: float
    armature: float
    # Spring between the bodies [N m/rad], [rad].
    stiffness: float
    spring_reference: float
    torque_max: float  # of its drives and its own limit [N m]; 0 for none


@dataclass(frozen=True, kw_only=True)
class MjcfActuator:
    """An actuator of MuJoCo that drives one joint."""

    name: str
    joint: str
    gear: float  # torque at the joint over force, and length over position
    gain: float  # force over control signal
    bias: tuple[float, ...]  # force, force over length and force over velocity of the length
    force_range: tuple[float, float] | None  # least and largest force
    control_range: tuple[float, float] | None  # least and largest control signal

    @property
    def position_gain(self) -> float:
        """`kp` of a servo at the joint [N m/rad]; 0 of a motor."""
        return -self.bias[1] * self.gear**2

    @property
    def velocity_gain(self) -> float:
        """`kv` of a servo at the joint [N m s/rad]; 0 of a motor."""
        return 0.0 - self.bias[2] * self.gear**2

    @property
    def torque_max(self) -> float:
        """Largest torque at the joint [N m]; 0 for no limit."""
        ranges = []
        if self.force_range is not None:
            ranges.append(max(map(abs, self.force_range)))
        if self.control_range is not None and not any(self.bias):
            ranges.append(max(map(abs, self.control_range)) * abs(self.gain))
        return min(ranges, default=0.0) * abs(self.gear)


@dataclass(frozen=True, kw_only=True)
class MjcfCoupling:
    """A joint that follows another one: position = slope * leader + offset."""

    follower: str
    leader: str
    slope: float
    offset: float


@dataclass(frozen=True, kw_only=True, eq=False)
class MjcfModel:
    """A compiled MJCF."""

    # Parents first, without the ground; sites with names only.
    bodies: tuple[MjcfBody, ...]
    sites: tuple[MjcfBody, ...]
    joints: dict[str, MjcfJoint]
    actuators: tuple[MjcfActuator, ...]
    couplings: tuple[MjcfCoupling, ...]  # to first order
    meshes: tuple[Path, ...]  # files of the meshes that give bodies their mass
    degrees: bool  # angles in the file are in degrees
    shaped: bool  # masses are those of shapes even where a body states its own
    notes: tuple[str, ...]  # parts of the model that a tree of joints cannot represent


def is_mjcf(path: Path) -> bool:
    """Return whether a file is an MJCF, by its root element."""
    try:
        with path.open("rb") as stream:
            _, root = next(ET.iterparse(stream, events=("start",)))
    except (ET.ParseError, OSError, StopIteration, ValueError, LookupError):
        return False
    return bool(root.tag == MJCF_ROOT)


def mjcf_parts(path: Path) -> list[Path]:
    """Files that make up an MJCF: itself, and those that it includes or attaches.

    Raises `InputFileError`: one is missing, no XML or too large.
    """
    found, waiting = [], [path]
    while waiting:
        file = waiting.pop(0)
        if file in found:
            continue
        found.append(file)
        root = parse_xml(file)
        for each in (*root.iter("include"), *root.iterfind("asset/model")):
            # MuJoCo searches in the folder of the main file.
            part = path.parent / each.get("file", "")
            if not part.is_file():
                raise InputFileError(file, each.tag, f"there is no file {part}.")
            waiting.append(part)
    return found


def mjcf_files(path: Path) -> list[Path]:
    """Files that an MJCF needs: itself, those that it includes, and meshes that give mass."""
    return [*mjcf_parts(path), *read_mjcf(path).meshes]


def names_in_common_folder(files: Sequence[Path]) -> dict[str, Path]:
    """Return files by their paths relative to the innermost folder that holds all of them."""
    places = [Path(os.path.abspath(file)) for file in files]
    root = Path(os.path.commonpath([place.parent for place in places]))
    return {place.relative_to(root).as_posix(): place for place in places}


def read_mjcf(path: str | os.PathLike[str]) -> MjcfModel:
    """Read an MJCF; raise `InputError` without `mujoco`, or where it refuses the file."""
    path = Path(path)
    return _read_mjcf(path, tuple(file.stat().st_mtime_ns for file in mjcf_parts(path)))


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
def _read_mjcf(path: Path, _times: tuple[int, ...]) -> MjcfModel:
    """Read an MJCF anew where one of its files was written since."""
    mujoco = _import_mujoco()
    with _collect_warnings(mujoco) as said:
        model = _read_model(mujoco, path)
    return replace(model, notes=(*model.notes, *(f"MuJoCo: {each}" for each in said)))


@contextmanager
def _collect_warnings(mujoco: Any) -> Iterator[list[str]]:
    """Collect warnings of MuJoCo, which by itself writes them into a log in the working folder."""
    said: dict[str, None] = {}
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda text: said.setdefault(text))
    found: list[str] = []
    try:
        with warnings.catch_warnings():
            # The same texts once more.
            warnings.simplefilter("ignore")
            yield found
    finally:
        mujoco.set_mju_user_warning(before)
        found += said


def _read_model(mujoco: Any, path: Path) -> MjcfModel:
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        always = spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
        notes = tuple(_reduce_to_mechanism(mujoco, spec, always))
        _name_elements(spec)
        meshes = _find_meshes(spec, path)
        model = spec.compile()
    except InputFileError:
        raise
    except (ValueError, mujoco.FatalError) as error:
        raise InputFileError(path, "", f"is refused by MuJoCo: {shortened(error)}.") from error
    reader = _ModelReader(mujoco, model)
    return MjcfModel(
        bodies=tuple(reader.bodies()),
        sites=tuple(reader.sites()),
        joints={joint.name: joint for joint in reader.joints()},
        actuators=tuple(reader.actuators()),
        couplings=tuple(reader.couplings()),
        meshes=meshes,
        degrees=bool(spec.compiler.degree),
        shaped=always,
        notes=notes,
    )


def _reduce_to_mechanism(mujoco: Any, spec: Any, shaped: bool) -> Iterator[str]:
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
    geoms = [
        geom
        for body in spec.bodies
        for geom in body.geoms
        if body.name == WORLD or (body.explicitinertial and not shaped)
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


def _find_meshes(spec: Any, path: Path) -> tuple[Path, ...]:
    """Return the files of meshes; raise `InputFileError` where one is missing."""
    files = {mesh.name: path.parent / spec.meshdir / mesh.file for mesh in spec.meshes if mesh.file}
    for body in spec.bodies:
        for geom in body.geoms:
            file = files.get(geom.meshname)
            if file is not None and not file.is_file():
                raise InputFileError(
                    path,
                    f"body {body.name!r}",
                    f"takes its mass from {file}, which is not there. Copy the mesh to that place,"
                    " or give the body an <inertial>.",
                )
    return tuple(files.values())


def _name_elements(spec: Any) -> None:
    """Name bodies and joints that have no name by their parents."""
    taken = {each.name for each in (*spec.bodies, *spec.joints)}
    for number, body in enumerate(spec.bodies):
        if not body.name:
            body.name = free_name(f"body_{number}", taken)
    for joint in spec.joints:
        if not joint.name:
            joint.name = free_name(f"{joint.parent.name}_joint", taken)


def free_name(wanted: str, taken: set[str]) -> str:
    """Return a name that is not among `taken`, and add it there."""
    name, number = wanted, 1
    while name in taken:
        number += 1
        name = f"{wanted}_{number}"
    taken.add(name)
    return name


class _ModelReader:
    """Parts of a compiled model of MuJoCo."""

    def __init__(self, mujoco: Any, model: Any) -> None:
        self.mujoco, self.model = mujoco, model

    def bodies(self) -> Iterator[MjcfBody]:
        """Yield all bodies but the ground."""
        model = self.model
        for b in range(1, model.nbody):
            first, count = int(model.body_jntadr[b]), int(model.body_jntnum[b])
            axes = self._read_rotation(model.body_iquat[b])
            yield MjcfBody(
                name=model.body(b).name,
                parent=model.body(model.body_parentid[b]).name,
                place=np.array(model.body_pos[b]),
                rotation=self._read_rotation(model.body_quat[b]),
                joints=tuple(model.joint(j).name for j in range(first, first + count)),
                mass=float(model.body_mass[b]),
                centre=np.array(model.body_ipos[b]),
                inertia=axes @ np.diag(model.body_inertia[b]) @ axes.T,
            )

    def sites(self) -> Iterator[MjcfBody]:
        """Yield sites with names: they are the usual frames of tools."""
        model = self.model
        for s in range(model.nsite):
            if model.site(s).name:
                yield MjcfBody(
                    name=model.site(s).name,
                    parent=model.body(model.site_bodyid[s]).name,
                    place=np.array(model.site_pos[s]),
                    rotation=self._read_rotation(model.site_quat[s]),
                    centre=np.zeros(3),
                    inertia=np.zeros((3, 3)),
                )

    def joints(self) -> Iterator[MjcfJoint]:
        """Yield all joints."""
        model = self.model
        drives = list(self.actuators())
        for j in range(model.njnt):
            position, dof = model.jnt_qposadr[j], model.jnt_dofadr[j]
            lower, upper = (float(x) for x in model.jnt_range[j])
            torques = [sum(each.torque_max for each in drives if each.joint == model.joint(j).name)]
            if model.jnt_actfrclimited[j]:
                torques.append(float(np.abs(model.jnt_actfrcrange[j]).max()))
            kind = self.mujoco.mjtJoint(model.jnt_type[j]).name
            yield MjcfJoint(
                name=model.joint(j).name,
                body=model.body(model.jnt_bodyid[j]).name,
                kind=kind.removeprefix("mjJNT_").lower(),
                anchor=np.array(model.jnt_pos[j]),
                axis=np.array(model.jnt_axis[j]),
                reference=float(model.qpos0[position]),
                limits=(lower, upper) if model.jnt_limited[j] else None,
                frictionloss=float(model.dof_frictionloss[dof]),
                damping=float(model.dof_damping[dof]),
                armature=float(model.dof_armature[dof]),
                stiffness=float(model.jnt_stiffness[j]),
                spring_reference=float(model.qpos_spring[position]),
                torque_max=min(filter(None, torques), default=0.0),
            )

    def couplings(self) -> Iterator[MjcfCoupling]:
        """Yield equalities of two joints."""
        model = self.model
        for e in range(model.neq):
            follower, leader = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
            if leader < 0 or not model.eq_active0[e]:
                continue
            # The polynomial relates positions from the references.
            at = [float(model.qpos0[model.jnt_qposadr[j]]) for j in (follower, leader)]
            constant, slope = (float(x) for x in model.eq_data[e][:2])
            yield MjcfCoupling(
                follower=model.joint(follower).name,
                leader=model.joint(leader).name,
                slope=slope,
                offset=at[0] + constant - slope * at[1],
            )

    def actuators(self) -> Iterator[MjcfActuator]:
        """Yield all actuators."""
        model = self.model
        for a in range(model.nu):
            force, control = (
                (float(pair[0]), float(pair[1])) if limited else None
                for pair, limited in (
                    (model.actuator_forcerange[a], model.actuator_forcelimited[a]),
                    (model.actuator_ctrlrange[a], model.actuator_ctrllimited[a]),
                )
            )
            yield MjcfActuator(
                name=model.actuator(a).name,
                joint=model.joint(model.actuator_trnid[a, 0]).name,
                gear=float(model.actuator_gear[a, 0]),
                gain=float(model.actuator_gainprm[a, 0]),
                bias=tuple(float(x) for x in model.actuator_biasprm[a, :3]),
                force_range=force,
                control_range=control,
            )

    def _read_rotation(self, quaternion: np.ndarray) -> np.ndarray:
        found = np.zeros(9)
        self.mujoco.mju_quat2Mat(found, quaternion)
        return found.reshape(3, 3)
