"""A robot arm: rigid bodies, limits and friction of each joint, drivetrains, and the tool."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from stiffopt.drivetrain.chain import Chain
from stiffopt.drivetrain.tables import OwnEntries
from stiffopt.errors import RobotError
from stiffopt.robot.body_tree import BodyTree, body_tree
from stiffopt.robot.frames import LinkFrame, link_frame, named_frame
from stiffopt.robot.held_joints import HeldJoint
from stiffopt.robot.link_shapes import JointShape, LinkShape, Purpose, joint_shapes
from stiffopt.robot.rigid_body import BodiesInMotion, RigidBodies


@dataclass(frozen=True)
class Source:
    """Where a number of the robot comes from; a row of reports."""

    joint: str
    element: str
    key: str
    provenance: str
    source: str


# Joints whose axes pass the tool this near do not move it [m].
_MIN_LEVER_ARM = 1e-6
# Share of a mass that is none.
_MASS_ROUND_OFF = 1e-12
_JOINT_ARRAY_FIELDS = (
    "position_lower",
    "position_upper",
    "velocity_max",
    "acceleration_max",
    "jerk_max",
    "torque_max",
    "rotor_inertia",
    "coulomb",
    "viscous",
    "damping",
    "hysteresis",
)


@dataclass(frozen=True, kw_only=True)
class Robot:
    """An arm whose joints yield under load.

    Parameters
    ----------
    name : str
    model : pinocchio.Model
        Revolute and prismatic joints; gravity included, rotor inertia not.
    position_lower, position_upper : array (n,)
        [rad] or [m]; infinite where a joint turns without end.
    velocity_max, acceleration_max, jerk_max : array (n,)
        [rad/s], [rad/s^2], [rad/s^3]; infinite where there is no limit.
    torque_max : array (n,)
        Of the drive at the joint's output [N m]; 100 % of the torque ratio.
    rotor_inertia : array (n,)
        Of the motor, at the joint's output [kg m^2].
    coulomb, viscous : array (n,)
        Friction at the joint's output [N m], [N m s/rad].
    chains : tuple of Chain or None
        Drivetrain of each joint; None is rigid.
    tool, flange : LinkFrame
        Where the tool point is, and where payloads are fixed.
    sources : tuple of Source
    title : str
    damping : array (n,), optional
        Of the joint's spring [N m s/rad]; NaN where it is not known.
    hysteresis : array (n,), optional
        Half width of the loop that wind-up describes over torque [rad]; default none.
    held : tuple of HeldJoint
        Joints of the URDF that the arm does not move.
    shapes : tuple of LinkShape
        What the links look like and collide with, as far as the URDF says it.
    urdf : Path or None
        File that describes the arm.
    payload : array (10,), optional
        Inertial parameters (mass, first moments, inertia) in the axes of the flange of what
        `with_payload` has put there; the model holds it.
    own : mapping of kind to mapping of name to row
        Parts of the user's own catalogue, which stand before those of the package.

    Notes
    -----
    Prismatic joints have metres for radians and newtons for newton metres throughout.
    """

    name: str
    model: pin.Model
    position_lower: np.ndarray
    position_upper: np.ndarray
    velocity_max: np.ndarray
    acceleration_max: np.ndarray
    jerk_max: np.ndarray
    torque_max: np.ndarray
    rotor_inertia: np.ndarray
    coulomb: np.ndarray
    viscous: np.ndarray
    chains: tuple[Chain | None, ...]
    tool: LinkFrame
    flange: LinkFrame
    sources: tuple[Source, ...] = ()
    title: str = ""
    damping: np.ndarray | None = None
    hysteresis: np.ndarray | None = None
    shapes: tuple[LinkShape, ...] = ()
    # Where it lies is no input: what it says is.
    urdf: Path | None = field(default=None, compare=False)
    payload: np.ndarray | None = None
    held: tuple[HeldJoint, ...] = ()
    # Parts that are used are in the chains: of the others no result knows.
    own: OwnEntries = field(default_factory=dict, compare=False)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.model.nv)

    @property
    def yields(self) -> bool:
        """Whether any joint has a spring, so that what it carries can swing."""
        return any(chain is not None and chain.stages for chain in self.chains)

    def tool_yields(self, poses: np.ndarray) -> bool:
        """Whether in any of some poses (K, n) a joint with a spring moves the tool."""
        springs = np.array([chain is not None and bool(chain.stages) for chain in self.chains])
        bodies = self.rigid_bodies()
        arms = [bodies.jacobian(self.tool, pose)[:3, springs] for pose in poses]
        return bool(np.max(np.abs(arms), initial=0.0) > _MIN_LEVER_ARM)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the moving joints, in the order of all arrays."""
        return tuple(self.model.names)[1:]

    @property
    def prismatic(self) -> np.ndarray:
        """Which joints slide, (n,) of bool."""
        return self.tree.prismatic

    @cached_property
    def tree(self) -> BodyTree:
        """Bodies and joints as plain numbers."""
        return body_tree(self.model)

    def rigid_bodies(self) -> RigidBodies:
        """Dynamics and kinematics of links and payload in numbers."""
        return RigidBodies(self.model)

    def bodies_in_motion(self) -> BodiesInMotion:
        """Rigid-body dynamics of links and payload in numbers, along whole motions."""
        return BodiesInMotion(self.model)

    def joint_shapes(self, purpose: Purpose) -> list[JointShape]:
        """Shapes of the links in the frames of their joints."""
        return joint_shapes(self.model, self.shapes, purpose)

    def estimated(self) -> list[Source]:
        """Numbers that are estimates, for reports to mark."""
        return [s for s in self.sources if s.provenance == "estimated"]

    def with_payload(
        self, mass: float, com: Sequence[float] = (0.0, 0.0, 0.0), inertia: Any = None
    ) -> Robot:
        """Copy with a body fixed at the flange.

        Parameters
        ----------
        mass : float [kg]
        com : array_like (3,)
            Centre of mass in the flange frame [m].
        inertia : array_like (3,) or (3, 3), optional
            About the centre of mass, in the axes of the flange frame [kg m^2]; three numbers are
            a diagonal. Default: a point mass.
        """
        tensor = np.zeros((3, 3)) if inertia is None else np.asarray(inertia, dtype=float)
        tensor = np.diag(tensor) if tensor.shape == (3,) else tensor
        centre = np.asarray(com, dtype=float)
        finite = np.isfinite(mass) and np.isfinite(centre).all() and np.isfinite(tensor).all()
        if not finite or mass < 0.0 or centre.shape != (3,) or tensor.shape != (3, 3):
            raise RobotError(
                "a payload needs a mass of 0 or above, a com of 3 and an inertia of 3 or 3 x 3 "
                f"finite numbers; got mass = {mass}, com = {com}, inertia = {inertia}."
            )
        moments = np.linalg.eigvalsh((tensor + tensor.T) / 2)
        if moments[0] < 0.0 or moments[2] > (moments[0] + moments[1]) * (1 + 1e-9):
            raise RobotError(
                f"the payload's principal inertias {moments} belong to no body: none may be below "
                "0, none above the sum of the other two. Give them about the centre of mass."
            )
        model = self.model.copy()
        at = pin.SE3(self.flange.rotation, self.flange.offset)
        body = pin.Inertia(float(mass), centre, tensor)
        model.appendBodyToJoint(self.flange.joint, body, at)
        carried = body.toDynamicParameters()
        held = carried if self.payload is None else self.payload + carried
        return replace(self, model=model, payload=held)

    def with_payload_times(self, factor: float) -> Robot:
        """Copy whose payload has `factor` times its mass and inertia, 0 or above."""
        if self.payload is None or factor == 1.0:
            return self
        if not (np.isfinite(factor) and factor >= 0.0):
            raise RobotError(f"a payload can be 0 or more times what it is, not {factor:g} times.")
        at = pin.SE3(self.flange.rotation, self.flange.offset)
        carried = at.act(_inertia_of(self.payload)).toDynamicParameters()
        joint = self.flange.joint
        whole = self.model.inertias[joint].toDynamicParameters()
        own = whole + (factor - 1.0) * carried
        if own[0] <= _MASS_ROUND_OFF * whole[0]:
            # What rounding leaves of a link without a mass has its centre anywhere.
            own[:4] = 0.0
        model = self.model.copy()
        model.inertias[joint] = _inertia_of(own)
        return replace(self, model=model, payload=factor * self.payload)

    def with_gravity(self, gravity: Sequence[float]) -> Robot:
        """Copy under another gravity (3,) [m/s^2], base axes."""
        model = self.model.copy()
        model.gravity.linear = np.asarray(gravity, dtype=float)
        return replace(self, model=model)

    def with_joints_locked(self, names: Sequence[str]) -> Robot:
        """Copy in which some joints are held at zero; what they carry belongs to the link before.

        Parameters
        ----------
        names : sequence of str
            Of moving joints, not all of them.
        """
        if not names:
            return self
        marked = self.model.copy()
        for name, frame in (("locked tool", self.tool), ("locked flange", self.flange)):
            at = pin.SE3(frame.rotation, frame.offset)
            marked.addFrame(pin.Frame(name, frame.joint, 0, at, pin.FrameType.OP_FRAME), False)
        models = [
            pin.buildReducedModel(
                model, [model.getJointId(name) for name in names], pin.neutral(model)
            )
            for model in (self.model, marked)
        ]
        left = np.array([name not in names for name in self.joint_names])
        arrays: dict[str, Any] = {
            name: array[left]
            for name in _JOINT_ARRAY_FIELDS
            if (array := getattr(self, name)) is not None
        }
        return replace(
            self,
            model=models[0],
            chains=tuple(chain for chain, stays in zip(self.chains, left, strict=True) if stays),
            tool=replace(named_frame(models[1], "locked tool"), link=self.tool.link),
            flange=replace(named_frame(models[1], "locked flange"), link=self.flange.link),
            **arrays,
        )

    def with_inertial_parameters(self, joint: int, parameters: np.ndarray) -> Robot:
        """Copy with another body behind a joint.

        Parameters
        ----------
        joint : int
            From 1.
        parameters : array (10,)
            As `Body.inertial_parameters`, with a mass above 0. Where their inertia belongs to no
            body, the inertia about the centre of mass stays what it was.
        """
        if not parameters[0] > 0.0:
            raise RobotError(f"a link needs a mass above 0, got {parameters[0]:g} kg.")
        model = self.model.copy()
        body = pin.Inertia.FromDynamicParameters(parameters)
        moments = np.linalg.eigvalsh(body.inertia)
        if moments[0] < 0.0 or moments[2] > moments[0] + moments[1]:
            body = pin.Inertia(body.mass, body.lever, model.inertias[joint].inertia)
        model.inertias[joint] = body
        return replace(self, model=model)

    def with_preloads(self, preloads: Mapping[int, Mapping[str, float]]) -> Robot:
        """Copy with other preloads of bolts and pins.

        Parameters
        ----------
        preloads : mapping of joint number to mapping of element name to float
            Joints are numbered from 1; of one bolt or pin [N]. All others stay as they are.
        """
        chains = list(self.chains)
        for joint, own in preloads.items():
            chain = chains[joint - 1] if 1 <= joint <= self.n else None
            if chain is None:
                raise RobotError(
                    f"joint {joint} has no drivetrain to preload; {self.name} has joints 1 to "
                    f"{self.n}. Describe its elements in the robot file."
                )
            chains[joint - 1] = chain.with_preloads(own)
        return replace(self, chains=tuple(chains))

    def with_tool(
        self,
        link: str | None = None,
        offset: Sequence[float] | None = None,
        rpy: Sequence[float] | None = None,
    ) -> Robot:
        """Copy with another tool point.

        Parameters
        ----------
        link : str, optional
            Default: the link of the robot's own tool.
        offset : array_like (3,), optional
            In the link's frame [m]; default its origin.
        rpy : array_like (3,), optional
            Roll, pitch, yaw about the link's axes [rad]; default as the link.
        """
        return replace(self, tool=link_frame(self.model, link or self.tool.link, offset, rpy))


def _inertia_of(parameters: np.ndarray) -> pin.Inertia:
    """Body of these dynamic parameters, which may have no mass."""
    if parameters[0] > 0.0:
        return pin.Inertia.FromDynamicParameters(parameters)
    # Of an inertia about the origin, as where there is no centre of mass.
    inertia = np.zeros((3, 3))
    rows, columns = (0, 0, 1, 0, 1, 2), (0, 1, 1, 2, 2, 2)
    inertia[rows, columns] = inertia[columns, rows] = parameters[4:]
    return pin.Inertia(0.0, np.zeros(3), inertia)
