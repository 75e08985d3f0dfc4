"""Commands that lead a motion of the links: by its wind-up, the servo's lag and a process force."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import scipy

from stiffopt.certificate.assess import joint_windup
from stiffopt.certificate.rigid_body import rigid_body_history
from stiffopt.elastic.smooth_motion import smooth_motion
from stiffopt.result.trajectory import ForceHistory, JointMotion, Trajectory

if TYPE_CHECKING:
    from stiffopt.elastic.servo import Servo
    from stiffopt.robot.robot import Robot

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


# Step at which the lead is computed, and knot spacing of its spline [s]: kinks of the stiffness,
# which a force passes, must not bend the command between two rows of its file.
_SAMPLE_STEP, _KNOT_SPACING = 2e-3, 2e-2


def force_lead(robot: Robot, plan: JointMotion, force: ForceHistory) -> Trajectory:
    """Return the additional wind-up under the process force, by which the motors lead."""
    time = np.linspace(0.0, plan.duration, max(50, int(np.ceil(plan.duration / _SAMPLE_STEP))) + 1)
    body = rigid_body_history(robot, *(np.asarray(plan(time, k)) for k in range(3)))
    pushed = np.einsum("kij,ki->kj", body.jacobian, force(time))
    turned = joint_windup(robot, body.link_torque - pushed) - joint_windup(robot, body.link_torque)
    return smooth_motion(_Samples(time, turned), _KNOT_SPACING)


def led_against_force(motors: Trajectory, lead: Trajectory, force: ForceHistory) -> Trajectory:
    """Return motors that lead by a further wind-up, with links under the force."""
    link = motors.link or motors
    added = motors.plus(lead.held_for(motors.duration - lead.duration))
    return replace(added, link=replace(link, force=force))


class _Samples:
    """Motion through samples."""

    def __init__(self, time: np.ndarray, values: np.ndarray) -> None:
        self.duration = float(time[-1])
        self._spline = scipy.interpolate.CubicSpline(time, values, bc_type="clamped")

    def __call__(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        return np.asarray(self._spline(t, order))
