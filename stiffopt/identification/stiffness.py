"""Joint stiffness of an arm from deflections under known forces: `identify_stiffness`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stiffopt.errors import InputFileError
from stiffopt.identification import robust_compliance
from stiffopt.identification.bearing_tilt import identify_tilt, tilt_explanations
from stiffopt.identification.result import Errors, JointStiffness, StaticStiffness, Status
from stiffopt.identification.static_rows import (
    MIN_LEVERAGE,
    Identifiable,
    StaticRows,
    check_nominal,
    check_sag,
    identifiable,
    static_rows,
)
from stiffopt.identification.torque_dependence import UNTESTED, fit_families, torque_dependence
from stiffopt.recording.static_set import StaticSet

CONFIDENCE = 0.95
BOOTSTRAP_DRAWS = 400
# Residual from which a pose is an outlier [standard deviations of one component].
OUTLIER_DEVIATIONS = 5.0
# Compliance over its standard deviation from which a weakly loaded joint gets an estimate.
_MIN_WEAK_SIGNIFICANCE = 5.0


def identify_stiffness(
    recorded: StaticSet, *, torque: bool = True, draws: int = BOOTSTRAP_DRAWS, seed: int = 1
) -> StaticStiffness:
    """Identify joint stiffness with standard deviations and test its torque dependence.

    Parameters
    ----------
    recorded : StaticSet
    torque : bool
        Also test whether compliance depends on torque.
    draws : int
        Of the bootstrap.
    seed : int
        Of the bootstrap.

    Raises
    ------
    InputFileError
        Too few poses, no joint that they load, weight in the displacements and no masses.
    """
    rows = static_rows(recorded)
    columns, measured = rows.compliance_columns(), rows.displacement
    can = identifiable(columns)
    kept = can.kept
    if not kept.size:
        raise InputFileError(
            recorded.path, "force", "the forces load no joint: they pass through every axis. "
            "Check the order of the columns and the tool frame."
        )  # fmt: skip
    laws = fit_families(rows, kept)
    tilt = identify_tilt(recorded, laws)
    bearings = tilt_explanations(recorded, tilt)
    if tilt and torque:
        laws = fit_families(rows, kept, bearings[0])
    explanations = [np.concatenate([columns[:, :, kept], each], axis=2) for each in bearings]
    robust, *rivals = (robust_compliance.cross_validate(each, measured) for each in explanations)
    used, fitted = robust.columns, robust.whole
    torsion = columns[:, :, kept]
    plain = robust_compliance.cross_validate(torsion, measured, robust=False)
    drawn = robust_compliance.bootstrap(used, measured, fitted, draws, seed)
    joints = _joint_estimates(recorded, rows, can, (robust, *rivals), plain.whole, drawn)
    check_sag(rows, recorded, np.array([1.0 / own.upper if own.upper else 0.0 for own in joints]))
    identified = [own.stiffness if own.status == "identified" else None for own in joints]
    check_nominal(recorded, np.array(identified, dtype=float))
    rigid = robust_compliance.cross_validate(torsion, measured) if tilt else robust
    norm = np.linalg.norm(fitted.residual, axis=1)
    # Rounding must not make outliers of data without error.
    outlying = max(OUTLIER_DEVIATIONS * fitted.scale, 1e-6 * robust_compliance.rms(measured))
    return StaticStiffness(
        source=recorded,
        rows=rows,
        joints=joints,
        errors=Errors(
            displacement=robust_compliance.rms(measured),
            fit=robust_compliance.rms(fitted.residual),
            left_out=robust_compliance.rms(robust.error),
            least_squares=robust_compliance.rms(plain.whole.residual),
            least_squares_left_out=robust_compliance.rms(plain.error),
            nominal=None
            if recorded.stiffness is None
            else robust_compliance.rms(measured - columns @ (1.0 / recorded.stiffness)),
            rigid_bearings=robust_compliance.rms(rigid.error),
        ),
        predicted=measured - fitted.residual,
        left_out=robust.predicted,
        weight=fitted.weight,
        scale=fitted.scale,
        outliers=tuple(int(k) + 1 for k in np.flatnonzero(norm > outlying)),
        correlation=_largest_correlation(used, fitted, can, recorded.n),
        torque_dependence=torque_dependence(rows, kept, laws) if torque else UNTESTED,
        tilt=tilt,
        assumptions=_list_assumptions(recorded, rows),
    )


def _joint_estimates(
    recorded: StaticSet,
    rows: StaticRows,
    can: Identifiable,
    explanations: Sequence[robust_compliance.CrossValidation],
    plain: robust_compliance.RobustFit,
    drawn: np.ndarray,
) -> tuple[JointStiffness, ...]:
    """Estimates of all joints; `explanations`: fits of the bearings found, then of their rivals."""
    from scipy.stats import t

    fitted, poses = explanations[0].whole, len(explanations[0].folds)
    alike = np.array(
        [
            np.sqrt(np.diag(robust_compliance.model_covariance(each.columns, each.whole)))
            for each in explanations
        ]
    )
    jackknife = np.array(
        [robust_compliance.jackknife_deviation(each.values) for each in explanations]
    )
    factor = float(t.ppf(0.5 + 0.5 * CONFIDENCE, poses - 1))
    # The interval contains that of every explanation which the poses do not tell from the first.
    apart = np.array([np.abs(each.whole.value - fitted.value) for each in explanations])
    deviations = np.max(apart / factor + np.maximum(alike, jackknife), axis=0)
    torque = np.quantile(np.abs(rows.load), [0.05, 0.5, 0.95], axis=0).T
    place = {int(j): k for k, j in enumerate(can.kept)}
    joints = []
    for j, name in enumerate(recorded.joints):
        status, reason = _geometric_identifiability(can, j)
        nominal = None if recorded.stiffness is None else float(recorded.stiffness[j])
        estimate: dict[str, float | None] = dict.fromkeys(_ESTIMATED_NOTE)
        if status == "identified":
            k = place[j]
            value, deviation = float(fitted.value[k]), float(deviations[k])
            status, reason = _compliance_significance(
                value, deviation, factor, float(can.leverage[j])
            )
            if status != "not_loaded":
                estimate = _stiffness_estimate(
                    value,
                    deviation,
                    factor,
                    nominal,
                    float(plain.value[k]),
                    robust_compliance.bootstrap_interval(drawn[:, k], poses, CONFIDENCE),
                    float(np.std(drawn[:, k], ddof=1)),
                )
                estimate["compliance_sd_alike"] = float(alike[0, k])
                estimate["compliance_sd"] = float(jackknife[0, k])
        low, middle, high = (float(each) for each in torque[j])
        joints.append(
            JointStiffness(
                joint=j + 1,
                name=name,
                unit="N/m" if recorded.prismatic[j] else "N m/rad",
                status=status,
                reason=reason,
                nominal=nominal,
                torque=(low, middle, high),
                leverage=float(can.leverage[j]),
                **estimate,
            )
        )
    return tuple(joints)


_ESTIMATED_NOTE = (
    "stiffness",
    "sd",
    "lower",
    "upper",
    "least_squares",
    "compliance",
    "compliance_sd",
    "compliance_sd_alike",
    "compliance_sd_bootstrap",
    "bootstrap_lower",
    "bootstrap_upper",
    "z_nominal",
)


def _geometric_identifiability(can: Identifiable, j: int) -> tuple[Status, str]:
    """Identifiability of joint j (from 0) by the geometry of the poses."""
    if not can.loaded[j]:
        return "not_loaded", (
            "not identifiable: no pose loads this joint. Pull where the force passes beside its "
            "axis."
        )
    if can.group[j]:
        others = [str(k + 1) for k in np.flatnonzero(can.group == can.group[j]) if k != j]
        return "confounded", (
            f"not identifiable: in these poses it moves the tool as joint {', '.join(others)} "
            "does. Change the joint angles between them."
        )
    return "identified", ""


def _compliance_significance(
    value: float, deviation: float, factor: float, leverage: float
) -> tuple[Status, str]:
    """Status of a compliance by its significance."""
    if leverage < MIN_LEVERAGE and value < _MIN_WEAK_SIGNIFICANCE * deviation:
        return "not_loaded", (
            "not identifiable: the poses load this joint so little that its deflection is below "
            "the errors. Pull with a longer lever about its axis."
        )
    if value > factor * deviation:
        return "identified", ""
    if value > deviation:
        return "lower_bound", (
            "poorly determined: within 95 % a rigid joint is not excluded. The lower end of the "
            "interval holds, the estimate is a guess."
        )
    return "lower_bound", "too stiff for these poses: only a lower bound can be given."


def _stiffness_estimate(
    value: float,
    deviation: float,
    factor: float,
    nominal: float | None,
    plain: float,
    drawn: tuple[float, float],
    spread: float,
) -> dict[str, float | None]:
    """Stiffness and its interval from a compliance; None in place of divisions by zero."""
    guess = value > deviation
    return {
        "stiffness": 1.0 / value if guess else None,
        "sd": deviation / value**2 if guess else None,
        "lower": _invert_compliance(value + factor * deviation),
        "upper": _invert_compliance(value - factor * deviation),
        "least_squares": _invert_compliance(plain),
        "compliance": value,
        "compliance_sd_bootstrap": spread,
        "bootstrap_lower": _invert_compliance(drawn[1]),
        "bootstrap_upper": _invert_compliance(drawn[0]),
        "z_nominal": (value - 1.0 / nominal) / deviation if nominal and deviation else None,
    }


def _invert_compliance(compliance: float) -> float | None:
    return 1.0 / compliance if compliance > 0.0 else None


def _largest_correlation(
    columns: np.ndarray, fitted: robust_compliance.RobustFit, can: Identifiable, n: int
) -> np.ndarray:
    covariance = robust_compliance.model_covariance(columns, fitted)
    deviation = np.sqrt(np.diag(covariance))
    full = np.full((n, n), np.nan)
    alone = can.group[can.kept] == 0
    inner = covariance / np.outer(deviation, deviation) if deviation.all() else np.eye(len(alone))
    full[np.ix_(can.kept[alone], can.kept[alone])] = inner[np.ix_(alone, alone)]
    return full


def _list_assumptions(recorded: StaticSet, rows: StaticRows) -> tuple[str, ...]:
    said = [
        "Links and base are rigid. Joint stiffness is that about the axes, beside the tilt of "
        "bearings that the poses support; intervals cover bearings that they do not tell apart.",
        "Joint angles and forces are exact; all error is in the displacements.",
        "Deflections are small: the lever arms are those of the undeflected arm.",
    ]
    if recorded.difference:
        said.append("Each displacement is a difference of two load states, so weight is out of it.")
    else:
        said.append("Displacements include the deflection under the weight of the links.")
    if recorded.difference and rows.weight is not None:
        said.append(
            "Torque dependence about the gravity torque of a joint is tested with the "
            "masses of the robot file, without counterbalances."
        )
    if recorded.difference and rows.weight is None:
        said.append(
            "No link has a mass: the torque that the joints already carried is unknown, and a "
            "torque-dependent compliance is tested as if it were none."
        )
    if recorded.locked:
        said.append(f"Held at zero and rigid: {', '.join(recorded.locked)}.")
    return tuple(said)
