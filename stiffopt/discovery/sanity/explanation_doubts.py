"""Doubts from descriptions of the files that explain their torques better, as text.

Each states the joints, the improvement, and the corrected line of recordings.toml.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from stiffopt.discovery.sanity.doubt import (
    Doubt,
    column_line,
    format_joints,
    format_numbers,
    format_shares,
    scale_line,
)
from stiffopt.discovery.sanity.explanations import UNIT_GAINS, Explanation, Explanations
from stiffopt.discovery.sanity.interpretations import DEGREE, MILLIMETRE, Reading
from stiffopt.discovery.sanity.sensor_doubts import FACTOR_TOLERANCE
from stiffopt.recording.recording_set import RecordingSet

# Range of gear ratios of arms.
_GEAR_RATIO_RANGE = (20.0, 400.0)


def describe_explanation(
    recordings: RecordingSet, search: Explanations, explanation: Explanation
) -> Iterator[Doubt]:
    """Yield the doubts of an explanation: gravity, delay, or units, orders, signs and gains.

    `search`: with residual shares of the stated reading.
    """
    shares = format_shares(search.strict, explanation.left, explanation.joints)
    joints = tuple(j + 1 for j in explanation.joints)
    if explanation.gravity is not None:
        direction = 9.81 * explanation.gravity
        stated = format_numbers(recordings.gravity)
        fit = f"the torques fit gravity along {format_numbers(direction)}"
        if not direction.any():
            fit = "the torques contain no weight, as if a controller added it later"
        yield Doubt(
            kind="gravity",
            joints=joints,
            evidence=f"Gravity is stated as {stated} m/s^2, but {fit}: {shares}.",
            line=f"gravity = {format_numbers(direction)}",
        )
    elif explanation.delay is not None:
        later = "later" if explanation.delay > 0.0 else "earlier"
        yield Doubt(
            kind="delay",
            joints=joints,
            evidence=f"The torques fit the motion if they were recorded"
            f" {1e3 * abs(explanation.delay):.0f} ms {later} than the positions: {shares}.",
            line=f"torque_delay = {explanation.delay:.3f} in [signals]",
        )
    else:
        yield from _doubt_reading(recordings, explanation, shares)
        if explanation.gains is not None:
            yield from _doubt_gains(recordings, explanation, search)


def doubt_degrees(recordings: RecordingSet, search: Explanations, found: Explanation) -> Doubt:
    """Doubt positions stated in degrees that are rad."""
    which = format_joints(found.joints)
    most = np.degrees(np.ptp(search.samples.position[:, list(found.joints)], axis=0).max())
    each = ", ".join(f"{100.0 * found.left[j]:.2g} % at joint {j + 1}" for j in found.joints)
    line = scale_line(recordings, "position", np.array(found.reading.position_scale))
    also = " (and the velocity's likewise)" if recordings.signals.velocity is not None else ""
    return Doubt(
        kind="position unit",
        joints=tuple(j + 1 for j in found.joints),
        evidence=f"The positions of {which} look like rad, not degrees: in degrees they move by"
        f" {most:.2g} deg at most; in rad the residual of the nominal model is {each} of the"
        " torque's variance.",
        line=line + also,
    )


def _doubt_reading(
    recordings: RecordingSet, explanation: Explanation, shares: str
) -> Iterator[Doubt]:
    """Yield doubts about units, swapped columns and signs of a reading."""
    reading, n = explanation.reading, recordings.n
    scale = np.array(reading.position_scale)
    units = {"degrees": ("deg", DEGREE), "mm": ("mm", MILLIMETRE)}
    turned = np.flatnonzero(scale < 0.0)
    if reading.time_scale != 1.0:
        yield Doubt(
            kind="time unit",
            evidence=f"The time looks {1.0 / reading.time_scale:g} times too large for the torques"
            f" of this motion: {shares}.",
            line=f"time = {reading.time_scale:g} in [signals.scale]",
        )
    for unit, (symbol, size) in units.items():
        alike = np.flatnonzero(np.abs(scale) == size)
        if not alike.size:
            continue
        every = alike.size == n
        which = "all joints" if every else format_joints(alike)
        yield Doubt(
            kind="position unit",
            joints=tuple(int(j) + 1 for j in alike),
            evidence=f"The positions of {which} look like {unit}: {shares}.",
            line=scale_line(recordings, "position", np.abs(scale), symbol if every else ""),
        )
    swapped = {
        kind: [j for j, source in enumerate(order) if j != source]
        for kind, order in (("position", reading.position_from), ("torque", reading.torque_from))
    }
    both = reading.position_from == reading.torque_from
    for kind, order in (("position", reading.position_from), ("torque", reading.torque_from)):
        if not swapped[kind] or (both and kind == "torque"):
            continue
        kinds = ("position", "torque") if both else (kind,)
        noun = "positions and torques" if both else f"{kind} columns"
        lines = " and ".join(column_line(recordings, each, order) for each in kinds)
        yield Doubt(
            kind="joint order" if both else f"{kind} order",
            joints=tuple(j + 1 for j in swapped[kind]),
            evidence=f"The {noun} of {format_joints(swapped[kind])} look exchanged: {shares}.",
            line=f"{lines} in [signals]",
        )
    torque_turned = np.flatnonzero(np.array(reading.torque_scale) < 0.0)
    yield from _doubt_zeros(recordings, reading, shares)
    yield from _doubt_sums(recordings, reading, shares)
    if turned.size:
        with_torque = set(turned) == set(torque_turned)
        one = turned.size == 1
        noun = "Position and torque" if with_torque else f"The position{'' if one else 's'}"
        look = "look" if with_torque or not one else "looks"
        lines = scale_line(recordings, "position", np.sign(scale))
        if with_torque:
            lines += " and " + scale_line(recordings, "torque", np.array(reading.torque_scale))
        yield Doubt(
            kind="position sign",
            joints=tuple(int(j) + 1 for j in turned),
            evidence=f"{noun} of {format_joints(turned)} {look} reversed, as about an axis of"
            f" the opposite direction: {shares}.",
            line=lines,
        )
        torque_turned = np.array([] if with_torque else torque_turned, dtype=int)
    if torque_turned.size:
        yield Doubt(
            kind="torque sign",
            joints=tuple(int(j) + 1 for j in torque_turned),
            evidence=f"The torque of {format_joints(torque_turned)} has the other sign: {shares}.",
            line=scale_line(recordings, "torque", np.array(reading.torque_scale)),
        )


def _doubt_zeros(recordings: RecordingSet, reading: Reading, shares: str) -> Iterator[Doubt]:
    """Yield a doubt about zeros of joints in another convention."""
    off = np.flatnonzero(reading.offset)
    if not off.size:
        return
    # The offset is added after the sign is corrected, to one that is stated.
    stated = recordings.signals.offset
    offset = np.array(reading.offset)
    if stated is not None:
        offset = offset + np.sign(reading.position_scale) * stated
    turns = ", ".join(f"{np.degrees(reading.offset[j]):+.0f} degrees" for j in off)
    yield Doubt(
        kind="position zero",
        joints=tuple(int(j) + 1 for j in off),
        evidence=f"The zero of {format_joints(off)} looks like that of another convention, off by"
        f" {turns}: {shares}.",
        line=f"offset = {format_numbers(offset)} in [signals]",
    )


def _doubt_sums(recordings: RecordingSet, reading: Reading, shares: str) -> Iterator[Doubt]:
    """Yield a doubt about positions that are sums of two joints."""
    summed = np.flatnonzero(reading.includes)
    if not summed.size:
        return
    parts = [
        f"joint {j + 1} {'+' if reading.includes[j] > 0 else '-'} joint {abs(reading.includes[j])}"
        f" in place of joint {j + 1} alone"
        for j in summed
    ]
    stated = np.array(recordings.signals.includes or (0,) * recordings.n)
    entries = ", ".join(str(int(x)) for x in np.where(stated == 0, reading.includes, stated))
    yield Doubt(
        kind="position sum",
        joints=tuple(int(j) + 1 for j in summed),
        evidence=f"The positions look like those of {' and '.join(parts)}: {shares}.",
        line=f"position_includes = [{entries}] in [signals]",
    )


def _doubt_gains(
    recordings: RecordingSet, explanation: Explanation, search: Explanations
) -> Iterator[Doubt]:
    """Yield doubts about torque gains, one per joint; one line corrects all.

    Where the torques are in another unit, joints whose factor the motion does not tell stay so.
    """
    before = search.strict
    gains = explanation.gains
    assert gains is not None
    ratio = recordings.nominal.gear_ratio
    factors = np.array([float(f"{1.0 / gain:.3g}") for gain in gains])
    other_unit = recordings.signals.unscaled or any(
        abs(gain) not in UNIT_GAINS and (abs(gain) < 1.0 or not search.torque_scale_known.any())
        for gain in gains
    )
    unknown = (
        (gains == 1.0) & ~search.torque_scale_known if other_unit else np.zeros(len(gains), bool)
    )
    line = scale_line(recordings, "torque", factors, unknown=unknown)
    for j in np.flatnonzero(gains != 1.0):
        slides = bool(recordings.prismatic[j])
        newton = "N" if slides else "N m"
        kind, words = _describe_gain(
            float(gains[j]), None if ratio is None else float(ratio[j]), newton
        )
        if unit := recordings.signals.torque_units[j] if recordings.signals.torque_units else "":
            one = unit.removesuffix("s")
            kind, words = "torque unit", f"has {factors[j]:.3g} {newton} per {one}"
        shares = format_shares(before, explanation.left, [int(j)])
        yield Doubt(
            kind=kind,
            joints=(int(j) + 1,),
            evidence=f"The torque of joint {j + 1} {words}: {shares}.",
            line=line,
        )


def _describe_gain(gain: float, ratio: float | None, newton: str) -> tuple[str, str]:
    size = abs(gain)
    turned = ", and has the other sign" if gain < 0.0 else ""
    if abs(size - 1.0) < FACTOR_TOLERANCE and gain < 0.0:
        return "torque sign", "has the other sign"
    for factor, prefix in ((1e3, "m"), (1e-3, "k")):
        if abs(size / factor - 1.0) < FACTOR_TOLERANCE:
            return "torque unit", f"looks like {prefix}{newton}{turned}"
    if ratio is not None and abs(ratio) > 2.0 and abs(size * abs(ratio) - 1.0) < FACTOR_TOLERANCE:
        return "torque unit", f"looks like that of the motor, before the gear of {ratio:g}{turned}"
    if size < 1.0:
        geared = ""
        if ratio is None and _GEAR_RATIO_RANGE[0] < 1.0 / size < _GEAR_RATIO_RANGE[1]:
            geared = f", or the motor's own torque before a gear of {1.0 / size:.3g}"
        current = f"looks like current, about {1.0 / size:.3g} {newton}/A{geared}{turned}"
        return "torque unit", f"{current}, if the robot's file is not of a larger arm"
    return "torque gain", f"is {gain:.3g} times the model's torque{turned}"
