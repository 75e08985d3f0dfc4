"""Commands that lead a motion of the links by shares of its wind-up and of the servo's lag."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.result.trajectory import JointMotion, Trajectory

if TYPE_CHECKING:
    from stiffopt.elastic.servo import Servo

# Least and largest share of the nominal wind-up: its mean over uncertain stiffness is above it.
WINDUP_SHARES = (1.0, 1.1)


@dataclass(frozen=True, eq=False)
class ExistingCommand:
    """Command of the motors, made or of an earlier solve."""

    motors: JointMotion  # motion of the motors, with that of the links as its `link`
    spacing: float | None  # as of `CompensatedMotion`
    share: float
    servo_share: float = 1.0


@dataclass(frozen=True, eq=False)
class CommandLead:
    """Smooth motion of the links and the motors that lead it.

    Commands are linear in the share of the wind-up, and in that of the servo's lag.
    """

    link: Trajectory
    motors: Trajectory  # with all of the nominal wind-up
    spacing: float | None
    servo: Servo  # whose known lag the command leads

    def command(self, share: float, servo_share: float) -> ExistingCommand:
        """Return the command with shares of the wind-up and of the servo's lag."""
        if self.servo.leads_exactly:
            servo_share = 1.0
        if self.servo.leads_exactly or servo_share == 0.0:
            motors = self._behind(share)
        else:
            motors = self._ahead(share)
            if servo_share < 1.0:
                held = self._held(self._behind(share))
                motors = _mixed(held, motors, servo_share, motors.link or held)
        return ExistingCommand(motors, self.spacing, share, servo_share)

    @functools.cached_property
    def corners(self) -> tuple[Trajectory, ...]:
        """Commands of one duration, of which all others are weighted sums.

        Least and largest share of the wind-up without the servo's lag, then with all of it.
        """
        behind = tuple(map(self._behind, WINDUP_SHARES))
        if self.servo.leads_exactly:
            return behind
        return (*map(self._held, behind), *map(self._ahead, WINDUP_SHARES))

    def weights(self, share: float, servo_share: float) -> np.ndarray:
        """Return the weights of the corners (2,) or (4,) in the command with some shares."""
        least, largest = WINDUP_SHARES
        further = (share - least) / (largest - least)
        own = np.array([1.0 - further, further])
        if self.servo.leads_exactly:
            return own
        return np.concatenate([(1.0 - servo_share) * own, servo_share * own])

    def _behind(self, share: float) -> Trajectory:
        """Return the motors with a share of the wind-up, without the servo's lag."""
        return _mixed(self.link, self.motors, share, self.link)

    def _ahead(self, share: float) -> Trajectory:
        """Return the motors with a share of the wind-up and all of the servo's lag."""
        link, ahead = self._ahead_of_servo
        return _mixed(link, ahead, share, ahead.link or link)

    @functools.cached_property
    def _ahead_of_servo(self) -> tuple[Trajectory, Trajectory]:
        """Links and motors ahead by the servo's lag, which is linear in them; of one duration."""
        found = [self.servo.lead(each) for each in (self.link, self.motors)]
        end = max(each.duration for each in found)
        link, motors = (each.held_for(end - each.duration) for each in found)
        held = self.link.held_for(end - self.link.duration)
        return link, replace(motors, link=held)

    def _held(self, motors: Trajectory) -> Trajectory:
        """Return motors that rest until commands that lead the servo end."""
        _, ahead = self._ahead_of_servo
        return replace(motors.held_for(ahead.duration - motors.duration), link=ahead.link)


def _mixed(begin: Trajectory, end: Trajectory, share: float, carried: Trajectory) -> Trajectory:
    """Return the motion at a share of the way between two, with `carried` as its links."""
    if share == 1.0:
        return end
    times = end.times
    derivatives = [(1.0 - share) * begin(times, k) + share * end(times, k) for k in range(4)]
    return Trajectory.through(times, np.stack(derivatives), carried)
