"""Tournament of rigid models and the catalogue's: the best prediction of stretches left out.

Before effects are claimed, the model with them competes with three plainer ones that see the same
samples: friction lines (nominal masses, friction and offset of every joint), the best single body
beside those, and base parameters (all inertial parameters free beside those). Every model is
fitted without a stretch, with consistent bodies as in an answer, and predicts it; the answer does
not predict worse than the best of them by more than the standard error of the difference.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.search.cross_validation import predict_folds
from stiffopt.discovery.search.rigid_model import (
    PRIOR_WIDTHS,
    common_deviations,
    with_own_noise,
    with_single_body,
)
from stiffopt.discovery.search.uncertainty import number_stretches

FRICTION_LINES, SINGLE_BODY, BASE_PARAMETERS, CATALOGUE_MODEL = (
    "friction lines",
    "the best single body",
    "base parameters",
    "effects of the catalogue",
)


# Relative difference of residuals below which rounding decides.
EQUAL_RESIDUALS = 1e-9


@dataclass(frozen=True, eq=False)
class Contender:
    """A model of the tournament."""

    name: str
    comparison: Comparison  # with its prior of masses, and the stated noise
    effects: tuple[LocatedEffect, ...]
    # (b,) mean square over the channels of the normalised residual of stretches left out, by the
    # share of each stretch.
    squares: np.ndarray

    @property
    def residual(self) -> float:
        """Normalised residual of stretches left out, root mean square over the channels."""
        return float(np.sqrt(self.squares.sum()))


def hold_tournament(
    comparison: Comparison,
    calibrated: Sequence[LocatedEffect],
    single: LocatedEffect | None,
    effects: Sequence[LocatedEffect],
) -> tuple[Contender, ...]:
    """Return the models with their residuals in stretches left out, the best first.

    Models that predict no worse than the best one by more than a standard error come before all
    others, and that of the catalogue first of them: it has gained its effects one by one.

    `comparison`: linearised about the effects, with the masses as free as found best. `calibrated`:
    values that every joint has and the nominal model does not state. `single`: the best single
    body. `effects`: calibrated values and effects of the catalogue.
    """
    held = comparison.with_bodies(None)
    free = comparison.with_bodies(common_deviations(comparison, PRIOR_WIDTHS[-1]))
    entries = [(CATALOGUE_MODEL, comparison, tuple(effects))]
    if calibrated:
        entries += [
            (FRICTION_LINES, held, tuple(calibrated)),
            (BASE_PARAMETERS, free, tuple(calibrated)),
        ]
        body = None if single is None else single.changed_body(comparison.constants)
        if single is not None and body is not None:
            # As a free body it stays physically consistent; amplitudes of an effect have no bounds.
            alone = with_single_body(comparison, body, single.sizes(comparison.constants))
            entries.append((SINGLE_BODY, alone, tuple(calibrated)))
        elif single is not None:
            entries.append((SINGLE_BODY, held, (*calibrated, single)))
    found = [
        Contender(name, model, own, _squares_left_out(model, own)) for name, model, own in entries
    ]
    best = min(found, key=lambda each: each.residual)

    def excess(each: Contender) -> float:
        more = each.squares - best.squares
        error = np.sqrt(len(more)) * more.std(ddof=1) if len(more) > 1 else 0.0
        equal = more.sum() <= max(error, EQUAL_RESIDUALS * best.squares.sum())
        return 0.0 if equal else float(more.sum())

    return tuple(sorted(found, key=excess))


def _squares_left_out(start: Comparison, effects: Sequence[LocatedEffect]) -> np.ndarray:
    """Return the squares (b,) of the residual of stretches left out, over the stated noise.

    With the noise beside the model's own fit: beside another's, a channel that only this one
    explains hardly counts, and its masses stay where their priors hold them.
    """
    model = with_own_noise(start, effects)
    left = predict_folds(model, effects).residual_within_bounds(model)
    rows = model.rows.channel
    share = (left * model.inflation[rows]) ** 2 / model.rows.counts[rows]
    return np.bincount(number_stretches(model), share / np.count_nonzero(model.rows.counts))


def describe_tournament(contenders: Sequence[Contender]) -> tuple[str, ...]:
    """Return a sentence on the models that competed; none without a competition."""
    if len(contenders) < 2:
        return ()
    first, *others = contenders
    rest = ", ".join(f"{each.name} {each.residual:.3g}" for each in others)
    return (
        f"Stretches of the training runs left out are predicted by {first.name} within"
        f" {first.residual:.3g} times the noise, which no other model betters by more than a"
        f" standard error ({rest}).",
    )
