"""Rows of a fit and noise of the channels, stated by the set or estimated from recordings."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stiffopt.discovery.comparison.prepared_run import PreparedRun
from stiffopt.recording.channel import DEVIATION_PER_MAD
from stiffopt.recording.nominal import Noise
from stiffopt.units import joint_unit


@dataclass(frozen=True, eq=False)
class ChannelNoise:
    """Standard deviation of each unfiltered channel."""

    # torque, deflection (n,) [N m], [rad]
    torque: np.ndarray
    deflection: np.ndarray

    @property
    def stacked(self) -> np.ndarray:
        """Deviations (2 n,) of all channels, torques first."""
        return np.concatenate([self.torque, self.deflection])


class ChannelRows:
    """Rows of runs in a fit: filtered, decimated, masked, divided by noise, assigned to blocks.

    Channels are numbered: torque of joint 1 to n, then deflection of joint 1 to n.

    `blocks`: cross-validation blocks per run; 1 takes each run as a whole.

    `channel`, `block` (m,) of int: channel and block of every row.
    """

    def __init__(self, runs: Sequence[PreparedRun], noise: ChannelNoise, blocks: int = 1) -> None:
        self.runs, self.noise = tuple(runs), noise
        self.n = self.runs[0].torque.shape[1]
        self._places = [self._locate_rows(run, blocks) for run in self.runs]
        self.channel = np.concatenate([p.channel for p in self._places])
        self.block = np.concatenate(
            [p.block + k * blocks for k, p in enumerate(self._places)]
        ).astype(int)
        self.size = len(self.channel)
        sizes = np.array([[len(where) for where in p.samples] for p in self._places])
        self._first_rows = (np.cumsum(sizes) - sizes.ravel()).reshape(sizes.shape)
        counts = np.bincount(self.channel, minlength=2 * self.n)
        self.channels = np.flatnonzero(counts > 0)
        self.counts = counts

    def _locate_rows(self, run: PreparedRun, blocks: int) -> _RowPlaces:
        """Return the samples that become rows, channel by channel."""
        step = run.low_pass.step
        grid = np.arange(0, len(run.time), step)
        sizes, samples, channels, block_ids = [], [], [], []
        # Rows whose filter spans a border belong to no block: blocks must not share samples.
        edges = np.linspace(0, len(run.time), blocks + 1)
        own = np.clip(np.searchsorted(edges, grid, "right") - 1, 0, blocks - 1)
        inner = edges[1:-1]
        near = (
            np.min(np.abs(grid[:, None] - inner), axis=1) < run.low_pass.settling
            if inner.size
            else np.zeros(len(grid), dtype=bool)
        )
        for kind, used in enumerate((run.torque_used, run.deflection_used)):
            for j in range(self.n):
                kept = used[grid, j] & ~near
                sizes.append(int(kept.sum()))
                samples.append(grid[kept])
                channels.append(np.full(sizes[-1], kind * self.n + j))
                block_ids.append(own[kept])
        first = run.low_pass.first_unpadded_row
        return _RowPlaces(
            samples=tuple(samples),
            rows=tuple(where // step - first for where in samples),
            channel=np.concatenate(channels),
            block=np.concatenate(block_ids),
        )

    def flatten(
        self, torque: Sequence[np.ndarray | None], deflection: Sequence[np.ndarray | None]
    ) -> np.ndarray:
        """Return one column of rows from additions (K, n) to the channels of every run."""
        out = np.zeros(self.size)
        for number, both in enumerate(zip(torque, deflection, strict=True)):
            self.fill_run(out, number, *both)
        return out

    def fill_run(
        self, out: np.ndarray, number: int, torque: np.ndarray | None, deflection: np.ndarray | None
    ) -> None:
        """Write additions (K, n) to the channels of one run (from 0) into its rows of `out`."""
        run, places, begins = self.runs[number], self._places[number], self._first_rows[number]
        for kind, values in enumerate((torque, deflection)):
            own = slice(kind * self.n, (kind + 1) * self.n)
            if values is None or not any(len(where) for where in places.samples[own]):
                continue
            scale = (self.noise.torque, self.noise.deflection)[kind]
            acted = np.flatnonzero(np.any(values, axis=0))
            passed = run.low_pass.decimate(values[:, acted])
            for j, column in zip(acted, passed.T, strict=True):
                where = places.rows[kind * self.n + j]
                begin = begins[kind * self.n + j]
                out[begin : begin + len(where)] = column[where] / (
                    scale[j] * run.low_pass.noise_gain
                )

    def channel_columns(
        self, number: int, own: Sequence[tuple[str, int, int, np.ndarray]], count: int
    ) -> Iterator[tuple[int, np.ndarray]]:
        """Yield columns of rows from additions to single channels of one run (from 0).

        `own`: kind of channel, joint and column (from 0), and the addition (K,). Yields the first
        row of each affected channel, and its columns (rows, count) from there on.
        """
        if not own:
            return
        run, places, begins = self.runs[number], self._places[number], self._first_rows[number]
        passed = run.low_pass.decimate(np.stack([values for *_, values in own]).T)
        found: dict[int, np.ndarray] = {}
        for (kind, joint, column, _), values in zip(own, passed.T, strict=True):
            of_kind = kind == "deflection"
            scale = self.noise.deflection if of_kind else self.noise.torque
            channel = of_kind * self.n + joint
            where = places.rows[channel]
            columns = found.setdefault(channel, np.zeros((len(where), count)))
            columns[:, column] += values[where] / (scale[joint] * run.low_pass.noise_gain)
        for channel, columns in found.items():
            yield int(begins[channel]), columns

    @cached_property
    def run(self) -> np.ndarray:
        """Number (m,) of the run of every row, from 0."""
        return np.repeat(np.arange(len(self.runs)), [len(p.channel) for p in self._places])

    @cached_property
    def sample(self) -> np.ndarray:
        """Number (m,) of the sample of its run that every row is of."""
        return np.concatenate([where for p in self._places for where in p.samples])

    def sample_signal(self, signal: Callable[[PreparedRun], np.ndarray]) -> np.ndarray:
        """Return a signal (K, ...) of each run at every row (m, ...)."""
        parts = []
        for run, places in zip(self.runs, self._places, strict=True):
            values = np.asarray(signal(run))
            parts += [values[where] for where in places.samples]
        return np.concatenate(parts)


@dataclass(frozen=True, eq=False)
class _RowPlaces:
    samples: tuple[np.ndarray, ...]
    rows: tuple[np.ndarray, ...]
    channel: np.ndarray
    block: np.ndarray


def part_numbers(time: np.ndarray, parts: int, begin: float = 0.0) -> np.ndarray:
    """Return the number (K,) of the equal part of a run that each of its times is in.

    `begin`: share of the run before the first part, which gets its number.
    """
    share = (elapsed_shares(time) - begin) / (1.0 - begin)
    return np.asarray(np.clip((share * parts).astype(int), 0, parts - 1))


def elapsed_shares(time: np.ndarray) -> np.ndarray:
    """Return the share (K,) of a run that has elapsed at each of its times."""
    return np.asarray((time - time[0]) / float(time[-1] - time[0]))


# Standard deviation of rounding to one count.
_QUANTISATION_SD = 12.0**-0.5
# Smallest estimated noise over a channel's range: smoothed recordings hold less, and no robot model
# is more exact.
_MIN_NOISE_SHARE = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownNoise:
    """Noise of the channels and its origin."""

    channels: ChannelNoise  # standard deviations of torque [N m] and deflection [rad] (n,)
    # torque_stated, deflection_stated (n,) of bool: True where the set states it; otherwise
    # estimated.
    torque_stated: np.ndarray
    deflection_stated: np.ndarray
    # Torques are of poses at rest: their noise includes friction of unknown direction.
    at_rest: bool = False

    def assumptions(self, prismatic: np.ndarray) -> list[str]:
        """Return sentences about estimated noise, from which joints are `prismatic`."""
        found = []
        for name, values, stated, unit in (
            ("Torque", self.channels.torque, self.torque_stated, "N m"),
            ("Link encoder", self.channels.deflection, self.deflection_stated, "rad"),
        ):
            guessed = np.flatnonzero(~stated & np.isfinite(values))
            each = ", ".join(
                f"{j + 1}: {values[j]:.3g} {joint_unit(unit, bool(prismatic[j]))}" for j in guessed
            )
            if guessed.size and self.at_rest and name == "Torque":
                found.append(
                    "Poses at rest: friction holds a pose with any torque within its band, and its"
                    f" direction is unknown; the scatter of the poses (joint {each}, one standard"
                    " deviation) counts as noise. Such data cannot show friction, rotor inertia,"
                    " damping, backlash in motion or delays: these need runs in motion."
                )
                continue
            if guessed.size:
                found.append(
                    f"{name} noise is estimated from the training runs above the filter's cutoff"
                    f" (joint {each})."
                )
        return found


def known_noise(stated: Noise, runs: Sequence[PreparedRun]) -> KnownNoise:
    """Return the noise of the unfiltered channels.

    `runs`: training runs, for channels without stated noise.

    An estimate is the spread of the samples above the cutoff of the zero-phase low-pass, scaled to
    white noise; by medians, so that jerks at reversals hardly count. Motion above the cutoff counts
    as noise. A channel that no run has is nan. Rounding to one count is the lower limit.
    """
    torque_count = np.median([run.torque_count for run in runs], axis=0)
    torque, torque_stated = _channel_noise(
        stated.torque, None, [run.torque for run in runs], runs, (torque_count,)
    )
    if runs[0].at_rest:
        torque = np.fmax(torque * torque_stated, scatter_at_rest(runs))
        torque_stated = np.zeros_like(torque_stated)
    deflection, deflection_stated = _channel_noise(
        stated.link_position,
        stated.link_position_resolution,
        [run.deflection for run in runs],
        runs,
        (stated.link_position_resolution, stated.position_resolution),
    )
    return KnownNoise(
        channels=ChannelNoise(torque, deflection),
        torque_stated=torque_stated,
        deflection_stated=deflection_stated,
        at_rest=runs[0].at_rest,
    )


def noise_above_cutoff(runs: Sequence[PreparedRun]) -> np.ndarray:
    """Return the noise (2 n,) of runs above the filter's cutoff, torques first.

    Channels without samples are nan.
    """
    n = runs[0].torque.shape[1]
    kinds = ([run.torque for run in runs], [run.deflection for run in runs])
    return np.array(
        [
            _estimate_noise([samples[:, j] for samples in kind], runs)
            for kind in kinds
            for j in range(n)
        ]
    )


def _channel_noise(
    stated: np.ndarray | None,
    count: np.ndarray | None,
    samples: Sequence[np.ndarray],
    runs: Sequence[PreparedRun],
    counts: Sequence[np.ndarray | None],
) -> tuple[np.ndarray, np.ndarray]:
    n = samples[0].shape[1]
    own = np.zeros(n) if stated is None else np.nan_to_num(stated)
    rounding = (
        np.sqrt(sum((np.zeros(n) if c is None else c) ** 2 for c in counts)) * _QUANTISATION_SD
    )
    floor = np.zeros(n) if count is None else count * _QUANTISATION_SD
    values, known = np.maximum(own, floor), own > 0.0
    for j in np.flatnonzero(~known):
        guess = _estimate_noise([s[:, j] for s in samples], runs)
        values[j] = np.maximum(guess, rounding[j])
    return values, known


def scatter_at_rest(runs: Sequence[PreparedRun]) -> np.ndarray:
    """Return the scatter (n,) of the torques of poses at rest beside any weight of the arm [N m].

    Friction holds a pose with any torque within its band: beside sensor noise, the scatter is that
    of friction of unknown direction. First moments of all bodies and a constant are fitted to each
    joint alone.
    """
    found = []
    for j in range(runs[0].torque.shape[1]):
        used = [np.isfinite(run.torque[:, j]) for run in runs]
        left = np.concatenate(
            [(r.torque - r.signals.drive_torque)[u, j] for r, u in zip(runs, used, strict=True)]
        )
        count = 10 * runs[0].torque.shape[1]
        columns = np.vstack(
            [
                np.column_stack(
                    [r.signals.body_regressor[..., k][u, j] for k in range(count)]
                    + [np.ones(int(u.sum()))]
                )
                for r, u in zip(runs, used, strict=True)
            ]
        )
        if len(left) < 2:
            found.append(float("nan"))
            continue
        fitted, _, rank, _ = np.linalg.lstsq(columns, left, rcond=1e-9)
        free = max(len(left) - int(rank), 1)
        found.append(float(np.sqrt(np.sum((left - columns @ fitted) ** 2) / free)))
    return np.array(found)


def _estimate_noise(channels: Sequence[np.ndarray], runs: Sequence[PreparedRun]) -> float:
    spreads, extent = [], 0.0
    for run, channel in zip(runs, channels, strict=True):
        known = np.isfinite(channel)
        if known.sum() < 10:
            continue
        places = np.arange(len(channel))
        filled = np.interp(places, places[known], channel[known])
        rest = (filled - run.low_pass(filled))[known]
        pulse = np.zeros(2 * run.low_pass.settling + 201)
        pulse[len(pulse) // 2] = 1.0
        gain = float(np.linalg.norm(pulse - run.low_pass(pulse)))
        spreads.append(DEVIATION_PER_MAD * float(np.median(np.abs(rest - np.median(rest)))) / gain)
        extent = max(extent, float(np.ptp(filled)))
    if not spreads:
        return float("nan")
    return max(float(np.median(spreads)), _MIN_NOISE_SHARE * extent, np.finfo(float).tiny)
