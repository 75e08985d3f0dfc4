"""`stiffopt schema`: what may stand in the files."""

from __future__ import annotations

from typing import Literal

from stiffopt.cli.base import app, print_json


@app.command
def schema(
    kind: Literal[
        "trajectory", "robot", "preload", "recordings", "static", "extended"
    ] = "trajectory",
) -> int:
    """Print the JSON Schema of a file kind, for editors.

    Parameters
    ----------
    kind
        Which file.
    """
    from stiffopt.report.file_reference import file_schema

    print_json(file_schema(kind))
    return 0
