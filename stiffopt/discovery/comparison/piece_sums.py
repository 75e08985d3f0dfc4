"""Sums of products by pieces, the rows of one channel in one block.

Noise factors of channels change with every fit, columns do not: products are summed once per piece,
and the sums of a fit are weighted sums of these. Most effects act on few channels.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from stiffopt.discovery.comparison.channel_rows import ChannelRows
from stiffopt.discovery.comparison.evidence import AddedSums, Sums, sum_by_block


@dataclass(frozen=True, eq=False)
class PieceColumns:
    """Columns on the pieces where they are not zero."""

    acted: np.ndarray  # (a,) of int, pieces with entries
    parts: tuple[np.ndarray, ...]  # (rows, k) columns on these
    width: int  # number of columns k

    def times(self, values: np.ndarray) -> PieceColumns:
        """Return one column: the sum of these times values (k,)."""
        return PieceColumns(self.acted, tuple((part @ values)[:, None] for part in self.parts), 1)

    @property
    def nbytes(self) -> int:
        """Memory of the columns."""
        return sum(part.nbytes for part in self.parts)


@dataclass(frozen=True, eq=False)
class PieceProducts:
    """Columns with their products."""

    columns: PieceColumns
    cross: np.ndarray  # (a, p, k) products with the columns of the nominal values
    inner: np.ndarray  # (a, k, k)
    moment: np.ndarray  # (a, k) products with the target


class Pieces:
    """Pieces of the rows of runs.

    `block`, `channel` (q,) of int: block and channel of every piece.
    """

    def __init__(self, rows: ChannelRows) -> None:
        number = rows.block * (2 * rows.n) + rows.channel
        self._order = np.argsort(number, kind="stable")
        found, self._starts = np.unique(number[self._order], return_index=True)
        self.block, self.channel = found // (2 * rows.n), found % (2 * rows.n)
        ends = (*self._starts.tolist(), len(number))
        self._slices = [slice(first, last) for first, last in pairwise(ends)]
        # Each piece is one contiguous stretch of rows, so its first row identifies it.
        firsts = self._order[self._starts]
        self._pieces_by_row = np.argsort(firsts)
        self._first_rows = firsts[self._pieces_by_row]

    def split(self, columns: np.ndarray) -> PieceColumns:
        """Return columns (m, k) by pieces."""
        ordered = columns[self._order]
        acted = np.flatnonzero(np.logical_or.reduceat(ordered.any(axis=1), self._starts))
        parts = tuple(ordered[self._slices[q]].copy() for q in acted)
        return PieceColumns(acted, parts, columns.shape[1])

    def from_stretches(self, parts: Iterable[tuple[int, np.ndarray]], width: int) -> PieceColumns:
        """Return columns by pieces, as `split` does, from stretches of nonzero rows.

        `parts` (rows, k): first row, and the columns from there on; whole pieces, each at most
        once. `width`: number of columns k.
        """
        found: dict[int, np.ndarray] = {}
        for begin, columns in parts:
            low, high = np.searchsorted(self._first_rows, (begin, begin + len(columns)))
            pieces = self._pieces_by_row[low:high].tolist()
            for q, first in zip(pieces, (self._first_rows[low:high] - begin).tolist(), strict=True):
                own = self._slices[q]
                part = columns[first : first + own.stop - own.start]
                if part.any():
                    found[q] = part.copy()
        acted = sorted(found)
        return PieceColumns(np.array(acted, dtype=int), tuple(found[q] for q in acted), width)

    def join(self, columns: PieceColumns) -> np.ndarray:
        """Return columns (m, k) of all rows."""
        ordered = np.zeros((len(self._order), columns.width))
        for q, part in zip(columns.acted, columns.parts, strict=True):
            ordered[self._slices[q]] = part
        return self.unorder(ordered.T).T

    def order(self, columns: np.ndarray) -> np.ndarray:
        """Return rows (..., m) in the order of pieces."""
        return columns[..., self._order]

    def unorder(self, ordered: np.ndarray) -> np.ndarray:
        """Return rows (..., m) in their own order again."""
        out = np.empty_like(ordered)
        out[..., self._order] = ordered
        return out

    def cut(self, ordered: np.ndarray) -> list[np.ndarray]:
        """Return the rows of every piece, views of rows (..., m) in the order of pieces."""
        return [ordered[..., part] for part in self._slices]


class PieceSums:
    """Sums of products of the nominal values' columns, and with further columns.

    `columns` (p, m): columns of the nominal values over the stated noise, rows in the order of
    pieces. `target` (m,): in the order of rows.
    """

    def __init__(self, pieces: Pieces, columns: np.ndarray, target: np.ndarray) -> None:
        self.pieces = pieces
        self._transposed = pieces.cut(columns)
        self._target = pieces.cut(pieces.order(target))
        self.gram = np.array([c @ c.T for c in self._transposed])
        self.moment = np.array([c @ y for c, y in zip(self._transposed, self._target, strict=True)])
        self.square = np.array([float(y @ y) for y in self._target])

    def products(self, added: PieceColumns) -> PieceProducts:
        """Return the products of further columns."""
        count, p, k = len(added.acted), self.gram.shape[1], added.width
        cross, inner, moment = (
            np.zeros((count, p, k)),
            np.zeros((count, k, k)),
            np.zeros((count, k)),
        )
        for i, (q, part) in enumerate(zip(added.acted.tolist(), added.parts, strict=True)):
            cross[i], inner[i] = self._transposed[q] @ part, part.T @ part
            moment[i] = part.T @ self._target[q]
        return PieceProducts(added, cross, inner, moment)


class WeightedSums:
    """Sums by blocks of nominal values and effects, with one weight per piece.

    `weight` (q,): weight of the squares of each piece.
    """

    def __init__(
        self, sums: PieceSums, effects: Sequence[PieceProducts], weight: np.ndarray
    ) -> None:
        self._sums, self._weight = sums, weight
        self._block = sums.pieces.block
        self._blocks = int(self._block.max()) + 1
        self._effect_columns: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        nominal, total = sums.gram.shape[1], sums.gram.shape[1]
        by_piece: dict[int, list[tuple[int, np.ndarray]]] = {}
        gram, moment, square = (
            sum_by_block((weight * x.T).T, self._block, self._blocks)
            for x in (sums.gram, sums.moment, sums.square)
        )
        for each in effects:
            for q, part in zip(each.columns.acted.tolist(), each.columns.parts, strict=True):
                by_piece.setdefault(q, []).append((total, part))
            total += each.columns.width
        for q, own in by_piece.items():
            places = np.concatenate([first + np.arange(part.shape[1]) for first, part in own])
            self._effect_columns[q] = (
                places,
                np.concatenate([part for _, part in own], axis=1).T.copy(),
            )
        self._size = total
        whole = np.zeros((self._blocks, total, total))
        moments = np.zeros((self._blocks, total))
        whole[:, :nominal, :nominal], moments[:, :nominal] = gram, moment
        first = nominal
        for each in effects:
            cross, _, with_target = self.added_sums(each).by_block
            place = slice(first, first + each.columns.width)
            whole[:, :, place] = cross
            whole[:, place, :] = cross.swapaxes(1, 2)
            moments[:, place] = with_target
            first = place.stop
        self.own = Sums(whole, moments, square)

    def added_sums(self, added: PieceProducts) -> AddedSums:
        """Return the sums of further columns with these."""
        acted, parts = added.columns.acted, added.columns.parts
        weight = self._weight[acted]
        cross = np.zeros((len(acted), self._size, added.columns.width))
        cross[:, : added.cross.shape[1]] = added.cross
        for i, (q, part) in enumerate(zip(acted.tolist(), parts, strict=True)):
            if q in self._effect_columns:
                places, others = self._effect_columns[q]
                cross[i, places] = others @ part
        return AddedSums(
            weight[:, None, None] * cross,
            weight[:, None, None] * added.inner,
            weight[:, None] * added.moment,
            self._block[acted],
            self._blocks,
        )
