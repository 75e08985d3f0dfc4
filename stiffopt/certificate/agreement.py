"""Model agreement: the optimiser's prediction of its own motion against the exact model.

Limits that hold and an objective that is not worse do not show a model error on the safe side, or
one where no limit is active. So torques, wind-up and deflection are compared pointwise, in both
directions, at the optimiser's own instants, each relative to its size over the motion.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.certificate.assess import assess, drive_history, joint_windup
from stiffopt.errors import format_relative
from stiffopt.result.assessment import PredictedMotion

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.trajectory import JointMotion

# Relative tolerances. Two implementations of rigid-body dynamics differ by rounding, 1e-12.
TORQUE_TOLERANCE = 1e-6
# Expected: smoothed kinks of a reducer, up to 0.5 % of its wind-up at the last smoothing, and fits
# of contact laws, 0.2 %; on the shipped problems together 0.3 % of a wind-up.
WINDUP_TOLERANCE = 1e-2
# Of the largest part: parts of the deflection are differences of wind-ups and inherit their error.
DEFLECTION_TOLERANCE = 1e-2
# Shares of the torque limit below which a joint's torque, and its wind-up, count as zero.
_IDLE_TORQUE_SHARE = 1e-3
_IDLE_WINDUP_TORQUE_SHARE = 1e-2


@dataclass(frozen=True)
class Disagreement:
    """Largest difference of one quantity from the optimiser's prediction."""

    quantity: str  # "spring torque", "drive torque", "wind-up" or a part of the deflection
    joint: int | None  # 1-based; None for the tool
    time: float  # [s]
    # Predicted minus true where it differs most, over the quantity's size along the motion; for a
    # deflection the length of the difference over the largest part's.
    value: float
    tolerance: float

    @property
    def excess(self) -> float:
        """Magnitude over tolerance: above 1 the two disagree."""
        return abs(self.value) / self.tolerance

    def describe(self) -> str:
        """Text for messages: "wind-up of joint 2 at 0.210 s by +12 %"."""
        owner = f" of joint {self.joint}" if self.joint else ""
        excess = format_relative(self.value, sign="+")
        return f"{self.quantity}{owner} at {self.time:.3f} s by {excess}"


def find_disagreements(
    problem: TrajectoryProblem, motion: JointMotion, believed: PredictedMotion
) -> tuple[Disagreement, ...]:
    """Return the largest difference of every quantity, the worst over its tolerance first."""
    found = list(_compare_quantities(problem, motion, believed))
    return tuple(sorted(found, key=lambda d: -d.excess))


def _compare_quantities(
    problem: TrajectoryProblem, motion: JointMotion, believed: PredictedMotion
) -> Iterator[Disagreement]:
    robot, time = problem.robot, believed.time
    true, carried = drive_history(problem, motion, time)
    idle = _IDLE_TORQUE_SHARE * np.asarray(robot.torque_max)
    size = np.maximum(np.max(np.abs(carried), axis=0), idle)
    spring = believed.spring_torque - carried
    yield from _joint_disagreements("spring torque", spring / size, time, TORQUE_TOLERANCE)
    if believed.torque is not None:
        # Around standstill the smooth law of dry friction is below the sharp one by this much.
        lacking = robot.coulomb * np.exp(-2.0 * np.abs(true.velocity) / believed.friction_width)
        drive = believed.torque - true.torque
        drive = np.sign(drive) * np.maximum(np.abs(drive) - 2.0 * lacking, 0.0)
        size = np.maximum(np.max(np.abs(true.torque), axis=0), idle)
        yield from _joint_disagreements("drive torque", drive / size, time, TORQUE_TOLERANCE)
    if believed.windup is None and not believed.deflection:
        return
    whole = assess(problem, motion, times=time)
    if believed.windup is not None:
        slight = joint_windup(
            robot, _IDLE_WINDUP_TORQUE_SHARE * np.asarray(robot.torque_max)[None]
        )[0]
        size = np.maximum(np.max(np.abs(whole.windup), axis=0), slight)
        shares = _relative_differences(believed.windup - whole.windup, size)
        yield from _joint_disagreements("wind-up", shares, time, WINDUP_TOLERANCE)
    largest = max(part.peak for part in whole.deflection_summary().values())
    for part, vectors in believed.deflection.items():
        away = np.linalg.norm(vectors - whole.deflection[part], axis=1)
        shares = _relative_differences(away, largest)
        k = int(np.argmax(shares))
        yield Disagreement(
            f"{part} deflection", None, float(time[k]), float(shares[k]), DEFLECTION_TOLERANCE
        )


def _joint_disagreements(
    quantity: str, shares: np.ndarray, time: np.ndarray, tolerance: float
) -> Iterator[Disagreement]:
    for j, share in enumerate(shares.T):
        k = int(np.argmax(np.abs(share)))
        yield Disagreement(quantity, j + 1, float(time[k]), float(share[k]), tolerance)


def _relative_differences(difference: np.ndarray, size: np.ndarray | float) -> np.ndarray:
    """Return difference over size: 0 without difference, infinite where a connection slips."""
    with np.errstate(invalid="ignore", divide="ignore"):
        shares = np.where(difference == 0.0, 0.0, difference / size)
    return np.where(np.isnan(shares), np.inf, shares)
