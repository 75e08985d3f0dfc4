"""A robot arm: rigid bodies, limits and friction of each joint, drivetrains, and the tool."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from stiffopt.drivetrain.chain import Chain
from stiffopt.errors import RobotError, nearest


@dataclass(frozen=True)
class Place:
    """A frame fixed to a moving link.

    Parameters
    ----------
    joint : int
        Index of the link's joint in the pinocchio model (1 is the first moving joint).
    offset : array (3,)
        Origin in that joint's frame [m].
    rotation : array (3, 3)
        Axes of the frame, as columns in the joint's frame.
    link : str
        Link whose frame the offset was given in.
    """

    joint: int
    offset: np.ndarray
    rotation: np.ndarray
    link: str = ""


class Tool(Place):
    """The frame whose position and deflection count."""


@dataclass(frozen=True)
class Source:
    """Where a number of the robot comes from; a row of reports."""

    joint: str
    element: str
    key: str
    provenance: str
    source: str


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
    tool, flange : Place
        Where the tool point is, and where payloads are fixed.
    sources : tuple of Source
    title : str

    Notes
    -----
    Prismatic joints have metres for radians and newtons for newton metres throughout.
    """

    name: str
    model: Any
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
    tool: Tool
    flange: Place
    sources: tuple[Source, ...] = ()
    title: str = ""

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.model.nv)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the moving joints, in the order of all arrays."""
        return tuple(self.model.names)[1:]

    @property
    def prismatic(self) -> np.ndarray:
        """Which joints slide, (n,) of bool."""
        return is_prismatic(self.model)

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
        return replace(self, tool=tool_at(self.model, link or self.tool.link, offset, rpy))


def is_prismatic(model: Any) -> np.ndarray:
    """Which joints of a pinocchio model slide, (n,) of bool."""
    return np.array([j.shortname().startswith("JointModelP") for j in list(model.joints)[1:]])


def link_names(model: Any) -> list[str]:
    """Links of a pinocchio model that have a frame."""
    return [f.name for f in model.frames if f.type == pin.FrameType.BODY and f.name != "universe"]


def _placed(model: Any, link: str, offset: Any, rpy: Any) -> tuple[int, np.ndarray, np.ndarray]:
    if link not in link_names(model):
        raise RobotError(f"no link {link!r}. {nearest(link, link_names(model))}")
    frame = model.frames[model.getFrameId(link, pin.FrameType.BODY)]
    if frame.parentJoint == 0:
        raise RobotError(f"the link {link!r} does not move. Take one behind the last joint.")
    shift = np.zeros(3) if offset is None else np.asarray(offset, dtype=float)
    angles = np.zeros(3) if rpy is None else np.asarray(rpy, dtype=float)
    if shift.shape != (3,) or angles.shape != (3,) or not np.isfinite([*shift, *angles]).all():
        raise RobotError(f"a frame at {link!r} needs 3 finite numbers as offset; got {offset}.")
    placement = frame.placement * pin.SE3(pin.rpy.rpyToMatrix(angles), shift)
    return int(frame.parentJoint), placement.translation.copy(), placement.rotation.copy()


def place_at(model: Any, link: str, offset: Any = None, rpy: Any = None) -> Place:
    """Frame fixed to a link, resolved to the link's joint."""
    return Place(*_placed(model, link, offset, rpy), link)


def tool_at(model: Any, link: str, offset: Any = None, rpy: Any = None) -> Tool:
    """Tool frame fixed to a link, resolved to the link's joint."""
    return Tool(*_placed(model, link, offset, rpy), link)
