"""Gain errors of one joint's torque, estimated beside free inertial parameters.

A joint's torque scales with the masses that it carries as with its gain. But neighbouring joints
carry the same masses: all joints are fitted together, with shared inertial parameters and friction
of each.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.sanity.interpretations import Samples
from stiffopt.discovery.sanity.torque_fit import MIN_MOVING_INSTANTS
from stiffopt.discovery.settings import MIN_MOVING_SPEED
from stiffopt.discovery.signals import smooth_sign

# Relative deviation of masses, and deviation of their centres [m].
_MASS_DEVIATION, _CENTRE_DEVIATION = 0.3, 0.2
# Multiple of a stated tolerance of masses, and its least value.
_STATED_TOLERANCE_FACTOR, _MIN_MASS_DEVIATION = 10.0, 0.02
# Load-dependent friction over the load; offset over the largest torque.
_LOAD_FRICTION_SHARE, _OFFSET_SHARE = 0.3, 0.3
# Residual share of a correct model.
_RESIDUAL_FLOOR = 2e-3
# Range of gains; smaller ones are within usual errors of drives.
_MAX_GAIN, _MIN_GAIN = 2.0, 1.21
# Least decrease of the misfit, in shares of variance; least ratio of the joint's residual shares;
# and its largest residual share with the gain.
_MIN_MISFIT_DECREASE, _MIN_SHARE_RATIO, _MAX_RESIDUAL_SHARE = 2.4e-3, 1.5, 0.02
# Least share of a torque's variance from bodies: friction alone identifies no gain.
_MIN_BODY_SHARE = 0.1
_OWN_COLUMNS = 11


@dataclass(frozen=True)
class JointGain:
    """A joint (from 0), its recorded over true torque, and residual shares without and with it."""

    joint: int
    gain: float
    before: float
    after: float


def find_joint_gains(robot: RobotModel, samples: Samples) -> list[JointGain]:
    """Find a joint whose torque has a gain error of 1.2 to 2.

    Parameters
    ----------
    robot : RobotModel
    samples : Samples
        Of the training runs.

    Returns
    -------
    list of JointGain
        Empty if masses, payload and friction explain as much, or the motion cannot decide.
    """
    fit = _CommonFit(robot, samples)
    if len(fit.used) < 2:
        return []
    plain, misfit = fit.solved(1.0, -1)
    found = []
    for j in fit.used:
        best = minimize_scalar(
            lambda x, j=j: fit.solved(float(np.exp(x)), j)[1],
            bounds=(-np.log(1.1 * _MAX_GAIN), np.log(1.1 * _MAX_GAIN)),
            method="bounded",
            options={"xatol": 2e-3},
        )
        gain = float(np.exp(best.x))
        left = fit.solved(gain, j)[0]
        size = max(gain, 1.0 / gain)
        told = (
            fit.of_bodies[j] > _MIN_BODY_SHARE
            and _MIN_GAIN <= size <= _MAX_GAIN
            and left[j] < _MAX_RESIDUAL_SHARE
            and plain[j] > _MIN_SHARE_RATIO * left[j]
        )
        if told and misfit - float(best.fun) > _MIN_MISFIT_DECREASE:
            found.append(JointGain(j, gain, float(plain[j]), float(left[j])))
    # Neighbours of the joint with the error gain a little in the other direction.
    found.sort(key=lambda each: each.after - each.before)
    return found[:1]


def _coupling_columns(
    velocity: np.ndarray, acceleration: np.ndarray, joint: int
) -> Iterator[np.ndarray]:
    """Yield friction and inertia coupled from a neighbour by gears, as in wrists; at most 1."""
    if not 0 <= joint < velocity.shape[1]:
        yield from np.zeros((3, len(velocity)))
        return
    speed, rate = velocity[:, joint], acceleration[:, joint]
    yield smooth_sign(speed)
    yield speed / max(float(np.abs(speed).max()), 1e-9)
    yield rate / max(float(np.abs(rate).max()), 1e-9)


class _CommonFit:
    """Least squares of all joints' torques over shared inertial parameters and own friction."""

    def __init__(self, robot: RobotModel, samples: Samples) -> None:
        motion = np.stack([samples.position, samples.velocity, samples.acceleration])
        known = np.isfinite(motion).all(axis=(0, 2))
        q, v, a = motion[:, known]
        regressor, spring = robot.body_regressor(q, v, a), robot.spring_torque(q, v, a)
        self.shared, self.n = regressor.shape[2], robot.n
        stated = robot.recordings.tolerance.mass
        off = (
            _MASS_DEVIATION
            if stated is None
            else min(_MASS_DEVIATION, max(_STATED_TOLERANCE_FACTOR * stated, _MIN_MASS_DEVIATION))
        )
        sizes = [off * m * np.repeat([1.0, _CENTRE_DEVIATION, _CENTRE_DEVIATION**2], [1, 3, 6])
                 for m in robot.constants.masses]  # fmt: skip
        scale = np.concatenate(sizes)
        self.grams: dict[int, np.ndarray] = {}
        self.of_bodies: dict[int, float] = {}
        for j in range(robot.n):
            torque, speed = samples.torque[known, j], v[:, j]
            rows = (np.abs(speed) >= MIN_MOVING_SPEED) & np.isfinite(torque)
            if rows.sum() < MIN_MOVING_INSTANTS or np.ptp(torque[rows]) == 0.0:
                continue
            direction, most = smooth_sign(speed), float(np.abs(torque[rows]).max())
            own = [
                np.full_like(speed, _OFFSET_SHARE * most),
                most * direction,
                most * speed / max(float(np.abs(speed).max()), 1e-9),
                most * a[:, j] / max(float(np.abs(a[:, j]).max()), 1e-9),
                _LOAD_FRICTION_SHARE * np.abs(spring[:, j]) * direction,
                *(most * column for k in (j - 1, j + 1) for column in _coupling_columns(v, a, k)),
            ]
            table = np.column_stack([torque, spring[:, j], regressor[:, j] * scale, *own])[rows]
            variance = float(np.sum((table[:, 0] - table[:, 0].mean()) ** 2))
            self.grams[j] = table.T @ table / variance
            self.of_bodies[j] = float(np.var(spring[rows, j])) * len(table) / variance
        self.used = list(self.grams)

    def solved(self, gain: float, joint: int) -> tuple[np.ndarray, float]:
        """Return residual shares (n,) and the misfit including priors, for one joint's gain."""
        size = self.shared + _OWN_COLUMNS * self.n
        matrix, right = _RESIDUAL_FLOOR * np.eye(size), np.zeros(size)
        for j, gram in self.grams.items():
            g, at = gain if j == joint else 1.0, self._column_indices(j)
            matrix[np.ix_(at, at)] += g**2 * gram[2:, 2:]
            right[at] += g * (gram[2:, 0] - g * gram[2:, 1])
        found = np.linalg.solve(matrix, right)
        left = np.full(self.n, np.nan)
        for j, gram in self.grams.items():
            g = gain if j == joint else 1.0
            rest = np.concatenate([[1.0, -g], -g * found[self._column_indices(j)]])
            left[j] = rest @ gram @ rest
        return left, float(np.nansum(left) + _RESIDUAL_FLOOR * found @ found)

    def _column_indices(self, joint: int) -> np.ndarray:
        own = self.shared + _OWN_COLUMNS * joint
        return np.concatenate([np.arange(self.shared), np.arange(own, own + _OWN_COLUMNS)])
