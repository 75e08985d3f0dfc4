"""Linear correction from the smooth law to the exact law at a design.

The corrected smooth law has value and slope of the exact law at the design, so a fixed point of
correction and optimisation is an optimum of the exact law. It remains convex.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from stiffopt.preload.model import PreloadModel
from stiffopt.symbolic import Quantity

# Relative step of finite differences, small beside the distance to slip of a design.
_RELATIVE_STEP = 1e-4

# Design vector -> smooth and exact values of one joint, (cases,) each.
_Laws = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class ExactShift:
    """Constants and slopes of the correction to the smooth law: arrays, or symbols for them."""

    # (joints, cases) [rad/(N m)], including all elements independent of the preloads.
    compliance: Quantity
    compliance_slope: Quantity  # (size, cases), by preloads of the same joint [rad/(N m) per N]
    # (n, cases) less that at the reference torque, of all joints of the robot [rad].
    windup: Quantity
    windup_slope: Quantity  # (size, cases) [rad per N]
    tilt: Quantity  # (elements, 1), of the tilting compliances [rad/(N m)]
    tilt_slope: Quantity  # (elements, 1), by the mean preload of an element [rad/(N m) per N]


def shift_shapes(model: PreloadModel) -> tuple[tuple[int, int], ...]:
    """Return the shapes of the fields of `ExactShift`."""
    cases, tilt = len(model.cases), (len(model.elements), 1)
    slopes = (model.size, cases)
    rows = (len(model.problem.joints), model.problem.robot.n)
    return (rows[0], cases), slopes, (rows[1], cases), slopes, tilt, tilt


def exact_shift(
    model: PreloadModel, preloads: np.ndarray, *, compliances: bool = True, windups: bool = True
) -> ExactShift:
    """Return the linearised difference of exact and smooth law at a design.

    `preloads` (size,) [N]. `compliances` and `windups`: quantities to compute; the others are zero.
    """
    n, joints = model.problem.robot.n, model.problem.joints
    shift = ExactShift(*(np.zeros(shape) for shape in shift_shapes(model)))
    for row, joint in enumerate(joints) if compliances else ():
        found = _linear_shift(model, joint, preloads, partial(_compliance_laws, model, joint))
        shift.compliance[row] = found[0]
        _store_slopes(model, joint, found[1], shift.compliance_slope)
    for joint in range(1, n + 1) if windups else ():
        if joint not in joints:
            shift.windup[joint - 1] = model.net_windups(preloads, joint)
            continue
        found = _linear_shift(model, joint, preloads, partial(_windup_laws, model, joint))
        shift.windup[joint - 1] = found[0]
        _store_slopes(model, joint, found[1], shift.windup_slope)
    for index in np.flatnonzero(model.tilt_vectors.any(axis=(1, 2))) if windups else ():
        shift.tilt[index], shift.tilt_slope[index] = _tilt_shift(model, preloads, int(index))
    return shift


def _tilt_shift(model: PreloadModel, preloads: np.ndarray, index: int) -> tuple[float, float]:
    """Return constant and slope of exact minus smooth tilting compliance of an element."""
    part = model.slices[index]
    mean = float(np.mean(preloads[part]))

    def missing(factor: float) -> float:
        scaled = model.replaced(preloads, index, factor * preloads[part])
        smooth = float(model.tilt_compliance(scaled, index))
        return model.exact_tilt_compliance(scaled, index) - smooth

    slope = (missing(1.0 + _RELATIVE_STEP) - missing(1.0 - _RELATIVE_STEP)) / (
        2.0 * _RELATIVE_STEP * mean
    )
    return missing(1.0) - slope * mean, slope


def _compliance_laws(
    model: PreloadModel, joint: int, preloads: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    smooth = np.asarray(model.compliances(preloads, joint))
    return smooth, model.exact_compliance(preloads, joint, model.torques(joint)[0])


def _windup_laws(
    model: PreloadModel, joint: int, preloads: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(model.windups(preloads, joint)), model.net_windups(preloads, joint)


def _linear_shift(
    model: PreloadModel, joint: int, preloads: np.ndarray, laws: _Laws
) -> tuple[np.ndarray, np.ndarray]:
    """Return constant (cases,) and slopes (own preloads, cases) of exact minus smooth law."""
    smooth, exact = laws(preloads)
    slopes: list[np.ndarray] = []
    own = _joint_positions(model, joint)
    for place, i in enumerate(own):
        twin = _find_equal_preload(model, preloads, own[:place], i)
        if twin is not None:
            slopes.append(slopes[twin])
            continue
        step = np.zeros(model.size)
        step[i] = _RELATIVE_STEP * preloads[i]
        (smooth_up, exact_up), (smooth_down, exact_down) = (
            laws(preloads + step),
            laws(preloads - step),
        )
        with np.errstate(invalid="ignore"):
            up, down = exact_up - smooth_up, exact_down - smooth_down
            # Below the preload at which the connection slips the exact law has no value.
            missing = np.where(np.isfinite(down), 0.5 * (up - down), up - (exact - smooth))
        # A step where a contact spot yields is no slope. Too steep a slope only slows convergence,
        # and near slip the exact one is far steeper; too flat a one makes the corrections cycle.
        smooth_change = 0.5 * (smooth_up - smooth_down)
        factor = np.divide(
            missing, smooth_change, where=smooth_change != 0.0, out=np.zeros_like(missing)
        )
        factor = np.where(np.isfinite(factor), np.maximum(factor, -0.5), 0.0)
        slopes.append(factor * smooth_change / step[i])
    found = np.array(slopes).reshape(-1, len(model.cases))
    return exact - smooth - preloads[own] @ found, found


def _find_equal_preload(
    model: PreloadModel, preloads: np.ndarray, before: list[int], i: int
) -> int | None:
    """Return the position of an equal preload of the same connection; None without."""
    ends = next(s for s in model.slices if s.start <= i < s.stop)
    for place, k in enumerate(before):
        # Relative difference of preloads of one connection that share a slope.
        if ends.start <= k and abs(preloads[k] - preloads[i]) < 1e-5 * preloads[i]:
            return place
    return None


def _joint_positions(model: PreloadModel, joint: int) -> list[int]:
    """Return the positions of a joint's preloads in the design vector."""
    return [
        i
        for index in model.indices[joint]
        for i in range(model.slices[index].start, model.slices[index].stop)
    ]


def _store_slopes(model: PreloadModel, joint: int, slopes: np.ndarray, whole: np.ndarray) -> None:
    whole[_joint_positions(model, joint)] = slopes
