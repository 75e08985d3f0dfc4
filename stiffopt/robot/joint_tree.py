"""Joints of a URDF as a tree, and recognition of the arm where no tip is named.

The arm is the only long chain; fingers at its end, and heads or wheels beside it, are recognised.
Among several arms, legs or wheels none is preferred: the message offers their tips.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Collection
from functools import cached_property

# Kinds of moving joints that an arm may have.
PLANNED_KINDS = ("revolute", "continuous", "prismatic")
# A branch of at most so many joints at the end of an arm of at least so many is a finger; beside
# such an arm, one of at most so many is a head or a wheel.
_MAX_FINGER_JOINTS, _MIN_ARM_JOINTS, _MAX_HEAD_JOINTS = 4, 3, 2
# Words in the names of gripper joints.
_JAW_WORDS = ("gripper", "finger", "jaw", "knuckle", "claw")
# Tips that the message offers at most.
_MAX_OFFERED_TIPS = 6


class JointTree:
    """Joints of a URDF by name and by parent link.

    `tree`: `<robot>`, whose joints form a tree. `still`: joints that count as fixed.
    """

    def __init__(self, tree: ET.Element, still: Collection[str] = ()) -> None:
        self.tree = tree
        self.still = frozenset(still)
        self.links = [link.get("name", "") for link in tree.findall("link")]
        self.joints = {joint.get("name", ""): joint for joint in tree.findall("joint")}
        self.below: dict[str, list[str]] = {}
        self.above: dict[str, str] = {}
        for name, joint in self.joints.items():
            self.below.setdefault(link_attribute(joint, "parent"), []).append(name)
            self.above[link_attribute(joint, "child")] = name

    def moves(self, name: str) -> bool:
        """Return whether a joint is not fixed."""
        return name not in self.still and self.joints[name].get("type") in PLANNED_KINDS

    @property
    def moving(self) -> list[str]:
        """Names of the joints that are not fixed."""
        return [name for name in self.joints if self.moves(name)]

    def path_to(self, link: str) -> list[str]:
        """Moving joints from the base to a link."""
        return [name for name in self.joints_to(link) if self.moves(name)]

    def joints_to(self, link: str | None) -> list[str]:
        """Joints of all kinds from the base to a link."""
        way: list[str] = []
        while link in self.above:
            name = self.above[link]
            way.insert(0, name)
            link = link_attribute(self.joints[name], "parent")
        return way

    def carries(self, link: str) -> bool:
        """Return whether any joint from the base to a link is not a fixed one."""
        return any(self.joints[name].get("type") != "fixed" for name in self.joints_to(link))

    def follows(self, name: str) -> bool:
        """Return whether a joint follows another (mimic)."""
        return self.joints[name].find("mimic") is not None

    def next_moving(self, link: str) -> list[str]:
        """First moving joints beyond a link, across fixed ones."""
        found, waiting = [], list(reversed(self.below.get(link, [])))
        while waiting:
            name = waiting.pop()
            if self.moves(name):
                found.append(name)
            else:
                waiting += reversed(self.below.get(self._child_link(name), []))
        return found

    @cached_property
    def behind(self) -> dict[str, int]:
        """Number of independent joints in the branch that begins with each joint."""
        counts: dict[str, int] = {}
        order = [name for root in self.roots for name in self.below.get(root, [])]
        for name in order:  # grows: parents before children
            order += self.below.get(self._child_link(name), [])
        for name in reversed(order):
            deeper = self.below.get(self._child_link(name), [])
            own = self.moves(name) and not self.follows(name)
            counts[name] = own + sum(counts[each] for each in deeper)
        return counts

    @property
    def roots(self) -> list[str]:
        """Links without a joint to a parent."""
        return sorted({link_attribute(j, "parent") for j in self.joints.values()} - set(self.above))

    def arm(self, described: Collection[str] = ()) -> list[str] | None:
        """Joints of the arm where no tip is named; None where it is ambiguous.

        `described`: joints that a file mentions; chains that contain one are selected.
        """
        way, ahead = self._unbranched_chain()
        if not ahead or self._is_hand(way, ahead):
            return way
        chains = [self._descendant_joints(name) for name in ahead]
        meant = [chain for chain in chains if not chain.isdisjoint(described)]
        if not meant:
            return None
        wanted = set(way).union(*meant)
        return [name for name in self.moving if name in wanted and not self.follows(name)]

    def describe_branches(self) -> str:
        """Message that asks for the tip of one of several chains; "" for a single arm."""
        if self.arm() is not None:
            return ""
        way, ahead = self._unbranched_chain()
        # Short branches at the end of a long chain may be fingers.
        short = bool(way) and all(self.behind[name] < len(way) for name in ahead)
        first = [self._child_link(way[-1])] if len(way) > _MAX_FINGER_JOINTS or short else []
        found = self._chain_ends([] if first else way, ahead)
        ends = first + sorted(found, key=lambda end: -len(self.path_to(end)))
        offered = " or ".join(f'--tip "{end}"' for end in ends[:_MAX_OFFERED_TIPS])
        others = f" ({len(ends) - _MAX_OFFERED_TIPS} more)" if len(ends) > _MAX_OFFERED_TIPS else ""
        counts = [len(self.path_to(end)) for end in ends]
        joints = f"{min(counts)} to {max(counts)}" if min(counts) < max(counts) else counts[0]
        plural = "" if counts == [1] * len(counts) else "s"
        return (
            f"branches into {len(ends)} chains of {joints} joint{plural}, of which one has to be"
            f" named: an arm is a single chain on a fixed base. Name the link at its"
            f' end: {offered}{others} of `stiffopt init`, or tool = {{ link = "{ends[0]}" }} in a'
            " robot file; other joints are then held."
        )

    def ambiguous_joints(self) -> list[str]:
        """Independent joints where one of several chains has to be named; else empty."""
        if self.arm() is not None:
            return []
        return [name for name in self.moving if not self.follows(name)]

    def _unbranched_chain(self) -> tuple[list[str], list[str]]:
        """Joints from the base to the first branch, and the joints that follow it.

        Branches without independent joints, such as the cylinder of a counterbalance, do not count;
        jaws that follow another one form a gripper with it.
        """
        way: list[str] = []
        link = self.roots[0] if self.roots else ""
        while True:
            ahead = self.next_moving(link)
            own = [name for name in ahead if self.behind[name]]
            if len(own) == 1 and not (len(way) >= _MIN_ARM_JOINTS and self._is_jaw(own[0], ahead)):
                ahead = own
            elif len(own) > 1 and (arm := self._arm_beside_heads(way, own)):
                ahead = [arm]
            elif own or len(ahead) != 1:
                return way, own
            way += ahead
            link = self._child_link(ahead[0])

    def _arm_beside_heads(self, way: list[str], ahead: list[str]) -> str | None:
        """Select the branch that is an arm where all others are heads, wheels or legs."""
        long = [name for name in ahead if self.behind[name] > _MAX_FINGER_JOINTS]
        if len(long) == 1:
            return long[0]
        if long or len(way) >= _MIN_ARM_JOINTS:
            return None
        arms = [name for name in ahead if self.behind[name] >= _MIN_ARM_JOINTS]
        heads = all(self.behind[name] <= _MAX_HEAD_JOINTS for name in ahead if name not in arms)
        return arms[0] if len(arms) == 1 and heads else None

    def _is_hand(self, way: list[str], ahead: list[str]) -> bool:
        """Return whether the branches at the end of a chain are fingers."""
        short = all(self.behind[name] <= _MAX_FINGER_JOINTS for name in ahead)
        if len(way) >= _MIN_ARM_JOINTS:
            return short
        return bool(way) and all(self._is_jaw(name, ahead) for name in ahead)

    def _is_jaw(self, name: str, ahead: list[str]) -> bool:
        """Return whether a joint moves a jaw, by its name or since neighbours follow it."""
        if self.behind[name] > _MAX_FINGER_JOINTS:
            return False
        named = self.behind[name] == 1 and any(word in name.lower() for word in _JAW_WORDS)
        return named or any(mimicked_joint(self.joints[each]) == name for each in ahead)

    def _descendant_joints(self, name: str) -> set[str]:
        """A joint and all moving joints beyond it."""
        found = {name}
        for each in self.next_moving(self._child_link(name)):
            found |= self._descendant_joints(each)
        return found

    def _chain_ends(self, way: list[str], ahead: list[str]) -> list[str]:
        """End links of chains without fingers, and of the common chain before them if long."""
        ends = [self._child_link(way[-1])] if len(way) >= _MIN_ARM_JOINTS else []
        for name in ahead:
            branch, after = [name], self._next_independent(name)
            while len(after) == 1 and not (
                len(branch) >= _MIN_ARM_JOINTS and self._ends_in_jaw(branch[-1])
            ):
                branch.append(after[0])
                after = self._next_independent(after[0])
            # A chain too long for a torso ends in a hand.
            if not after or len(branch) > _MAX_FINGER_JOINTS or self._is_hand(branch, after):
                ends.append(self._child_link(branch[-1]))
            else:
                ends += self._chain_ends(branch, after)
        return ends

    def _ends_in_jaw(self, name: str) -> bool:
        ahead = self.next_moving(self._child_link(name))
        return any(self._is_jaw(each, ahead) for each in ahead)

    def _next_independent(self, name: str) -> list[str]:
        """Next joints of a joint that are independent or carry such."""
        return [each for each in self.next_moving(self._child_link(name)) if self.behind[each]]

    def _child_link(self, name: str) -> str:
        return link_attribute(self.joints[name], "child")


def mimicked_joint(joint: ET.Element) -> str:
    """Name of the joint that a joint follows (mimic); "" for none."""
    mimic = joint.find("mimic")
    return "" if mimic is None else mimic.get("joint", "")


def link_attribute(joint: ET.Element, end: str) -> str:
    """Name of the link at the end "parent" or "child" of a joint; "" for none."""
    found = joint.find(end)
    return "" if found is None else found.get("link", "")
