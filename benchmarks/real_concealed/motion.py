"""A public set as a person sees it: motion of its runs, and torques of its rigid bodies."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio

from benchmarks.blind.sets import description

# Slower than this a joint counts as standing [rad/s].
MOVING = 0.03
# Window of the polynomial that positions are differentiated by [s].
_WINDOW = 0.12


@dataclass(frozen=True, eq=False)
class Motion:
    """Joint motion of one run (K, n), and its measured torque."""

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    torque: np.ndarray


class PublicSet:
    """A recording set with an answer about it.

    Parameters
    ----------
    folder : Path
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.told = folder, description(folder)
        self.joints: list[str] = self.told["joints"]

    def runs(self, *roles: str) -> list[str]:
        """Names of the files with these roles."""
        return [run["file"] for run in self.told["runs"] if run["role"] in roles]

    def columns(self, file: str) -> dict[str, np.ndarray]:
        """Channels of a run as they were recorded."""
        with np.load(self.folder / file) as read:
            return {name: read[name] for name in read.files}

    def motion(self, file: str) -> Motion:
        """Motion of a run from its positions."""
        return motion_of(self.columns(file), self.told["signals"])

    @cached_property
    def tested(self) -> list[Motion]:
        """Motion of the runs that are never fitted."""
        return [self.motion(file) for file in self.runs("test", "extrapolate")]

    def size(self, added: list[np.ndarray]) -> np.ndarray:
        """Root mean square over moving samples of tested runs of what is added (n,)."""
        square, count = np.zeros(len(self.joints)), np.zeros(len(self.joints))
        for run, values in zip(self.tested, added, strict=True):
            moving = (np.abs(run.velocity) >= MOVING) & np.isfinite(values)
            square += np.where(moving, values, 0.0).__pow__(2).sum(axis=0)
            count += moving.sum(axis=0)
        return np.asarray(np.sqrt(square / np.maximum(count, 1)))

    def rigid_torques(self, robot: Path, run: Motion) -> np.ndarray:
        """Torques (K, n) of a URDF's bodies along a run."""
        model = pinocchio.buildModelFromUrdf(str(robot))
        model.gravity.linear = np.array(self.told.get("gravity", [0.0, 0.0, -9.81]))
        data = model.createData()
        place = [model.joints[model.getJointId(name)].idx_v for name in self.joints]
        out = np.zeros_like(run.position)
        q, v, a = (np.zeros(model.nv) for _ in range(3))
        for k in range(len(run.time)):
            q[place], v[place], a[place] = run.position[k], run.velocity[k], run.acceleration[k]
            out[k] = pinocchio.rnea(model, data, q, v, a)[place]
        return out


def motion_of(columns: dict[str, np.ndarray], signals: dict[str, Any]) -> Motion:
    """Motion of a run from its columns."""
    time = columns[signals["time"]]
    position = np.column_stack([columns[name] for name in signals["position"]])
    torque = np.column_stack([columns[name] for name in signals["torque"]])
    velocity, acceleration = _slopes(time, position)
    return Motion(time, position, velocity, acceleration, torque)


def _slopes(time: np.ndarray, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and second derivative by local cubics, as a person would do by hand."""
    from scipy.signal import savgol_filter

    step = float(np.median(np.diff(time)))
    even = np.arange(time[0], time[-1] + 0.5 * step, step)
    width = max(5, round(_WINDOW / step) | 1)
    known = np.column_stack(
        [np.interp(even, time[np.isfinite(c)], c[np.isfinite(c)]) for c in position.T]
    )
    found = []
    for order in (1, 2):
        slope = savgol_filter(known, width, 3, deriv=order, delta=step, axis=0)
        found.append(np.column_stack([np.interp(time, even, c) for c in slope.T]))
    return found[0], found[1]
