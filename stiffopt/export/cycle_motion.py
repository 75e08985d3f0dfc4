"""Motion of a cycle's folder: its certified legs one after another, with rests and events."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import BPoly

from stiffopt.errors import InputFileError
from stiffopt.export.improved_motion import read_improved
from stiffopt.export.motion import (
    MotionEvent,
    SampledMotion,
    SplineMotion,
    StoredMotion,
    Which,
    read_motion,
)
from stiffopt.export.motion_checks import SampledRows, judge_samples, solved_legs
from stiffopt.files import load_json
from stiffopt.folders import check_result
from stiffopt.improvement.improvement_files import IMPROVEMENT_FILE
from stiffopt.result.assessment import Violation
from stiffopt.result.cycle import CYCLE_FILE, JoinedMotion, leg_folder


@dataclass(frozen=True, kw_only=True)
class StoredCycle(StoredMotion):
    """Motion of a cycle; `problem` and `link` are those of its first leg."""

    legs: tuple[StoredMotion, ...]
    starts: tuple[float, ...]  # of the legs [s]

    def judge(self, motion: SampledMotion) -> Violation:
        """Return the tightest limit of the drives at the samples of all legs."""
        found = []
        for start, leg in zip(self.starts, self.legs, strict=True):
            inside = (motion.time >= start) & (motion.time <= start + float(leg.curve.x[-1]))
            if np.count_nonzero(inside) > 1:
                rows = (motion.position, motion.velocity, motion.acceleration)
                sampled = SampledRows(
                    motion.time[inside] - start, [each[inside] for each in rows], leg.link
                )
                found.append(judge_samples(leg.problem, sampled, f"{leg.title}, sampled"))
        return max(found, key=lambda each: each.value)


def read_stored(folder: Path, which: Which = "motor", problem: Path | None = None) -> StoredMotion:
    """Read the motion of a solve, a cycle or an improvement; parameters as of `read_motion`."""
    if (folder / IMPROVEMENT_FILE).is_file():
        return read_improved(folder, which, problem)
    if not (folder / CYCLE_FILE).is_file():
        return read_motion(folder, which, problem)
    path = folder / CYCLE_FILE
    check_result(folder, CYCLE_FILE)
    document = load_json(path)
    times = _read_times(path, document)
    problems = solved_legs(path, document, problem)
    legs = tuple(
        read_motion(folder / leg_folder(k + 1), which, stated=stated)
        for k, stated in enumerate(problems)
    )
    if len(legs) != len(times):
        raise InputFileError(path, "legs", "the cycle has another number of legs. Solve again.")
    starts = np.array([start for start, _, _ in times])
    end = max(leave for _, _, leave in times)
    curve = _joined_curve([leg.curve for leg in legs], starts, end)
    hashes = [leg.seal[key] for leg in legs for key in sorted(leg.seal)]
    events = [
        MotionEvent(time=arrival, kind=str(leg["event"]), mass=float(leg["mass_after"]))
        for leg, (_, arrival, _) in zip(document["legs"], times, strict=True)
        if leg["event"]
    ]
    first = legs[0]
    whole = hashlib.sha256(repr((hashes, times, events)).encode()).hexdigest()
    return StoredCycle(
        title=str(document.get("title") or folder.resolve().name),
        which=which,
        joint_names=first.joint_names,
        prismatic=first.prismatic,
        curve=curve,
        link=first.link,
        problem=first.problem,
        seal={**first.seal, "motion": whole},
        legs=legs,
        starts=tuple(starts.tolist()),
        events=tuple(events),
    )


def _read_times(path: Path, document: Any) -> list[tuple[float, float, float]]:
    """Start, arrival and departure [s] of each leg of a cycle.json."""
    try:
        found = [
            (float(leg["start"]), float(leg["arrival"]), float(leg["arrival"] + leg["dwell"]))
            for leg in document["legs"]
        ]
        _ = [(leg["event"], float(leg["mass_after"])) for leg in document["legs"]]
    except (KeyError, TypeError, ValueError) as error:
        raise InputFileError(path, "legs", f"has no usable {error}. Solve again.") from error
    if not found:
        raise InputFileError(path, "legs", "the solve found no motion to export.")
    return found


def _joined_curve(curves: list[Any], starts: np.ndarray, end: float) -> BPoly:
    """Position over the time of the cycle, with the rests."""
    joined = JoinedMotion([SplineMotion(each) for each in curves], starts, end)
    times = joined.times
    times = times[np.append(True, np.diff(times) > 1e-9)]
    return BPoly.from_derivatives(
        times, np.stack([joined(times, order) for order in range(3)], axis=1)
    )
