"""Live view of a solved motion in the browser: `stiffopt view`, drawn by viser (extra `view`)."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from http import HTTPStatus
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from stiffopt.errors import InputError, InputFileError
from stiffopt.report.scene.document import shapes_around
from stiffopt.report.scene.poses import Poses, joint_frames, tool_positions
from stiffopt.robot.body_tree import Capsule, arm_reach, link_capsules
from stiffopt.robot.link_shapes import JointShape, mesh_triangles

if TYPE_CHECKING:
    from stiffopt.robot.cell import Cell
    from stiffopt.robot.robot import Robot

_BENT_COLOUR, _PLANNED_COLOUR, _GHOST_COLOUR = (196, 64, 56), (58, 108, 178), (150, 150, 150)
_FRAME_TIME = 1.0 / 30.0
# Boxes thinner than this [m] are walls, drawn more transparent.
_MAX_WALL_THICKNESS = 5e-3


class LiveScene:
    """Server of a page that shows an arm along a motion, with sliders of time and magnification.

    Parameters
    ----------
    poses : Poses
        Motion with one or more parts of the deflection.
    ghost : Poses or None
        Motion to compare with.
    cell : Cell or None
        Cell around the arm.
    host, port : str, int
        Address of the page; if the port is in use, the next one is taken. Requests for another
        host, or from pages of another origin, are refused with status 403.

    Raises
    ------
    InputError
        viser is not installed, or there is no such port.
    """

    def __init__(
        self,
        robot: Robot,
        poses: Poses,
        ghost: Poses | None = None,
        *,
        cell: Cell | None = None,
        host: str = "127.0.0.1",
        port: int = 8080,
    ) -> None:
        try:
            import viser
        except ModuleNotFoundError as error:
            raise InputError(
                "viewing needs viser. Install it: pip install 'stiffopt[view]'"
            ) from error
        if not 0 < port < 2**16:
            raise InputError(f"--port {port}: allowed are 1 to 65535.")
        self.robot, self.poses, self._ghost = robot, poses, ghost
        with _guarded_server({host, "127.0.0.1", "localhost", "[::1]"}):
            self.server = viser.ViserServer(host=host, port=port, verbose=False)
        self.server.scene.set_up_direction("+z")
        self.server.scene.add_grid("/floor", width=4.0, height=4.0, cell_size=0.1)
        self._arms = {
            "/bent": _ArmFrames(self.server, robot, "/bent", _BENT_COLOUR, None),
            "/planned": _ArmFrames(self.server, robot, "/planned", _PLANNED_COLOUR, 0.35),
        }
        if ghost is not None:
            self._arms["/ghost"] = _ArmFrames(self.server, robot, "/ghost", _GHOST_COLOUR, 0.25)
        for number, solid in enumerate(shapes_around(cell, arm_reach(robot.tree, robot.tool))):
            wall = solid.shape.kind == "box" and solid.shape.size[2] < _MAX_WALL_THICKNESS
            _add_shape(
                self.server.scene, f"/cell/{number}", solid, _GHOST_COLOUR, 0.2 if wall else 0.45
            )
        path = tool_positions(robot.tree, robot.tool, poses.position)
        self.server.scene.add_line_segments(
            "/path",
            np.stack([path[:-1], path[1:]], axis=1),
            _PLANNED_COLOUR,
            thickness=2.0,
            thickness_units="screen",
        )
        gui, end = self.server.gui, float(poses.time[-1])
        self.time: Any = gui.add_slider("time [s]", 0.0, end, end / 1000.0, 0.0)
        self.factor = gui.add_slider("enlarged", 0.0, 1000.0, 1.0, 100.0 if poses.bend else 0.0)
        self.part = gui.add_dropdown("part", tuple(poses.bend) or ("none",))
        self.playing = gui.add_checkbox("play", False)
        for each in (self.time, self.factor, self.part):
            each.on_update(lambda _: self.draw())
        self.draw()

    @property
    def address(self) -> str:
        """Address of the page."""
        return f"http://{self.server.get_host()}:{self.server.get_port()}"

    def draw(self) -> None:
        """Show the arm at the slider's time."""
        poses, at = self.poses, float(self.time.value)
        planned = _interpolate_row(poses.time, poses.position, at)
        bend = poses.bend.get(self.part.value)
        bent = planned
        if bend is not None:
            bent = planned - float(self.factor.value) * _interpolate_row(poses.time, bend, at)
        shown = {"/bent": bent, "/planned": planned}
        if self._ghost is not None:
            shown["/ghost"] = _interpolate_row(self._ghost.time, self._ghost.position, at)
        with self.server.atomic():
            for name, q in shown.items():
                self._arms[name].move(q)

    def tool(self) -> np.ndarray:
        """Return the displayed position of the bent arm's tool (3,) [m]."""
        return self._arms["/bent"].tool()

    def run(self) -> None:
        """Play while the box is ticked, until interrupted."""
        try:
            while True:
                time.sleep(_FRAME_TIME)
                if self.playing.value:
                    end = float(self.poses.time[-1])
                    self.time.value = (float(self.time.value) + _FRAME_TIME) % end
        except KeyboardInterrupt:
            pass
        finally:
            self.close()

    def close(self) -> None:
        """Stop serving."""
        self.server.stop()


@contextmanager
def _guarded_server(hosts: set[str]) -> Iterator[None]:
    """Make the server that viser starts refuse foreign pages; viser has no option for it."""
    from websockets.asyncio import server

    plain, guarded = server.serve, False

    def serve(*arguments: Any, process_request: Callable[..., Any], **named: Any) -> Any:
        nonlocal guarded
        guarded = True

        def answer(connection: Any, request: Any) -> Any:
            if not is_own_request(request.headers, hosts):
                return connection.respond(HTTPStatus.FORBIDDEN, "Not for this host or origin.\n")
            return process_request(connection, request)

        return plain(*arguments, process_request=answer, **named)

    server.serve = serve  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        server.serve = plain  # type: ignore[misc]
    if not guarded:
        raise InputError("this version of viser is not supported. Install viser 1.0 or later.")


def is_own_request(headers: Any, hosts: set[str]) -> bool:
    """Return True for a request that names one of the hosts and has its origin, or no origin.

    This refuses DNS rebinding (a foreign name resolved to this machine) and pages of other servers.
    """
    named, origins = headers.get_all("Host"), headers.get_all("Origin")
    if len(named) != 1 or re.sub(r":\d+$", "", named[0]).lower() not in hosts:
        return False
    return all(origin.lower() == f"http://{named[0].lower()}" for origin in origins)


class _ArmFrames:
    """Frames of the joints with the shapes attached to them."""

    def __init__(
        self,
        server: Any,
        robot: Robot,
        name: str,
        color: tuple[int, int, int],
        opacity: float | None,
    ) -> None:
        self._robot = robot
        self._frames = [
            server.scene.add_frame(f"{name}/J{j}", show_axes=False) for j in range(1, robot.n + 1)
        ]
        placed = [each for each in robot.joint_shapes("visual") if each.shape.known]
        placed = placed or [each for each in robot.joint_shapes("collision") if each.shape.known]
        shown = set()
        for number, each in enumerate(placed):
            place = f"{name}/J{each.joint}" if each.joint else name
            if _add_shape(server.scene, f"{place}/shape{number}", each, color, opacity):
                shown.add(each.joint)
        for number, rod in enumerate(link_capsules(robot.tree, robot.tool)):
            # Links with shapes need no capsule; the base has one only where no shapes exist.
            if rod.joint in shown or (rod.joint == 0 and shown):
                continue
            place = f"{name}/J{rod.joint}" if rod.joint else name
            _add_capsule(server.scene, f"{place}/rod{number}", rod, color, opacity)

    def move(self, q: np.ndarray) -> None:
        """Move the joints to positions (n,)."""
        rotations, origins = joint_frames(self._robot.tree, q[None])
        turns = Rotation.from_matrix(rotations[0]).as_quat(scalar_first=True)
        for frame, turn, origin in zip(self._frames, turns, origins[0], strict=True):
            frame.wxyz, frame.position = turn, origin

    def tool(self) -> np.ndarray:
        frame = self._frames[self._robot.tool.joint - 1]
        turn = Rotation.from_quat(np.asarray(frame.wxyz), scalar_first=True).as_matrix()
        return np.asarray(frame.position + turn @ self._robot.tool.offset)


def _add_shape(
    scene: Any,
    name: str,
    placed: JointShape,
    color: tuple[int, int, int],
    opacity: float | None,
) -> bool:
    """Add a shape to its joint; False for a mesh that cannot be read."""
    shape, looks = placed.shape, dict[str, Any](color=color, opacity=opacity)
    looks["wxyz"] = Rotation.from_matrix(placed.rotation).as_quat(scalar_first=True)
    looks["position"] = placed.offset
    if shape.kind == "box":
        scene.add_box(name, dimensions=shape.size, **looks)
    elif shape.kind == "sphere":
        scene.add_icosphere(name, radius=shape.size[0], **looks)
    elif shape.kind == "cylinder":
        scene.add_cylinder(name, radius=shape.size[0], height=shape.size[1], **looks)
    else:
        try:
            vertices, corners = mesh_triangles(shape)
        except InputFileError:
            return False
        scene.add_mesh_simple(name, vertices, corners, side="double", **looks)
    return True


def _add_capsule(
    scene: Any,
    name: str,
    rod: Capsule,
    color: tuple[int, int, int],
    opacity: float | None,
) -> None:
    along = rod.end - rod.begin
    turn = Rotation.align_vectors([along], [[0.0, 0.0, 1.0]])[0]
    scene.add_cylinder(
        name,
        radius=rod.radius,
        height=float(np.linalg.norm(along)),
        color=color,
        opacity=opacity,
        wxyz=turn.as_quat(scalar_first=True),
        position=0.5 * (rod.begin + rod.end),
    )
    for number, end in enumerate((rod.begin, rod.end)):
        scene.add_icosphere(
            f"{name}_{number}", radius=rod.radius, color=color, opacity=opacity, position=end
        )


def _interpolate_row(times: np.ndarray, values: np.ndarray, t: float) -> np.ndarray:
    """Interpolate values (K, n) at a time; constant beyond the ends."""
    columns: Sequence[float] = [np.interp(t, times, column) for column in values.T]
    return np.array(columns)
