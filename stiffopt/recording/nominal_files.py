"""Nominal robot, drives and noise of a recording set, and the assumptions in place of gaps."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.connection.connection import Connection
from stiffopt.connection.constant import Constant
from stiffopt.connection.reducer import Reducer
from stiffopt.drivetrain.chain import Chain, Stage
from stiffopt.errors import InputFileError, nearest
from stiffopt.recording import schema
from stiffopt.recording.nominal import Counterbalance, Noise, Nominal, Tolerance
from stiffopt.robot.elements import locate_errors
from stiffopt.robot.robot import Robot

# Keys with one number per joint: of the robot, of the drives.
_ROBOT_LISTS = ("rotor_inertia", "coulomb", "viscous", "torque_max")
_DRIVE_LISTS = ("gear_ratio", "torque_rated", "joint_damping")


def per_joint(
    value: float | Sequence[float] | None, n: int, path: Path, where: str
) -> np.ndarray | None:
    """Array (n,) of a list, or of one number for all joints."""
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


def build_nominal(section: schema.NominalSection, joints: Sequence[str], path: Path) -> Nominal:
    """Nominal values of the section beside the robot, one entry per joint."""
    n = len(joints)
    lists = {key: _finite_per_joint(section, key, n, path) for key in _DRIVE_LISTS}
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
        counterbalance=tuple(
            _read_counterbalance(one, joints, path)
            for one in (balance if isinstance(balance, tuple) else (balance,))
        ),
        **lists,
    )


def check_nominal(section: schema.NominalSection, joints: Sequence[str], path: Path) -> None:
    """Raise `InputFileError` where a list of the section does not match these joints."""
    build_nominal(section, joints, path)
    for key in _ROBOT_LISTS:
        _finite_per_joint(section, key, len(joints), path)


def build_nominal_robot(
    described: Robot, order: np.ndarray, section: schema.NominalSection, path: Path
) -> Robot:
    """Robot of its own file with the values that the section states.

    `described`: with the joints of the set, in its own order. `order` (n,): index of each joint of
    the set among those of the robot. `path`: of the set's file, for messages.
    """
    of_set = np.argsort(order)
    stated: dict[str, Any] = {}
    for key in _ROBOT_LISTS:
        numbers = _finite_per_joint(section, key, described.n, path)
        if numbers is not None:
            stated[key] = numbers[of_set]
    robot = replace(described, **stated)
    chains = build_chains(section, robot.torque_max[order], path)
    if chains is None:
        return robot
    return replace(robot, chains=tuple(chains[j] for j in of_set))


def missing_nominal_values(section: schema.NominalSection, described: Robot) -> tuple[str, ...]:
    """Keys of coulomb, viscous, rotor_inertia that neither a set nor its robot file gives."""
    return tuple(
        key
        for key in ("coulomb", "viscous", "rotor_inertia")
        if getattr(section, key) is None and not np.any(getattr(described, key))
    )


def build_chains(
    section: schema.NominalSection, torque_max: np.ndarray, path: Path
) -> tuple[Chain | None, ...] | None:
    """Drivetrain of each joint: its reducer, and its contacts as one spring; None is rigid.

    `torque_max` (n,) [N m]. None in place of all where the section gives no stiffness.
    """
    n = len(torque_max)
    contacts = per_joint(section.contact_stiffness, n, path, "nominal.contact_stiffness")
    curves = None if section.reducer is None else _reducer_curves(section.reducer, n, path)
    if contacts is None and curves is None:
        return None
    chains: list[Chain | None] = []
    for j, most in enumerate(torque_max):
        curve = None if curves is None else curves[:, j]
        with locate_errors(path, f"nominal.reducer, joint {j + 1}"):
            chains.append(
                build_joint_chain(curve, np.inf if contacts is None else contacts[j], most)
            )
    return tuple(chains)


def build_joint_chain(
    curve: Sequence[float] | np.ndarray | None, contacts: float, torque_max: float
) -> Chain | None:
    """Drivetrain of a reducer K1, K2, K3, T1, T2 and a contact stiffness [N m/rad]; None is rigid.

    A reducer with an infinite slope, and infinite contacts, are rigid.
    """
    elements: list[Connection] = []
    if curve is not None and np.isfinite(curve[:3]).all():
        k1, k2, k3, t1, t2 = (float(value) for value in curve)
        reducer = Reducer(
            name="reducer",
            torque_max=float(torque_max),
            K1=k1,
            K2=k2,
            K3=k3,
            T1=t1,
            # The element needs T1 < T2; catalogues with two slopes have equal ones.
            T2=max(t2, t1 * (1.0 + 1e-9)),
        )
        elements.append(reducer)
    if np.isfinite(contacts):
        most, stiffness = float(torque_max), float(contacts)
        elements.append(Constant(name="contacts", torque_max=most, stiffness=stiffness))
    return Chain(tuple(Stage(element) for element in elements)) if elements else None


def build_noise(section: schema.NoiseSection, n: int, path: Path) -> Noise:
    """Sensor noise, one entry per joint."""
    return Noise(
        **{
            key: per_joint(value, n, path, f"noise.{key}")
            for key, value in section.model_dump().items()
        }
    )


def _finite_per_joint(
    section: schema.NominalSection, key: str, n: int, path: Path
) -> np.ndarray | None:
    numbers = per_joint(getattr(section, key), n, path, f"nominal.{key}")
    if numbers is not None and not np.isfinite(numbers).all():
        raise InputFileError(path, f"nominal.{key}", f"got {list(numbers)}, not finite.")
    return numbers


def _reducer_curves(section: schema.ReducerCurvesSection, n: int, path: Path) -> np.ndarray:
    """K1, K2, K3, T1, T2 of all joints (5, n)."""
    rows = []
    for key in ("K1", "K2", "K3", "T1", "T2"):
        numbers = per_joint(getattr(section, key), n, path, f"nominal.reducer.{key}")
        assert numbers is not None
        rows.append(numbers)
    if not (rows[3] <= rows[4]).all():
        raise InputFileError(path, "nominal.reducer.T2", "must not be below T1. Swap the two.")
    return np.array(rows)


def _read_counterbalance(
    section: schema.SpringSection | schema.TableSection, joints: Sequence[str], path: Path
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
    if isinstance(section, schema.SpringSection):
        return Counterbalance(joint=joint - 1, stiffness=section.stiffness, offset=section.offset)
    angle, torque = np.array(section.angle), np.array(section.torque)
    if angle.shape != torque.shape or len(angle) < 2 or not (np.diff(angle) > 0.0).all():
        raise InputFileError(
            path, where, "angle must increase and have as many entries (two or more) as torque."
        )
    return Counterbalance(joint=joint - 1, angle=angle, torque=torque)


NO_RATIO = "nominal.gear_ratio is not given: nothing periodic in the rotor angle can be named."


def assumptions(
    document: schema.RecordingsFile, described: Robot, locked: Sequence[str]
) -> tuple[str, ...]:
    """Assumptions in place of missing entries, one sentence each, in the order of the file.

    `described`: robot of its own file. `locked`: joints without recordings.
    """
    found = []
    if locked:
        found.append(f"Joints not recorded are held at zero: {', '.join(locked)}.")
    if document.gravity is None:
        found.append("Gravity is 9.81 m/s^2 along -z of the base.")
    if document.signals.torque_side is None and any(document.signals.torque or ()):
        found.append("Torque is the motor's, from current, before friction.")
    found += nominal_assumptions(
        document.nominal,
        document.tolerance,
        described,
        links=bool(document.signals.link_position),
    )
    if document.noise.torque is None:
        found.append("Torque noise is not given and is estimated from the recordings.")
    if document.signals.link_position and document.noise.link_position is None:
        found.append("Link encoder noise is not given and is estimated from the recordings.")
    if all(run.session_time is None for run in document.runs):
        found.append("Session times are not given: all runs are taken as equally warm.")
    return tuple(found)


def nominal_assumptions(
    nominal: schema.NominalSection, tolerance: Tolerance, described: Robot, *, links: bool
) -> tuple[str, ...]:
    """Assumptions on the nominal robot and its tolerances, which an extended model replaces."""
    found = [*_list_nominal_assumptions(nominal, described, links)]
    if silent := missing_tolerances(tolerance):
        found.append(f"Tolerances not given, wide defaults hold: {', '.join(silent)}.")
    return tuple(found)


def missing_tolerances(tolerance: Tolerance) -> list[str]:
    """Names of tolerances that a set does not give, but for the damping, never known well."""
    return [k for k, value in vars(tolerance).items() if value is None and k != "joint_damping"]


def _list_nominal_assumptions(
    nominal: schema.NominalSection, described: Robot, links: bool
) -> Iterator[str]:
    if nominal.gear_ratio is None:
        yield NO_RATIO
    for key, quantity in (
        ("rotor_inertia", "the rotor inertia"),
        ("coulomb", "the Coulomb friction"),
        ("viscous", "the viscous friction"),
    ):
        if key in missing_nominal_values(nominal, described):
            yield f"nominal.{key} is not given: {quantity} is not known and is estimated."
        elif getattr(nominal, key) is None:
            yield f"nominal.{key} is not given: {quantity} is that of the robot's file."
    if nominal.reducer is None:
        if any(described.chains) and nominal.contact_stiffness is None:
            yield "nominal.reducer is not given: drivetrains are those of the robot's file."
        elif links:
            yield "nominal.reducer is not given: the joints' stiffness is estimated."
