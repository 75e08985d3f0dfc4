"""Filter kernel and convolution against scipy's."""

import numpy as np
import pytest
from scipy.signal import fftconvolve, firwin

from stiffopt.discovery.comparison.filtering import ZeroPhaseFilter


@pytest.mark.parametrize(("rate", "cutoff"), [(100.0, 10.0), (250.0, 7.5), (1000.0, 40.0)])
def test_kernel_and_convolution_match_scipy(rate, cutoff):
    low_pass = ZeroPhaseFilter(rate, cutoff)
    taps = firwin(2 * low_pass.settling + 1, cutoff, fs=rate)
    np.testing.assert_allclose(low_pass._kernel, taps, rtol=0.0, atol=1e-12)
    samples = np.random.default_rng(3).normal(size=(4 * len(taps), 2))
    expected = fftconvolve(samples, taps[:, None], mode="valid", axes=0)
    np.testing.assert_allclose(low_pass._convolve_padded(samples), expected, rtol=0.0, atol=1e-12)
