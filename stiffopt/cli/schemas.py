"""`stiffopt schema`, `explain`, `catalogue` and `compare`."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from stiffopt.cli.base import NoChanges, app, print_json, refuse_changes


@app.command
def schema(
    kind: Literal[
        "trajectory",
        "robot",
        "catalogue",
        "preload",
        "sweep",
        "recordings",
        "static",
        "extended",
    ] = "trajectory",
) -> int:
    """Print the JSON Schema of a kind of file, for editors.

    `kind`: kind of file.
    """
    from stiffopt.report.file_reference import file_schema

    print_json(file_schema(kind))
    return 0


@app.command
def explain(key: str) -> int:
    """Explain a key of a file: description, allowed values, unit and default.

    `key`: name or path of a key, such as prepressure, motion.duration or limits.jerk.
    """
    from stiffopt.report.common.terminal import print_lines
    from stiffopt.report.file_reference import explain_key

    print_lines(explain_key(key))
    return 0


@app.command
def catalogue(
    kind: Literal["reducers", "bolts", "keys", "belts", "surfaces", "robots", "effects"]
    | None = None,
    *,
    own: Path | None = None,
) -> int:
    """List the shipped catalogues with the sources of their numbers.

    `kind`: catalogue to list; without it, the available catalogues. `own`: user catalogue file,
    whose entries are added.
    """
    from contextlib import nullcontext

    from stiffopt.drivetrain.tables import with_own
    from stiffopt.report.catalogue_page import catalogue_kinds, catalogue_table
    from stiffopt.report.common.terminal import print_table
    from stiffopt.robot.own_catalogue import read_own_catalogue

    with nullcontext() if own is None else with_own(read_own_catalogue(own)):
        if kind is None:
            print_table(("stiffopt catalogue", "entries", "named in files as"), catalogue_kinds())
        else:
            print_table(*catalogue_table(kind))
    return 0


@app.command
def compare(first: Path, second: Path, *, changes: NoChanges = ()) -> int:
    """Compare two result folders and list every entry that differs.

    `first`: folder of a solve, a preload study or a diagnosis. `second`: another folder of the same
    kind.
    """
    from stiffopt.report.common.terminal import print_lines, print_table
    from stiffopt.report.compare import compare_results

    refuse_changes(changes)
    name, rows = compare_results(first, second)
    if rows:
        print_table((name, str(first), str(second), "change"), rows)
    else:
        print_lines((f"{name}: no differences.",))
    return 0
