"""Doubts about sensors: positions beyond limits, contradicting velocities and link angles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from stiffopt.discovery.sanity.doubt import Doubt, limit_to_runs, scale_line
from stiffopt.discovery.sanity.interpretations import DEGREE, MILLIMETRE
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun
from stiffopt.units import to_si

# Margin of position limits: share of the range, and at least [rad] or [m].
LIMIT_MARGIN_SHARE, _MIN_LIMIT_MARGIN = 0.05, 0.02
# Relative tolerances of a factor of a sign or a gear, and of a unit.
FACTOR_TOLERANCE, _UNIT_TOLERANCE = 0.2, 0.1


def doubt_position_limits(recordings: RecordingSet, runs: Sequence[RecordedRun]) -> Iterator[Doubt]:
    """Yield doubts about positions beyond limits: a unit if that explains all of them."""
    lower = recordings.robot.position_lower[recordings.order]
    upper = recordings.robot.position_upper[recordings.order]
    span = upper - lower
    reach = np.full((2, recordings.n), np.nan)
    for run in runs:
        known = np.isfinite(run.position)
        low = np.where(known, run.position, np.inf).min(axis=0)
        high = np.where(known, run.position, -np.inf).max(axis=0)
        reach[0], reach[1] = np.fmin(reach[0], low), np.fmax(reach[1], high)
    margin = np.maximum(LIMIT_MARGIN_SHARE * span, _MIN_LIMIT_MARGIN)
    with np.errstate(invalid="ignore"):
        out = np.isfinite(span) & ((reach[0] < lower - margin) | (reach[1] > upper + margin))
    if not out.any():
        return
    turning = ~recordings.prismatic
    in_degrees = DEGREE * reach
    fits = (in_degrees[0] >= lower - margin) & (in_degrees[1] <= upper + margin)
    far = np.nanmax(np.abs(reach[:, turning & out]), initial=0.0) > 3.0 * np.pi
    if far and np.all(fits | ~turning | ~np.isfinite(span)):
        yield Doubt(
            kind="position unit",
            joints=tuple(int(j) + 1 for j in np.flatnonzero(out)),
            evidence="The positions look like degrees: "
            + _describe_reach(recordings, reach, lower, upper, out),
            line=scale_line(recordings, "position", np.ones(recordings.n), "deg"),
        )
        return
    yield Doubt(
        kind="position limits",
        joints=tuple(int(j) + 1 for j in np.flatnonzero(out)),
        evidence="Positions lie beyond the limits of the robot's own file: "
        + _describe_reach(recordings, reach, lower, upper, out)
        + " Check their zero, sign and unit, or correct the limits.",
    )


def _describe_reach(
    recordings: RecordingSet,
    reach: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    out: np.ndarray,
) -> str:
    parts = [
        f"joint {j + 1} reads {reach[0, j]:.3g} to {reach[1, j]:.3g}"
        f" {'m' if recordings.prismatic[j] else 'rad'}, its limits are {lower[j]:.3g} to"
        f" {upper[j]:.3g}"
        for j in np.flatnonzero(out)
    ]
    return "; ".join(parts) + "."


def doubt_second_sensors(recordings: RecordingSet, runs: Sequence[RecordedRun]) -> Iterator[Doubt]:
    """Yield doubts about velocities and link angles that contradict positions, one per signal."""
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
        evidence = f"The {noun} contradicts the position: {each}."
        line = _ratio_line(recordings, signal, ratios)
        if not line and signal == "velocity" and (factor := _common_factor(recordings, ratios)):
            evidence += " All joints agree: time or sampling rate may be wrong."
            line = f"time = {1.0 / factor:.3g} in [signals.scale]"
        yield Doubt(
            kind=noun,
            joints=tuple(joints),
            evidence=limit_to_runs(names, evidence) if alone else evidence,
            line="" if alone else line,
        )


def _ratio_line(recordings: RecordingSet, signal: str, ratios: Mapping[int, float | None]) -> str:
    """Return a line that corrects all joints of a signal by one cause, or ""."""
    known = np.array([np.nan if ratio is None else ratio for ratio in ratios.values()])
    slides = recordings.prismatic[np.array(list(ratios)) - 1]
    units = [("deg", DEGREE)] if not slides.any() else [("mm", MILLIMETRE)] if slides.all() else []
    for unit, size in units:
        if np.all(np.abs(known / size - 1.0) < _UNIT_TOLERANCE):
            return f'position = "{unit}" in [signals.scale]'
    if signal == "velocity":
        units = [(f"{unit}/s", size) for unit, size in units]
        units += [("rpm", to_si("1 rpm", "angular velocity"))] if not slides.any() else []
    for unit, size in units:
        if np.all(np.abs(known * size - 1.0) < _UNIT_TOLERANCE):
            return scale_line(recordings, signal, np.ones(recordings.n), unit)
    if np.all(np.abs(known + 1.0) < FACTOR_TOLERANCE):
        signs = np.ones(recordings.n)
        signs[np.array(list(ratios)) - 1] = -1.0
        return scale_line(recordings, signal, signs)
    return ""


def _common_factor(recordings: RecordingSet, ratios: Mapping[int, float | None]) -> float | None:
    """Return the common factor of the velocities of all joints; None without one."""
    known = np.array([np.nan if ratio is None else ratio for ratio in ratios.values()])
    usual = float(np.median(known))
    alike = len(known) == recordings.n > 1 and bool(
        np.all(np.abs(known / usual - 1.0) < _UNIT_TOLERANCE)
    )
    return usual if alike and usual > 0.0 else None
