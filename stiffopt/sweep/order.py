"""In which order cases are solved, and from which other one each starts.

The first case starts from the beginning. Each following round doubles the number of cases: every
one starts from the nearest of the rounds before. So nearly all start near, few wait for others, and
what a case starts from does not depend on workers, kills or time.
"""

from __future__ import annotations

import numpy as np

from stiffopt.sweep.cases import Case
from stiffopt.units import number_and_unit


def spread_order(cases: list[Case]) -> list[Case]:
    """Cases far from each other first: the order in which rounds take them."""
    count = max(len(cases) - 1, 1).bit_length()
    # Numbers with their bits reversed spread evenly over a grid.
    keys = [int(f"{number:0{count}b}"[::-1], 2) for number in range(len(cases))]
    return [cases[k] for k in np.argsort(keys, kind="stable")]


def predecessors(cases: list[Case]) -> dict[str, str | None]:
    """Key of the case that each starts from, by its key; None for those that start cold."""
    found: dict[str, str | None] = {}
    groups: dict[object, list[Case]] = {}
    for case in spread_order(cases):
        found[case.key] = None
        # Other starts than the usual one, and other kinds than motions, start from the beginning.
        if case.kind == "trajectory" and case.start == 0:
            groups.setdefault(case.base, []).append(case)
    for own in groups.values():
        places = _normalised_values(own)
        for k in range(1, len(own)):
            rounds = 1 << (k.bit_length() - 1)
            distance = np.abs(places[:rounds] - places[k]).sum(axis=1)
            found[own[k].key] = own[int(np.argmin(distance))].key
    return found


def _normalised_values(cases: list[Case]) -> np.ndarray:
    """Varied values (cases, values): numbers from 0 to 1, of others which one it is."""
    columns = []
    for k in range(len(cases[0].changes)):
        values = [case.changes[k][1] for case in cases]
        numbers = [_number_or_nan(value) for value in values]
        if not np.all(np.isfinite(numbers)):
            texts = sorted({str(value) for value in values})
            numbers = [float(texts.index(str(value))) for value in values]
        column = np.array(numbers)
        columns.append((column - column.min()) / (np.ptp(column) or 1.0))
    return np.stack(columns, axis=1) if columns else np.zeros((len(cases), 0))


def _number_or_nan(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return np.nan
    return number_and_unit(value)[0]
