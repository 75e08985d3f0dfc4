"""Freedom of a process on a tool path: tool axis rotation, tilt, placement of the work, posture.

The pose of the tool at a distance along the stated path is

    position  o + d + exp(w) (p - o),    rotation  exp(w) R exp(a, b, 0) exp(0, 0, c)

with p and R as stated, o the origin of the work frame, d and w its shift and rotation, a and b the
tilt of the tool about its own x and y axes, and c its rotation about its own z axis. The last three
are constant or cubic B-splines of the distance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import scipy

from stiffopt.declaration import NOT_NEGATIVE, Angle, Doc, Length, check_fields
from stiffopt.errors import ProblemError

ErrorDirection = Literal["any", "axis", "side"]
_HalfWidths = tuple[
    Annotated[Length, NOT_NEGATIVE],
    Annotated[Length, NOT_NEGATIVE],
    Annotated[Length, NOT_NEGATIVE],
]
_HalfAngles = tuple[
    Annotated[Angle, NOT_NEGATIVE], Annotated[Angle, NOT_NEGATIVE], Annotated[Angle, NOT_NEGATIVE]
]
_SPLINE_DEGREE = 3


@dataclass(frozen=True, kw_only=True)
class PathFreedom:
    """Freedom that the process leaves on the tool path, chosen when the problem is read."""

    tool_axis_rotation: Annotated[
        Angle,
        NOT_NEGATIVE,
        Doc("Largest rotation about the tool's z axis, either way; 180 deg or more: any."),
    ] = 0.0
    tilt: Annotated[
        Angle, NOT_NEGATIVE, Doc("Largest angle of the tool's z axis from the stated one.")
    ] = 0.0
    placement_box: Annotated[
        _HalfWidths, Doc("Largest shift of the work frame along the base axes, either way.")
    ] = (0.0, 0.0, 0.0)
    placement_rotation: Annotated[
        _HalfAngles,
        Doc(
            "Largest rotation of the work frame about the base axes, either way (rotation vector)."
        ),
    ] = (0.0, 0.0, 0.0)
    posture: Annotated[
        Literal["any", "near"],
        Doc("Any solution of the inverse kinematics, or the one that `near` selects."),
    ] = "any"
    variation: Annotated[
        Literal["along_path", "constant"],
        Doc("Rotation and tilt change smoothly along the path, or are one for all of it."),
    ] = "along_path"
    minimise: Annotated[
        Literal["tool_error", "duration"],
        Doc(
            "Least deflection of the tool under path.force, its largest value on the path; or "
            "least time within the limits of joint velocity and acceleration."
        ),
    ] = "tool_error"
    error_direction: Annotated[
        ErrorDirection,
        Doc(
            "Direction of the deflection that counts: any; axis: along the stated tool axis, "
            "normal to a face; side: across the feed, normal to a flank."
        ),
    ] = "any"

    def __post_init__(self) -> None:
        check_fields(self, "path.freedom", ProblemError)

    @property
    def rotates_freely(self) -> bool:
        """True where any rotation about the tool's axis is allowed."""
        return self.tool_axis_rotation >= np.pi - 1e-9

    @property
    def turns(self) -> bool:
        """True where rotation or tilt of the tool is free."""
        return self.tool_axis_rotation > 0.0 or self.tilt > 0.0

    @property
    def placement(self) -> np.ndarray:
        """Half-widths (6,) of shift [m] and rotation [rad] of the work frame."""
        return np.array([*self.placement_box, *self.placement_rotation])

    def turn_basis(self, length: float) -> TurnBasis:
        """Return the basis of rotation and tilt on a path [m]."""
        if self.variation == "constant" or not self.turns:
            return TurnBasis(np.array([0.0, length]), 0)
        return TurnBasis.splines(length)


@dataclass(frozen=True, eq=False)
class TurnBasis:
    """B-splines over the distance along a path."""

    knots: np.ndarray  # (m,) [m]
    degree: int  # 0 for a single constant

    @classmethod
    def splines(cls, length: float) -> TurnBasis:
        """Cubic B-splines on a path [m]."""
        # Distance between the knots of the turns' splines [m], and least and largest number of
        # intervals.
        count = int(np.clip(np.ceil(length / 0.02), 6, 60))
        inner = np.linspace(0.0, length, count + 1)
        ends = np.zeros(_SPLINE_DEGREE), np.full(_SPLINE_DEGREE, length)
        return cls(np.concatenate([ends[0], inner, ends[1]]), _SPLINE_DEGREE)

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return len(self.knots) - self.degree - 1

    def matrix(self, along: np.ndarray) -> np.ndarray:
        """Values (K, m) of the basis at distances (K,) [m]."""
        if self.degree == 0:
            return np.ones((len(along), 1))
        inside = np.clip(along, self.knots[0], self.knots[-1])
        return np.asarray(
            scipy.interpolate.BSpline.design_matrix(inside, self.knots, self.degree).toarray()
        )


@dataclass(frozen=True, eq=False)
class FreedomChoice:
    """Chosen placement, rotation, tilt and posture."""

    origin: np.ndarray  # (3,) [m] of the stated work frame
    placement: np.ndarray  # (6,) shift [m] and rotation vector [rad] of the work frame
    basis: TurnBasis
    # (m, 3) coefficients of the rotation about the tool's axis and of the tilts about x and y
    # [rad].
    turns: np.ndarray
    joints: Callable[[float], np.ndarray]  # joint positions (n,) near those at a distance [m]

    @property
    def work_rotation(self) -> scipy.spatial.transform.Rotation:
        """Rotation of the work frame from the stated one."""
        return scipy.spatial.transform.Rotation.from_rotvec(self.placement[3:])

    def angles(self, along: np.ndarray) -> np.ndarray:
        """Rotation and tilts (K, 3) [rad] at distances (K,) [m]."""
        return np.asarray(self.basis.matrix(along) @ self.turns)

    def place(self, points: np.ndarray) -> np.ndarray:
        """Points (K, 3) [m] of the stated path as they are placed."""
        moved = self.work_rotation.apply(points - self.origin) if len(points) else points
        return np.asarray(self.origin + self.placement[:3] + moved)

    def turn(self, along: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Orientations (K, 3, 3) of the tool from the stated ones at distances (K,) [m]."""
        spin, *tilt = self.angles(along).T
        leaned = scipy.spatial.transform.Rotation.from_rotvec(
            np.stack([*tilt, np.zeros_like(spin)], axis=1)
        )
        spun = scipy.spatial.transform.Rotation.from_rotvec(
            spin[:, None] * np.array([0.0, 0.0, 1.0])
        )
        return np.asarray(self.work_rotation.as_matrix() @ rotations @ (leaned * spun).as_matrix())
