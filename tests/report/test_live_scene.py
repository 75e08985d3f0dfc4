"""`stiffopt view`: the arm of a solve live in the browser."""

from __future__ import annotations

import http.client
import json

import numpy as np
import pytest
from small_arms import write_problem, write_robot

from stiffopt.cli import run
from stiffopt.errors import InputError
from stiffopt.report.scene.poses import stored_poses, tool_positions
from stiffopt.robot.cell import Box, Cell, MeshObstacle
from stiffopt.robot.files import load_robot

viser = pytest.importorskip("viser")


@pytest.fixture
def scene(tmp_path):
    from stiffopt.report.scene.live import LiveScene

    robot = load_robot(write_robot(tmp_path, "planar"))
    time = np.linspace(0.0, 1.0, 101)
    position = np.outer(time, np.full(robot.n, 0.8))
    poses = stored_poses(robot, time, position, np.full((101, robot.n), 1e-3))
    ghost = stored_poses(robot, time, 0.5 * position)
    opened = LiveScene(robot, poses, ghost, port=18080)
    yield opened
    opened.close()


@pytest.mark.parametrize("port", [0, -1, 65536, 99999999])
def test_ports_that_cannot_be_are_told(port):
    from stiffopt.report.scene.live import LiveScene

    with pytest.raises(InputError, match="allowed are 1 to 65535"):
        LiveScene(None, None, port=port)


def test_the_page_is_served_to_this_machine(scene):
    connection = http.client.HTTPConnection("127.0.0.1", scene.server.get_port(), timeout=10)
    connection.request("GET", "/")
    with connection.getresponse() as response:
        assert response.status == 200
        assert b"<html" in response.read()
    connection.close()
    assert scene.address.startswith("http://127.0.0.1:")


def test_sliders_move_the_arm(scene):
    robot = scene.robot
    scene.factor.value = 0.0
    scene.time.value = 0.5
    scene.draw()
    where = tool_positions(robot.tree, robot.tool, np.full((1, robot.n), 0.4))[0]
    assert scene.tool() == pytest.approx(where, abs=1e-9)
    scene.factor.value, scene.part.value = 100.0, "total"
    scene.draw()
    bent = tool_positions(robot.tree, robot.tool, np.full((1, robot.n), 0.4 - 0.1))[0]
    assert scene.tool() == pytest.approx(bent, abs=1e-9)


def test_live_scene_shows_the_cell(tmp_path):
    from stiffopt.report.scene.live import LiveScene

    robot = load_robot(write_robot(tmp_path, "planar"))
    poses = stored_poses(robot, np.array([0.0, 1.0]), np.zeros((2, robot.n)))
    box = Box(name="table", size=(0.2, 0.4, 0.1), position=(0.5, 0.1, -0.2))
    lost = MeshObstacle(name="lost", file=str(tmp_path / "lost.stl"))
    opened = LiveScene(robot, poses, cell=Cell(floor=-0.5, box=(box,), mesh=(lost,)), port=18090)
    try:
        shown = opened.server.scene._handle_from_node_name
        assert {name for name in shown if name.startswith("/cell/")} == {"/cell/0", "/cell/2"}
    finally:
        opened.close()


@pytest.mark.slow
def test_view_of_a_folder(tmp_path, capsys, monkeypatch):
    from stiffopt.report.scene.live import LiveScene

    path = write_problem(tmp_path, minimise='objective = "dynamic_deflection"')
    out = tmp_path / "out"
    assert run(["solve", str(path), "--out", str(out), "--quiet"]) == 0
    shown = []
    monkeypatch.setattr(LiveScene, "run", lambda self: (shown.append(self.poses), self.close()))
    capsys.readouterr()
    assert run(["view", str(out), "--port", "18090"]) == 0
    assert "http://127.0.0.1:18" in capsys.readouterr().out
    # The largest deflection is that of the certificate.
    certificate = json.loads((out / "result.json").read_text())["certificate"]
    largest = shown[0].deflection["total"].max()
    assert largest == pytest.approx(certificate["deflection"]["total"]["peak"], rel=0.02)
    assert run(["view", str(tmp_path)]) == 2


OWN = "127.0.0.1:{port}"


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Host": OWN}, 200),
        ({"Host": "localhost:{port}", "Origin": "http://localhost:{port}"}, 200),
        ({"Host": "localhost:9"}, 200),  # a port that is forwarded to this one
        ({"Host": "evil.example:{port}"}, 403),  # whatever address that name has today
        ({"Host": "127.0.0.1.evil.example"}, 403),
        ({"Host": OWN, "Origin": "http://evil.example"}, 403),
        ({"Host": OWN, "Origin": "http://localhost:{port}"}, 403),
        ({"Host": OWN, "Origin": "null"}, 403),
        ({}, 403),
    ],
)
@pytest.mark.parametrize("upgrade", [False, True])
def test_foreign_hosts_and_origins_are_refused(scene, headers, status, upgrade):
    port = scene.server.get_port()
    sent = {name: value.format(port=port) for name, value in headers.items()}
    if upgrade:
        sent |= {
            "Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13",
            "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
        }  # fmt: skip
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.putrequest("GET", "/", skip_host=True)
    for name, value in sent.items():
        connection.putheader(name, value)
    connection.endheaders()
    with connection.getresponse() as response:
        assert response.status == (101 if upgrade and status == 200 else status)
    connection.close()


def test_unsupported_viser_is_refused():
    from stiffopt.report.scene.live import _guarded_server

    with (
        pytest.raises(InputError, match="version of viser is not supported"),
        _guarded_server(set()),
    ):
        pass  # begins no server of websockets
