"""Tilt of output bearings from static deflections, told from torsion by poses left out.

The part of a joint's moment that is transverse to its axis tilts the output bearing by
psi = M / k, alike about every transverse axis, and moves the tool by psi x r. Joints are added one
by one, each where it predicts poses left out better than those before, and dropped again where
later ones take their place: a bearing whose tilt acts as the torsion of a neighbour does not, and
stays rigid. Torsion has the law, constant or softening, that predicts poses left out best: else
the bearings would take what softening leaves.

Encoders of motors and links turn about the axis and motor torques act about it: of all that is
recorded of an arm, only a measured place of its tool shows a tilt, which static sets have.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.identification.robust_compliance import (
    CrossValidation,
    cross_validate,
    jackknife_deviation,
    rms,
)
from stiffopt.identification.torque_dependence import (
    MIN_GAIN,
    FittedFamily,
    is_determined,
    paired_test,
)
from stiffopt.recording.static_set import StaticSet
from stiffopt.robot.joint_load import joint_frames, joint_wrenches

# Adjusted p-value below this, besides an error on poses left out lower by MIN_GAIN. Student's t is
# only near the distribution of robust fits: the level is well below the false alarms accepted.
MAX_CHANCE = 0.001
# Probability by chance that a rival's errors exceed those found so often: above it, both are told.
_MAX_RIVAL_CHANCE = 0.05


@dataclass(frozen=True, kw_only=True)
class BearingTilt:
    """Tilt compliance of one joint's output bearing."""

    joint: int  # from 1
    # With its standard deviation by the jackknife [rad/(N m)].
    compliance: float
    sd: float
    # Joints (from 1) whose bearing in its place predicts poses left out about as well.
    rivals: tuple[int, ...] = ()


def tilt_columns(recorded: StaticSet) -> np.ndarray:
    """Return the displacement of the tool for unit tilt compliance of each joint, (m, 3, n)."""
    robot, order = recorded.robot, recorded.order
    position = np.empty_like(recorded.position)
    position[:, order] = recorded.position
    still = np.zeros_like(position)
    wrench = joint_wrenches(robot, position, still, still, recorded.force[:, None, :])
    if recorded.difference:
        wrench = wrench - joint_wrenches(robot, position, still, still, np.zeros(3))
    axes, arm = joint_frames(robot, position)
    # A joint's moment balances the loads, which tilt its bearing the other way.
    load = -np.einsum("knij,knj->kni", axes[..., :2], wrench[..., 3:5])
    moved = np.where(robot.prismatic[:, None], 0.0, np.cross(load, arm))
    return np.asarray(np.moveaxis(moved[:, order], 1, 2))


def identify_tilt(recorded: StaticSet, torsion: Sequence[FittedFamily]) -> tuple[BearingTilt, ...]:
    """Return the bearings whose tilt the poses support, beside the best law of the torsion."""
    laws = [law for family in torsion for law in family.fits]
    if not laws:
        return ()
    measured, added = recorded.displacement, tilt_columns(recorded)
    found = min(laws, key=lambda each: rms(each.error))
    first = found.columns.shape[2]
    joints: list[int] = []
    free = [j for j in range(added.shape[2]) if np.any(added[:, :, j])]
    while free:
        wider = [np.concatenate([found.columns, added[:, :, [j]]], axis=2) for j in free]
        if not is_determined(wider[0]):
            break
        tried = [cross_validate(columns, measured) for columns in wider]
        best = int(np.argmin([rms(each.error) for each in tried]))
        if not _supported(found, tried[best], -1, len(free)):
            break
        found = tried[best]
        joints.append(free.pop(best))
        for k in range(len(joints) - 2, -1, -1):
            narrower = cross_validate(np.delete(found.columns, first + k, axis=2), measured)
            if not _supported(narrower, found, first + k, len(joints)):
                found = narrower
                del joints[k]

    compliance, deviation = found.whole.value, jackknife_deviation(found.values)

    def rivals(place: int) -> tuple[int, ...]:
        """Return the joints (from 1) whose bearing in place of a found one predicts as well."""
        columns, as_good = found.columns.copy(), []
        for other in free:
            columns[:, :, first + place] = added[:, :, other]
            if _is_as_good(cross_validate(columns, measured), found):
                as_good.append(other + 1)
        return tuple(as_good)

    return tuple(
        BearingTilt(
            joint=j + 1,
            compliance=float(compliance[first + k]),
            sd=float(deviation[first + k]),
            rivals=rivals(k),
        )
        for k, j in enumerate(joints)
    )


def tilt_explanations(recorded: StaticSet, tilt: Sequence[BearingTilt]) -> list[np.ndarray]:
    """Return the columns (m, 3, k) of the bearings found, then with each rival in its place."""
    if not tilt:
        return [np.empty((*recorded.displacement.shape, 0))]
    found = [each.joint - 1 for each in tilt]
    sets = [found]
    for k, each in enumerate(tilt):
        sets += [[*found[:k], rival - 1, *found[k + 1 :]] for rival in each.rivals]
    added = tilt_columns(recorded)
    return [added[:, :, joints] for joints in sets]


def _is_as_good(rival: CrossValidation, found: CrossValidation) -> bool:
    """Return True where poses left out do not tell a rival from what was found.

    Ranks tell even differences of rounding, so that those below `MIN_GAIN` tell nothing.
    """
    if not rms(found.error) < (1.0 - MIN_GAIN) * rms(rival.error):
        return True
    worse = np.sum(rival.error**2 - found.error**2, axis=1)
    return paired_test(worse) > _MAX_RIVAL_CHANCE


def _supported(narrower: CrossValidation, wider: CrossValidation, column: int, tried: int) -> bool:
    """Return True where a column differs from zero and decreases the error on poses left out.

    As torsion, by Student's t of its fits without one pose each, adjusted for the joints tried.
    """
    from scipy.stats import t

    if not rms(wider.error) < (1.0 - MIN_GAIN) * rms(narrower.error):
        return False
    tilt = wider.values[:, column]
    factor = float(t.ppf(1.0 - MAX_CHANCE / tried, len(tilt) - 1))
    return float(np.mean(tilt)) > factor * float(jackknife_deviation(tilt[:, None])[0])
