"""Answer of links on their springs to small torques, linear along a motion.

M(t) z" + C(t) z' + K(t) z = f(t), with the matrices of the motion: inertia, Coriolis terms with the
damping of the joints, springs with the change of the weight. Matrices are constant from one sample
to the next and f is linear there; both steps are then exact, however fast a mode is.
"""

from __future__ import annotations

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
        n, count = self.n, len(inertia)
        mobility, damping, springs = (
            0.5 * (m[1:] + m[:-1]) for m in (self._mobility, rate, stiffness)
        )
        # Velocities over a typical rate, so that all states are of one size.
        self._unit = float(np.sqrt(np.max(np.abs(mobility @ springs))))
        slope = np.zeros((count - 1, 2 * n, 2 * n))
        slope[:, :n, n:] = self._unit * np.eye(n)
        slope[:, n:, :n] = -mobility @ springs / self._unit
        slope[:, n:, n:] = -mobility @ damping
        self._step = exponentials(dt * slope)
        self._soft = np.linalg.inv(springs)
        self._lag = self._soft @ damping @ self._soft

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
        state = self._march(self._forced(many))
        z, velocity = state[:, : self.n], self._unit * state[:, self.n :]
        pulled = self._pulled(many, z, velocity)
        return z[..., 0], velocity[..., 0], pulled[..., 0]

    def moved(self, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Swing and its velocity under torques (K, n) of many calls, mostly on one link.

        The same as a call gives; what a step does with a torque is kept from call to call.
        """
        added = np.zeros((len(torque), 2 * self.n, 1))
        begin, end = self._gains
        for j in np.flatnonzero(np.any(torque, axis=0)):
            own = torque[:, j, None]
            added[1:, :, 0] += begin[j] * own[:-1] + end[j] * own[1:]
        state = self._march(added)[..., 0]
        return state[:, : self.n], self._unit * state[:, self.n :]

    def free(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Swing (K, n, m) that is left alone after it begins at displacements and velocities.

        Parameters
        ----------
        state : array (2 n, m)
            [rad], below them [rad/s].
        """
        begin = np.zeros((len(self._step) + 1, 2 * self.n, state.shape[1]))
        begin[0, : self.n] = state[: self.n]
        begin[0, self.n :] = state[self.n :] / self._unit
        found = self._march(begin)
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

    @cached_property
    def _band(self) -> np.ndarray:
        """x_k+1 - step_k x_k = added_k+1 as a lower banded matrix of unit diagonal."""
        size, count = 2 * self.n, len(self._step)
        # By column: of a state, the diagonal and what the next one has of it below.
        by_column = np.zeros((count + 1, size, 2 * size))
        by_column[..., 0] = 1.0
        for column in range(size):
            below = slice(size - column, 2 * size - column)
            by_column[:-1, column, below] = -self._step[:, :, column]
        return by_column.reshape(-1, 2 * size).T

    def _march(self, added: np.ndarray) -> np.ndarray:
        count, size, many = added.shape
        if not many:
            return added
        found, failed = dtbtrs(self._band, added.reshape(count * size, many), uplo="L", diag="U")
        assert not failed
        return np.asarray(found).reshape(added.shape)


def exponentials(matrices: np.ndarray) -> np.ndarray:
    """Exponentials of many small matrices (K, p, p), to machine precision.

    Series of the scaled matrices, squared again; scipy's takes them one by one.
    """
    out = np.empty_like(matrices)
    for first in range(0, len(matrices), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        out[part] = _series(matrices[part])
    return out


def _series(matrices: np.ndarray) -> np.ndarray:
    largest = float(np.abs(matrices).sum(axis=1).max())
    halvings = max(0, int(np.ceil(np.log2(max(largest, 1e-300) / _SMALL))))
    once = matrices / 2.0**halvings
    twice = once @ once
    thrice = twice @ once
    own = np.eye(matrices.shape[1])

    def three(first: int) -> np.ndarray:
        c = [1.0 / factorial(first + k) for k in range(3)]
        return np.asarray(c[0] * own + c[1] * once + c[2] * twice)

    found = three(_TERMS - 3)
    for first in range(_TERMS - 6, -1, -3):
        found = found @ thrice + three(first)
    for _ in range(halvings):
        found = found @ found
    return np.asarray(found)
