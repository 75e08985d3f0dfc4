"""Poses at rest: runs with one row a pose, as in tables for gravity compensation.

Time numbers the poses. Nothing moves from row to row, so that no velocity or acceleration exists:
torques hold the weight and friction of unknown direction.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from stiffopt.errors import InputFileError
from stiffopt.recording.clock import MAX_MOTION_STEP
from stiffopt.recording.signals import Signals

# Fewer poses do not separate weight from friction at all.
MIN_POSES = 6


def holds_rest_poses(columns: Mapping[str, np.ndarray], signals: Signals) -> bool:
    """Return True for a table of poses: as stated, else by its rows.

    Rows are poses where their spacing is too long for a motion in seconds and positions do not
    follow one another.
    """
    if signals.at_rest is not None:
        return signals.at_rest
    if signals.time not in columns:
        return False
    steps = np.diff(columns[signals.time])
    steps = steps[np.isfinite(steps)]
    if not steps.size or not float(np.median(steps)) > MAX_MOTION_STEP:
        return False
    positions = np.column_stack([columns[name] for name in signals.position])
    return are_unordered(positions)


def are_unordered(positions: np.ndarray) -> bool:
    """Return True if rows of positions (K, n), in any unit, do not follow one another."""
    positions = positions[np.isfinite(positions).all(axis=1)]
    if len(positions) < MIN_POSES:
        return False
    spread = 2.0 * positions.var(axis=0)
    moved = np.mean(np.diff(positions, axis=0) ** 2, axis=0)
    turned = spread > 0.0
    # Mean square step over twice the variance (von Neumann's ratio over 2) of poses in no order: 1.
    # A motion sampled often enough to be followed has less than a tenth.
    return bool(turned.any() and np.median(moved[turned] / spread[turned]) > 0.3)


def read_pose_rows(
    columns: Mapping[str, np.ndarray], signals: Signals, path: Path
) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers of all rows (R,) and the rows (K,) with a complete position.

    Raises `InputFileError`: too few poses.
    """
    positions = np.column_stack([columns[name] for name in signals.position])
    rows = np.flatnonzero(np.isfinite(positions).all(axis=1))
    if len(rows) < MIN_POSES:
        raise InputFileError(
            path,
            "",
            f"holds {len(rows)} poses at rest; weight is separated from friction from {MIN_POSES}"
            " poses on, well from 50. Record more poses, or put several files into one.",
        )
    return np.arange(len(positions), dtype=float), rows
