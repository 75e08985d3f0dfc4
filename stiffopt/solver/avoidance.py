"""Rows that keep a motion clear of collisions: planes between what comes near, step by step.

In every interval in which two solids come near, a plane is laid between what the first one sweeps
and the second, and both ends of the interval keep to its side, as far as the clearance asks. With
the planes fixed these are smooth rows, and sufficient; solved, the planes are laid anew on the
motion that was found, which keeps them, so that the objective only falls.

Source: Schulman et al. (2014), "Motion planning with sequential convex optimization and convex
collision checking", for the hull of what is swept between two instants.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from stiffopt.dynamics.height_over_plane import NUMBERS, height_over_plane
from stiffopt.robot.separating_planes import SeparatingPlane, SeparatingPlanes
from stiffopt.transcription.node_rows import NodeRows, renumber_node_rows, with_node_rows
from stiffopt.transcription.ocp import Rows
from stiffopt.transcription.transcription import Transcription

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import TrajectoryProblem

NAME = "clearance"
# Solids nearer than this share of the arm's length get rows.
_NEAR = 0.02
# Of rows, for the solver's tolerance [m]; what is nearer than allowed by less is kept.
_SCALE = 0.1
_EXACT = 1e-6
# Rows of one plane at one node, at most.
_ROWS = 6

# Number of a couple and of an interval.
Place = tuple[int, int]


class Avoidance:
    """What keeps a problem's motion clear, from one solve to the next.

    Parameters
    ----------
    problem : TrajectoryProblem
    met : collection of pairs
        What the motion met before: they get rows in every interval, others where they are near.
    """

    def __init__(self, problem: TrajectoryProblem, met: Collection[tuple[str, str]]) -> None:
        self.problem = problem
        self.model = problem.clearance_model
        self._planes = SeparatingPlanes(self.model)
        # By how much more than the clearance each pair is kept apart [m].
        self._more = np.zeros(len(self.model.pairs))
        pairs = {self.model.pairs.index(pair) for pair in met}
        self._everywhere = {k for k, pair in enumerate(self.model.pair_of) if int(pair) in pairs}
        self._active: set[Place] = set()
        self._plain: Transcription | None = None
        self._functions: dict[tuple[int, int], ca.Function] = {}

    def added(self, plain: Transcription, x: np.ndarray) -> Transcription:
        """The transcription with rows for all that is near at the vector `x` of its programme."""
        self._plain, self._active = plain, set()
        return self._with_rows(x)

    def renewed(self, made: Transcription, x: np.ndarray) -> tuple[Transcription, bool]:
        """The rows laid anew at `x`; whether they are at the same places as those of `made`."""
        assert self._plain is not None
        before = set(self._active)
        blocks = self._blocks(self._plain, x)
        if self._active == before:
            return (renumber_node_rows(made, self._plain, blocks) if blocks else made), True
        return with_node_rows(self._plain, blocks), False

    def ran_into(self, x: np.ndarray) -> bool:
        """Whether a motion comes too near to something where no rows are; there are from now on."""
        assert self._plain is not None
        _, nearest = self._near(self._plain, x)
        close = np.argwhere(nearest < self._band - _EXACT)
        new = {int(k) for i, k in close if (int(k), int(i)) not in self._active}
        self._everywhere |= new
        return bool(new)

    def begun_again(self, x: np.ndarray) -> Transcription:
        """The rows as `added` at another vector, for all that was run into since."""
        return self._with_rows(x)

    def widen(self, pair: tuple[str, str], by: float) -> None:
        """Keep a pair further apart [m]: what the motion bends between two nodes."""
        self._more[self.model.pairs.index(pair)] += by

    @property
    def rows_before(self) -> int:
        """How many rows the programme has without those of clearances."""
        assert self._plain is not None
        return len(self._plain.nlp.lower_g)

    @property
    def _band(self) -> np.ndarray:
        """How far every couple is kept apart (couples,) [m]."""
        return np.asarray(
            self.problem.stated_cell.clearance + self._more[self.model.pair_of], dtype=float
        )

    def _with_rows(self, x: np.ndarray) -> Transcription:
        assert self._plain is not None
        blocks = self._blocks(self._plain, x)
        return with_node_rows(self._plain, blocks) if blocks else self._plain

    def _near(self, plain: Transcription, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions (nodes, n), and least distances in every interval (intervals, couples)."""
        states = plain.node_states(x)[:, _positions(plain)]
        columns = plain.scheme.state_columns(len(plain.intervals))
        distances = np.array([self.model.couple_distances(q) for q in states])
        return states, distances[columns].min(axis=1)

    def _blocks(self, plain: Transcription, x: np.ndarray) -> list[NodeRows]:
        """Rows of all couples that are near, or were near before, in the intervals where."""
        states, nearest = self._near(plain, x)
        columns = plain.scheme.state_columns(len(plain.intervals))
        placed = [self.model.placements(q) for q in states]
        near = nearest < self._band + _NEAR * self.model.arm
        near[:, sorted(self._everywhere)] = True
        self._active |= {(int(k), int(i)) for i, k in np.argwhere(near)}
        free = _free_nodes(plain)
        blocks = []
        for couple in sorted({k for k, _ in self._active}):
            own = sorted(i for k, i in self._active if k == couple)
            planes = [self._planes.plane(couple, [placed[c] for c in columns[i]]) for i in own]
            blocks.append(self._rows(couple, planes, columns[own], free, _positions(plain)))
        return blocks

    def _rows(
        self,
        couple: int,
        planes: list[SeparatingPlane],
        columns: np.ndarray,
        free: np.ndarray,
        positions: list[int],
    ) -> NodeRows:
        """Rows of one couple: every plane at all nodes of its interval."""
        most = min(_ROWS, self._planes.supports(couple))
        count = np.arange(most)
        numbers = np.zeros((*columns.shape, most, NUMBERS))
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
                    np.full(len(near.radius), plane.height + self._band[couple]),
                ]
            )
            # Rows without bounds take the first one's numbers.
            numbers[k] = own[np.where(count < m, count, 0)]
            kept[k] = (count < m) & free[columns[k]][:, None]
        pair = self.model.pairs[self.model.pair_of[couple]]
        return NodeRows(
            rows=Rows.make(NAME, [" and ".join(pair)], 0.0, np.inf, _SCALE, unit="m"),
            function=self._function(couple),
            states=positions,
            columns=np.repeat(columns.ravel(), most),
            numbers=numbers.reshape(-1, NUMBERS),
            kept=kept.ravel(),
        )

    def _function(self, couple: int) -> ca.Function:
        first, second = (self.model.solids[k].joint for k in self.model.couples[couple])
        if (first, second) not in self._functions:
            tree = self.problem.robot.tree
            self._functions[first, second] = height_over_plane(tree, first, second)
        return self._functions[first, second]


def _positions(plain: Transcription) -> list[int]:
    """Which states are the joints' positions."""
    return [chain[0] for chain in plain.ocp.chains]


def _free_nodes(plain: Transcription) -> np.ndarray:
    """Nodes at which the pose is not given."""
    bounds = plain.states
    apart = (bounds.upper - bounds.lower)[_positions(plain)]
    return np.asarray(np.any(apart > 1e-9, axis=0))
