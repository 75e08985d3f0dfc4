"""Zero-phase low-pass of all measured channels and model terms, decimation, resampling, gaps."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import fft
from scipy.interpolate import CubicSpline

from stiffopt.recording.clock import MIN_GAP_STEPS
from stiffopt.recording.run import RecordedRun

# Half length of the kernel in cycles of the cutoff; short, to lose few samples at the ends.
_HALF_LENGTH_CYCLES = 1.5
# Rows of a fit per second and Hz of the cutoff.
ROWS_PER_CYCLE = 2.5
# Cutoff of slow motion [Hz].
SLOW_CUTOFF = 8.0
# Largest step between samples that a spline bridges, over the median step: two may be missing.
_MAX_SPLINE_STEPS = 3.5
# Degree of the polynomial that extrapolates a motion beyond its ends.
_EXTRAPOLATION_DEGREE = 5
# Fourth-order differences at the first two of five samples, times 12.
_END_DIFFERENCES = np.array([[-25.0, 48.0, -36.0, 16.0, -3.0], [-3.0, -10.0, 18.0, -6.0, 1.0]])


@dataclass(frozen=True)
class ZeroPhaseFilter:
    """Symmetric FIR low-pass: rows of a fit depend on few neighbouring samples."""

    rate: float  # sampling rate [Hz]
    cutoff: float  # cutoff frequency [Hz], below half the rate

    def __call__(self, samples: np.ndarray) -> np.ndarray:
        """Filter along the first axis, with point-symmetric extension at the ends."""
        samples = np.asarray(samples, dtype=float)
        half = self.settling
        if len(samples) <= half + 1:
            return samples.copy()
        before = 2.0 * samples[:1] - samples[half:0:-1]
        after = 2.0 * samples[-1:] - samples[-2 : -half - 2 : -1]
        return self._convolve_padded(np.concatenate([before, samples, after]))

    def filter_motion(self, samples: np.ndarray) -> np.ndarray:
        """Filter a smooth motion along the first axis, extrapolated at the ends.

        Recordings begin and end in motion; a point-symmetric extension has no acceleration there.
        """
        samples = np.asarray(samples, dtype=float)
        half = self.settling
        near = 2 * half + 1
        if len(samples) < near:
            return self(samples)
        inside = np.arange(near) / near
        beyond = np.arange(-half, 0) / near
        powers = np.arange(_EXTRAPOLATION_DEGREE + 1)
        weights = beyond[:, None] ** powers @ np.linalg.pinv(inside[:, None] ** powers)
        before = np.tensordot(weights, samples[:near], 1)
        after = np.tensordot(weights, samples[::-1][:near], 1)[::-1]
        return self._convolve_padded(np.concatenate([before, samples, after]))

    def _convolve_padded(self, padded: np.ndarray) -> np.ndarray:
        kernel = self._kernel.reshape(-1, *(1,) * (padded.ndim - 1))
        count = len(padded) + len(kernel) - 1
        size = fft.next_fast_len(count, True)
        spectrum = fft.rfftn(padded, [size], axes=[0]) * fft.rfftn(kernel, [size], axes=[0])
        whole = fft.irfftn(spectrum, [size], axes=[0])
        return np.asarray(whole[len(kernel) - 1 : len(padded)])

    def decimate(self, samples: np.ndarray) -> np.ndarray:
        """Return filtered channels (g, c) at every `step`-th sample, unpadded.

        The first row is that of sample `step * first_unpadded_row`.
        """
        step, length = self.step, len(self._kernel)
        begin = step * self.first_unpadded_row - self.settling
        channels = np.ascontiguousarray(samples.T, dtype=float)
        count = max(0, -(-(len(samples) - length + 1 - begin) // step))
        across, along = channels.strides
        # Overlapping windows without a copy; numpy's sliding_window_view takes longer than the
        # product.
        windows = np.ndarray(
            (count, len(channels), length),
            buffer=channels,
            offset=begin * along if count else 0,
            strides=(step * along, across, along),
        )
        return np.asarray(windows @ self._kernel)

    @property
    def first_unpadded_row(self) -> int:
        """Index of the first decimated row that depends on recorded samples only."""
        return -(-self.settling // self.step)

    @cached_property
    def noise_gain(self) -> float:
        """Standard deviation of filtered white noise of unit standard deviation."""
        return float(np.sqrt(np.sum(self._kernel**2)))

    @cached_property
    def row_correlation(self) -> float:
        """Correlation of neighbouring rows of filtered white noise."""
        step, kernel = self.step, self._kernel
        return (
            float(kernel[step:] @ kernel[:-step] / (kernel @ kernel)) if step < len(kernel) else 0.0
        )

    @property
    def step(self) -> int:
        """Decimation factor of rows: closer rows carry no further information."""
        return max(1, int(self.rate / (ROWS_PER_CYCLE * self.cutoff)))

    @cached_property
    def settling(self) -> int:
        """Half length of the kernel in samples: rows nearer to an end depend on padding."""
        return int(np.ceil(_HALF_LENGTH_CYCLES * self.rate / self.cutoff))

    @cached_property
    def _kernel(self) -> np.ndarray:
        # Windowed sinc with Hamming window; importing scipy.signal for it takes half a second.
        length = 2 * self.settling + 1
        kernel = np.sinc(
            2.0 * self.cutoff / self.rate * np.arange(-self.settling, self.settling + 1)
        )
        kernel *= np.hamming(length)
        return np.asarray(kernel / kernel.sum())


@dataclass(frozen=True)
class PoseFilter(ZeroPhaseFilter):
    """Identity in place of the low-pass, for poses at rest: rows have no neighbours in time."""

    rate: float = 1.0
    cutoff: float = 1.0

    @cached_property
    def settling(self) -> int:
        """No row depends on another."""
        return 0


def derivative(samples: np.ndarray, dt: float) -> np.ndarray:
    """Return the fourth-order difference along the first axis, one-sided at the ends."""
    if len(samples) < 5:
        return np.asarray(np.gradient(samples, dt, axis=0))
    slope = np.empty_like(samples, dtype=float)
    slope[2:-2] = samples[:-4] - 8.0 * samples[1:-3] + 8.0 * samples[3:-1] - samples[4:]
    slope[:2] = np.tensordot(_END_DIFFERENCES, samples[:5], 1)
    slope[-2:] = -np.tensordot(_END_DIFFERENCES, samples[::-1][:5], 1)[::-1]
    return slope / (12.0 * dt)


def resample_uniform(run: RecordedRun) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return time, motor, link and torque on a uniform clock: motions by splines, torque linear."""
    step = run.step
    count = int(np.floor((run.time[-1] - run.time[0]) / step + 1e-6)) + 1
    time = run.time[0] + step * np.arange(count)
    empty = np.full_like(run.position, np.nan)
    channels = (run.position, empty if run.link_position is None else run.link_position, run.torque)
    if count == len(run.time) and np.allclose(time, run.time, rtol=0.0, atol=1e-3 * step):
        return (time, *(np.array(c, dtype=float) for c in channels))
    motor, link, torque = channels
    motion = (interpolate_motion(run.time, position, time) for position in (motor, link))
    return (time, *motion, interpolate_linear(run.time, torque, time))


def interpolate_motion(stamps: np.ndarray, samples: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return positions (K, n) at other times (R, n) by splines; nan in empty columns.

    A straight line over one missing sample cuts a turn short by 20 um at 10 m/s^2, which excites
    the joint springs. Longer gaps are mostly motors at rest: linear.
    """
    bridged = interpolate_linear(stamps, samples, time)
    for out, column in zip(bridged.T, samples.T, strict=True):
        known = np.isfinite(column)
        if np.count_nonzero(known) < 2:
            out[:] = np.nan
            continue
        stamps_known = stamps[known]
        apart = np.diff(stamps_known)[
            np.clip(np.searchsorted(stamps_known, time) - 1, 0, len(stamps_known) - 2)
        ]
        near = (
            (apart < _MAX_SPLINE_STEPS * np.median(np.diff(stamps_known)))
            & (time > stamps_known[0])
            & (time < stamps_known[-1])
        )
        out[near] = CubicSpline(stamps_known, column[known])(time[near])
    return bridged


def interpolate_linear(stamps: np.ndarray, samples: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return columns (K, n) at other times (R, n), across missing samples; nan in empty columns."""
    columns = []
    for column in samples.T:
        known = np.isfinite(column)
        if not known.any():
            columns.append(np.full(len(time), np.nan))
            continue
        columns.append(np.interp(time, stamps[known], column[known]))
    return np.column_stack(columns)


def bridge_gaps(samples: np.ndarray) -> np.ndarray:
    """Return samples with missing ones interpolated; empty channels stay nan."""
    out = samples.copy()
    for column in out.T:
        missing = ~np.isfinite(column)
        if missing.any() and not missing.all():
            places = np.arange(len(column))
            column[missing] = np.interp(places[missing], places[~missing], column[~missing])
    return out


def fill_missing(samples: np.ndarray) -> np.ndarray:
    """Return samples with missing ones interpolated; empty channels are zero."""
    filled = bridge_gaps(samples)
    return np.where(np.isfinite(filled), filled, 0.0)


def near_gaps(stamps: np.ndarray, step: float, time: np.ndarray, reach: int) -> np.ndarray:
    """Return True for instants (K,) within gaps between stamps or within `reach` steps of these."""
    near = np.zeros(len(time), dtype=bool)
    margin = reach * step
    for k in np.flatnonzero(np.diff(stamps) > MIN_GAP_STEPS * step):
        near |= (time > stamps[k] - margin) & (time < stamps[k + 1] + margin)
    return near


@dataclass(frozen=True, eq=False)
class SlowMotion:
    """Motion and torque of a run on a uniform clock, in a band that weight and friction show in."""

    time: np.ndarray  # (K,) [s]
    dt: float  # [s]
    low_pass: ZeroPhaseFilter
    # position, velocity, acceleration, torque (K, n): filtered; gaps are bridged.
    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    torque: np.ndarray


def filter_slow_motion(run: RecordedRun) -> SlowMotion:
    """Return the slow motion of a run, without encoder noise and vibration."""
    time, position, _, torque = resample_uniform(run)
    dt = float(time[1] - time[0])
    low_pass = ZeroPhaseFilter(1.0 / dt, min(SLOW_CUTOFF, 0.2 / dt))
    q = low_pass.filter_motion(bridge_gaps(position))
    v = derivative(q, dt)
    smooth = low_pass(bridge_gaps(torque))
    return SlowMotion(time, dt, low_pass, q, v, derivative(v, dt), smooth)
