"""Study files: what they say, load cases from poses and trajectories, and wrong entries."""

import csv

import numpy as np
import pinocchio as pin
import pytest
from small_arms import ROOT
from small_studies import FLANGE, study_text, write_flanged, write_study

from stiffopt.errors import InputFileError
from stiffopt.fastening.tightening import Tightening
from stiffopt.preload.files import load_study
from stiffopt.preload.load_case import LoadCase
from stiffopt.preload.problem import Choice, PreloadProblem, Requirements
from stiffopt.preload.study import value_units
from stiffopt.result.provenance import inputs_hash
from stiffopt.robot.files import load_robot

# With every key that a study of one flange may have, and an er3a beside it.
COMPLETE = """
schema = 1
kind = "preload"
title = "flexspline flange of J2"
robot = "er3a_c60"
joints = [2]
free = ["flexspline_flange"]
individual = false

[[load_case]]
name = "peak torque"
torque = [0.0, "110 N*m", 0.0, 0.0, 0.0, 0.0]
[[load_case]]
name = "pick and place"
trajectory = "../out/pick_and_place/trajectory.csv"

[tightening]
method = "angle"
scatter = 1.4
thread_friction = 0.1
head_friction = 0.14
embedding = 5e-6

[[minimise]]
objective = "total_preload"
[require]
joint_stiffness = { 2 = "15 N*m/arcmin" }
slip_safety = 1.3
bolt_utilisation = 0.9

[choose]
sizes = ["M4", "M5", "M6"]
grades = ["10.9", "12.9"]
counts = [6, 8, 9, 12]

[expected.values.preload_flexspline_flange]
value = 7.1e3
unit = "N"
rtol = 1e-3
source = "grid search, 4001 points"
"""


def write_trajectory(path, position, spring, **more):
    """trajectory.csv of some joints' positions and spring torques (K, n), with further columns."""
    n = position.shape[1]
    numbered = {f"{q}{j + 1}": a[:, j] for q, a in (("q", position), ("tau_spring", spring))
                for j in range(n)}  # fmt: skip
    columns = {"t": 0.01 * np.arange(len(position)), **numbered, **more}
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        writer.writerows(np.column_stack(list(columns.values())).tolist())
    return path


def test_every_key_arrives(tmp_path):
    torque = np.outer(np.linspace(-1.0, 1.0, 5), np.arange(1.0, 7.0))
    write_trajectory(tmp_path / "out/pick_and_place/trajectory.csv", np.zeros((5, 6)), torque)
    path = tmp_path / "studies" / "study.toml"
    path.parent.mkdir()
    path.write_text(COMPLETE)
    loaded = load_study(path)
    problem = loaded.problem
    assert (problem.title, problem.joints, problem.free) == (
        "flexspline flange of J2",
        (2,),
        ("flexspline_flange",),
    )
    assert problem.tightening == Tightening(
        method="angle", scatter=1.4, thread_friction=0.1, head_friction=0.14, embedding=5e-6
    )
    assert problem.requirements.slip_safety == 1.3
    assert problem.requirements.bolt_utilisation == 0.9
    assert problem.requirements.joint_stiffness == pytest.approx({2: 15 * 60 * 180 / np.pi})
    assert problem.choose == Choice(
        sizes=("M4", "M5", "M6"), grades=("10.9", "12.9"), counts=(6, 8, 9, 12)
    )
    assert problem.load_cases[0].torque == pytest.approx([0, 110, 0, 0, 0, 0])
    assert problem.histories[0].name == "pick and place"
    assert problem.histories[0].torque == pytest.approx(torque)
    assert loaded.expected["preload_flexspline_flange"].value == 7.1e3
    assert (loaded.front_points, loaded.motion) == (15, None)


def test_file_and_python_give_the_same_problem(tmp_path):
    read = load_study(write_study(tmp_path)).problem
    written = PreloadProblem(
        robot=load_robot(tmp_path / "pendulum.toml"),
        joints=(1,),
        load_cases=(LoadCase(name="peak", torque=np.array([60.0])),),
        title="ring",
    )
    assert inputs_hash(read) == inputs_hash(written)
    assert read.requirements == Requirements()


def test_all_joints_with_a_drivetrain_are_the_default(tmp_path):
    text = study_text("torque = [60.0, 10.0]", robot="planar.toml").replace("joints = [1]\n", "")
    assert load_study(write_study(tmp_path, text, arm="planar")).problem.joints == (1, 2)


# ---- poses


def height_of_mass(model, angles):
    return pin.computePotentialEnergy(model, model.createData(), angles)


def tool_of(robot, angles):
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, angles)
    return data.oMi[robot.tool.joint].act(np.asarray(robot.tool.offset))


def differences(function, angles, step=1e-6):
    """Slope of a function of the angles, one column a joint."""
    shifts = step * np.eye(len(angles))
    return np.stack(
        [(function(angles + s) - function(angles - s)) / (2 * step) for s in shifts], -1
    )


POSE = "joints = [-0.4, 0.7]\nforce = [30.0, 0.0, '-80 N']"


def planar_study(folder, load, **pieces):
    return load_study(write_study(folder, arm="planar", load=load, **pieces)).problem


def test_torques_of_a_pose_are_those_of_virtual_work(tmp_path):
    problem = planar_study(tmp_path, POSE)
    angles, force = np.array([-0.4, 0.7]), np.array([30.0, 0.0, -80.0])
    robot = problem.robot
    gravity = differences(lambda q: height_of_mass(robot.model, q), angles)
    jacobian = differences(lambda q: tool_of(robot, q), angles)
    case = problem.load_cases[0]
    assert case.torque == pytest.approx(gravity - force @ jacobian, rel=1e-6)
    assert case.jacobian == pytest.approx(jacobian, abs=1e-8)
    assert case.reference_torque is None
    # The tool pressed down from above loads the shoulder more than gravity alone.
    assert abs(case.torque[0]) > abs(gravity[0])


def test_process_deflection_leaves_gravity_out(tmp_path):
    problem = planar_study(tmp_path, POSE, top='deflection = "process"')
    angles = np.array([-0.4, 0.7])
    gravity = differences(lambda q: height_of_mass(problem.robot.model, q), angles)
    assert problem.load_cases[0].reference_torque == pytest.approx(gravity, rel=1e-6)


def test_pose_by_position_is_that_of_its_joints(tmp_path):
    by_joints = planar_study(tmp_path, POSE).load_cases[0]
    place = tool_of(load_robot(tmp_path / "planar.toml"), np.array([-0.4, 0.7])).tolist()
    load = f"position = {place}\nnear = [-0.3, 0.6]\nforce = [30.0, 0.0, -80.0]"
    by_place = planar_study(tmp_path, load).load_cases[0]
    assert by_place.torque == pytest.approx(by_joints.torque, rel=1e-6)


def test_force_of_the_tool_section_is_the_default(tmp_path):
    own = planar_study(tmp_path, POSE).load_cases[0]
    top = "[tool]\nprocess_force = [30.0, 0.0, -80.0]"
    shared = planar_study(tmp_path, "joints = [-0.4, 0.7]", top=top).load_cases[0]
    assert shared.torque == pytest.approx(own.torque)


def test_payload_loads_a_pose(tmp_path):
    bare = planar_study(tmp_path, "joints = [0.0, 0.0]").load_cases[0]
    top = "[payload]\nmass = '2 kg'\ncom = [0.0, 0.0, 0.0]"
    loaded = planar_study(tmp_path, "joints = [0.0, 0.0]", top=top).load_cases[0]
    arm = np.linalg.norm(tool_of(load_robot(tmp_path / "planar.toml"), np.zeros(2)))
    assert abs(loaded.torque[0] - bare.torque[0]) == pytest.approx(2 * 9.81 * arm, rel=1e-3)


# ---- trajectories


@pytest.fixture
def motion(tmp_path):
    """A motion of the planar arm with 1 kg, its torques by pinocchio; writes trajectory.csv."""
    write_flanged(tmp_path, "planar")
    robot = load_robot(tmp_path / "planar.toml").with_payload(1.0)
    t = 0.01 * np.arange(21)
    q = np.column_stack([-0.6 + np.sin(3 * t), 0.4 - 0.5 * np.sin(5 * t)])
    qd = np.column_stack([3 * np.cos(3 * t), -2.5 * np.cos(5 * t)])
    qdd = np.column_stack([-9 * np.sin(3 * t), 12.5 * np.sin(5 * t)])
    data = robot.model.createData()
    force = np.array([0.0, 0.0, -40.0])
    links = np.array([pin.rnea(robot.model, data, *row) for row in zip(q, qd, qdd, strict=True)])
    rest = np.array([pin.computeGeneralizedGravity(robot.model, data, x) for x in q])
    pushed = np.array([differences(lambda x: tool_of(robot, x), x).T @ force for x in q])
    tool = np.array([tool_of(robot, x) for x in q])
    extra = {f"{name}{j + 1}": a[:, j] for name, a in (("qd", qd), ("qdd", qdd)) for j in (0, 1)}
    extra |= {f"tool_{axis}": tool[:, k] for k, axis in enumerate("xyz")}

    def write(spring=links, **change):
        write_trajectory(tmp_path / "trajectory.csv", q, spring, **(extra | change))
        return tmp_path

    return write, {"links": links, "gravity": rest, "pushed": pushed, "q": q}


DEFLECTION = {"load": 'trajectory = "trajectory.csv"', "minimise": 'objective = "tool_deflection"'}
KILOGRAM = "[payload]\nmass = 1.0\n"


def dynamic_study(folder, top="", deflection="dynamic", **pieces):
    head = f'deflection = "{deflection}"\n{top}'
    return planar_study(folder, **(DEFLECTION | {"top": head} | pieces))


def test_dynamic_deflection_of_a_trajectory_leaves_gravity_out(motion):
    write, truth = motion
    history = dynamic_study(write(), KILOGRAM).histories[0]
    assert history.torque == pytest.approx(truth["links"])
    assert history.reference_torque == pytest.approx(truth["gravity"])
    assert history.jacobian.shape == (21, 3, 2)
    assert history.source == "trajectory trajectory.csv"


def test_process_deflection_of_a_trajectory_leaves_the_motion_out(motion):
    write, truth = motion
    folder = write(truth["links"] - truth["pushed"])
    top = KILOGRAM + "[tool]\nprocess_force = [0.0, 0.0, '-40 N']"
    history = dynamic_study(folder, top, "process").histories[0]
    assert history.reference_torque == pytest.approx(truth["links"], rel=1e-6, abs=1e-6)


def test_torques_alone_need_neither_tool_nor_payload(motion):
    write, _ = motion
    folder = write(tool_x=np.zeros(21))
    history = planar_study(folder, DEFLECTION["load"]).histories[0]
    assert history.jacobian is None


@pytest.mark.parametrize(
    ("change", "study", "parts"),
    [
        ({"tool_x": np.zeros(21)}, {"top": KILOGRAM}, ["tool_x", "mm away", "[tool]"]),
        ({}, {}, ["tau_spring", "[payload]", "tool.process_force"]),
        ({"q1": np.full(21, np.nan)}, {}, ["row 1, q1", "finite number"]),
        ({"t": np.zeros(21)}, {}, ["row 2, t", "must increase"]),
        ({"tau_spring3": np.zeros(21)}, {}, ["tau_spring3", "more joints than the robot, 2"]),
        ({}, {"deflection": "process", "top": KILOGRAM}, ["load_case[peak]", "process_force"]),
        (
            {},
            {"top": KILOGRAM + "[tool]\nprocess_force = [1.0, 0.0, 0.0]"},
            ["load_case[peak]", "'total' or 'process'"],
        ),
    ],
)
def test_trajectory_that_does_not_fit(motion, change, study, parts):
    write, _ = motion
    folder = write(**change)
    with pytest.raises(InputFileError) as error:
        dynamic_study(folder, **study)
    for part in parts:
        assert part in str(error.value)


# ---- wrong entries

LOADS = {
    "none": ("", ["load_case[peak]", "give one of `torque`"]),
    "two": ("torque = [1.0]\ntrajectory = 'a.csv'", ["`torque` and `trajectory`"]),
    "negative": ("torque = [-60.0]", ["load_case[peak].torque[1]", "-60", "magnitude"]),
    "not finite": ("torque = [nan]", ["load_case[peak].torque", "finite"]),
    "too many": ("torque = [1.0, 2.0]", ["load_case[peak].torque", "1 values", "got 2"]),
    "wrong unit": ("torque = ['60 N']", ["load_case[peak].torque[1]", "needs torque, got force"]),
    "no such file": ("trajectory = 'trajectry.csv'", ["trajectry.csv", "no such file"]),
    "no table": ("trajectory = 'pendulum.urdf'", ["at least two rows", "tau_spring1"]),
    "force on torques": ("torque = [1.0]\nforce = [1.0, 0.0, 0.0]", ["`force` needs a pose"]),
    "near joints": ("joints = [0.0]\nnear = [0.0]", ["`near` needs a `position`"]),
    "out of range": ("joints = ['200 deg']", ["load_case[peak].joints[1]", "range of joint 1"]),
    "out of reach": ("position = [3.0, 0.0, 0.0]", ["load_case[peak]", "reach"]),
    "unknown key": ("torqe = [1.0]", ["load_case[peak].torqe", "Did you mean 'torque'?"]),
}

PIECES = {
    "unknown element": (
        {"top": 'free = ["rng"]'},
        ["free", "'rng'", "Did you mean 'ring'?"],
    ),
    "unknown size": (
        {"more": '[choose]\nsizes = ["M55"]'},
        ["choose.sizes", "'M55'", "Did you mean 'M5'?"],
    ),
    "unknown grade": ({"more": '[choose]\ngrades = ["12.8"]'}, ["choose.grades", "12.9"]),
    "no bolts": ({"more": "[choose]\ncounts = [0]"}, ["choose", "counts"]),
    "unknown method": (
        {"more": '[tightening]\nmethod = "torque_rench"'},
        ["tightening.method", "Did you mean 'torque_wrench'?"],
    ),
    "no friction": (
        {"more": "[tightening]\nthread_friction = 0.0"},
        ["tightening.thread_friction", "thread_friction = 0", "validity range 0 to 1"],
    ),
    "scatter below 1": ({"more": "[tightening]\nscatter = 0.9"}, ["tightening", "scatter = 0.9"]),
    "two objectives": (
        {"minimise": 'objective = "total_preload"\n[[minimise]]\nobjective = "joint_stiffness"'},
        ["one [[minimise]]", "[require]"],
    ),
    "unknown objective": (
        {"minimise": 'objective = "total_preloads"'},
        ["minimise[1].objective", "Did you mean 'total_preload'?"],
    ),
    "no such joint": ({"require": "joint_stiffness = { 2 = 1e4 }"}, ["joint_stiffness", "joint 2"]),
    "slip safety below 1": (
        {"require": "slip_safety = 0.9"},
        ["require.slip_safety", "1 or above"],
    ),
    "deflection of torques": (
        {"minimise": 'objective = "tool_deflection"'},
        ["load_case", "no load case gives the tool a total deflection", "trajectory or a pose"],
    ),
    "dynamic deflection at rest": (
        {
            "minimise": 'objective = "tool_deflection"',
            "load": "joints = [0.1]",
            "top": 'deflection = "dynamic"',
        },
        ["load_case", "at rest there is no dynamic deflection"],
    ),
    "process deflection without force": (
        {
            "require": 'tool_deflection = "1 mm"',
            "load": "joints = [0.1]",
            "top": 'deflection = "process"',
        },
        ["load_case", "`force`"],
    ),
    "unknown value": (
        {"more": '[expected.values.preload_rng]\nvalue = 1.0\nunit = "N"\nsource = "exact"'},
        ["expected.values.preload_rng", "Did you mean 'preload_ring'?"],
    ),
    "unit of a value": (
        {"more": '[expected.values.preload_ring]\nvalue = 1.0\nunit = "m"\nsource = "exact"'},
        ["expected.values.preload_ring.unit", "cannot be converted"],
    ),
    "motion of another robot": (
        {"more": f'[motion]\nproblem = "{ROOT}/problems/two_link.toml"'},
        ["motion.problem", "two_link", "same robot"],
    ),
}


def assert_refused(path, parts):
    with pytest.raises(InputFileError) as error:
        load_study(path)
    for part in parts:
        assert part in str(error.value)
    assert "pydantic" not in str(error.value)


@pytest.mark.parametrize("name", LOADS)
def test_wrong_load_case(name, tmp_path):
    load, parts = LOADS[name]
    assert_refused(write_study(tmp_path, load=load), parts)


@pytest.mark.parametrize("name", PIECES)
def test_wrong_piece(name, tmp_path):
    pieces, parts = PIECES[name]
    assert_refused(write_study(tmp_path, **pieces), parts)


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("7.5 kN", "14 kN", ["robot, joint 1", "14 kN", "largest assembly preload", "M5 12.9"]),
        ('"M5"', '"M55"', ["'M55'", "Did you mean 'M5'?"]),
        (
            'bolt = {{ size = "M5", grade = "12.9", count = 9, circle_diameter = "30 mm" }}',
            "",
            ["bolt"],
        ),
    ],
)
def test_wrong_robot(old, new, parts, tmp_path):
    path = write_study(tmp_path)
    write_flanged(tmp_path, flange=FLANGE.replace(old, new))
    assert_refused(path, parts)


def test_values_are_named_before_anything_is_solved(tmp_path):
    problem = load_study(write_study(tmp_path, top="individual = true")).problem
    units = value_units(problem)
    assert units["preload_ring"] == units["preload_ring_9"] == "N"
    assert units["stiffness_joint_1"] == "N m/rad"
    assert "preload_ring_10" not in units
    assert "tool_deflection" not in units
