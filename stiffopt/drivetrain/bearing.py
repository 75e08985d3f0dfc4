"""Elastic mounts: the output bearing of a joint, elastic in tilt, axial and radial direction."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from stiffopt.declaration import POSITIVE, Doc, Length, LinearStiffness, Stiffness, check_fields
from stiffopt.errors import InputError


@dataclass(frozen=True, eq=False)
class ElasticMount:
    """Linear springs at a point of the link behind a joint."""

    # (3,) point from the joint's origin [m], in axes of the link whose third is the joint's.
    place: np.ndarray
    axes: np.ndarray  # (3, 3) axes of the springs as columns, in the same axes
    # (6,) wrench [F, M] at the point to displacement and rotation there [m/N, rad/(N m)]; 0 is
    # rigid.
    compliance: np.ndarray
    # Next joint (from 0) of a bending link, which carries that joint and half of its own mass;
    # None: the springs carry the whole link.
    carries: int | None = None

    def loads(self, joint: int) -> tuple[int, ...]:
        """Joints (from 0) whose mean wrench is that of the springs behind a joint."""
        return (joint,) if self.carries is None else (joint, self.carries)

    def times(self, factor: float) -> ElasticMount:
        """Return the mount with its stiffnesses times a factor."""
        return replace(self, compliance=self.compliance / factor)


@dataclass(frozen=True, kw_only=True)
class OutputBearing:
    """Output bearing of a joint: tilt about both transverse axes, axial and radial deflection.

    Linear and alike about the axis, as catalogues state it: tilt = moment / moment_stiffness
    (Harmonic Drive, LynxDrive catalogue 1018856, equation 45.1). A missing stiffness is rigid.
    """

    moment_stiffness: Annotated[
        Stiffness | None,
        POSITIVE,
        Doc("Moment stiffness, of the tilt about an axis across that of the joint; default rigid."),
    ] = None
    axial_stiffness: Annotated[
        LinearStiffness | None, POSITIVE, Doc("Stiffness along the axis; default rigid.")
    ] = None
    radial_stiffness: Annotated[
        LinearStiffness | None, POSITIVE, Doc("Stiffness across the axis; default rigid.")
    ] = None
    position: Annotated[
        Length, Doc("Position of the bearing along the joint's axis, from the joint's origin.")
    ] = 0.0

    def __post_init__(self) -> None:
        check_fields(self, "bearing")
        if not any((self.moment_stiffness, self.axial_stiffness, self.radial_stiffness)):
            raise InputError(
                "a bearing without stiffness is rigid: give moment_stiffness, axial_stiffness, "
                "radial_stiffness or `catalogue`, or leave the section out."
            )

    def times(self, factor: float) -> OutputBearing:
        """Return the bearing with its stiffnesses times a factor."""
        keys = ("moment_stiffness", "axial_stiffness", "radial_stiffness")
        given = {key: own for key in keys if (own := getattr(self, key)) is not None}
        return replace(self, **{key: factor * own for key, own in given.items()})

    @property
    def mount(self) -> ElasticMount:
        """Springs of the bearing; rigid about the joint's axis, where the drivetrain yields."""
        stiffness = (
            *2 * (self.radial_stiffness,),
            self.axial_stiffness,
            *2 * (self.moment_stiffness,),
        )
        compliance = [0.0 if each is None else 1.0 / each for each in (*stiffness, None)]
        place = np.array([0.0, 0.0, self.position])
        return ElasticMount(place, np.eye(3), np.array(compliance))
