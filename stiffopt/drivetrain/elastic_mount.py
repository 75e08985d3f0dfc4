"""Elastic mount: six springs at a point of a link, as an output bearing or a bending link."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


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
