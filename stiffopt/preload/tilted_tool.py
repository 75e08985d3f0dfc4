"""What tilting flanges add to the deflection of the tool.

A moment across its axis turns a flange, and the tool with it. While the face presses everywhere the
turn is the moment times one compliance, which falls with the preload.
"""

from __future__ import annotations

import numpy as np

from stiffopt.connection import BoltedFlange
from stiffopt.drivetrain.chain import Stage
from stiffopt.fastening.tilting import tilting_flange
from stiffopt.preload.load_case import LoadCase, LoadHistory
from stiffopt.robot.joint_load import at_face


def tilts(stage: Stage) -> bool:
    """Whether a stage is a flange that carries its joint's moments, and its bolts are known."""
    flange = stage.element
    if not isinstance(flange, BoltedFlange) or flange.bolt is None:
        return False
    return flange.bearing == "none" and stage.ratio == 1.0


def tool_levers(
    stage: Stage, joint: int, load: LoadCase | LoadHistory
) -> tuple[np.ndarray, np.ndarray] | None:
    """Moments across a flange and where the tool is from its face, in base axes.

    Parameters
    ----------
    stage : Stage
    joint : int
        1-based.
    load : LoadCase or LoadHistory

    Returns
    -------
    (moments (..., 2, 3) [N m], arm (..., 3) [m]) or None
        First of all that acts, then of what does not count in the deflection. None where the load
        has no moments, or the flange carries none.
    """
    if load.wrench is None or load.frames is None or load.arm is None or not tilts(stage):
        return None
    flange = stage.element
    assert isinstance(flange, BoltedFlange)
    place = joint - 1
    frame = load.frames[..., place, :, :]
    reference = load.reference_wrench
    loads = [load.wrench, np.zeros_like(load.wrench) if reference is None else reference]
    moments = np.stack(
        [at_face(w[..., place, :], flange.face_position)[..., 3:5] for w in loads], -2
    )
    turned = np.einsum("...ij,...mj->...mi", frame[..., :2], moments)
    return turned, load.arm[..., place, :] - flange.face_position * frame[..., 2]


def tilt_vector(stage: Stage, joint: int, load: LoadCase | LoadHistory) -> np.ndarray:
    """Movement of the tool for a compliance of 1 rad/(N m) (..., 3) [m N m/rad]; 0 without."""
    found = tool_levers(stage, joint, load)
    if found is None:
        return np.zeros((*load.torque.shape[:-1], 3))
    moments, arm = found
    return np.asarray(np.cross(moments[..., 0, :] - moments[..., 1, :], arm))


def tilted_tool(
    stage: Stage, joint: int, load: LoadCase | LoadHistory, preload: float
) -> np.ndarray:
    """Movement of the tool by one flange with a preload left in service (..., 3) [m].

    Along the reaction of the joint, as its wind-up is; infinite where nothing is left of the
    preload of a flange that has to bear a moment.
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
