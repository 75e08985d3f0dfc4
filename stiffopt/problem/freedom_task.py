"""Nodes of a tool path with freedom: poses, forces, time steps, and the arm's functions there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial

import casadi as ca
import numpy as np

from stiffopt.dynamics.deflection import spring_torques, tool_deflection
from stiffopt.dynamics.inverse_kinematics import LENGTH_PER_RADIAN
from stiffopt.dynamics.kinematics import frame_jacobian, frame_pose
from stiffopt.errors import ProblemError
from stiffopt.problem.limit import Limits
from stiffopt.problem.limits.joint_curve import allowed_torque
from stiffopt.problem.path_force import COUNTED_AXES, ForceFrame, PathForce
from stiffopt.problem.path_freedom import PathFreedom, TurnBasis
from stiffopt.problem.pose_following import MIN_CONDITION
from stiffopt.problem.stage_model import StageModel, compact_chains, windups
from stiffopt.problem.tool_path import ToolPath
from stiffopt.robot.robot import Robot
from stiffopt.symbolic import Quantity

# Share of the limits of velocity, acceleration and holding torque that is used: the rest is for
# corners, ends and the torque of the motion.
USED_SHARE = 0.9
# Relative cost of a holding torque above that share, over the excess: more than any excess gains.
EXCESS_WEIGHT = 100.0
# Joints that a pose fixes.
POSE_JOINTS = 6
# A scan takes each fourth node.
SCAN_STRIDE = 4
# Nodes per turn of the feed [1/rad], eight in a right angle, and how many at most.
_NODES_PER_TURN, _MOST_TURN_NODES = 16.0 / np.pi, 240
# Residual at which a pose counts as found [m].
_SOLVED_RESIDUAL = 1e-8
# Entries of a node's data: position, rotation, force, rows of the error's directions.
_NODE_DATA = 3 + 9 + 3 + 9


@dataclass(frozen=True, eq=False)
class FreedomTask:
    """Tool path with freedom at nodes."""

    robot: Robot
    freedom: PathFreedom
    limits: Limits
    path: ToolPath  # as stated
    origin: np.ndarray  # (3,) [m] of its work frame
    force: PathForce | None  # along the stated path
    force_axes: ForceFrame  # in which it is given

    def __post_init__(self) -> None:
        freedom = self.freedom
        if freedom.posture == "near" and not (freedom.turns or np.any(freedom.placement)):
            raise ProblemError(
                "path.freedom leaves nothing free: give tool_axis_rotation, tilt or placement_box, "
                'or posture = "any".'
            )
        if self.force is not None and self.force_axes == "tool" and freedom.turns:
            raise ProblemError(
                "path.freedom would turn a force given in axes of the tool with the tool: give it "
                'in axes of the path, path.force.frame = "path", or of the base.'
            )
        if self.minimises_error and self.force is None:
            raise ProblemError(
                "path.freedom minimises the deflection under the process force, and there is none: "
                'add [path.force], or minimise = "duration".'
            )
        if self.minimises_error and not self.robot.yields:
            raise ProblemError(
                f"path.freedom minimises the deflection of the tool, and {self.robot.name} has no "
                'drivetrain: describe its joints\' elements, or minimise = "duration".'
            )

    @property
    def minimises_error(self) -> bool:
        """True where the deflection is minimised, else the time."""
        return self.freedom.minimise == "tool_error"

    @cached_property
    def position_range(self) -> tuple[np.ndarray, np.ndarray]:
        """Joint positions (n,) that may be used: the joints' spline passes between the nodes."""
        lower, upper = self.limits.position_lower, self.limits.position_upper
        # Part of the joints' range that is left at both ends [rad], at most a hundredth of it.
        room = np.minimum(2e-3, 0.01 * (upper - lower))
        return lower + room, upper - room

    @cached_property
    def along(self) -> np.ndarray:
        """Distances of the nodes (K,) [m]."""
        length = self.path.length
        # Nodes of a scan are 20 mm apart, within bounds of their number.
        scanned = int(np.clip(np.ceil(length / 0.02), 6, 30))
        even = np.linspace(0.0, length, SCAN_STRIDE * scanned + 1)
        if self.minimises_error:
            return even
        # The least time is decided where the path turns: further nodes in proportion to the turn.
        place, turned = self.path.turn_of_feed()
        more = min(_NODES_PER_TURN * turned[-1], _MOST_TURN_NODES)
        share = np.interp(place, even, np.arange(len(even)))
        share += more * turned / max(turned[-1], 1e-12)
        count = SCAN_STRIDE * int(np.ceil(share[-1] / SCAN_STRIDE))
        return np.asarray(np.interp(np.linspace(0.0, share[-1], count + 1), share, place))

    @cached_property
    def basis(self) -> TurnBasis:
        """Basis of rotation and tilt."""
        return self.freedom.turn_basis(self.path.length)

    @cached_property
    def least_steps(self) -> np.ndarray:
        """Time (K - 1,) [s] between nodes at the largest tool speed."""
        middles = 0.5 * (self.along[1:] + self.along[:-1])
        piece = np.clip(
            np.searchsorted(self.path.breaks, middles) - 1, 0, len(self.path.speeds) - 1
        )
        speed = np.minimum(self.path.speeds[piece], self.limits.tool_speed)
        # Tool speed at which joint rates are judged where the path states none [m/s]: that of
        # ISO 10218-1 for manual operation, which no process exceeds without saying so.
        usual = 0.25 if self.minimises_error else np.inf
        return np.asarray(np.diff(self.along) / np.where(np.isfinite(speed), speed, usual))

    def node_data(self, along: np.ndarray) -> np.ndarray:
        """Data of nodes (24, K) at distances (K,) [m]."""
        position, rotation = self.path.poses(along)
        pushed, rows = np.zeros((len(along), 3)), np.repeat(np.eye(3)[None], len(along), axis=0)
        if self.force is not None:
            share = along / self.path.length
            middles = 0.5 * (self.along[1:] + self.along[:-1])
            with np.errstate(divide="ignore"):
                feed = np.interp(along, middles, np.diff(self.along) / self.least_steps)
            pushed = self.force(share, np.where(np.isfinite(feed), feed, 0.0))
            axes = self.force.axes_at(share)
            rows = np.diag(COUNTED_AXES[self.freedom.error_direction]) @ axes.swapaxes(1, 2)
        flat = [each.swapaxes(1, 2).reshape(len(along), 9) for each in (rotation, rows)]
        return np.hstack([position, flat[0], pushed, flat[1]]).T

    @cached_property
    def node(self) -> ca.Function:
        """Function (q (n,), placement (6,), turns (3,), data (24,)) -> (residual (6,), error (3,)).

        The residual of the pose is in [m], an angle times 0.3 m; the error is the deflection of
        the tool under the force in the directions that count [m].
        """
        robot = self.robot
        q, placement = ca.SX.sym("q", robot.n), ca.SX.sym("placement", 6)
        turns, data = ca.SX.sym("turns", 3), ca.SX.sym("data", _NODE_DATA)
        stated, turned, force, rows = ca.vertsplit(data, [0, 3, 12, 15, _NODE_DATA])
        placed = _rotation_of_vector(placement[3:])
        wanted = self.origin + placement[:3] + ca.mtimes(placed, stated - self.origin)
        leaned = _rotation_of_vector(ca.vertcat(turns[1:], 0.0))
        spun = _rotation_of_vector(ca.vertcat(0.0, 0.0, turns[0]))
        goal = ca.mtimes([placed, ca.reshape(turned, 3, 3), leaned, spun])
        position, rotation = frame_pose(robot.tree, robot.tool, q)
        off = ca.mtimes(rotation.T, goal)
        angle = 0.5 * ca.vertcat(
            off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]
        )
        residual = ca.vertcat(position - wanted, LENGTH_PER_RADIAN * angle)
        error: Quantity = ca.SX.zeros(3)
        if self.force is not None and robot.yields:
            pushed = self._base_force(placement, force)
            rest = ca.SX.zeros(robot.n)
            jacobian = frame_jacobian(robot.tree, robot.tool, q)
            torques = spring_torques(robot.tree, q, rest, rest, ca.mtimes(jacobian.T, pushed))
            windup = partial(windups, compact_chains(robot), smoothing=1.0)
            moved = tool_deflection(jacobian, torques, windup).process
            error = ca.mtimes([ca.reshape(rows, 3, 3), placed.T, moved])
        return ca.Function("node", [q, placement, turns, data], [residual, error])

    @cached_property
    def linearised_pose(self) -> ca.Function:
        """Function of the same arguments -> (residual (6,), its Jacobian by q (6, n))."""
        arguments = [ca.SX.sym("a", *self.node.size_in(k)) for k in range(4)]
        residual, _ = self.node(*arguments)
        jacobian = ca.densify(ca.jacobian(residual, arguments[0]))
        return ca.Function("pose", arguments, [residual, jacobian])

    @cached_property
    def derivatives(self) -> ca.Function:
        """Function of the same arguments -> Jacobians and gradients.

        Of the residual by q (6, n) and by placement and turns (6, 9), of the squared error by q
        (n,) and by placement and turns (9,).
        """
        arguments = [ca.SX.sym("a", *self.node.size_in(k)) for k in range(4)]
        residual, error = self.node(*arguments)
        q, parameters = arguments[0], ca.vertcat(*arguments[1:3])
        square = ca.dot(error, error)
        return ca.Function(
            "derivatives",
            arguments,
            [
                ca.densify(ca.jacobian(residual, q)),
                ca.densify(ca.jacobian(residual, parameters)),
                ca.densify(ca.jacobian(square, q)),
                ca.densify(ca.jacobian(square, parameters)),
            ],
        )

    @cached_property
    def hold(self) -> ca.Function:
        """Function (q (n,), placement (6,), data (24,)) -> excess (2 n,) of torques at rest.

        Of weight, process force and dry friction in either direction, above the share of the
        torque limits that is used, relative to it; of positive torques, then of negative ones.
        """
        robot = self.robot
        allowed = USED_SHARE * allowed_torque(self.limits, np.zeros((1, robot.n)))[0]
        q, placement = ca.SX.sym("q", robot.n), ca.SX.sym("placement", 6)
        data, rest = ca.SX.sym("data", _NODE_DATA), ca.SX.zeros(robot.n)
        model = StageModel(robot, q, rest, rest, np.zeros(3), 1.0, np.zeros(robot.n))
        force = self._base_force(placement, data[12:15])
        torque = model.torques.gravity - ca.mtimes(model.jacobian.T, force)
        sides = [(sign * torque + robot.coulomb) / allowed - 1.0 for sign in (1.0, -1.0)]
        return ca.Function("hold", [q, placement, data], [ca.densify(ca.vertcat(*sides))])

    @cached_property
    def hold_derivatives(self) -> ca.Function:
        """Function of the same arguments -> Jacobians by q (2 n, n) and by placement (2 n, 6)."""
        arguments = [ca.SX.sym("a", *self.hold.size_in(k)) for k in range(3)]
        excess = self.hold(*arguments)
        slopes = [ca.densify(ca.jacobian(excess, each)) for each in arguments[:2]]
        return ca.Function("hold_derivatives", arguments, slopes)

    def _base_force(self, placement: Quantity, force: Quantity) -> Quantity:
        """Process force (3,) in base axes, of the force at a node."""
        placed = _rotation_of_vector(placement[3:])
        return force if self.force_axes == "base" else ca.mtimes(placed, force)

    def hold_excess(self, q: np.ndarray, placement: np.ndarray, data: np.ndarray) -> np.ndarray:
        """Excess (K, 2 n) of torques at rest, at joint positions (K, n); the others (., K)."""
        return np.asarray(self.hold.map(len(q))(q.T, placement, data)).T

    @cached_property
    def _conditioning(self) -> ca.Function:
        """Function (q (n,), u (6,), v (n,)) -> (J (6, n), gradient (n,) of u J v by q).

        J is the Jacobian of the tool's pose in its own axes, angles times 0.3 m; with its singular
        vectors u and v the gradient is that of the singular value.
        """
        robot = self.robot
        q, left, right = ca.SX.sym("q", robot.n), ca.SX.sym("u", 6), ca.SX.sym("v", robot.n)
        position, rotation = frame_pose(robot.tree, robot.tool, q)
        columns = []
        turned = ca.jacobian(ca.vec(rotation), q)
        for j in range(robot.n):
            rate = ca.mtimes(rotation.T, ca.reshape(turned[:, j], 3, 3))
            columns.append(LENGTH_PER_RADIAN * ca.vertcat(rate[2, 1], rate[0, 2], rate[1, 0]))
        moved = ca.mtimes(rotation.T, ca.jacobian(position, q))
        jacobian = ca.densify(ca.vertcat(moved, ca.horzcat(*columns)))
        value = ca.dot(left, ca.mtimes(jacobian, right))
        slope = ca.densify(ca.gradient(value, q))
        return ca.Function("conditioning", [q, left, right], [jacobian, slope])

    def singular_values(
        self, joints: np.ndarray, held: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return least and largest singular value (K,) of the pose's Jacobian, joints `held` fixed.

        And the gradient (K, n) of the least by the joint positions (K, n).
        """
        count, n = joints.shape
        function = self._conditioning.map(count)
        jacobian, _ = function(joints.T, np.zeros((6, count)), np.zeros((n, count)))
        whole = np.asarray(jacobian).reshape(6, count, n).transpose(1, 0, 2) * ~held
        left, values, right = np.linalg.svd(whole, full_matrices=False)
        _, slope = function(joints.T, left[:, :, 5].T, right[:, 5].T)
        return values[:, 5], values[:, 0], np.asarray(slope).T

    def errors(
        self, q: np.ndarray, placement: np.ndarray, turns: np.ndarray, data: np.ndarray
    ) -> np.ndarray:
        """Deflection that counts (K,) [m] at joint positions (K, n); the others (., K) or (.,)."""
        _, error = self.node.map(len(q))(q.T, placement, turns, data)
        return np.asarray(np.linalg.norm(np.asarray(error), axis=0))

    def costs(
        self,
        joints: np.ndarray,
        nodes: np.ndarray,
        placement: np.ndarray,
        turns: np.ndarray,
        data: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Cost (C,) of motions (C, K, n) through nodes: the largest deflection [m] or the time [s].

        A deflection counts more where joints are too slow for the speed of the path. And the
        largest excess (C,) of torques at rest. Placement (6, C K) and turns (3, C K) are those of
        each node of each motion, data (24, K) of one.
        """
        count, size, n = joints.shape
        flat, data = joints.reshape(count * size, n), np.tile(data, (1, count))
        hold = self.hold_excess(flat, placement, data).max(axis=1, initial=0.0)
        excess = hold.reshape(count, size).max(axis=1)
        elapsed = np.concatenate([[0.0], np.cumsum(self.least_steps)])
        least = np.diff(np.interp(nodes, self.along, elapsed))
        needed = np.max(np.abs(np.diff(joints, axis=1)) / self.limits.velocity, axis=2)
        if not self.minimises_error:
            _, bend, twist = path_derivatives(nodes, joints.swapaxes(0, 1))
            for values, limit, power in (
                (bend, self.limits.acceleration, 1.0 / 2.0),
                (twist, self.limits.jerk, 1.0 / 3.0),
            ):
                slowest = np.max(np.abs(values) / limit, axis=2).T ** power
                needed = np.maximum(needed, np.diff(nodes) * slowest)
            return np.maximum(needed, least).sum(axis=1), excess
        error = self.errors(flat, placement, turns, data)
        slowing = np.maximum(1.0, np.max(needed / least, axis=1))
        return error.reshape(count, size).max(axis=1) * slowing, excess

    def solve_poses(
        self,
        q: np.ndarray,
        placement: np.ndarray,
        turns: np.ndarray,
        data: np.ndarray,
        held: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Joint positions (K, n) of poses, from guesses (K, n), and which were found, not singular.

        Joints `held` (n,) keep their positions. Damped Gauss-Newton steps of all at once, inside
        the position limits.
        """
        count, n = q.shape
        pose = self.linearised_pose.map(count)
        lower, upper = self.position_range
        q = np.clip(q, lower, upper)
        for _ in range(40):
            residual, jacobian = (np.asarray(each) for each in pose(q.T, placement, turns, data))
            off = np.linalg.norm(residual, axis=0)
            if np.all(off < _SOLVED_RESIDUAL):
                break
            own = jacobian.reshape(6, count, n).transpose(1, 0, 2)
            if held is not None:
                own = own * ~held
            gram = own @ own.swapaxes(1, 2)
            # Damping of Gauss-Newton steps by the squared residual, and its floor.
            damping = 0.1 * off**2 + 1e-10
            gram += damping[:, None, None] * np.eye(6)
            step = np.einsum(
                "kij,ki->kj", own, np.linalg.solve(gram, residual.T[:, :, None])[..., 0]
            )
            size = np.abs(step).max(axis=1, keepdims=True)
            # Largest step of a joint [rad].
            step = step * np.minimum(1.0, 0.4 / np.maximum(size, 1e-12))
            q = np.clip(q - step, lower, upper)
        values = np.linalg.svd(jacobian.reshape(6, count, n).transpose(1, 0, 2), compute_uv=False)
        regular = values[:, -1] > MIN_CONDITION * values[:, 0]
        return q, (off < _SOLVED_RESIDUAL) & regular


def _rotation_of_vector(vector: Quantity) -> Quantity:
    """Rotation (3, 3) about a vector by its length [rad], smooth at zero."""
    # Square of an angle [rad^2] that keeps the rotation vector's root smooth at zero.
    square = ca.dot(vector, vector) + 1e-16
    angle = ca.sqrt(square)
    cross = ca.skew(vector)
    return (
        ca.SX.eye(3)
        + ca.sin(angle) / angle * cross
        + (1.0 - ca.cos(angle)) / square * ca.mtimes(cross, cross)
    )


# First, second and third derivative (K - 1, ...) by the distance.
Derivatives = tuple[np.ndarray, np.ndarray, np.ndarray]


def path_derivatives(along: np.ndarray, joints: np.ndarray) -> Derivatives:
    """Return three derivatives (K - 1, ...) by the distance (K,) [m] in each step, of (K, ...)."""
    step = np.diff(along).reshape((-1,) + (1,) * (joints.ndim - 1))
    slope = np.diff(joints, axis=0) / step
    inner = np.diff(slope, axis=0) / (0.5 * (step[1:] + step[:-1]))
    bend = np.concatenate([inner[:1], 0.5 * (inner[1:] + inner[:-1]), inner[-1:]])
    twist = np.zeros_like(slope)
    twist[1:-1] = np.diff(inner, axis=0) / step[1:-1]
    return slope, bend, twist
