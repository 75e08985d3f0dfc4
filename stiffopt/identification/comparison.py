"""Identified joint stiffness of several sets beside each other and beside the drivetrains' model.

A joint that differs from its model points to an element: the one whose compliance has to change by
the fewest standard deviations for the joint to be as soft as identified. Each element's compliance
is log-normally distributed, wider where its numbers are estimated.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from stiffopt.exact.chain import exact_windup, windup_shares
from stiffopt.files import atomic_write, write_csv
from stiffopt.formatting import listed
from stiffopt.identification.result import JointStiffness, StaticStiffness
from stiffopt.robot.robot import Robot
from stiffopt.robot.tolerances import TOLERANCE_IN_STANDARD_DEVIATIONS

COMPARISON_FILE, TABLE_FILE, UNCERTAINTY_FILE = (
    "comparison.json",
    "comparison.csv",
    "uncertainty.toml",
)
# Logarithmic standard deviation of an element's compliance: makers state stiffness as typical
# values that scatter by a fifth; an estimate is right within a factor of two.
_CATALOGUE_SPREAD, _ESTIMATED_SPREAD = 0.2, float(np.log(2.0))
# Difference that is named [standard deviations], and the most a relative bound can be.
_MIN_NAMED_DIFFERENCE, _MAX_BOUND = 2.0, 0.99
# Of joints that no set identifies: the default of [uncertainty].
_DEFAULT_BOUND = 0.2


@dataclass(frozen=True, kw_only=True)
class JointComparison:
    """One joint in all sets and in the model."""

    joint: int  # from 1
    name: str
    # By set [N m/rad, N/m for a prismatic joint]; None where a set does not identify it.
    stiffness: tuple[float | None, ...]
    sd: tuple[float | None, ...]
    # Compliance-weighted mean of the sets, with the larger of its own and the sets' scatter.
    pooled: float | None = None
    pooled_sd: float | None = None
    spread: float | None = None  # largest difference of two sets, in standard deviations
    # Secant stiffness of the drivetrain at the median torque of the first set that identifies the
    # joint.
    model: float | None = None
    difference: float | None = None  # identified less modelled compliance, in standard deviations
    # Element that a difference points to, and the factor on its compliance that explains it.
    element: str = ""
    factor: float | None = None
    # Relative bound of the modelled stiffness that covers what was identified.
    bound: float | None = None
    # Moment stiffness of the output bearing by set; None where its tilt is not supported.
    tilt: tuple[float | None, ...] = ()
    modelled_tilt: float | None = None  # moment stiffness of the robot file [N m/rad]


def compare_stiffness(
    results: Sequence[StaticStiffness], robot: Robot | None = None
) -> tuple[JointComparison, ...]:
    """Compare the joints of several sets of one type of arm, and with its drivetrains.

    `results`: joints belong together by their number. `robot`: with the drivetrains of all joints.
    """
    count = min(len(each.joints) for each in results)
    found = []
    for j in range(count):
        tilts = [{each.joint: each.compliance for each in own.tilt} for own in results]
        bearing = robot.bearings[j] if robot is not None and j < len(robot.bearings) else None
        found.append(
            replace(
                _compare_joint([each.joints[j] for each in results], robot, j),
                tilt=tuple(1.0 / own[j + 1] if j + 1 in own else None for own in tilts),
                modelled_tilt=None if bearing is None else bearing.moment_stiffness,
            )
        )
    return tuple(found)


def _compare_joint(sets: Sequence[JointStiffness], robot: Robot | None, j: int) -> JointComparison:
    known = [each for each in sets if each.status == "identified"]
    identified = [each if each.status == "identified" else None for each in sets]
    found = JointComparison(
        joint=j + 1,
        name=sets[0].name,
        stiffness=tuple(None if each is None else each.stiffness for each in identified),
        sd=tuple(None if each is None else each.sd for each in identified),
    )
    if not known:
        return found
    compliance = np.array([each.compliance for each in known], dtype=float)
    # As the set's interval has it, from the larger of two deviations.
    deviation = compliance**2 * np.array([each.sd for each in known], dtype=float)
    weight = deviation**-2.0
    mean = float(np.average(compliance, weights=weight))
    # Arms of a type scatter beyond the errors of their sets.
    scatter = float(np.std(compliance, ddof=1)) if len(known) > 1 else 0.0
    own = max(float(np.sum(weight)) ** -0.5, scatter)
    apart = [
        abs(a - b) / np.hypot(s, t)
        for a, s in zip(compliance, deviation, strict=True)
        for b, t in zip(compliance, deviation, strict=True)
    ]
    values = asdict(found) | {
        "pooled": 1.0 / mean,
        "pooled_sd": own / mean**2,
        "spread": float(max(apart)) if len(known) > 1 else None,
    }
    chain = None if robot is None or j >= robot.n else robot.chains[j]
    if robot is None or chain is None or not chain.stages:
        return JointComparison(**values)
    torque = known[0].torque[1]
    modelled = float(exact_windup(chain, np.array([torque]))[0]) / torque
    difference = (mean - modelled) / own
    ratio = modelled / mean
    values |= {
        "model": 1.0 / modelled,
        "difference": difference,
        "bound": min(
            abs(ratio - 1.0) + TOLERANCE_IN_STANDARD_DEVIATIONS * own / mean * ratio, _MAX_BOUND
        ),
    }
    if abs(difference) >= _MIN_NAMED_DIFFERENCE:
        element, factor = _responsible_element(robot, j, torque, mean / modelled)
        values |= {"element": element, "factor": factor}
    return JointComparison(**values)


def _responsible_element(
    robot: Robot, j: int, torque: float, ratio: float
) -> tuple[str, float | None]:
    """Element whose compliance explains that of a joint over its model, and the factor on it."""
    chain = robot.chains[j]
    assert chain is not None
    estimated = {
        each.element
        for each in robot.sources
        if each.joint == robot.joint_names[j] and each.provenance == "estimated"
    }
    found: list[tuple[float, str, float]] = []
    for name, share in windup_shares(chain, torque).items():
        factor = 1.0 + (ratio - 1.0) / share if share > 0.0 else 0.0
        if factor > 0.0:
            spread = _ESTIMATED_SPREAD if name in estimated else _CATALOGUE_SPREAD
            found.append((abs(float(np.log(factor))) / spread, name, factor))
    if not found:
        return "", None
    _, name, factor = min(found)
    return name, factor


def describe_spread(names: Sequence[str], joint: JointComparison) -> str:
    """Name the softest and the stiffest set of a joint that differs between them; "" without."""
    if joint.spread is None or joint.spread < _MIN_NAMED_DIFFERENCE:
        return ""
    known = {name: k for name, k in zip(names, joint.stiffness, strict=True) if k is not None}
    soft, stiff = min(known, key=known.__getitem__), max(known, key=known.__getitem__)
    return (
        f"{soft} is {known[stiff] / known[soft]:.2f} times as soft as {stiff}; sets differ by up "
        f"to {joint.spread:.1f} standard deviations"
    )


def describe_difference(joint: JointComparison) -> str:
    """Describe what a difference from the model points to; "" without one."""
    if joint.difference is None or abs(joint.difference) < _MIN_NAMED_DIFFERENCE:
        return ""
    kind = "softer" if joint.difference > 0.0 else "stiffer"
    told = f"{kind} than modelled by {abs(joint.difference):.1f} standard deviations"
    if joint.factor is None:
        return f"{told}: no single element explains it"
    return f"{told}: {joint.element}, {joint.factor:.2f} times its compliance, explains it"


def write_comparison(names: Sequence[str], joints: Sequence[JointComparison], folder: Path) -> None:
    """Write comparison.json, comparison.csv and, beside a model, uncertainty.toml.

    `names`: of the sets.
    """
    document = {"sets": list(names), "joints": [asdict(joint) for joint in joints]}
    atomic_write(folder / COMPARISON_FILE, json.dumps(document, indent=1))
    columns = ("joint", "name", *names, "pooled", "pooled_sd", "model", "difference", "element")
    rows = [
        [joint.joint, joint.name, *joint.stiffness, joint.pooled, joint.pooled_sd, joint.model,
         joint.difference, joint.element]
        for joint in joints
    ]  # fmt: skip
    write_csv(folder / TABLE_FILE, columns, [["" if x is None else x for x in row] for row in rows])
    bounds = [joint.bound for joint in joints]
    if any(bound is not None for bound in bounds):
        left_out = [joint.name for joint in joints if joint.bound is None]
        note = f"# Not identified, as by default: {listed(left_out)}.\n" if left_out else ""
        values = ", ".join(f"{_DEFAULT_BOUND if b is None else b:.3g}" for b in bounds)
        atomic_write(
            folder / UNCERTAINTY_FILE,
            "# Bounds of the modelled joint stiffness that cover what was identified.\n"
            f"{note}[uncertainty]\nstiffness = [{values}]\n",
        )
