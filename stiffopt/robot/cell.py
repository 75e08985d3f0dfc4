"""Robot cell: floor, boxes, planes and meshes around an arm, and the clearance to keep."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from stiffopt.declaration import (
    NOT_NEGATIVE,
    POSITIVE,
    Angle,
    Doc,
    Length,
    Ratio,
    check_fields,
)
from stiffopt.errors import InputError

_Point = tuple[Length, Length, Length]
_RollPitchYaw = tuple[Angle, Angle, Angle]
_FLOOR_NAME = "floor"


@dataclass(frozen=True, kw_only=True)
class Box:
    """A box of the cell."""

    name: Annotated[str, Doc("Name in results.")]
    size: Annotated[
        tuple[
            Annotated[Length, POSITIVE], Annotated[Length, POSITIVE], Annotated[Length, POSITIVE]
        ],
        Doc("Edges along its axes."),
    ]
    position: Annotated[_Point, Doc("Centre, base frame.")]
    rpy: Annotated[_RollPitchYaw, Doc("Fixed-axis roll, pitch, yaw of its axes.")] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        check_fields(self, f"box {self.name!r}")


@dataclass(frozen=True, kw_only=True)
class Plane:
    """A wall or ceiling of the cell; the half-space behind it is solid."""

    name: Annotated[str, Doc("Name in results.")]
    point: Annotated[_Point, Doc("Any of its points, base frame.")]
    normal: Annotated[tuple[Ratio, Ratio, Ratio], Doc("Direction towards the arm, base axes.")]

    def __post_init__(self) -> None:
        check_fields(self, f"plane {self.name!r}")
        if not np.linalg.norm(self.normal) > 0.0:
            raise InputError(f"plane {self.name!r}: the normal 0 0 0 has no direction. Give one.")


@dataclass(frozen=True, kw_only=True)
class MeshObstacle:
    """A mesh of the cell (STL, OBJ, DAE)."""

    name: Annotated[str, Doc("Name in results.")]
    file: Annotated[str, Doc("Path of the mesh, relative to the problem file.")]
    position: Annotated[_Point, Doc("Origin, base frame.")] = (0.0, 0.0, 0.0)
    rpy: Annotated[_RollPitchYaw, Doc("Fixed-axis roll, pitch, yaw of its axes.")] = (0.0, 0.0, 0.0)
    scale: Annotated[Ratio, POSITIVE, Doc("Metres for a unit of the mesh: 0.001 for mm.")] = 1.0

    def __post_init__(self) -> None:
        check_fields(self, f"mesh {self.name!r}")


@dataclass(frozen=True, kw_only=True)
class Cell:
    """Obstacles of the arm and its clearance, self-collision included."""

    floor: Annotated[
        Length | None, Doc("Height of the floor, base frame; the link at the base may touch it.")
    ] = None
    clearance: Annotated[
        Length, NOT_NEGATIVE, Doc("Least distance to everything, and between the arm's links.")
    ] = 0.0
    self_collision: Annotated[
        bool, Doc("True: links are checked against each other, except neighbours.")
    ] = True
    link_radius: Annotated[
        Length | None,
        POSITIVE,
        Doc(
            "Radius of links that the URDF gives no shape, as rods from joint to joint; default "
            "estimated from the reach, and then not used between links."
        ),
    ] = None
    box: Annotated[tuple[Box, ...], Doc("Boxes.")] = ()
    plane: Annotated[tuple[Plane, ...], Doc("Walls and ceilings.")] = ()
    mesh: Annotated[tuple[MeshObstacle, ...], Doc("Meshes.")] = ()

    def __post_init__(self) -> None:
        check_fields(self, "cell")
        names = self.names
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"two obstacles of the cell are named {name!r}. Rename one.")

    @property
    def names(self) -> list[str]:
        """Names of all obstacles."""
        own = [_FLOOR_NAME] if self.floor is not None else []
        things: tuple[Box | Plane | MeshObstacle, ...] = (*self.box, *self.plane, *self.mesh)
        return [*own, *(each.name for each in things)]

    def found_in(self, folder: Path) -> Cell:
        """Cell with absolute paths of its mesh files."""
        return replace(
            self,
            mesh=tuple(
                replace(each, file=str((folder / each.file).resolve())) for each in self.mesh
            ),
        )
