"""Answer of links on their springs to small torques, linear along a motion.

M(t) z" + C(t) z' + K(t) z = f(t), with the matrices of the motion: inertia, Coriolis terms with the
damping of the joints, springs with the change of the weight. Matrices are constant from one sample
to the next and f is linear there; both steps are then exact, however fast a mode is.
"""

from __future__ import annotations

from copy import copy
from functools import cached_property
from math import factorial

import numpy as np
from scipy.linalg import eigh
from scipy.linalg.lapack import dtbtrs

# Matrices whose exponentials are taken at once: few enough to stay in the processor's cache.
_AT_ONCE = 96
# Terms of the exponential's series, and the norm up to which they give it to machine precision.
_TERMS, _SMALL = 12, 0.5


class SwingResponse:
    """Links that swing about a motion.

    Parameters
    ----------
    inertia, rate, stiffness : array (K, n, n)
        M [kg m^2], C [N m s/rad] and K [N m/rad] at every sample.
    dt : float
        Between samples [s].

    Notes
    -----
    It begins without swing. Steps by the matrix exponential of the mean matrices of both ends.
    """

    def __init__(
        self, inertia: np.ndarray, rate: np.ndarray, stiffness: np.ndarray, dt: float
    ) -> None:
        self.dt, self.n = dt, inertia.shape[1]
        self._mobility = np.linalg.inv(inertia)
        self._rate, self._stiffness = rate, stiffness
        # Velocities over a typical rate, so that all states are of one size.
        self._unit = float(np.sqrt(np.max(np.abs(self._mobility @ stiffness))))
        steps, size = len(inertia) - 1, 2 * self.n
        self._step = np.empty((steps, size, size))
        self._soft, self._lag = np.empty((2, steps, self.n, self.n))
        # x_k+1 - step_k x_k = added_k+1 as a lower banded matrix of unit diagonal. By column: of a
        # state, the diagonal and what the next one has of it below.
        self._by_column = np.zeros((steps + 1, size, 2 * size))
        self._by_column[..., 0] = 1.0
        self._take(0, steps)

    def _take(self, first: int, last: int) -> None:
        """Take steps, those from sample `first` on and before `last`, with the springs of now."""
        n, size = self.n, 2 * self.n
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
                0.5 * (m[ends] + m[steps]) for m in (self._mobility, self._rate, self._stiffness)
            )
            slope = np.zeros((len(springs), size, size))
            slope[:, :n, n:] = self._unit * np.eye(n)
            slope[:, n:, :n] = -mobility @ springs / self._unit
            slope[:, n:, n:] = -mobility @ damping
            self._step[steps] = exponentials(self.dt * slope)
            below[steps] = -self._step[steps].swapaxes(1, 2)
            self._soft[steps] = soft = np.linalg.inv(springs)
            self._lag[steps] = soft @ damping @ soft

    def copy(self) -> SwingResponse:
        """One whose springs may be changed."""
        new = copy(self)
        new.__dict__.pop("_gains", None)
        for name in ("_stiffness", "_step", "_soft", "_lag", "_by_column"):
            setattr(new, name, getattr(self, name).copy())
        return new

    def change_springs(self, samples: slice, stiffness: np.ndarray) -> None:
        """Take other springs (K, n, n) at some samples [N m/rad]; elsewhere they stay."""
        self._stiffness[samples] = stiffness
        self.__dict__.pop("_gains", None)
        first, last, _ = samples.indices(len(self._stiffness))
        self._take(max(first - 1, 0), min(last, len(self._step)))

    def __call__(self, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Swing under torques on the links.

        Parameters
        ----------
        torque : array (K, n) or (K, n, m)
            m of them beside each other [N m].

        Returns
        -------
        z, velocity, acceleration : arrays like `torque`
            [rad], [rad/s], [rad/s^2].
        """
        if torque.ndim == 3:
            # One after another: that is faster than all together.
            each = [self(torque[..., i]) for i in range(torque.shape[2])]
            z, velocity, acceleration = (np.stack(x, axis=2) for x in zip(*each, strict=True))
            return z, velocity, acceleration
        many = torque[..., None]
        state = self._march(self._forced(many)[None, ..., 0])[0]
        z, velocity = state[:, : self.n], self._unit * state[:, self.n :]
        return z, velocity, self._pulled(many, z[..., None], velocity[..., None])[..., 0]

    def moved(self, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Swing and its velocity under torques (K, n) of many calls, mostly on one link.

        The same as a call gives; what a step does with a torque is kept from call to call.
        """
        added = np.zeros((1, len(torque), 2 * self.n))
        for link in np.flatnonzero(torque.any(axis=0)).tolist():
            self._push(added, link, torque[None, :, link])
        state = self._march(added)[0]
        return state[:, : self.n], self._unit * state[:, self.n :]

    def pushed(self, link: int, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Swing and its velocity (m, K, n) under each of m torques (m, K) on one link."""
        added = np.zeros((*torque.shape, 2 * self.n))
        self._push(added, link, torque)
        state = self._march(added)
        return state[..., : self.n], self._unit * state[..., self.n :]

    def _push(self, added: np.ndarray, link: int, torque: np.ndarray) -> None:
        """Add to the states (m, K, 2 n) what each of m torques (m, K) does on one link."""
        begin, end = self._gains
        added[:, 1:] += begin[link] * torque[:, :-1, None]
        added[:, 1:] += end[link] * torque[:, 1:, None]

    def free(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Swing (K, n, m) that is left alone after it begins at displacements and velocities.

        Parameters
        ----------
        state : array (2 n, m)
            [rad], below them [rad/s].
        """
        begin = np.zeros((state.shape[1], len(self._step) + 1, 2 * self.n))
        begin[:, 0, : self.n] = state[: self.n].T
        begin[:, 0, self.n :] = state[self.n :].T / self._unit
        found = np.moveaxis(self._march(begin), 0, 2)
        z, velocity = found[:, : self.n], self._unit * found[:, self.n :]
        return z, velocity, self._pulled(np.zeros_like(z), z, velocity)

    def modes(self, sample: int) -> tuple[np.ndarray, np.ndarray]:
        """Modes with the matrices of one sample.

        Frequencies (n,) [Hz], lowest first, and shapes (n, n) of unit modal mass, in columns. A fit
        on its way may have masses that cannot be: what then does not swing has 0 Hz and no shape.
        """
        mobility, stiffness = (
            0.5 * (m[sample] + m[sample].T) for m in (self._mobility, self._stiffness)
        )
        root = np.linalg.cholesky(stiffness)
        squares, turned = eigh(root.T @ mobility @ root)
        rates = np.sqrt(np.maximum(squares, 0.0))
        shapes = mobility @ root @ turned / np.where(rates > 0.0, rates, np.inf)
        return rates / (2.0 * np.pi), shapes

    def _forced(self, torque: np.ndarray) -> np.ndarray:
        """What each step adds to the state: a torque that is linear within it."""
        ramp = (torque[1:] - torque[:-1]) / self.dt
        held, late = self._soft @ torque[:-1], self._lag @ ramp
        moving = self._soft @ ramp
        speed = moving / self._unit
        begin = np.concatenate([held - late, speed], axis=1)
        end = np.concatenate([held + self.dt * moving - late, speed], axis=1)
        added = np.zeros((len(torque), 2 * self.n, torque.shape[2]))
        added[1:] = end - self._step @ begin
        return added

    @cached_property
    def _gains(self) -> tuple[np.ndarray, np.ndarray]:
        """What a step adds to the state for its torque at the begin, and at the end.

        (n, K - 1, 2 n) each: of a torque on every link.
        """
        held = np.concatenate([self._soft, np.zeros_like(self._soft)], axis=1)
        ramp = np.concatenate([-self._lag, self._soft / self._unit], axis=1) / self.dt
        late = ramp - self._step @ ramp
        begin, end = -late - self._step @ held, late + held
        of_link = [np.ascontiguousarray(np.moveaxis(x, 2, 0)) for x in (begin, end)]
        return of_link[0], of_link[1]

    def _pulled(self, torque: np.ndarray, z: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        left = torque - self._rate @ velocity - self._stiffness @ z
        return np.asarray(self._mobility @ left)

    def _march(self, added: np.ndarray) -> np.ndarray:
        """States (m, K, 2 n) from what each step adds to them; takes its memory."""
        if not len(added):
            return added
        band = self._by_column.reshape(-1, 4 * self.n).T
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
