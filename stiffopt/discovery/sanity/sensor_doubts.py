"""Doubts about sensors: limits, velocities and link angles, dead or repeated torques, contacts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np

from stiffopt.discovery.comparison.filtering import filter_slow_motion
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.sanity.doubt import Doubt, format_joints, limit_to_runs, scale_line
from stiffopt.discovery.sanity.interpretations import DEGREE, MILLIMETRE, Samples
from stiffopt.discovery.sanity.torque_fit import Motion, fit_gain
from stiffopt.discovery.settings import MIN_MOVING_SPEED
from stiffopt.recording.channel import are_magnitudes, are_whole, true_intervals
from stiffopt.recording.channel_faults import covered_range, moved_travel
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun
from stiffopt.units import to_si

# Margin of position limits: share of the range, and at least [rad] or [m].
LIMIT_MARGIN_SHARE, _MIN_LIMIT_MARGIN = 0.05, 0.02
# Scale of angles in counts of an encoder.
COUNT_SCALE = "[...] in [signals.scale], in rad per count (of 12 bits: 0.00153398)"
# Relative tolerances of a factor of a sign or a gear, and of a unit.
FACTOR_TOLERANCE, _UNIT_TOLERANCE = 0.2, 0.1


def doubt_position_limits(recordings: RecordingSet, runs: Sequence[RecordedRun]) -> Iterator[Doubt]:
    """Yield doubts about positions beyond limits: a unit if that explains all of them.

    Limits that are guesses of a robot file contradict no recording.
    """
    lower = recordings.robot.position_lower[recordings.order]
    upper = recordings.robot.position_upper[recordings.order]
    sources = recordings.robot.estimated()
    guessed = {each.joint for each in sources if each.key == "position_lower"}
    span = np.where([name in guessed for name in recordings.joints], np.inf, upper - lower)
    reach = np.full((2, recordings.n), np.nan)
    for run in runs:
        known = np.isfinite(run.position)
        low = np.where(known, run.position, np.inf).min(axis=0)
        high = np.where(known, run.position, -np.inf).max(axis=0)
        reach[0], reach[1] = np.fmin(reach[0], low), np.fmax(reach[1], high)
    margin = np.maximum(LIMIT_MARGIN_SHARE * span, _MIN_LIMIT_MARGIN)
    with np.errstate(invalid="ignore"):
        out = np.isfinite(span) & ((reach[0] < lower - margin) | (reach[1] > upper + margin))
    if not out.any():
        return
    told = "; ".join(
        f"joint {j + 1} reads {reach[0, j]:.3g} to {reach[1, j]:.3g}"
        f" {'m' if recordings.prismatic[j] else 'rad'}, its limits are {lower[j]:.3g} to"
        f" {upper[j]:.3g}"
        for j in np.flatnonzero(out)
    )
    turning = ~recordings.prismatic
    in_degrees = DEGREE * reach
    fits = (in_degrees[0] >= lower - margin) & (in_degrees[1] <= upper + margin)
    far = np.nanmax(np.abs(reach[:, turning & out]), initial=0.0) > 3.0 * np.pi
    if far and np.all(fits | ~turning | ~np.isfinite(span)):
        yield Doubt(
            kind="position unit",
            joints=tuple(int(j) + 1 for j in np.flatnonzero(out)),
            evidence=f"The positions look like degrees: {told}.",
            line=scale_line(recordings, "position", np.ones(recordings.n), "deg"),
        )
        return
    if far and are_whole(np.vstack([run.position for run in runs])):
        yield Doubt(
            kind="position unit",
            joints=tuple(int(j) + 1 for j in np.flatnonzero(out)),
            evidence=f"The positions are counts of an encoder: {told}.",
            line=f"position = {COUNT_SCALE}",
        )
        return
    yield Doubt(
        kind="position limits",
        joints=tuple(int(j) + 1 for j in np.flatnonzero(out)),
        evidence=f"Positions lie beyond the limits of the robot's own file: {told}. Check their"
        " zero, sign and unit, or correct the limits.",
    )


def doubt_second_sensors(recordings: RecordingSet, runs: Sequence[RecordedRun]) -> Iterator[Doubt]:
    """Yield doubts about velocities and link angles that contradict positions, one per signal."""
    seen: dict[str, dict[int, tuple[str, float | None]]] = {}
    where: dict[str, list[str]] = {}
    for run in runs:
        for fault in run.faults:
            too_short = fault.ratio is not None and np.isnan(fault.ratio)
            if fault.kind == "contradicts position" and fault.joint is not None and not too_short:
                detail = fault.detail.removesuffix(". Left out.")
                seen.setdefault(fault.signal, {}).setdefault(fault.joint, (detail, fault.ratio))
                where.setdefault(fault.signal, []).append(run.name)
    for signal, joints in seen.items():
        if signal == "velocity" and _is_poor_velocity(recordings, joints, runs):
            continue
        names = list(dict.fromkeys(where[signal]))
        alone = len(names) < len(runs)
        noun = "velocity" if signal == "velocity" else "link position"
        each = "; ".join(f"that of joint {joint} {detail}" for joint, (detail, _) in joints.items())
        ratios = {joint: ratio for joint, (_, ratio) in joints.items()}
        evidence = f"The {noun} contradicts the position: {each}."
        line = _ratio_line(recordings, signal, ratios)
        if not line and signal == "velocity" and (factor := _common_factor(recordings, ratios)):
            evidence += " All joints agree: time or sampling rate may be wrong."
            line = f"time = {1.0 / factor:.3g} in [signals.scale]"
        yield Doubt(
            kind=noun,
            joints=tuple(joints),
            evidence=limit_to_runs(names, evidence) if alone else evidence,
            line="" if alone else line,
        )


def _is_poor_velocity(
    recordings: RecordingSet,
    joints: Mapping[int, tuple[str, float | None]],
    runs: Sequence[RecordedRun],
) -> bool:
    """Return True for velocities that are left out alone: no unit or sign corrects any of them.

    Velocities of as many other joints agree, so that units and clock are right; positions are
    enough where a velocity is poor.
    """
    agreeing = {
        j + 1
        for run in runs
        if run.velocity is not None
        for j in range(run.n)
        if np.isfinite(run.velocity[:, j]).any()
        and covered_range(run.position[:, j]) >= moved_travel(recordings.prismatic[j])
    }
    explained = [
        _ratio_line(recordings, "velocity", {joint: ratio}) for joint, (_, ratio) in joints.items()
    ]
    return len(agreeing - set(joints)) >= len(joints) and not any(explained)


def _ratio_line(recordings: RecordingSet, signal: str, ratios: Mapping[int, float | None]) -> str:
    """Return a line that corrects all joints of a signal by one cause, or ""."""
    known = np.array([np.nan if ratio is None else ratio for ratio in ratios.values()])
    slides = recordings.prismatic[np.array(list(ratios)) - 1]
    units = [("deg", DEGREE)] if not slides.any() else [("mm", MILLIMETRE)] if slides.all() else []
    for unit, size in units:
        if np.all(np.abs(known / size - 1.0) < _UNIT_TOLERANCE):
            return f'position = "{unit}" in [signals.scale]'
    if signal == "velocity":
        units = [(f"{unit}/s", size) for unit, size in units]
        units += [("rpm", to_si("1 rpm", "angular velocity"))] if not slides.any() else []
    for unit, size in units:
        if np.all(np.abs(known * size - 1.0) < _UNIT_TOLERANCE):
            return scale_line(recordings, signal, np.ones(recordings.n), unit)
    if np.all(np.abs(known + 1.0) < FACTOR_TOLERANCE):
        signs = np.ones(recordings.n)
        signs[np.array(list(ratios)) - 1] = -1.0
        return scale_line(recordings, signal, signs)
    return ""


def _common_factor(recordings: RecordingSet, ratios: Mapping[int, float | None]) -> float | None:
    """Return the common factor of the velocities of all joints; None without one."""
    known = np.array([np.nan if ratio is None else ratio for ratio in ratios.values()])
    usual = float(np.median(known))
    alike = len(known) == recordings.n > 1 and bool(
        np.all(np.abs(known / usual - 1.0) < _UNIT_TOLERANCE)
    )
    return usual if alike and usual > 0.0 else None


# A channel is dead if its deviation is below the first share of that of the nominal torque, and
# the nominal torque leaves more than the second share of its variance at any gain.
_MAX_DEAD_SIZE, _MIN_UNRELATED_SHARE = 0.1, 0.9
# Share of equal samples of two runs from which a channel repeats, and values that it then has at
# least: a coarse or stationary channel repeats by chance.
_MIN_EQUAL_SHARE, _MIN_DISTINCT_VALUES = 0.9, 100


def doubt_dead_channels(
    recordings: RecordingSet, robot: RobotModel, samples: Samples
) -> Iterator[Doubt]:
    """Yield a doubt about torque channels that do not follow the motion at any gain.

    `samples`: of the training runs.
    """
    motion = Motion.of(robot, samples.position, samples.velocity, samples.acceleration)
    dead, parts = [], []
    for j in range(recordings.n):
        torque = samples.torque[:, j]
        known = np.isfinite(torque)
        if not known.any():
            continue
        asked = motion.spring[known, j] + robot.friction(motion.velocity)[known, j]
        size = float(np.std(torque[known]))
        if size >= _MAX_DEAD_SIZE * float(np.std(asked)):
            continue
        if fit_gain(robot, motion, torque, j, ())[1] > _MIN_UNRELATED_SHARE:
            unit = "N" if recordings.prismatic[j] else "N m"
            dead.append(j)
            parts.append(
                f"that of joint {j + 1} is {np.mean(torque[known]):.2g} +- {size:.2g} {unit}, the"
                f" motion takes up to {np.abs(asked).max():.3g} {unit}"
            )
    if dead:
        names = ['""' if j in dead else f'"{x}"' for j, x in enumerate(recordings.signals.torque)]
        yield Doubt(
            kind="dead channel",
            joints=tuple(j + 1 for j in dead),
            evidence=f"The torque of {format_joints(dead)} does not follow the motion:"
            f" {'; '.join(parts)}. The channel is not connected, or not filled.",
            line=f"torque = [{', '.join(names)}] in [signals]",
        )


def doubt_magnitudes(runs: Sequence[RecordedRun]) -> Iterator[Doubt]:
    """Yield a doubt about torques without a sign, as some drives report their current."""
    if are_magnitudes(np.vstack([run.torque for run in runs])):
        yield Doubt(
            kind="torque sign",
            evidence="The torques are never negative, each of them is 0 at times, whichever way the"
            " joints move: magnitudes without a sign. Record signed currents, or commanded beside"
            " measured positions.",
        )


def doubt_repeated_torques(runs: Sequence[RecordedRun]) -> Iterator[Doubt]:
    """Yield a doubt about torques that are equal to the digit in two runs: commands, or copies."""
    for first, second in combinations(runs, 2):
        count = min(len(first.time), len(second.time))
        equal = [
            j for j in range(first.n) if _repeats(first.torque[:count, j], second.torque[:count, j])
        ]
        if not equal:
            continue
        pair = f"{first.name} and {second.name}"
        copied = np.array_equal(first.position[:count], second.position[:count], equal_nan=True)
        if copied:
            evidence = f"{pair} are one recording: positions and torques are equal to the digit."
            evidence += " Leave one of them out."
        else:
            evidence = (
                f"The torque of {format_joints(equal)} is equal to the digit in {pair}, the"
                " positions are not: it looks commanded or calculated, not measured. Record the"
                " measured torque or current."
            )
        yield Doubt(
            kind="repeated run" if copied else "commanded torque",
            joints=tuple(j + 1 for j in equal),
            evidence=evidence,
        )
        return


def _repeats(first: np.ndarray, second: np.ndarray) -> bool:
    known = np.isfinite(first) & np.isfinite(second)
    if len(np.unique(first[known])) < _MIN_DISTINCT_VALUES:
        return False
    return bool(np.mean(first[known] == second[known]) > _MIN_EQUAL_SHARE)


# Shortest interval [s].
_MIN_DURATION = 0.3
# Bound of the friction at rest over the Coulomb friction; error of the weight over itself; and the
# excess over both from which an interval counts, over the Coulomb friction.
_STICTION_RATIO, _WEIGHT_TOLERANCE, _MIN_EXCESS = 1.5, 0.1, 0.5
# Largest share of the stationary time with an excess: more is a wrong model, not a contact.
_MAX_SHARE = 0.5


def doubt_contacts_at_rest(robot: RobotModel, runs: Sequence[RecordedRun]) -> Iterator[Doubt]:
    """Yield a remark about every interval in which a stationary joint carries a further load.

    A fit leaves stationary joints out, whose friction is anything between its bounds. A load beyond
    these bounds is nevertheless one.

    `robot`: joints without stated friction are left out.
    """
    for run in runs:
        if not run.usable:
            continue
        slow = filter_slow_motion(run)
        load = robot.spring_torque(slow.position, slow.velocity, slow.acceleration)
        rest = np.abs(slow.velocity) < MIN_MOVING_SPEED
        carried = slow.torque - load - robot.rotor_inertia * slow.acceleration
        bound = _STICTION_RATIO * robot.coulomb + _WEIGHT_TOLERANCE * np.abs(load)
        excess = np.where(rest & np.isfinite(carried), np.abs(carried) - bound, -np.inf)
        for j in np.flatnonzero(robot.coulomb > 0.0).tolist():
            found = excess[:, j] > _MIN_EXCESS * robot.coulomb[j]
            if found.sum() > _MAX_SHARE * rest[:, j].sum():
                continue
            for begin, end in true_intervals(found):
                if (end - begin) * slow.dt >= _MIN_DURATION:
                    yield _describe_contact(robot, run, slow.time, carried[:, j], j, (begin, end))


def _describe_contact(
    robot: RobotModel,
    run: RecordedRun,
    time: np.ndarray,
    carried: np.ndarray,
    joint: int,
    interval: tuple[int, int],
) -> Doubt:
    begin, end = interval
    unit = "N" if robot.recordings.prismatic[joint] else "N m"
    most = float(np.abs(carried[begin:end]).max())
    return Doubt(
        kind="contact at rest",
        joints=(joint + 1,),
        evidence=f"In {run.name}, {time[begin]:.2f} to {time[end - 1]:.2f} s, joint {joint + 1}"
        f" stands and carries {most:.3g} {unit} beside its weight, where friction holds"
        f" {robot.coulomb[joint]:.3g} {unit}: something touches or loads the arm there.",
    )
