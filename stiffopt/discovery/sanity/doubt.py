"""Doubts about a recording set, with the evidence and the line of recordings.toml to change."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.errors import InputFileError
from stiffopt.recording.recording_set import RecordingSet


@dataclass(frozen=True, kw_only=True)
class Doubt:
    """A contradiction between recordings and their description."""

    kind: str  # "position unit", "torque gain", "joint order", "gravity" and others
    joints: tuple[int, ...] = ()  # from 1; empty for the set as a whole
    evidence: str  # the evidence, in a sentence
    line: str = ""  # corrected line of recordings.toml; "" if no line corrects it

    def __str__(self) -> str:
        ending = f" If so, write {self.line}." if self.line else ""
        return f"{self.evidence}{ending}"

    def as_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return asdict(self)


class DoubtfulRecordings(InputFileError):
    """Recordings that contradict their description and are not diagnosed.

    `path`: of recordings.toml.
    """

    def __init__(self, path: Path, doubts: Sequence[Doubt]) -> None:
        self.doubts = tuple(doubts)
        lines = [doubt.line for doubt in doubts]
        # A line that corrects several doubts is written with the last of them.
        reasons = "".join(
            f"\n  {doubt if doubt.line not in lines[k + 1 :] else doubt.evidence}"
            for k, doubt in enumerate(doubts)
        )
        super().__init__(
            path,
            "",
            "the recordings contradict their description and were not diagnosed. No file was"
            f" changed; check this first:{reasons}\nIf the description is right, diagnose"
            " with --despite-doubts.",
        )


# Shares of a residual that are told in figures [%].
_SMALLEST_PERCENT, _LARGEST_PERCENT = 0.01, 1000.0
# Signals in units of the position, with the suffix of their unit.
_UNITS_OVER_POSITION = {"velocity": "/s", "link_position": ""}


def scale_line(
    recordings: RecordingSet,
    signal: str,
    factors: np.ndarray,
    unit: str = "",
    unknown: np.ndarray | None = None,
) -> str:
    """Return an entry of [signals.scale]: a unit for all joints, or a corrected factor each.

    Joints of `unknown` (n,) keep the unit of a torque whose factor nobody has told, or get "A".
    """
    if unit:
        text = f'{signal} = "{unit}"'
        if signal == "position":
            others = [k for k in _UNITS_OVER_POSITION if getattr(recordings.signals, k) is not None]
            text += "".join(
                f' (and {k} = "{unit}{_UNITS_OVER_POSITION[k]}" if it is too)' for k in others
            )
        return f"{text} in [signals.scale]"
    stated = recordings.signals.scale_of(signal, recordings.n)
    if unknown is None or not unknown.any():
        return f"{signal} = {format_numbers(stated * factors)} in [signals.scale]"
    units = recordings.signals.torque_units or ("",) * recordings.n
    each = [
        f'"{unit or "A"}"' if left else format_numbers([value])[1:-1]
        for value, left, unit in zip(stated * factors, unknown, units, strict=True)
    ]
    return (
        f"{signal} = [{', '.join(each)}] in [signals.scale] (the weight does not tell that of"
        f" {format_joints(np.flatnonzero(unknown))})"
    )


def column_line(recordings: RecordingSet, signal: str, order: Sequence[int]) -> str:
    """Return an entry of [signals] with its columns in another order."""
    names = getattr(recordings.signals, signal)
    return f"{signal} = [" + ", ".join(f'"{names[k]}"' for k in order) + "]"


def format_numbers(values: Iterable[float]) -> str:
    """Format numbers as a TOML array: [1.0, -1.0]."""
    return "[" + ", ".join(repr(float(f"{value:.6g}") + 0.0) for value in values) + "]"


def format_joints(joints: Iterable[int]) -> str:
    """Format joints (from 0) as text: "joints 2 and 3"."""
    names = [str(int(j) + 1) for j in joints]
    if len(names) == 1:
        return f"joint {names[0]}"
    return f"joints {', '.join(names[:-1])} and {names[-1]}"


def limit_to_runs(names: Sequence[str], evidence: str) -> str:
    """Limit evidence to some runs, since the others fit the description."""
    them, those = ("it", "that file") if len(names) == 1 else ("them", "those files")
    return (
        f"Only in {' and '.join(names)}, not in all runs: {evidence} Correct {those} or leave"
        f" {them} out: lines of recordings.toml hold for every run."
    )


def format_shares(before: np.ndarray, after: np.ndarray, joints: Sequence[int]) -> str:
    """Format the residual shares of each joint's torque before and after a correction."""
    parts = ", ".join(
        f"{_format_share(after[j])} at joint {j + 1} (as described {_format_share(before[j])})"
        for j in joints
    )
    return f"of the torque's variance the residual of the nominal model is then {parts}"


def _format_share(value: float) -> str:
    """Format a share with two digits; beyond these bounds its size tells nothing more."""
    percent = float(f"{100.0 * value:.2g}")
    if percent > _LARGEST_PERCENT:
        return f"over {_LARGEST_PERCENT:,g} %"
    return f"{percent:,g} %" if percent >= _SMALLEST_PERCENT else f"under {_SMALLEST_PERCENT:g} %"
