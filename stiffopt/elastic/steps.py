"""Steps of links that swing along a motion, by the matrix exponential of many at once."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from math import factorial
from typing import Protocol

import numpy as np
from scipy.linalg.lapack import dtbtrs

# Matrices whose exponentials are taken at once: few enough to stay in the processor's cache.
_AT_ONCE = 96
# Terms of the exponential's series, and the norm up to which they give it to machine precision.
_TERMS, _SMALL = 12, 0.5

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
    """Steps with the mean matrices of both ends."""

    def __init__(self, matrices: Matrices) -> None:
        self._of, self._n = matrices, matrices.joints
        count, size = len(matrices.mobility) - 1, 2 * self._n
        self._step = np.empty((count, size, size))
        self._soft, self._lag = np.empty((2, count, self._n, self._n))
        # x_k+1 - step_k x_k = added_k+1 as a lower banded matrix of unit diagonal. By column: of a
        # state, the diagonal and what the next one has of it below.
        self._by_column = np.zeros((count + 1, size, 2 * size))
        self._by_column[..., 0] = 1.0
        self.take(0, count)

    def take(self, first: int, last: int) -> None:
        """See `Steps`."""
        n, size, unit = self._n, 2 * self._n, self._of.unit
        self.__dict__.pop("_gains", None)
        along = self._by_column.strides[0]
        below = np.ndarray(
            self._step.shape,
            buffer=self._by_column,
            offset=8 * size,
            strides=(along, 8 * (2 * size - 1), 8),
        )
        for begin in range(first, last, _AT_ONCE):
            steps = slice(begin, min(begin + _AT_ONCE, last))
            ends = slice(begin + 1, steps.stop + 1)
            mobility, damping, springs = (
                0.5 * (m[ends] + m[steps])
                for m in (self._of.mobility, self._of.rate, self._of.stiffness)
            )
            slope = np.zeros((len(springs), size, size))
            slope[:, :n, n:] = unit * np.eye(n)
            slope[:, n:, :n] = -mobility @ springs / unit
            slope[:, n:, n:] = -mobility @ damping
            self._step[steps] = exponentials(self._of.dt * slope)
            below[steps] = -self._step[steps].swapaxes(1, 2)
            self._soft[steps] = soft = np.linalg.inv(springs)
            self._lag[steps] = soft @ damping @ soft

    def copy(self, stiffness: np.ndarray) -> ArraySteps:
        """See `Steps`."""
        new = copy(self)
        new.__dict__.pop("_gains", None)
        new._of = replace(self._of, stiffness=stiffness)
        for name in ("_step", "_soft", "_lag", "_by_column"):
            setattr(new, name, getattr(self, name).copy())
        return new

    def march(self, load: Load, begin: np.ndarray | None, *, accelerated: bool) -> Swung:
        """See `Steps`."""
        links, torque = load.links, load.torque
        added = np.zeros((*torque.shape[:2], 2 * self._n))
        if begin is not None:
            added[:, 0] = begin
        # One after another: that is faster than all together.
        beside = np.zeros(len(torque)) if load.within is None else load.within
        for state, on, each, own in zip(added, links, torque, beside, strict=True):
            ends = np.stack([each[:-1], each[1:]], axis=1) + own
            if len(on) == self._n:
                state += self._forced(ends)
                continue
            for link, (first, last) in zip(on.tolist(), ends.T, strict=True):
                begin_of, end_of = self._gains
                state[1:] += begin_of[link] * first[:, None] + end_of[link] * last[:, None]
        state = self._solved(added)
        of, n = self._of, self._n
        z, velocity = state[..., :n], of.unit * state[..., n:]
        if not accelerated:
            return z, velocity, None
        left = -(of.rate @ velocity[..., None] + of.stiffness @ z[..., None])[..., 0]
        for each, on, own in zip(left, links, torque, strict=True):
            each[:, on] += own
        return z, velocity, (of.mobility @ left[..., None])[..., 0]

    def _forced(self, ends: np.ndarray) -> np.ndarray:
        """What each step adds to the state (K, 2 n): a torque that is linear within it.

        Of its ends (K - 1, 2, n).
        """
        first, last, dt, unit = ends[:, 0, :, None], ends[:, 1, :, None], self._of.dt, self._of.unit
        ramp = (last - first) / dt
        held, late = self._soft @ first, self._lag @ ramp
        moving = self._soft @ ramp
        speed = moving / unit
        begin = np.concatenate([held - late, speed], axis=1)
        end = np.concatenate([held + dt * moving - late, speed], axis=1)
        added = np.zeros((len(ends) + 1, 2 * self._n))
        added[1:] = (end - self._step @ begin)[..., 0]
        return added

    @cached_property
    def _gains(self) -> tuple[np.ndarray, np.ndarray]:
        """What a step adds to the state for its torque at the begin, and at the end.

        (n, K - 1, 2 n) each: of a torque on every link.
        """
        dt, unit = self._of.dt, self._of.unit
        held = np.concatenate([self._soft, np.zeros_like(self._soft)], axis=1)
        ramp = np.concatenate([-self._lag, self._soft / unit], axis=1) / dt
        late = ramp - self._step @ ramp
        begin, end = -late - self._step @ held, late + held
        of_link = [np.ascontiguousarray(np.moveaxis(x, 2, 0)) for x in (begin, end)]
        return of_link[0], of_link[1]

    def _solved(self, added: np.ndarray) -> np.ndarray:
        """States (m, K, 2 n) from what each step adds to them; takes its memory."""
        if not len(added):
            return added
        band = self._by_column.reshape(-1, 4 * self._n).T
        whole = added.reshape(len(added), -1).T
        found, failed = dtbtrs(band, whole, uplo="L", diag="U", overwrite_b=True)
        assert not failed
        return np.asarray(found.T).reshape(added.shape)


def exponentials(matrices: np.ndarray) -> np.ndarray:
    """Exponentials of many small matrices (K, p, p), to machine precision.

    Series of the scaled matrices, squared again; scipy's takes them one by one.
    """
    largest = float(np.abs(matrices).sum(axis=1).max())
    halvings = max(0, int(np.ceil(np.log2(max(largest, 1e-300) / _SMALL))))
    once = matrices / 2.0**halvings
    twice = once @ once
    thrice = twice @ once

    def three(first: int) -> np.ndarray:
        c = [1.0 / factorial(first + k) for k in range(3)]
        terms = c[1] * once
        terms += c[2] * twice
        np.einsum("kii->ki", terms)[:] += c[0]
        return np.asarray(terms)

    found = three(_TERMS - 3)
    for first in range(_TERMS - 6, -1, -3):
        found = found @ thrice
        found += three(first)
    for _ in range(halvings):
        found = found @ found
    return np.asarray(found)
