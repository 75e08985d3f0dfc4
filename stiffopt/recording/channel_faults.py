"""Faults of the channels of one joint: faulty samples or channels are reported and removed.

Order of the checks: samples that are no numbers, angles that wrap, constant channels, channels that
contradict the motor encoder, stuck intervals, spikes, saturation, coarse quantisation. Only
unphysical values are removed; saturated and coarse ones are kept.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from stiffopt.recording.channel import (
    find_saturated_samples,
    find_spikes,
    find_stuck_samples,
    is_held_by_friction,
    resolution,
    true_intervals,
)
from stiffopt.recording.run import Fault, FaultKind, counted
from stiffopt.recording.signals import Kind

# Travel below which a joint is stationary: revolute [rad], prismatic [m].
_MIN_TRAVEL = (1e-3, 1e-4)
# Travel over that one from which a joint moves enough to compare its sensors.
_MOVED_RATIO = 10.0
# Slope and correlation between two sensors of one motion that do not contradict each other.
_SLOPE_RANGE = (0.8, 1.25)
MIN_CORRELATION = 0.8
_ANGLE_SIGNALS: tuple[Kind, ...] = ("position", "link_position")
_SECOND_SENSORS: tuple[Kind, ...] = ("velocity", "link_position")
# Jumps below this share of a channel's range are harmless; clock jitter causes such too.
_HARMLESS_JUMP_SHARES = {"position": 2e-4, "link_position": 2e-4, "velocity": 5e-3, "torque": 5e-3}
# Deviation of a wrap from a whole turn [turns], by the motion within a sample time.
_WRAP_TOLERANCE = 0.1
# Levels within the range of a channel below which it is reported as coarse.
_MIN_FINE_LEVELS = 500
# Share of faulty samples above which the whole channel is removed.
_MAX_BAD_SHARE = 0.5
# Counts of motion that an encoder misses where it is stuck.
_MIN_STUCK_COUNTS = 20.0
# Window over which changes of two sensors are compared [s].
_CHANGE_WINDOW = 0.2
# Range of a random walk over the standard deviation of its end, sqrt(8 / pi), and the multiple of
# that of its noise from which an integrated velocity is a travel.
_RANDOM_WALK_RANGE, _MIN_TRAVEL_RATIO = 1.6, 3.0


@dataclass
class JointChannels:
    """Channels of one joint during the checks; faulty samples become NaN."""

    joint: int
    time: np.ndarray
    channels: dict[Kind, np.ndarray]
    prismatic: bool = False
    faults: list[Fault] = field(default_factory=list)

    @property
    def unit(self) -> str:
        """Unit of the position."""
        return "m" if self.prismatic else "rad"

    @property
    def still(self) -> float:
        """Travel below which the joint is stationary [rad]."""
        return _MIN_TRAVEL[self.prismatic]

    @property
    def moved(self) -> float:
        """Travel from which the joint moves [rad]."""
        return moved_travel(self.prismatic)

    def report(
        self,
        signal: Kind,
        kind: FaultKind,
        detail: str,
        bad: np.ndarray | None = None,
        keep: bool = False,
        ratio: float | None = None,
    ) -> None:
        """Add a fault; `bad` (K,) marks its samples, None the whole channel."""
        values = self.channels[signal]
        share = 1.0 if bad is None else float(bad.mean())
        left_out = not keep and (bad is None or share > _MAX_BAD_SHARE)
        if not keep:
            values[slice(None) if left_out or bad is None else bad] = np.nan
        ending = " Left out." if left_out else "" if keep else " These samples are left out."
        self.faults.append(
            Fault(
                signal=signal,
                joint=self.joint + 1,
                kind=kind,
                detail=detail + ending,
                left_out=left_out,
                share=share,
                ratio=ratio,
            )
        )

    def usable(self, signal: Kind) -> np.ndarray | None:
        """Return a channel, None if it is absent or was removed."""
        values = self.channels.get(signal)
        return values if values is not None and np.isfinite(values).any() else None


def check_joint_channels(joint: JointChannels) -> list[Fault]:
    """Run all checks; faulty samples are removed in place."""
    for signal in joint.channels:
        _check_finite(joint, signal)
    for signal in _ANGLE_SIGNALS:
        _check_wrapping(joint, signal)
    _check_constant(joint)
    for signal in _SECOND_SENSORS:
        _check_agreement(joint, signal)
    for signal in joint.channels:
        _check_stuck(joint, signal)
        _check_spikes(joint, signal)
    _check_saturation(joint)
    for signal in joint.channels:
        _check_quantisation(joint, signal)
    return joint.faults


def moved_travel(prismatic: bool) -> float:
    """Return the travel from which a joint moves: revolute [rad], prismatic [m]."""
    return _MOVED_RATIO * _MIN_TRAVEL[bool(prismatic)]


def covered_range(values: np.ndarray | None) -> float:
    """Range of a channel, 0 if it is absent."""
    if values is None or not np.isfinite(values).any():
        return 0.0
    return float(np.nanmax(values) - np.nanmin(values))


def _check_finite(joint: JointChannels, signal: Kind) -> None:
    bad = ~np.isfinite(joint.channels[signal])
    joint.channels[signal][bad] = np.nan
    if bad.all():
        joint.report(signal, "not finite", "no sample is a number.")
    elif bad.any():
        joint.report(
            signal, "not finite", f"no number at {counted(int(bad.sum()), 'sample')}.", bad
        )


def _check_wrapping(joint: JointChannels, signal: Kind) -> None:
    """Unwrap an angle that the logger keeps within one turn."""
    values = joint.usable(signal)
    if values is None or joint.prismatic:
        return
    there = np.flatnonzero(np.isfinite(values))
    turns = np.diff(values[there]) / (2.0 * np.pi)
    jumps = np.abs(turns) > 0.5
    # Other jumps of this size do not come from wrapping.
    if not jumps.any() or (np.abs(np.abs(turns[jumps]) - 1.0) > _WRAP_TOLERANCE).any():
        return
    values[there[1:]] -= 2.0 * np.pi * np.cumsum(np.round(turns))
    marked = np.zeros(len(values), dtype=bool)
    marked[there[1:][jumps]] = True
    text = f"jumps by a whole turn {counted(int(jumps.sum()), 'time')}; made continuous."
    joint.report(signal, "wrapped", text, marked, keep=True)


def _check_constant(joint: JointChannels) -> None:
    position, link = joint.usable("position"), joint.usable("link_position")
    velocity, torque = joint.usable("velocity"), joint.usable("torque")
    by_velocity = 0.0 if velocity is None else _integrated_travel(velocity, joint.time)
    by_other = max(covered_range(link), by_velocity)
    if position is not None and covered_range(position) == 0.0 and by_other > joint.moved:
        joint.report(
            "position",
            "constant",
            f"stays at {position[0]:g} {joint.unit} while other sensors of the joint travel "
            f"{by_other:.3g} {joint.unit}.",
        )
    moved = max(covered_range(position), by_other)
    if torque is not None and covered_range(torque) == 0.0:
        joint.report(
            "torque",
            "constant",
            f"stays at {np.nanmax(torque):g} in the whole run: not connected, or not recorded.",
        )
    second: tuple[tuple[Kind, np.ndarray | None], ...] = (
        ("velocity", velocity),
        ("link_position", link),
    )
    for signal, values in second:
        if values is None or covered_range(values) != 0.0:
            continue
        level = float(np.nanmax(values))
        # A constant zero is an empty column, also where the joint is stationary.
        empty = signal == "link_position" and level == 0.0
        if moved > joint.still or empty:
            joint.report(
                signal,
                "constant",
                f"stays at {level:g} in the whole run while the joint travels {moved:.3g} "
                f"{joint.unit}.",
            )


def _check_agreement(joint: JointChannels, signal: Kind) -> None:
    position, values = joint.usable("position"), joint.usable(signal)
    if position is None or values is None or covered_range(position) < joint.moved:
        return
    if signal == "velocity":
        slope, correlation = compare_velocity(values, position, joint.time)
    else:
        slope, correlation = regress_changes(position, values, joint.time)
    if _SLOPE_RANGE[0] <= slope <= _SLOPE_RANGE[1] and correlation > MIN_CORRELATION:
        return
    if not correlation > MIN_CORRELATION:
        hint = (
            "the other way round"
            if correlation < -MIN_CORRELATION
            else "or belongs to another joint"
        )
        text = f"does not follow the motor encoder (correlation {correlation:.2f}), {hint}."
    else:
        degrees = abs(slope * np.pi / 180.0 - 1.0) < 0.1
        hint = ", as degrees would" if degrees else ""
        text = f"changes {slope:.3g} times as much as the motor encoder{hint}."
    # Runs too short to compare have a ratio of NaN.
    known = np.isnan(correlation) or abs(correlation) > MIN_CORRELATION
    joint.report(signal, "contradicts position", text, ratio=slope if known else None)


def _check_stuck(joint: JointChannels, signal: Kind) -> None:
    values = joint.usable(signal)
    if values is None or signal == "velocity":
        return
    other = joint.usable("link_position" if signal == "position" else "position")
    if other is None:
        return
    least, step = joint.still, resolution(values) or 0.0
    if signal != "torque":
        least = max(least, _MIN_STUCK_COUNTS * step)
    bad = find_stuck_samples(values, other, least, step)
    if signal == "torque":
        bad &= ~find_saturated_samples(values, step)
    if signal == "position":
        for begin, end in true_intervals(bad):
            bad[begin:end] = not is_held_by_friction(values, other, begin, end)
    if bad.any():
        found = true_intervals(bad)
        longest = max(joint.time[end - 1] - joint.time[begin] for begin, end in found)
        joint.report(
            signal,
            "constant",
            f"is stuck {counted(len(found), 'time')} while the joint moves, "
            f"longest {longest:.3g} s.",
            bad,
        )


def _check_spikes(joint: JointChannels, signal: Kind) -> None:
    values = joint.usable(signal)
    if values is None:
        return
    if signal == "velocity" and covered_range(joint.usable("position")) < joint.moved:
        return
    bad, size = find_spikes(
        values, resolution(values) or 0.0, _HARMLESS_JUMP_SHARES[signal] * covered_range(values)
    )
    if bad.any():
        joint.report(
            signal,
            "outlier",
            f"jumps away and back at {counted(int(bad.sum()), 'sample')}, by up to {size:.3g}.",
            bad,
        )


def _check_saturation(joint: JointChannels) -> None:
    torque = joint.usable("torque")
    if torque is None:
        return
    bad = find_saturated_samples(torque, resolution(torque) or 0.0)
    if bad.any():
        joint.report(
            "torque",
            "saturated",
            f"rests on its largest values {np.nanmin(torque):.4g} or {np.nanmax(torque):.4g} for "
            f"{counted(int(bad.sum()), 'sample')}: the drive or the sensor is at its limit. Kept.",
            bad,
            keep=True,
        )


def _check_quantisation(joint: JointChannels, signal: Kind) -> None:
    values = joint.usable(signal)
    if values is None or covered_range(joint.usable("position")) < joint.moved:
        return
    step = resolution(values)
    if step is not None and covered_range(values) < _MIN_FINE_LEVELS * step:
        joint.report(
            signal,
            "quantised",
            f"has only {round(covered_range(values) / step) + 1} levels, steps of {step:.3g}. "
            "Kept.",
            np.isfinite(values),
            keep=True,
        )


def _integrated_travel(velocity: np.ndarray, time: np.ndarray) -> float:
    """Return the range that a velocity integrates to beyond its offset and noise; 0 for none."""
    known = velocity[np.isfinite(velocity)]
    travel = covered_range(integrate_velocity(velocity - known.mean(), time))
    # Neighbouring samples of a motion are alike, those of noise are not.
    noise = float(np.std(np.diff(known))) / np.sqrt(2.0) * float(np.linalg.norm(np.diff(time)))
    return travel if travel > _MIN_TRAVEL_RATIO * _RANDOM_WALK_RANGE * noise else 0.0


def compare_velocity(
    velocity: np.ndarray, position: np.ndarray, time: np.ndarray
) -> tuple[float, float]:
    """Return slope and correlation of an integrated velocity with a position, as of changes.

    Its offset, which it has where the position rests, is no contradiction.
    """
    lag = _samples_per_window(time)
    # Changes up to each sample: none within a window is rest.
    changes = np.cumsum(np.diff(position, prepend=position[:1]) != 0.0)
    rests = np.isfinite(velocity)
    rests[:lag] = False
    rests[lag:] &= changes[lag:] == changes[:-lag]
    offset = float(velocity[rests].mean()) if rests.any() else 0.0
    return regress_changes(position, integrate_velocity(velocity - offset, time), time)


def _samples_per_window(time: np.ndarray) -> int:
    return max(1, round(_CHANGE_WINDOW / float(np.median(np.diff(time)))))


def regress_changes(
    reference: np.ndarray, channel: np.ndarray, time: np.ndarray
) -> tuple[float, float]:
    """Return slope and correlation of changes over a window with those of a reference.

    Through the origin; NaN where nothing changes.
    """
    lag = _samples_per_window(time)
    if len(time) <= 2 * lag:
        return float("nan"), float("nan")
    within = time[lag:] - time[:-lag] < 1.5 * _CHANGE_WINDOW
    one = (reference[lag:] - reference[:-lag])[within]
    two = (channel[lag:] - channel[:-lag])[within]
    good = np.isfinite(one) & np.isfinite(two)
    one, two = one[good], two[good]
    power, other = float(one @ one), float(two @ two)
    if power == 0.0 or other == 0.0:
        return float("nan"), float("nan")
    return float(one @ two) / power, float(one @ two) / float(np.sqrt(power * other))


def integrate_velocity(velocity: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Trapezoidal integral of a velocity: (K,) [rad/s] -> (K,) [rad]."""
    filled = np.where(np.isfinite(velocity), velocity, 0.0)
    steps = 0.5 * (filled[1:] + filled[:-1]) * np.diff(time)
    return np.concatenate(([0.0], np.cumsum(steps)))
