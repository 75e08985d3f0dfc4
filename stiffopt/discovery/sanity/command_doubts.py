"""Doubts about commanded positions, and position errors that are recorded as torques."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from stiffopt.actuator.position_servo import PositionServo
from stiffopt.discovery.sanity.doubt import Doubt, format_joints
from stiffopt.discovery.sanity.sensor_doubts import COUNT_SCALE, doubt_position_limits
from stiffopt.errors import InputError
from stiffopt.recording.channel import are_whole
from stiffopt.recording.channel_faults import moved_travel
from stiffopt.recording.readers.read import is_messages, read_tables
from stiffopt.recording.recorded_arm import path_inside_set
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun, command_interval
from stiffopt.recording.state_pair import StatePair

# Range of the ratio of commanded to measured travel in one unit: a weak joint covers a share.
_TRAVEL_RATIO = (1.0 / 3.0, 3.0)
# Travel of a command over that of its position below which the command stands still.
_MIN_COMMAND_TRAVEL = 1e-6
# Ratio of a degree to a radian within which commands are in degrees.
_DEGREE_RATIO_TOLERANCE = 3.0
# Correlation of command and position below which they are of different joints or motions.
_MIN_CORRELATION = 0.5
# Longest lag that is searched [s], and rows by which a position may lead its command by noise.
_MAX_LAG, _MIN_LEAD_ROWS = 0.5, 1.5
# Interval of commands above which one logged in faster rows is taken for thinned [s]; and rows.
_MAX_COMMAND_INTERVAL, _MIN_HELD_ROWS = 0.04, 4


def doubt_commands(recordings: RecordingSet, runs: Sequence[RecordedRun]) -> Iterator[Doubt]:
    """Yield doubts about the commands of a set without torques; one kind is told at a time."""
    commanded = [run for run in runs if run.command is not None and run.usable]
    if not commanded:
        yield Doubt(
            kind="no command",
            evidence="No training run holds a command and positions of all joints, and no torque is"
            " recorded: there is nothing to explain.",
        )
        return
    position = np.vstack([run.position for run in commanded])
    command = np.vstack([run.command for run in commanded if run.command is not None])
    travel = np.max(
        [np.nanmax(r.position, axis=0) - np.nanmin(r.position, axis=0) for r in commanded],
        axis=0,
    )
    least = np.array([moved_travel(slides) for slides in recordings.prismatic])
    moving = travel > least
    if not moving.any():
        yield Doubt(
            kind="no motion",
            evidence=f"No joint moves by more than {travel.max():.2g} rad: at rest nothing is told"
            " but weight over gain. Record a motion through much of each joint's range.",
        )
        return
    yield from next(
        filter(
            None,
            (
                tuple(kind)
                for kind in (
                    _doubt_copies(position, command, moving),
                    _doubt_units(recordings, position, command, moving),
                    # In degrees or counts as well as the commands: no simulation holds them.
                    doubt_position_limits(recordings, commanded),
                    _doubt_other_joints(position, command, moving),
                    _doubt_swapped(recordings, commanded, moving),
                    _doubt_thinned(commanded, moving),
                )
            ),
        ),
        (),
    )


def _doubt_copies(position: np.ndarray, command: np.ndarray, moving: np.ndarray) -> Iterator[Doubt]:
    """Doubt positions that repeat their commands, and positions that move without any."""
    away = np.abs(command - position)[:, moving]
    if np.nanmax(away, initial=0.0) == 0.0:
        yield Doubt(
            kind="copied command",
            evidence="The positions equal the commands in every row: no servo follows without an"
            " error, and nothing was measured. Name the columns of measured positions.",
        )
    elif (_travel_ratio(position, command)[moving] < _MIN_COMMAND_TRAVEL).all():
        yield Doubt(
            kind="no command",
            evidence="The commands stand still while the arm moves: they do not tell what moved it."
            " Name the columns of commanded positions.",
        )


def _travel_ratio(position: np.ndarray, command: np.ndarray) -> np.ndarray:
    """Return how far each command (n,) travels over its position."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.nanstd(command, axis=0) / np.nanstd(position, axis=0))


def _doubt_units(
    recordings: RecordingSet, position: np.ndarray, command: np.ndarray, moving: np.ndarray
) -> Iterator[Doubt]:
    """Doubt commands whose travel is not that of the positions; a joint may be held in place."""
    ratio = _travel_ratio(position, command)
    odd = (
        moving
        & (ratio > _MIN_COMMAND_TRAVEL)
        & ((ratio < _TRAVEL_RATIO[0]) | (ratio > _TRAVEL_RATIO[1]))
    )
    if not odd.any():
        return
    which, usual = format_joints(np.flatnonzero(odd)), float(np.median(ratio[odd]))
    whole = are_whole(command[:, odd])
    degree = 180.0 / np.pi
    if max(usual / degree, degree / usual) < _DEGREE_RATIO_TOLERANCE and not whole:
        what, line = "commands are in degrees", 'command = "deg" in [signals.scale]'
        if not odd[moving].all():
            scale = recordings.signals.scale_of("command", len(odd)) / np.where(odd, degree, 1.0)
            each = ", ".join(f"{own:.6g}" for own in scale)
            line = f"command = [{each}] in [signals.scale]"
    elif max(usual * degree, 1.0 / (usual * degree)) < _DEGREE_RATIO_TOLERANCE:
        what = "positions are in degrees"
        line = 'position = "deg" and command = 1.0 in [signals.scale]'
    elif whole:
        what = "commands are counts of an encoder"
        line = f"command = {COUNT_SCALE}"
    else:
        what, line = "commands have another unit than positions, or are another signal", ""
    yield Doubt(
        kind="command unit",
        joints=tuple(int(j) + 1 for j in np.flatnonzero(odd)),
        evidence=f"The commands of {which} travel {usual:.3g} times as far as the positions: the"
        f" {what}.",
        line=line,
    )


def _doubt_other_joints(
    position: np.ndarray, command: np.ndarray, moving: np.ndarray
) -> Iterator[Doubt]:
    """Doubt commands that do not go with the position of their joint."""
    for j in np.flatnonzero(moving):
        own = _correlate(command[:, j], position[:, j])
        if not own < _MIN_CORRELATION:
            continue
        others = [_correlate(command[:, k], position[:, j]) for k in range(command.shape[1])]
        best = int(np.nanargmax(others))
        if -own > max(_MIN_CORRELATION, others[best]):
            hint = " It moves the other way: reverse the sign by -1.0 in [signals.scale]."
        elif others[best] > max(_MIN_CORRELATION, own + 0.3):
            hint = f" It goes with the command of joint {best + 1}: check the order of the columns."
        else:
            hint = " Is it sent to this joint, with this sign?"
        yield Doubt(
            kind="command order",
            joints=(int(j) + 1,),
            evidence=f"The position of joint {j + 1} does not follow its command (correlation"
            f" {own:.2f}).{hint}",
        )


def _correlate(one: np.ndarray, two: np.ndarray) -> float:
    known = np.isfinite(one) & np.isfinite(two)
    if known.sum() < 3 or np.ptp(one[known]) == 0.0 or np.ptp(two[known]) == 0.0:
        return float("nan")
    return float(np.corrcoef(one[known], two[known])[0, 1])


def _doubt_swapped(
    recordings: RecordingSet, runs: Sequence[RecordedRun], moving: np.ndarray
) -> Iterator[Doubt]:
    """Doubt positions that lead their commands."""
    lags, weights = np.array([find_lag(run) for run in runs]).transpose(1, 0, 2)
    moved = moving & (weights.sum(axis=0) > 0.0)
    joint = np.sum(lags * weights, axis=0)[moved] / weights.sum(axis=0)[moved]
    step = float(np.median([run.step for run in runs]))
    if moved.any() and (lead := -float(np.median(joint))) > _MIN_LEAD_ROWS * step:
        names = recordings.signals
        yield Doubt(
            kind="swapped",
            evidence=f"The positions ({', '.join(names.position[:3])}) lead the commands by"
            f" {1e3 * lead:.0f} ms, and an arm follows its commands: position and command are"
            " swapped.",
            line="position and command in [signals] with each other's columns",
        )


def find_lag(run: RecordedRun) -> np.ndarray:
    """Return the lag of each position after its command [s], and its weight (2, n).

    By the correlation of their rates; a joint that stands in the run has no weight.
    """
    assert run.command is not None
    most = min(round(_MAX_LAG / run.step), len(run.time) // 4)
    found = np.zeros((2, run.n))
    for j in range(run.n):
        series = []
        for values in (run.command[:, j], run.position[:, j]):
            known = np.isfinite(values)
            whole = np.interp(run.time, run.time[known], values[known]) if known.any() else values
            series.append(np.nan_to_num(whole - np.mean(whole)))
        # Rates over several rows: of a held command single differences are mostly zero.
        width = max(1, most // 10)
        rate, moved = (each[width:] - each[:-width] for each in series)
        scores = [
            float(
                rate[max(0, -k) : len(rate) - max(0, k)]
                @ moved[max(0, k) : len(moved) - max(0, -k)]
            )
            for k in range(-most, most + 1)
        ]
        best = int(np.argmax(scores))
        found[:, j] = (best - most) * run.step, max(scores[best], 0.0)
    return found


def _doubt_thinned(runs: Sequence[RecordedRun], moving: np.ndarray) -> Iterator[Doubt]:
    """Doubt commands that change far more rarely than rows are logged."""
    each = np.array([(command_interval(run, moving), run.step) for run in runs])
    each = each[np.isfinite(each[:, 0])]
    if not len(each):
        return
    interval, step = np.median(each, axis=0)
    if interval > _MAX_COMMAND_INTERVAL and interval > _MIN_HELD_ROWS * step:
        yield Doubt(
            kind="command rate",
            evidence=f"The commands change every {1e3 * interval:.0f} ms, the rows are"
            f" {1e3 * step:.3g} ms apart: logged more slowly than they were sent, commands do not"
            " tell the torques between. Log every command that is sent.",
        )


# Residual of an error against command less position, over its size: rounding of a log.
_MAX_RESIDUAL = 1e-3


def take_errors_as_commands(recordings: RecordingSet) -> tuple[RecordingSet, tuple[str, ...]]:
    """Return a set whose torques are position errors as one with commands, and a note of it.

    A servo's error times a factor is torque only without delay and damping. Where every torque
    column is a multiple of another column less the position, that one is the command; the stated
    scale of the torque is then the gain. Other sets are returned unchanged, without a note.
    """
    signals = recordings.signals
    entries = recordings.with_role("train")
    if isinstance(recordings, StatePair) or signals.command is not None or not entries:
        return recordings, ()
    path = path_inside_set(recordings.path, "runs", entries[0].file)
    if not all(signals.torque) or not path.is_file() or is_messages(path):
        return recordings, ()
    try:
        tables = list(read_tables(path).values())
    except InputError:
        return recordings, ()  # whoever opens the run says why
    if len(tables) != 1:
        return recordings, ()
    found = [
        _find_command(tables[0], torque, position)
        for torque, position in zip(signals.torque, signals.position, strict=True)
    ]
    if not all(each is not None for each in found):
        return recordings, ()
    commands, factors = zip(*(each for each in found if each is not None), strict=True)
    scale = {kind: value for kind, value in signals.scale.items() if kind != "torque"}
    if "position" in scale:
        scale["command"] = scale["position"]
    n, kp = recordings.n, None
    if "torque" in signals.scale:
        gain = signals.scale_of("torque", n) * factors / signals.scale_of("position", n)
        kp = tuple(float(each) for each in gain) if (gain > 0.0).all() else None
    law = PositionServo(kind="position_servo", kp=kp).law(
        recordings.robot.torque_max[recordings.order]
    )
    own = replace(signals, torque=("",) * n, command=commands, scale=scale)
    pairs = ", ".join(
        f"{torque} is {command} less {position}"
        for torque, command, position in zip(
            signals.torque, commands, signals.position, strict=True
        )
    )
    note = (
        f"What is stated as torque is a position error ({pairs}): commands and positions are"
        " diagnosed in its place" + (", with the stated scale as gain." if kp else ".")
    )
    return replace(recordings, signals=own, actuator=law), (note,)


def _find_command(
    table: Mapping[str, np.ndarray], torque: str, position: str
) -> tuple[str, float] | None:
    """Return the column that a position error is against, and the error per difference."""
    if torque not in table or position not in table:
        return None
    error, place = table[torque], table[position]
    for name, values in table.items():
        if name in (torque, position) or values.dtype.kind != "f":
            continue
        known = np.isfinite(values) & np.isfinite(error) & np.isfinite(place)
        away = (values - place)[known]
        own = error[known]
        if not away.any() or not np.std(own) > 0.0:
            continue
        factor = float(own @ away) / float(away @ away)
        if float(np.std(own - factor * away)) <= _MAX_RESIDUAL * float(np.std(own)):
            return name, factor
    return None
