"""Studies of flanges that carry all six components, and of what the robot has at present."""

from dataclasses import replace

import numpy as np
import pytest
from preload_studies import TESTED, case, study, with_elements
from small_studies import write_study

from stiffopt import load_robot
from stiffopt.certificate.rigid_body import rigid_body_history
from stiffopt.connection import FlangeRing
from stiffopt.drivetrain import catalogue
from stiffopt.errors import InputFileError
from stiffopt.fastening.flange_load import FlangeLoads
from stiffopt.fastening.tightening import Tightening, preload_at_torque
from stiffopt.fastening.tilting import tilting_flange
from stiffopt.fastening.verification import Verification
from stiffopt.preload.bolt_sheet import bolt_sheets
from stiffopt.preload.catalogue_choice import choose_design
from stiffopt.preload.files import load_study
from stiffopt.preload.flange_loads import flange_values
from stiffopt.preload.load_case import LoadCase, LoadHistory
from stiffopt.preload.load_sources import pose_case
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.optimise import optimise_preloads
from stiffopt.preload.problem import Choice, PreloadProblem
from stiffopt.result.status import SolveStatus
from stiffopt.robot.joint_load import joint_wrenches, shift_wrench

ROBOT = load_robot("er3a_c60").with_payload(3.0, (0.0, 0.0, 0.1))
RNG = np.random.default_rng(7)
MOTION = tuple(RNG.normal(size=(40, 6)) for _ in range(3))
FORCE = np.array([20.0, -10.0, 60.0])


def open_flange(joint=2, **changes):
    """The arm with a flexspline flange that has no bearing beside it."""
    return with_elements(joint, flexspline_flange={"bearing": "none"} | changes)


# ---- the joint's load


def test_torque_is_one_of_six_components():
    wrench = joint_wrenches(ROBOT, *MOTION, FORCE)
    body = rigid_body_history(ROBOT, *MOTION)
    torque = body.link_torque - np.einsum("kin,i->kn", body.jacobian, FORCE)
    assert wrench[:, :, 5] == pytest.approx(torque, abs=1e-10)


def test_first_joint_bears_weight_and_tool_force():
    rest = np.zeros((1, 6))
    bodies = ROBOT.tree.bodies
    weight = 9.81 * sum(body.mass for body in bodies)
    wrench = joint_wrenches(ROBOT, rest, rest, rest, np.zeros(3))[0, 0]
    # Standing upright: all weight along the axis, nothing across.
    assert wrench[2] == pytest.approx(weight, rel=1e-12)
    assert wrench[:2] == pytest.approx([0.0, 0.0], abs=1e-9)
    pulled = joint_wrenches(ROBOT, rest, rest, rest, np.array([0, 0, 50.0]))[0, 0]
    assert pulled[2] == pytest.approx(weight - 50.0)
    pose = ROBOT.rigid_bodies().pose(ROBOT.tool, rest[0])[0]
    centre = ROBOT.rigid_bodies().pose(replace(ROBOT.tool, joint=1, offset=np.zeros(3)), rest[0])[0]
    # 50 N up at the tool take off 50 N times its distance from the axis.
    moment = np.hypot(*(wrench - pulled)[3:5])
    assert moment == pytest.approx(50.0 * np.hypot(*(pose - centre)[:2]), rel=1e-9)


def test_moving_the_face_moves_the_moment():
    wrench = np.array([3.0, -2.0, 10.0, 1.0, 4.0, 7.0])
    lever = np.array([0.0, 0.0, 0.05])
    moved = shift_wrench(wrench, 0.05)
    assert moved[:3] == pytest.approx(wrench[:3])
    assert moved[3:] == pytest.approx(wrench[3:] - np.cross(lever, wrench[:3]))
    assert np.array_equal(shift_wrench(wrench, 0.0), wrench)


# ---- in a study


def test_a_pose_tilts_the_flange():
    robot = open_flange(2)
    angles = np.array([0.3, 0.4, 0.5, -0.3, 0.6, 0.2])
    load = pose_case(robot, "press", angles, np.array([0.0, 200.0, 0.0]))
    problem = study(load, robot=robot, free=("flexspline_flange",))
    model = PreloadModel(problem)
    (steps,) = model.verifications
    assert float(steps.loads.tilting[0]) == pytest.approx(np.hypot(*load.wrench[1, 3:5]))
    solution = optimise_preloads(problem)
    kinds = {row.kind: row for row in solution.rows}
    for kind in ("slip under the whole load", "one-sided opening", "alternating stress"):
        assert kinds[kind].utilisation > 0.0
        assert kinds[kind].equation
    assert solution.vector[0] >= steps.least_preload * (1 - 1e-9)
    # With a bearing beside it the same pose asks for less.
    beside = open_flange(2, bearing="beside")
    alone = optimise_preloads(replace(problem, robot=beside))
    assert "one-sided opening" not in {row.kind for row in alone.rows}
    (freed,) = PreloadModel(replace(problem, robot=beside)).verifications
    assert freed.least_preload < steps.least_preload


def test_sheet_of_a_tilted_flange():
    wrench = np.zeros((6, 6))
    wrench[1] = [0, 0, 0, 30.0, 0, 20.0]
    load = LoadCase(name="tilt", torque=wrench[:, 5], wrench=wrench)
    model = PreloadModel(study(load, robot=open_flange(2), free=("flexspline_flange",)))
    (element,), preload = model.elements, np.array([9e3])
    (sheet,) = bolt_sheets(model, preload)
    assert sheet.in_service == pytest.approx(9e3 / 1.6 - element.loss)
    tilting = tilting_flange(element.stage.element, sheet.in_service)
    assert sheet.tilt == pytest.approx(tilting.rotation(30.0))
    assert 30.0 < sheet.opening_moment == pytest.approx(tilting.opening_moment)
    # What is not tight holds nothing.
    (loose,) = bolt_sheets(model, np.array([300.0]))
    assert (loose.tilting_stiffness, loose.tilt) == (0.0, np.inf)


def test_a_sheet_of_a_flange_that_bends_is_in_balance():
    wrench = np.zeros((6, 6))
    wrench[1] = [40.0, 0, 200.0, 30.0, -12.0, 20.0]
    load = LoadCase(name="tilt", torque=wrench[:, 5], wrench=wrench)
    thin = {"ring": FlangeRing(thickness=4e-3, supports=4)}
    sheets = []
    for changes in ({}, thin):
        robot = open_flange(2, **changes)
        model = PreloadModel(study(load, robot=robot, free=("flexspline_flange",)))
        (sheet,) = bolt_sheets(model, np.array([9e3]))
        radius = sheet.flange.circle_diameter / 2
        assert sheet.axial.sum() == pytest.approx(200.0)
        assert radius * sheet.axial @ np.sin(sheet.angles) == pytest.approx(30.0)
        assert radius * sheet.axial @ np.cos(sheet.angles) == pytest.approx(12.0)
        sheets.append(sheet)
    rigid, bent = sheets
    assert bent.axial.max() > 1.005 * rigid.axial.max()
    assert bent.working_load >= bent.axial.max() * (1 - 1e-3)
    assert bent.clamp_needed > rigid.clamp_needed


def test_a_load_too_large_names_the_step_that_stops_it():
    wrench = np.zeros((6, 6))
    wrench[1] = [0, 0, 0, 900.0, 0, 10.0]
    load = LoadCase(name="tilt", torque=np.array([0, 10.0, 0, 0, 0, 0]), wrench=wrench)
    solution = optimise_preloads(
        study(load, robot=open_flange(2), free=("flexspline_flange",)), throw=False
    )
    assert solution.status is SolveStatus.INFEASIBLE
    assert "opening, flexspline_flange, tilt" in solution.message
    assert "a larger circle" in solution.message


def test_the_motion_brings_its_worst_instants():
    robot = open_flange(2)
    wrench = 0.3 * joint_wrenches(robot, *MOTION, FORCE)
    history = LoadHistory(
        name="motion", time=np.arange(40.0), torque=wrench[:, :, 5], wrench=wrench
    )
    needs = {"slip_safety": None}
    problem = PreloadProblem(
        robot=robot,
        joints=(2,),
        histories=(history,),
        free=("flexspline_flange",),
        tightening=TESTED,
        requirements=replace(study().requirements, **needs),
    )
    solution = optimise_preloads(problem)
    (element,) = problem.elements
    whole = Verification(
        element.stage.element,
        TESTED,
        FlangeLoads(
            names=("",) * 40,
            values=flange_values(element.stage, 2, history.torque, wrench),
            alternating=True,
        ),
    )
    # The torque turns back, so 1.8; and no instant that is left out asks for more.
    assert whole.slip_safety == 1.8
    assert solution.vector[0] >= whole.least_preload * (1 - 1e-9)
    (steps,) = PreloadModel(problem, solution.cases).verifications
    assert steps.slip_safety == 1.8
    assert steps.alternating_force == pytest.approx(whole.alternating_force, rel=1e-12)
    assert steps.additional == pytest.approx(whole.additional, rel=1e-12)
    assert len(solution.cases) < 12


def test_loads_by_hand(tmp_path):
    load = 'torque = [20.0]\naxial_force = ["300 N"]\ntilting_moment = [15.0]\nreversing = true'
    path = write_study(tmp_path, load=load)
    text = (tmp_path / "pendulum.toml").read_text().replace('bearing = "beside"\n', "")
    (tmp_path / "pendulum.toml").write_text(text)
    problem = load_study(path).problem
    (one,) = problem.load_cases
    assert one.wrench[0] == pytest.approx([0, 0, 300.0, 15.0, 0, 20.0])
    (steps,) = PreloadModel(problem).verifications
    assert steps.slip_safety == 1.8
    assert float(steps.opening.max()) == pytest.approx(300 / 9 + 4 * 15 / (9 * 30e-3), rel=1e-4)
    for wrong, text in (
        ("torque = [20.0]\naxial_force = [1.0, 2.0]", "one number of 0 or above a joint"),
        ("torque = [20.0]\ntilting_moment = [-1.0]", "magnitudes"),
        ("joints = [0.0]\naxial_force = [1.0]", "`axial_force` needs a `torque` beside it"),
    ):
        with pytest.raises(InputFileError, match=text):
            load_study(write_study(tmp_path, load=wrong))


# ---- shipped flanges and present preloads


@pytest.mark.parametrize(
    ("tightening", "too_weak"),
    [
        (Tightening(), ["1.flex", "2.circ", "2.flex", "3.flex", "4.flex", "5.flex"]),
        (Tightening(method="torque_wrench_tested"), ["1.flex"]),
        (Tightening(method="angle"), []),
    ],
)
def test_flanges_that_hold_the_peak_torques_by_the_defaults(tightening, too_weak):
    robot = load_robot("er3a_c60")
    problem = PreloadProblem(
        robot=robot,
        joints=(1, 2, 3, 4, 5, 6),
        load_cases=(LoadCase(name="peak", torque=robot.torque_max),),
        tightening=tightening,
        free=("circular_spline_flange", "flexspline_flange"),
    )
    model = PreloadModel(problem)
    found = [
        e.key.removeprefix("joint_")[:6]
        for e, steps in zip(model.elements, model.verifications, strict=True)
        if e.largest(float(steps.clamp_needed.max())) > min(e.capacity, steps.largest_preload)
    ]
    assert found == too_weak


def test_net_preload_is_not_diminished_again():
    robot = load_robot("er3a_c60")
    problem = PreloadProblem(
        robot=robot,
        joints=(2,),
        load_cases=(case(j2=110.0),),
        free=("flexspline_flange",),
        tightening=TESTED,
    )
    model = PreloadModel(problem)
    (element,) = model.elements
    assert element.least(model.design[0]) == pytest.approx(7800.0)
    slip = next(r for r in optimise_preloads(problem).rows_before if r.kind == "slip safety")
    lever = 2 / 3 * (20e-3**3 - 10e-3**3) / (20e-3**2 - 10e-3**2)
    assert slip.value == pytest.approx(0.15 * 9 * 7800.0 * lever / 110.0)
    # The bolt is as tight as the maker's 9 N m leave it, not 1.6 times the net preload.
    rows = {r.kind: r for r in optimise_preloads(problem).rows_before}
    largest = preload_at_torque(catalogue.bolt("M5"), 9.0, 0.12, 0.12)
    limit = next(lim for lim in element.limits if lim.name == "bolt utilisation")
    assert rows["bolt utilisation"].value == pytest.approx(largest / limit.capacity)
    assert rows["bolt utilisation"].value < 1.0


def test_purchased_pattern_is_fixed_unless_redrilled():
    robot = load_robot("er3a_c60")
    problem = PreloadProblem(
        robot=robot,
        joints=(2,),
        load_cases=(case(j2=60.0),),
        free=("flexspline_flange",),
        tightening=TESTED,
        choose=Choice(sizes=("M4", "M5", "M6"), counts=(8, 9), grades=("10.9", "12.9")),
    )
    found = choose_design(problem)
    assert {(r.design.size, r.design.count) for r in found.table} == {("M5", 9)}
    assert {r.design.grade for r in found.table} == {"10.9", "12.9"}
    told = choose_design(replace(problem, choose=replace(problem.choose, redrill=True)))
    assert len({(r.design.size, r.design.count) for r in told.table}) == 6
