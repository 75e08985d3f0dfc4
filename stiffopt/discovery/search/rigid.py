"""The rigid model re-identified, where nobody vouches for the nominal masses.

A robot description's masses and centres are off on nearly every arm. Where a set states no
tolerance of them, all inertial parameters are fitted together with what the set does not give, as
one stage before any effect is sought. One body moved, one payload or a tilted base is preferred to
a little of everything where it explains as much in recordings left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.comparison.bodies import body_units
from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.located_effect import LocatedEffect, places
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.search.candidates import Candidate, Scorer
from stiffopt.discovery.thresholds import NAMED_EVIDENCE, SPARSE_SHARE

# Standard deviations of inertial parameters that are tried, over their typical sizes.
WIDTHS = (0.02, 0.06, 0.2, 0.6)


@dataclass(frozen=True, kw_only=True, eq=False)
class RigidStage:
    """What the rigid model needs.

    Parameters
    ----------
    width : float
        Standard deviation of the inertial parameters over their typical sizes; 0 where nominal
        values within usual tolerances do.
    gain : float
        Log predictive density of stretches left out that this width gains.
    single : Candidate or None
        One change that explains as much.
    """

    width: float
    gain: float
    single: Candidate | None

    def bodies(self, comparison: Comparison) -> np.ndarray | None:
        """Standard deviations of all inertial parameters (n, 10); None where they stay."""
        return self.width * body_units(comparison.robot) if self.width else None


def rigid_stage(
    comparison: Comparison,
    effects: Sequence[LocatedEffect],
    catalogue: Sequence[Effect],
    tell: Callable[[str], object] = lambda _: None,
) -> RigidStage:
    """Choose between nominal bodies, one change and all parameters, by recordings left out.

    Parameters
    ----------
    comparison : Comparison
        With nominal bodies.
    effects : sequence of LocatedEffect
        What is found already.
    catalogue : sequence of Effect
    tell : callable
        Called with a sentence at every step.
    """
    nominal = Scorer(comparison, effects)
    width, gain = _best_width(comparison, effects, nominal.by_block, tell)
    single = _best_single(nominal, catalogue, tell)
    if single is not None and single.gain > max(SPARSE_SHARE * gain, NAMED_EVIDENCE):
        found = (*effects, single.located)
        beside = Scorer(comparison, found)
        width, gain = _best_width(comparison, found, beside.by_block, tell)
    else:
        single = None
    if gain < NAMED_EVIDENCE:
        width, gain = 0.0, 0.0
    return RigidStage(width=width, gain=gain, single=single)


def _best_width(
    comparison: Comparison,
    effects: Sequence[LocatedEffect],
    without: np.ndarray,
    tell: Callable[[str], object],
) -> tuple[float, float]:
    """The narrowest width within a standard error of the best, over blocks, and what it gains."""
    units, rows = body_units(comparison.robot), []
    for k, width in enumerate(WIDTHS, start=1):
        tell(f"re-identify the rigid model ({k} of {len(WIDTHS)} widths)")
        rows.append(Scorer(comparison.with_bodies(width * units), effects).by_block - without)
    gains = np.array(rows)
    best = int(np.argmax(gains.sum(axis=1)))
    behind = gains[best] - gains
    error = np.sqrt(gains.shape[1]) * behind.std(axis=1)
    chosen = int(np.argmax(behind.sum(axis=1) <= error))
    return WIDTHS[chosen], float(gains[chosen].sum())


def _best_single(
    scorer: Scorer, catalogue: Sequence[Effect], tell: Callable[[str], object]
) -> Candidate | None:
    found = []
    for entry in catalogue:
        if entry.family != "inertial" or entry.scope not in ("link", "robot"):
            continue
        for located in places(entry, scorer.comparison.constants, ()):
            if any(located.same_place(other) for other in scorer.base):
                continue
            tell(f"re-identify the rigid model: {located.label} in place of all")
            scored = scorer.score(located)
            if scored is not None:
                found.append(scored)
    return max(found, key=lambda c: c.gain, default=None)
