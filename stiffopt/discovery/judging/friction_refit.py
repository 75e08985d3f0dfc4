"""Refit of friction to all moving samples of the training runs, including reversals.

A fit excludes samples within its filter's length of a stationary joint, where dry friction is
undetermined. Predictions include them, and with an inexact law the best level differs. Dry and
viscous friction and offsets of a joint are therefore refitted to all moving samples, unfiltered, if
that improves cross-validation; the step counts as uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stiffopt.discovery.comparison.channel_rows import part_numbers
from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.located_effect import EstimatedEffect, Extension
from stiffopt.discovery.prediction import Predictor, used_samples
from stiffopt.discovery.search.cross_validation import FoldPredictions, folds_per_run
from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.search.uncertainty import Estimate, estimate_parameters
from stiffopt.discovery.training import Training

# Least relative decrease of a joint's squares in stretches left out.
_MIN_GAIN_SHARE = 0.05
# Prior standard deviation of a step over its size: wide, so that only the data count.
_STEP_PRIOR = 1e3


def refit_friction(
    training: Training, comparison: Comparison, selected: Sequence[Selected]
) -> tuple[tuple[Selected, ...], Estimate]:
    """Refit friction of findings to all moving samples, and drop findings that these contradict.

    `comparison`: with the noise estimated beside the effects.
    """
    while True:
        located = tuple(s.located for s in selected)
        parameters = estimate_parameters(comparison, located)
        names = sorted({e.effect.identity for e in parameters.effects if _is_refittable(e)})
        if not names:
            return tuple(selected), parameters
        rows = _MovingSamples(training, parameters, names)
        kept = [
            each
            for each, found in zip(selected, parameters.effects, strict=True)
            if each.located.calibrated
            or not _is_refittable(found)
            or rows.helps(found, names, training)
        ]
        if len(kept) == len(selected):
            return tuple(selected), _apply_steps(training, parameters, rows, names)
        selected = kept


# Name of an effect and the runs in which it acts.
EffectIdentity = tuple[str, tuple[str, ...]]


def _apply_steps(
    training: Training, parameters: Estimate, rows: _MovingSamples, names: Sequence[EffectIdentity]
) -> Estimate:
    """Return the estimate with friction and offsets refitted to all moving samples."""
    effects = parameters.effects
    plain = [k for k, each in enumerate(effects) if _is_refittable(each)]
    steps = np.zeros(len(effects))
    for joint in {effects[k].located.joint for k in plain}:
        own = [k for k in plain if effects[k].located.joint == joint]
        assert joint is not None
        columns = [names.index(effects[k].located.effect.identity) for k in own]
        found = rows.step(joint, columns)
        if found is not None and _is_within_bounds(parameters, own, found, training):
            steps[own] = found
    return parameters.moved(steps)


def _is_refittable(each: EstimatedEffect) -> bool:
    """True for friction or an offset of one joint with a single amplitude."""
    effect = each.located.effect
    # An offset of a link encoder changes no torque.
    usual = effect.usual and "torque" in effect.needs
    friction = bool(effect.nominal) and effect.family == "friction"
    return (usual or friction) and len(each.amplitudes) == 1 and each.located.joint is not None


def _is_within_bounds(
    parameters: Estimate, own: Sequence[int], steps: np.ndarray, training: Training
) -> bool:
    """True if all values stay within their bounds."""
    for k, step in zip(own, steps, strict=True):
        located = parameters.effects[k].located
        size = located.sizes(training.constants)[0]
        value = parameters.effects[k].amplitudes[0] / size + step
        lower, upper = located.bounds(training.constants)[0]
        if not lower <= value <= upper:
            return False
    return True


class _MovingSamples:
    """Torque residuals of moving samples, and their change by a unit step of each value."""

    def __init__(
        self, training: Training, parameters: Estimate, names: Sequence[EffectIdentity]
    ) -> None:
        found = Extension(calibration=parameters.calibration(), effects=parameters.effects)
        parts = folds_per_run(len(training.recorded))
        rows: list[list[tuple[np.ndarray, np.ndarray, np.ndarray]]] = [
            [] for _ in range(training.robot.n)
        ]
        for number, run in enumerate(training.recorded):
            predictor = Predictor(training, run)
            each = [found, *(_increase_amplitudes(found, name, training) for name in names)]
            places = np.searchsorted(run.stamps, run.time)
            predicted = predictor.predict_each([(*training.before, more) for more in each])
            now, *raised = (prediction.torque[places] for prediction in predicted)
            fold = number * parts + part_numbers(run.time, parts)
            for kind, joint, used in used_samples(run, predictor.velocity):
                if kind != "torque":
                    continue
                left = run.torque[used, joint] - now[used, joint]
                columns = np.column_stack([torque[used, joint] for torque in raised])
                columns -= now[used, joint][:, None]
                rows[joint].append((columns, left, fold[used]))
        self._rows = rows

    def helps(
        self, found: EstimatedEffect, names: Sequence[EffectIdentity], training: Training
    ) -> bool:
        """True if it improves the prediction of all moving samples."""
        located = found.located
        assert located.joint is not None
        column = names.index(located.effect.identity)
        amount = found.amplitudes[0] / located.sizes(training.constants)[0]
        own = self._rows[located.joint]
        now = sum(float(left @ left) for _, left, _ in own)
        without = sum(
            float(np.sum((left + amount * added[:, column]) ** 2)) for added, left, _ in own
        )
        return without > now

    def step(self, joint: int, columns: Sequence[int]) -> np.ndarray | None:
        """Return the best steps of a joint's values over their sizes; None without enough gain."""
        if not self._rows[joint]:
            return None
        matrix = np.vstack([part[0] for part in self._rows[joint]])[:, columns]
        left = np.concatenate([part[1] for part in self._rows[joint]])
        fold = np.concatenate([part[2] for part in self._rows[joint]])
        prior, free = np.full(len(columns), _STEP_PRIOR), np.full(len(columns), np.inf)
        fold = np.unique(fold, return_inverse=True)[1]
        without = FoldPredictions(matrix, left, prior, free, fold).residual()
        if without @ without > (1.0 - _MIN_GAIN_SHARE) * float(left @ left):
            return None
        return np.asarray(np.linalg.lstsq(matrix.T @ matrix, matrix.T @ left)[0])


def _increase_amplitudes(found: Extension, name: EffectIdentity, training: Training) -> Extension:
    """Return the extension with every effect of a name increased by its size."""
    effects = []
    for each in found.effects:
        if each.located.effect.identity == name:
            size = each.located.sizes(training.constants)[0]
            each = replace(each, amplitudes=(each.amplitudes[0] + size,))
        effects.append(each)
    return replace(found, effects=tuple(effects))
