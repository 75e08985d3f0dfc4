"""Velocities and link angles that are not of the motion that the positions tell."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from stiffopt.discovery.sanity.doubt import Doubt
from stiffopt.discovery.sanity.lines import of_some, scale_line
from stiffopt.discovery.sanity.orders import DEGREE, MILLIMETRE
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun

# Within which a factor counts as that of a sign or a unit.
_LIKE, _NEAR = 0.2, 0.1


def second_sensors(recordings: RecordingSet, runs: Sequence[RecordedRun]) -> Iterator[Doubt]:
    """Doubts of velocities and link angles, one a signal."""
    seen: dict[str, dict[int, tuple[str, float | None]]] = {}
    where: dict[str, list[str]] = {}
    for run in runs:
        for fault in run.faults:
            too_short = fault.ratio is not None and np.isnan(fault.ratio)
            if fault.kind == "contradicts position" and fault.joint is not None and not too_short:
                detail = fault.detail.removesuffix(". Left out.")
                seen.setdefault(fault.signal, {}).setdefault(fault.joint, (detail, fault.ratio))
                where.setdefault(fault.signal, []).append(run.name)
    for signal, joints in seen.items():
        names = list(dict.fromkeys(where[signal]))
        alone = len(names) < len(runs)
        noun = "velocity" if signal == "velocity" else "link position"
        each = "; ".join(f"that of joint {joint} {detail}" for joint, (detail, _) in joints.items())
        ratios = {joint: ratio for joint, (_, ratio) in joints.items()}
        evidence = f"The {noun} is not that of the position: {each}."
        line = _ratio_line(recordings, signal, ratios)
        if not line and signal == "velocity" and (factor := _common_factor(recordings, ratios)):
            evidence += " All joints alike, as where time or sample rate are not as stated."
            line = f"time = {1.0 / factor:.3g} in [signals.scale]"
        yield Doubt(
            kind=noun,
            joints=tuple(joints),
            evidence=of_some(names, evidence) if alone else evidence,
            line="" if alone else line,
        )


def _ratio_line(recordings: RecordingSet, signal: str, ratios: Mapping[int, float | None]) -> str:
    """Line that mends all joints of a signal by one cause, "" where there is none."""
    known = np.array([np.nan if ratio is None else ratio for ratio in ratios.values()])
    slides = recordings.prismatic[np.array(list(ratios)) - 1]
    for unit, size, own in (("deg", DEGREE, ~slides), ("mm", MILLIMETRE, slides)):
        if not own.all():
            continue
        if np.all(np.abs(known * size - 1.0) < _NEAR):
            unit_of = f"{unit}/s" if signal == "velocity" else unit
            return scale_line(recordings, signal, np.ones(recordings.n), unit_of)
        if np.all(np.abs(known / size - 1.0) < _NEAR):
            return f'position = "{unit}" in [signals.scale]'
    if np.all(np.abs(known + 1.0) < _LIKE):
        signs = np.ones(recordings.n)
        signs[np.array(list(ratios)) - 1] = -1.0
        return scale_line(recordings, signal, signs)
    return ""


def _common_factor(recordings: RecordingSet, ratios: Mapping[int, float | None]) -> float | None:
    """By how much the velocities of all joints are too large alike; None where they are not."""
    known = np.array([np.nan if ratio is None else ratio for ratio in ratios.values()])
    usual = float(np.median(known))
    alike = len(known) == recordings.n > 1 and bool(np.all(np.abs(known / usual - 1.0) < _NEAR))
    return usual if alike and usual > 0.0 else None
