"""Whether the optimiser believed of its motion what is true: pointwise, in both directions.

A limit that holds and an objective that is not worse say nothing of a model that is wrong to the
safe side, or wrong where no limit is near. So torques, wind-up and deflection are compared at the
optimiser's own instants, each relative to its size over the motion.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.certificate.assess import assess, drive_history, joint_windup
from stiffopt.errors import relative
from stiffopt.result.assessment import PredictedMotion

if TYPE_CHECKING:
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.result.trajectory import JointMotion

# Two codes of one rigid-body dynamics differ by rounding, 1e-12 of the torque.
TORQUE = 1e-6
# Honest are the smoothed corners of a reducer, up to 0.5 % of its wind-up at the last smoothing,
# and the fits of contact laws, 0.2 %; on the shipped problems they come to 0.3 % of a wind-up.
WINDUP = 1e-2
# Parts of the deflection are differences of wind-ups and err with these: relative to the largest.
DEFLECTION = 1e-2
# Below these shares of the largest torque, and of the wind-up there, a joint is as good as idle.
_IDLE = 1e-3
_IDLE_WINDUP = 1e-2


@dataclass(frozen=True)
class Disagreement:
    """The largest difference of one quantity from what the optimiser believed.

    Parameters
    ----------
    quantity : str
        "spring torque", "drive torque", "wind-up" or a part of the deflection.
    joint : int or None
        1-based; None for the tool.
    time : float [s]
    value : float
        Believed minus true where it differs most, over the quantity's size along the motion; of a
        deflection the length of the difference over the largest part's.
    tolerance : float
    """

    quantity: str
    joint: int | None
    time: float
    value: float
    tolerance: float

    @property
    def excess(self) -> float:
        """Size over tolerance: above 1 the two disagree."""
        return abs(self.value) / self.tolerance

    def describe(self) -> str:
        """Text for messages: "wind-up of joint 2 at 0.210 s by +12 %"."""
        owner = f" of joint {self.joint}" if self.joint else ""
        return f"{self.quantity}{owner} at {self.time:.3f} s by {relative(self.value, sign='+')}"


def differences(
    problem: TrajectoryProblem, motion: JointMotion, believed: PredictedMotion
) -> tuple[Disagreement, ...]:
    """Largest difference of every quantity, the worst over its tolerance first.

    Parameters
    ----------
    problem : TrajectoryProblem
    motion : callable
        As for `assess`.
    believed : Believed
    """
    found = list(_compared(problem, motion, believed))
    return tuple(sorted(found, key=lambda d: -d.excess))


def _compared(
    problem: TrajectoryProblem, motion: JointMotion, believed: PredictedMotion
) -> Iterator[Disagreement]:
    robot, time = problem.robot, believed.time
    true, carried = drive_history(problem, motion, time)
    idle = _IDLE * np.asarray(robot.torque_max)
    size = np.maximum(np.max(np.abs(carried), axis=0), idle)
    spring = believed.spring_torque - carried
    yield from _joints("spring torque", spring / size, time, TORQUE)
    if believed.torque is not None:
        # About standstill the sharp law of dry friction jumps; the smooth one lacks this much.
        lacking = robot.coulomb * np.exp(-2.0 * np.abs(true.velocity) / believed.friction_width)
        drive = believed.torque - true.torque
        drive = np.sign(drive) * np.maximum(np.abs(drive) - 2.0 * lacking, 0.0)
        size = np.maximum(np.max(np.abs(true.torque), axis=0), idle)
        yield from _joints("drive torque", drive / size, time, TORQUE)
    if believed.windup is None and not believed.deflection:
        return
    whole = assess(problem, motion, times=time)
    if believed.windup is not None:
        slight = joint_windup(robot, _IDLE_WINDUP * np.asarray(robot.torque_max)[None])[0]
        size = np.maximum(np.max(np.abs(whole.windup), axis=0), slight)
        shares = _shares(believed.windup - whole.windup, size)
        yield from _joints("wind-up", shares, time, WINDUP)
    largest = max(part.peak for part in whole.deflection_summary().values())
    for part, vectors in believed.deflection.items():
        away = np.linalg.norm(vectors - whole.deflection[part], axis=1)
        shares = _shares(away, largest)
        k = int(np.argmax(shares))
        yield Disagreement(f"{part} deflection", None, float(time[k]), float(shares[k]), DEFLECTION)


def _joints(
    quantity: str, shares: np.ndarray, time: np.ndarray, tolerance: float
) -> Iterator[Disagreement]:
    for j, share in enumerate(shares.T):
        k = int(np.argmax(np.abs(share)))
        yield Disagreement(quantity, j + 1, float(time[k]), float(share[k]), tolerance)


def _shares(difference: np.ndarray, size: np.ndarray | float) -> np.ndarray:
    """Difference over size: 0 where there is none, infinite where a connection slips."""
    with np.errstate(invalid="ignore", divide="ignore"):
        shares = np.where(difference == 0.0, 0.0, difference / size)
    return np.where(np.isnan(shares), np.inf, shares)
