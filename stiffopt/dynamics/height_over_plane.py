"""Height of a point, ball or disc of one link over a plane that is fixed to another."""

from __future__ import annotations

import casadi as ca

from stiffopt.dynamics.kinematics import tool_pose
from stiffopt.robot.body_tree import BodyTree
from stiffopt.symbolic import Quantity

# Keeps the root smooth where a disc lies flat: a disc then stands a thousandth of its radius off.
_FLAT_DISC_REGULARISATION = 1e-6
# Numbers of one row: centre, axis, radius, normal, height.
ROW_PARAMETERS = 11


def height_over_plane(tree: BodyTree, first: int, second: int) -> ca.Function:
    """Height of the lowest point over a plane as a CasADi function.

    Parameters
    ----------
    tree : BodyTree
    first : int
        Number of the joint, from 1, that carries the point, ball or disc.
    second : int
        Of the joint that carries the plane; 0 is the base.

    Returns
    -------
    casadi.Function
        (q (n,), numbers (11,)) -> height [m]. The numbers are a centre (3) [m], the unit axis (3)
        of a disc (zero for a ball or a point) and a radius [m] in the frame of the first joint; the
        plane's unit normal (3) and its height along it [m] in that of the second.
    """
    q, numbers = ca.SX.sym("q", tree.n), ca.SX.sym("numbers", ROW_PARAMETERS)
    centre, axis, radius, normal, height = ca.vertsplit(numbers, [0, 3, 6, 7, 10, 11])
    origin, rotation = _joint_pose(tree, first, q)
    base, turn = _joint_pose(tree, second, q)
    outward = ca.mtimes(turn, normal)
    along = ca.dot(outward, ca.mtimes(rotation, axis))
    middle = ca.dot(outward, origin + ca.mtimes(rotation, centre) - base)
    reach = radius * ca.sqrt(1.0 + _FLAT_DISC_REGULARISATION - along * along)
    return ca.Function("height_over_plane", [q, numbers], [middle - reach - height])


def _joint_pose(tree: BodyTree, joint: int, q: Quantity) -> tuple[Quantity, Quantity]:
    if joint == 0:
        return ca.SX.zeros(3), ca.SX.eye(3)
    return tool_pose(tree, joint, (0.0, 0.0, 0.0), None, q)
