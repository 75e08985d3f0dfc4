"""What a diagnosis leaves open, for a further one that starts from its model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stiffopt.discovery.comparison.evidence import Added
from stiffopt.discovery.comparison.extension import Extension
from stiffopt.discovery.comparison.located_effect import places
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.extended.left_open import left_open_section
from stiffopt.discovery.extended.schema import LeftOpenSection
from stiffopt.discovery.identifiable import widen_for_changes
from stiffopt.discovery.search.candidates import Scorer, scan
from stiffopt.discovery.search.uncertainty import Estimate
from stiffopt.discovery.settings import ZERO_TOLERANCE
from stiffopt.discovery.training import Training
from stiffopt.recording.thinning import sampling_rate

# Shapes of the likeliest suspects are fitted; log evidence below which nothing is suspected.
_MAX_REFINED_SUSPECTS, _MIN_SUSPECT_EVIDENCE = 12, 2.0


def build_left_open(
    training: Training,
    whole: Extension,
    catalogue: Sequence[Effect],
    before: LeftOpenSection | None = None,
) -> LeftOpenSection:
    """Section of extended.toml about what is left of the training runs.

    Parameters
    ----------
    training : Training
    whole : Extension
        All that the extended model has.
    catalogue : sequence of Effect
        That is asked for; without any, nothing is suspected.
    before : LeftOpenSection, optional
        Of the model that was started from.
    """
    own = replace(training, start=whole.fitted, tolerance=ZERO_TOLERANCE, suspects={}).comparison()
    ratio = own.inflation * own.channel_ratio(own.target)
    suspects: dict[str, float] = {}
    leanings: dict[str, tuple[float, ...]] = {}
    if training.free_bodies and catalogue:
        own = own.moved(Extension(), np.nan_to_num(np.fmax(1.0, ratio), nan=1.0))
        scorer, changes = Scorer(own), widen_for_changes(catalogue)
        suspects = {
            candidate.located.label: candidate.evidence / own.rows.size
            for candidate in scan(scorer, changes, refined=_MAX_REFINED_SUSPECTS)
            if candidate.evidence > _MIN_SUSPECT_EVIDENCE and not candidate.located.by_run
        }
        leanings = _fit_leanings(scorer, changes)
    noise, rate = training.noise.channels, sampling_rate(training.recorded)
    return left_open_section(ratio, noise, training.settings, suspects, leanings, before, rate)


def add_left_open_deviation(training: Training, parameters: Estimate) -> Estimate:
    """The estimate, where what the model left of its own recordings counts as a deviation more.

    An inertia that the model lacks, or has too much of, is found beside a change of it, in whatever
    recordings: that noise of the same size would hardly look like it is no comfort.
    """
    away = []
    for each, size in zip(parameters.effects, parameters.sizes, strict=True):
        leaning = training.leanings.get(each.located.label, ())
        away.append(np.abs(leaning) / size if len(leaning) == len(size) else 0.0 * size)
    return parameters.doubted(np.concatenate(away)) if away else parameters


def _fit_leanings(scorer: Scorer, catalogue: Sequence[Effect]) -> dict[str, tuple[float, ...]]:
    """Amplitudes that every effect alone would take, bounds or not, where they stand out at all.

    With the shapes of those that a search starts from that suit best.
    """
    best: dict[str, Added] = {}
    sizes: dict[str, np.ndarray] = {}
    constants = scorer.comparison.constants
    for effect in catalogue:
        for located in places(effect, constants, ()):
            if located.by_run:
                continue
            found = scorer.unbounded(located) if located.possible(constants) else None
            known = best.get(located.label)
            if found and (known is None or found.log_evidence > known.log_evidence):
                best[located.label], sizes[located.label] = found, located.sizes(constants)
    return {
        label: tuple(float(f"{v:.4g}") for v in found.mean * sizes[label])
        for label, found in best.items()
        if np.any(found.mean**2 > np.diag(found.covariance))
    }
