"""Files of an error budget: budget.json and budget.csv."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.budget.budget import CONFIDENCE, ORIENTATION, POSITION, ErrorBudget, semi_axes
from stiffopt.budget.measurements import Measurement
from stiffopt.budget.volume import VolumeBudget
from stiffopt.files import SCHEMA, atomic_write, write_csv

JSON_FILE, CSV_FILE = "budget.json", "budget.csv"
_BUDGET_PARTS = (("position", "m", POSITION), ("orientation", "rad", ORIENTATION))


def write_budget(
    budget: ErrorBudget,
    volume: VolumeBudget,
    measurements: Sequence[Measurement],
    assumptions: Sequence[str],
    folder: Path,
) -> None:
    """Write budget.json (SI) and budget.csv, the bounds over time, into `folder`."""
    document = {
        "schema": SCHEMA,
        "kind": "budget",
        "confidence": CONFIDENCE,
        "motion": budget_entry(budget),
        "volume": {
            **budget_entry(volume.budget),
            "unreached": volume.unreached.tolist(),
        },
        "measurements": [asdict(each) for each in measurements],
        "assumptions": list(assumptions),
    }
    bounds = [budget.bound(rows) for _, _, rows in _BUDGET_PARTS]
    table = np.column_stack([budget.states.time, budget.place, *bounds, budget.mean])
    write_csv(
        folder / CSV_FILE,
        (
            *("t", "tool_x", "tool_y", "tool_z", "bound_position", "bound_orientation"),
            *(f"mean_{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz")),
        ),
        table.tolist(),
    )
    atomic_write(folder / JSON_FILE, json.dumps(document, indent=2, allow_nan=False) + "\n")


def budget_entry(budget: ErrorBudget) -> dict[str, Any]:
    """Return bounds, ellipsoids and shares in every state as plain data."""
    covariance = budget.covariance
    entry: dict[str, Any] = {"time": budget.states.time.tolist(), "tool": budget.place.tolist()}
    for name, unit, rows in _BUDGET_PARTS:
        lengths, directions = semi_axes(covariance[:, rows, rows])
        entry[name] = {
            "unit": unit,
            "bound": budget.bound(rows).tolist(),
            "mean": budget.mean[:, rows].tolist(),
            "semi_axes": lengths.tolist(),
            # A row a semi-axis.
            "directions": directions.swapaxes(1, 2).tolist(),
            "shares": {group: part.tolist() for group, part in budget.shares(rows).items()},
        }
    return entry
