"""A run that does not belong to the others: of another arm, or of one that carries something."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.discovery.sanity.explanations import Explanations
from stiffopt.discovery.sanity.samples import Samples, sampled
from stiffopt.recording.run import RecordedRun

# The nominal model leaves at least this share of a torque's variance in an odd run, and so many
# times more than in any other run; shares below the last are as good as nothing.
_LEFT, _TIMES, _NOTHING = 0.05, 8.0, 0.005
# Where it leaves more of others too, they are no measure: what is wrong is wrong in all runs.
_OTHERS = 0.3
# Runs that are compared.
_MOST_RUNS = 60
# Of the ranges that others moved in, what is near them still; fewer instants decide nothing.
_BESIDE, _FEWEST = 0.05, 30


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
    elsewhere : bool
        Whether it fits where the others were as well, or was hardly there: it moves faster or
        further than these, where a robot may lack what only shows there.
    """

    run: RecordedRun
    search: Explanations
    joints: tuple[int, ...]
    left: np.ndarray
    others: np.ndarray
    elsewhere: bool


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
        odd = _odd(shares[k], others)
        if odd.any():
            joints = tuple(int(j) for j in np.flatnonzero(odd))
            beside = [other.samples for _, other in searches if other is not search]
            there = _where_others_were(search.samples, beside)
            elsewhere = (
                there is None or not _odd(Explanations(together.robot, there).strict, others).any()
            )
            found.append(OddRun(run, search, joints, shares[k], others, elsewhere))
    return found


def _odd(shares: np.ndarray, others: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        far = (shares > _LEFT) & (shares > _TIMES * np.maximum(others, _NOTHING))
        return np.asarray(far & (others < _OTHERS))


def _where_others_were(samples: Samples, others: Sequence[Samples]) -> Samples | None:
    """Instants at which all joints are where others were, no faster; None of too few."""
    inside = np.ones(len(samples.position), dtype=bool)
    for name in ("position", "velocity", "acceleration"):
        beside = np.vstack([getattr(each, name) for each in others])
        low, high = np.nanmin(beside, axis=0), np.nanmax(beside, axis=0)
        margin = _BESIDE * (high - low)
        own = getattr(samples, name)
        inside &= ~((own < low - margin) | (own > high + margin)).any(axis=1)
    if inside.sum() < _FEWEST:
        return None
    names = ("position", "velocity", "acceleration", "torque")
    return replace(samples, **{name: getattr(samples, name)[inside] for name in names})
