"""What the load cases of a study bring to its flanges, and VDI 2230 of each of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stiffopt.connection import BoltedFlange
from stiffopt.drivetrain.chain import Stage
from stiffopt.fastening.flange_load import FlangeLoads
from stiffopt.fastening.tightening import Tightening
from stiffopt.fastening.verification import SLIP_ALTERNATING, SLIP_STATIC, Verification
from stiffopt.preload.load_case import LoadCase, LoadHistory
from stiffopt.robot.joint_load import at_face


def flange_values(
    stage: Stage, joint: int, torque: np.ndarray, wrench: np.ndarray | None
) -> np.ndarray:
    """Loads of a flange in its own axes, at its face.

    Parameters
    ----------
    stage : Stage
        Of a bolted flange. Where it turns faster than its joint, on the motor's side, it carries
        its part of the torque alone.
    joint : int
        1-based.
    torque : array (K, n)
        Of the joints [N m].
    wrench : array (K, n, 6) or None

    Returns
    -------
    array (K, 6)
    """
    values = np.zeros((len(torque), 6))
    flange = stage.element
    assert isinstance(flange, BoltedFlange)
    if wrench is not None and stage.ratio == 1.0:
        values = at_face(wrench[:, joint - 1], flange.face_position)
    values[:, 5] = torque[:, joint - 1] / stage.reduction
    return values


def turns_back(cases: Sequence[LoadCase], joint: int) -> bool:
    """Whether the torque of a joint changes its sign in one of the motions that cases are of."""
    return any(c.reversing is not None and bool(c.reversing[joint - 1]) for c in cases)


def slip_safety(asked: float | None, cases: Sequence[LoadCase], joint: int) -> float:
    """Safety against slip in a joint [-] (R12): what is asked for, else by whether it reverses."""
    if asked is not None:
        return asked
    return SLIP_ALTERNATING if turns_back(cases, joint) else SLIP_STATIC


def case_loads(stage: Stage, joint: int, cases: Sequence[LoadCase]) -> FlangeLoads:
    """Loads of a flange in all load cases; those without a wrench have their torque alone."""
    values = [
        flange_values(
            stage, joint, case.torque[None], None if case.wrench is None else case.wrench[None]
        )
        for case in cases
    ]
    return FlangeLoads(
        names=tuple(case.name for case in cases),
        values=np.concatenate(values),
        alternating=turns_back(cases, joint),
    )


def verification(
    stage: Stage,
    joint: int,
    cases: Sequence[LoadCase],
    tightening: Tightening,
    slip_safety: float | None,
) -> Verification | None:
    """VDI 2230 of a flange under the load cases; None for pins."""
    if not isinstance(stage.element, BoltedFlange):
        return None
    loads = case_loads(stage, joint, cases)
    return Verification(stage.element, tightening, loads, slip_safety)


def critical_instants(
    stage: Stage, joint: int, history: LoadHistory, tightening: Tightening
) -> set[int]:
    """Instants of a motion that are worst for some check of a flange."""
    if not isinstance(stage.element, BoltedFlange) or history.wrench is None:
        return set()
    if stage.element.bearing == "beside":
        return set()
    values = flange_values(stage, joint, history.torque, history.wrench)
    loads = FlangeLoads(
        names=("",) * len(values), values=values, alternating=bool(history.reversing[joint - 1])
    )
    worst = Verification(stage.element, tightening, loads)
    place = int(np.argmax(np.ptp(worst.axial, axis=0)))
    return {
        int(np.argmax(worst.clamp_needed)),
        int(np.argmax(worst.clamp_against_opening)),
        int(np.argmax(worst.opening.max(axis=1))),
        int(np.argmax(np.linalg.norm(values[:, :2], axis=1))),
        int(np.argmax(worst.axial[:, place])),
        int(np.argmin(worst.axial[:, place])),
    }
