"""Bending link: a beam of uniform section, or the stiffness matrix of a finite element model.

A uniform beam, and most links, have a point at which their stiffness matrix is diagonal: for the
beam the middle of its length (Timoshenko beam with k = 5/6; Przemieniecki, Theory of Matrix
Structural Analysis, 1968, section 5.6). There the link is six springs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from stiffopt.declaration import POSITIVE, Doc, Length, Named, check_fields
from stiffopt.drivetrain import catalogue
from stiffopt.drivetrain.bearing import ElasticMount
from stiffopt.errors import InputError
from stiffopt.robot.joint_load import complete_axes

# Share of a section that carries shear (rectangle 5/6; thin tubes less, whose shear is small too).
_SHEAR_SHARE = 5.0 / 6.0
# Largest coupling of displacement and rotation that is left out, over the geometric mean of both
# compliances: the tool's deflection changes by at most that share.
_MAX_COUPLING = 0.05


@dataclass(frozen=True, kw_only=True)
class LinkBeam:
    """Bending of the link behind a joint, from that joint to the next one.

    A tube (`diameter`) or box (`width`, `height`), or `stiffness` from a finite element model. The
    beam carries what follows and half of the link's own mass.
    """

    diameter: Annotated[Length | None, POSITIVE, Doc("Outer diameter of a tube.")] = None
    width: Annotated[
        Length | None, POSITIVE, Doc("Outer width of a box, across the joint's axis.")
    ] = None
    height: Annotated[
        Length | None, POSITIVE, Doc("Outer height of a box, along the joint's axis.")
    ] = None
    wall: Annotated[Length | None, POSITIVE, Doc("Wall thickness of the tube or box.")] = None
    material: Annotated[
        str, Named("material"), Doc("Material, for its modulus and Poisson's ratio.")
    ] = "aluminium"
    stiffness: Annotated[
        tuple[tuple[float, float, float, float, float, float], ...] | None,
        Doc(
            "6 x 6 stiffness of the link's outer end (origin of the next joint) with its inner end "
            "held, in axes of the link: force and moment [N, N m] over displacement and rotation "
            "[m, rad]."
        ),
    ] = None

    def __post_init__(self) -> None:
        check_fields(self, "beam")
        tube = self.diameter is not None
        box = self.width is not None and self.height is not None
        if (tube + box + (self.stiffness is not None)) != 1:
            raise InputError(
                "give diameter and wall of a tube, width, height and wall of a box, or stiffness."
            )
        if self.stiffness is not None:
            _check_stiffness(np.array(self.stiffness, dtype=float))
            return
        least = min(each for each in (self.diameter, self.width, self.height) if each is not None)
        if self.wall is None or self.wall > 0.5 * least:
            raise InputError(f"wall: needs a thickness up to half of the section, {0.5 * least} m.")

    def mount(self, axis: np.ndarray, end: np.ndarray, carries: int) -> ElasticMount:
        """Return the springs of the link.

        `axis` (3,): of the joint, in axes of the link. `end` (3,): origin of the next joint, from
        the joint's origin [m]. `carries`: next joint, from 0.
        """
        own = complete_axes(axis).T
        if self.stiffness is not None:
            compliance = np.linalg.inv(np.array(self.stiffness, dtype=float))
            middle, axes, diagonal = _decouple(compliance)
            return ElasticMount(own @ (end + middle), own @ axes, diagonal, carries)
        length = float(np.linalg.norm(end))
        if not length > 0.0:
            raise InputError("the next joint has the same origin: a beam needs a length.")
        along = end / length
        # Height lies along the joint's axis as far as that is across the beam.
        up = axis - (axis @ along) * along
        up = up / np.linalg.norm(up) if np.linalg.norm(up) > 1e-6 else complete_axes(along)[:, 0]
        axes = np.column_stack([np.cross(up, along), up, along])
        return ElasticMount(own @ (0.5 * end), own @ axes, self._compliance(length), carries)

    def _compliance(self, length: float) -> np.ndarray:
        """Compliance (6,) at the middle; axes along width, height and beam."""
        material = catalogue.material(self.material)
        area, second, torsion = self._section()
        modulus, shear = material.modulus, material.shear_modulus
        across = length**3 / (12.0 * modulus * second) + length / (_SHEAR_SHARE * shear * area)
        turned = length / (modulus * second[::-1])
        return np.array(
            [*across, length / (modulus * area), *turned, length / (shear * torsion)], dtype=float
        )

    def _section(self) -> tuple[float, np.ndarray, float]:
        """Area [m^2], second moments (2,) for bending along width and height, torsion [m^4]."""
        wall = float(self.wall or 0.0)
        if self.diameter is not None:
            outer, inner = self.diameter, self.diameter - 2.0 * wall
            polar = np.pi / 32.0 * (outer**4 - inner**4)
            return np.pi / 4.0 * (outer**2 - inner**2), np.full(2, 0.5 * polar), float(polar)
        sides = np.array([self.width, self.height], dtype=float)
        inside = sides - 2.0 * wall
        area = float(np.prod(sides) - np.prod(inside))
        second = (sides**3 * sides[::-1] - inside**3 * inside[::-1]) / 12.0
        # Bredt: 4 A^2 over the integral of ds/t along the middle of the wall.
        middle = sides - wall
        torsion = 2.0 * float(np.prod(middle)) ** 2 * wall / float(middle.sum())
        return area, second, torsion


def _check_stiffness(matrix: np.ndarray) -> None:
    """Check a stiffness matrix: 6 x 6, symmetric, positive definite, nearly decoupled somewhere."""
    if matrix.shape != (6, 6) or not np.isfinite(matrix).all():
        raise InputError(f"stiffness: needs 6 x 6 finite numbers, got {matrix.shape}.")
    scale = np.sqrt(np.abs(np.diag(matrix)))
    if np.any(np.abs(matrix - matrix.T) > 1e-3 * np.outer(scale, scale)):
        raise InputError("stiffness: must be symmetric.")
    if np.linalg.eigvalsh((matrix + matrix.T) / 2.0)[0] <= 0.0:
        raise InputError("stiffness: must be positive definite: its inner end is held.")
    _decouple(np.linalg.inv(matrix))


def _decouple(compliance: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return point (3,) from the end, axes (3, 3) and compliance (6,) of six springs.

    Raises `InputError`: no point and axes at which the compliance (6, 6) is diagonal.
    """
    # At p from the end: coupling C_dr - [p] C_rr of displacement and moment.
    columns = np.stack([(_cross_matrix(e) @ compliance[3:, 3:]).ravel() for e in np.eye(3)], axis=1)
    point = np.linalg.lstsq(columns, compliance[:3, 3:].ravel(), rcond=None)[0]
    shift = np.eye(6)
    shift[:3, 3:] = -_cross_matrix(point)
    there = shift @ compliance @ shift.T
    moved, rotated = there[:3, :3], there[3:, 3:]
    _, axes = np.linalg.eigh(moved / np.trace(moved) + rotated / np.trace(rotated))
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    both = np.kron(np.eye(2), axes)
    turned = both.T @ there @ both
    size = np.sqrt(np.diag(turned))
    left = turned / np.outer(size, size) - np.eye(6)
    if np.abs(left).max() > _MAX_COUPLING:
        raise InputError(
            f"stiffness: its displacements and rotations stay coupled by {np.abs(left).max():.0%} "
            f"at any point and axes ({_MAX_COUPLING:.0%} is allowed): divide the link, or give a "
            "tube or box."
        )
    return point, axes, np.diag(turned).copy()


def _cross_matrix(vector: np.ndarray) -> np.ndarray:
    """Matrix of the cross product with a vector (3,)."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
