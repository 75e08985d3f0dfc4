"""Distances between links of an arm and between links and obstacles, by coal."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import coal
import numpy as np
import pinocchio as pin

from stiffopt.errors import InputFileError
from stiffopt.robot.body_tree import arm_reach, link_capsules
from stiffopt.robot.cell import Cell
from stiffopt.robot.frames import first_link_of, rotation_from_rpy
from stiffopt.robot.link_shapes import LinkShape, Purpose, convex_hull, load_mesh, load_mesh_file

if TYPE_CHECKING:
    from stiffopt.robot.robot import Robot

# Links that overlap in all of so many random poses overlap by design, such as wrist housings.
_SAMPLED_POSES = 60


@dataclass(frozen=True)
class Solid:
    """Solid fixed to a joint's frame; joint 0 is the base with the cell."""

    name: str
    joint: int
    placement: Any  # in the frame of the joint
    geometry: Any
    of_cell: bool = False
    guessed: bool = False  # the solid is a capsule of estimated radius


class ClearanceModel:
    """Distances of all pairs of solids that can collide.

    Parameters
    ----------
    robot : Robot
        Collision shapes of its URDF, else visual ones, else capsules from joint to joint. Meshes
        of links are replaced by their convex hulls.
    cell : Cell
        Its meshes are used as they are.

    Attributes
    ----------
    pairs : list of (name, name)
        Names of links and obstacles.
    guessed : tuple of str
        Links that are capsules of estimated radius.
    missing : tuple of str
        Meshes of the URDF that were not found or cannot be read.
    solids : list of Solid
        Links first.
    couples : list of (int, int)
        Indices of solids whose distance is computed; obstacles come second.
    pair_of : array (len(couples),)
        Index of the pair of each couple.
    arm : float
        Length of the arm including the shapes of its links, prismatic joints at zero [m].
    """

    def __init__(self, robot: Robot, cell: Cell) -> None:
        self._model = robot.model.copy()
        missing: list[str] = []
        links = list(_link_solids(robot, cell, missing))
        self.solids = solids = [*links, *_cell_solids(cell)]
        self.missing = tuple(dict.fromkeys(missing))
        self.guessed = tuple(dict.fromkeys(each.name for each in links if each.guessed))
        self._geometry = pin.GeometryModel()
        for number, solid in enumerate(solids):
            self._geometry.addGeometryObject(
                pin.GeometryObject(
                    f"{number} {solid.name}", solid.joint, solid.placement, solid.geometry
                )
            )
        chosen = list(_collision_pairs(robot, cell, solids))
        for a, b in chosen:
            self._geometry.addCollisionPair(pin.CollisionPair(a, b))
        self._make_data()
        named = [(solids[a].name, solids[b].name) for a, b in chosen]
        own = [not solids[b].of_cell for _, b in chosen]
        designed = self._always_overlapping(robot, np.array(own, dtype=bool), named)
        for a, b in [pair for pair, name in zip(chosen, named, strict=True) if name in designed]:
            self._geometry.removeCollisionPair(pin.CollisionPair(a, b))
        self.couples = [
            pair for pair, name in zip(chosen, named, strict=True) if name not in designed
        ]
        named = [name for name in named if name not in designed]
        self._make_data()
        self.pairs = list(dict.fromkeys(named))
        index = {pair: k for k, pair in enumerate(self.pairs)}
        self.pair_of = np.array([index[name] for name in named], dtype=int)
        self.arm = arm_reach(robot.tree, robot.tool) + max(map(_link_extent, links), default=0.0)
        self._prismatic = robot.prismatic

    def _make_data(self) -> None:
        self._data = self._model.createData()
        self._geometry_data = pin.GeometryData(self._geometry)

    def _always_overlapping(
        self, robot: Robot, own: np.ndarray, named: list[tuple[str, str]]
    ) -> set[tuple[str, str]]:
        """Pairs of links that overlap in every sampled pose."""
        if not own.any():
            return set()
        low, high = robot.position_lower, robot.position_upper
        low = np.where(np.isfinite(low), low, -np.pi)
        high = np.where(np.isfinite(high), high, np.pi)
        poses = np.random.default_rng(1).uniform(low, high, (_SAMPLED_POSES, robot.n))
        nearest: dict[tuple[str, str], np.ndarray] = {}
        every = np.array([self.couple_distances(q) for q in poses])
        for k in np.flatnonzero(own):
            nearest[named[k]] = np.minimum(nearest.get(named[k], np.inf), every[:, k])
        return {pair for pair, each in nearest.items() if np.all(each < 0.0)}

    def couple_distances(self, q: np.ndarray) -> np.ndarray:
        """Distance of every couple (len(couples),) at joint positions (n,) [m]."""
        pin.computeDistances(self._model, self._data, self._geometry, self._geometry_data, q)
        return np.array([each.min_distance for each in self._geometry_data.distanceResults])

    def distances(self, q: np.ndarray) -> np.ndarray:
        """Distance of every pair (len(pairs),) at joint positions (n,); overlap is negative [m]."""
        nearest = np.full(len(self.pairs), np.inf)
        np.minimum.at(nearest, self.pair_of, self.couple_distances(q))
        return nearest

    def placements(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotation (n + 1, 3, 3) and origin (n + 1, 3) of the joint frames, the base first."""
        pin.forwardKinematics(self._model, self._data, q)
        frames = list(self._data.oMi)
        return np.array([f.rotation for f in frames]), np.array([f.translation for f in frames])

    def fastest(self, speed: np.ndarray, position: np.ndarray) -> np.ndarray:
        """Bound (K,) on the rate of any distance [m/s] for joint speeds and positions (K, n).

        No point is farther from an axis than the length of the arm with its prismatic joints.
        """
        slides = np.abs(position[:, self._prismatic]).sum(axis=1)
        arms = np.where(self._prismatic, 1.0, (self.arm + slides)[:, None])
        return np.asarray(np.sum(np.abs(speed) * arms, axis=1))


def _link_solids(robot: Robot, cell: Cell, missing: list[str]) -> Iterator[Solid]:
    """Solids of links: collision shapes, else visual ones, else capsules; extends `missing`."""
    shown: set[int] = set()
    purposes: tuple[Purpose, ...] = ("collision", "visual")
    for purpose in purposes:
        placed = [each for each in robot.joint_shapes(purpose) if each.joint not in shown]
        for each in placed:
            form = coal_form(each.shape)
            if form is None:
                missing.append(each.shape.name)
                continue
            shown.add(each.joint)
            at = pin.SE3(each.rotation, each.offset)
            yield Solid(each.shape.link, each.joint, at, form)
    for rod in link_capsules(robot.tree, robot.tool):
        if rod.joint in shown or rod.joint == 0:
            continue
        radius = rod.radius if cell.link_radius is None else cell.link_radius
        along = rod.end - rod.begin
        length = float(np.linalg.norm(along))
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), along / length)
        yield Solid(
            first_link_of(robot.model, rod.joint),
            rod.joint,
            pin.SE3(turn.matrix(), 0.5 * (rod.begin + rod.end)),
            coal.Capsule(radius, length),
            guessed=cell.link_radius is None,
        )


def _link_extent(solid: Solid) -> float:
    """Largest distance of a point of a link from the origin of its joint [m]."""
    form = solid.geometry
    form.computeLocalAABB()
    return float(
        np.linalg.norm(solid.placement.translation)
        + np.linalg.norm(form.aabb_center)
        + form.aabb_radius
    )


def coal_form(shape: LinkShape) -> Any:
    """Convert a shape to coal; None for a mesh that is missing or cannot be read."""
    if shape.kind == "box":
        return coal.Box(*shape.size)
    if shape.kind == "sphere":
        return coal.Sphere(*shape.size)
    if shape.kind == "cylinder":
        return coal.Cylinder(*shape.size)
    if not shape.known:
        return None
    try:
        return convex_hull(load_mesh(shape), shape.file)
    except InputFileError:
        return None


def _cell_solids(cell: Cell) -> Iterator[Solid]:
    """Obstacles of the cell, fixed to the base."""
    up = np.array([0.0, 0.0, 1.0])
    if cell.floor is not None:
        yield Solid("floor", 0, pin.SE3.Identity(), coal.Halfspace(up, cell.floor), of_cell=True)
    for plane in cell.plane:
        normal = np.array(plane.normal) / np.linalg.norm(plane.normal)
        solid = coal.Halfspace(normal, float(normal @ plane.point))
        yield Solid(plane.name, 0, pin.SE3.Identity(), solid, of_cell=True)
    for box in cell.box:
        at = pin.SE3(rotation_from_rpy(box.rpy), np.array(box.position))
        yield Solid(box.name, 0, at, coal.Box(*box.size), of_cell=True)
    for mesh in cell.mesh:
        solid = load_mesh_file(mesh.file, np.full(3, mesh.scale), boxes=True)
        at = pin.SE3(rotation_from_rpy(mesh.rpy), np.array(mesh.position))
        yield Solid(mesh.name, 0, at, solid, of_cell=True)


def _collision_pairs(robot: Robot, cell: Cell, solids: list[Solid]) -> Iterator[tuple[int, int]]:
    """Indices of solids that can collide: links with obstacles, links that are no neighbours."""
    parents = {j + 1: body.parent for j, body in enumerate(robot.tree.bodies)}
    for a, one in enumerate(solids):
        for b, other in enumerate(solids):
            if one.of_cell or (not other.of_cell and b <= a):
                continue
            if other.of_cell:
                if one.joint > 0:
                    yield a, b
                continue
            near = one.joint == other.joint or one.joint == parents.get(other.joint)
            near = near or other.joint == parents.get(one.joint)
            if cell.self_collision and not near and not (one.guessed or other.guessed):
                yield a, b
