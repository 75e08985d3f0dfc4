"""Answer of links on their springs to small torques, linear along a motion.

M(t) z" + C(t) z' + K(t) z = f(t), with the matrices of the motion: inertia, Coriolis terms with the
damping of the joints, springs with the change of the weight. Matrices are constant from one sample
to the next and f is linear there; both steps are then exact, however fast a mode is.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.linalg import eigh, expm
from scipy.linalg.lapack import dtbtrs


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
        self._step = expm(dt * slope)
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

        Frequencies (n,) [Hz], lowest first, and shapes (n, n) of unit modal mass, in columns.
        """
        inertia = np.linalg.inv(self._mobility[sample])
        stiffness = self._stiffness[sample]
        squares, shapes = eigh(0.5 * (stiffness + stiffness.T), 0.5 * (inertia + inertia.T))
        return np.sqrt(np.maximum(squares, 0.0)) / (2.0 * np.pi), shapes

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

    def _pulled(self, torque: np.ndarray, z: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        left = torque - self._rate @ velocity - self._stiffness @ z
        return np.asarray(self._mobility @ left)

    @cached_property
    def _band(self) -> np.ndarray:
        """x_k+1 - step_k x_k = added_k+1 as a lower banded matrix of unit diagonal."""
        size, count = 2 * self.n, len(self._step)
        band = np.zeros((2 * size, (count + 1) * size), order="F")
        band[0] = 1.0
        columns = np.arange(count)[:, None] * size + np.arange(size)
        for row in range(size):
            for column in range(size):
                band[size + row - column, columns[:, column]] = -self._step[:, row, column]
        return band

    def _march(self, added: np.ndarray) -> np.ndarray:
        count, size, many = added.shape
        if not many:
            return added
        found, failed = dtbtrs(self._band, added.reshape(count * size, many), uplo="L", diag="U")
        assert not failed
        return np.asarray(found).reshape(added.shape)
