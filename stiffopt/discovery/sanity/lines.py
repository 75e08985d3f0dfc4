"""Lines of recordings.toml as they would have to be, and numbers in the words of evidence."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from stiffopt.errors import format_factor
from stiffopt.recording.recording_set import RecordingSet

# Signals that are read together with the position, and what their unit adds to its unit.
_WITH_POSITION = {"velocity": "/s", "link_position": ""}


def scale_line(recordings: RecordingSet, signal: str, factors: np.ndarray, unit: str = "") -> str:
    """Entry of [signals.scale]: a unit for all joints, or a factor each on top of today's."""
    if unit:
        text = f'{signal} = "{unit}"'
        if signal == "position":
            others = [k for k in _WITH_POSITION if getattr(recordings.signals, k) is not None]
            text += "".join(
                f' (and {k} = "{unit}{_WITH_POSITION[k]}" if it is too)' for k in others
            )
        return f"{text} in [signals.scale]"
    stated = recordings.signals.scale_of(signal, recordings.n)
    return f"{signal} = {listed_numbers(stated * factors)} in [signals.scale]"


def column_line(recordings: RecordingSet, signal: str, order: Sequence[int]) -> str:
    """Entry of [signals] with its columns in another order."""
    names = getattr(recordings.signals, signal)
    return f"{signal} = [" + ", ".join(f'"{names[k]}"' for k in order) + "]"


def listed_numbers(values: Iterable[float]) -> str:
    """Numbers as TOML has them: [1.0, -1.0]."""
    return "[" + ", ".join(repr(float(f"{value:.6g}") + 0.0) for value in values) + "]"


def joints_in_words(joints: Iterable[int]) -> str:
    """Joints from 0 in words: "joints 2 and 3"."""
    names = [str(int(j) + 1) for j in joints]
    if len(names) == 1:
        return f"joint {names[0]}"
    return f"joints {', '.join(names[:-1])} and {names[-1]}"


def of_some(names: Sequence[str], evidence: str) -> str:
    """Evidence of these runs, where others are as the file says."""
    them, those = ("it", "that file") if len(names) == 1 else ("them", "those files")
    return (
        f"Of {' and '.join(names)} alone, not of all runs: {evidence} Mend {those} or leave {them}"
        " out: lines of recordings.toml hold for every run."
    )


def share_words(before: np.ndarray, after: np.ndarray, joints: Sequence[int]) -> str:
    """What the model leaves of each joint's torque as described, and otherwise."""
    parts = [f"{_share(after[j])} in place of {_share(before[j])} at joint {j + 1}" for j in joints]
    return f"of the torque's variance the nominal model then leaves {', '.join(parts)}"


def _share(value: float) -> str:
    if value >= 2.0:
        return f"{format_factor(value) if value >= 10.0 else f'{value:.2g} times'} all"
    return f"{100.0 * value:.0f} %" if value >= 0.1 else f"{100.0 * value:.2g} %"
