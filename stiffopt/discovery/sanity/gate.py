"""The sanity gate: what is doubted of recordings before anything is diagnosed from them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.sanity.doubt import Doubt
from stiffopt.discovery.sanity.explanations import Explanation, Explanations
from stiffopt.discovery.sanity.joint_gains import JointGain, joint_gains
from stiffopt.discovery.sanity.lines import (
    column_line,
    joints_in_words,
    listed_numbers,
    of_some,
    scale_line,
    share_words,
)
from stiffopt.discovery.sanity.odd_runs import OddRun, odd_runs
from stiffopt.discovery.sanity.orders import DEGREE, MILLIMETRE
from stiffopt.discovery.sanity.samples import sampled
from stiffopt.discovery.sanity.second_sensors import second_sensors
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun
from stiffopt.recording.set_points import is_set_point, may_be_set_point

# How far beyond its limits a joint may read: share of its range, and [rad] or [m].
_BEYOND = (0.05, 0.02)
# Within which a factor counts as that of a unit, a sign or a gear.
_LIKE, _NEAR = 0.2, 0.1
# Ratios of the gears of arms.
_GEARS = (20.0, 400.0)
# Share of a torque's variance that is open where single runs are looked at, and how many.
_OPEN, _MOST_RUNS = 0.04, 12


class SanityGate:
    """What is doubted of a set by some of its runs, and what is remarked beside.

    Parameters
    ----------
    recordings : RecordingSet
    runs : sequence of RecordedRun
        Training runs: no other run is looked at before findings are fixed.

    Notes
    -----
    The nominal model, wrong as it may be, tells a unit or an order: other readings of the same
    files (degrees, swapped joints and columns, turned signs, any gain, another gravity, a delay)
    are doubted for only where they explain the torques many times better than the file's own
    reading with any friction, rotor inertia, spring and payload that a robot may have besides.
    """

    def __init__(self, recordings: RecordingSet, runs: Sequence[RecordedRun]) -> None:
        self._recordings, self._runs = recordings, runs

    @cached_property
    def doubts(self) -> tuple[Doubt, ...]:
        """What stops a diagnosis; nothing where the set can be what it says."""
        recordings, runs = self._recordings, self._runs
        if not any(body.mass > 0.0 for body in recordings.robot.tree.bodies):
            return (_without_masses(recordings),)
        found = [
            *_currents(recordings),
            *_set_points(recordings),
            *second_sensors(recordings, runs),
        ]
        explanation, search = None, self._search
        if search is not None:
            odd = [each for each in self._odd if each not in self._elsewhere]
            explanation = None if odd else search.best()
            if odd:
                found = [*_of_odd_runs(recordings, odd), *found]
            elif explanation is not None:
                found = [*_explained(recordings, search, explanation), *found]
            elif (standing := search.standing_in_degrees()) is not None:
                found = [_in_rad(recordings, search, standing), *found]
            elif len(runs) > 1 and not found:
                found = [*_of_single_runs(recordings, runs, search)]
        if not any(doubt.kind == "position unit" for doubt in found):
            found += _beyond_limits(recordings, runs)
        return tuple(found)

    @property
    def remarks(self) -> tuple[Doubt, ...]:
        """What stops nothing and yet is to be looked at; read where nothing is doubted.

        A drive's constant may be off by that much, which is an effect of the catalogue; and so may
        be the description.
        """
        told = tuple(_references(self._recordings))
        if self._search is None or self._recordings.signals.currents:
            return told
        gains = joint_gains(self._robot, self._search.samples)
        return (
            *told,
            *map(_of_elsewhere, self._elsewhere),
            *(_of_joint_gain(self._recordings, each) for each in gains),
        )

    @cached_property
    def _robot(self) -> RobotModel:
        return RobotModel(self._recordings)

    @cached_property
    def _search(self) -> Explanations | None:
        samples = sampled(self._runs)
        return None if samples is None else Explanations(self._robot, samples)

    @cached_property
    def _odd(self) -> list[OddRun]:
        if self._search is None or len(self._runs) < 2:
            return []
        return odd_runs(self._search, self._runs)

    @cached_property
    def _elsewhere(self) -> list[OddRun]:
        """Odd runs that the robot may explain: a stop, an inertia that others do not ask."""
        return [each for each in self._odd if each.elsewhere and each.search.best() is None]


def _without_masses(recordings: RecordingSet) -> Doubt:
    """Weight and inertia would be what the model lacks, and nothing else could be told."""
    return Doubt(
        kind="masses",
        joints=(),
        evidence="No link of the robot has a mass: its URDF gives no <inertial>. Give them there,"
        " if only roughly: all else is judged beside the weight.",
        line="",
    )


def _currents(recordings: RecordingSet) -> Iterator[Doubt]:
    """Torques that nobody has made of currents yet."""
    if recordings.signals.currents:
        yield Doubt(
            kind="torque unit",
            joints=(),
            evidence="The torques are stated as currents in A. Give N m per A at each joint (the"
            " motor's torque constant times the gear ratio) as torque in [signals.scale]; what the"
            " weight of the nominal model suggests, if anything, is told here as well.",
            line="",
        )


def _set_points(recordings: RecordingSet) -> Iterator[Doubt]:
    """Positions that the arm was told to take."""
    told = [name for name in recordings.signals.position if name and is_set_point(name)]
    if told:
        yield Doubt(
            kind="set points",
            joints=(),
            evidence=f"The positions are set points by their names ({', '.join(told[:3])}"
            f"{', ...' if len(told) > 3 else ''}): what the arm was told to do is not what it did,"
            " and its controller's errors would be taken for physics. Record measured positions.",
            line="position = [...] in [signals] with the columns that were measured",
        )


def _references(recordings: RecordingSet) -> Iterator[Doubt]:
    """Positions whose names may be those of set points."""
    names = [name for name in recordings.signals.position if name]
    told = [name for name in names if may_be_set_point(name) and not is_set_point(name)]
    if told:
        yield Doubt(
            kind="set points",
            joints=(),
            evidence=f"The positions speak of a reference ({', '.join(told[:3])}"
            f"{', ...' if len(told) > 3 else ''}): are they measured, and not what the arm was told"
            " to do?",
            line="",
        )


def _of_joint_gain(recordings: RecordingSet, found: JointGain) -> Doubt:
    factors = np.ones(recordings.n)
    factors[found.joint] = float(f"{1.0 / found.gain:.3g}")
    j = found.joint + 1
    return Doubt(
        kind="torque gain",
        joints=(j,),
        evidence=f"The torque of joint {j} fits {found.gain:.3g} times what the model expects: of"
        f" its variance {100.0 * found.after:.2g} % then stays in place of"
        f" {100.0 * found.before:.2g} %, whatever masses and friction all joints are given. Is its"
        " torque constant, gear ratio or column that of another joint? A diagnosis may call it"
        " torque_gain.",
        line=scale_line(recordings, "torque", factors),
    )


# ---- by the torques


def _explained(
    recordings: RecordingSet, search: Explanations, explanation: Explanation
) -> Iterator[Doubt]:
    shares = share_words(search.strict, explanation.left, explanation.joints)
    joints = tuple(j + 1 for j in explanation.joints)
    if explanation.gravity is not None:
        direction = 9.81 * explanation.gravity
        stated = listed_numbers(recordings.gravity)
        fit = f"the torques fit gravity along {listed_numbers(direction)}"
        if not direction.any():
            fit = "the torques hold no weight, as of a controller that adds it behind them"
        yield Doubt(
            kind="gravity",
            joints=joints,
            evidence=f"Gravity is stated as {stated} m/s^2, but {fit}: {shares}.",
            line=f"gravity = {listed_numbers(direction)}",
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
        yield from _of_reading(recordings, explanation, shares)
        if explanation.gains is not None:
            yield from _of_gains(recordings, explanation, search.strict)


def _of_elsewhere(odd: OddRun) -> Doubt:
    which = joints_in_words(odd.joints)
    return Doubt(
        kind="another arm",
        joints=tuple(j + 1 for j in odd.joints),
        evidence=f"{odd.run.name} moves faster or further than the other runs and does not fit them"
        f" there, in the torque of {which}. If that is the same arm with the same load, the model"
        " lacks something that shows there alone.",
        line="",
    )


def _in_rad(recordings: RecordingSet, search: Explanations, found: Explanation) -> Doubt:
    """Joints that are stated in degrees and move in rad."""
    which = joints_in_words(found.joints)
    most = np.degrees(np.ptp(search.samples.position[:, list(found.joints)], axis=0).max())
    each = ", ".join(f"{100.0 * found.left[j]:.2g} % at joint {j + 1}" for j in found.joints)
    line = scale_line(recordings, "position", np.array(found.reading.position_scale))
    also = " (and the velocity's likewise)" if recordings.signals.velocity is not None else ""
    return Doubt(
        kind="position unit",
        joints=tuple(j + 1 for j in found.joints),
        evidence=f"The positions of {which} look like rad, not degrees: as degrees they move by"
        f" {most:.2g} deg at most, as rad the nominal model leaves of the torque's variance"
        f" {each}.",
        line=line + also,
    )


def _of_odd_runs(recordings: RecordingSet, odd: Sequence[OddRun]) -> Iterator[Doubt]:
    """Another reading of a run where one explains it; else the run is of something else."""
    for each in odd:
        explanation = each.search.best()
        if explanation is not None:
            yield from _of_one_run(recordings, each.run.name, each.search, explanation)
            continue
        shares = ", ".join(
            f"{100.0 * each.left[j]:.3g} % at joint {j + 1} (at most {100.0 * each.others[j]:.2g} %"
            " in the others)"
            for j in each.joints
        )
        yield Doubt(
            kind="another arm",
            joints=tuple(j + 1 for j in each.joints),
            evidence=f"{each.run.name} does not fit the other runs, as of another arm, or of this"
            f" one with a load or a contact: of the torque's variance the nominal model leaves"
            f" {shares}, with friction of its own. Take its [[runs]] section out, or give that load"
            " a set of its own.",
            line="",
        )


def _of_one_run(
    recordings: RecordingSet, name: str, search: Explanations, explanation: Explanation
) -> Iterator[Doubt]:
    for doubt in _explained(recordings, search, explanation):
        yield replace(doubt, evidence=of_some([name], doubt.evidence), line="")


def _of_single_runs(
    recordings: RecordingSet, runs: Sequence[RecordedRun], together: Explanations
) -> Iterator[Doubt]:
    """What single runs contradict, where the others are as the file says."""
    with np.errstate(invalid="ignore"):
        fails = together.strict > _OPEN
    if not fails.any():
        return
    for run in runs[:_MOST_RUNS]:
        samples = sampled([run])
        if samples is None:
            continue
        search = Explanations(together.robot, samples)
        explanation = search.best()
        if explanation is None:
            continue
        yield from _of_one_run(recordings, run.name, search, explanation)


def _of_reading(recordings: RecordingSet, explanation: Explanation, shares: str) -> Iterator[Doubt]:
    """Degrees, swapped columns and turned signs of a reading."""
    reading, n = explanation.reading, recordings.n
    scale = np.array(reading.position_scale)
    units = {"degrees": ("deg", DEGREE), "mm": ("mm", MILLIMETRE)}
    turned = np.flatnonzero(scale < 0.0)
    if reading.time_scale != 1.0:
        yield Doubt(
            kind="time unit",
            joints=(),
            evidence=f"The time looks {1.0 / reading.time_scale:g} times too large for the torques"
            f" of this motion: {shares}.",
            line=f"time = {reading.time_scale:g} in [signals.scale]",
        )
    for unit, (symbol, size) in units.items():
        alike = np.flatnonzero(np.abs(scale) == size)
        if not alike.size:
            continue
        every = alike.size == n
        which = "all joints" if every else joints_in_words(alike)
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
        what = "positions and torques" if both else f"{kind} columns"
        lines = " and ".join(column_line(recordings, each, order) for each in kinds)
        yield Doubt(
            kind="joint order" if both else f"{kind} order",
            joints=tuple(j + 1 for j in swapped[kind]),
            evidence=f"The {what} of {joints_in_words(swapped[kind])} look exchanged: {shares}.",
            line=f"{lines} in [signals]",
        )
    torque_turned = np.flatnonzero(np.array(reading.torque_scale) < 0.0)
    if turned.size:
        with_torque = set(turned) == set(torque_turned)
        one = turned.size == 1
        what = "Position and torque" if with_torque else f"The position{'' if one else 's'}"
        look = "look" if with_torque or not one else "looks"
        lines = scale_line(recordings, "position", np.sign(scale))
        if with_torque:
            lines += " and " + scale_line(recordings, "torque", np.array(reading.torque_scale))
        yield Doubt(
            kind="position sign",
            joints=tuple(int(j) + 1 for j in turned),
            evidence=f"{what} of {joints_in_words(turned)} {look} turned round, as about an axis of"
            f" the other direction: {shares}.",
            line=lines,
        )
        torque_turned = np.array([] if with_torque else torque_turned, dtype=int)
    if torque_turned.size:
        yield Doubt(
            kind="torque sign",
            joints=tuple(int(j) + 1 for j in torque_turned),
            evidence=f"The torque of {joints_in_words(torque_turned)} has the other sign:"
            f" {shares}.",
            line=scale_line(recordings, "torque", np.array(reading.torque_scale)),
        )


def _of_gains(
    recordings: RecordingSet, explanation: Explanation, before: np.ndarray
) -> Iterator[Doubt]:
    """Torques off by a factor, joint by joint; one line mends them all."""
    gains = explanation.gains
    assert gains is not None
    ratio = recordings.nominal.gear_ratio
    factors = np.array([float(f"{1.0 / gain:.3g}") for gain in gains])
    line = scale_line(recordings, "torque", factors)
    for j in np.flatnonzero(gains != 1.0):
        slides = bool(recordings.prismatic[j])
        kind, words = _gain_in_words(
            float(gains[j]), None if ratio is None else float(ratio[j]), "N" if slides else "N m"
        )
        shares = share_words(before, explanation.left, [int(j)])
        yield Doubt(
            kind=kind,
            joints=(int(j) + 1,),
            evidence=f"The torque of joint {j + 1} {words}: {shares}.",
            line=line,
        )


def _gain_in_words(gain: float, ratio: float | None, newton: str) -> tuple[str, str]:
    size = abs(gain)
    turned = ", and has the other sign" if gain < 0.0 else ""
    if abs(size - 1.0) < _LIKE and gain < 0.0:
        return "torque sign", "has the other sign"
    for factor, prefix in ((1e3, "m"), (1e-3, "k")):
        if abs(size / factor - 1.0) < _LIKE:
            return "torque unit", f"looks like {prefix}{newton}{turned}"
    if ratio is not None and abs(ratio) > 2.0 and abs(size * abs(ratio) - 1.0) < _LIKE:
        return "torque unit", f"looks like that of the motor, before the gear of {ratio:g}{turned}"
    if size < 1.0:
        geared = ""
        if ratio is None and _GEARS[0] < 1.0 / size < _GEARS[1]:
            geared = f", or the motor's own torque before a gear of {1.0 / size:.3g}"
        current = f"looks like current, about {1.0 / size:.3g} {newton}/A{geared}{turned}"
        return "torque unit", f"{current}, if the robot's file is not of a larger arm"
    return "torque gain", f"is {gain:.3g} times what the model expects{turned}"


# ---- by the limits


def _beyond_limits(recordings: RecordingSet, runs: Sequence[RecordedRun]) -> Iterator[Doubt]:
    lower = recordings.robot.position_lower[recordings.order]
    upper = recordings.robot.position_upper[recordings.order]
    span = upper - lower
    reach = np.full((2, recordings.n), np.nan)
    for run in runs:
        known = np.isfinite(run.position)
        low = np.where(known, run.position, np.inf).min(axis=0)
        high = np.where(known, run.position, -np.inf).max(axis=0)
        reach[0], reach[1] = np.fmin(reach[0], low), np.fmax(reach[1], high)
    margin = np.maximum(_BEYOND[0] * span, _BEYOND[1])
    with np.errstate(invalid="ignore"):
        out = np.isfinite(span) & ((reach[0] < lower - margin) | (reach[1] > upper + margin))
    if not out.any():
        return
    turning = ~recordings.prismatic
    in_degrees = DEGREE * reach
    fits = (in_degrees[0] >= lower - margin) & (in_degrees[1] <= upper + margin)
    far = np.nanmax(np.abs(reach[:, turning & out]), initial=0.0) > 3.0 * np.pi
    if far and np.all(fits | ~turning | ~np.isfinite(span)):
        yield Doubt(
            kind="position unit",
            joints=tuple(int(j) + 1 for j in np.flatnonzero(out)),
            evidence="The positions look like degrees: "
            + _reaches(recordings, reach, lower, upper, out),
            line=scale_line(recordings, "position", np.ones(recordings.n), "deg"),
        )
        return
    yield Doubt(
        kind="position limits",
        joints=tuple(int(j) + 1 for j in np.flatnonzero(out)),
        evidence="Positions lie beyond the limits of the robot's own file: "
        + _reaches(recordings, reach, lower, upper, out)
        + " Check their zero, sign and unit, or mend the limits there.",
        line="",
    )


def _reaches(
    recordings: RecordingSet,
    reach: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    out: np.ndarray,
) -> str:
    parts = [
        f"joint {j + 1} reads {reach[0, j]:.3g} to {reach[1, j]:.3g}"
        f" {'m' if recordings.prismatic[j] else 'rad'}, its limits are {lower[j]:.3g} to"
        f" {upper[j]:.3g}"
        for j in np.flatnonzero(out)
    ]
    return "; ".join(parts) + "."
