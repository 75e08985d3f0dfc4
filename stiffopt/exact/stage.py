"""Unsmoothed wind-up of one element of a drivetrain, referred to the joint's output."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.exact import connection
from stiffopt.exact.quadrature import Antiderivative, antiderivative

if TYPE_CHECKING:
    from stiffopt.connection import Connection
    from stiffopt.drivetrain.stage import Stage

Preloads = Mapping[str, float] | None


def stage_compliance(stage: Stage, torque: np.ndarray, preloads: Preloads) -> np.ndarray:
    """Slope of `stage_windup` [rad/(N m)] at the joint torque through this stage, (k,) [N m]."""
    down = stage.ratio * stage.efficiency
    own = connection.tangent_compliance(stage.element, torque / down, _preload(stage, preloads))
    return own * (_turn(stage) / down)


def stage_windup(stage: Stage, torque: np.ndarray, preloads: Preloads) -> np.ndarray:
    """Wind-up at the joint [rad] by quadrature of the slope, (k,) [N m] -> (k,)."""
    own = torque / (stage.ratio * stage.efficiency)
    largest = float(np.max(np.abs(own), initial=0.0))
    base = stage.element.torque_max
    # Whole octaves of the largest torque meant, so that one curve serves many calls.
    octaves = max(0, math.ceil(math.log2(largest / base))) if largest > base else 0
    # Without the name, so that equal elements share a curve.
    unnamed = replace(stage.element, name="")
    curve = _curve(unnamed, _preload(stage, preloads), base * 2.0**octaves)
    return _turn(stage) * curve(own)


def stage_slip_torque(stage: Stage, preloads: Preloads) -> float:
    """Joint torque [N m] at which this stage alone would slip."""
    own = connection.slip_torque(stage.element, _preload(stage, preloads))
    return own * stage.ratio * stage.efficiency


def _turn(stage: Stage) -> float:
    """Turn of the joint for a unit turn of the element; see `Chain.reflect` for the other one."""
    return 1.0 / stage.ratio if stage.reflect else stage.ratio * stage.efficiency


def _preload(stage: Stage, preloads: Preloads) -> float | None:
    return (preloads or {}).get(stage.element.name)


@functools.lru_cache(maxsize=512)
def _curve(element: Connection, preload: float | None, upper: float) -> Antiderivative:
    return antiderivative(
        lambda torque: connection.tangent_compliance(element, torque, preload),
        upper,
        connection.breakpoints(element),
    )
