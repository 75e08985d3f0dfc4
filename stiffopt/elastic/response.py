"""Answer of links on their springs to small torques, linear along a motion.

M(t) z" + C(t) z' + K(t) z = f(t), with the matrices of the motion: inertia, Coriolis terms with the
damping of the joints, springs with the change of the weight. Matrices are constant from one sample
to the next and f is linear there; both steps are then exact, however fast a mode is.
"""

from __future__ import annotations

from copy import copy

import numpy as np
from scipy.linalg import eigh

from stiffopt.elastic import native_steps
from stiffopt.elastic.steps import ArraySteps, Load, Matrices, Steps


class SwingResponse:
    """Links that swing about a motion.

    Parameters
    ----------
    inertia, rate, stiffness : array (K, n, n)
        M [kg m^2], C [N m s/rad] and K [N m/rad] at every sample.
    dt : float
        Between samples [s].
    mobility : array (K, n, n), optional
        Inverse of the inertia, where it is known.

    Attributes
    ----------
    mobility : array (K, n, n)

    Notes
    -----
    It begins without swing. Steps by the matrix exponential of the mean matrices of both ends.
    """

    def __init__(
        self,
        inertia: np.ndarray,
        rate: np.ndarray,
        stiffness: np.ndarray,
        dt: float,
        mobility: np.ndarray | None = None,
    ) -> None:
        self.dt, self.n = dt, inertia.shape[1]
        self.mobility = np.linalg.inv(inertia) if mobility is None else mobility
        self._stiffness = np.array(stiffness, dtype=float, order="C")
        # Velocities over a typical rate, so that all states are of one size.
        self._unit = float(np.sqrt(np.max(np.abs(self.mobility @ self._stiffness))))
        damping = np.ascontiguousarray(rate, dtype=float)
        given = Matrices(self.mobility, damping, self._stiffness, dt, self._unit)
        self._steps: Steps = native_steps.steps(given) or ArraySteps(given)

    def copy(self) -> SwingResponse:
        """One whose springs may be changed."""
        new = copy(self)
        new._stiffness = self._stiffness.copy()
        new._steps = self._steps.copy(new._stiffness)
        return new

    def change_springs(self, samples: slice, stiffness: np.ndarray) -> None:
        """Take other springs (K, n, n) at some samples [N m/rad]; elsewhere they stay."""
        self._stiffness[samples] = stiffness
        first, last, _ = samples.indices(len(self._stiffness))
        self._steps.take(max(first - 1, 0), min(last, len(self._stiffness) - 1))

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
        many = np.moveaxis(torque, 2, 0) if torque.ndim == 3 else torque[None]
        z, velocity, acceleration = self._marched(
            Load(np.tile(np.arange(self.n), (len(many), 1)), many)
        )
        if torque.ndim == 2:
            return z[0], velocity[0], acceleration[0]
        return np.moveaxis(z, 0, 2), np.moveaxis(velocity, 0, 2), np.moveaxis(acceleration, 0, 2)

    def driven(
        self,
        torque: np.ndarray,
        z: np.ndarray,
        velocity: np.ndarray,
        within: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Swing under torques (K, n) that begins at a displacement and a velocity (n,).

        And, where given, under others at the begin and the end of every step (K - 1, 2, n).
        """
        begin = np.concatenate([z, velocity / self._unit])[None]
        beside = None if within is None else within[None]
        found = self._marched(Load(np.arange(self.n)[None], torque[None], beside), begin)
        return found[0][0], found[1][0], found[2][0]

    def moved(self, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Swing and its velocity under torques (K, n) of many calls, mostly on one link.

        The same as a call gives; what a step does with a torque is kept from call to call.
        """
        links = np.flatnonzero(torque.any(axis=0))
        load = Load(links[None], torque[None][..., links])
        z, velocity, _ = self._steps.march(load, None, accelerated=False)
        return z[0], velocity[0]

    def pushed(self, links: np.ndarray, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Swing and its velocity (m, K, n) under m torques (m, K), each on one link (m,)."""
        load = Load(links[:, None], torque[..., None])
        z, velocity, _ = self._steps.march(load, None, accelerated=False)
        return z, velocity

    def free(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Swing (K, n, m) that is left alone after it begins at displacements and velocities.

        Parameters
        ----------
        state : array (2 n, m)
            [rad], below them [rad/s].
        """
        begin = state.T / np.repeat([1.0, self._unit], self.n)
        nothing = np.zeros((len(begin), len(self._stiffness), 0))
        found = self._marched(Load(np.zeros((len(begin), 0), dtype=int), nothing), begin)
        z, velocity, acceleration = (np.moveaxis(each, 0, 2) for each in found)
        return z, velocity, acceleration

    def modes(self, sample: int) -> tuple[np.ndarray, np.ndarray]:
        """Modes with the matrices of one sample.

        Frequencies (n,) [Hz], lowest first, and shapes (n, n) of unit modal mass, in columns. A fit
        on its way may have masses that cannot be: what then does not swing has 0 Hz and no shape.
        """
        mobility, stiffness = (
            0.5 * (m[sample] + m[sample].T) for m in (self.mobility, self._stiffness)
        )
        root = np.linalg.cholesky(stiffness)
        squares, turned = eigh(root.T @ mobility @ root)
        rates = np.sqrt(np.maximum(squares, 0.0))
        shapes = mobility @ root @ turned / np.where(rates > 0.0, rates, np.inf)
        return rates / (2.0 * np.pi), shapes

    def _marched(
        self, load: Load, begin: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        z, velocity, acceleration = self._steps.march(load, begin, accelerated=True)
        assert acceleration is not None
        return z, velocity, acceleration
