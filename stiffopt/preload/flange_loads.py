"""Loads of a study's flanges, their VDI 2230 verification, and the tool deflection by tilting."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stiffopt.connection import BoltedFlange
from stiffopt.drivetrain.chain import Stage
from stiffopt.fastening.flange_load import FlangeLoads
from stiffopt.fastening.tightening import Tightening
from stiffopt.fastening.tilting import tilting_flange
from stiffopt.fastening.verification import (
    MIN_ALTERNATING_SLIP_SAFETY,
    MIN_STATIC_SLIP_SAFETY,
    Verification,
)
from stiffopt.preload.load_case import LoadCase, LoadHistory
from stiffopt.robot.joint_load import shift_wrench


def flange_values(
    stage: Stage, joint: int, torque: np.ndarray, wrench: np.ndarray | None
) -> np.ndarray:
    """Return the loads (K, 6) of a flange in its own axes, at its interface.

    On the motor side of a reducer it carries its share of the torque (K, n) only, none of the
    wrench (K, n, 6).
    """
    values = np.zeros((len(torque), 6))
    flange = stage.element
    assert isinstance(flange, BoltedFlange)
    if wrench is not None and stage.ratio == 1.0:
        values = shift_wrench(wrench[:, joint - 1], flange.face_position)
    values[:, 5] = torque[:, joint - 1] / stage.reduction
    return values


def torque_reverses(cases: Sequence[LoadCase], joint: int) -> bool:
    """Return True if the torque of a joint changes its sign in a motion of the load cases."""
    return any(c.reversing is not None and bool(c.reversing[joint - 1]) for c in cases)


def slip_safety(asked: float | None, cases: Sequence[LoadCase], joint: int) -> float:
    """Return the required slip safety of a joint [-] (R12): given, static or alternating."""
    if asked is not None:
        return asked
    return MIN_ALTERNATING_SLIP_SAFETY if torque_reverses(cases, joint) else MIN_STATIC_SLIP_SAFETY


def case_loads(stage: Stage, joint: int, cases: Sequence[LoadCase]) -> FlangeLoads:
    """Return the loads of a flange in all load cases; torque only without a wrench."""
    values = [
        flange_values(
            stage, joint, case.torque[None], None if case.wrench is None else case.wrench[None]
        )
        for case in cases
    ]
    return FlangeLoads(
        names=tuple(case.name for case in cases),
        values=np.concatenate(values),
        alternating=torque_reverses(cases, joint),
    )


def verification(
    stage: Stage,
    joint: int,
    cases: Sequence[LoadCase],
    tightening: Tightening,
    slip_safety: float | None,
) -> Verification | None:
    """Return the VDI 2230 verification of a flange under the load cases; None for pins."""
    if not isinstance(stage.element, BoltedFlange):
        return None
    loads = case_loads(stage, joint, cases)
    return Verification(stage.element, tightening, loads, slip_safety)


def critical_instants(
    stage: Stage, joint: int, history: LoadHistory, tightening: Tightening
) -> set[int]:
    """Return the instants of a motion that are worst for any check of a flange."""
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


def carries_tilting(stage: Stage) -> bool:
    """Return True for a flange with given bolts that carries the joint's tilting moment."""
    flange = stage.element
    if not isinstance(flange, BoltedFlange) or flange.bolt is None:
        return False
    return flange.bearing == "none" and stage.ratio == 1.0


def tool_levers(
    stage: Stage, joint: int, load: LoadCase | LoadHistory
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return tilting moments of a flange and the vector from it to the tool, in base axes.

    `joint`: 1-based. Returns (moments (..., 2, 3) [N m], arm (..., 3) [m]) or None: moments of the
    full load and of the reference load, which does not count in the deflection. None if the load
    has no moments or the flange carries none.
    """
    if load.wrench is None or load.frames is None or load.arm is None or not carries_tilting(stage):
        return None
    flange = stage.element
    assert isinstance(flange, BoltedFlange)
    place = joint - 1
    frame = load.frames[..., place, :, :]
    reference = load.reference_wrench
    loads = [load.wrench, np.zeros_like(load.wrench) if reference is None else reference]
    moments = np.stack(
        [shift_wrench(w[..., place, :], flange.face_position)[..., 3:5] for w in loads], -2
    )
    turned = np.einsum("...ij,...mj->...mi", frame[..., :2], moments)
    return turned, load.arm[..., place, :] - flange.face_position * frame[..., 2]


def tilt_vector(stage: Stage, joint: int, load: LoadCase | LoadHistory) -> np.ndarray:
    """Return the tool displacement at a compliance of 1 rad/(N m) (..., 3) [m N m/rad]."""
    found = tool_levers(stage, joint, load)
    if found is None:
        return np.zeros((*load.torque.shape[:-1], 3))
    moments, arm = found
    return np.asarray(np.cross(moments[..., 0, :] - moments[..., 1, :], arm))


def tilt_deflection(
    stage: Stage, joint: int, load: LoadCase | LoadHistory, preload: float
) -> np.ndarray:
    """Return the tool displacement by one flange at a preload in service (..., 3) [m].

    Signed along the joint's reaction, like its wind-up; infinite without preload under a moment.
    """
    found = tool_levers(stage, joint, load)
    if found is None:
        return np.zeros((*load.torque.shape[:-1], 3))
    moments, arm = found
    if preload <= 0.0:
        loose = np.abs(moments).sum(axis=(-2, -1), keepdims=True)[..., 0]
        return np.where(loose > 0.0, np.inf, np.zeros((*load.torque.shape[:-1], 3)))
    flange = stage.element
    assert isinstance(flange, BoltedFlange)
    tilting = tilting_flange(flange, preload)
    sizes = np.linalg.norm(moments, axis=-1)
    turn = np.vectorize(tilting.secant_compliance, otypes=[float])(sizes)[..., None] * moments
    return np.asarray(np.cross(turn[..., 0, :] - turn[..., 1, :], arm))
