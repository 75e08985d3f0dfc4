"""FIGAROH: base parameters with friction, rotor inertia and offset of every joint.

Regressor, elimination, QR and names are its own; rows are weighed by each joint's residual of a
first fit, as its weighted least squares does. Samples in which a joint hardly moves are left out.
"""

from __future__ import annotations

import numpy as np
from figaroh.identification.parameter import (
    add_standard_additional_parameters,
    get_standard_parameters,
)
from figaroh.tools.qrdecomposition import QRDecomposer
from figaroh.tools.regressor import (
    build_regressor_basic,
    build_regressor_reduced,
    get_index_eliminate,
)
from figaroh.tools.robot import Robot
from given import Given, Samples, answer

# Training samples that are used at most, and test samples at once.
MOST = 6000
LEAST_COLUMN = 1e-3


def regressor(given: Given, robot: Robot, samples: Samples, rows: np.ndarray) -> np.ndarray:
    """FIGAROH's, joint after joint (n K, columns), each joint in its own band."""
    n = len(given.joints)
    config = {
        "has_friction": True,
        "has_actuator_inertia": True,
        "has_joint_offset": True,
        "is_joint_torques": True,
        "act_idxv": list(range(n)),
    }
    blocks: list[np.ndarray] = [np.empty(0)] * n
    for band in np.unique(given.band_of):
        motion = (values[band][rows] for values in (samples.q, samples.v, samples.a))
        whole = build_regressor_basic(robot, *motion, config)
        for j in np.flatnonzero(given.band_of == band):
            blocks[j] = whole[j * len(rows) : (j + 1) * len(rows)]
    return np.vstack(blocks)


def predict(given: Given) -> tuple[np.ndarray, str]:
    """All joints."""
    robot = Robot(given.urdf, package_dirs=".")
    n = len(given.joints)
    assert tuple(robot.model.names[1:]) == given.joints, "joints stand in another order"
    config = {"has_friction": True, "has_actuator_inertia": True, "has_joint_offset": True}
    standard = get_standard_parameters(robot.model)
    standard |= add_standard_additional_parameters(robot.model, config)
    total = len(given.train.torque)
    rows = np.linspace(0, total - 1, min(MOST, total)).astype(int)
    moving = np.concatenate([given.moving(j)[rows] for j in range(n)])
    joint = np.repeat(np.arange(n), len(rows))[moving]
    matrix = regressor(given, robot, given.train, rows)[moving]
    torque = given.train.torque[rows].T.ravel()[moving]
    gone, names = get_index_eliminate(matrix, standard, LEAST_COLUMN)
    reduced = build_regressor_reduced(matrix, gone)
    first = QRDecomposer()
    base, _, _, values = first.double_decomposition(torque, reduced, names)
    left = torque - base @ values
    size = np.array([np.sqrt(np.mean(left[joint == j] ** 2)) if (joint == j).any() else 1.0
                     for j in range(n)])[joint]  # fmt: skip
    kept = list(first.base_indices)
    values = np.linalg.lstsq(reduced[:, kept] / size[:, None], torque / size, rcond=None)[0]
    predicted = []
    for part in np.array_split(
        np.arange(len(given.test.nominal)), 1 + len(given.test.nominal) // MOST
    ):
        wanted = build_regressor_reduced(regressor(given, robot, given.test, part), gone)
        predicted.append((wanted[:, kept] @ values).reshape(n, len(part)).T)
    return np.vstack(predicted), f"{len(kept)} base parameters"


if __name__ == "__main__":
    answer(predict)
