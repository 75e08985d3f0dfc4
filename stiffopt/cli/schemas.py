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
    from stiffopt.discovery.extended.schema import ExtendedFile
    from stiffopt.files import Section
    from stiffopt.preload.schema import PreloadFile
    from stiffopt.problem.schema import ProblemFile
    from stiffopt.recording.schema import RecordingsFile, StaticFile
    from stiffopt.robot.schema import robot_file

    models: dict[str, type[Section]] = {
        "trajectory": ProblemFile,
        "robot": robot_file(),
        "preload": PreloadFile,
        "recordings": RecordingsFile,
        "static": StaticFile,
        "extended": ExtendedFile,
    }
    print_json(models[kind].model_json_schema(by_alias=True))
    return 0
