"""Planes that separate two convex solids while the arm moves from one pose to another.

A plane is fixed to the second solid. The first solid lies on its far side in all poses of the step
at the largest possible distance: the plane is that of the least distance between the second solid
and the convex hull of the first one in these poses, by coal. A motion that satisfies the planes of
all steps keeps the distance, and also satisfies planes computed from the motion itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import coal
import numpy as np

if TYPE_CHECKING:
    from stiffopt.robot.clearance import ClearanceModel, Solid

# Directions of the initial points of the hull; further points are added while they lie lower than
# it by more than this [m].
_AXIS_DIRECTIONS = np.vstack([np.eye(3), -np.eye(3)])
_HEIGHT_TOLERANCE = 1e-6
# Rounds of added points; a few are usual.
_MAX_HULL_PASSES = 20
# Up to so many points coal searches them one by one and needs no edges.
_MAX_HULL_POINTS = 32
# Points on the rim of a disc, for the direction only: distances are exact.
_RIM_POINTS = 8
# Supports of a solid that are constrained by a plane: those that are nearest, or become so by a
# rotation of so much [rad].
_MAX_NEAR_SUPPORTS = 6
_MAX_TURN = 0.5


@dataclass(frozen=True, eq=False)
class Support:
    """Support of a convex solid: points, balls and discs whose convex hull it is."""

    centre: np.ndarray  # (m, 3) in the frame of the joint [m]
    axis: np.ndarray  # (m, 3) unit vector along the axis of a disc; zero for a ball or a point
    radius: np.ndarray  # (m,) [m]

    def lowest(self, normal: np.ndarray) -> np.ndarray:
        """Least height of each along a direction (3,): (m,) [m]."""
        along = self.axis @ normal
        return np.asarray(
            self.centre @ normal - self.radius * np.sqrt(np.maximum(1.0 - along**2, 0.0))
        )

    def moved(self, rotation: np.ndarray, origin: np.ndarray) -> Support:
        """Support in another frame."""
        return Support(self.centre @ rotation.T + origin, self.axis @ rotation.T, self.radius)

    def points(self) -> np.ndarray:
        """Points (k, 3) whose hull approximates the solid without the radius of balls."""
        rims: list[np.ndarray] = [self.centre[~self._is_disc]]
        for centre, axis, radius in zip(
            self.centre[self._is_disc],
            self.axis[self._is_disc],
            self.radius[self._is_disc],
            strict=True,
        ):
            first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
            first /= np.linalg.norm(first)
            angle = np.arange(_RIM_POINTS) * 2.0 * np.pi / _RIM_POINTS
            second = np.cross(axis, first)
            rims.append(
                centre + radius * (np.outer(np.cos(angle), first) + np.outer(np.sin(angle), second))
            )
        return np.asarray(np.concatenate(rims))

    @property
    def _is_disc(self) -> np.ndarray:
        return np.asarray(np.any(self.axis != 0.0, axis=1))


@dataclass(frozen=True, eq=False)
class SeparatingPlane:
    """Plane in the frame of the second solid's joint, and the nearest supports of the first."""

    normal: np.ndarray  # (3,) unit vector towards the first solid
    height: float  # height of the second solid along the normal [m]
    near: Support  # nearest supports of the first solid, in the frame of its joint
    distance: float  # least distance between plane and first solid over all poses [m]


class SeparatingPlanes:
    """Separating planes of the couples of a clearance model."""

    def __init__(self, model: ClearanceModel) -> None:
        self.model = model
        self._supports = [support_of(solid) for solid in model.solids]

    def supports(self, couple: int) -> int:
        """Number of supports of the first solid of a couple."""
        support = self._supports[self.model.couples[couple][0]]
        assert support is not None
        return len(support.radius)

    def plane(
        self,
        couple: int,
        placements: Sequence[tuple[np.ndarray, np.ndarray]],
    ) -> SeparatingPlane:
        """Separating plane of a couple over a step.

        `couple`: index of the couple. `placements` (array (n + 1, 3, 3), array (n + 1, 3)): frames
        of the joints in every pose of the step.
        """
        a, b = self.model.couples[couple]
        first, second = self.model.solids[a], self.model.solids[b]
        support = self._supports[a]
        assert support is not None
        swept = [
            support.moved(*_relative_frame(each, first.joint, second.joint)) for each in placements
        ]
        normal, witness = self._separating_normal(swept, second)
        other = self._supports[b]
        height = witness
        if other is not None:
            height = -float(other.lowest(-normal).min())
        lowest = np.min([each.lowest(normal) for each in swept], axis=0)
        return SeparatingPlane(
            normal,
            height,
            _nearest_supports(support, lowest),
            float(lowest.min()) - height,
        )

    def _separating_normal(self, swept: list[Support], second: Solid) -> tuple[np.ndarray, float]:
        """Direction from the second solid to the swept first one, and height of the second."""
        at = second.placement
        if isinstance(second.geometry, coal.Halfspace):
            normal = at.rotation @ np.asarray(second.geometry.n)
            return normal, float(second.geometry.d + normal @ at.translation)
        points = np.concatenate([each.points() for each in swept])
        chosen = list(dict.fromkeys(int(k) for k in np.argmax(points @ _AXIS_DIRECTIONS.T, axis=0)))
        if len(points) <= _MAX_HULL_POINTS:
            chosen = list(range(len(points)))
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        placed = coal.Transform3s(at.rotation, at.translation)
        for _ in range(_MAX_HULL_PASSES):
            result.clear()
            coal.distance(
                _convex_hull(points[chosen]),
                coal.Transform3s.Identity(),
                second.geometry,
                placed,
                request,
                result,
            )
            # coal's normal points from the first to the second.
            normal = -np.asarray(result.normal)
            low = points @ normal
            lowest = int(np.argmin(low))
            if (
                low[lowest] > low[chosen].min() - _HEIGHT_TOLERANCE
                or len(chosen) == _MAX_HULL_POINTS
            ):
                break
            chosen.append(lowest)
        return normal, float(normal @ np.asarray(result.getNearestPoint2()))


def support_of(solid: Solid) -> Support | None:
    """Support of a solid in the frame of its joint; None if not convex or not bounded."""
    form = solid.geometry
    axes = np.zeros((1, 3))
    up = np.array([0.0, 0.0, 1.0])
    if isinstance(form, coal.Sphere):
        own = Support(np.zeros((1, 3)), axes, np.array([form.radius]))
    elif isinstance(form, coal.Capsule | coal.Cylinder):
        ends = np.outer([-form.halfLength, form.halfLength], up)
        disc = up if isinstance(form, coal.Cylinder) else np.zeros(3)
        own = Support(ends, np.tile(disc, (2, 1)), np.full(2, form.radius))
    elif isinstance(form, coal.Box):
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
        own = _support_of_points(signs * np.asarray(form.halfSide))
    elif isinstance(form, coal.ConvexBase):
        own = _support_of_points(np.array([form.point(k) for k in range(form.num_points)]))
    else:
        return None
    return own.moved(solid.placement.rotation, solid.placement.translation)


def _support_of_points(points: np.ndarray) -> Support:
    return Support(points, np.zeros_like(points), np.zeros(len(points)))


def _relative_frame(
    placed: tuple[np.ndarray, np.ndarray], first: int, second: int
) -> tuple[np.ndarray, np.ndarray]:
    """Frame of one joint relative to that of another."""
    rotation, origin = placed
    back = rotation[second].T
    return back @ rotation[first], back @ (origin[first] - origin[second])


def _nearest_supports(support: Support, lowest: np.ndarray) -> Support:
    """Supports that are lowest, or can become so by a small rotation of the solid."""
    order = np.argsort(lowest)
    away = np.linalg.norm(support.centre - support.centre[order[0]], axis=1)
    lift = lowest - lowest[order[0]]
    kept = [k for k in order if lift[k] <= _MAX_TURN * away[k] + _HEIGHT_TOLERANCE][
        :_MAX_NEAR_SUPPORTS
    ]
    return Support(support.centre[kept], support.axis[kept], support.radius[kept])


def _convex_hull(points: np.ndarray) -> Any:
    """Convex hull of a few points, flat or not, for coal."""
    corners, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for point in points:
        corners.append(point)
    count = len(points)
    for k in range(count):
        faces.append(coal.Triangle(k, (k + 1) % count, (k + 2) % count))
    return coal.Convex(corners, faces)
