"""Nominal values, tolerances and noise from the sections of a set file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from stiffopt.errors import InputFileError, nearest
from stiffopt.recording.nominal import Counterbalance, Noise, Nominal, Reducer, Tolerance
from stiffopt.recording.schema import (
    NoiseSection,
    NominalSection,
    ReducerSection,
    SpringSection,
    TableSection,
    ToleranceSection,
)

_LISTS = (
    "gear_ratio",
    "rotor_inertia",
    "coulomb",
    "viscous",
    "torque_max",
    "torque_rated",
    "joint_damping",
    "contact_stiffness",
)


def per_joint(
    value: float | Sequence[float] | None, n: int, path: Path, where: str
) -> np.ndarray | None:
    """Array (n,) of a list, or of one number that holds for all joints."""
    if value is None:
        return None
    numbers = np.array([value] * n if isinstance(value, float) else value, dtype=float)
    if numbers.shape != (n,):
        raise InputFileError(
            path, where, f"needs one number a joint ({n}), got {numbers.size}. Complete the list."
        )
    if np.isnan(numbers).any():
        raise InputFileError(path, where, "nan is no number to compute with. Leave the key out.")
    return numbers


def as_nominal(section: NominalSection, joints: Sequence[str], path: Path) -> Nominal:
    """Nominal values with one entry a joint."""
    n = len(joints)
    lists = {key: per_joint(getattr(section, key), n, path, f"nominal.{key}") for key in _LISTS}
    for key, numbers in lists.items():
        allowed = key == "contact_stiffness" or numbers is None or np.isfinite(numbers).all()
        if not allowed:
            raise InputFileError(path, f"nominal.{key}", f"got {list(numbers or ())}, not finite.")
    ratio = lists["gear_ratio"]
    if ratio is not None and not ratio.all():
        raise InputFileError(path, "nominal.gear_ratio", "a ratio of 0 turns nothing.")
    if section.connections is not None and len(section.connections) != n:
        raise InputFileError(
            path,
            "nominal.connections",
            f"needs one text a joint ({n}), got {len(section.connections)}.",
        )
    balance = section.counterbalance
    return Nominal(
        friction_temperature=section.friction_temperature,
        pole_pairs=section.pole_pairs,
        connections=section.connections,
        reducer=None if section.reducer is None else _reducer(section.reducer, n, path),
        counterbalance=tuple(
            _counterbalance(one, joints, path)
            for one in (balance if isinstance(balance, tuple) else (balance,))
        ),
        **lists,
    )


def as_tolerance(section: ToleranceSection) -> Tolerance:
    """Tolerances as the set gives them."""
    return Tolerance(**section.model_dump())


def as_noise(section: NoiseSection, n: int, path: Path) -> Noise:
    """Noise with one entry a joint."""
    return Noise(
        **{
            key: per_joint(value, n, path, f"noise.{key}")
            for key, value in section.model_dump().items()
        }
    )


def _reducer(section: ReducerSection, n: int, path: Path) -> Reducer:
    columns: dict[str, np.ndarray] = {}
    for key in ("K1", "K2", "K3", "T1", "T2"):
        numbers = per_joint(getattr(section, key), n, path, f"nominal.reducer.{key}")
        if numbers is not None:
            columns[key] = numbers
    if not (columns["T1"] <= columns["T2"]).all():
        raise InputFileError(path, "nominal.reducer.T2", "must not be below T1. Swap the two.")
    return Reducer(**columns)


def _counterbalance(
    section: SpringSection | TableSection, joints: Sequence[str], path: Path
) -> Counterbalance:
    where = "nominal.counterbalance"
    joint = section.joint
    if isinstance(joint, str):
        if joint not in joints:
            raise InputFileError(
                path, f"{where}.joint", f"no joint {joint!r}. {nearest(joint, joints)}"
            )
        joint = list(joints).index(joint) + 1
    if not 1 <= joint <= len(joints):
        raise InputFileError(
            path, f"{where}.joint", f"got {joint}, allowed are 1 to {len(joints)} or a name."
        )
    if isinstance(section, SpringSection):
        return Counterbalance(joint=joint - 1, stiffness=section.stiffness, offset=section.offset)
    angle, torque = np.array(section.angle), np.array(section.torque)
    if angle.shape != torque.shape or len(angle) < 2 or not (np.diff(angle) > 0.0).all():
        raise InputFileError(
            path, where, "angle must increase and have as many entries (two or more) as torque."
        )
    return Counterbalance(joint=joint - 1, angle=angle, torque=torque)
