"""What can be minimised. Values are SI; several objectives are summed with their weights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from stiffopt.errors import ProblemError, nearest

UNITS = {
    "dynamic_deflection": "m",
    "total_deflection": "m",
    "process_deflection": "m",
    "joint_stiffness": "N m/rad",
    "mean_compliance": "rad/(N m)",
    "duration": "s",
    "torque_squared": "s",
    "acceleration_squared": "rad^2/s^3",
}
DEFLECTIONS = ("dynamic_deflection", "total_deflection", "process_deflection")
SMOOTHED = (*DEFLECTIONS, "joint_stiffness", "mean_compliance")


@dataclass(frozen=True, kw_only=True)
class Objective:
    """One term of the objective.

    Parameters
    ----------
    name : str
        dynamic_deflection : deviation from the static sag of the same pose; what calibration
        cannot remove. total_deflection : with the sag. process_deflection : the extra deflection
        under the process force. joint_stiffness : MAXIMISES the minimum over time and `joints` of
        k_j / weight_j. mean_compliance : time average of the summed tangent compliance of
        `joints`. duration. torque_squared : integral of the sum of (tau/tau_max)^2.
        acceleration_squared : integral of the sum of squared accelerations.
    measure : "peak" or "rms"
        Of a deflection.
    weight : float
        In the weighted sum.
    joints : tuple of int
        1-based; empty for all joints.
    joint_weights : mapping joint number -> float
        For joint_stiffness: k_j / weight_j is compared; 1 where not given.
    accept_bound : bool
        Solve even where the objective cannot get past a value that no motion changes.
    """

    name: str = "dynamic_deflection"
    measure: str = "peak"
    weight: float = 1.0
    joints: tuple[int, ...] = ()
    joint_weights: Mapping[int, float] = field(default_factory=dict)
    accept_bound: bool = False

    def __post_init__(self) -> None:
        if self.name not in UNITS:
            raise ProblemError(f"Unknown objective {self.name!r}. {nearest(self.name, UNITS)}")
        if self.measure not in ("peak", "rms"):
            raise ProblemError(f"Unknown measure {self.measure!r}; allowed: 'peak' or 'rms'.")
        if not self.weight > 0:
            raise ProblemError(
                f"The weight of {self.name} is {self.weight:g}; allowed: greater than zero."
            )

        if any(not weight > 0 for weight in self.joint_weights.values()):
            raise ProblemError("joint_weights must all be greater than zero.")

    @property
    def maximised(self) -> bool:
        """Whether a larger value is better."""
        return self.name == "joint_stiffness"

    @property
    def unit(self) -> str:
        """SI unit of the value."""
        return UNITS[self.name]

    def weight_of(self, joint: int) -> float:
        """Weight of a joint (1-based) in joint_stiffness."""
        return float(self.joint_weights.get(joint, 1.0))
