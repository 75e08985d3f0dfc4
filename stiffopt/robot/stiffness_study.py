"""Joint stiffness over torque, with and without contacts, by the unsmoothed law."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from stiffopt.connection import Key
from stiffopt.contact.spots import Loading
from stiffopt.contact.surface import SurfacePair
from stiffopt.drivetrain.chain import Chain
from stiffopt.errors import InputError, RobotError
from stiffopt.exact.chain import exact_compliance, exact_windup
from stiffopt.files import write_csv
from stiffopt.robot.robot import Robot

# Geometric from a thousandth of the largest torque: contacts matter at low torque.
DEFAULT_RATIOS: tuple[float, ...] = tuple(
    sorted({*(10.0 ** np.linspace(-3.0, 0.0, 61)).round(12).tolist(), 0.005, 0.02, 0.05, 0.2})
)


Flanks = Literal["series", "parallel"]


@dataclass(frozen=True)
class StiffnessRow:
    """One joint at one torque."""

    joint: int  # from 1
    torque_ratio: float  # torque over the joint's `torque_max` [-]
    torque: float  # [N m]
    # dT/dphi and T/phi of the whole drivetrain [N m/rad].
    tangent_stiffness: float
    secant_stiffness: float
    windup: float  # phi [rad]
    # Of the reducer alone; infinite for a joint without one [N m/rad].
    reducer_only_tangent_stiffness: float
    # Tangent stiffness with contacts over that of the reducer alone [-].
    ratio_to_reducer_only: float
    # Arrangement of the flanks of the keys: "series", "parallel", "mixed", or "none" for a joint
    # without keys.
    flanks: str
    # Tangent stiffness with contacts under first loading, and with contacts that had a larger load
    # before, as in a robot after its first motions [N m/rad].
    first_loading_stiffness: float
    cyclic_stiffness: float


COLUMNS: tuple[str, ...] = tuple(f.name for f in dataclasses.fields(StiffnessRow))


def stiffness_study(
    robot: Robot, ratios: Sequence[float] | None = None, *, both_readings: bool = True
) -> list[StiffnessRow]:
    """Stiffness of every joint over the torque ratio.

    Parameters
    ----------
    ratios : sequence of float, optional
        Torques over `torque_max`, above 0 [-]; default `DEFAULT_RATIOS`.
    both_readings : bool
        Also compute the other arrangement of the key flanks, parallel for series and the reverse.

    Returns
    -------
    list of StiffnessRow
        By joint, then arrangement (that of the robot first), then ratio; none for rigid joints.

    Raises
    ------
    RobotError
        No joint has a drivetrain.
    """
    if all(chain is None for chain in robot.chains):
        raise RobotError(
            f"{robot.name}: no joint has a drivetrain, all are rigid. "
            "Describe the drivetrain in a robot TOML and load it with the URDF."
        )
    shares = np.asarray(DEFAULT_RATIOS if ratios is None else ratios, dtype=float)
    if shares.ndim != 1 or not (np.isfinite(shares).all() and (shares > 0.0).all()):
        raise InputError(
            f"torque ratios must be finite numbers above 0, got {ratios}. "
            "Give shares of torque_max such as 0.01, 0.1, 1."
        )
    rows: list[StiffnessRow] = []
    for j, chain in enumerate(robot.chains):
        if chain is None:
            continue
        torque = shares * robot.torque_max[j]
        for flanks, reading in _flank_readings(chain, both_readings):
            rows += _joint_rows(j + 1, flanks, reading, shares, torque)
    return rows


def write_stiffness_csv(rows: Sequence[StiffnessRow], path: str | os.PathLike[str]) -> None:
    """Write the rows as `stiffness.csv`, atomically."""
    write_csv(path, COLUMNS, [dataclasses.astuple(row) for row in rows])


def with_flanks(chain: Chain, flanks: Flanks) -> Chain:
    """Copy a chain with the flanks of all keys in "series" or "parallel"."""
    stages = tuple(
        replace(s, element=replace(s.element, flanks=flanks)) if isinstance(s.element, Key) else s
        for s in chain.stages
    )
    return replace(chain, stages=stages)


def with_loading(chain: Chain, loading: Loading) -> Chain:
    """Copy a chain with all rough contacts under "first" or "cyclic" loading."""
    stages = []
    for stage in chain.stages:
        surface = getattr(stage.element, "surface", None)
        if isinstance(surface, SurfacePair):
            worn: Any = {"surface": replace(surface, loading=loading)}
            stage = replace(stage, element=replace(stage.element, **worn))
        stages.append(stage)
    return replace(chain, stages=tuple(stages))


def _flank_readings(chain: Chain, both: bool) -> list[tuple[str, Chain]]:
    kinds = sorted({e.flanks for e in chain.elements.values() if isinstance(e, Key)})
    own = "none" if not kinds else kinds[0] if len(kinds) == 1 else "mixed"
    readings: tuple[Flanks, ...] = ("series", "parallel")
    others = [f for f in readings if kinds and f != own] if both else []
    return [(own, chain), *((f, with_flanks(chain, f)) for f in others)]


def _joint_rows(
    joint: int, flanks: str, chain: Chain, ratios: np.ndarray, torque: np.ndarray
) -> list[StiffnessRow]:
    compliance = exact_compliance(chain, torque)
    windup = exact_windup(chain, torque)
    alone = exact_compliance(chain.reducer_only(), torque)
    # A rigid remainder (no reducer) has compliance 0; a slipping contact has no stiffness.
    with np.errstate(divide="ignore"):
        columns = {
            "torque_ratio": ratios,
            "torque": torque,
            "tangent_stiffness": 1.0 / compliance,
            "secant_stiffness": torque / windup,
            "windup": windup,
            "reducer_only_tangent_stiffness": 1.0 / alone,
            "ratio_to_reducer_only": alone / compliance,
            "first_loading_stiffness": 1.0 / exact_compliance(with_loading(chain, "first"), torque),
            "cyclic_stiffness": 1.0 / exact_compliance(with_loading(chain, "cyclic"), torque),
        }
    return [
        StiffnessRow(
            joint=joint, flanks=flanks, **{name: float(c[k]) for name, c in columns.items()}
        )
        for k in range(len(ratios))
    ]
