"""Linear elastic response of the links to small torques along a motion.

M(t) z" + C(t) z' + K(t) z = f(t), with the matrices of the motion: inertia, Coriolis terms with the
damping of the joints, springs with the change of the weight. Matrices are constant from one sample
to the next and f is linear there; the matrix exponential is then exact, however fast a mode is.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import scipy

from stiffopt.elastic import native

Response = tuple[np.ndarray, np.ndarray, np.ndarray | None]


@dataclass(frozen=True)
class Matrices:
    """Matrices of the linearised equation of motion along a motion."""

    # (K, n, n) inverse inertia, C and K at every sample; K may change in place before `take`.
    mobility: np.ndarray
    rate: np.ndarray
    stiffness: np.ndarray
    dt: float  # between samples [s]
    unit: float  # typical rate [1/s] that scales velocities to the size of displacements

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return int(self.mobility.shape[1])


@dataclass(frozen=True)
class Load:
    """Torques of m independent responses, each on l links of its own."""

    links: np.ndarray  # (m, l)
    torque: np.ndarray  # (m, K, l) at every sample, linear in between [N m]
    # (m, K - 1, 2, l) added to those, at the start and at the end of every step [N m].
    within: np.ndarray | None = None


class Steps(Protocol):
    """Transition from each sample to the next."""

    def take(self, first: int, last: int) -> None:
        """Recompute the steps from sample `first` up to `last` with the present stiffness."""

    def copy(self, stiffness: np.ndarray) -> Steps:
        """Return a copy that refers to another array of stiffness (K, n, n)."""

    def march(self, load: Load, begin: np.ndarray | None, *, accelerated: bool) -> Response:
        """Integrate m responses: displacements, velocities, accelerations (m, K, n) on request.

        `begin` (m, 2 n): initial displacements [rad], then velocities over `unit`; None is at rest.
        """


class ArraySteps:
    """Steps by the mean matrices of both ends in NumPy, without the compiled core."""

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
        self._step[steps] = scipy.linalg.expm(self._of.dt * slope)
        self._soft[steps] = soft = np.linalg.inv(springs)
        self._lag[steps] = soft @ damping @ soft

    def copy(self, stiffness: np.ndarray) -> ArraySteps:
        """See `Steps`."""
        new = copy(self)
        new._of = replace(self._of, stiffness=stiffness)
        for name in ("_step", "_soft", "_lag"):
            setattr(new, name, getattr(self, name).copy())
        return new

    def march(self, load: Load, begin: np.ndarray | None, *, accelerated: bool) -> Response:
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
        # As columns a response has the same digits alone and beside others.
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


class ElasticResponse:
    """Linear time-varying response of the links to torques, about a motion.

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
    Initially at rest. Steps by the matrix exponential of the mean matrices of both ends.
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
        self._matrices = Matrices(self.mobility, damping, self._stiffness, dt, self._unit)
        self._known_steps: Steps | None = None

    @property
    def _steps(self) -> Steps:
        """Transition matrices, which take more memory than the motion itself."""
        if self._known_steps is None:
            given = self._matrices
            self._known_steps = native.native_steps(given) or ArraySteps(given)
        return self._known_steps

    def release_steps(self) -> None:
        """Free the transition matrices, which are recomputed when needed."""
        self._known_steps = None

    def copy(self) -> ElasticResponse:
        """Return an independent copy whose stiffness may be changed."""
        new = copy(self)
        new._stiffness = self._stiffness.copy()
        new._matrices = replace(self._matrices, stiffness=new._stiffness)
        if self._known_steps is not None:
            new._known_steps = self._known_steps.copy(new._stiffness)
        return new

    def change_springs(self, samples: slice, stiffness: np.ndarray) -> None:
        """Replace the stiffness (K, n, n) [N m/rad] at some samples."""
        self._stiffness[samples] = stiffness
        first, last, _ = samples.indices(len(self._stiffness))
        self._steps.take(max(first - 1, 0), min(last, len(self._stiffness) - 1))

    def __call__(self, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the response to torques on the links.

        `torque` (K, n) or (K, n, m): m load cases side by side [N m]. `z, velocity, acceleration`
        arrays like `torque`: [rad], [rad/s], [rad/s^2].
        """
        many = np.moveaxis(torque, 2, 0) if torque.ndim == 3 else torque[None]
        z, velocity, acceleration = self._integrate_with_acceleration(
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
        """Return the response to torques (K, n) from an initial displacement and velocity (n,).

        `within` adds torques at the start and the end of every step (K - 1, 2, n).
        """
        begin = np.concatenate([z, velocity / self._unit])[None]
        beside = None if within is None else within[None]
        found = self._integrate_with_acceleration(
            Load(np.arange(self.n)[None], torque[None], beside), begin
        )
        return found[0][0], found[1][0], found[2][0]

    def moved(self, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return responses and velocities (m, K, n) to m torques (m, K, n) that load few links.

        As a call, without accelerations; links without torque are skipped.
        """
        links = np.flatnonzero(torque.any(axis=(0, 1)))
        load = Load(np.tile(links, (len(torque), 1)), torque[..., links])
        z, velocity, _ = self._steps.march(load, None, accelerated=False)
        return z, velocity

    def pushed(self, links: np.ndarray, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return response and velocity (m, K, n) to m torques (m, K), each on one link (m,)."""
        load = Load(links[:, None], torque[..., None])
        z, velocity, _ = self._steps.march(load, None, accelerated=False)
        return z, velocity

    def free(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the free response (K, n, m) to initial displacements and velocities.

        `state` (2 n, m) [rad], below them [rad/s].
        """
        begin = state.T / np.repeat([1.0, self._unit], self.n)
        nothing = np.zeros((len(begin), len(self._stiffness), 0))
        found = self._integrate_with_acceleration(
            Load(np.zeros((len(begin), 0), dtype=int), nothing), begin
        )
        z, velocity, acceleration = (np.moveaxis(each, 0, 2) for each in found)
        return z, velocity, acceleration

    def modes(self, sample: int) -> tuple[np.ndarray, np.ndarray]:
        """Modes with the matrices of one sample.

        Frequencies (n,) [Hz], lowest first, and shapes (n, n) of unit modal mass, in columns.
        Inertia that is not positive, as in iterations of a fit, gives 0 Hz and a zero shape.
        """
        mobility, stiffness = (
            0.5 * (m[sample] + m[sample].T) for m in (self.mobility, self._stiffness)
        )
        root = np.linalg.cholesky(stiffness)
        squares, turned = scipy.linalg.eigh(root.T @ mobility @ root)
        rates = np.sqrt(np.maximum(squares, 0.0))
        shapes = mobility @ root @ turned / np.where(rates > 0.0, rates, np.inf)
        return rates / (2.0 * np.pi), shapes

    def _integrate_with_acceleration(
        self, load: Load, begin: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        z, velocity, acceleration = self._steps.march(load, begin, accelerated=True)
        assert acceleration is not None
        return z, velocity, acceleration
