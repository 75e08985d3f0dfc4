"""The file that describes a recording set, found by the set's folder or itself."""

from __future__ import annotations

from pathlib import Path

from stiffopt.errors import InputFileError

FILE = "recordings.toml"
# Endings of recordings as they come from a logger.
_RUNS = (".csv", ".txt", ".tsv", ".npz", ".parquet", ".mcap", ".db3", ".dat", ".log")


def described_by(path: Path) -> Path:
    """The recordings.toml of a set, given by its folder or itself.

    Raises
    ------
    InputFileError
        For recordings that have none yet, with what to do.
    """
    file = path / FILE if path.is_dir() else path
    if path.is_file() and path.suffix.lower() in _RUNS:
        raise InputFileError(
            path, "", "is a recording, not a recording set, which says what its columns are:"
            f" `stiffopt init recording {path} --urdf ROBOT.urdf` writes one."
        )  # fmt: skip
    bare = path.is_dir() and not file.exists()
    if bare and any(each.suffix.lower() in _RUNS for each in path.iterdir()):
        raise InputFileError(
            path, "", f"holds recordings, but no {FILE} that says what their columns are:"
            f" `stiffopt init recording {path} --urdf ROBOT.urdf` writes one."
        )  # fmt: skip
    return file
