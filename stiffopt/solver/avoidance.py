"""Rows that keep a motion clear of collisions: planes between what comes near, step by step.

In every interval in which two solids come near, a plane is laid between what the first one sweeps
and the second, and both ends of the interval keep to its side, as far as the clearance asks. With
the planes fixed these are smooth rows, and sufficient; solved, the planes are laid anew on the
motion that was found, which keeps them, so that the objective only falls.

Source: Schulman et al. (2014), "Motion planning with sequential convex optimization and convex
collision checking", for the hull of what is swept between two instants.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.dynamics.height_over_plane import NUMBERS, height_over_plane
from stiffopt.robot.separation import SeparatingPlane, Separation
from stiffopt.transcription.node_rows import NodeRows, renumbered, with_node_rows
from stiffopt.transcription.ocp import Rows
from stiffopt.transcription.transcription import Transcription

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import TrajectoryProblem

NAME = "clearance"
# Solids nearer than this share of the arm's length get rows.
_NEAR = 0.05
# Of rows, for the solver's tolerance [m].
_SCALE = 0.1
# Rows of one plane at one node.
_ROWS = 6

# Number of a couple and of an interval.
Place = tuple[int, int]


@dataclass(eq=False)
class Avoidance:
    """What keeps a problem's motion clear, from one solve to the next.

    Parameters
    ----------
    problem : TrajectoryProblem
    more : array (pairs,)
        By how much more than the clearance each pair is kept apart, for what the motion bends
        between two nodes [m].
    """

    problem: TrajectoryProblem
    more: np.ndarray = field(init=False)
    _active: set[Place] = field(init=False, default_factory=set)
    _plain: Transcription | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        self.model = self.problem.clearance_model
        self.separation = Separation(self.model)
        self.more = np.zeros(len(self.model.pairs))
        self._functions = {
            key: height_over_plane(self.problem.robot.tree, *key)
            for key in {self._joints(k) for k in range(len(self.model.couples))}
        }

    def added(self, plain: Transcription, x: np.ndarray) -> Transcription:
        """The transcription with rows for all that is near at the vector `x` of its programme."""
        self._plain, self._active = plain, set()
        blocks = self._blocks(plain, x)
        return with_node_rows(plain, blocks) if blocks else plain

    def renewed(self, made: Transcription, x: np.ndarray) -> tuple[Transcription, bool]:
        """The rows laid anew at `x`; whether they are at the same places as those of `made`."""
        assert self._plain is not None
        before = set(self._active)
        blocks = self._blocks(self._plain, x)
        if self._active == before:
            return (renumbered(made, self._plain, blocks) if blocks else made), True
        return with_node_rows(self._plain, blocks), False

    def widen(self, pair: tuple[str, str], by: float) -> None:
        """Keep a pair further apart [m]."""
        self.more[self.model.pairs.index(pair)] += by

    def _joints(self, couple: int) -> tuple[int, int]:
        a, b = self.model.couples[couple]
        return self.model.solids[a].joint, self.model.solids[b].joint

    def _blocks(self, plain: Transcription, x: np.ndarray) -> list[NodeRows]:
        """Rows of all couples that are near, or were near before, in the intervals where."""
        index = [chain[0] for chain in plain.ocp.chains]
        columns = plain.scheme.state_columns(len(plain.intervals))
        states = plain.states.take(x)[:, index]
        near = np.array([self.model.couple_distances(q) for q in states])
        placed = [self.model.placements(q) for q in states]
        band = self.problem.stated_cell.clearance + self.more[self.model.pair_of]
        reach = band + _NEAR * self.model.arm
        nearest = near[columns].min(axis=1)
        self._active |= {(int(k), int(i)) for i, k in np.argwhere(nearest < reach)}
        free = self._free_columns(plain, index)
        blocks = []
        for couple in sorted({k for k, _ in self._active}):
            own = sorted(i for k, i in self._active if k == couple)
            planes = [self.separation.plane(couple, [placed[c] for c in columns[i]]) for i in own]
            blocks.append(self._rows(couple, planes, columns[own], band[couple], free, index))
        return blocks

    def _rows(
        self,
        couple: int,
        planes: list[SeparatingPlane],
        columns: np.ndarray,
        band: float,
        free: np.ndarray,
        index: list[int],
    ) -> NodeRows:
        """Rows of one couple: every plane at all nodes of its interval."""
        nodes = columns.shape[1]
        numbers = np.zeros((len(planes), nodes, _ROWS, NUMBERS))
        kept = np.zeros((len(planes), nodes, _ROWS), dtype=bool)
        for k, plane in enumerate(planes):
            near = plane.near
            m = len(near.radius)
            own = np.column_stack(
                [
                    near.centre,
                    near.axis,
                    near.radius,
                    np.tile(plane.normal, (m, 1)),
                    np.full(m, plane.height + band),
                ]
            )
            # Rows without bounds take the first one's numbers.
            numbers[k] = own[np.where(np.arange(_ROWS) < m, np.arange(_ROWS), 0)]
            kept[k] = (np.arange(_ROWS) < m) & free[columns[k]][:, None]
        pair = self.model.pairs[self.model.pair_of[couple]]
        return NodeRows(
            rows=Rows.make(NAME, [" and ".join(pair)], 0.0, np.inf, _SCALE, unit="m"),
            function=self._functions[self._joints(couple)],
            states=index,
            columns=np.repeat(columns.ravel(), _ROWS),
            numbers=numbers.reshape(-1, NUMBERS),
            kept=kept.ravel(),
        )

    def _free_columns(self, plain: Transcription, index: list[int]) -> np.ndarray:
        """Nodes at which the pose is not given."""
        block = plain.states
        bounds = (block.take(each) for each in (plain.nlp.lower_x, plain.nlp.upper_x))
        lower, upper = (each[:, index] for each in bounds)
        return np.asarray(np.any(upper - lower > 1e-9, axis=1))
