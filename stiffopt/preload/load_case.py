"""Loads of a preload design: at one instant, and along a motion."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stiffopt.errors import ProblemError

# Torque over the largest torque of a joint that counts as zero, without reversal [-].
ZERO_TORQUE_SHARE = 1e-9
# Optional fields of a load besides its torques.
_OPTIONAL_FIELDS = ("reference_torque", "jacobian", "wrench", "reference_wrench", "frames", "arm")


@dataclass(frozen=True, kw_only=True, eq=False)
class LoadCase:
    """Torques of the joints at one instant.

    Parameters
    ----------
    torque : array (n,)
        In the joints' springs [N m], signed.
    reference_torque : array (n,), optional
        Torque whose wind-up does not count in the tool deflection [N m], such as gravity with
        calibrated sag.
    jacobian : array (3, n), optional
        Of the tool point, base axes; required for the tool deflection.
    wrench : array (n, 6), optional
        Force and moment in every joint, about its origin, the third axis along the joint's [N],
        [N m]; see `stiffopt.robot.joint_load`. Without it the load is torque only.
    reference_wrench : array (n, 6), optional
        Part of it that does not count in the tool deflection, as `reference_torque`.
    frames : array (n, 3, 3), optional
        Axes of the joints as columns, base axes.
    arm : array (n, 3), optional
        From each joint's origin to the tool point, base axes [m]; 0 if the joint does not move it.
        Frames and arm are required for the tilting of flanges.
    reversing : array (n,) of bool, optional
        Joints whose torque changes its sign in the motion of the case.
    time : float, optional
        Time in that motion [s].
    source : str
        Origin of the torques.
    """

    name: str
    torque: np.ndarray
    reference_torque: np.ndarray | None = None
    jacobian: np.ndarray | None = None
    wrench: np.ndarray | None = None
    reference_wrench: np.ndarray | None = None
    frames: np.ndarray | None = None
    arm: np.ndarray | None = None
    reversing: np.ndarray | None = None
    time: float | None = None
    source: str = "given"

    def __post_init__(self) -> None:
        _require_finite(self, f"Load case {self.name!r}")


@dataclass(frozen=True, kw_only=True, eq=False)
class LoadHistory:
    """Torques along a motion, whose worst instants become load cases."""

    name: str
    time: np.ndarray  # (K,) [s]
    torque: np.ndarray  # (K, n) [N m]
    reference_torque: np.ndarray | None = None  # (K, n) [N m]
    jacobian: np.ndarray | None = None  # (K, 3, n)
    # (K, n, 6).
    wrench: np.ndarray | None = None
    reference_wrench: np.ndarray | None = None
    frames: np.ndarray | None = None  # (K, n, 3, 3)
    arm: np.ndarray | None = None  # (K, n, 3) as of a `LoadCase`
    source: str = "given"

    def __post_init__(self) -> None:
        _require_finite(self, f"Load history {self.name!r}")
        if self.torque.ndim != 2 or len(self.time) != len(self.torque) or not len(self.time):
            raise ProblemError(
                f"Load history {self.name!r}: time (K,) and torque (K, n) do not fit: "
                f"{self.time.shape} and {self.torque.shape}."
            )

    @cached_property
    def reversing(self) -> np.ndarray:
        """Joints whose torque changes its sign beyond rounding, (n,) of bool."""
        noise = ZERO_TORQUE_SHARE * np.abs(self.torque).max(axis=0)
        return np.asarray((self.torque.min(axis=0) < -noise) & (self.torque.max(axis=0) > noise))

    def at(self, index: int) -> LoadCase:
        """Return the load case at an instant, named by motion and time."""
        return LoadCase(
            name=f"{self.name} at {self.time[index]:.3f} s",
            torque=self.torque[index],
            **{
                key: None if (values := getattr(self, key)) is None else values[index]
                for key in _OPTIONAL_FIELDS
            },
            reversing=self.reversing,
            time=float(self.time[index]),
            source=self.source,
        )


def _require_finite(loads: LoadCase | LoadHistory, owner: str) -> None:
    """Convert the array fields to arrays and raise `ProblemError` for values not finite."""
    for key in ("time", "torque", *_OPTIONAL_FIELDS):
        value = getattr(loads, key)
        if value is None or isinstance(value, float):
            continue
        array = np.asarray(value, dtype=float)
        if not np.isfinite(array).all():
            raise ProblemError(f"{owner}: {key} must be finite numbers.")
        object.__setattr__(loads, key, array)
