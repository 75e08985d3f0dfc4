"""What each peer is given and gives back; with numpy alone, as it runs in their environments."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

# Slower samples say little of friction [rad/s, m/s].
SLOW = 0.03


@dataclass(frozen=True)
class Samples:
    """Samples of all runs of one role.

    Attributes
    ----------
    q, v, a : array (B, K, n)
        Motion of all joints in each of the bands.
    torque, nominal : array (K, n)
        As measured (nan where it is not), and of the nominal model in each joint's band.
    """

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    torque: np.ndarray
    nominal: np.ndarray


@dataclass(frozen=True)
class Given:
    """A robot with its training runs, and the motion of its test runs.

    Attributes
    ----------
    urdf : str
    joints : tuple of str
    band_of : array (n,) of int
        Which of the bands the torque of each joint follows.
    rotor_inertia : array (n,)
        At the joints, zero where nobody gave it.
    train, test : Samples
        Torques of the test runs are nan.
    """

    urdf: str
    joints: tuple[str, ...]
    band_of: np.ndarray
    rotor_inertia: np.ndarray
    train: Samples
    test: Samples

    def moving(self, j: int) -> np.ndarray:
        """Training samples that joint j is fitted to (K,) of bool."""
        fast = np.abs(self.train.v[self.band_of[j], :, j]) >= SLOW
        return fast & np.isfinite(self.train.torque[:, j])


def answer(predict: Callable[[Given], tuple[np.ndarray, str]]) -> None:
    """Answer FILE.npz with the torques of the test samples, and print the size of the model."""
    path = Path(sys.argv[1])
    with np.load(path) as stored:
        roles = [
            Samples(*(stored[f"{role}_{name}"] for name in ("q", "v", "a", "torque", "nominal")))
            for role in ("train", "test")
        ]
        given = Given(
            str(stored["urdf"]),
            tuple(str(name) for name in stored["joints"]),
            stored["band_of"],
            stored["rotor_inertia"],
            *roles,
        )
    torque, size = predict(given)
    np.save(path.with_suffix(".npy"), torque)
    print(json.dumps(size))
