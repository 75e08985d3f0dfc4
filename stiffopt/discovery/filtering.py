"""One zero-phase filter for every measured channel and every model term."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.signal import butter, sosfiltfilt

_ORDER = 4


@dataclass(frozen=True)
class ZeroPhaseFilter:
    """Butterworth low-pass run forwards and backwards.

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
        """Filter along the first axis."""
        if len(samples) <= self._padding:
            return np.array(samples, dtype=float)
        return np.asarray(sosfiltfilt(self._sections, samples, axis=0, padlen=self._padding))

    @cached_property
    def noise_gain(self) -> float:
        """Standard deviation that white noise of unit standard deviation keeps."""
        pulse = np.zeros(4 * int(self.rate / self.cutoff) + 201)
        pulse[len(pulse) // 2] = 1.0
        return float(np.sqrt(np.sum(self(pulse) ** 2)))

    @property
    def step(self) -> int:
        """Samples between rows of a fit: closer ones say nothing new after the filter."""
        return max(1, int(self.rate / (2.5 * self.cutoff)))

    @property
    def settling(self) -> int:
        """Samples at either end that the filter makes up in part."""
        return int(1.2 * self.rate / self.cutoff)

    @cached_property
    def _sections(self) -> np.ndarray:
        return np.asarray(butter(_ORDER, self.cutoff / (self.rate / 2), output="sos"))

    @property
    def _padding(self) -> int:
        return int(2 * self.rate / self.cutoff)


def derivative(samples: np.ndarray, dt: float) -> np.ndarray:
    """Central difference of fourth order along the first axis, of second order at the ends."""
    slope = np.gradient(samples, dt, axis=0)
    if len(samples) > 4:
        slope[2:-2] = (samples[:-4] - 8.0 * samples[1:-3] + 8.0 * samples[3:-1] - samples[4:]) / (
            12.0 * dt
        )
    return np.asarray(slope)
