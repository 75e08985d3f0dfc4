"""A robot arm: rigid bodies, limits and friction of each joint, drivetrains, and the tool."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from stiffopt.drivetrain.bearing import ElasticMount, OutputBearing
from stiffopt.drivetrain.chain import Chain
from stiffopt.drivetrain.tables import OwnEntries
from stiffopt.errors import RobotError
from stiffopt.robot.added_torque import AddedTorque
from stiffopt.robot.body_tree import BodyTree, body_tree
from stiffopt.robot.frames import LinkFrame, link_frame, named_frame
from stiffopt.robot.held_joints import HeldJoint
from stiffopt.robot.joint_load import supporting_joints
from stiffopt.robot.link_shapes import JointShape, LinkShape, Purpose, joint_shapes
from stiffopt.robot.rigid_body import BodiesInMotion, RigidBodies


@dataclass(frozen=True)
class Source:
    """Provenance of a number of the robot, a row of reports."""

    joint: str
    element: str
    key: str
    provenance: str
    source: str


# Lever arm below which a joint does not move the tool [m].
_MIN_LEVER_ARM = 1e-6
# Relative rounding of a mass difference.
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
    """A robot arm with elastic or rigid joints.

    Parameters
    ----------
    model : pinocchio.Model
        Revolute and prismatic joints; gravity included, rotor inertia not.
    position_lower, position_upper : array (n,)
        [rad] or [m]; infinite for continuous joints.
    velocity_max, acceleration_max, jerk_max : array (n,)
        [rad/s], [rad/s^2], [rad/s^3]; infinite where there is no limit.
    torque_max : array (n,)
        Torque limit of the drive at the joint's output [N m]; 100 % of the torque ratio.
    rotor_inertia : array (n,)
        Inertia of the rotor at the joint's output [kg m^2].
    coulomb, viscous : array (n,)
        Friction at the joint's output [N m], [N m s/rad].
    chains : tuple of Chain or None
        Drivetrain of each joint; None is rigid.
    tool, flange : LinkFrame
        Tool point, and frame to which payloads are fixed.
    damping : array (n,), optional
        Damping of the joint's spring [N m s/rad]; NaN where unknown.
    hysteresis : array (n,), optional
        Half width of the hysteresis loop of wind-up over torque [rad]; default none.
    bearings : tuple of OutputBearing or None
        Output bearing of each joint; None is rigid. Empty: all are.
    links : tuple of ElasticMount or None
        Bending of the link behind each joint; None is rigid. Empty: all are.
    held : tuple of HeldJoint
        Joints of the URDF that are held fixed.
    shapes : tuple of LinkShape
        Visual and collision shapes of the links.
    urdf : Path or None
        File that describes the arm.
    payload : array (10,), optional
        Inertial parameters (mass, first moments, inertia) of the payload in the axes of the flange;
        included in the model.
    added_torques : tuple of AddedTorque
        Torques beyond rigid bodies and friction.
    own : mapping of kind to mapping of name to row
        Parts of the user's catalogue, which take precedence over those of the package.

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
    # Not compared: only the content of the URDF is an input.
    urdf: Path | None = field(default=None, compare=False)
    payload: np.ndarray | None = None
    bearings: tuple[OutputBearing | None, ...] = ()
    links: tuple[ElasticMount | None, ...] = ()
    held: tuple[HeldJoint, ...] = ()
    added_torques: tuple[AddedTorque, ...] = ()
    # Not compared: parts in use are in the chains, others have no effect.
    own: OwnEntries = field(default_factory=dict, compare=False)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.model.nv)

    @property
    def tilts(self) -> bool:
        """Return whether the output bearing of any joint or any link is elastic."""
        return any(each is not None for each in (*self.bearings, *self.links))

    @property
    def mounts(self) -> tuple[tuple[ElasticMount, ...], ...]:
        """Elastic mounts behind each joint, from the joint outwards: its bearing, its link."""
        bearings = self.bearings or (None,) * self.n
        return tuple(
            (() if bearing is None else (bearing.mount,)) + (() if link is None else (link,))
            for bearing, link in zip(bearings, self.links or (None,) * self.n, strict=True)
        )

    @property
    def yields(self) -> bool:
        """Return whether any joint is elastic."""
        return any(chain is not None and chain.stages for chain in self.chains)

    def tool_yields(self, poses: np.ndarray) -> bool:
        """Return whether an elastic joint moves the tool in any of some poses (K, n)."""
        springs = np.array([chain is not None and bool(chain.stages) for chain in self.chains])
        bodies = self.rigid_bodies()
        arms = (bodies.jacobian(self.tool, pose)[:3, springs] for pose in poses)
        return any(bool(np.any(np.abs(arm) > _MIN_LEVER_ARM)) for arm in arms)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the moving joints, in the order of all arrays."""
        return tuple(self.model.names)[1:]

    @property
    def prismatic(self) -> np.ndarray:
        """Return which joints are prismatic, (n,) of bool."""
        return self.tree.prismatic

    @cached_property
    def position_fixes_joints(self) -> bool:
        """Return whether a position of the tool leaves the joints no freedom but a branch."""
        # Of a pose without symmetry: the rank there is that of nearly all poses.
        moves = self.rigid_bodies().jacobian(self.tool, np.arange(1.0, self.n + 1.0))[:3]
        return bool(np.linalg.matrix_rank(moves) == self.n)

    @cached_property
    def tree(self) -> BodyTree:
        """Bodies and joints as plain numbers."""
        return body_tree(self.model)

    def rigid_bodies(self) -> RigidBodies:
        """Numeric dynamics and kinematics of links and payload."""
        return RigidBodies(self.model)

    def bodies_in_motion(self) -> BodiesInMotion:
        """Numeric rigid-body dynamics of links and payload along whole motions."""
        return BodiesInMotion(self.model)

    def joint_shapes(self, purpose: Purpose) -> list[JointShape]:
        """Shapes of the links in the frames of their joints."""
        return joint_shapes(self.model, self.shapes, purpose)

    def estimated(self) -> list[Source]:
        """Sources of estimated numbers, marked in reports."""
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
        """Copy with the payload's mass and inertia times `factor`, 0 or above."""
        if self.payload is None or factor == 1.0:
            return self
        if not (np.isfinite(factor) and factor >= 0.0):
            raise RobotError(
                f"the factor of a payload must be finite and 0 or above, got {factor:g}."
            )
        at = pin.SE3(self.flange.rotation, self.flange.offset)
        carried = at.act(_inertia_of(self.payload)).toDynamicParameters()
        joint = self.flange.joint
        whole = self.model.inertias[joint].toDynamicParameters()
        own = whole + (factor - 1.0) * carried
        if own[0] <= _MASS_ROUND_OFF * whole[0]:
            # The rounding residue of a massless link has an arbitrary centre.
            own[:4] = 0.0
        model = self.model.copy()
        model.inertias[joint] = _inertia_of(own)
        return replace(self, model=model, payload=factor * self.payload)

    def with_bearings_times(self, factors: np.ndarray | float) -> Robot:
        """Copy with bearings and links of each joint stiffer by a factor, (n,) or one for all."""
        if not self.tilts:
            return self
        own = np.broadcast_to(factors, self.n).tolist()
        return replace(
            self,
            bearings=tuple(
                each and each.times(factor)
                for each, factor in zip(self.bearings, own, strict=bool(self.bearings))
            ),
            links=tuple(
                each and each.times(factor)
                for each, factor in zip(self.links, own, strict=bool(self.links))
            ),
        )

    def with_gravity(self, gravity: Sequence[float]) -> Robot:
        """Copy under another gravity (3,) [m/s^2], base axes."""
        model = self.model.copy()
        model.gravity.linear = np.asarray(gravity, dtype=float)
        return replace(self, model=model)

    def with_joints_locked(self, names: Sequence[str]) -> Robot:
        """Copy with some joints fixed at zero, their links merged with the link before.

        Parameters
        ----------
        names : sequence of str
            Names of moving joints, not of all.
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
            bearings=tuple(each for j, each in enumerate(self.bearings) if left[j]),
            links=self._links_without(left),
            tool=replace(named_frame(models[1], "locked tool"), link=self.tool.link),
            flange=replace(named_frame(models[1], "locked flange"), link=self.flange.link),
            **arrays,
        )

    def _links_without(self, left: np.ndarray) -> tuple[ElasticMount | None, ...]:
        """Bending links of joints that are left (n,), up to the next joint that is."""
        places, kept = np.cumsum(left) - 1, np.flatnonzero(left)
        found: list[ElasticMount | None] = []
        for link in (each for each, stays in zip(self.links, left, strict=False) if stays):
            following = None
            if link is not None and link.carries is not None:
                chains = ((k, supporting_joints(self.model, int(k) + 1)) for k in kept)
                following = next((k for k, chain in chains if link.carries + 1 in chain), None)
            found.append(
                None
                if link is None or following is None
                else replace(link, carries=int(places[following]))
            )
        return tuple(found)

    def with_inertial_parameters(self, joint: int, parameters: np.ndarray) -> Robot:
        """Copy with other inertial parameters of a joint's body.

        Parameters
        ----------
        joint : int
            From 1.
        parameters : array (10,)
            As `Body.inertial_parameters`, with a mass above 0. The inertia about the centre of mass
            stays the same where the given one is not physical.
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
            Joints from 1; preload of one bolt or pin [N]. Others are unchanged.
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
    """Inertia of these dynamic parameters; the mass may be zero."""
    if parameters[0] > 0.0:
        return pin.Inertia.FromDynamicParameters(parameters)
    # Inertia about the origin, since there is no centre of mass.
    inertia = np.zeros((3, 3))
    rows, columns = (0, 0, 1, 0, 1, 2), (0, 1, 1, 2, 2, 2)
    inertia[rows, columns] = inertia[columns, rows] = parameters[4:]
    return pin.Inertia(0.0, np.zeros(3), inertia)
