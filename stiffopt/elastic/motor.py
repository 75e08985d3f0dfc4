"""Motor motion: the command itself, or the response of a servo to it."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from stiffopt.errors import InputError

if TYPE_CHECKING:
    from stiffopt.result.trajectory import JointMotion

# Between samples [s]; cubic interpolation is then exact to a nanoradian.
_SAMPLE_INTERVAL = 5e-4
# Final speed of a motion that ends at rest [rad/s].
_MAX_REST_SPEED = 1e-6


class MotorMotion:
    """Motor positions over time, cubic between samples, at rest after the last one.

    Parameters
    ----------
    time : array (K,)
        From 0, strictly increasing [s].
    position, velocity : array (K, n)
        [rad], [rad/s].
    duration : float, optional
        When the command arrives [s]; default the last sample.
    """

    def __init__(
        self,
        time: np.ndarray,
        position: np.ndarray,
        velocity: np.ndarray,
        duration: float | None = None,
    ) -> None:
        self.time = np.asarray(time, dtype=float)
        self.duration = float(self.time[-1]) if duration is None else duration
        self._end = float(self.time[-1])
        self._spline = CubicHermiteSpline(self.time, position, velocity)
        self._times = self.time.tolist()
        # Positions, then velocities, highest power first: (4, 2 n) each.
        c3, c2, c1, c0 = self._spline.c
        slopes = np.stack([np.zeros_like(c3), 3.0 * c3, 2.0 * c2, c1])
        both = np.concatenate([np.stack([c3, c2, c1, c0]), slopes], axis=2)
        self._pieces = list(np.ascontiguousarray(both.transpose(1, 0, 2)))
        self._joints = both.shape[2] // 2
        self._last = np.array(position[-1], dtype=float)
        self._still = np.zeros_like(self._last)
        self.ends_at_rest = bool(np.max(np.abs(velocity[-1])) < _MAX_REST_SPEED)

    @classmethod
    def of(cls, motion: JointMotion) -> MotorMotion:
        """Sample a motion `motion(t, order)`, also at its break times (`motion.times`)."""
        count = max(2, int(np.ceil(motion.duration / _SAMPLE_INTERVAL)) + 1)
        breaks = np.asarray(getattr(motion, "times", ()), dtype=float)
        time = np.union1d(np.linspace(0.0, motion.duration, count), breaks)
        time = time[np.concatenate([[True], np.diff(time) > 1e-9 * motion.duration])]
        return cls(time, motion(time, 0), motion(time, 1))

    def __call__(self, t: object, order: int = 0) -> np.ndarray:
        """Positions (order 0) or their derivatives (K, n) at the times (K,)."""
        times = np.asarray(t, dtype=float)
        value = self._spline(np.clip(times, 0.0, self._end), order)
        if order == 0:
            return np.asarray(value)
        return np.where((times > self._end)[..., None], 0.0, value)

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        """Position and velocity (n,) at one instant."""
        if t > self._end:
            return self._last, self._still
        k = min(max(bisect_right(self._times, t) - 1, 0), len(self._pieces) - 1)
        x = t - self._times[k]
        both = np.dot(np.array((x * x * x, x * x, x, 1.0)), self._pieces[k])
        return both[: self._joints], both[self._joints :]

    def table(self) -> dict[str, np.ndarray | int]:
        """Break times (k + 1,), pieces (k, 4, 2 n) as in `at`, and the last position (n,)."""
        pieces = np.array(self._pieces)
        return {
            "pieces": len(pieces),
            "times": self.time,
            "motion": pieces,
            "last": self._last,
        }

    def acceleration(self, t: float) -> np.ndarray:
        """Acceleration (n,) at one instant."""
        return self._still if t > self._end else np.asarray(self._spline(t, 2))

    def position(self, times: np.ndarray) -> np.ndarray:
        """Positions (K, n) at the times (K,)."""
        return np.asarray(self._spline(np.clip(times, 0.0, self._end)))


@dataclass(frozen=True)
class Servo:
    """Servo: position loop with velocity feed-forward and dead time, the same for every joint.

    The motor's speed is feed_forward times the command's, delayed, plus 2 pi bandwidth times the
    delayed position error. The reaction of the links on the motors is neglected.

    Parameters
    ----------
    bandwidth : float
        Of the position loop [Hz].
    feed_forward : float
        Share of the command's velocity that is fed forward, 0 to 1.
    delay : float
        Dead time of the loop [s].
    """

    bandwidth: float
    feed_forward: float = 1.0
    delay: float = 0.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.bandwidth) and self.bandwidth > 0.0):
            raise InputError(f"the servo's bandwidth must be above 0 Hz, got {self.bandwidth:g}.")
        if not 0.0 <= self.feed_forward <= 1.0:
            raise InputError(
                f"the servo's velocity feed-forward is a share from 0 to 1, got "
                f"{self.feed_forward:g}."
            )
        if not (np.isfinite(self.delay) and self.delay >= 0.0):
            raise InputError(f"the servo's delay must be 0 s or above, got {self.delay:g}.")
        largest = 1.0 / (4.0 * self.bandwidth)
        if self.delay >= largest:
            raise InputError(
                f"the servo is unstable: a position loop of {self.bandwidth:g} Hz needs a delay "
                f"below {1e3 * largest:.4g} ms, and has {1e3 * self.delay:.4g} ms. Lower the "
                "bandwidth or the delay."
            )

    @property
    def follows_exactly(self) -> bool:
        """True with full velocity feed-forward and without delay."""
        return self.feed_forward == 1.0 and self.delay == 0.0

    def __str__(self) -> str:
        delay = f" and {1e3 * self.delay:g} ms delay" if self.delay else ""
        forward = f"{100.0 * self.feed_forward:.3g} % velocity feed-forward"
        return f"{self.bandwidth:g} Hz with {forward}{delay}"

    def with_lag(self, command: MotorMotion, until: float, share: float) -> MotorMotion:
        """Motor motion with a share of the servo's lag, until the time `until` [s]."""
        late = self.follow(command, until)
        exact = 1.0 - share
        return MotorMotion(
            late.time,
            share * late.position(late.time) + exact * command.position(late.time),
            share * late(late.time, 1) + exact * command(late.time, 1),
            command.duration,
        )

    def follow(self, command: MotorMotion, until: float) -> MotorMotion:
        """Motor motion in response to a command, from rest until the time `until` [s]."""
        gain = 2.0 * np.pi * self.bandwidth
        # The delay is a whole number of steps, so that delayed positions are known samples.
        lag = 0 if self.delay == 0.0 else max(1, int(np.ceil(self.delay / _SAMPLE_INTERVAL)))
        step = self.delay / lag if lag else min(_SAMPLE_INTERVAL, 0.02 / self.bandwidth)
        count = int(np.ceil(until / step)) + 1
        # At whole and half steps; before the start command and motor rest at the first position.
        times = 0.5 * step * np.arange(2 * count + 1)
        late = np.clip(times - self.delay, 0.0, None)
        wanted = command.position(late)
        speeds = command(late, 1)
        speeds[times < self.delay] = 0.0
        drive = self.feed_forward * speeds + gain * wanted
        position, velocity = (
            np.empty((count + 1, len(wanted[0]))),
            np.empty_like(drive[: count + 1]),
        )
        position[0] = wanted[0]
        if not lag:
            velocity[0] = drive[0] - gain * position[0]
            for k in range(count):
                x, mid = position[k], drive[2 * k + 1]
                a = velocity[k]
                b = mid - gain * (x + 0.5 * step * a)
                c = mid - gain * (x + 0.5 * step * b)
                d = drive[2 * k + 2] - gain * (x + step * c)
                position[k + 1] = x + step / 6.0 * (a + 2.0 * b + 2.0 * c + d)
                velocity[k + 1] = drive[2 * k + 2] - gain * position[k + 1]
        else:
            velocity[0] = drive[0] - gain * position[0]
            for k in range(count):
                # The delayed error is known: Simpson's rule with the Hermite cubic at its middle.
                begin, end = k - lag, k + 1 - lag
                old = position[max(end, 0)]
                middle = position[0]
                if begin >= 0:
                    middle = 0.5 * (position[begin] + position[end]) + step / 8.0 * (
                        velocity[begin] - velocity[end]
                    )
                half = drive[2 * k + 1] - gain * middle
                velocity[k + 1] = drive[2 * k + 2] - gain * old
                position[k + 1] = position[k] + step / 6.0 * (
                    velocity[k] + 4.0 * half + velocity[k + 1]
                )
        return MotorMotion(step * np.arange(count + 1), position, velocity, command.duration)
