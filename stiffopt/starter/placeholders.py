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

# Largest plausible speed of the tool by one joint, or of a prismatic joint [m/s], and of a revolute
# joint [rad/s] (spindle of the fastest SCARA: 52).
_MAX_TOOL_SPEED, _MAX_JOINT_SPEED = 30.0, 60.0
# Largest plausible joint torque [N m] or force [N]: the largest arms have 4e4 N m at their base and
# 1e5 N at a prismatic joint.
_MAX_CREDIBLE_TORQUE = 1e5
# Rounding in the triangle inequality of principal moments [-].
_INERTIA_ROUNDING = 1.02
# Fewest joints at which equal torque limits are a placeholder.
_MIN_EQUAL_TORQUES = 4


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
    found = []
    for j, (name, stated) in enumerate(arm.joints.items()):
        speed, slides = stated["velocity"], bool(tree.prismatic[j])
        at_tool = speed if slides else speed * lengths[j]
        if at_tool > _MAX_TOOL_SPEED:
            why = f"which moves the tool at {at_tool:.3g} m/s"
        elif not slides and speed > _MAX_JOINT_SPEED:
            why = "faster than any joint of an arm"
        else:
            continue
        unit = "m/s" if slides else "rad/s"
        found.append(
            Placeholder(
                joint=name, quantity="velocity", value=speed, unit=unit, why=why, format=arm.format
            )
        )
    return tuple(found)


def torque_placeholders(arm: LoadedUrdf, demands: np.ndarray) -> tuple[Placeholder, ...]:
    """Return torque limits far beyond the demand of weight and full acceleration.

    `demands` (n,): largest torque of each joint for both; forces of prismatic joints.
    """
    slides = body_tree(arm.model).prismatic
    found = []
    for j, (name, stated) in enumerate(arm.joints.items()):
        alike = demands[slides == slides[j]]
        # A placeholder exceeds this multiple of the largest joint demand, and this torque [N m]
        # or, as prismatic joints also press, this force [N].
        most = max(
            15.0 * float(np.max(alike)),
            2000.0 if slides[j] else 200.0,
        )
        if stated["effort"] <= min(most, _MAX_CREDIBLE_TORQUE):
            continue
        unit = "N" if slides[j] else "N m"
        why = f"the arm's weight and full acceleration take {np.max(alike):.3g} {unit} at most"
        found.append(
            Placeholder(
                joint=name,
                quantity="effort",
                value=stated["effort"],
                unit=unit,
                why=why,
                format=arm.format,
            )
        )
    return tuple(found)


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
    if len(torques) >= _MIN_EQUAL_TORQUES and len(set(torques)) == 1:
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
    if (
        len(torques) >= _MIN_EQUAL_TORQUES
        and len(set(torques.values())) == 1
        and any(torques.values())
    ):
        yield (
            f"QUESTION: the {arm.format} has the torque {next(iter(torques.values())):g} N m for"
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
