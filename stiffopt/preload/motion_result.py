"""Outcome of optimising preloads and motion together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from stiffopt.preload.solution import PreloadSolution
from stiffopt.result.solution import Solution
from stiffopt.result.status import SolveStatus

# A gain below this is called not worth the effort.
_MIN_USEFUL_GAIN = 0.01
# Less than what is written of it.
_MIN_REPORTED_GAIN = 5e-5


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionRound:
    """One round of the alternation.

    Parameters
    ----------
    deflection_before_preload, deflection_after : float
        Of the new motion, with the preloads it was optimised for and with those then found [m].
    preloads : mapping of element key to float
        Largest preload that tightening leaves, after the round [N].
    """

    deflection_before_preload: float
    deflection_after: float
    preloads: Mapping[str, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionStudy:
    """What optimising preloads and motion together is worth.

    Parameters
    ----------
    status : SolveStatus
        acceptable where the rounds ended before the deflection settled.
    objective_name : str
        Deflection whose peak counts, by the exact law with the least preloads.
    start : float
        Of the motion optimised with the start preloads, before preloads change [m].
    separate : float
        The same motion after its preloads were optimised [m]; nan where the study was stopped
        before.
    joint : float
        Both together [m]; never above `separate`, where the rounds begin.
    gain : float
        1 - joint/separate.
    rounds : tuple of MotionRound
    start_preloads, separate_preloads, preloads : mapping of element key to float
        Largest preload that tightening leaves [N].
    trajectory : Solution
        The motion of `joint`, assessed with its preloads.
    separate_trajectory : Solution
        The motion of `start` and `separate`, assessed with the preloads of `separate`.
    preload_solution : PreloadSolution or None
        Rows and limits of `joint`.
    note : str
        What it means.
    seconds : float
    """

    status: SolveStatus
    objective_name: str
    start: float
    separate: float
    joint: float
    gain: float
    rounds: tuple[MotionRound, ...]
    start_preloads: Mapping[str, float]
    separate_preloads: Mapping[str, float]
    preloads: Mapping[str, float]
    trajectory: Solution
    separate_trajectory: Solution
    preload_solution: PreloadSolution | None
    note: str
    seconds: float


def describe_gain(status: SolveStatus, gain: float) -> str:
    """Tell a designer what the gain of a joint study means."""
    if not np.isfinite(gain):
        return "Stopped by the user before the preloads were optimised."
    if gain < _MIN_REPORTED_GAIN:
        text = "Optimised together, preloads and motion deflect no less than one after another"
    else:
        text = (
            f"Optimised together, preloads and motion deflect {100 * gain:.2f} % less than one "
            "after another"
        )
    if gain < _MIN_USEFUL_GAIN:
        text += ": a gain below 1 %, so the joint study is not worth it here"
    ends = {
        SolveStatus.INTERRUPTED: " Stopped by the user; this is the best so far.",
        SolveStatus.ACCEPTABLE: " The rounds ended before the deflection settled.",
    }
    return f"{text}.{ends.get(status, '')}"
