"""Contact intervals, in which something touches, loads or offsets the arm: found and excluded.

Missing physics acts whenever its state recurs. A contact acts at one time: in one run, for a while,
in states without residual at other times. A fit would explain it by friction and weight. It is
searched in the residual beside findings and excluded from fit and proof. A dragging brake acts
against the motion in either direction; it is no contact and stays in the open residual.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from stiffopt.discovery.comparison.channel_rows import ChannelNoise
from stiffopt.discovery.comparison.comparison import Comparison, Fit
from stiffopt.discovery.judging.temporary_loads import TemporaryLoad
from stiffopt.discovery.prediction import Prediction, Predictor, residuals
from stiffopt.discovery.signals import RobotConstants, RobotSignals
from stiffopt.recording.channel import DEVIATION_PER_MAD
from stiffopt.recording.run import RecordedRun

# Root mean square over the usual size of a channel that starts an interval, and that ends it; and
# length of its window [s].
ONSET_RATIO, _DECAY_RATIO, _RMS_WINDOW = 5.0, 2.0, 0.3
# Shorter intervals are bursts [s]; largest root mean square of a channel outside of intervals, over
# its usual size, up to which contacts are distinguished.
_MIN_DURATION, _MAX_BACKGROUND_RATIO = 0.25, 2.0
# Largest share of a run, and of all runs, with contacts.
_MAX_RUN_SHARE, _MAX_AFFECTED_RUNS = 0.3, 0.5
# Excluded margin on either side [s], for the length of the filters.
_EXCLUSION_MARGIN = 0.25
# Distance of equal states, over the recorded ranges; least share of an interval with such states
# outside of it; number of neighbours; least share of its residual that these must not explain.
_STATE_DISTANCE, _MIN_REVISITED_SHARE, _NEIGHBOUR_COUNT, _MIN_REPEATED_SHARE = 0.25, 0.5, 5, 0.3
# Contacts are slow: cosines per second that follow them, and the least share that these explain.
# With the sign of the velocity they leave at least this ratio of the residual without it.
_FUNCTIONS_PER_SECOND, _MIN_SLOW_SHARE, _MIN_DRAG_RATIO = 4.0, 0.5, 0.8
# Largest sampling rate of a residual track [Hz].
_MAX_TRACK_RATE = 100.0


@dataclass(frozen=True, kw_only=True)
class Episode:
    """A contact interval."""

    run: str
    role: str
    # begin, end: times of the run [s].
    begin: float
    end: float
    joints: tuple[int, ...]  # joints with changed torques, from 1
    sizes: tuple[float, ...]  # largest torque [N m] or force [N] at each of them
    # True if it lasts until the end of a held-out run and depends on the position like a load; then
    # it is not excluded.
    stays: bool = False
    # nrmse_with, nrmse_without: normalised residual of the held-out run with and without all its
    # intervals; None in training.
    nrmse_with: float | None = None
    nrmse_without: float | None = None

    def holds(self, time: np.ndarray) -> np.ndarray:
        """Return a mask (K,) of the excluded times of its run."""
        return (time > self.begin - _EXCLUSION_MARGIN) & (time < self.end + _EXCLUSION_MARGIN)


@dataclass(frozen=True, kw_only=True, eq=False)
class ResidualTrack:
    """Residuals and states along one run."""

    run: str
    role: str
    time: np.ndarray  # (K,) [s]
    # (K, 2 n) residuals of torques, then of motor less link angles, over the noise; nan if not
    # compared.
    left: np.ndarray
    unit: np.ndarray  # (2 n,) torque at the link per unit of these [N m]
    velocity: np.ndarray  # (K, n) [rad/s]
    state: np.ndarray  # (K, n, 3) angle, velocity and load of each joint over the recorded ranges

    @property
    def usual(self) -> np.ndarray:
        """Robust size of the residual of each channel (2 n,)."""
        sizes = [np.abs(c[np.isfinite(c)]) for c in self.left.T]
        return np.array(
            [max(1.0, DEVIATION_PER_MAD * np.median(s)) if s.size else 1.0 for s in sizes]
        )

    def strength(self) -> np.ndarray:
        """Return the windowed root mean square over the usual size (K, 2 n); 0 if not compared."""
        known = np.isfinite(self.left)
        square = np.where(known, self.left / self.usual, 0.0) ** 2
        half = 0.5 * _RMS_WINDOW
        first = np.searchsorted(self.time, self.time - half)
        last = np.searchsorted(self.time, self.time + half, "right")
        sums = [np.vstack([np.zeros(v.shape[1]), np.cumsum(v, axis=0)]) for v in (square, known)]
        total, count = (s[last] - s[first] for s in sums)
        # One or two samples are an outlier.
        return np.asarray(np.sqrt(total / np.maximum(count, 3)))


def training_tracks(comparison: Comparison, fit: Fit) -> list[ResidualTrack]:
    """Return the residual tracks of a fit to the training runs."""
    if comparison.runs[0].at_rest:
        return []  # poses have no intervals
    rows = comparison.rows
    tracks = []
    for index, run in enumerate(comparison.runs):
        own = rows.run == index
        grid = np.arange(0, len(run.time), run.low_pass.step)
        left = np.full((len(grid), 2 * rows.n), np.nan)
        left[rows.sample[own] // run.low_pass.step, rows.channel[own]] = fit.residual[own]
        gain = run.low_pass.noise_gain
        tracks.append(
            _build_track(
                run.name, run.role, run.time[grid], left, rows.noise, gain, run.signals, grid
            )
        )
    return tracks


def held_out_track(
    run: RecordedRun, predictor: Predictor, after: Prediction, noise: ChannelNoise
) -> ResidualTrack:
    """Return the residual track of a predicted run."""
    left = np.full((len(run.time), 2 * run.n), np.nan)
    for kind, joint, used, (own,) in residuals(run, predictor.velocity, after):
        of_link = kind == "link_position"
        scale = (noise.deflection if of_link else noise.torque)[joint]
        if np.isfinite(scale):
            left[used, of_link * run.n + joint] = own / scale
    every = max(1, round(1.0 / (_MAX_TRACK_RATE * run.step)))
    time = run.time[::every]
    signals = predictor.nominal.signals
    nearest = np.clip(np.searchsorted(signals.time, time), 0, len(signals.time) - 1)
    return _build_track(run.name, run.role, time, left[::every], noise, 1.0, signals, nearest)


def _build_track(
    run: str,
    role: str,
    time: np.ndarray,
    left: np.ndarray,
    noise: ChannelNoise,
    gain: float,
    signals: RobotSignals,
    places: np.ndarray,
) -> ResidualTrack:
    constants: RobotConstants = signals.constants
    joints = constants.joints
    stroke = np.array([j.stroke for j in joints])
    angle, speed = signals.motor_position[places], signals.motor_velocity[places]
    load = signals.spring_torque[places]
    ranges = (
        np.maximum(np.ptp(stroke, axis=1), 1e-9),
        2.0 * np.array([max(j.fastest, 1e-9) for j in joints]),
        2.0 * np.array([max(j.largest_torque, 1e-9) for j in joints]),
    )
    softness = np.array([float(j.compliance(0.0)) if j.elastic else np.inf for j in joints])
    return ResidualTrack(
        run=run,
        role=role,
        time=time,
        left=left,
        unit=gain * np.concatenate([noise.torque, np.nan_to_num(noise.deflection) / softness]),
        velocity=speed,
        state=np.stack([v / r for v, r in zip((angle, speed, load), ranges, strict=True)], axis=2),
    )


def find_episodes(
    tracks: Sequence[ResidualTrack], others: Sequence[ResidualTrack] = ()
) -> tuple[Episode, ...]:
    """Find contact intervals in runs.

    `tracks`: runs to search in. `others`: further runs without contacts, whose states count as
    undisturbed.

    A channel with any strong residual that is no contact is not used.
    """
    strengths = [track.strength() for track in tracks]
    if not tracks:
        return ()
    quiet = np.zeros(tracks[0].left.shape[1], dtype=bool)
    while True:
        found = [
            _find_stretches(track, np.where(quiet, 0.0, strength))
            for track, strength in zip(tracks, strengths, strict=True)
        ]
        if not any(found) or _is_too_frequent([track.time for track in tracks], found):
            return ()
        known = _UndisturbedStates(tracks, found, others)
        wrong = quiet | ~known.understood
        for track, strength, stretches in zip(tracks, strengths, found, strict=True):
            for stretch in stretches:
                strong = np.flatnonzero(~quiet & _strong_channels(track, strength, stretch))
                alone = len(strong) == 1
                for channel in strong:
                    if not _is_contact(track, stretch, int(channel), known, alone=alone):
                        wrong[channel] = True
        if np.array_equal(wrong, quiet):
            break
        quiet = wrong
    return tuple(
        _build_episode(track, np.where(quiet, 0.0, strength), stretch)
        for track, strength, stretches in zip(tracks, strengths, found, strict=True)
        for stretch in stretches
    )


Stretch = tuple[float, float]


def _select_times(track: ResidualTrack, stretch: Stretch) -> np.ndarray:
    return (track.time >= stretch[0]) & (track.time <= stretch[1])


def _strong_channels(track: ResidualTrack, strength: np.ndarray, stretch: Stretch) -> np.ndarray:
    return np.asarray(strength[_select_times(track, stretch)].max(axis=0) > ONSET_RATIO)


def _find_stretches(track: ResidualTrack, strength: np.ndarray) -> list[Stretch]:
    """Return stretches of strong residual in any channel, joined if close."""
    going = np.zeros(len(track.time) + 2, dtype=bool)
    for channel in strength.T:
        on = np.concatenate([[False], channel > _DECAY_RATIO, [False]])
        edges = np.flatnonzero(np.diff(on.astype(int)))
        for first, last in zip(edges[::2], edges[1::2], strict=True):
            if channel[first:last].max() > ONSET_RATIO:
                going[first + 1 : last + 1] = True
    edges = np.flatnonzero(np.diff(going.astype(int)))
    found: list[Stretch] = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        begin, end = float(track.time[first]), float(track.time[last - 1])
        if found and begin - found[-1][1] < _RMS_WINDOW:
            begin = found.pop()[0]
        found.append((begin, end))
    return found


def _is_too_frequent(times: Sequence[np.ndarray], found: Sequence[Sequence[Stretch]]) -> bool:
    """True if stretches are too many or too long for contacts in runs of these times (K,)."""
    if sum(map(bool, found)) > max(1.0, _MAX_AFFECTED_RUNS * len(times)):
        return True
    return any(
        sum(end - begin for begin, end in own) > _MAX_RUN_SHARE * float(np.ptp(time))
        for time, own in zip(times, found, strict=True)
    )


class _UndisturbedStates:
    """Residuals by state outside of all stretches."""

    def __init__(
        self,
        tracks: Sequence[ResidualTrack],
        found: Sequence[list[Stretch]],
        others: Sequence[ResidualTrack],
    ) -> None:
        self._parts = [(track, np.ones(len(track.time), dtype=bool)) for track in others]
        for track, stretches in zip(tracks, found, strict=True):
            apart = np.ones(len(track.time), dtype=bool)
            for begin, end in stretches:
                # Samples just before and after are no independent recurrence of the state.
                apart &= (track.time < begin - 1.0) | (track.time > end + 1.0)
            self._parts.append((track, apart))

    @property
    def understood(self) -> np.ndarray:
        """Mask of the channels with small residuals outside of the stretches (2 n,)."""
        square, count = 0.0, 0.0
        for track, apart in self._parts:
            left = track.left[apart] / track.usual
            square = square + np.nansum(left**2, axis=0)
            count = count + np.isfinite(left).sum(axis=0)
        return np.asarray(square <= _MAX_BACKGROUND_RATIO**2 * np.maximum(count, 1))

    def explains(self, track: ResidualTrack, inside: np.ndarray, channel: int) -> bool:
        """True if residuals in the same states are unknown or similar."""
        joint = channel % track.velocity.shape[1]
        states, values = [], []
        for other, apart in self._parts:
            used = apart & np.isfinite(other.left[:, channel])
            states.append(other.state[used, joint])
            values.append(other.left[used, channel] / other.usual[channel])
        place, value = np.concatenate(states), np.concatenate(values)
        if len(place) < _NEIGHBOUR_COUNT:
            return True
        here = track.state[inside, joint]
        away, which = cKDTree(place).query(here, k=_NEIGHBOUR_COUNT)
        # Beyond the positions of all other parts there may be a stop.
        within = (here[:, 0] >= place[:, 0].min()) & (here[:, 0] <= place[:, 0].max())
        if np.mean((away[:, 0] < _STATE_DISTANCE) & within) < _MIN_REVISITED_SHARE:
            return True
        own = track.left[inside, channel] / track.usual[channel]
        beside = own - value[which].mean(axis=1)
        return float(beside @ beside) < (1.0 - _MIN_REPEATED_SHARE) * float(own @ own)


def _is_contact(
    track: ResidualTrack, stretch: Stretch, channel: int, known: _UndisturbedStates, *, alone: bool
) -> bool:
    """True if a stretch is slow, not against the motion, and not explained by the state.

    A brake acts on the torque of one joint only; there, in an arm of several joints, the motion
    must reverse to exclude one.
    """
    if stretch[1] - stretch[0] < _MIN_DURATION + _RMS_WINDOW:
        return False
    inside = _select_times(track, stretch) & np.isfinite(track.left[:, channel])
    left, time = track.left[inside, channel], track.time[inside]
    n = track.velocity.shape[1]
    count = int(np.clip(_FUNCTIONS_PER_SECOND * (stretch[1] - stretch[0]), 2, len(left) // 3))
    phase = (time - stretch[0]) / max(stretch[1] - stretch[0], 1e-9)
    slow = np.cos(np.pi * np.outer(phase, np.arange(count + 1)))

    def remaining(columns: np.ndarray) -> float:
        return float(np.sum((left - columns @ np.linalg.lstsq(columns, left)[0]) ** 2))

    along = remaining(slow)
    if along > (1.0 - _MIN_SLOW_SHARE) * float(left @ left):
        return False
    if channel < n and alone:
        side = np.sign(track.velocity[inside, channel])
        turns = bool(np.any(side != side[0]))
        if remaining(slow * side[:, None]) < _MIN_DRAG_RATIO * along or (n > 1 and not turns):
            return False
    return not known.explains(track, inside, channel)


def _build_episode(track: ResidualTrack, strength: np.ndarray, stretch: Stretch) -> Episode:
    inside = _select_times(track, stretch)
    n = track.velocity.shape[1]
    strong = _strong_channels(track, strength, stretch)
    left = np.abs(np.nan_to_num(track.left[inside]))
    time = track.time[inside]
    # The window extends the stretch by about half its length at both ends.
    above = time[np.any((left > 3.0 * track.usual)[:, strong], axis=1)]
    sizes = left.max(axis=0) * track.unit
    joints = [j for j in range(n) if strong[j] or strong[n + j]]
    return Episode(
        run=track.run,
        role=track.role,
        begin=float(above[0]) if above.size else stretch[0],
        end=float(above[-1]) if above.size else stretch[1],
        joints=tuple(j + 1 for j in joints),
        sizes=tuple(float(sizes[j] if strong[j] else sizes[n + j]) for j in joints),
    )


def episodes_of_force(load: TemporaryLoad, runs: Sequence[RecordedRun]) -> tuple[Episode, ...]:
    """Return the contact intervals of a force; none where they are too frequent for contacts."""
    if _is_too_frequent([run.time for run in runs], load.intervals):
        return ()
    changed = np.flatnonzero(load.torques > load.noise)
    return tuple(
        Episode(
            run=run.name,
            role=run.role,
            begin=begin,
            end=end,
            joints=tuple((changed + 1).tolist()),
            sizes=tuple(load.torques[changed].tolist()),
        )
        for run, own in zip(runs, load.intervals, strict=True)
        for begin, end in own
    )


def mask_episodes(run: RecordedRun, episodes: Sequence[Episode]) -> RecordedRun:
    """Return the run with torques and link positions masked during contact intervals."""
    out = np.zeros(len(run.time), dtype=bool)
    for each in episodes:
        if each.run == run.name:
            out |= each.holds(run.time)
    return _mask_samples(run, out)


def mask_load_changes(run: RecordedRun) -> RecordedRun:
    """Return the run masked where it grasps and releases the part that it carries.

    There the load passes from the support to the arm, not at one instant.
    """
    ends = np.array(run.carried).ravel()
    inner = ends[(ends > run.time[0]) & (ends < run.time[-1])]
    away = np.abs(run.time[:, None] - inner)
    return _mask_samples(run, np.any(away < _EXCLUSION_MARGIN, axis=1))


def _mask_samples(run: RecordedRun, out: np.ndarray) -> RecordedRun:
    if not out.any():
        return run

    def kept(values: np.ndarray) -> np.ndarray:
        return np.where(out[:, None], np.nan, values)

    link = None if run.link_position is None else kept(run.link_position)
    return replace(run, torque=kept(run.torque), link_position=link)
