"""Placeholder limits of a URDF, told from real ones by the arm's size and weight.

An arm moves its tool at a few m/s and carries a few times its own weight. Limits far beyond are
treated as not stated; doubtful ones are kept and asked about.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.robot.body_tree import BodyTree, body_tree
from stiffopt.robot.frames import LinkFrame
from stiffopt.robot.urdf import LoadedUrdf
from stiffopt.units import joint_unit

# Largest plausible speed of the tool by one joint, of a prismatic joint (linear motors: 10) [m/s],
# and of a revolute joint [rad/s] (spindle of the fastest SCARA: 52).
_MAX_TOOL_SPEED, _MAX_SLIDE_SPEED, _MAX_JOINT_SPEED = 30.0, 15.0, 60.0
# Largest plausible joint torque [N m] or force [N]: the largest arms have 4e4 N m at their base and
# 1e5 N at a prismatic joint.
_MAX_CREDIBLE_TORQUE = 1e5
# Rounding in the triangle inequality of principal moments [-].
_INERTIA_ROUNDING = 1.02
# Fewest joints whose equal limits are one statement: implausible for one, a placeholder of all.
_MIN_EQUAL_LIMITS = 4


@dataclass(frozen=True, kw_only=True)
class Placeholder:
    """Limit treated as not stated."""

    joint: str
    quantity: str  # "velocity" or "effort"
    value: float  # of the file, in its unit
    unit: str
    why: str
    format: str  # of the file, such as "URDF"

    def __str__(self) -> str:
        return f"the {self.format} says {self.value:g} {self.unit}, {self.why}"


def speed_placeholders(arm: LoadedUrdf, tool: LinkFrame) -> tuple[Placeholder, ...]:
    """Return speed limits that are implausible for an arm of this length."""
    tree = body_tree(arm.model)
    lengths = _chain_lengths(tree, tool)
    reasons = {}
    for j, (name, stated) in enumerate(arm.joints.items()):
        speed, slides = stated["velocity"], bool(tree.prismatic[j])
        at_tool = speed if slides else speed * lengths[j]
        if slides and speed > _MAX_SLIDE_SPEED:
            reasons[name] = "faster than any prismatic axis"
        elif at_tool > _MAX_TOOL_SPEED:
            reasons[name] = f"which moves the tool at {at_tool:.3g} m/s"
        elif not slides and speed > _MAX_JOINT_SPEED:
            reasons[name] = "faster than any joint of an arm"
    return _describe_placeholders(arm, "velocity", reasons)


def torque_placeholders(
    arm: LoadedUrdf, demands: np.ndarray, weight: np.ndarray
) -> tuple[Placeholder, ...]:
    """Return torque limits that weight and motion contradict.

    `demands` (n,): largest torque of each joint for weight and full acceleration; forces of
    prismatic joints. `weight` (n,): largest gravity torque, 0 where the masses are guessed.
    """
    slides = body_tree(arm.model).prismatic
    stated = {name: each["effort"] for name, each in arm.joints.items()}
    reasons = {}
    for j, (name, torque) in enumerate(stated.items()):
        alike, unit = demands[slides == slides[j]], joint_unit("N m", slides[j])
        # A placeholder exceeds this multiple of the largest joint demand, and this torque [N m]
        # or, as prismatic joints also press, this force [N].
        most = max(15.0 * float(np.max(alike)), 2000.0 if slides[j] else 200.0)
        if torque > min(most, _MAX_CREDIBLE_TORQUE):
            reasons[name] = (
                f"the arm's weight and full acceleration take {np.max(alike):.3g} {unit} at most"
            )
        elif _is_shared(torque, stated) and 0.0 < torque < weight[j]:
            reasons[name] = f"the arm's weight alone takes {float(weight[j]):.3g} {unit}"
    return _describe_placeholders(arm, "effort", reasons)


def _is_shared(value: float, stated: Mapping[str, float]) -> bool:
    return sum(each == value for each in stated.values()) >= _MIN_EQUAL_LIMITS


def _describe_placeholders(
    arm: LoadedUrdf, quantity: str, reasons: Mapping[str, str]
) -> tuple[Placeholder, ...]:
    """Return the placeholders of these joints, and of those that share their value."""
    stated = {name: each[quantity] for name, each in arm.joints.items()}
    shared = {
        stated[name]: name for name in reversed(list(reasons)) if _is_shared(stated[name], stated)
    }
    unit = {"velocity": "rad/s", "effort": "N m"}[quantity]
    slides = body_tree(arm.model).prismatic
    return tuple(
        Placeholder(
            joint=name,
            quantity=quantity,
            value=value,
            unit=joint_unit(unit, slides[j]),
            why=reasons.get(name) or f"a placeholder as for {shared[value]}",
            format=arm.format,
        )
        for j, (name, value) in enumerate(stated.items())
        if name in reasons or value in shared
    )


def drop_placeholders(arm: LoadedUrdf, found: tuple[Placeholder, ...]) -> LoadedUrdf:
    """Return the arm with these limits not stated."""
    joints = {name: dict(stated) for name, stated in arm.joints.items()}
    for each in found:
        joints[each.joint][each.quantity] = 0.0
    return replace(arm, joints=joints)


def credible_torques(arm: LoadedUrdf) -> np.ndarray:
    """Return torque limits (n,) usable for a mass estimate [N m]; nan otherwise."""
    torques = np.array([stated["effort"] for stated in arm.joints.values()])
    slides = body_tree(arm.model).prismatic
    if len(torques) >= _MIN_EQUAL_LIMITS and len(set(torques)) == 1:
        return np.full(len(torques), np.nan)
    known = (torques > 0.0) & (torques < _MAX_CREDIBLE_TORQUE) & ~slides
    return np.where(known, torques, np.nan)


def open_questions(
    arm: LoadedUrdf, weight: np.ndarray, guessed: Mapping[str, object]
) -> Iterator[str]:
    """Yield a question about each doubtful value that is kept.

    `weight` (n,): largest gravity torque of each joint. `guessed`: links with guessed masses, which
    may be too heavy for a weak drive.
    """
    torques = {name: stated["effort"] for name, stated in arm.joints.items()}
    values = set(torques.values())
    if len(torques) >= _MIN_EQUAL_LIMITS and len(values) == 1 and any(values):
        yield (
            f"QUESTION: the {arm.format} has the torque {values.pop():g} N m for"
            f" all {len(torques)} joints. Arms have a tenth at the wrist: is it a placeholder? Put"
            " torque_max of the data sheet."
        )
    weak = [
        f"{name} ({torques[name]:g} N m, the weight takes {float(w):.3g})"
        for name, w in zip(torques, weight, strict=True)
        if 0.0 < torques[name] < w
    ]
    if weak:
        reason = " or the guessed masses" if guessed else " or the masses"
        yield (
            f"QUESTION: the torque of {', '.join(weak)} does not hold the arm's own weight in every"
            f" pose: the limit{reason} of the {arm.format} must be wrong, unless springs help."
        )

    impossible: dict[str, list[str]] = {}
    for body in body_tree(arm.model).bodies:
        wrong = inertia_fault(np.linalg.eigvalsh(body.inertia))
        if wrong:
            impossible.setdefault(wrong, []).append(body.name)
    for wrong, names in impossible.items():
        yield (
            f"QUESTION: the inertia of the links moved by {', '.join(names)} is impossible: one"
            f" principal moment is {wrong}. Was it exported about another point, or are two"
            " entries swapped?"
        )


def inertia_fault(moments: np.ndarray) -> str:
    """Return why ascending principal moments (3,) are impossible; "" if possible."""
    if moments[0] < -(_INERTIA_ROUNDING - 1.0) * moments[2]:
        return "below 0"
    if moments[2] > _INERTIA_ROUNDING * (moments[0] + moments[1]):
        return "larger than the other two together"
    return ""


def _chain_lengths(tree: BodyTree, tool: LinkFrame) -> np.ndarray:
    """Return the length of the chain beyond each joint (n,) [m]."""
    steps = [float(np.linalg.norm(body.translation)) for body in tree.bodies[1:]]
    steps.append(float(np.linalg.norm(tool.offset)))
    return np.cumsum(steps[::-1])[::-1]
