"""A run that does not belong to the others: of another arm, or of one that carries something."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.sanity.explanations import Explanations
from stiffopt.discovery.sanity.samples import sampled
from stiffopt.recording.run import RecordedRun

# The nominal model leaves at least this share of a torque's variance in an odd run, and so many
# times more than in any other run; shares below the last are as good as nothing.
_LEFT, _TIMES, _NOTHING = 0.05, 8.0, 0.005
# Runs that are compared.
_MOST_RUNS = 60


@dataclass(frozen=True, eq=False)
class OddRun:
    """A run, the joints (from 0) that tell it, and the shares that it and the others leave.

    Parameters
    ----------
    run : RecordedRun
    search : Explanations
        Of this run alone.
    joints : tuple of int
    left, others : array (n,)
        In this run, and the most in any other.
    """

    run: RecordedRun
    search: Explanations
    joints: tuple[int, ...]
    left: np.ndarray
    others: np.ndarray


def odd_runs(together: Explanations, runs: Sequence[RecordedRun]) -> list[OddRun]:
    """Runs in which the nominal model fails where it holds in all the others.

    Each run is given friction of its own, so that a cold arm is no other one. Of two runs the one
    that the nominal model fits is believed.
    """
    searches: list[tuple[RecordedRun, Explanations]] = []
    for run in runs[:_MOST_RUNS]:
        samples = sampled([run])
        if samples is not None:
            searches.append((run, Explanations(together.robot, samples)))
    if len(searches) < 2:
        return []
    shares = np.array([search.strict for _, search in searches])
    found = []
    for k, (run, search) in enumerate(searches):
        rest = np.delete(shares, k, axis=0)
        known = np.isfinite(rest).any(axis=0)
        others = np.where(known, np.nanmax(np.where(np.isfinite(rest), rest, -1.0), axis=0), np.nan)
        with np.errstate(invalid="ignore"):
            odd = (shares[k] > _LEFT) & (shares[k] > _TIMES * np.maximum(others, _NOTHING))
        if odd.any():
            joints = tuple(int(j) for j in np.flatnonzero(odd))
            found.append(OddRun(run, search, joints, shares[k], others))
    return found
