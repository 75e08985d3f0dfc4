"""Servo: cascaded position and velocity loops of the motors, sampled set-points and dead time.

The controller sends set-points at its rate; the drive interpolates between them by cubics, for
which it waits one period. With y the set-point as it reaches the drive, x the motor, g = 2 pi
bandwidth of the position loop and w the bandwidth of the velocity loop:

    x'' = w (a y' + g (y - x(t - delay)) - x') + b y''

with the shares a and b of velocity and torque fed forward. Known lag and dead time are led by the
command (`Servo.lead`); set-points are sent by the known dead time earlier. The load's reaction on
the motors is neglected.

Source of the cascade and of w = 5 g: Gross, Hamann, Wiegaertner (2001), "Electrical feed drives in
automation", Publicis.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import scipy

from stiffopt.declaration import NOT_NEGATIVE, POSITIVE, Bounds, Doc, Frequency, Ratio, Time
from stiffopt.elastic.motor import SAMPLE_INTERVAL, MotorMotion
from stiffopt.errors import InputError
from stiffopt.result.trajectory import Trajectory


@dataclass(frozen=True, kw_only=True)
class ServoKind:
    """Typical values of a kind of controller."""

    bandwidth: float  # of the position loop [Hz]
    # Shares of the commanded velocity and of the torque of the commanded acceleration.
    feed_forward: float = 1.0
    torque_feed_forward: float
    delay: float = 0.0  # dead time of the loop [s]
    rate: float | None  # of the set-points [Hz]; None for continuous ones
    source: str  # of the rate


# Typical values by kind of controller. Rates are those of the controllers' interfaces. Bandwidths,
# feed-forward shares and loop delays are not published; they are assumed within the ranges that
# identified drives have: 8 to 40 Hz, 0.9 to 1, 1 to 8 ms.
SERVO_KINDS = {
    "ideal": ServoKind(
        bandwidth=20.0,
        torque_feed_forward=1.0,
        rate=None,
        source="Follows exactly.",
    ),
    "industrial": ServoKind(
        bandwidth=20.0,
        torque_feed_forward=0.9,
        rate=250.0,
        source="KUKA.RobotSensorInterface: 4 ms cycle.",
    ),
    "collaborative": ServoKind(
        bandwidth=15.0,
        torque_feed_forward=0.9,
        rate=500.0,
        source="Universal Robots e-Series, The URScript Programming Language: 2 ms cycle.",
    ),
    "research": ServoKind(
        bandwidth=40.0,
        torque_feed_forward=0.95,
        rate=1000.0,
        source="Franka Control Interface: 1 ms cycle.",
    ),
    "cb_series": ServoKind(
        bandwidth=15.0,
        torque_feed_forward=0.8,
        rate=125.0,
        source="Universal Robots CB-Series, The URScript Programming Language: 8 ms cycle.",
    ),
}


# Bandwidth of the velocity loop over that of the position loop.
_VELOCITY_LOOP_RATIO = 5.0
# Shares below which the inverse of the servo, by which a command leads, rings or leaves a pole
# faster than the samples.
_MIN_LED_TORQUE_SHARE, _MIN_LED_VELOCITY_SHARE = 0.02, 0.1
# Time after the plan's end in which the lead decays, over the time constant of the position loop.
_LEAD_DECAY_CONSTANTS = 14.0
# Lead [rad] and its rate [rad/s] at which a command ends.
MAX_LEAD_AT_END = (1e-8, 5e-7)
_COMMAND_STRIDE = 4  # steps between the breaks of a leading command
_STEPS_AT_ONCE = 8192  # of the servo's response and its inverse; whole strides


@dataclass(frozen=True)
class Servo:
    """Position loop of the motors, the same for every joint.

    Keys that are left out have the typical values of the kind of controller.
    """

    bandwidth: Annotated[Frequency | None, POSITIVE, Doc("Bandwidth of the position loop.")] = None
    feed_forward: Annotated[
        Ratio | None,
        Bounds(least=0.0, most=1.0),
        Doc("Share of the commanded velocity that is fed forward."),
    ] = None
    delay: Annotated[Time | None, NOT_NEGATIVE, Doc("Dead time of the loop.")] = None
    torque_feed_forward: Annotated[
        Ratio | None,
        Bounds(least=0.0, most=1.0),
        Doc("Share of the torque of the commanded acceleration that is fed forward."),
    ] = None
    rate: Annotated[
        Frequency | None, POSITIVE, Doc("Rate of the set-points; default that of the kind.")
    ] = None
    kind: Annotated[
        Literal["ideal", "industrial", "collaborative", "research", "cb_series"],
        Doc("Kind of controller, whose typical values stand for keys that are left out."),
    ] = "ideal"

    def __post_init__(self) -> None:
        for name, value in vars(SERVO_KINDS[self.kind]).items():
            if name != "source" and getattr(self, name) is None:
                object.__setattr__(self, name, value)
        gain, forward, delay, torque = self._numbers
        if not (np.isfinite(gain) and gain > 0.0):
            raise InputError(f"the servo's bandwidth must be above 0 Hz, got {self.bandwidth:g}.")
        for share, name in ((forward, "velocity"), (torque, "torque")):
            if not 0.0 <= share <= 1.0:
                raise InputError(
                    f"the servo's {name} feed-forward is a share from 0 to 1, got {share:g}."
                )
        if not (np.isfinite(delay) and delay >= 0.0):
            raise InputError(f"the servo's delay must be 0 s or above, got {delay:g}.")
        largest = self._largest_stable_delay()
        if delay >= largest:
            raise InputError(
                f"the servo is unstable: a position loop of {self.bandwidth:g} Hz needs a delay "
                f"below {1e3 * largest:.4g} ms, and has {1e3 * delay:.4g} ms. Lower the "
                "bandwidth or the delay."
            )

    @property
    def _numbers(self) -> tuple[float, float, float, float]:
        """Gain of the position loop [1/s], velocity share, delay [s] and torque share."""
        found = (self.bandwidth, self.feed_forward, self.delay, self.torque_feed_forward)
        gain, forward, delay, torque = (math.nan if x is None else x for x in found)
        return 2.0 * np.pi * gain, forward, delay, torque

    def _largest_stable_delay(self) -> float:
        gain, ratio = self._numbers[0], _VELOCITY_LOOP_RATIO
        # Frequency w at which the open loop g r / (s (s + r)) has unit magnitude, r = ratio g.
        crossing = gain * ratio * math.sqrt(0.5 * math.sqrt(1.0 + 4.0 / ratio**2) - 0.5)
        return (0.5 * math.pi - math.atan(crossing / (ratio * gain))) / crossing

    @property
    def period(self) -> float:
        """Period of the set-points [s]; 0 where they are continuous."""
        return 0.0 if self.rate is None else 1.0 / self.rate

    @property
    def dead_time(self) -> float:
        """Time from sending a set-point until the motor moves [s]."""
        return self._numbers[2] + self.period

    @property
    def follows_exactly(self) -> bool:
        """True with full feed-forward and without delay and sampling."""
        return self.leads_exactly and self.period == 0.0

    @property
    def leads_exactly(self) -> bool:
        """True where the motor follows the set-points but for the dead time of sampling."""
        return self._numbers[1:] == (1.0, 0.0, 1.0)

    def __str__(self) -> str:
        _, forward, delay, torque = self._numbers
        late = f" and {1e3 * delay:g} ms delay" if delay else ""
        sampled = "" if self.rate is None else f", set-points at {self.rate:g} Hz"
        shares = f"{100.0 * forward:.3g} % velocity"
        shares += "" if torque == 1.0 else f" and {100.0 * torque:.3g} % torque"
        return f"{self.bandwidth:g} Hz with {shares} feed-forward{late}{sampled}"

    def transfer(self, s: np.ndarray) -> np.ndarray:
        """Transfer function from set-points, sent the dead time ahead, to the motor at s [1/s]."""
        gain, forward, delay, torque = self._numbers
        inner, late = _VELOCITY_LOOP_RATIO * gain, np.exp(-delay * s)
        led = torque * s**2 + inner * forward * s + inner * gain
        return np.asarray(late * led / (s**2 + inner * s + inner * gain * late))

    def follow(self, command: MotorMotion, until: float, ahead: float = 0.0) -> MotorMotion:
        """Motor motion in response to a command, from rest until the time `until` [s].

        The command is sent `ahead` [s] of the time of the result.
        """
        if self.follows_exactly and ahead == 0.0:
            return command
        gain, forward, delay, torque = self._numbers
        inner = _VELOCITY_LOOP_RATIO * gain
        # The delay is a whole number of steps, so that delayed positions are known samples.
        lag = 0 if delay == 0.0 else max(1, int(np.ceil(delay / SAMPLE_INTERVAL)))
        step = delay / lag if lag else min(SAMPLE_INTERVAL, 0.02 / gain)
        times, command = step * np.arange(int(np.ceil(until / step)) + 1), self._as_sent(command)
        step_state, first, second = _linear_hold(0.0 if lag else inner * gain, inner, step)
        motion = np.empty((2, len(times), len(command(0.0))))
        known = np.zeros((1, *motion.shape[::2]))
        # Whole delays at a time: all samples of a motion of minutes would take a gigabyte.
        size, last = _STEPS_AT_ONCE // (lag or 1) * (lag or 1) or lag, len(times) - 1
        for begin in range(0, last, size):
            stop, start = min(begin + size, last), max(begin - lag, 0)
            y, rate, bend = _set_points(command, times[start : stop + 1] + ahead - self.dead_time)
            before = y[np.maximum(np.arange(begin, stop + 1) - lag, 0) - start]
            y, rate, bend = (each[begin - start :] for each in (y, rate, bend))
            # Of the lag x - y; the loop's own delayed part is added in the loop below.
            force = -(1.0 - torque) * bend - inner * (1.0 - forward) * rate
            force += inner * gain * (y - before)
            state = np.concatenate([known, np.empty((stop - begin, *known.shape[1:]))])
            # Until the delay has passed, delayed positions are those of steps before.
            for k in range(begin, stop, lag or size):
                own = np.arange(k, min(k + (lag or size), stop) + 1)
                pull = force[own - begin]
                if lag:
                    pull -= inner * gain * state[np.maximum(own - lag, 0) - start, 0]
                driven = first * pull[:-1, None] + second * pull[1:, None]
                state[own[1:] - start] = _recur_linearly(step_state, driven, state[k - start])
            motion[:, begin : stop + 1] = y, rate
            motion[:, begin : stop + 1] += state[begin - start :].swapaxes(0, 1)
            known = state[-lag - 1 :]
        return MotorMotion(times, motion[0], motion[1], command.duration)

    def _as_sent(self, command: MotorMotion) -> MotorMotion:
        """Command through the set-points that are sent."""
        if not self.period:
            return command
        grid = self.period * np.arange(int(np.ceil(command.time[-1] / self.period)) + 2)
        return MotorMotion(grid, command(grid), command(grid, 1), command.duration)

    def lead(self, motors: Trajectory) -> Trajectory:
        """Command by which the motors move as planned; it is sent the dead time ahead.

        The inverse of the loops' response; its link motion is that of `motors`, held to its end.
        """
        if self.leads_exactly:
            return motors
        gain, forward, delay, torque = self._numbers
        inner = _VELOCITY_LOOP_RATIO * gain
        forward = max(forward, _MIN_LED_VELOCITY_SHARE)
        torque = max(torque, _MIN_LED_TORQUE_SHARE)
        decay = _LEAD_DECAY_CONSTANTS * max(forward / gain, 1.0 / inner) + delay
        count = int(np.ceil((motors.duration + decay) / (_COMMAND_STRIDE * SAMPLE_INTERVAL)))
        times = np.linspace(0.0, motors.duration + decay, _COMMAND_STRIDE * count + 1)
        step_state, first, second = _linear_hold(
            inner * gain / torque, inner * forward / torque, float(times[1])
        )
        state, places, last = np.zeros((1, 2, motors.joints)), [], 0
        for begin in range(0, len(times) - 1, _STEPS_AT_ONCE):
            own = times[begin : begin + _STEPS_AT_ONCE + 1]
            plan, late = _hold_at_ends(motors, own, 4), _hold_at_ends(motors, own - delay, 2)
            force, rate = (
                (1.0 - torque) * plan[2 + k]
                + inner * (1.0 - forward) * plan[1 + k]
                + inner * gain * (late[k] - plan[k])
                for k in range(2)
            )
            driven = (first * force[:-1, None] + second * force[1:, None]) / torque
            state = np.concatenate([state[-1:], _recur_linearly(step_state, driven, state[-1])])
            lead = np.stack([state[:, 0], state[:, 1], np.zeros_like(force), np.zeros_like(force)])
            lead[2] = (force - inner * forward * lead[1] - inner * gain * lead[0]) / torque
            lead[3] = (rate - inner * forward * lead[2] - inner * gain * lead[1]) / torque
            # Until the lead has decayed: a jump to the end would have any jerk.
            large = np.abs(lead[:2]) > np.reshape(MAX_LEAD_AT_END, (2, 1, 1))
            late_rows = np.flatnonzero(large.any(axis=(0, 2)) | (own < motors.duration))
            last = begin + int(late_rows[-1]) if late_rows.size else last
            # The last row of a block is the first one of the next.
            places.append((plan + lead)[:, bool(begin) * _COMMAND_STRIDE :: _COMMAND_STRIDE])
        last = min(_COMMAND_STRIDE * -(-(last + 1) // _COMMAND_STRIDE), len(times) - 1)
        link = motors.link or motors
        held = link.held_for(float(times[last]) - link.duration)
        kept = slice(None, last // _COMMAND_STRIDE + 1)
        return Trajectory.through(
            times[::_COMMAND_STRIDE][kept], np.concatenate(places, axis=1)[:, kept], held
        )


def _set_points(command: MotorMotion, sent: np.ndarray) -> list[np.ndarray]:
    """Set-points with two rates (K, n) each at the times since the first one (K,)."""
    found = [command(np.maximum(sent, 0.0), k) for k in range(3)]
    for rates in found[1:]:
        rates[sent < 0.0] = 0.0
    return found


def _hold_at_ends(motion: Trajectory, times: np.ndarray, orders: int) -> np.ndarray:
    """Motion and its rates (orders, K, n), at rest before its start and after its end."""
    inside = np.clip(times, 0.0, motion.duration)
    found = np.stack([motion(inside, k) for k in range(orders)])
    found[1:, (times < 0.0) | (times > motion.duration)] = 0.0
    return found


def _recur_linearly(step: np.ndarray, driven: np.ndarray, begin: np.ndarray) -> np.ndarray:
    """Return the states (K, 2, n) of z[k + 1] = step z[k] + driven[k] after a first one (2, n).

    A triangular system of four diagonals, solved by substitution for all motors at once.
    """
    count, _, motors = driven.shape
    driven = driven.copy()
    driven[0] += step @ begin
    diagonals = np.zeros((4, 2 * count))
    diagonals[0] = 1.0
    diagonals[2, ::2], diagonals[3, ::2] = -step[:, 0]
    diagonals[1, 1::2], diagonals[2, 1::2] = -step[:, 1]
    found, _ = scipy.linalg.lapack.dtbtrs(diagonals, driven.reshape(2 * count, motors), uplo="L")
    return np.asarray(found.reshape(driven.shape))


@functools.lru_cache(maxsize=64)
def _linear_hold(
    stiffness: float, damping: float, step: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Exact step of x'' = f - damping x' - stiffness x, f linear: transition, weights of ends."""
    whole = np.zeros((4, 4))
    whole[0, 1], whole[1, :2] = 1.0, (-stiffness, -damping)
    whole[1, 2], whole[2, 3] = 1.0, 1.0 / step
    found = scipy.linalg.expm(step * whole)
    ramp = found[:2, 3:]
    return found[:2, :2], found[:2, 2:3] - ramp, ramp
