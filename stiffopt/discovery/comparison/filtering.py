"""One zero-phase filter for every measured channel and every model term."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import fft

# Half the length of the kernel over rate / cutoff: short enough to lose little at the ends.
_HALF_LENGTH_CYCLES = 1.5
# Rows of a fit a second and Hz of the cutoff.
ROWS_PER_CYCLE = 2.5
# Of the polynomial that a motion goes on with beyond its ends.
_EXTRAPOLATION_DEGREE = 5
# Fourth-order differences at the first two of five samples, times 12.
_END_DIFFERENCES = np.array([[-25.0, 48.0, -36.0, 16.0, -3.0], [-3.0, -10.0, 18.0, -6.0, 1.0]])


@dataclass(frozen=True)
class ZeroPhaseFilter:
    """Symmetric low-pass of finite length: rows of a fit depend on few samples about them.

    Parameters
    ----------
    rate : float
        Of the samples [Hz].
    cutoff : float
        [Hz], below half the rate.
    """

    rate: float
    cutoff: float

    def __call__(self, samples: np.ndarray) -> np.ndarray:
        """Filter along the first axis; beyond the ends the samples go on point-symmetrically."""
        samples = np.asarray(samples, dtype=float)
        half = self.settling
        if len(samples) <= half + 1:
            return samples.copy()
        before = 2.0 * samples[:1] - samples[half:0:-1]
        after = 2.0 * samples[-1:] - samples[-2 : -half - 2 : -1]
        return self._convolve_padded(np.concatenate([before, samples, after]))

    def filter_motion(self, samples: np.ndarray) -> np.ndarray:
        """Filter what is smooth along the first axis: beyond the ends it goes on as a polynomial.

        Recordings begin and end in motion; a point-symmetric end has no acceleration.
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
        """Filtered values (g, c) of channels (K, c) at every `step`-th sample, without the ends.

        The first is that of sample `step * first_whole`.
        """
        step, length = self.step, len(self._kernel)
        begin = step * self.first_unpadded_row - self.settling
        samples = np.ascontiguousarray(samples, dtype=float)
        count = max(0, -(-(len(samples) - length + 1 - begin) // step))
        along, across = samples.strides
        # Windows of the same memory; numpy's own view of them takes longer than a short product.
        windows = np.ndarray(
            (count, samples.shape[1], length),
            buffer=samples,
            offset=begin * along if count else 0,
            strides=(step * along, across, along),
        )
        return np.asarray(windows @ self._kernel)

    @property
    def first_unpadded_row(self) -> int:
        """Number of the first of every `step`-th samples that the filter has not made up."""
        return -(-self.settling // self.step)

    @cached_property
    def noise_gain(self) -> float:
        """Standard deviation that white noise of unit standard deviation keeps."""
        return float(np.sqrt(np.sum(self._kernel**2)))

    @property
    def step(self) -> int:
        """Samples between rows of a fit: closer ones say nothing new after the filter."""
        return max(1, int(self.rate / (ROWS_PER_CYCLE * self.cutoff)))

    @cached_property
    def settling(self) -> int:
        """Samples at either end that the filter makes up in part."""
        return int(np.ceil(_HALF_LENGTH_CYCLES * self.rate / self.cutoff))

    @cached_property
    def _kernel(self) -> np.ndarray:
        # Weights of the sharp low-pass under Hamming's window; scipy.signal, which has both, takes
        # half a second to import.
        length = 2 * self.settling + 1
        kernel = np.sinc(
            2.0 * self.cutoff / self.rate * np.arange(-self.settling, self.settling + 1)
        )
        kernel *= np.hamming(length)
        return np.asarray(kernel / kernel.sum())


def derivative(samples: np.ndarray, dt: float) -> np.ndarray:
    """Difference of fourth order along the first axis, one-sided at the ends."""
    if len(samples) < 5:
        return np.asarray(np.gradient(samples, dt, axis=0))
    slope = np.empty_like(samples, dtype=float)
    slope[2:-2] = samples[:-4] - 8.0 * samples[1:-3] + 8.0 * samples[3:-1] - samples[4:]
    slope[:2] = np.tensordot(_END_DIFFERENCES, samples[:5], 1)
    slope[-2:] = -np.tensordot(_END_DIFFERENCES, samples[::-1][:5], 1)[::-1]
    return slope / (12.0 * dt)
