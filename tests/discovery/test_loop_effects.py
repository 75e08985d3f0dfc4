"""Findings in the simulation from commands."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy import special
from servo_sets import ARMATURE, COULOMB, DELAY, KP, VISCOUS, state_drive, write_servo_set

from stiffopt.closed_loop.arm import CommandedArm
from stiffopt.closed_loop.least_squares import Polished
from stiffopt.closed_loop.simulation import simulate
from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.located_effect import (
    EstimatedEffect,
    Extension,
    LocatedEffect,
)
from stiffopt.discovery.conclusions import _null_share, findings_with_loop_values
from stiffopt.discovery.diagnosis import Finding, Parameter, Rival
from stiffopt.discovery.effect import Term, Values
from stiffopt.discovery.extended.model import ExtendedModel
from stiffopt.discovery.extended.value_changes import extended_model
from stiffopt.discovery.laws.law import Factor, Law, law_effect
from stiffopt.discovery.laws.sources import LawSource
from stiffopt.discovery.loop_effects import _FLANK_DAMPING, _FLANK_FREQUENCY, robot_in_loop
from stiffopt.discovery.loop_fit import (
    build_loop,
    commanded_run,
    expect_parameters,
    nominal_parameters,
)
from stiffopt.discovery.position_fit import ClosedLoopModel
from stiffopt.discovery.sanity.actuator_estimate import ResolvedActuator, resolve_actuator
from stiffopt.discovery.settings import DEFAULT_TOLERANCE, Settings
from stiffopt.discovery.signals import RobotConstants
from stiffopt.discovery.training import open_training_runs, prepare_training
from stiffopt.recording.recording_set import RecordingSet, load_recordings

SPRING = 3.0  # [N m/rad]


@pytest.fixture(name="servo", scope="module")
def servo_set(tmp_path_factory: pytest.TempPathFactory) -> RecordingSet:
    """Pendulum on a servo with known gains."""
    actuator = f"kp = [{KP}]\nkd = [0.0]\ndelay = {DELAY}"
    return load_recordings(
        write_servo_set(tmp_path_factory.mktemp("servo") / "set", actuator=actuator, runs=2)
    )


def prepared(
    recordings: RecordingSet, *found: EstimatedEffect
) -> tuple[ResolvedActuator, ExtendedModel]:
    """Return the set with the law of its actuator, and the nominal model with findings."""
    own = resolve_actuator(recordings, open_training_runs(recordings))
    training = prepare_training(own.recordings, Settings(), None, lambda _: None, own.runs)
    return own, extended_model(own.recordings, training.constants, Extension(effects=found))


def simulated(recordings: RecordingSet, *found: EstimatedEffect) -> np.ndarray:
    """Return positions (K,) of the training run, simulated with findings."""
    own, model = prepared(recordings, *found)
    robot, physics, own_values = robot_in_loop(own.recordings, model)
    run = commanded_run(own.recordings, own.runs[0])
    loop = build_loop(own.recordings, [run], robot.tree, physics)
    values = nominal_parameters(own.recordings, robot, physics)
    for name, value in (("armature", ARMATURE), ("viscous", VISCOUS), ("coulomb", COULOMB)):
        values.values[values.place(name)] = value
    for (name, place), value in own_values.items():
        values.values[values.place(name)][place] += value
    quiet = replace(run, command=np.full_like(run.command, 0.8))
    return simulate(loop, quiet, values)[:, 0]


def found(name: str, amplitudes: tuple[float, ...], shapes: tuple[float, ...]) -> EstimatedEffect:
    located = LocatedEffect(effect=effect(name), joint=0, shapes=shapes)
    return EstimatedEffect(located=located, amplitudes=amplitudes)


def test_a_spring_holds_the_arm_back(servo: RecordingSet) -> None:
    plain = simulated(servo)[-1]
    held = simulated(servo, found("cable_spring", (SPRING, 0.0), (0.1,)))[-1]
    weight = 0.75 * 9.81 * 0.14

    def friction(q: float, spring: float) -> float:
        return abs(KP * (0.8 - q) - weight * np.sin(q) - spring * (q - 0.1))

    assert held < plain - 0.05
    # Both rest where friction holds what is left.
    assert friction(held, SPRING) <= 1.05 * COULOMB
    assert friction(plain, 0.0) <= 1.05 * COULOMB


def test_an_encoder_zero_moves_the_weight(servo: RecordingSet) -> None:
    plain = simulated(servo)[-1]
    turned = simulated(servo, found("joint_zero", (0.3,), (0.3,)))[-1]
    assert turned < plain - 0.005


def test_load_friction_holds_the_arm_back(servo: RecordingSet) -> None:
    plain = simulated(servo)[-1]
    held = simulated(servo, found("load_friction", (0.4,), (0.02,)))[-1]
    assert held < plain - 0.005


def test_a_surface_carries_the_arm(tmp_path: Path) -> None:
    actuator = f"kp = [{KP}]\nkd = [0.0]\ndelay = {DELAY}"
    folder = write_servo_set(tmp_path / "set", actuator=actuator, runs=2)
    file = folder / "recordings.toml"
    file.write_text('tool_frame = "tip"\n' + file.read_text())
    urdf = folder / "robot.urdf"
    tip = """<link name="tip"/><joint name="end" type="fixed"><parent link="arm"/>
<child link="tip"/><origin xyz="0 0 -0.2"/></joint></robot>"""
    urdf.write_text(urdf.read_text().replace("</robot>", tip))
    pressed = load_recordings(folder)
    stiffness, height = 400.0, 0.36
    located = LocatedEffect(effect=effect("external_contact"), shapes=(height,))
    contact = EstimatedEffect(located=located, amplitudes=(stiffness,))
    end = simulated(pressed, contact)[-1]
    plain = simulated(pressed)[-1]
    # At its command of 0.8 rad the tip stands higher; it began below the surface.
    depth = max(height - (0.5 - 0.2 * np.cos(end)), 0.0)
    push = stiffness * depth * 0.2 * np.sin(end)
    left = KP * (0.8 - end) - 0.75 * 9.81 * 0.14 * np.sin(end) + push
    assert end > plain + 0.005
    assert depth > 0.0
    assert abs(left) <= 1.05 * COULOMB


def test_backlash_before_the_encoder_lets_the_motor_travel_unseen(servo: RecordingSet) -> None:
    width, rounding = 0.05, 0.01
    own = resolve_actuator(servo, open_training_runs(servo)).recordings
    training = prepare_training(own, Settings(), None, lambda _: None, open_training_runs(servo))
    extension = Extension(effects=(found("output_backlash", (width, 0.5), (width, rounding)),))
    physics = robot_in_loop(own, extended_model(own, training.constants, extension))[1]
    (spring,) = physics.springs.values()
    assert spring.encoder_at_output
    assert physics.torque is None
    load = training.constants.joints[0].torque_rated
    unknown = physics.amplitudes
    both = [
        float(ca.substitute(spring.windup(ca.SX(sign * load)), unknown.symbols, unknown.values))
        for sign in (1.0, -1.0)
    ]
    # The flanks yield besides.
    assert width < both[0] - both[1] < width + 0.02


def test_flanks_of_a_rigid_joint_carry_the_rotor_of_the_robots_file(servo: RecordingSet) -> None:
    """A softer spring than that of its rotor is one that a servo excites."""
    damping = []
    for factor in (1.0, 2.0):
        rotor = np.full(1, factor * ARMATURE)
        own = replace(servo, robot=replace(servo.robot, rotor_inertia=rotor))
        resolved, model = prepared(own, found("output_backlash", (0.0, 0.0), (0.0, 0.002)))
        _, physics, _ = robot_in_loop(resolved.recordings, model)
        damping.append(physics.springs[0].damping)
    expected = 2.0 * _FLANK_DAMPING * _FLANK_FREQUENCY * ARMATURE
    np.testing.assert_allclose(damping, [expected, 2.0 * expected])


def test_a_rotor_that_findings_changed_is_as_uncertain_as_the_change(tmp_path: Path) -> None:
    """Filtered torques take a delay for inertia, and links tell little of a rotor's size."""
    folder = write_servo_set(tmp_path / "set", actuator=f"kp = [{KP}]\ndelay = {DELAY}", runs=2)
    state_drive(folder)
    resolved, _ = prepared(load_recordings(folder))
    robot, run = resolved.recordings.robot, commanded_run(resolved.recordings, resolved.runs[0])
    loop = build_loop(resolved.recordings, [run], robot.tree)
    for change, deviation in ((0.0, 0.05 * ARMATURE), (0.3, 0.3)):
        begun = nominal_parameters(resolved.recordings, robot)
        begun.values[begun.place("armature")] += change
        prior, deviations = expect_parameters(resolved.recordings, [run], loop, begun)
        np.testing.assert_allclose(prior.of("armature"), ARMATURE + change)
        np.testing.assert_allclose(deviations[prior.place("armature")], deviation)


def test_effects_with_memory_are_left_out(servo: RecordingSet) -> None:
    plain = simulated(servo)
    np.testing.assert_array_equal(plain, simulated(servo, found("gain_warmup", (0.2,), (100.0,))))


def test_a_finding_and_its_change_since_add_up(servo: RecordingSet) -> None:
    whole = simulated(servo, found("joint_zero", (0.3,), (0.3,)))
    parts = [found("joint_zero", (part,), (part,)) for part in (0.1, 0.2)]
    np.testing.assert_allclose(simulated(servo, *parts), whole, atol=1e-12)


def test_effects_that_read_other_samples_are_left_out(servo: RecordingSet) -> None:
    def second_sample(signals: Any, amplitudes: Values, _: Values) -> Term:
        return Term(drive_torque=amplitudes[0] * (signals.motor_position + signals.time[1]))

    own = replace(effect("base_tilt"), term=second_sample, change_robot=None)
    located = LocatedEffect(effect=own)
    plain = simulated(servo)
    left_out = simulated(servo, EstimatedEffect(located=located, amplitudes=(1.0, 1.0)))
    np.testing.assert_array_equal(plain, left_out)


def test_effects_with_memory_and_undefined_samples_are_left_out(servo: RecordingSet) -> None:
    def undefined(signals: Any, amplitudes: Values, _: Values) -> Term:
        with np.errstate(invalid="ignore"):
            root = np.sqrt(signals.motor_position)
        return Term(drive_torque=amplitudes[0] * (1.0 + signals.time) * root)

    own = replace(effect("quadratic_drag"), name="rising", term=undefined)
    located = LocatedEffect(effect=own, joint=0)
    plain = simulated(servo)
    left_out = simulated(servo, EstimatedEffect(located=located, amplitudes=(1.0,)))
    np.testing.assert_array_equal(plain, left_out)


def law(*factors: Factor) -> EstimatedEffect:
    own = Law(joint=0, place="link_torque", factors=factors)
    located = LocatedEffect(effect=law_effect(own, [SPRING]), joint=0, shapes=own.shapes)
    return EstimatedEffect(located=located, amplitudes=(SPRING,))


def test_a_law_acts_as_the_effect_that_it_equals(servo: RecordingSet) -> None:
    sprung = simulated(servo, found("cable_spring", (SPRING, 0.0), (0.0,)))
    own = simulated(servo, law(Factor(LawSource("position", 0), "linear")))
    np.testing.assert_allclose(own, sprung, atol=1e-9)


def test_the_values_of_a_law_are_unknowns_of_the_simulation(servo: RecordingSet) -> None:
    """Held as the torques tell them, their errors would go to friction and rotor inertia."""
    bounds = ((-1.0, 1.0), (0.1, 2.0))
    dent = law(Factor(LawSource("position", 0), "bump", (0.2, 0.5), bounds))
    resolved, model = prepared(servo, dent)
    own = robot_in_loop(resolved.recordings, model)[1].amplitudes
    np.testing.assert_allclose(own.values, [SPRING, 0.2, 0.5])
    np.testing.assert_allclose(own.bounds[1:], bounds)
    np.testing.assert_allclose(own.deviations[1:], [1.0, 0.95])


def test_laws_of_accelerations_are_left_out(servo: RecordingSet) -> None:
    """They follow from the torques that such a law would need them for."""
    jolt = Factor(LawSource("acceleration", 0), "bump", (0.0, 1.0), ((-1.0, 1.0), (0.1, 2.0)))
    np.testing.assert_array_equal(simulated(servo), simulated(servo, law(jolt)))


def fitted_loop(servo: RecordingSet, more: float) -> ClosedLoopModel:
    """Return a closed loop whose fitted dry friction exceeds the nominal one by some amount."""
    fitted = nominal_parameters(servo, servo.robot)
    fitted.values[fitted.place("coulomb")] += more
    law = resolve_actuator(servo, open_training_runs(servo)).recordings.actuator
    assert law is not None
    loop = CommandedArm(servo.robot.tree, law, np.zeros(1))
    count = len(fitted.values)
    spread = np.full(count, 0.005)
    polished = Polished(
        parameters=fitted,
        deviations=spread,
        attainable=spread,
        residual=np.ones(1),
        noise=np.ones(1),
        discretisation=np.zeros(1),
        places=np.arange(count),
        covariance=np.diag(spread**2),
        expected=fitted,
        expected_deviations=spread,
    )
    return ClosedLoopModel(
        nominal_loop=loop,
        loop=loop,
        nominal=nominal_parameters(servo, servo.robot),
        fitted=fitted,
        deviations=spread,
        polished=polished,
    )


def constants(servo: RecordingSet) -> RobotConstants:
    """Return the constants of the training runs."""
    runs = open_training_runs(servo)
    return prepare_training(servo, Settings(), None, lambda _: None, runs).constants


def claimed_friction(rivals: tuple[Rival, ...] = ()) -> Finding:
    """Return a claim of 0.05 N m more dry friction."""
    return Finding(
        estimated=found("coulomb", (0.05,), ()),
        link=None,
        probability=0.999 - sum(rival.probability for rival in rivals),
        misfit=0.001,
        rivals=rivals,
        parameters=(Parameter(name="dFc", value=0.05, sd=0.005, unit="N m", prior_sd=0.1),),
        where="",
        channel="torque_1",
        variance_explained=0.5,
    )


@pytest.mark.parametrize(("simulated_more", "certainty"), [(0.0, "possible"), (0.05, "found")])
@pytest.mark.parametrize("rival_share", [0.0, 0.01])
def test_a_value_that_the_simulation_refutes_is_not_claimed(
    servo: RecordingSet, rival_share: float, simulated_more: float, certainty: str
) -> None:
    """The unknown cause, the finding and its rivals are all that there may be."""
    drag = LocatedEffect(effect=effect("quadratic_drag"), joint=0)
    rivals = (Rival(located=drag, probability=rival_share),) if rival_share else ()
    model = fitted_loop(servo, simulated_more)
    (judged,) = findings_with_loop_values(
        servo, constants(servo), model, [claimed_friction(rivals)], ()
    )
    assert judged.certainty == certainty
    assert judged.misfit + judged.group_probability == pytest.approx(1.0)


def test_a_finding_has_no_part_in_what_the_starting_model_holds(servo: RecordingSet) -> None:
    earlier = Extension(effects=(found("coulomb", (0.2,), ()), found("viscous", (0.1,), ())))
    model = fitted_loop(servo, 0.26)
    (judged,) = findings_with_loop_values(
        servo, constants(servo), model, [claimed_friction()], (earlier,)
    )
    assert judged.parameters[0].value == pytest.approx(0.06)


def test_parameters_of_a_body_count_as_far_as_they_are_free(tmp_path: Path) -> None:
    """Seven parameters of a body of the simulation make ten amplitudes of a payload."""
    folder = write_servo_set(tmp_path / "set", actuator=f"kp = [{KP}]\ndelay = {DELAY}")
    urdf = folder / "robot.urdf"
    urdf.write_text(urdf.read_text().replace('xyz="0 0 -0.14"', 'xyz="0.01 0.02 -0.14"'))
    servo = load_recordings(folder)
    model, stated = fitted_loop(servo, 0.0), DEFAULT_TOLERANCE.mass
    assert servo.tolerance.mass is None
    assert stated is not None
    deviations = 4.5
    model.fitted.values[model.fitted.bodies.start] = deviations * np.hypot(0.005, stated)
    located = LocatedEffect(effect=effect("payload"))
    claimed = EstimatedEffect(located=located, amplitudes=(0.1,) + (0.0,) * 9)
    payload = replace(claimed_friction(), estimated=claimed, parameters=())
    (judged,) = findings_with_loop_values(servo, constants(servo), model, [payload], ())
    chance = float(special.chdtrc(7, deviations**2))
    assert judged.misfit == pytest.approx(_null_share(chance))


def test_a_value_is_as_uncertain_as_the_deviations_of_the_fit_say(servo: RecordingSet) -> None:
    """They may hold what the fit does not tell, as the scale of masses that nobody states."""
    model = fitted_loop(servo, 0.5)
    assert model.polished is not None
    unsure = replace(model.polished, deviations=10.0 * model.polished.deviations)
    sds = []
    for polished in (model.polished, unsure):
        own = replace(model, polished=polished)
        (judged,) = findings_with_loop_values(
            servo, constants(servo), own, [claimed_friction()], ()
        )
        sds.append(judged.parameters[0].sd)
    assert sds[1] ** 2 - sds[0] ** 2 == pytest.approx(0.05**2 - 0.005**2)
