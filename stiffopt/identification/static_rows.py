"""Deflection of an arm at rest as rows linear in joint compliances, and their identifiability.

The torque that winds a joint up is that of the weight less that of the force on the tool,
s = g(q) - J^T f, and the tool moves by -J phi(s). With phi = c s, one column a joint.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stiffopt.errors import InputFileError
from stiffopt.recording.static_set import StaticSet

Windup = Callable[[np.ndarray], np.ndarray]

# Largest rotation that counts as small: the lever arm then changes by half of it squared, 0.5 %.
_MAX_ROTATION = 0.1  # [rad]


@dataclass(frozen=True, kw_only=True, eq=False)
class StaticRows:
    """Loads and measured displacements of all poses."""

    jacobian: np.ndarray  # (m, 3, n) of the tool's position, base frame [m/rad]
    pull: np.ndarray  # (m, n) joint torque of the force on the tool, J^T f [N m]
    # (m, n) torque that holds the weight of the links, g(q) [N m]; None without masses.
    weight: np.ndarray | None
    displacement: np.ndarray  # (m, 3) measured [m]
    difference: bool  # displacements are differences of two load states, with and without the force

    @property
    def load(self) -> np.ndarray:
        """Joint torques that caused the measured displacement, (m, n) [N m].

        Positive in the direction of the deflection.
        """
        if self.difference or self.weight is None:
            return self.pull
        return np.asarray(self.pull - self.weight)

    def compliance_columns(self) -> np.ndarray:
        """Displacement of the tool for unit compliance of each joint, (m, 3, n)."""
        return np.asarray(self.jacobian * self.load[:, None, :])

    def windup_columns(self, windup: Windup, *, on_weight: bool) -> np.ndarray:
        """Displacement of the tool for a wind-up law, per joint.

        `windup` (m, n) -> (m, n): odd in the torque [N m]. `on_weight`: the difference is taken
        about the gravity torque of the pose; else about an unloaded joint. Returns array (m, 3, n).
        """
        if self.difference and on_weight and self.weight is not None:
            moved = windup(self.weight) - windup(self.weight - self.pull)
        else:
            moved = windup(self.load)
        return np.asarray(self.jacobian * moved[:, None, :])


def static_rows(recorded: StaticSet) -> StaticRows:
    """Rows of a static set.

    Raises `InputFileError`: too few poses, displacements too large for a deflection, or such that
    include the weight of links without mass.
    """
    m, n = recorded.position.shape
    if m < 3 or 3 * m <= n:
        least = max(3, n // 3 + 1)
        raise InputFileError(
            recorded.path, "poses", f"{m} poses cannot tell {n} joints and their errors apart. "
            f"Measure at least {least}, better {2 * n}."
        )  # fmt: skip
    massive = any(body.mass > 0.0 for body in recorded.robot.tree.bodies)
    if not recorded.difference and not massive:
        raise InputFileError(
            recorded.path, "difference", "is false, so the weight of the links is in the "
            "displacements, but no link of the robot has a mass. Give the masses, or differences "
            "of two load states with difference = true."
        )  # fmt: skip
    robot, order = recorded.robot, recorded.order
    bodies = robot.rigid_bodies()
    jacobian, weight = np.empty((m, 3, n)), np.empty((m, n))
    for k, position in enumerate(recorded.position):
        q = np.empty(n)
        q[order] = position
        jacobian[k] = bodies.jacobian(robot.tool, q)[:3, order]
        weight[k] = bodies.gravity_torque(q)[order]
    lever = np.median(np.linalg.norm(jacobian[..., ~recorded.prismatic], axis=(1, 2)))
    moved = np.median(np.linalg.norm(recorded.displacement, axis=1))
    if moved > _MAX_ROTATION * lever > 0.0:
        raise InputFileError(
            recorded.path, "displacement", f"is {moved:.3g} m in half of the poses, which is no "
            f"small deflection at lever arms of {lever:.3g} m. Check the unit, as "
            'scale.displacement = "mm" in static.toml, or "dx [mm]" in the table.'
        )  # fmt: skip
    return StaticRows(
        jacobian=jacobian,
        pull=np.einsum("kij,ki->kj", jacobian, recorded.force),
        weight=weight if massive else None,
        displacement=recorded.displacement,
        difference=recorded.difference,
    )


def check_sag(rows: StaticRows, recorded: StaticSet, compliance: np.ndarray) -> None:
    """Raise `InputFileError` where the weight alone turns a joint, of least compliances (n,), far.

    Deflections under a force in a wrong unit give such joints.
    """
    if rows.weight is None:
        return
    turned = np.where(recorded.prismatic, 0.0, np.median(np.abs(rows.weight), axis=0) * compliance)
    j = int(np.argmax(turned))
    if turned[j] > _MAX_ROTATION:
        raise InputFileError(
            recorded.path, "force", f"and displacement give {recorded.joints[j]} "
            f"{1.0 / compliance[j]:.3g} N m/rad: the weight of the links alone would turn it by "
            f'{turned[j]:.3g} rad. Check the unit: scale.force = "kN" in static.toml.'
        )  # fmt: skip


# Halfway, in decades, to the factor of a thousand between units, beyond any error of a data sheet.
_MAX_NOMINAL_RATIO = 1000.0**0.5


def check_nominal(recorded: StaticSet, stiffness: np.ndarray) -> None:
    """Raise `InputFileError` where identified joints are all far above, or below, nominal ones.

    `stiffness` (n,): NaN where not identified.
    """
    if recorded.stiffness is None or np.isnan(stiffness).all():
        return
    decades = np.log10(stiffness / recorded.stiffness)
    if max(np.nanmin(decades), -np.nanmax(decades)) > np.log10(_MAX_NOMINAL_RATIO):
        raise InputFileError(
            recorded.path, "force", "and displacement give every joint about "
            f"{10.0 ** np.nanmedian(decades):.3g} times its nominal.stiffness. Check the units of "
            'both, as scale.force = "N" in static.toml, and of nominal.stiffness [N m/rad].'
        )  # fmt: skip


# Columns below this share of the largest are rounding, not load; likewise residuals of
# one column on others.
ROUND_OFF_SHARE = 1e-6
# Leverage below which a joint is loaded too weakly for its estimate to be accepted as it is.
MIN_LEVERAGE = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class Identifiable:
    """Identifiability of joint compliances from the columns of a static set."""

    leverage: np.ndarray  # (n,) size of each joint's column over the largest [-]
    loaded: np.ndarray  # (n,)
    group: np.ndarray  # (n,) joints with the same number above 0 are confounded; 0: not confounded
    kept: np.ndarray  # (k,) joints of a full-rank subset, without one of each confounded direction


def identifiable(columns: np.ndarray) -> Identifiable:
    """Analyse rank and leverage of the compliance columns.

    `columns` (m, 3, n).
    """
    n = columns.shape[2]
    rows = columns.reshape(-1, n)
    size = np.linalg.norm(rows, axis=0)
    leverage = size / (np.max(size, initial=0.0) or 1.0)
    loaded = leverage > ROUND_OFF_SHARE
    unit = rows / np.where(loaded, size, 1.0)
    group = np.zeros(n, dtype=int)
    here = [int(j) for j in np.flatnonzero(loaded)]
    kept: list[int] = []
    # Largest leverage first, so that the weakly loaded joint of a confounded group is left out.
    for j in sorted(here, key=lambda j: -float(leverage[j])):
        if _unexplained_norm(unit[:, j], unit[:, kept]) > ROUND_OFF_SHARE:
            kept.append(j)
    for j in sorted(set(here) - set(kept)):
        combination = np.linalg.lstsq(unit[:, kept], unit[:, j], rcond=None)[0]
        members = [j, *(k for k, c in zip(kept, combination, strict=True) if abs(c) > 1e-3)]
        known = [int(group[k]) for k in members if group[k]]
        number = min(known) if known else int(group.max()) + 1
        group[np.isin(group, known)] = number
        group[members] = number
    return Identifiable(
        leverage=leverage, loaded=loaded, group=group, kept=np.array(sorted(kept), dtype=int)
    )


def _unexplained_norm(column: np.ndarray, others: np.ndarray) -> float:
    """Norm of the part of a unit column that other columns do not explain."""
    if not others.shape[1]:
        return 1.0
    combination = np.linalg.lstsq(others, column, rcond=None)[0]
    return float(np.linalg.norm(column - others @ combination))
