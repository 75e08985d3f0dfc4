"""Joint motion with piecewise-polynomial acceleration, integrated exactly.

Trajectories have toppra's interface, `trajectory(t, order)`, so that the same code plots both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from stiffopt.errors import OutOfValidityError, ProblemError

# Relative rounding of times from other computations; no extrapolation.
_TIME_SLACK = 1e-9


class JointMotion(Protocol):
    """Interface of sampled motions of n joints, `motion(times, order)` as `Trajectory`."""

    @property
    def duration(self) -> float:
        """Time from start to end [s]."""

    def __call__(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        """Evaluate position (order 0) or a derivative at times (K,), shape (K, n)."""


@dataclass(frozen=True, eq=False)
class ForceHistory:
    """Force on the tool over time, linear in between and constant outside."""

    time: np.ndarray  # (K,) [s]
    force: np.ndarray  # (K, 3) [N] base axes

    def __call__(self, t: np.ndarray) -> np.ndarray:
        """Return the force (K, 3) at times (K,)."""
        return np.stack([np.interp(t, self.time, column) for column in self.force.T], axis=-1)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Motion of n joints over K intervals.

    Parameters
    ----------
    times : array (K + 1,)
        Breaks, from 0, strictly increasing. [s]
    acceleration : array (K, d + 1, n)
        Coefficient j of interval k multiplies (t - times[k])**j. [rad/s^(2+j)] or [m/s^(2+j)]
    q0, v0 : array (n,)
        Position [rad] or [m] and velocity [rad/s] or [m/s] at time 0.
    link : Trajectory or None
        Motion of the links, if this is the motion of motors that lead them; None for one motion of
        both.
    force : ForceHistory or None
        Process force on the tool during this motion of the links.

    Notes
    -----
    Position and velocity are continuous by construction. At a break, acceleration and jerk are
    those of the following interval; at the end, those of the last interval.
    """

    times: np.ndarray
    acceleration: np.ndarray
    q0: np.ndarray
    v0: np.ndarray
    link: Trajectory | None = None
    force: ForceHistory | None = None
    _position: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        times = np.array(self.times, dtype=float)
        acceleration = np.array(self.acceleration, dtype=float)
        q0, v0 = (np.array(x, dtype=float).reshape(-1) for x in (self.q0, self.v0))
        _check_coefficients(times, acceleration, q0, v0)
        position = _integrate_acceleration(times, acceleration, q0, v0)
        names = ("times", "acceleration", "q0", "v0", "_position")
        for name, array in zip(names, (times, acceleration, q0, v0, position), strict=True):
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @classmethod
    def from_acceleration(
        cls, times: object, coefficients: object, q0: object, v0: object
    ) -> Trajectory:
        """Trajectory from acceleration polynomials; parameters as for the class."""
        t, a, q, v = (np.asarray(x, dtype=float) for x in (times, coefficients, q0, v0))
        return cls(t, a, q, v)

    @classmethod
    def piecewise_linear_acceleration(
        cls, times: object, a_nodes: object, q0: object, v0: object
    ) -> Trajectory:
        """Trajectory whose acceleration is linear between nodes: a C2 cubic spline in position.

        Parameters
        ----------
        times : array_like (K + 1,)
            Nodes, from 0. [s]
        a_nodes : array_like (K + 1, n)
            Acceleration at the nodes. [rad/s^2] or [m/s^2]
        q0, v0 : array_like (n,)
            Position and velocity at time 0.
        """
        t, a = np.asarray(times, dtype=float), np.asarray(a_nodes, dtype=float)
        if a.ndim != 2 or t.shape != a.shape[:1]:
            raise ProblemError(
                f"a trajectory needs one row of accelerations at each node; got times of shape "
                f"{t.shape} and accelerations of shape {a.shape}."
            )
        slope = np.diff(a, axis=0) / np.diff(t)[:, None]
        return cls.from_acceleration(t, np.stack([a[:-1], slope], axis=1), q0, v0)

    @classmethod
    def through(
        cls,
        times: np.ndarray,
        derivatives: np.ndarray,
        link: Trajectory,
        ends: np.ndarray | None = None,
    ) -> Trajectory:
        """Interpolate samples by polynomials of degree 7, three times continuously differentiable.

        Steps below 0.2 ms interpolate acceleration and jerk alone: rounding of a position over
        the cube of the step would appear as jerk.

        Parameters
        ----------
        times : array (K + 1,)
            Samples, from 0. [s]
        derivatives : array (4, K + 1, n)
            Position, velocity, acceleration and jerk at the samples.
        ends : array (4, K, n), optional
            Left-hand values at the interval ends, if they jump at samples.
        """
        step = np.diff(times)[:, None]
        ends = derivatives[:, 1:] if ends is None else ends
        # Coefficients in the normalised time of an interval: four each from its start and end.
        first = [derivatives[k, :-1] * step**k / math.factorial(k) for k in range(4)]
        wanted = np.stack([ends[k] * step**k for k in range(4)])
        powers = np.array([[float(math.perm(j, k)) for j in range(8)] for k in range(4)])
        missing = wanted - np.einsum("kj,jin->kin", powers[:, :4], np.stack(first))
        last = np.einsum("jk,kin->jin", np.linalg.inv(powers[:, 4:]), missing)
        bent = np.einsum("jk,kin->jin", np.linalg.inv(powers[2:, 4:6]), missing[2:])
        # Shortest step over which positions are interpolated [s]: below, rounding at 3 rad gives
        # more than 0.05 rad/s^3 of jerk.
        short = step[:, 0] < 2e-4
        last[:, short] = np.concatenate([bent, np.zeros_like(bent)])[:, short]
        position = np.concatenate([first, last])
        acceleration = [j * (j - 1) * position[j] / step**j for j in range(2, 8)]
        start = derivatives[:, 0]
        return cls(times, np.stack(acceleration, axis=1), start[0], start[1], link)

    @property
    def duration(self) -> float:
        """Time from start to end [s]."""
        return float(self.times[-1])

    @property
    def joints(self) -> int:
        """Number of joints."""
        return int(self.q0.size)

    def __call__(self, t: object, order: int = 0) -> np.ndarray:
        """Evaluate position (order 0), velocity (1), acceleration (2) or jerk (3) at times `t`.

        Parameters
        ----------
        t : float or array_like (m,)
            Within [0, duration]. [s]
        order : int
            Number of derivatives by time; any order, those beyond the degree are zero.

        Returns
        -------
        array (n,) for a single time, (m, n) for several
        """
        time = np.asarray(t, dtype=float)
        slack = _TIME_SLACK * self.duration
        for outside in time[~((time >= -slack) & (time <= self.duration + slack))].flat:
            raise OutOfValidityError(
                "time", outside, 0.0, self.duration, "A trajectory is defined between its ends."
            )
        interval = np.clip(
            np.searchsorted(self.times, time, side="right") - 1, 0, len(self.times) - 2
        )
        local = (np.clip(time, 0.0, self.duration) - self.times[interval])[..., None]
        # Blocks of times need the coefficients of few intervals.
        first, last = (interval.min(), interval.max()) if interval.size else (0, 0)
        interval = interval - first
        # Contiguous powers halve the evaluation time.
        powers = np.ascontiguousarray(
            _differentiate_coefficients(self._position[first : last + 1], order).swapaxes(0, 1)
        )
        value = np.take(powers[-1], interval, axis=0)
        for each in powers[-2::-1]:
            value *= local
            value += np.take(each, interval, axis=0)
        return value

    def scaled_to(self, duration: float) -> Trajectory:
        """Scale the speed uniformly along the same path.

        Parameters
        ----------
        duration : float
            New duration; velocities change by the ratio, accelerations by its square. [s]
        """
        if not (np.isfinite(duration) and duration > 0):
            raise ProblemError(f"a trajectory cannot take {duration:g} s; give a positive time.")
        factor = duration / self.duration
        powers = 2.0 + np.arange(self.acceleration.shape[1])
        times = self.times * factor
        times[-1] = duration
        return Trajectory(
            times,
            self.acceleration * (factor**-powers)[:, None],
            self.q0,
            self.v0 / factor,
        )

    def plus(self, change: Trajectory) -> Trajectory:
        """Add a motion of the same duration exactly, whatever the distance of their breaks.

        Interpolating samples of the sum would divide rounding by the cube of short steps.

        Parameters
        ----------
        change : Trajectory
            Motion to add; the link motion stays that of this trajectory.
        """
        return self._combined(change, 1.0, 1.0, self.link)

    def mixed_with(self, other: Trajectory, share: float) -> Trajectory:
        """Return the motion at a share of the way to another one of the same duration."""
        return self._combined(other, 1.0 - share, share, None)

    def _combined(
        self, other: Trajectory, own_factor: float, factor: float, link: Trajectory | None
    ) -> Trajectory:
        """Return the weighted sum of two motions of the same duration."""
        times = np.union1d(self.times, other.times)
        # Breaks of both that differ by rounding are one.
        times = times[np.append(np.diff(times) > _TIME_SLACK * self.duration, True)]
        times[[0, -1]] = 0.0, self.duration
        parts = [
            weight * _recentre_coefficients(times, each)
            for weight, each in ((own_factor, self), (factor, other))
        ]
        less, total = sorted(parts, key=lambda each: each.shape[1])
        total[:, : less.shape[1]] += less
        q0, v0 = (
            own_factor * getattr(self, name) + factor * getattr(other, name)
            for name in ("q0", "v0")
        )
        return Trajectory(times, total, q0, v0, link)

    def held_for(self, rest: float) -> Trajectory:
        """Append a rest [s] under the same process force to a motion that ends at rest."""
        if rest <= 0.0:
            return self
        return Trajectory(
            np.append(self.times, self.duration + rest),
            np.concatenate([self.acceleration, np.zeros_like(self.acceleration[:1])]),
            self.q0,
            self.v0,
            force=self.force,
        )

    def sample(self, step: float) -> np.ndarray:
        """Sampling times from 0 to the end, `step` apart, the end included.

        Parameters
        ----------
        step : float
            Step; the last one may be shorter. [s]

        Returns
        -------
        array (m,)
        """
        if not step > 0:
            raise ProblemError(f"a sampling step must be positive, got {step:g} s.")
        count = int(np.floor(self.duration / step * (1 + 1e-12)))
        times: np.ndarray = np.minimum(np.arange(count + 1) * step, self.duration)
        if self.duration - times[-1] > 1e-9 * step:
            return np.append(times, self.duration)
        times[-1] = self.duration
        return times


def join_motions(motions: list[tuple[Trajectory, float]]) -> Trajectory:
    """Return motions from rest to rest one after another, each followed by a rest [s]."""
    times, parts, at = [np.zeros(1)], [], 0.0
    degree = max(motion.acceleration.shape[1] for motion, _ in motions)
    for motion, dwell in motions:
        held = motion.held_for(dwell)
        times.append(at + held.times[1:])
        at += held.duration
        part = np.zeros((len(held.times) - 1, degree, held.joints))
        part[:, : held.acceleration.shape[1]] = held.acceleration
        parts.append(part)
    first = motions[0][0]
    return Trajectory(np.concatenate(times), np.concatenate(parts), first.q0, first.v0)


def _check_coefficients(
    times: np.ndarray, acceleration: np.ndarray, q0: np.ndarray, v0: np.ndarray
) -> None:
    if times.ndim != 1 or times.size < 2 or times[0] != 0.0 or not np.all(np.diff(times) > 0):
        raise ProblemError(
            "the times of a trajectory must start at 0 and increase strictly, with at least two."
        )
    shape = (times.size - 1, q0.size)
    if acceleration.ndim != 3 or acceleration.shape[::2] != shape or v0.size != q0.size:
        raise ProblemError(
            f"the acceleration of a trajectory must have the shape (intervals, coefficients, "
            f"joints) = ({shape[0]}, any, {shape[1]}), got {acceleration.shape}; velocities: "
            f"{v0.size}."
        )
    for name, array in (("acceleration", acceleration), ("q0", q0), ("v0", v0)):
        if not np.all(np.isfinite(array)):
            raise ProblemError(f"{name} of a trajectory holds a value that is not finite.")


def _integrate_acceleration(
    times: np.ndarray, acceleration: np.ndarray, q0: np.ndarray, v0: np.ndarray
) -> np.ndarray:
    """Position coefficients (K, d + 3, n), continuous in position and velocity."""
    step = np.diff(times)
    j = np.arange(acceleration.shape[1])
    position = np.zeros((len(step), len(j) + 2, q0.size))
    position[:, 2:] = acceleration / ((j + 1.0) * (j + 2.0))[None, :, None]
    powers = step[:, None] ** (j + 1.0)
    gain = np.einsum("kj,kjn->kn", powers / (j + 1.0), acceleration)
    shift = np.einsum("kj,kjn->kn", powers * step[:, None], position[:, 2:])
    velocity = np.vstack([v0, v0 + np.cumsum(gain, axis=0)])
    position[:, 1] = velocity[:-1]
    travel = velocity[:-1] * step[:, None] + shift
    position[:, 0] = np.vstack([q0, q0 + np.cumsum(travel, axis=0)])[:-1]
    return position


def _recentre_coefficients(times: np.ndarray, motion: Trajectory) -> np.ndarray:
    """Acceleration coefficients (K, d + 1, n) about the starts of other intervals."""
    interval = np.searchsorted(motion.times, 0.5 * (times[:-1] + times[1:])) - 1
    coefficients = motion.acceleration[interval]
    local = times[:-1] - motion.times[interval]
    moved: np.ndarray = np.zeros_like(coefficients)
    for low in range(coefficients.shape[1]):
        for high in range(low, coefficients.shape[1]):
            share = math.comb(high, low) * local ** (high - low)
            moved[:, low] += share[:, None] * coefficients[:, high]
    return moved


def _differentiate_coefficients(coefficients: np.ndarray, order: int) -> np.ndarray:
    for _ in range(order):
        if coefficients.shape[1] == 1:
            return np.zeros_like(coefficients)
        factors = np.arange(1.0, coefficients.shape[1])
        coefficients = coefficients[:, 1:] * factors[:, None]
    return coefficients
