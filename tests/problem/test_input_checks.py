"""Checks of units, inertias and payloads before a solve."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from small_arms import ROOT

from stiffopt import Objective, Target, TrajectoryProblem, load_problem, load_robot, solve
from stiffopt.baseline.baselines import baselines, strict_baseline
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.cli import run
from stiffopt.errors import ProblemError
from stiffopt.problem.input_checks import (
    check_plausible,
    inconsistent_inertias,
    max_reach,
    shifted_numbers,
)
from stiffopt.problem.resolve import resolve
from stiffopt.report.solve.wording import comparison

PROBLEM = ROOT / "problems" / "er3a_pick_and_place.toml"


def changed(tmp_path, old: str, new: str):
    text = PROBLEM.read_text()
    assert old in text
    path = tmp_path / "p.toml"
    path.write_text(text.replace(old, new, 1))
    return path


def problem(start: Target, robot=None) -> TrajectoryProblem:
    return TrajectoryProblem(
        robot=robot or load_robot("er3a_c60"),
        start=start,
        end=Target(joints=np.zeros(6)),
        duration=(1.0, 1.0),
        objectives=(Objective(name="torque_squared"),),
    )


def test_bare_degrees_in_a_file_are_refused(tmp_path, capsys):
    rpy = re.search(r"rpy = \[.*?\]", PROBLEM.read_text())[0]
    path = changed(tmp_path, rpy, "rpy = [180, 0, 0]")
    assert run(["solve", str(path), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "motion.start.rpy[1]: 180 rad is not plausible" in said
    assert 'Write "180 deg" if that is meant' in said


def test_angles_beyond_a_turn_are_refused_outside_the_joint_range():
    with pytest.raises(ProblemError, match=r"motion.start.joints\[2\] \(joint_2\) = 90 rad"):
        check_plausible(problem(Target(joints=[0, 90, 0, 0, 0, 0])))
    check_plausible(problem(Target(joints=[0, 0, 0, 0, 0, 2 * np.pi])))


def test_lengths_in_millimetres_are_refused():
    with pytest.raises(ProblemError, match=r"lies 430.* m from the base.*350 mm"):
        check_plausible(problem(Target(position=[350, 0, 250])))
    robot = load_robot("er3a_c60")
    with pytest.raises(ProblemError, match=r"tool.offset: the tool lies 78"):
        check_plausible(problem(Target(joints=np.zeros(6)), robot.with_tool(offset=[0, 0, 78.5])))
    heavy = robot.with_payload(1.0, [0.0, 0.0, 50.0])
    with pytest.raises(ProblemError, match=r"payload\.com"):
        check_plausible(problem(Target(joints=np.zeros(6)), heavy))
    assert 0.8 < max_reach(robot) < 2.0


PENDULUM = """<robot name="pendulum"><link name="base"/><link name="rod"><inertial>
<origin xyz="0.25 0 0"/><mass value="3"/>
<inertia ixx="0.001" iyy="0.06" izz="0.06" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="pivot" type="revolute"><parent link="base"/><child link="rod"/>
<origin xyz="0 0 0.1"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="40" velocity="4"/></joint></robot>"""


def test_last_link_length_follows_from_its_inertia(tmp_path):
    (tmp_path / "pendulum.urdf").write_text(PENDULUM)
    robot = load_robot(tmp_path / "pendulum.urdf")

    def at(offset: float) -> TrajectoryProblem:
        ends = (Target(joints=[0.1]), Target(joints=[1.0]))
        return replace(
            problem(ends[0], robot.with_tool(link="rod", offset=[offset, 0, 0])), end=ends[1]
        )

    # Its tip lies five times as far from the joint as the joint does from the base.
    check_plausible(at(0.5))
    with pytest.raises(ProblemError, match=r"tool.offset: the tool lies 500 m"):
        check_plausible(at(500.0))
    (tmp_path / "pendulum.urdf").write_text(PENDULUM.replace('"0.25 0 0"', '"250 0 0"'))
    robot = load_robot(tmp_path / "pendulum.urdf")
    with pytest.raises(ProblemError, match=r"centre of mass behind joint 1 .*lies 250 m"):
        check_plausible(at(0.5))


def test_payload_without_inertia_is_reported(tmp_path):
    inertia = re.search(r"\ninertia = .*", PROBLEM.read_text())[0]
    loaded = load_problem(changed(tmp_path, inertia, ""))
    assert "a point mass" in loaded.problem.remarks[0]
    assert load_problem(PROBLEM).problem.remarks == ()


def test_loaded_problem_can_be_solved():
    solution = solve(load_problem(ROOT / "problems" / "two_link.toml"))
    assert solution.status.usable
    assert solution.strict_baseline.name == "toppra"


def test_the_strict_baseline_keeps_every_limit():
    stated = load_problem(PROBLEM).problem
    motion = resolve(stated)
    beside = baselines(stated, motion)
    assert not beside["toppra"].assessment.feasible(CERTIFICATE_TOLERANCE)
    strict = strict_baseline(stated, motion, beside)
    assert strict.name == "S-curve"
    assert strict.assessment.feasible(CERTIFICATE_TOLERANCE)
    assert strict.assessment.duration == pytest.approx(0.6)
    assert strict.feasible


@pytest.mark.slow
def test_no_baseline_is_exempt_from_a_limit(solution_of_two_baselines):
    """Neither baseline keeps the limits within the duration allowed: neither is compared with."""
    stated, solution = solution_of_two_baselines
    assert not any(each.feasible for each in solution.baselines.values())
    strict = solution.strict_baseline
    assert strict is not None
    assert strict.feasible
    text = comparison(stated, solution)
    assert f"than the {strict.name} motion" in text
    assert "exempt" not in text
    text = comparison(stated, replace(solution, strict_baseline=None))
    assert "no baseline meets all limits, so none is counted." in text.lower()


@pytest.fixture(scope="module")
def solution_of_two_baselines():
    """Of few intervals: only the sentence matters."""
    from stiffopt.problem.trajectory import Method

    stated = replace(load_problem(PROBLEM).problem, method=Method(intervals=20, max_iterations=60))
    return stated, solve(stated, throw=False)


def test_inconsistent_inertia_is_reported():
    robot = load_robot("ur10")
    assert inconsistent_inertias(robot) == ()
    tree = robot.tree
    wrong = replace(tree.bodies[2], inertia=np.diag([0.1, 0.1, 0.3]))
    bodies = (*tree.bodies[:2], wrong, *tree.bodies[3:])
    (text,) = inconsistent_inertias(SimpleNamespace(tree=replace(tree, bodies=bodies)))
    assert "j3 ([0.1, 0.1, 0.3] kg m^2)" in text


@pytest.mark.parametrize(
    ("names", "told"),
    [
        (("rail_7", "arm_1"), "1 is rail_7, 2 is arm_1"),
        (("joint_0", "joint_1"), "1 is joint_0, 2 is joint_1"),
        (("joint_1", "joint_2"), ""),
        (("shoulder_pan_joint", "wrist_1"), ""),
    ],
)
def test_numbers_unlike_those_of_the_names_are_told(names, told):
    found = " ".join(shifted_numbers(SimpleNamespace(joint_names=names, n=2)))
    assert told in found
    assert bool(found) == bool(told)
