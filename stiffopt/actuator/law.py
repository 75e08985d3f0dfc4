"""Law of an actuator that follows commanded positions: torque [N m] from error [rad] and speed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

# Relative standard deviation of a gain that nobody states, and that no recording tells.
UNSTATED_GAIN_DEVIATION = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class ActuatorLaw:
    """Torque of position-controlled joints, clip(clip(k e, drive) - d v, torque).

    Every kind of actuator of the package is this law with its own constants: of a position servo k
    and d are its P and D gains, of a cascade the product of its gains and the velocity gain, of a
    voltage-limited motor the torque per volt times the gain, and the back-EMF.
    """

    stiffness: np.ndarray  # (n,) torque per position error [N m/rad]; nan where it is not known
    damping: np.ndarray  # (n,) torque per velocity [N m s/rad]; 0 where it is not stated
    # (n,) bound on the part from the error, as of a motor's voltage; infinite without [N m].
    drive_max: np.ndarray
    torque_max: np.ndarray  # (n,) bound on the torque; infinite without [N m]
    delay: float  # time from a command to the torque that follows it [s]; nan where it is not known
    integral: np.ndarray  # (n,) integral over proportional gain [1/s]
    tolerance: np.ndarray  # (n,) one standard deviation of each gain, relative
    delay_deviation: float = 0.0  # one standard deviation of the delay [s]; 0 where it is stated
    # (n,) gains that a recording told, not its description; default none. From a deviation of
    # `UNSTATED_GAIN_DEVIATION` they are mere guesses, which hold a simulated joint but give torque
    # no scale.
    estimated: np.ndarray | None = None
    damping_stated: bool = True  # otherwise it counts as viscous friction of the joints

    @property
    def known(self) -> bool:
        """Return whether delay and all gains are known."""
        return bool(np.isfinite(self.stiffness).all() and np.isfinite(self.delay))

    @property
    def scaled(self) -> np.ndarray:
        """Return the joints (n,) whose gain gives torque its scale."""
        guessed = np.zeros(len(self.stiffness), bool) if self.estimated is None else self.estimated
        loose = guessed & (self.tolerance >= UNSTATED_GAIN_DEVIATION)
        return np.asarray(np.isfinite(self.stiffness) & ~loose)

    @property
    def stated_tolerance(self) -> np.ndarray:
        """Return one standard deviation (n,) of each gain before any recording, relative."""
        if self.estimated is None:
            return self.tolerance
        return np.where(self.estimated, UNSTATED_GAIN_DEVIATION, self.tolerance)

    def reordered(self, order: Sequence[int] | np.ndarray) -> ActuatorLaw:
        """Return the law of the joints in another order."""
        names = ("stiffness", "damping", "drive_max", "torque_max", "tolerance", "estimated",
                 "integral")  # fmt: skip
        own = {name: getattr(self, name) for name in names}
        return replace(self, **{k: each[order] for k, each in own.items() if each is not None})

    def torque(self, error: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Torque at a position error and a velocity: (..., n) [rad], [rad/s] -> (..., n) [N m].

        nan where the gain gives it no scale.
        """
        stiffness = np.where(self.scaled, self.stiffness, np.nan)
        drive = np.clip(stiffness * error, -self.drive_max, self.drive_max)
        whole = drive - self.damping * velocity
        return np.asarray(np.clip(whole, -self.torque_max, self.torque_max))


def mean_command(
    time: np.ndarray, command: np.ndarray, begin: np.ndarray, end: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return means of held commands over intervals (m, n), and their rate per time [rad/s].

    Each of `command` (K, n) [rad] holds from its `time` (K,) [s] until the next one. Means over the
    intervals `begin` to `end` (m,) [s] change continuously with a delay, which the command itself
    does not.
    """
    area = np.cumsum(command[:-1] * np.diff(time)[:, None], axis=0)
    area = np.vstack([np.zeros(command.shape[1]), area])

    def integrate(until: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        place = np.clip(np.searchsorted(time, until, side="right") - 1, 0, len(time) - 1)
        return area[place] + command[place] * (until - time[place])[:, None], command[place]

    (first, held), (last, holds) = integrate(begin), integrate(end)
    span = (end - begin)[:, None]
    return (last - first) / span, (holds - held) / span
