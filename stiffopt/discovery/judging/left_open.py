"""What a diagnosis leaves open, for a further one that starts from its model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stiffopt.discovery.comparison.extension import Extension
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.extended.left_open import left_open
from stiffopt.discovery.extended.schema import LeftOpenSection
from stiffopt.discovery.search.candidates import Scorer, scan
from stiffopt.discovery.search.identifiable_effects import of_changes
from stiffopt.discovery.settings import FIXED
from stiffopt.discovery.training import Training

# Shapes of the likeliest suspects are fitted; log evidence below which nothing is suspected.
_REFINED, _LEAST = 12, 2.0


def open_section(
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
    own = replace(training, start=whole.fitted, tolerance=FIXED, suspects={}).comparison()
    ratio = own.inflation * own.channel_ratio(own.target)
    suspects = {}
    if training.free_bodies and catalogue:
        own = own.moved(Extension(), np.nan_to_num(np.fmax(1.0, ratio), nan=1.0))
        suspects = {
            candidate.located.label: candidate.evidence / own.rows.size
            for candidate in scan(Scorer(own), of_changes(catalogue), refined=_REFINED)
            if candidate.evidence > _LEAST and not candidate.located.by_run
        }
    return left_open(ratio, training.noise.channels, training.settings, suspects, before)
