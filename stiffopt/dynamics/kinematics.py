"""Forward kinematics of a point fixed to a joint frame, and its position Jacobian.

`joint` is its number (1 is the first joint), `offset` lies in the joint's frame [m] and
`rotation` turns tool vectors into that frame. Results are in the base frame.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from stiffopt.dynamics.joint_axes import AxisJoint, axis_joints, clean
from stiffopt.dynamics.newton_euler import joint_pose
from stiffopt.robot.body_tree import BodyTree
from stiffopt.robot.frames import LinkFrame
from stiffopt.symbolic import Quantity


def tool_pose(
    tree: BodyTree, joint: int, offset: ArrayLike, rotation: object, q: Quantity
) -> tuple[Quantity, Quantity]:
    """Return position (3,) [m] and rotation (3, 3) of a tool frame, expressions of SX q (n,).

    With `rotation` None the tool frame is parallel to the joint frame.
    """
    joints = axis_joints(tree)
    frames = axis_frames(joints, q, joint)
    origin, turn = frames[joint]
    to_axis_frame = joints[joint - 1].from_joint_frame
    position = origin + ca.mtimes(turn, _as_casadi_vector(to_axis_frame @ _as_point(offset)))
    tool = np.eye(3) if rotation is None else np.asarray(rotation, dtype=float)
    turn = ca.mtimes(turn, ca.sparsify(ca.DM(clean(to_axis_frame @ tool))))
    return ca.densify(position), ca.densify(turn)


def point_position(tree: BodyTree, joint: int, offset: ArrayLike, q: Quantity) -> Quantity:
    """Return the position (3,) [m] of a point, an expression of SX q (n,), base axes."""
    return tool_pose(tree, joint, offset, None, q)[0]


def point_jacobian(tree: BodyTree, joint: int, offset: ArrayLike, q: Quantity) -> Quantity:
    """Return the position Jacobian (3, n) of a point, an expression of SX q (n,)."""
    joints = axis_joints(tree)
    frames = axis_frames(joints, q, joint)
    origin, turn = frames[joint]
    point = origin + ca.mtimes(
        turn, _as_casadi_vector(joints[joint - 1].from_joint_frame @ _as_point(offset))
    )
    return _columns_of_point(joints, frames, point)


def frame_pose(tree: BodyTree, frame: LinkFrame, q: Quantity) -> tuple[Quantity, Quantity]:
    """Return position and rotation of a frame as of `tool_pose`, relative to its `seen_from`."""
    position, rotation = tool_pose(tree, frame.joint, frame.offset, frame.rotation, q)
    if frame.seen_from is None:
        return position, rotation
    origin, axes = frame_pose(tree, frame.seen_from, q)
    return ca.mtimes(axes.T, position - origin), ca.mtimes(axes.T, rotation)


def frame_jacobian(tree: BodyTree, frame: LinkFrame, q: Quantity) -> Quantity:
    """Return the position Jacobian (3, n) of a frame, relative to its `seen_from`."""
    moved, work = point_jacobian(tree, frame.joint, frame.offset, q), frame.seen_from
    if work is None:
        return moved
    point = point_position(tree, frame.joint, frame.offset, q)
    axes, joints = frame_pose(tree, work, q)[1], axis_joints(tree)
    carried = _columns_of_point(joints, axis_frames(joints, q, work.joint), point)
    return ca.mtimes(axes.T, moved - carried)


def _columns_of_point(
    joints: tuple[AxisJoint, ...], frames: dict[int, tuple[Quantity, Quantity]], point: Quantity
) -> Quantity:
    """Jacobian (3, n) of a point (3,), base axes, that moves with the last of the axis frames."""
    columns = [ca.SX.zeros(3) for _ in joints]
    for i, (center, rotation) in frames.items():
        if i:
            axis = rotation[:, 2]
            turning = not joints[i - 1].prismatic
            columns[i - 1] = ca.cross(axis, point - center) if turning else axis
    return ca.densify(ca.horzcat(*columns))


def axis_frames(
    joints: tuple[AxisJoint, ...], q: Quantity, last: int
) -> dict[int, tuple[Quantity, Quantity]]:
    """Return origin and rotation, in the base, of the axis frames from the base to joint `last`."""
    support = [last]
    while support[-1]:
        support.append(joints[support[-1] - 1].parent)
    frames: dict[int, tuple[Quantity, Quantity]] = {0: (ca.SX.zeros(3), ca.SX.eye(3))}
    for i in reversed(support[:-1]):
        joint = joints[i - 1]
        rotation, origin = joint_pose(joint, q[i - 1])
        center, turn = frames[joint.parent]
        frames[i] = (center + ca.mtimes(turn, origin), ca.mtimes(turn, rotation))
    return frames


def _as_point(offset: ArrayLike) -> np.ndarray:
    return np.asarray(offset, dtype=float).reshape(3)


def _as_casadi_vector(values: np.ndarray) -> ca.DM:
    return ca.sparsify(ca.DM(clean(values)))


# Keeps the root smooth where a disc is parallel to the plane; an error of 1e-3 of its radius.
_FLAT_DISC_REGULARISATION = 1e-6
# Parameters of one row: centre, axis, radius, normal, height.
ROW_PARAMETERS = 11


def height_over_plane(tree: BodyTree, first: int, second: int) -> ca.Function:
    """Return (q (n,), numbers (11,)) -> height [m] of the lowest point over a plane.

    The numbers are a centre (3) [m], the unit axis (3) of a disc (zero for a ball or a point) and a
    radius [m] in the frame of joint `first`; the plane's unit normal (3) and its height along it
    [m] in that of `second` (0: base).
    """
    q, numbers = ca.SX.sym("q", tree.n), ca.SX.sym("numbers", ROW_PARAMETERS)
    centre, axis, radius, normal, height = ca.vertsplit(numbers, [0, 3, 6, 7, 10, 11])
    origin, rotation = _link_frame(tree, first, q)
    base, turn = _link_frame(tree, second, q)
    outward = ca.mtimes(turn, normal)
    along = ca.dot(outward, ca.mtimes(rotation, axis))
    middle = ca.dot(outward, origin + ca.mtimes(rotation, centre) - base)
    reach = radius * ca.sqrt(1.0 + _FLAT_DISC_REGULARISATION - along * along)
    return ca.Function("height_over_plane", [q, numbers], [middle - reach - height])


def _link_frame(tree: BodyTree, joint: int, q: Quantity) -> tuple[Quantity, Quantity]:
    if joint == 0:
        return ca.SX.zeros(3), ca.SX.eye(3)
    return tool_pose(tree, joint, (0.0, 0.0, 0.0), None, q)
