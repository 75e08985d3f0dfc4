"""Flanges that tilt move the tool: by geometry, by work, in the programme and in the catalogue."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from preload_studies import case, study, with_elements

from stiffopt import load_robot
from stiffopt.fastening.tilting import tilting_flange
from stiffopt.preload.catalogue_choice import choose_design
from stiffopt.preload.flange_loads import carries_tilting, tilt_deflection, tilt_vector
from stiffopt.preload.load_case import LoadHistory
from stiffopt.preload.load_sources import pose_case
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.optimise import optimise_preloads, with_worst_instants
from stiffopt.preload.problem import Choice, Requirements
from stiffopt.robot.joint_load import joint_frames, joint_wrenches

ANGLES = np.array([0.3, 0.4, 0.5, -0.3, 0.6, 0.2])
FORCE = np.array([20.0, -10.0, 60.0])
OPEN = {"bearing": "none", "face_position": 0.04}


def open_arm(*joints, **changes):
    """The arm with flexspline flanges that carry all of their joints' load."""
    robot = load_robot("er3a_c60")
    for joint in joints:
        chains = list(robot.chains)
        chains[joint - 1] = with_elements(joint, flexspline_flange=OPEN | changes).chains[joint - 1]
        robot = replace(robot, chains=tuple(chains))
    return robot


def flange_of(robot, joint):
    return next(s for s in robot.chains[joint - 1].stages if s.element.name == "flexspline_flange")


def pressed(robot, deflection="process"):
    return pose_case(robot, "press", ANGLES, FORCE, deflection)


def test_only_flanges_that_bear_all_tilt():
    assert carries_tilting(flange_of(open_arm(2), 2))
    assert not carries_tilting(flange_of(load_robot("er3a_c60"), 2))
    load = pressed(load_robot("er3a_c60"))
    assert not tilt_vector(flange_of(load_robot("er3a_c60"), 2), 2, load).any()
    # Torques alone say nothing of moments.
    assert not tilt_vector(flange_of(open_arm(2), 2), 2, case("torque", j2=50.0)).any()


@pytest.mark.parametrize("joint", [1, 2, 4])
def test_a_turned_flange_by_turning_the_arm_behind_it(joint):
    robot = open_arm(joint)
    stage, load = flange_of(robot, joint), pressed(robot, "total")
    tilting = tilting_flange(stage.element, 5e3)
    # Turn everything behind the face by the moments of the joint, as a rigid body.
    axes, arm = (values[0, joint - 1] for values in joint_frames(robot, ANGLES[None]))
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, ANGLES)
    origin = data.oMi[joint].translation
    tool = data.oMi[robot.tool.joint].act(robot.tool.offset)
    assert arm == pytest.approx(tool - origin)
    assert axes[:, 2] == pytest.approx(data.oMi[joint].rotation @ robot.tree.bodies[joint - 1].axis)
    force, moment = load.wrench[joint - 1, :3], load.wrench[joint - 1, 3:].copy()
    moment -= np.cross([0.0, 0.0, 0.04], force)
    moment[2] = 0.0
    face = origin + 0.04 * axes[:, 2]
    small = 1e-3
    turn = pin.exp3(small * axes @ moment / tilting.closed_stiffness)
    moved = (face + turn @ (tool - face) - tool) / small
    found = tilt_deflection(stage, joint, load, 5e3)
    assert found == pytest.approx(moved, rel=1e-5, abs=1e-12)
    assert found == pytest.approx(
        tilt_vector(stage, joint, load) / tilting.closed_stiffness, rel=1e-9
    )


def test_force_does_the_work_that_the_flanges_store():
    """Castigliano: force times deflection is the sum of torque times wind-up, tilting among it."""
    robot = open_arm(1, 2, 4)
    load = pressed(robot)
    model = PreloadModel(study(load, robot=robot, joints=(1, 2, 4)))
    preloads = model.design
    deflection = model.exact_deflection(preloads)[0]
    push = load.wrench - load.reference_wrench
    work = sum(push[j - 1, 5] * float(model.net_windups(preloads, j)[0]) for j in range(1, 7))
    tilted = 0.0
    for index, element in enumerate(model.elements):
        if not carries_tilting(element.stage):
            continue
        moment = push[element.joint - 1, 3:5].copy()
        moment += 0.04 * np.array([1, -1]) * push[element.joint - 1, [1, 0]]
        tilted += moment @ moment * model.exact_tilt_compliance(preloads, index)
    assert tilted > 0.01 * work
    assert FORCE @ deflection == pytest.approx(work + tilted, rel=1e-9)


def test_a_moment_that_opens_the_face_turns_it_further():
    robot = open_arm(2)
    stage, load = flange_of(robot, 2), pressed(robot, "total")
    loose = tilting_flange(stage.element, 30.0)
    assert np.hypot(*load.wrench[1, 3:5]) > loose.lift_off_moment
    closed = tilt_vector(stage, 2, load) / loose.closed_stiffness
    assert np.linalg.norm(tilt_deflection(stage, 2, load, 30.0)) > 1.005 * np.linalg.norm(closed)
    assert np.isinf(tilt_deflection(stage, 2, load, 0.0)).all()
    unloaded = replace(load, wrench=np.zeros((6, 6)))
    assert not tilt_deflection(stage, 2, unloaded, 0.0).any()


def test_flanges_outside_the_study_tilt_as_they_are():
    robot = open_arm(1, 2)
    load = pressed(robot)
    model = PreloadModel(study(load, robot=robot, joints=(2,), free=("flexspline_flange",)))
    ((joint, stage),) = model.fixed_flanges
    assert joint == 1
    expected = tilt_deflection(stage, 1, load, stage.element.preload)
    assert model.fixed_tilt(load) == pytest.approx(expected)
    assert expected.any()


@pytest.fixture(scope="module")
def tilted_study():
    robot = open_arm(1, 2)
    return study(
        pressed(robot),
        robot=robot,
        joints=(1, 2),
        free=("flexspline_flange",),
        objective="tool_deflection",
    )


def test_programme_and_exact_law_agree_at_the_optimum(tilted_study):
    solution = optimise_preloads(tilted_study)
    model = PreloadModel(tilted_study)
    exact = float(np.linalg.norm(model.exact_deflection(solution.vector)[0]))
    assert solution.objective == pytest.approx(exact, rel=1e-9)
    assert solution.kkt_residual < 1e-8
    # More preload everywhere is no better by more than the tie that takes the least of them.
    for index in range(len(model.elements)):
        for factor in (0.9, 0.97):
            less = solution.vector.copy()
            less[model.slices[index]] *= factor
            assert np.linalg.norm(model.exact_deflection(less)[0]) > exact * (1 - 1e-6)


def test_preload_matters_where_flanges_tilt(tilted_study):
    def change(problem):
        model = PreloadModel(problem)
        found = [
            np.linalg.norm(model.exact_deflection(factor * model.design)[0]) for factor in (0.7, 1)
        ]
        return found[0] / found[1] - 1

    beside = replace(tilted_study, robot=load_robot("er3a_c60"))
    assert change(tilted_study) > 1.5 * change(beside) > 0


def test_requirement_of_deflection_is_kept_with_tilting(tilted_study):
    best = optimise_preloads(tilted_study)
    weakest = PreloadModel(tilted_study).exact_deflection(
        optimise_preloads(replace(tilted_study, objective="total_preload")).vector
    )
    allowed = (best.objective + float(np.linalg.norm(weakest[0]))) / 2
    asked = replace(
        tilted_study,
        objective="total_preload",
        requirements=Requirements(tool_deflection=allowed),
    )
    solution = optimise_preloads(asked)
    row = next(r for r in solution.rows if r.kind == "tool deflection")
    assert row.value == pytest.approx(allowed, rel=1e-6)
    assert row.satisfied


def test_catalogue_counts_tilting(tilted_study):
    wanted = replace(tilted_study, choose=Choice(grades=("12.9",), torques=(4.0, 6.0, 8.0)))
    choice = choose_design(wanted)
    assert choice.status.usable
    exact = PreloadModel(choice.problem).exact_deflection(choice.solution.vector)
    assert choice.objective == pytest.approx(float(np.linalg.norm(exact[0])), rel=1e-9)
    best = optimise_preloads(tilted_study)
    assert choice.proof.bound <= choice.objective * (1 + 1e-9)
    assert choice.objective >= best.objective * (1 - 1e-9)


def test_worst_instant_of_the_tool_is_found_with_tilting():
    robot = open_arm(1, 2)
    rng = np.random.default_rng(3)
    position = ANGLES + 0.3 * rng.normal(size=(30, 6))
    speed, acceleration = rng.normal(size=(2, 30, 6))
    wrench = joint_wrenches(robot, position, speed, acceleration, FORCE)
    frames, arm = joint_frames(robot, position)
    loads = [pose_case(robot, "pose", pose, FORCE) for pose in position]
    history = LoadHistory(
        name="motion",
        time=np.linspace(0, 1, 30),
        torque=wrench[..., 5],
        jacobian=np.array([load.jacobian for load in loads]),
        wrench=wrench,
        frames=frames,
        arm=arm,
    )
    problem = study(robot=robot, joints=(1, 2), free=("flexspline_flange",), histories=(history,))
    preloads = PreloadModel(problem).design
    cases = with_worst_instants(problem, (), preloads)
    every = PreloadModel(problem, [history.at(k) for k in range(30)])
    worst = np.linalg.norm(every.exact_deflection(preloads), axis=1)
    found = PreloadModel(problem, cases).exact_deflection(preloads)
    assert np.nanmax(np.linalg.norm(found, axis=1)) == pytest.approx(worst.max(), rel=1e-9)


@pytest.mark.parametrize(("tilt", "worst"), [(1.0, 3), (-1.0, 2), (0.0, 2)])
def test_worst_instant_of_the_tool_is_that_of_wind_up_and_tilting_together(tilt, worst):
    """Wind-ups of 2, 3 and 1 mm; tilting takes from the first two or adds to them."""
    history = LoadHistory(
        name="swing",
        time=np.arange(4.0),
        torque=np.array([[0.0], [2.0], [3.0], [1.0]]),
        jacobian=np.tile([[1e-3], [0.0], [0.0]], (4, 1, 1)),
    )
    turned = np.outer(tilt * np.array([0.0, -2.0, -3.5, 3.0]), [1e-3, 0.0, 0.0])
    one_joint = SimpleNamespace(
        problem=SimpleNamespace(robot=SimpleNamespace(n=1)),
        exact_windup=lambda preloads, joint, torque: torque,
        tilt_deflection=lambda motion, preloads: turned,
    )
    sizes = PreloadModel.deflection_sizes(one_joint, history, None)
    assert history.at(int(np.argmax(sizes))).time == worst
