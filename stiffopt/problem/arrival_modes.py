"""How an arm swings on after its motors have stopped, as a smooth function of the links' end.

The links of a planned motion need not be at rest when the motors are: what is left swings freely
in the modes of the end pose and decays. In flat coordinates (`problem.motor_model`) the links'
state at the end and the motors' are functions of the same derivatives.
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

# What a plan leaves after arrival though its links are at rest: damping is left out of the wind-up
# and corners of the stiffness are smoothed [m].
_MODEL_AMPLITUDE_ERROR = 5e-6
# The size is smooth at zero, within this share of what is allowed.
_ROOT_SMOOTHING = 1e-2
# Share of what is allowed that the modes may take where nearly all of it is left anyway.
_MIN_BOUND_SHARE = 0.2


@dataclass(frozen=True, eq=False)
class ArrivalModes:
    """The modes in which the links swing on.

    Parameters
    ----------
    sizes : tuple of Quantity
        Square of the size at the tool when the motors stop, one a mode [m^2].
    decays : array (K,)
        Rates at which the sizes decay [1/s].
    """

    sizes: tuple[Quantity, ...]
    decays: np.ndarray

    @classmethod
    def of(cls, modes: Sequence[Mode], model: MotorModel) -> ArrivalModes:
        """From the modes in the end pose and the model of the end state."""
        shapes = np.stack([mode.shape for mode in modes], axis=1)
        # The other way round: from joints to modes; rigid joints are in none.
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
        """Sum of the modes' sizes [m] at most `allowed`, a time `after` the motors' stop [s].

        By the root of their squares and number, which is never less: the sum itself has a corner
        wherever a mode rests, and is least just there.
        """
        share = np.exp(-self.decays * after) / allowed
        weights = len(share) * share**2
        squares = sum(float(own) * size for own, size in zip(weights, self.sizes, strict=True))
        total = ca.sqrt(squares + _ROOT_SMOOTHING**2) - _ROOT_SMOOTHING
        upper = max(1.0 - _MODEL_AMPLITUDE_ERROR / allowed, _MIN_BOUND_SHARE)
        return PathRows(name=name, labels=("tool",), expressions=(total,), upper=upper)
