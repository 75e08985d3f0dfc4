"""Steps of links that swing along a motion, by the matrix exponential."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy.linalg import expm

Swung = tuple[np.ndarray, np.ndarray, np.ndarray | None]


@dataclass(frozen=True)
class Matrices:
    """Of the swings along a motion.

    Attributes
    ----------
    mobility, rate, stiffness : array (K, n, n)
        Of which the stiffness may change in place before steps are taken anew.
    dt : float
        Between samples [s].
    unit : float
        Typical rate [1/s]: velocities over it are of the size of displacements.
    """

    mobility: np.ndarray
    rate: np.ndarray
    stiffness: np.ndarray
    dt: float
    unit: float

    @property
    def joints(self) -> int:
        """Their number n."""
        return int(self.mobility.shape[1])


@dataclass(frozen=True)
class Load:
    """Torques on m swings, each on l links of its own.

    Attributes
    ----------
    links : array (m, l) of int
    torque : array (m, K, l)
        At every sample, linear in between [N m].
    within : array (m, K - 1, 2, l), optional
        Beside those, at the begin and at the end of every step [N m].
    """

    links: np.ndarray
    torque: np.ndarray
    within: np.ndarray | None = None


class Steps(Protocol):
    """Steps from each sample to the next."""

    def take(self, first: int, last: int) -> None:
        """Take steps, those from sample `first` on and before `last`, with the springs of now."""

    def copy(self, stiffness: np.ndarray) -> Steps:
        """Steps that may be taken anew with springs (K, n, n) in another place of memory."""

    def march(self, load: Load, begin: np.ndarray | None, *, accelerated: bool) -> Swung:
        """Displacements, velocities and, if `accelerated`, accelerations (m, K, n) of m swings.

        Parameters
        ----------
        load : Load
        begin : array (m, 2 n) or None
            Displacements [rad], then velocities over `unit`; None is at rest.
        """


class ArraySteps:
    """Steps with the mean matrices of both ends, without the compiled core."""

    def __init__(self, matrices: Matrices) -> None:
        self._of, self._n = matrices, matrices.joints
        count, size = len(matrices.mobility) - 1, 2 * self._n
        self._step = np.empty((count, size, size))
        self._soft, self._lag = np.empty((2, count, self._n, self._n))
        self.take(0, count)

    def take(self, first: int, last: int) -> None:
        """See `Steps`."""
        n, unit = self._n, self._of.unit
        steps, ends = slice(first, last), slice(first + 1, last + 1)
        mobility, damping, springs = (
            0.5 * (m[ends] + m[steps])
            for m in (self._of.mobility, self._of.rate, self._of.stiffness)
        )
        slope = np.zeros((len(springs), 2 * n, 2 * n))
        slope[:, :n, n:] = unit * np.eye(n)
        slope[:, n:, :n] = -mobility @ springs / unit
        slope[:, n:, n:] = -mobility @ damping
        self._step[steps] = expm(self._of.dt * slope)
        self._soft[steps] = soft = np.linalg.inv(springs)
        self._lag[steps] = soft @ damping @ soft

    def copy(self, stiffness: np.ndarray) -> ArraySteps:
        """See `Steps`."""
        new = copy(self)
        new._of = replace(self._of, stiffness=stiffness)
        for name in ("_step", "_soft", "_lag"):
            setattr(new, name, getattr(self, name).copy())
        return new

    def march(self, load: Load, begin: np.ndarray | None, *, accelerated: bool) -> Swung:
        """See `Steps`."""
        of, n = self._of, self._n
        many, count = load.torque.shape[:2]
        whole, ends = np.zeros((many, count, n)), np.zeros((many, count - 1, 2, n))
        for own, both, on, torque in zip(whole, ends, load.links, load.torque, strict=True):
            own[:, on] = torque
            both[:, 0], both[:, 1] = own[:-1], own[1:]
        if load.within is not None:
            for both, on, within in zip(ends, load.links, load.within, strict=True):
                both[..., on] += within
        # Columns: each swing has the same digits alone and beside others.
        states = np.zeros((many, count, 2 * n, 1))
        if begin is not None:
            states[:, 0, :, 0] = begin
        for k in range(count - 1):
            first, last = ends[:, k, 0, :, None], ends[:, k, 1, :, None]
            ramp = (last - first) / of.dt
            late, speed = self._lag[k] @ ramp, self._soft[k] @ ramp / of.unit
            held, then = (
                np.concatenate([self._soft[k] @ x - late, speed], axis=1) for x in (first, last)
            )
            states[:, k + 1] = self._step[k] @ (states[:, k] - held) + then
        states = states[..., 0]
        z, velocity = states[..., :n], of.unit * states[..., n:]
        if not accelerated:
            return z, velocity, None
        left = whole - (of.rate @ velocity[..., None] + of.stiffness @ z[..., None])[..., 0]
        return z, velocity, (of.mobility @ left[..., None])[..., 0]
