"""An arm as capsules from joint to joint, where nothing says what its links look like."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiffopt.robot.body_tree import BodyTree
from stiffopt.robot.frames import LinkFrame

# Radius of the first and of the last link over the reach: a guess that looks like an arm.
_THICK, _THIN = 0.055, 0.028


@dataclass(frozen=True)
class Capsule:
    """A round rod with round ends, fixed to a joint's frame.

    Parameters
    ----------
    joint : int
        From 1; 0 is the base.
    begin, end : array (3,)
        In the frame of the joint [m].
    radius : float [m]
        Guessed from the arm's reach.
    """

    joint: int
    begin: np.ndarray
    end: np.ndarray
    radius: float


def reach(tree: BodyTree, tool: LinkFrame) -> float:
    """Length of the chain of links from the base to the tool [m]."""
    steps = [np.linalg.norm(body.translation) for body in tree.bodies]
    return float(np.sum(steps) + np.linalg.norm(tool.offset))


def mounting_distance(tree: BodyTree) -> float:
    """Distance of the first joint from the origin where no link is as long [m]; else zero.

    An arm under a ceiling or on a gantry is placed by it: there is no part of the arm between.
    """
    first, *others = (float(np.linalg.norm(body.translation)) for body in tree.bodies)
    return first if others and first > max(others) else 0.0


def capsules(tree: BodyTree, tool: LinkFrame) -> list[Capsule]:
    """One from every joint to each joint behind it, and one to the tool; none for a mounting."""
    mounted = mounting_distance(tree) > 0.0
    radii = joint_radii(tree, tool)
    rods = [
        Capsule(
            body.parent, np.zeros(3), np.array(body.translation), radii[max(body.parent, 1) - 1]
        )
        for body in tree.bodies
        if not (mounted and body.parent == 0)
    ]
    end = tool.offset
    if np.linalg.norm(end) <= 1e-9:
        # No tool point of its own: the last link is twice as long as to its centre of mass.
        end = 2.0 * tree.bodies[tool.joint - 1].centre
    rods.append(Capsule(tool.joint, np.zeros(3), np.array(end), 0.7 * radii[-1]))
    return [rod for rod in rods if np.linalg.norm(rod.end) > 1e-9]


def joint_radii(tree: BodyTree, tool: LinkFrame) -> list[float]:
    """Radius of the link behind each joint (n,) [m]: thick at the base, thin at the tool."""
    own = reach(tree, tool) - mounting_distance(tree)
    return [float(r) for r in own * np.linspace(_THICK, _THIN, tree.n)]
