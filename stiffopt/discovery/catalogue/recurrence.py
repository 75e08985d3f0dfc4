"""Recurrences over samples, for effects with memory."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dtbtrs


def first_order_lag(values: np.ndarray, kept: float) -> np.ndarray:
    """Return the first-order lag of a signal (K,); a step keeps the share `kept`."""
    added = (1.0 - kept) * values
    added[0] = values[0]
    return linear_recurrence(np.full(len(added), float(kept)), added)


def linear_recurrence(kept: np.ndarray, added: np.ndarray) -> np.ndarray:
    """Return x_k = kept_k x_k-1 + added_k (K,) from added_0 on, by bidiagonal equations."""
    band = np.ones((2, len(kept)))
    band[1, :-1] = -kept[1:]
    return np.asarray(dtbtrs(band, added, uplo="L", diag="U")[0])
