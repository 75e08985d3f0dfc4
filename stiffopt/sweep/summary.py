"""Summary of a sweep: table, spread of optima over initial guesses, trade-off front; its files."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.files import SCHEMA, atomic_write, pick, write_csv, write_json
from stiffopt.sweep.cases import Case, Sweep
from stiffopt.sweep.run import is_unusable
from stiffopt.sweep.shared_values import SharedValue, shared_values
from stiffopt.units import number_and_unit

Cell = float | int | str | None


@dataclass(frozen=True)
class StartSpread:
    """Optima of one case from several initial guesses."""

    # Objective in SI.
    best: float
    worst: float
    unit: str
    # Number of starts with a usable result, and of all starts.
    usable: int
    starts: int
    near: int  # number of starts within 1 % of the best


@dataclass(frozen=True)
class Front:
    """Pareto front of one entry and the objective."""

    # Entry and unit of its values; "" for bare numbers.
    over: str
    unit: str
    # (k,) increasing values with decreasing objectives (increasing, if maximised).
    values: np.ndarray
    objectives: np.ndarray
    knee: int | None  # index of the knee; None below three points


@dataclass(frozen=True)
class SweepSummary:
    """Sweep with its results."""

    sweep: Sweep
    results: Sequence[dict[str, Any] | None]  # content of the cases' files, in order
    interrupted: bool

    @cached_property
    def units(self) -> dict[str, str]:
        """Names and units of the values, in order of first occurrence."""
        found: dict[str, str] = {}
        for each in self.results:
            for name, entry in (each or {"values": {}})["values"].items():
                found.setdefault(name, entry["unit"])
        return found

    def columns(self) -> dict[str, list[Cell]]:
        """Table of finished cases: number, varied entries, status and values (SI)."""
        done = self.done
        bases = self.sweep.base_names
        table: dict[str, list[Cell]] = {"case": [case.number for case, _ in done]}
        if len(bases) > 1:
            table["base"] = [bases[case.base] for case, _ in done]
        for place in self.sweep.places:
            table[place] = [table_cell(dict(case.changes)[place]) for case, _ in done]
        if self.sweep.starts > 1:
            table["start"] = [case.start for case, _ in done]
        table["status"] = [found["status"] for _, found in done]
        for name in self.units:
            table[name] = [found["values"].get(name, {}).get("value") for _, found in done]
        table["message"] = [found["message"] if is_unusable(found) else "" for _, found in done]
        return table

    @property
    def done(self) -> list[tuple[Case, dict[str, Any]]]:
        """Finished cases with their results."""
        pairs = zip(self.sweep.cases, self.results, strict=True)
        return [(case, found) for case, found in pairs if found is not None]

    def statuses(self) -> dict[str, int]:
        """Number of cases by status; "open" without a result."""
        found: dict[str, int] = {}
        for each in self.results:
            status = "open" if each is None else str(each["status"])
            found[status] = found.get(status, 0) + 1
        return found

    def spreads(self) -> dict[tuple[Cell, ...], StartSpread]:
        """Spread of the optima of each case over several starts."""
        if self.sweep.starts < 2:
            return {}
        bases = self.sweep.base_names
        groups: dict[tuple[Cell, ...], list[float | None]] = {}
        for case, found in self.done:
            name = (bases[case.base], *(table_cell(value) for _, value in case.changes))
            groups.setdefault(name, []).append(objective_value(found))
        spreads = {}
        for name, own in groups.items():
            values = [value for value in own if value is not None]
            if not values:
                continue
            best = (max if self.maximised else min)(values)
            spread = max(abs(value - best) for value in values)
            near = sum(abs(value - best) <= 0.01 * abs(best) for value in values)
            worst = best + (-spread if self.maximised else spread)
            spreads[name] = StartSpread(
                best, worst, self.units["objective"], len(values), len(own), near
            )
        return spreads

    @property
    def maximised(self) -> bool:
        """True if a larger objective is better."""
        return any(found["maximised"] for _, found in self.done)

    def front(self) -> Front | None:
        """Trade-off front, if the sweep has one."""
        if not self.sweep.front:
            return None
        sign = -1.0 if self.maximised else 1.0
        over = [number_and_unit(dict(case.changes)[self.sweep.front]) for case, _ in self.done]
        points = sorted(
            (at, sign * value)
            for (at, _), (_, found) in zip(over, self.done, strict=True)
            if (value := objective_value(found)) is not None
        )
        kept: list[tuple[float, float]] = []
        for value, cost in points:
            if not kept or cost < kept[-1][1]:
                kept.append((value, cost))
        values = np.array([value for value, _ in kept])
        costs = np.array([cost for _, cost in kept])
        unit = (over[0][1] if over else None) or ""
        return Front(self.sweep.front, unit, values, sign * costs, knee(values, costs))

    def shared_values(self) -> list[SharedValue]:
        """Values that several recording sets tell, common to all or each arm's own."""
        bases = self.sweep.base_names
        told: dict[str, list[dict[str, Any]]] = {}
        for case, found in self.done:
            own = {"case": ", ".join(case.changed)}
            values = found["result"].get("simulation") or ()
            told.setdefault(bases[case.base], []).extend({**each, **own} for each in values)
        return shared_values(told)

    def document(self) -> dict[str, Any]:
        """Content of sweep.json."""
        front = self.front()
        return {
            "schema": SCHEMA,
            **pick(self.sweep, "title", "kind"),
            "cases": len(self.sweep.cases),
            "status": self.statuses(),
            "interrupted": self.interrupted,
            "varied": list(self.sweep.places),
            "units": self.units,
            "spread": [
                {"case": list(name), **vars(spread)} for name, spread in self.spreads().items()
            ],
            "shared_values": [vars(each) for each in self.shared_values()],
            "front": None
            if front is None
            else {
                **pick(front, "over", "unit", "values", "objectives"),
                "knee": None if front.knee is None else front.values[front.knee],
            },
        }


def objective_value(found: dict[str, Any]) -> float | None:
    """Objective [SI] of a usable result."""
    if is_unusable(found):
        return None
    value = found["values"].get("objective", {}).get("value")
    return None if value is None else float(value)


def table_cell(value: Any) -> Cell:
    """Convert a varied value to a cell; numbers stay numbers."""
    if isinstance(value, str) or (isinstance(value, int | float) and not isinstance(value, bool)):
        return value if isinstance(value, str) else float(value)
    return str(value)


def knee(values: np.ndarray, costs: np.ndarray) -> int | None:
    """Knee of a falling curve: point farthest below the line between its ends, axes scaled to 0..1.

    >>> knee(np.array([1.0, 2.0, 3.0, 4.0]), np.array([9.0, 2.0, 1.0, 0.0]))
    1
    """
    if len(values) < 3:
        return None
    x = (values - values[0]) / (values[-1] - values[0])
    y = (costs - costs[-1]) / (costs[0] - costs[-1])
    return int(np.argmax(1.0 - x - y))


SUMMARY_FILE = "sweep.json"
TABLE_FILE = "table.csv"
PARQUET_FILE = "table.parquet"


def write_sweep(summary: SweepSummary, directory: str | Path) -> Path:
    """Write table and summary; return the table's path. Parquet only where pyarrow is installed."""
    folder = Path(directory)
    columns = summary.columns()
    rows = zip(*columns.values(), strict=True)
    write_csv(folder / TABLE_FILE, list(columns), rows)
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        pass
    else:
        # pyarrow needs one type per column: mixed columns become texts.
        uniform = {
            name: [None if c is None else str(c) for c in cells]
            if any(isinstance(c, str) for c in cells)
            else cells
            for name, cells in columns.items()
        }
        stream = io.BytesIO()
        parquet.write_table(pyarrow.table(uniform), stream)
        atomic_write(folder / PARQUET_FILE, stream.getvalue())
    write_json(folder / SUMMARY_FILE, summary.document())
    return folder / TABLE_FILE
