"""Test of torque-dependent joint compliance by cross-validation on poses left out.

Contacts under small load are soft, so a joint with contacts winds up as c s + b |s|^q with q < 1,
or c s + b tanh(s / s0). Both always lower the error on the poses they were fitted to. They are
accepted where they predict poses left out better than constant compliance, and better than a
constant error of the displacement sensor, which has a similar effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from stiffopt.identification.robust_compliance import (
    CrossValidation,
    RobustFit,
    cross_validate,
    loss,
    rms,
)
from stiffopt.identification.static_rows import StaticRows, Windup

Verdict = Literal["supported", "weak", "not supported", "not tested"]

# Supported: adjusted p-value below this, and error on poses left out lower by at least this share.
MAX_CHANCE = 0.01
MIN_GAIN = 0.02
# Fewer poses cannot reach this level in a paired test.
MIN_POSES = 8
# Exponents q that are tried, and torques s0 over the joint's root mean square torque.
EXPONENTS = (0.14, 0.3, 0.5)
TANH_TORQUE_SHARES = (0.05, 0.1, 0.2, 0.5)


@dataclass(frozen=True, kw_only=True, eq=False)
class Compared:
    """One model compared with constant compliance."""

    name: str
    formula: str
    candidate: bool  # depends on torque; else an alternative explanation without torque dependence
    shape: str  # form chosen on all poses
    parameters: int
    # Root mean square of one component on its own poses, on poses left out [m].
    fit: float
    left_out: float
    # Share by which the error on poses left out is below that of constant compliance; negative if
    # above.
    gain: float
    # Probability of so much gain by chance, one-sided signed-rank test over poses, adjusted for the
    # number of models tried; 1 for rivals.
    chance: float
    value: np.ndarray  # (p,) parameters on all poses
    error: np.ndarray  # (m, 3) of the poses left out [m]


@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueDependence:
    """Verdict on torque-dependent compliance."""

    # "supported", "weak" (predicts better, not decisively), "not supported", "not tested".
    verdict: Verdict
    sentence: str
    models: tuple[Compared, ...]  # constant compliance first
    best: str  # name of the torque-dependent model that predicts best; empty if none was tried
    # Of the supported model: joint (from 1) -> stiffness [N m/rad] at the torques that 5, 50 and 95
    # % of the poses do not exceed.
    secant: dict[int, tuple[float, float, float]]


UNTESTED = TorqueDependence(
    verdict="not tested", sentence="not tested.", models=(), best="", secant={}
)


@dataclass(frozen=True, eq=False)
class _FamilyFit:
    error: np.ndarray
    whole: RobustFit
    shape: WindupForm


def torque_dependence(
    rows: StaticRows, kept: np.ndarray, fitted: Sequence[FittedFamily]
) -> TorqueDependence:
    """Compare nested models of the joints' wind-up by predicting poses left out.

    `kept` (k,): joints (from 0) whose compliances are identifiable. `fitted`: as of `fit_families`.
    """
    m = len(rows.displacement)
    if m < MIN_POSES:
        return TorqueDependence(
            verdict="not tested",
            sentence=f"{m} poses are too few to test it; at least {MIN_POSES}, better 20, with "
            "small and large forces in the same pose.",
            models=(),
            best="",
            secant={},
        )
    tried = [each.family for each in fitted]
    runs = [_predict_left_out(each) for each in fitted]
    constant = runs[0]
    # Data without error have a scale of zero.
    scale = max(constant.whole.scale, 1e-9 * rms(rows.displacement))
    losses = [loss(run.error, scale) for run in runs]
    # Candidates are compared with the best model without torque dependence.
    plain = [k for k, family in enumerate(tried) if not family.candidate]
    rival = min(plain, key=lambda k: float(np.sum(losses[k])))
    candidates = len(tried) - len(plain)
    models = tuple(
        Compared(
            name=family.name,
            formula=family.formula,
            candidate=family.candidate,
            shape=run.shape.label,
            parameters=len(run.whole.value),
            fit=rms(run.whole.residual),
            left_out=rms(run.error),
            gain=1.0 - rms(run.error) / (rms(constant.error) or 1.0),
            chance=min(1.0, candidates * paired_test(losses[rival] - losses[k]))
            if family.candidate
            else 1.0,
            value=run.whole.value,
            error=run.error,
        )
        for k, (family, run) in enumerate(zip(tried, runs, strict=True))
    )
    best = min(
        (k for k in range(len(models)) if models[k].candidate),
        key=lambda k: (models[k].chance, -models[k].gain),
        default=None,
    )
    if best is None:
        return TorqueDependence(
            verdict="not tested",
            sentence=f"{m} poses are too few for the parameters of a torque-dependent compliance.",
            models=models,
            best="",
            secant={},
        )
    verdict, sentence, chosen = _decide_verdict(models, models[rival])
    secant = {}
    if verdict == "supported":
        secant = _secant_range(rows, kept, models[best], runs[best].shape)
    return TorqueDependence(
        verdict=verdict, sentence=sentence, models=models, best=chosen.name, secant=secant
    )


def _predict_left_out(fitted: FittedFamily) -> _FamilyFit:
    """Errors of poses left out; the form is selected without the pose."""
    errors = [each.error for each in fitted.fits]
    folds = zip(*(each.folds for each in fitted.fits), strict=True)
    error = np.array([errors[_select_form(fits)][k] for k, fits in enumerate(folds)])
    whole = [each.whole for each in fitted.fits]
    best = _select_form(whole)
    return _FamilyFit(error, whole[best], fitted.family.shapes[best])


def _select_form(fits: Sequence[RobustFit]) -> int:
    if len(fits) == 1:
        return 0
    scale = max(fits[0].scale, 1e-300)
    return int(np.argmin([np.sum(loss(each.residual, scale)) for each in fits]))


def paired_test(drop: np.ndarray) -> float:
    """One-sided p-value of a decrease of the loss (Wilcoxon's signed-rank test).

    Ranks, since a few poses with large loads would dominate a test of the mean.
    """
    from scipy.stats import wilcoxon

    if not drop.any():
        return 1.0
    return float(wilcoxon(drop, alternative="greater").pvalue)


def _decide_verdict(models: tuple[Compared, ...], rival: Compared) -> tuple[Verdict, str, Compared]:
    """Verdict, sentence, and the torque-dependent model concerned."""
    candidates = [model for model in models if model.candidate]
    sure = min(candidates, key=lambda model: (model.chance, -model.gain))
    if sure.chance < MAX_CHANCE and sure.gain >= MIN_GAIN:
        return (
            "supported",
            f"supported by these poses: {_parameter_values(sure, len(candidates))}.",
            sure,
        )
    best = max(candidates, key=lambda model: model.gain)
    numbers = _parameter_values(best, len(candidates))
    if best.left_out < rival.left_out:
        return "weak", f"weak: {numbers}; not decisive.", best
    than = "constant compliance" if rival is models[0] else "constant compliance with an offset"
    return (
        "not supported",
        f"not supported: {than} predicts poses left out better; {numbers}.",
        best,
    )


def _parameter_values(model: Compared, tried: int) -> str:
    return (
        f"{-100 * model.gain:+.1f} % error on poses left out (model: {model.name}), probability "
        f"of chance {model.chance:.2g} with {tried} models tried"
    )


def _secant_range(
    rows: StaticRows, kept: np.ndarray, best: Compared, shape: WindupForm
) -> dict[int, tuple[float, float, float]]:
    torque = np.quantile(np.abs(rows.load), [0.05, 0.5, 0.95], axis=0)
    added = torque if shape.windup is None else shape.windup(torque)
    result = {}
    for place, j in enumerate(kept):
        windup = best.value[place] * torque[:, j] + best.value[len(kept) + place] * added[:, j]
        if (windup > 0.0).all():
            low, middle, high = torque[:, j] / windup
            result[int(j) + 1] = (float(low), float(middle), float(high))
    return result


@dataclass(frozen=True, kw_only=True, eq=False)
class WindupForm:
    """One form of a model, selected by the poses that it is fitted to."""

    label: str
    columns: np.ndarray  # (m, 3, p) all columns, those of the constant compliances first
    windup: Windup | None = None  # added wind-up for a factor of one


@dataclass(frozen=True)
class Family:
    """A model of the wind-up with one form or several to select from."""

    name: str
    formula: str
    candidate: bool
    shapes: tuple[WindupForm, ...]


@dataclass(frozen=True, eq=False)
class FittedFamily:
    """A model with the fits of its forms."""

    family: Family
    fits: tuple[CrossValidation, ...]


def fit_families(
    rows: StaticRows, kept: np.ndarray, beside: np.ndarray | None = None
) -> list[FittedFamily]:
    """Fit all models that the poses determine without one of them.

    `kept` (k,): joints (from 0) that get parameters. `beside` (m, 3, b): columns of bearings that
    tilt, the last ones of every model.
    """
    m = len(rows.displacement)
    added = np.empty((m, 3, 0)) if beside is None else beside
    found = []
    for family in _families(rows, kept):
        wider = [np.concatenate([form.columns, added], axis=2) for form in family.shapes]
        if is_determined(wider[0]):
            fits = tuple(cross_validate(columns, rows.displacement) for columns in wider)
            found.append(FittedFamily(family, fits))
    return found


def is_determined(columns: np.ndarray) -> bool:
    """Return True where there are fewer columns than displacements without one pose."""
    return int(columns.shape[2]) < 3 * (len(columns) - 1)


def _families(rows: StaticRows, kept: np.ndarray) -> list[Family]:
    """Constant compliance, its alternative with sensor offset, and torque-dependent candidates."""
    constant = rows.compliance_columns()[:, :, kept]
    m = len(constant)
    both = np.broadcast_to(np.hstack([np.eye(3), -np.eye(3)]), (m, 3, 6))
    found = [
        Family("constant", "c s", False, (WindupForm(label="", columns=constant),)),
        Family(
            "constant, sensor offset",
            "c s, displacement + x0",
            False,
            (WindupForm(label="", columns=np.concatenate([constant, both], axis=2)),),
        ),
    ]
    size = np.sqrt(np.mean(np.square(rows.load), axis=0))
    powers = [(f"q = {q:g}", _power_form(q)) for q in EXPONENTS]
    bends = [(f"s0 = {share:g} of rms s", _tanh_form(share * size)) for share in TANH_TORQUE_SHARES]
    preloaded = rows.difference and rows.weight is not None and bool(np.any(rows.weight))
    for on_weight in (False, True) if preloaded else (False,):
        place = ", on the weight" if on_weight else ""
        for name, formula, laws in (
            ("contact", "c s + b |s|^q sign s", powers),
            ("tanh", "c s + b tanh(s / s0)", bends),
        ):
            shapes = tuple(_fit_shape(rows, kept, constant, *law, on_weight) for law in laws)
            found.append(Family(name + place, formula, True, shapes))
    return found


def _fit_shape(
    rows: StaticRows,
    kept: np.ndarray,
    constant: np.ndarray,
    label: str,
    law: Windup,
    on_weight: bool,
) -> WindupForm:
    added = rows.windup_columns(law, on_weight=on_weight)[:, :, kept]
    return WindupForm(label=label, columns=np.concatenate([constant, added], axis=2), windup=law)


def _power_form(exponent: float) -> Windup:
    return lambda s: np.sign(s) * np.abs(s) ** exponent


def _tanh_form(bend: np.ndarray) -> Windup:
    bend = np.where(bend > 0.0, bend, 1.0)
    return lambda s: np.tanh(s / bend)
