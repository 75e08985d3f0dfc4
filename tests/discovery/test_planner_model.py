"""What a diagnosis found, in the robot that a planner computes with."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from stiffopt.cli import run as command
from stiffopt.discovery.catalogue import CATALOGUE
from stiffopt.discovery.catalogue.robot_change import ADDED_SPRING_NAME
from stiffopt.discovery.comparison.located_effect import EstimatedEffect, Extension, LocatedEffect
from stiffopt.discovery.extended.model import ExtendedModel, load_extended, robot_signature
from stiffopt.discovery.extended.planning import joint_constants, planner_model
from stiffopt.discovery.names import ValueName
from stiffopt.elastic.uncertainty import Uncertainty, bounds_from_deviations
from stiffopt.errors import InputFileError
from stiffopt.exact.chain import exact_windup, windup_shares
from stiffopt.robot.files import load_robot
from stiffopt.robot.robot import Robot

PROBLEMS = Path(__file__).resolve().parents[2] / "problems"
HEAD = """
schema = 1
kind = "extended"
name = "arm"
joints = [{names}]
links = [{names}]
[nominal]
contact_stiffness = [{stiff}]
[scales]
torque_rated = [{rated}]
torque_max = [{most}]
fastest = [{fast}]
"""


@pytest.fixture(scope="module")
def arm() -> Robot:
    return load_robot("er3a_c60_contact")


def extended(folder: Path, names: tuple[str, ...], torque_max: np.ndarray) -> ExtendedModel:
    """An extended model of an arm, without anything found."""

    def listed(values: object) -> str:
        return ", ".join(f"{float(v)}" for v in np.asarray(values))

    path = folder / "extended.toml"
    path.write_text(
        HEAD.format(
            names=", ".join(f'"{n}"' for n in names),
            stiff=listed(np.full(len(names), 2e4)),
            rated=listed(torque_max / 3.0),
            most=listed(torque_max),
            fast=listed(np.full(len(names), 2.0)),
        )
    )
    return load_extended(path)


def found(
    model: ExtendedModel,
    name: str,
    amplitudes: tuple[float, ...],
    shapes: tuple[float, ...] = (),
    **place: Any,
) -> ExtendedModel:
    effect = next(e for e in CATALOGUE if e.name == name)
    located = LocatedEffect(effect=effect, shapes=shapes, **place)
    estimated = EstimatedEffect(located=located, amplitudes=amplitudes)
    effects = (*model.extension.effects, estimated)
    return replace(model, extension=Extension(effects=effects))


@pytest.fixture(scope="module")
def model(arm: Robot, tmp_path_factory: pytest.TempPathFactory) -> ExtendedModel:
    return extended(tmp_path_factory.mktemp("model"), arm.joint_names, arm.torque_max)


def test_friction_and_rotor_inertia_are_added_to_the_robots_own(
    arm: Robot, model: ExtendedModel
) -> None:
    own = found(model, "coulomb", (1.3,), joint=1)
    own = found(own, "viscous", (0.7,), joint=1)
    own = found(own, "rotor_inertia", (0.02,), joint=4)
    changed = planner_model(arm, own)
    assert changed.robot.coulomb - arm.coulomb == pytest.approx([0, 1.3, 0, 0, 0, 0])
    assert changed.robot.viscous - arm.viscous == pytest.approx([0, 0.7, 0, 0, 0, 0])
    assert changed.robot.rotor_inertia[4] == pytest.approx(arm.rotor_inertia[4] + 0.02)
    assert changed.left_out == ()
    assert len(changed.changes) == 3


def test_calibrated_values_scale_the_robots_own(arm: Robot, model: ExtendedModel) -> None:
    calibrated = replace(
        model,
        extension=Extension(calibration={ValueName("coulomb", 2): 0.1, ValueName("mass", 1): 0.01}),
    )
    changed = planner_model(arm, calibrated)
    assert changed.robot.coulomb / arm.coulomb == pytest.approx([1, 1, 1.1, 1, 1, 1])
    assert changed.robot.model.inertias[2].mass == arm.model.inertias[2].mass


def test_payload_equals_found_body(arm: Robot, model: ExtendedModel) -> None:
    # A point mass in the frame of the last joint.
    mass, centre = 0.8, np.array([0.02, -0.01, 0.05])
    point = pin.Inertia(mass, centre, np.zeros((3, 3))).toDynamicParameters()
    changed = planner_model(arm, found(model, "payload", tuple(point))).robot
    expected = arm.model.copy()
    expected.appendBodyToJoint(
        arm.n, pin.Inertia(mass, centre, np.zeros((3, 3))), pin.SE3.Identity()
    )
    q, v, a = (np.linspace(low, 1.0, arm.n) for low in (-0.8, 0.3, -2.0))
    torque = pin.rnea(changed.model, changed.model.createData(), q, v, a)
    assert torque == pytest.approx(pin.rnea(expected, expected.createData(), q, v, a), rel=1e-9)


def test_standard_deviations_of_stiffness_bound_the_joint_in_planning(
    arm: Robot, tmp_path: Path
) -> None:
    own = extended(tmp_path, arm.joint_names, arm.torque_max)
    text = (tmp_path / "extended.toml").read_text()
    (tmp_path / "extended.toml").write_text(
        text
        + """
[[effect]]
name = "stiffness_linear"
joint = 3
[effect.term]
x = 0.25
[effect.parameters]
factor = { value = 0.8, sd = 0.02 }
"""
    )
    planner = planner_model(arm, load_extended(tmp_path / "extended.toml"))
    deviation = planner.stiffness_deviation
    assert deviation[2] == pytest.approx(0.025)
    assert np.isnan(np.delete(deviation, 2)).all()
    shares = bounds_from_deviations(Uncertainty(), deviation).shares(arm.n)
    assert shares == pytest.approx([0.2, 0.2, 0.025 * np.sqrt(3.0), 0.2, 0.2, 0.2])
    assert np.isnan(planner_model(arm, own).stiffness_deviation).all()
    assert np.isnan(planner.payload_deviation)


def test_the_standard_deviation_of_a_payload_bounds_it_in_planning(
    arm: Robot, model: ExtendedModel
) -> None:
    heavier = replace(
        found(model, "payload", (0.5, *np.zeros(9))),
        parameters=({"dm": 0.5},),
        deviations=({"dm": 0.05},),
    )
    carrying = arm.with_payload(2.0, [0.0, 0.0, 0.05], [0.01, 0.01, 0.01])
    planner = planner_model(carrying, heavier)
    # What was found is of the last link: the 2 kg of the payload vary by as many kilograms.
    assert planner.payload_deviation == pytest.approx(0.025)
    varied = planner.robot.with_payload_times(1.0 + planner.payload_deviation)
    added = varied.model.inertias[6].mass - planner.robot.model.inertias[6].mass
    assert added == pytest.approx(0.05)
    unsure = bounds_from_deviations(
        Uncertainty(), planner.stiffness_deviation, planner.payload_deviation
    )
    assert unsure.payload == pytest.approx(0.025 * np.sqrt(3.0))
    assert np.isnan(planner_model(carrying, model).payload_deviation)


def test_softer_joint_winds_up_by_the_factor(arm: Robot, model: ExtendedModel) -> None:
    changed = planner_model(arm, found(model, "stiffness_linear", (0.5,), joint=2)).robot
    before, after = arm.chains[2], changed.chains[2]
    assert before is not None
    assert after is not None
    rated = arm.torque_max[2] / 3.0
    torques = np.linspace(0.05, 1.0, 20) * rated
    ratio = np.mean(exact_windup(after, torques)) / np.mean(exact_windup(before, torques))
    assert ratio == pytest.approx(1.5, rel=1e-6)
    assert changed.chains[1] is arm.chains[1]


def test_found_preload_loss_reduces_preload(arm: Robot, model: ExtendedModel) -> None:
    """A wind-up made by loosening a flange leads back to that preload."""
    chain = arm.chains[2]
    assert chain is not None
    rated = arm.torque_max[2] / 3.0
    bolted = [s.element for s in chain.stages if s.element.kind == "bolted_flange"]
    shares = windup_shares(chain, rated)
    weakest = max(bolted, key=lambda e: shares[e.name])
    torques = np.linspace(0.05, 1.0, 20) * rated
    loose = chain.with_preloads({weakest.name: 0.8 * float(weakest.preload or 0.0)})
    added = exact_windup(loose, torques) - exact_windup(chain, torques)
    shapes = (0.05, 0.5)
    one = (torques / rated + shapes[0]) ** shapes[1] - shapes[0] ** shapes[1]
    size = rated * (1.0 / joint_constants(model, 2, None).contact_stiffness)
    amplitude = float(np.mean(added) / (size * np.mean(one)))
    changed = planner_model(arm, found(model, "preload_loss", (amplitude,), shapes, joint=2))
    after = changed.robot.chains[2]
    assert after is not None
    assert after.elements[weakest.name].preload == pytest.approx(
        0.8 * float(weakest.preload or 0.0), rel=1e-3
    )
    assert ADDED_SPRING_NAME not in after.elements
    assert "80 %" in changed.changes[0]


def test_excess_compliance_becomes_spring(arm: Robot, model: ExtendedModel) -> None:
    changed = planner_model(arm, found(model, "preload_loss", (3.0,), (0.05, 0.5), joint=2))
    before, after = arm.chains[2], changed.robot.chains[2]
    assert before is not None
    assert after is not None
    rated = arm.torque_max[2] / 3.0
    share = np.linspace(0.05, 1.0, 20)
    wanted = 3.0 * rated / 2e4 * ((share + 0.05) ** 0.5 - 0.05**0.5)
    added = exact_windup(after, share * rated) - exact_windup(before, share * rated)
    assert np.mean(added) == pytest.approx(np.mean(wanted), rel=1e-6)
    assert ADDED_SPRING_NAME in after.elements
    # What is left must still hold everything that the drive can give.
    assert min(after.slip_torques().values()) > arm.torque_max[2]


def test_settled_belt_is_a_spring_in_series(arm: Robot, model: ExtendedModel) -> None:
    changed = planner_model(arm, found(model, "belt_creep", (1e-5, 2e-5), (0.1,), joint=0))
    before, after = arm.chains[0], changed.robot.chains[0]
    assert before is not None
    assert after is not None
    torque = np.array([5.0, 12.0])
    assert exact_windup(after, torque) - exact_windup(before, torque) == pytest.approx(
        3e-5 * torque, rel=1e-6
    )


def test_model_of_another_robot_is_refused(arm: Robot, tmp_path) -> None:
    """A UR10's and an ER3A's joints are as many."""
    ur10 = load_robot("ur10")
    names = tuple(f"j{k}" for k in range(1, 7))
    other = extended(tmp_path, names, ur10.torque_max)
    with pytest.raises(
        InputFileError, match=r"this model is of j1, .*er3a_c60_contact has joint_1"
    ):
        planner_model(arm, other)
    stated = replace(other, joints=arm.joint_names, robot=robot_signature(ur10, range(6)))
    with pytest.raises(InputFileError, match=r"made for the robot ur10 .*not for er3a_c60_contact"):
        planner_model(arm, stated)
    own = replace(other, robot=robot_signature(arm.with_payload(1.0), range(6)))
    assert planner_model(arm, own).robot.n == 6


def test_unchanged_masses_are_not_listed(arm: Robot, model: ExtendedModel) -> None:
    moved = found(model, "inertial_error", (0.0, 0.01, 0.0, 0.0, *[0.0] * 6), link=4)
    (sentence,) = planner_model(arm, moved).changes
    assert "kg as before, centre from (0, 1, 0) to (18, 1, 0) mm" in sentence
    heavier = found(model, "inertial_error", (0.5, 0.01, 0.0, 0.0, *[0.0] * 6), link=4)
    (sentence,) = planner_model(arm, heavier).changes
    before, after = re.search(r"([0-9.]+) to ([0-9.]+) kg", sentence).groups()
    assert float(after) - float(before) == pytest.approx(0.5, abs=1e-3)


def test_effects_without_influence_are_listed(arm: Robot, model: ExtendedModel) -> None:
    changed = planner_model(arm, found(model, "torque_offset", (0.5,), joint=1))
    assert changed.left_out == ("torque_offset of joint 2",)
    assert changed.changes == ()
    assert np.array_equal(changed.robot.coulomb, arm.coulomb)


def test_model_of_another_arm_is_an_error(arm: Robot, tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="joints: this model is of a, b"):
        planner_model(arm, extended(tmp_path, ("a", "b"), np.array([10.0, 10.0])))


def test_solve_with_a_model_shows_the_change(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One command: planned without and with what was found, and the change in deflection."""
    model = extended(tmp_path, ("joint_1", "joint_2"), np.array([120.0, 60.0]))
    text = Path(model.source).read_text() + (
        '[[effect]]\nname = "belt_creep"\njoint = 1\n'
        "[effect.term]\nC_now = 1e-4\nC_creep = 0.0\ntau_r = 0.1\n"
    )
    Path(model.source).write_text(text)
    problem = str(PROBLEMS / "two_link.toml")
    out = tmp_path / "out"
    assert command(["solve", problem, "--model", model.source, "--out", str(out), "--quiet"]) == 0
    result = json.loads((out / "result.json").read_text())
    said = [note for note in result["notes"] if note.startswith("Peak total deflection")]
    assert len(said) == 1
    assert "in series" in "".join(result["notes"])
    assert said[0] in capsys.readouterr().out
    assert "Peak total deflection" in (out / "report.html").read_text()
    promised, true, best = (float(x.split()[-1]) for x in said[0].split(" mm")[:3])
    assert true > promised
    own = result["certificate"]["deflection"]["total"]["peak"]
    assert best == pytest.approx(1e3 * own, rel=1e-3)


def test_planning_uses_re_identified_bodies(arm: Robot, tmp_path: Path) -> None:
    """Half a kilogram more in link 2, a centimetre further out: weight as the regressor has it."""
    model = extended(tmp_path, arm.joint_names, arm.torque_max)
    body = arm.tree.bodies[1]
    change = {ValueName("body", 1, "m"): 0.5, ValueName("body", 1, "mx"): 0.01 * body.mass}
    known = replace(model, extension=Extension(calibration=change))
    changed = planner_model(arm, known)
    moved = changed.robot.tree.bodies[1]
    assert moved.mass == pytest.approx(body.mass + 0.5)
    assert moved.mass * moved.centre[0] == pytest.approx(body.mass * (body.centre[0] + 0.01))
    assert any("re-identified" in sentence for sentence in changed.changes)
