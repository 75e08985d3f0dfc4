"""Collision constraints: rows that keep solids on their sides of separating planes.

In every interval in which two solids come near, a plane separates the volume swept by the first one
from the second, and both ends of the interval are constrained to its side by the clearance. With
fixed planes these rows are smooth and sufficient. After a solve the planes are updated for the
motion found, which satisfies them, so that the objective decreases monotonically.

Source: Schulman et al. (2014), "Motion planning with sequential convex optimization and convex
collision checking", for the convex hull of the volume swept between two instants.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from stiffopt.dynamics.kinematics import ROW_PARAMETERS, height_over_plane
from stiffopt.robot.separating_planes import SeparatingPlane, SeparatingPlanes
from stiffopt.transcription.node_rows import NodeRows, renumber_node_rows, with_node_rows
from stiffopt.transcription.ocp import Rows
from stiffopt.transcription.transcription import Transcription

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import TrajectoryProblem

CLEARANCE_ROWS = "clearance"
# Couples of solids nearer than the clearance plus this share of the arm's length get rows.
_NEAR_COUPLE_ARM_SHARE = 0.02
# Scale of the rows [m], and violation of the clearance that is tolerated [m].
_ROW_SCALE = 0.1
_CLEARANCE_TOLERANCE = 1e-6
# Rows of one plane at one node; further support points of a solid get none.
_MAX_ROWS_PER_NODE = 6

# Number of a couple and of an interval.
Place = tuple[int, int]


class ClearanceRows:
    """Collision constraints of a problem, kept from one solve to the next.

    Pairs that have `collided` get rows in every interval, others where they are near.
    """

    def __init__(self, problem: TrajectoryProblem, collided: Collection[tuple[str, str]]) -> None:
        self.problem = problem
        self.model = problem.clearance_model
        self._planes = SeparatingPlanes(self.model)
        # Of each pair, beyond the stated clearance [m].
        self._extra_clearance = np.zeros(len(self.model.pairs))
        pairs = {self.model.pairs.index(pair) for pair in collided}
        self._couples_everywhere = {
            k for k, pair in enumerate(self.model.pair_of) if int(pair) in pairs
        }
        self._active_places: set[Place] = set()
        self._base_transcription: Transcription | None = None
        self._functions: dict[tuple[int, int], ca.Function] = {}

    def add_rows(self, plain: Transcription, x: np.ndarray) -> Transcription:
        """Return the transcription with rows for all couples near at the NLP vector `x`."""
        self._base_transcription, self._active_places = plain, set()
        return self._add_clearance_rows(x)

    def update_planes(self, made: Transcription, x: np.ndarray) -> tuple[Transcription, bool]:
        """Return the rows updated at `x`, and True where their structure is that of `made`."""
        assert self._base_transcription is not None
        before = set(self._active_places)
        blocks = self._clearance_blocks(self._base_transcription, x)
        if self._active_places == before:
            return (
                renumber_node_rows(made, self._base_transcription, blocks) if blocks else made
            ), True
        return with_node_rows(self._base_transcription, blocks), False

    def collides_elsewhere(self, x: np.ndarray) -> bool:
        """Return True where a couple without rows is too near; it gets rows everywhere."""
        assert self._base_transcription is not None
        _, nearest = self._interval_distances(self._base_transcription, x)
        close = np.argwhere(nearest < self._required_distances - _CLEARANCE_TOLERANCE)
        new = {int(k) for i, k in close if (int(k), int(i)) not in self._active_places}
        self._couples_everywhere |= new
        return bool(new)

    def rows_at(self, x: np.ndarray) -> Transcription:
        """Return the rows as of `add_rows` at another vector, with couples that collided since."""
        return self._add_clearance_rows(x)

    def increase_clearance(self, pair: tuple[str, str], by: float) -> None:
        """Increase the clearance of a pair [m], for the motion's curvature between nodes."""
        self._extra_clearance[self.model.pairs.index(pair)] += by

    @property
    def base_row_count(self) -> int:
        """Number of rows of the programme without clearances."""
        assert self._base_transcription is not None
        return len(self._base_transcription.nlp.lower_g)

    @property
    def _required_distances(self) -> np.ndarray:
        """Required distance of every couple (couples,) [m]."""
        return np.asarray(
            self.problem.stated_cell.clearance + self._extra_clearance[self.model.pair_of],
            dtype=float,
        )

    def _add_clearance_rows(self, x: np.ndarray) -> Transcription:
        assert self._base_transcription is not None
        blocks = self._clearance_blocks(self._base_transcription, x)
        return (
            with_node_rows(self._base_transcription, blocks) if blocks else self._base_transcription
        )

    def _interval_distances(
        self, plain: Transcription, x: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return positions (nodes, n) and least distances per interval (intervals, couples)."""
        states = plain.node_states(x)[:, _position_states(plain)]
        columns = plain.scheme.state_columns(len(plain.intervals))
        distances = np.array([self.model.couple_distances(q) for q in states])
        return states, distances[columns].min(axis=1)

    def _clearance_blocks(self, plain: Transcription, x: np.ndarray) -> list[NodeRows]:
        """Return the rows of all couples in the intervals in which they are or were near."""
        states, nearest = self._interval_distances(plain, x)
        columns = plain.scheme.state_columns(len(plain.intervals))
        placed = [self.model.placements(q) for q in states]
        near = nearest < self._required_distances + _NEAR_COUPLE_ARM_SHARE * self.model.arm
        near[:, sorted(self._couples_everywhere)] = True
        self._active_places |= {(int(k), int(i)) for i, k in np.argwhere(near)}
        free = _unfixed_nodes(plain)
        blocks = []
        for couple in sorted({k for k, _ in self._active_places}):
            own = sorted(i for k, i in self._active_places if k == couple)
            planes = [self._planes.plane(couple, [placed[c] for c in columns[i]]) for i in own]
            blocks.append(
                self._couple_rows(couple, planes, columns[own], free, _position_states(plain))
            )
        return blocks

    def _couple_rows(
        self,
        couple: int,
        planes: list[SeparatingPlane],
        columns: np.ndarray,
        free: np.ndarray,
        positions: list[int],
    ) -> NodeRows:
        """Return the rows of one couple: every plane at all nodes of its interval."""
        most = min(_MAX_ROWS_PER_NODE, self._planes.supports(couple))
        count = np.arange(most)
        numbers = np.zeros((*columns.shape, most, ROW_PARAMETERS))
        kept = np.zeros((*columns.shape, most), dtype=bool)
        for k, plane in enumerate(planes):
            near = plane.near
            m = min(len(near.radius), most)
            own = np.column_stack(
                [
                    near.centre,
                    near.axis,
                    near.radius,
                    np.tile(plane.normal, (len(near.radius), 1)),
                    np.full(len(near.radius), plane.height + self._required_distances[couple]),
                ]
            )
            # Unused rows repeat the first one's parameters; they have no bounds.
            numbers[k] = own[np.where(count < m, count, 0)]
            kept[k] = (count < m) & free[columns[k]][:, None]
        pair = self.model.pairs[self.model.pair_of[couple]]
        return NodeRows(
            rows=Rows.make(CLEARANCE_ROWS, [" and ".join(pair)], 0.0, np.inf, _ROW_SCALE, unit="m"),
            function=self._height_function(couple),
            states=positions,
            columns=np.repeat(columns.ravel(), most),
            numbers=numbers.reshape(-1, ROW_PARAMETERS),
            kept=kept.ravel(),
        )

    def _height_function(self, couple: int) -> ca.Function:
        first, second = (self.model.solids[k].joint for k in self.model.couples[couple])
        if (first, second) not in self._functions:
            tree = self.problem.robot.tree
            self._functions[first, second] = height_over_plane(tree, first, second)
        return self._functions[first, second]


def _position_states(plain: Transcription) -> list[int]:
    """Return the indices of the joint positions among the states."""
    return [chain[0] for chain in plain.ocp.chains]


def _unfixed_nodes(plain: Transcription) -> np.ndarray:
    """Return a mask of the nodes at which the pose is free."""
    bounds = plain.states
    apart = (bounds.upper - bounds.lower)[_position_states(plain)]
    return np.asarray(np.any(apart > 1e-9, axis=0))
