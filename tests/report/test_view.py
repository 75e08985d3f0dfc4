"""`stiffopt view`: the arm of a solve on a page of its own."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from small_arms import write_problem, write_robot

from stiffopt.cli import run
from stiffopt.report.scene.poses import stored_poses
from stiffopt.report.scene.still import write_scene_page
from stiffopt.robot.cell import Box, Cell
from stiffopt.robot.files import load_robot


def scene_of(page):
    """Content of the scene on a page."""
    text = page.read_text(encoding="utf-8")
    (found,) = re.findall(r'id="scene-document">(.*?)</script>', text, re.DOTALL)
    return json.loads(found)


def test_page_has_motion_ghost_and_cell(tmp_path):
    robot = load_robot(write_robot(tmp_path, "planar"))
    time = np.linspace(0.0, 1.0, 101)
    position = np.outer(time, np.full(robot.n, 0.8))
    motions = {
        "planned": stored_poses(robot, time, position, np.full((101, robot.n), 1e-3)),
        "toppra": stored_poses(robot, time, 0.5 * position),
    }
    box = Box(name="table", size=(0.2, 0.4, 0.1), position=(0.5, 0.1, -0.2))
    page = write_scene_page(
        "two links", robot, motions, tmp_path / "scene.html", Cell(floor=-0.5, box=(box,))
    )
    document = scene_of(page)
    assert [each["name"] for each in document["motions"]] == ["planned", "toppra"]
    assert document["motions"][1]["position"][-1] == pytest.approx([0.4] * robot.n, abs=1e-6)
    assert len(document["around"]) == 2
    assert "<h1>two links</h1>" in page.read_text(encoding="utf-8")


@pytest.mark.slow
def test_view_of_a_folder(tmp_path, capsys):
    path = write_problem(tmp_path, minimise='objective = "dynamic_deflection"')
    out = tmp_path / "out"
    assert run(["solve", str(path), "--out", str(out), "--quiet"]) == 0
    assert run(["view", str(out), "--no-open"]) == 0
    assert f"Wrote {out / 'scene.html'}" in capsys.readouterr().out
    # The largest deflection is that of the certificate.
    certificate = json.loads((out / "result.json").read_text())["certificate"]
    largest = max(scene_of(out / "scene.html")["motions"][0]["deflection"]["total"])
    assert largest == pytest.approx(certificate["deflection"]["total"]["peak"], rel=0.02)
    assert run(["view", str(tmp_path), "--no-open"]) == 2
