"""Residual vibration as a smooth function of the links' state at arrival.

The links of a planned motion need not be at rest when the motors stop: they then vibrate freely
in the elastic modes of the end pose and decay. In flat coordinates (`problem.motor_model`) the
end states of links and motors are functions of the same derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from stiffopt.problem.stage_terms import PathRows

if TYPE_CHECKING:
    from collections.abc import Sequence

    from stiffopt.elastic.modes import Mode
    from stiffopt.problem.motor_model import MotorModel
    from stiffopt.symbolic import Quantity

# Residual vibration of a plan whose links end at rest [m]: the optimiser's wind-up neglects damping
# and smooths the kinks of the stiffness.
_MODEL_AMPLITUDE_ERROR = 5e-6
# Width over which the root of the squared amplitudes is smoothed at zero, over the bound.
_ROOT_SMOOTHING = 1e-2
# Least share of the bound left to the modes where the model's error takes most of it.
_MIN_BOUND_SHARE = 0.2


@dataclass(frozen=True, eq=False)
class ArrivalModes:
    """Elastic modes of the end pose with their amplitudes at arrival."""

    # Squared amplitude at the tool when the motors stop, for each mode [m^2].
    sizes: tuple[Quantity, ...]
    decays: np.ndarray  # (K,) decay rates of the amplitudes [1/s]

    @classmethod
    def of(cls, modes: Sequence[Mode], model: MotorModel) -> ArrivalModes:
        """Project the end state of `model` onto the modes of the end pose."""
        shapes = np.stack([mode.shape for mode in modes], axis=1)
        # Pseudo-inverse: modes span the compliant joints only.
        along = np.linalg.pinv(shapes)
        links, speed, _ = model.link
        displaced = ca.mtimes(ca.DM(along), links - model.position)
        moved = ca.mtimes(ca.DM(along), speed)
        sizes, decays = [], []
        for k, mode in enumerate(modes):
            rate = 2.0 * np.pi * mode.frequency
            reach = float(mode.tool @ mode.tool)
            sizes.append(reach * (displaced[k] ** 2 + (moved[k] / rate) ** 2))
            decays.append(mode.damping * rate)
        return cls(sizes=tuple(sizes), decays=np.array(decays))

    def row(self, name: str, allowed: float, after: float) -> PathRows:
        """Bound the sum of modal amplitudes by `allowed` [m], a time `after` [s] the motors' stop.

        The root of the mode count times the summed squares is used: it is never less than the sum,
        and smooth where the sum has a kink, at every mode at rest.
        """
        share = np.exp(-self.decays * after) / allowed
        weights = len(share) * share**2
        squares = sum(float(own) * size for own, size in zip(weights, self.sizes, strict=True))
        total = ca.sqrt(squares + _ROOT_SMOOTHING**2) - _ROOT_SMOOTHING
        upper = max(1.0 - _MODEL_AMPLITUDE_ERROR / allowed, _MIN_BOUND_SHARE)
        return PathRows(name=name, labels=("tool",), expressions=(total,), upper=upper)
