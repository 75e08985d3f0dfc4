"""Tilt of output bearings from static deflections, told from torsion by poses left out.

The part of a joint's moment that is transverse to its axis tilts the output bearing by
psi = M / k, alike about every transverse axis, and moves the tool by psi x r. Joints are added one
by one, each where it predicts poses left out better than those before: a bearing whose tilt acts
as the torsion of a neighbour does not, and stays rigid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiffopt.identification.robust_compliance import (
    RobustFit,
    fit,
    jackknife_deviation,
    without_each,
)
from stiffopt.recording.static_set import StaticSet
from stiffopt.robot.joint_load import joint_frames

# Adjusted p-value below this, and error on poses left out lower by this share.
MAX_CHANCE = 0.01
MIN_GAIN = 0.02


@dataclass(frozen=True, kw_only=True)
class BearingTilt:
    """Tilt compliance of one joint's output bearing.

    Parameters
    ----------
    joint : int
        From 1.
    compliance, sd : float
        With its standard deviation by the jackknife [rad/(N m)].
    left_out : float
        Root mean square of one component on poses left out, with this bearing and those before
        it [m].
    """

    joint: int
    compliance: float
    sd: float
    left_out: float


def tilt_columns(recorded: StaticSet) -> np.ndarray:
    """Return the displacement of the tool for unit tilt compliance of each joint, (m, 3, n).

    By the force on the tool alone, in the differences of two load states.
    """
    position = np.empty_like(recorded.position)
    position[:, recorded.order] = recorded.position
    axes, arm = joint_frames(recorded.robot, position)
    axis, arm = axes[..., 2][:, recorded.order], arm[:, recorded.order]
    moment = np.cross(arm, recorded.force[:, None, :])
    transverse = moment - np.sum(moment * axis, axis=2, keepdims=True) * axis
    turning = ~np.asarray(recorded.prismatic)[:, None]
    return np.asarray(np.moveaxis(turning * np.cross(transverse, arm), 1, 2))


def identify_tilt(
    recorded: StaticSet, torsion: np.ndarray, folds: list[RobustFit]
) -> tuple[BearingTilt, ...]:
    """Return the bearings whose tilt the poses support, the most important first.

    Parameters
    ----------
    recorded : StaticSet
        Of differences; with weight in the displacements no tilt is identified.
    torsion : array (m, 3, k)
        Columns of the identifiable joints.
    folds : list of RobustFit
        Of torsion alone, without one pose each.
    """
    measured = recorded.displacement
    if not recorded.difference:
        return ()
    added, columns = tilt_columns(recorded), torsion
    free = [j for j in range(added.shape[2]) if np.any(added[:, :, j])]
    error = np.array([measured[k] - columns[k] @ fold.value for k, fold in enumerate(folds)])
    found: list[BearingTilt] = []
    while free:
        tried = []
        for j in free:
            wider = np.concatenate([columns, added[:, :, [j]]], axis=2)
            if wider.shape[2] < 3 * (len(measured) - 1):
                tried.append((j, wider, *_predict_left_out(wider, measured)))
        if not tried:
            break
        j, wider, narrower, values = min(tried, key=lambda each: np.sum(each[2] ** 2))
        if not _supported(error, narrower, values[:, -1], len(free)):
            break
        found.append(
            BearingTilt(
                joint=j + 1,
                compliance=float(fit(wider, measured).value[-1]),
                sd=float(jackknife_deviation(values)[-1]),
                left_out=float(np.sqrt(np.mean(narrower**2))),
            )
        )
        columns, error = wider, narrower
        free.remove(j)
    return tuple(found)


def _predict_left_out(columns: np.ndarray, measured: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Errors (m, 3) of poses left out, and the values (m, p) of the fits without them."""
    whole = fit(columns, measured)
    folds = [fit(columns[k], measured[k], start=whole) for k in without_each(len(measured))]
    values = np.array([fold.value for fold in folds])
    return measured - np.einsum("kip,kp->ki", columns, values), values


def _supported(before: np.ndarray, after: np.ndarray, tilt: np.ndarray, tried: int) -> bool:
    """Return whether a tilt differs from zero, and errors (m, 3) on poses left out decreased.

    As torsion, by Student's t of its fits (m,) without one pose each, adjusted for the joints
    tried.
    """
    from scipy.stats import t

    sizes = [float(np.sqrt(np.mean(np.square(error)))) for error in (before, after)]
    if not sizes[1] < (1.0 - MIN_GAIN) * sizes[0]:
        return False
    deviation = float(jackknife_deviation(tilt[:, None])[0])
    factor = float(t.ppf(1.0 - MAX_CHANCE / tried, len(tilt) - 1))
    return float(np.mean(tilt)) > factor * deviation
