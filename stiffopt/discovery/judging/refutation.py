"""Refutation of findings by held-out runs, against models that are fitted without them.

Findings are chosen and fitted by the training runs alone. Held-out runs support none: they may
refute one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.comparison.channel_rows import part_numbers
from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.design_matrix import STRETCH_DURATION
from stiffopt.discovery.comparison.located_effect import Extension, LocatedEffect
from stiffopt.discovery.names import Channel
from stiffopt.discovery.prediction import Predictor, residuals

# Key of a located effect.
_Key = tuple[object, ...]


@dataclass(frozen=True)
class HeldOutEvidence:
    """Evidence of held-out runs on a finding."""

    # Root mean square residual of its channel with it over that of a model fitted without it.
    ratio: float
    # Likelihood of its gain over that of no gain; 1 where it gains. By the spread of the gain
    # between stretches (Student's t): errors of a law are correlated within a stretch, so that the
    # number of samples says nothing.
    likelihood: float


class Refutation:
    """Predictions of held-out runs by models that are fitted without one finding each.

    `comparison`: of the training runs, with the noise estimated beside `effects`, which are all
    that were fitted. `channels`: by the key of each effect to be tested, the channel that it
    changes most.
    """

    def __init__(
        self,
        comparison: Comparison,
        effects: Sequence[LocatedEffect],
        channels: Mapping[_Key, Channel],
    ) -> None:
        self._channels = channels
        # None: without none of them.
        keys = (None, *channels) if channels else ()
        self._models = [
            comparison.extension_of(comparison.fit([e for e in effects if e.key != key]))
            for key in keys
        ]
        # By finding and stretch: squares of its channel with and without it.
        self._squares: dict[_Key, list[tuple[float, float]]] = {key: [] for key in channels}

    def add(self, predictor: Predictor, start: Sequence[Extension]) -> None:
        """Add a run; `start`: extensions that the diagnosis started from."""
        if not self._models:
            return
        run = predictor.run
        duration = float(run.time[-1] - run.time[0])
        part = part_numbers(run.time, max(1, round(duration / STRETCH_DURATION)))
        whole, *others = predictor.predict_each([(*start, each) for each in self._models])
        squares = {key: list(own) for key, own in self._squares.items()}
        for (key, channel), without in zip(self._channels.items(), others, strict=True):
            for kind, joint, used, both in residuals(run, predictor.velocity, whole, without):
                if (kind, joint + 1) == channel:
                    sums = [np.bincount(part[used], each**2) for each in both]
                    squares[key] += [own for own in zip(*sums, strict=True) if all(own)]
        # Assigned last: after Ctrl-C a run is added as a whole or not at all.
        self._squares = squares

    def evidence(self) -> dict[_Key, HeldOutEvidence]:
        """Return the evidence by key; without those of which fewer than two stretches tell."""
        found = {}
        for key, squares in self._squares.items():
            if len(squares) > 1:
                beside, without = np.array(squares).T
                ratio = float(np.sqrt(beside.sum() / without.sum()))
                found[key] = HeldOutEvidence(ratio, _likelihood_of_gain(without - beside))
        return found


def _likelihood_of_gain(gains: np.ndarray) -> float:
    """Return the likelihood ratio of a mean gain (b,) of zero or more to the mean that is seen."""
    count, mean, spread = len(gains), float(gains.mean()), float(gains.std(ddof=1))
    if mean >= 0.0:
        return 1.0
    deviation = mean / max(spread, 1e-300) * np.sqrt(count)
    return float((1.0 + deviation**2 / (count - 1)) ** (-0.5 * count))
