"""Open residual of a diagnosis, for a further one that starts from its extended model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stiffopt.discovery.comparison.evidence import AddedPosterior
from stiffopt.discovery.comparison.located_effect import Extension, effect_places
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.extended.left_open import left_open_section
from stiffopt.discovery.extended.schema import LeftOpenSection
from stiffopt.discovery.identifiable import widen_for_changes
from stiffopt.discovery.search.candidates import Scorer, scan
from stiffopt.discovery.search.uncertainty import Estimate
from stiffopt.discovery.settings import ZERO_TOLERANCE
from stiffopt.discovery.training import Training
from stiffopt.recording.decimation import sampling_rate

# Number of suspects whose shapes are fitted, and least log evidence of a suspect.
_MAX_REFINED_SUSPECTS, _MIN_SUSPECT_EVIDENCE = 12, 2.0


def build_left_open(
    training: Training,
    whole: Extension,
    catalogue: Sequence[Effect],
    before: LeftOpenSection | None = None,
) -> LeftOpenSection:
    """Return the section of extended.toml about the residual of the training runs.

    `whole`: the whole extension of the model. `catalogue`: possible suspects; empty to skip their
    search. `before`: section of the starting model.
    """
    own = replace(training, start=whole.fitted, tolerance=ZERO_TOLERANCE, suspects={}).comparison()
    ratio = own.inflation * own.channel_ratio(own.target)
    suspects: dict[str, float] = {}
    leanings: dict[str, tuple[float, ...]] = {}
    if training.free_bodies and catalogue:
        own = own.with_extension(Extension(), np.nan_to_num(np.fmax(1.0, ratio), nan=1.0))
        scorer, changes = Scorer(own), widen_for_changes(catalogue)
        suspects = {
            candidate.located.label: candidate.evidence / own.rows.size
            for candidate in scan(scorer, changes, refined=_MAX_REFINED_SUSPECTS)
            if candidate.evidence > _MIN_SUSPECT_EVIDENCE and not candidate.located.is_run_specific
        }
        leanings = _fit_leanings(scorer, changes)
    noise, rate = training.noise.channels, sampling_rate(training.recorded)
    return left_open_section(ratio, noise, training.settings, suspects, leanings, before, rate)


def add_left_open_deviation(training: Training, parameters: Estimate) -> Estimate:
    """Add amplitudes that the open residual of the model suggests as one standard deviation.

    An error of the model, such as of an inertia, recurs in all recordings and adds to a change of
    the same value; it does not average out like noise.
    """
    away = []
    for each, size in zip(parameters.effects, parameters.sizes, strict=True):
        leaning = training.leanings.get(each.located.label, ())
        away.append(np.abs(leaning) / size if len(leaning) == len(size) else 0.0 * size)
    return parameters.doubted(np.concatenate(away)) if away else parameters


def _fit_leanings(scorer: Scorer, catalogue: Sequence[Effect]) -> dict[str, tuple[float, ...]]:
    """Fit the amplitudes of every single effect without bounds; return those above one sigma.

    With the best of the initial shapes.
    """
    best: dict[str, AddedPosterior] = {}
    sizes: dict[str, np.ndarray] = {}
    constants = scorer.comparison.constants
    for effect in catalogue:
        for located in effect_places(effect, constants, ()):
            if located.is_run_specific:
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
