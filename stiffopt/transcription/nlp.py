"""The nonlinear programme, with a name for every variable and row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stiffopt.transcription.ocp import Rows

# SX or MX of CasADi.
Symbols = Any


@dataclass(frozen=True)
class Places:
    """Points in time: phase index and fraction of that phase, one entry a point."""

    phase: np.ndarray
    fraction: np.ndarray

    def __len__(self) -> int:
        return len(self.phase)

    def __getitem__(self, index: Any) -> Places:
        return Places(self.phase[index], self.fraction[index])


@dataclass(frozen=True)
class NlpEntry:
    """Name of one variable or row of the NLP."""

    name: str  # name of the block, for example "torque"
    label: str  # label within the block, for example "joint 2"
    unit: str
    scale: float  # the NLP works with value / scale
    phase: int  # -1 where the entry belongs to no point in time
    fraction: float  # of the phase's duration; nan where the entry belongs to no point in time
    given: bool = False  # True where both bounds are equal

    def __str__(self) -> str:
        text = f"{self.name}, {self.label}" if self.label else self.name
        if self.phase < 0:
            return text
        phase = f" of phase {self.phase + 1}" if self.phase else ""
        return f"{text} (at {100.0 * self.fraction:.3g} %{phase})"


@dataclass(frozen=True)
class RowViolation:
    """A row outside its bound."""

    entry: NlpEntry
    # In the row's unit.
    value: float
    bound: float
    relative: float  # excess divided by the row's scale

    def __str__(self) -> str:
        unit = f" {self.entry.unit}" if self.entry.unit else ""
        return (
            f"{self.entry}: {self.value:.6g}{unit} against {self.bound:.6g}{unit} "
            f"({100.0 * self.relative:.3g} % of its scale)"
        )


@dataclass(frozen=True, kw_only=True)
class Block:
    """Entries with m labels at k points in time; labels run fastest."""

    rows: Rows  # name, labels, unit and scale
    places: Places | None  # None for entries that belong to no point in time (k = 1)
    # (m, k) bounds in the entries' unit.
    lower: np.ndarray
    upper: np.ndarray
    offset: int  # index of its first entry
    structural: bool = False  # equations of motion; never named as the cause of a conflict

    @property
    def size(self) -> int:
        """Number of entries."""
        return int(self.lower.size)

    @property
    def scales(self) -> np.ndarray:
        """Scale of every entry (m k,)."""
        return np.tile(self.rows.scale, self.lower.shape[1])

    def take(self, vector: np.ndarray) -> np.ndarray:
        """Read the block's (k, m) values in their unit out of a scaled NLP vector."""
        part = np.asarray(vector, dtype=float)[self.offset : self.offset + self.size]
        values = part.reshape(self.lower.shape[1], -1 if self.size else 0) * self.rows.scale
        return np.asarray(values)

    def entry(self, index: int) -> NlpEntry:
        """Name of the entry at a position counted from the block's start."""
        point, label = divmod(index, len(self.rows))
        return NlpEntry(
            name=self.rows.name,
            label=self.rows.labels[label],
            unit=self.rows.unit,
            scale=float(self.rows.scale[label]),
            phase=-1 if self.places is None else int(self.places.phase[point]),
            fraction=np.nan if self.places is None else float(self.places.fraction[point]),
            given=bool(self.lower[label, point] == self.upper[label, point]),
        )


@dataclass
class Blocks:
    """Blocks in order; grows while an NLP is put together."""

    items: list[Block] = field(default_factory=list)
    size: int = 0

    def add(
        self,
        rows: Rows,
        places: Places | None,
        lower: np.ndarray | None = None,
        upper: np.ndarray | None = None,
        structural: bool = False,
    ) -> Block:
        """Append a block; bounds of single entries override those of the rows."""
        shape = (len(rows), 1 if places is None else len(places))
        block = Block(
            rows=rows,
            places=places,
            lower=np.broadcast_to(rows.lower[:, None], shape) if lower is None else lower,
            upper=np.broadcast_to(rows.upper[:, None], shape) if upper is None else upper,
            offset=self.size,
            structural=structural,
        )
        self.items.append(block)
        self.size += block.size
        return block

    def add_nodes(
        self,
        rows: Rows,
        places: Places,
        first: tuple[np.ndarray | None, np.ndarray | None],
        last: tuple[np.ndarray | None, np.ndarray | None],
    ) -> Block:
        """Append values at nodes, with further bounds (lower, upper) of the first and the last."""
        lower = np.repeat(rows.lower[:, None], len(places), axis=1)
        upper = np.repeat(rows.upper[:, None], len(places), axis=1)
        for column, (low, high) in ((0, first), (-1, last)):
            if low is not None:
                lower[:, column] = np.maximum(lower[:, column], low)
            if high is not None:
                upper[:, column] = np.minimum(upper[:, column], high)
        return self.add(rows, places, lower, upper)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Scaled lower and upper bounds of all entries."""
        lower = [b.lower.ravel(order="F") / b.scales for b in self.items]
        upper = [b.upper.ravel(order="F") / b.scales for b in self.items]
        return np.concatenate([np.zeros(0), *lower]), np.concatenate([np.zeros(0), *upper])

    def entry(self, index: int) -> NlpEntry:
        """Name of an entry by its position in the NLP vector."""
        for block in self.items:
            if index < block.offset + block.size:
                return block.entry(index - block.offset)
        raise IndexError(f"entry {index} of {self.size}")


@dataclass(frozen=True, eq=False)
class BlockScales:
    """Scales of a programme, one array a block."""

    # Of states and controls, or spline coefficients, of static variables and durations.
    variables: tuple[np.ndarray, ...]
    rows: tuple[np.ndarray, ...]

    @classmethod
    def of(cls, nlp: Nlp) -> BlockScales:
        """Collect the scales of a programme."""
        both = ([block.rows.scale for block in own.items] for own in (nlp.variables, nlp.rows))
        return cls(*map(tuple, both))

    def tobytes(self) -> bytes:
        """Return all scales as bytes for comparison."""
        return b"".join(each.tobytes() for each in (*self.variables, *self.rows))


@dataclass(frozen=True, kw_only=True)
class Nlp:
    """minimise f(x, p) subject to lower_x <= x <= upper_x, lower_g <= g(x, p) <= upper_g.

    All vectors are scaled: value = scale * entry. `derivatives` replace those of `casadi.nlpsol`:
    grad_f, jac_g, hess_lag. `numbers` are values of the last parameters, which may differ between
    problems of one graph.
    """

    x: Symbols
    p: Symbols
    f: Symbols
    g: Symbols
    variables: Blocks
    rows: Blocks
    lower_x: np.ndarray
    upper_x: np.ndarray
    lower_g: np.ndarray
    upper_g: np.ndarray
    derivatives: Mapping[str, Any] = field(default_factory=dict)
    numbers: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def parameters(self, own: np.ndarray | None = None) -> np.ndarray:
        """Join the problem's own parameters (default zeros) and the numbers."""
        if own is None:
            own = np.zeros(self.p.numel() - len(self.numbers))
        return np.append(np.asarray(own, dtype=float), self.numbers)

    @property
    def casadi(self) -> dict[str, Symbols]:
        """Problem for `casadi.nlpsol`."""
        return {"x": self.x, "p": self.p, "f": self.f, "g": self.g}

    def violations(self, g: np.ndarray) -> np.ndarray:
        """Scaled excess of every row over its bounds, zero inside."""
        g = np.asarray(g, dtype=float).ravel()
        return np.asarray(np.maximum(np.maximum(self.lower_g - g, g - self.upper_g), 0.0))

    def worst_excess(self, g: np.ndarray) -> tuple[float, str]:
        """Largest scaled excess of a row, and that row's name; "" where none is exceeded."""
        excess = self.violations(g)
        worst = float(excess.max(initial=0.0))
        return worst, str(self.rows.entry(int(np.argmax(excess)))) if worst > 0.0 else ""

    @property
    def structural(self) -> np.ndarray:
        """Mask (m,) of the rows that are equations of motion."""
        each = [np.full(block.size, block.structural) for block in self.rows.items]
        return np.concatenate([np.zeros(0, dtype=bool), *each])

    def worst_rows(self, g: np.ndarray, n: int = 5, tolerance: float = 0.0) -> list[RowViolation]:
        """Find the n most violated rows, each name and label once, at its worst point.

        `g`: row values of the NLP (scaled). `tolerance`: rows with a smaller relative excess are
        left out.
        """
        g = np.asarray(g, dtype=float).ravel()
        excess = self.violations(g)
        found: dict[tuple[str, str], RowViolation] = {}
        for index in np.argsort(-excess, kind="stable"):
            if len(found) == n or not excess[index] > tolerance:
                break
            entry = self.rows.entry(int(index))
            below = g[index] < self.lower_g[index]
            bound = self.lower_g[index] if below else self.upper_g[index]
            violation = RowViolation(
                entry, g[index] * entry.scale, bound * entry.scale, float(excess[index])
            )
            found.setdefault((entry.name, entry.label), violation)
        return list(found.values())

    def conflicts(
        self, multipliers_x: np.ndarray, multipliers_g: np.ndarray, n: int = 40
    ) -> list[NlpEntry]:
        """Find at most `n` limits and boundary values that cannot hold together, by falling weight.

        At a point of locally minimal infeasibility, multipliers weigh the bounds that prevent
        feasibility. Each name and label stands once, at its heaviest point; those below one per
        cent of the heaviest are left out.
        """
        found: list[tuple[float, NlpEntry]] = []
        for blocks, multipliers in ((self.variables, multipliers_x), (self.rows, multipliers_g)):
            weights = np.abs(np.asarray(multipliers, dtype=float).ravel())
            for block in blocks.items:
                if block.structural or not block.size:
                    continue
                own = weights[block.offset : block.offset + block.size]
                table = own.reshape(-1, len(block.rows))
                for label, total in enumerate(table.sum(axis=0)):
                    point = int(np.argmax(table[:, label]))
                    found.append((float(total), block.entry(point * len(block.rows) + label)))
        found.sort(key=lambda pair: -pair[0])
        return [entry for weight, entry in found[:n] if weight > 0.01 * found[0][0]]
