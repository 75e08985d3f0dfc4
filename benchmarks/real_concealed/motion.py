"""A public set as a person sees it: motion of its runs, and torques of its rigid bodies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio

from benchmarks.blind.sets import description

# Slower than this a joint counts as standing [rad/s].
MOVING = 0.03
# Windows of the polynomials that positions are differentiated by, and torques freed of noise [s].
# In 0.12 s an acceleration loses 3 % on fast arms and a quarter on the KUKA's wrist; in half of the
# first it is larger by 1 %, but for noise.
_WINDOW, _SMOOTH = 0.03, 0.12
# Share of a motion in which a load lies on its rarer side.
_EITHER_SIDE = 0.1


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

    @cached_property
    def trained(self) -> list[Motion]:
        """Motion of the runs that are fitted."""
        return [self.motion(file) for file in self.runs("train")]

    def size(self, added: Callable[[Motion], np.ndarray], *, centred: bool = False) -> np.ndarray:
        """Root mean square over moving samples of what is added (n,).

        Over those that are fitted or those that are not, whichever is less: what one of them does
        not show is not there to be found, or is not missed. About its mean where it is in a link
        angle: a constant is an offset of the encoder.
        """
        return np.minimum(
            *(_rms(runs, added, centred=centred) for runs in (self.trained, self.tested))
        )

    def carried(self, run: Motion) -> np.ndarray:
        """Torque (K, n) that the gears carry: bodies, and a balancer where the torque shows one.

        Friction and the rotors' own inertia are in front of them.
        """
        return self.rigid_torques(self.folder / self.told["robot"], run) + np.column_stack(
            [_balancer(run, j) @ fitted for j, fitted in enumerate(self._balancers)]
        )

    def turns_over(self, joint: int) -> bool:
        """Whether the load of a joint lies a tenth of the motion on either side: play shows."""
        shares = []
        for runs in (self.trained, self.tested):
            load = np.concatenate(
                [self.carried(r)[np.abs(r.velocity[:, joint]) >= MOVING, joint] for r in runs]
            )
            shares += [np.mean(load > 0.0), np.mean(load < 0.0)]
        return bool(min(shares) >= _EITHER_SIDE)

    @cached_property
    def _balancers(self) -> list[np.ndarray]:
        """Of every joint by least squares, beside friction."""
        rotor = self.told["nominal"].get("rotor_inertia", [0.0] * len(self.joints))
        robot, found = self.folder / self.told["robot"], []
        rigid = [self.rigid_torques(robot, run) for run in self.trained]
        for j in range(len(self.joints)):
            columns, left = [], []
            for run, own in zip(self.trained, rigid, strict=True):
                speed = run.velocity[:, j]
                moving = np.abs(speed) >= MOVING
                friction = np.column_stack([np.sign(speed), speed])
                columns.append(np.hstack([_balancer(run, j), friction])[moving])
                rest = run.torque[:, j] - rotor[j] * run.acceleration[:, j] - own[:, j]
                left.append(rest[moving])
            values = np.linalg.lstsq(np.vstack(columns), np.concatenate(left), rcond=None)[0]
            found.append(values[:3])
        return found

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


def _rms(runs: list[Motion], added: Callable[[Motion], np.ndarray], *, centred: bool) -> np.ndarray:
    parts = []
    for run in runs:
        values = added(run)
        moving = (np.abs(run.velocity) >= MOVING) & np.isfinite(values)
        parts.append(np.where(moving, values, np.nan))
    whole = np.vstack(parts)
    known = np.isfinite(whole)
    count = np.maximum(known.sum(axis=0), 1)
    mean = np.where(known, whole, 0.0).sum(axis=0) / count if centred else 0.0
    return np.asarray(np.sqrt(np.where(known, whole - mean, 0.0).__pow__(2).sum(axis=0) / count))


def _balancer(run: Motion, joint: int) -> np.ndarray:
    """What a spring on a crank may do to a joint (K, 3)."""
    angle = run.position[:, joint]
    return np.column_stack([np.ones(len(angle)), np.sin(angle), np.cos(angle)])


def motion_of(columns: dict[str, np.ndarray], signals: dict[str, Any]) -> Motion:
    """Motion of a run from its columns."""
    time = columns[signals["time"]]
    position = np.column_stack([columns[name] for name in signals["position"]])
    torque = np.column_stack([columns[name] for name in signals["torque"]])
    velocity, acceleration = _slopes(time, position)
    return Motion(time, position, velocity, acceleration, torque)


def smooth(time: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """Samples without what is faster than a motion."""
    return _slopes(time, samples, (0,), _SMOOTH)[0]


def _slopes(
    time: np.ndarray,
    position: np.ndarray,
    orders: tuple[int, ...] = (1, 2),
    window: float = _WINDOW,
) -> list[np.ndarray]:
    """First and second derivative by local cubics, as a person would do by hand."""
    from scipy.signal import savgol_filter

    step = float(np.median(np.diff(time)))
    even = np.arange(time[0], time[-1] + 0.5 * step, step)
    width = max(5, round(window / step) | 1)
    known = np.column_stack(
        [np.interp(even, time[np.isfinite(c)], c[np.isfinite(c)]) for c in position.T]
    )
    found = []
    for order in orders:
        slope = savgol_filter(known, width, 3, deriv=order, delta=step, axis=0)
        found.append(np.column_stack([np.interp(time, even, c) for c in slope.T]))
    return found
