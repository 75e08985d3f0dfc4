"""Answers that are read again: folders of a solve and of a diagnosis, without their manifest.

With it a folder that was changed is refused as a whole, and nothing inside would be read.
"""

from __future__ import annotations

import contextlib
import io
import shutil
from collections.abc import Iterator
from pathlib import Path

from benchmarks.reliability import mutators
from benchmarks.reliability.commands import ROOT
from benchmarks.reliability.subject import RECORDED, Subject


def answers(place: Path) -> Iterator[Subject]:
    """Result folders, laid out below `place`; a small solve and a diagnosis make them."""
    from stiffopt.cli import run
    from stiffopt.discovery.extended.model import load_extended
    from stiffopt.export.motion import read_motion
    from stiffopt.recipe.stored_result import read_result
    from stiffopt.report.compare import compare_results

    work = place / "answers"
    shutil.copytree(ROOT / "problems", work, ignore=shutil.ignore_patterns("recordings"))
    small = (work / "two_link.toml").read_text()
    (work / "small.toml").write_text(small.replace("intervals = 20", "intervals = 8"))
    shutil.copytree(RECORDED, work / "set")
    quiet = ("--quiet",)
    with contextlib.redirect_stdout(io.StringIO()):
        solve = run(["solve", str(work / "small.toml"), "--out", str(work / "solved"), *quiet])
        diagnose = run(
            ["diagnose", str(work / "set"), "--out", str(work / "found"), *quiet,
             "--no-report", "--no-experiment"]
        )  # fmt: skip
    if solve or diagnose:
        raise RuntimeError(f"sound files ended with {solve} and {diagnose}")
    for folder in ("solved", "found"):
        (work / folder / "manifest.json").unlink()
    shutil.copytree(work / "solved", work / "again")
    of_json, of_csv = mutators.spoiled_document, mutators.spoiled_csv
    result, table = "solved/result.json", "solved/trajectory.csv"
    exported = ("export", "solved", "--to", "csv", "--out", "out")
    read = lambda path: read_motion(path.parent, "motor")  # noqa: E731
    yield Subject("result, export", work, result, of_json, read, exported)
    both = lambda path: compare_results(path.parent, work / "again")  # noqa: E731
    yield Subject("result, compare", work, result, of_json, both, ("compare", "solved", "again"))
    stored = lambda path: read_result(path.parent)  # noqa: E731
    simulated = ("simulate", "solved", "--out", "out")
    yield Subject("result, simulate", work, result, of_json, stored, simulated)
    exported = ("export", "solved", "--to", "ros2", "--out", "out")
    yield Subject("trajectory, export", work, table, of_csv, read, exported)
    modes = ("modes", "solved", "--out", "out")
    yield Subject("trajectory, modes", work, table, of_csv, stored, modes)
    begun = ("solve", "small.toml", "--out", "out", "--quiet", "--guess", "solved")
    yield Subject("trajectory, guess", work, table, of_csv, stored, begun, whole=False)
    found = ("export", "found", "--to", "urdf", "--recordings", "set", "--out", "out")
    toml = mutators.spoiled_toml
    yield Subject("extended, export", work, "found/extended.toml", toml, load_extended, found)
    diagnosis = "found/diagnosis.json"
    same = lambda path: compare_results(path.parent, path.parent)  # noqa: E731
    yield Subject(
        "diagnosis, compare", work, diagnosis, of_json, same, ("compare", "found", "found")
    )
