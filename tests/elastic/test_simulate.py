"""The elastic arm against closed forms, energy, a second integrator and its own linearisation."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from elastic_arms import (
    INERTIA,
    LENGTH,
    RATE,
    STIFFNESS,
    answer,
    arm,
    bang,
    one_soft_joint,
    there_and_stop,
)
from small_arms import CONSTANT, joint, write_robot

from stiffopt.elastic.arm import ElasticArm
from stiffopt.elastic.modes import modes
from stiffopt.elastic.motor import MotorMotion
from stiffopt.elastic.simulate import REST, simulate, typical_hysteresis
from stiffopt.errors import InputError, RobotError
from stiffopt.robot.files import load_robot


@pytest.mark.parametrize("share", [0.0, 0.02, 0.3])
def test_one_joint_vibrates_as_two_masses_on_a_spring(tmp_path, share):
    damping = 2.0 * share * np.sqrt(STIFFNESS * INERTIA)
    swivel = arm(tmp_path, damping=np.array([damping]))
    half, acceleration = 0.0973, 40.0
    found = simulate(swivel, bang([acceleration], half, [0.0]))
    since = [answer(found.time - t, RATE, share) for t in (0.0, half, 2 * half)]
    behind = -acceleration / RATE**2 * (since[0] - 2.0 * since[1] + since[2])
    # The largest is 7e-4 rad.
    np.testing.assert_allclose(found.windup[:, 0], -behind, atol=2e-7)
    np.testing.assert_allclose(found.distance, 2 * LENGTH * np.sin(np.abs(behind) / 2), atol=8e-8)
    np.testing.assert_allclose(found.spring_torque, STIFFNESS * found.windup, atol=1e-6)
    flight, rest = found.time <= found.duration, found.time >= found.duration
    assert found.peak == pytest.approx(LENGTH * np.abs(behind)[flight].max(), rel=1e-3)
    assert found.peak_after == pytest.approx(LENGTH * np.abs(behind)[rest].max(), rel=1e-3)
    assert found.duration == pytest.approx(2 * half)
    assert found.time[-1] == pytest.approx(2 * half + REST)


def test_default_damping_is_two_percent_of_critical_and_ringing_decays_by_it(tmp_path):
    swivel = arm(tmp_path)
    assert swivel.assumed_damping == (1,)
    assert modes(swivel, np.zeros(1))[0].damping == pytest.approx(0.02)
    found = simulate(swivel, bang([40.0], 0.0973, [0.0]))
    period = 2.0 * np.pi / RATE
    after = found.time - found.duration
    first, later = (
        found.distance[(after > k * period) & (after < (k + 1) * period)].max() for k in (1, 16)
    )
    assert np.log(first / later) == pytest.approx(0.02 * RATE * 15 * period, rel=0.02)


def test_energy_is_conserved_without_damping(tmp_path):
    planar = arm(tmp_path, "planar", damping=np.zeros(2))
    found = simulate(planar, bang([12.0, -9.0], 0.1, [-0.6, 0.4]))
    rest = found.time >= found.duration
    q, v, windup = found.position[rest], found.velocity[rest], found.windup[rest]
    model = planar.robot.model
    data = model.createData()
    moving = [pin.computeMechanicalEnergy(model, data, *row) for row in zip(q, v, strict=True)]
    share = np.linspace(0.0, 1.0, 401)
    stored = np.zeros(len(q))
    for j, spring in enumerate(planar.springs):
        wound = windup[:, j : j + 1] * share
        stored += np.trapezoid(spring.torque(wound), wound, axis=1)
    energy = np.array(moving) + stored
    swing = np.ptp(stored)
    assert swing > 1e-5
    assert np.ptp(energy) < 2e-3 * swing


@pytest.mark.parametrize("name", ["planar", "slide"])
def test_integrators_agree(tmp_path, name):
    jointed = arm(tmp_path, name)
    motion = bang([3.0, -9.0], 0.12, [0.0, 0.4])
    one, other = (simulate(jointed, motion, method=m) for m in ("DOP853", "Radau"))
    np.testing.assert_allclose(one.deviation, other.deviation, atol=2e-3 * one.peak)
    assert one.peak > 1e-5


def test_rigid_joints_follow_their_motors_and_load_the_springs(tmp_path):
    elbow = one_soft_joint(tmp_path)
    motion = there_and_stop([0.0, 30.0], 0.1, [0.3, 0.2])
    found = simulate(elbow, MotorMotion.of(motion))
    flight = found.time <= found.duration
    np.testing.assert_allclose(
        found.position[flight, 1], motion(found.time[flight])[:, 1], atol=1e-12
    )
    assert np.all(found.windup[:, 1] == 0.0)
    # Held at rest long after, the shoulder carries both links' weight.
    still = elbow.static_equilibrium(motion(motion.duration)[None])[0]
    np.testing.assert_allclose(
        found.position[-200:].mean(axis=0), still, atol=0.05 * np.ptp(found.windup[:, 0])
    )
    assert elbow.assumed_damping == (1,)
    assert any("rigid, since the robot file gives no elements: elbow." in n for n in found.notes)
    heavier = one_soft_joint(tmp_path, hysteresis=np.array([0.0, 1e-4]))
    assert not heavier.hysteresis.any()


def test_rigid_arm_has_no_deviation(tmp_path):
    elbow = one_soft_joint(tmp_path, chains=(None, None))
    found = simulate(elbow, bang([5.0, 30.0], 0.1, [0.3, 0.2]))
    assert found.peak == pytest.approx(0.0, abs=1e-12)
    assert found.settling_time == 0.0
    assert modes(elbow, np.zeros(2)) == ()


def test_constant_force_shifts_the_static_equilibrium(tmp_path):
    pushed = arm(tmp_path, "planar", process_force=(30.0, 0.0, -40.0))
    plain = arm(tmp_path, "planar")
    motion = bang([2.0, 2.0], 0.1, [0.3, 0.2])
    at = motion.position(np.array([0.0]))
    difference = pushed.tool(pushed.static_equilibrium(at)) - plain.tool(
        plain.static_equilibrium(at)
    )
    assert difference[0, 2] < -1e-4
    found = simulate(pushed, motion)
    assert found.distance[0] == pytest.approx(0.0, abs=1e-10)
    assert found.distance[-1] < 0.1 * found.peak


def test_ringing_has_the_frequency_of_a_mode(tmp_path):
    planar = arm(tmp_path, "planar", damping=np.array([0.5, 0.2]))
    found = simulate(planar, bang([4.0, -1.0], 0.1, [0.3, 0.2]))
    lowest = modes(planar, found.position[-1] + found.windup[-1])[0]
    rest = found.time >= found.duration
    ring = found.windup[rest, 0] - found.windup[rest, 0].mean()
    spectrum = np.abs(np.fft.rfft(ring * np.hanning(len(ring)), 16 * len(ring)))
    step = found.time[-1] - found.time[-2]
    frequency = np.fft.rfftfreq(16 * len(ring), step)[int(np.argmax(spectrum))]
    assert frequency == pytest.approx(lowest.frequency, rel=0.01)


def test_settling_time_is_from_arrival_until_the_tool_stays_in_the_band(tmp_path):
    found = simulate(arm(tmp_path), bang([40.0], 0.0973, [0.0]), band=2e-5)
    after = found.time - found.duration
    settled = found.settling_time
    assert settled is not None
    assert 0.0 < settled < REST
    assert np.all(found.distance[after >= settled] <= 2e-5)
    assert np.any(found.distance[(after > settled - 2e-3) & (after < settled)] > 2e-5)
    never = simulate(arm(tmp_path, damping=np.zeros(1)), bang([40.0], 0.0973, [0.0]), band=2e-6)
    assert never.settling_time is None


def test_hysteresis_loop_has_the_stated_width(tmp_path):
    half_width = 1e-4
    swivel = arm(tmp_path, hysteresis=np.array([half_width]), damping=np.zeros(1))

    class Swinging:
        """Acceleration of a sine, slow beside the mode of 53 Hz."""

        duration = 1.5

        def __call__(self, t, order=0):
            rate = 4.0 * np.pi
            drift = rate * t - np.sin(rate * t)
            speed = rate * (1.0 - np.cos(rate * t))
            return 0.5 * (drift if order == 0 else speed)[:, None]

    found = simulate(swivel, MotorMotion.of(Swinging()))
    flight = (found.time > 0.3) & (found.time < 1.5)
    torque, windup = found.spring_torque[flight, 0], found.windup[flight, 0]
    crossing = np.flatnonzero(np.diff(np.sign(torque)))
    assert len(crossing) >= 4
    share = torque[crossing] / (torque[crossing] - torque[crossing + 1])
    at_zero = windup[crossing] + share * (windup[crossing + 1] - windup[crossing])
    np.testing.assert_allclose(np.abs(at_zero), half_width, rtol=0.05)
    # Wind-up lags: going through zero upwards the spring is still wound the other way.
    assert np.all(np.sign(at_zero) == -np.sign(torque[crossing + 1]))
    share = 100.0 * LENGTH * half_width / found.distance.max()
    assert f"0.04 mm from its static equilibrium at the end, {share:.0f} %" in found.notes[0]


def test_slipping_joint_is_named(tmp_path):
    robot = load_robot("er3a_c60")
    slipping = ElasticArm(robot, np.zeros(6))
    found = simulate(slipping, bang([120.0, 0.0, 0.0, 0.0, 0.0, 0.0], 0.05, np.zeros(6)))
    assert np.isfinite(found.peak)
    assert found.notes[0].startswith("joint_1 passes 80")


def test_invalid_dynamics_are_refused(tmp_path):
    with pytest.raises(RobotError, match="damping of swivel must lie between 0 and the critical"):
        arm(tmp_path, damping=np.array([61.0]))
    with pytest.raises(RobotError, match="got -1"):
        arm(tmp_path, damping=np.array([-1.0]))
    with pytest.raises(RobotError, match="half width of 0 or above"):
        arm(tmp_path, hysteresis=np.array([-1e-4]))
    stiff = arm(tmp_path, "slide")
    stiff.robot.model.inertias[1].mass = 1e-6
    stiff.robot.model.inertias[2].mass = 1e-6
    light = ElasticArm(stiff.robot, np.zeros(2))
    with pytest.raises(RobotError, match="mostly of rail, lies beyond the reach"):
        simulate(light, bang([1.0, 0.0], 0.1, [0.0, 0.0]))


def test_damping_and_hysteresis_of_a_robot_file_keep_their_source(tmp_path):
    stated = {"damping": 3.0, "hysteresis": '"20 arcmin"', "source": '"a measured ring-down"'}
    spring = CONSTANT.format(stiffness=STIFFNESS)
    robot = load_robot(write_robot(tmp_path, "swivel", joints=[joint("swivel", spring, **stated)]))
    swivel = ElasticArm(robot, np.zeros(1))
    assert swivel.assumed_damping == ()
    assert swivel.damping[0] == 3.0
    assert swivel.hysteresis[0] == pytest.approx(np.radians(20 / 60))
    (source,) = [source for source in robot.sources if "damping" in source.key]
    assert source.source == "a measured ring-down"
    wrong = [joint("swivel", spring, damping=-3.0)]
    with pytest.raises(InputError, match=r"joint\[.*\.damping"):
        load_robot(write_robot(tmp_path, "swivel", joints=wrong))


def test_motion_without_final_rest_ends_at_arrival(tmp_path):
    motion = MotorMotion(np.array([0.0, 0.2]), np.array([[0.0], [0.2]]), np.ones((2, 1)))
    found = simulate(arm(tmp_path), motion)
    assert found.time[-1] == pytest.approx(0.2)
    assert found.peak < 1e-8
    assert found.peak_after is found.rms_after is found.settling_time is None


def test_joint_of_high_frequency_may_follow_its_motor(tmp_path):
    """A light hand on a stiff wrist, 2 kHz: what the arm does otherwise is the same."""
    springs = [CONSTANT.format(stiffness=k) for k in (STIFFNESS, 4e6)]
    joints = [joint(name, s) for name, s in zip(("shoulder", "elbow"), springs, strict=True)]
    whole = ElasticArm(load_robot(write_robot(tmp_path, "planar", joints=joints)), np.zeros(2))
    assert modes(whole, np.zeros(2))[1].frequency > 1500.0
    following = whole.with_fast_joints_following(np.zeros(2))
    assert (following.following, whole.following) == ((2,), ())
    motion = bang([20.0, 10.0], 0.05, [0.0, 0.0])
    own, full = simulate(following, motion), simulate(whole, motion)
    assert own.peak == pytest.approx(full.peak, rel=2e-3)
    assert own.notes[0] == "elbow: single-joint vibration above 1200 Hz, taken as rigid."


def test_prismatic_joint_has_no_typical_hysteresis(tmp_path):
    robot = load_robot(write_robot(tmp_path, "slide"))
    pose = np.array([0.1, 0.5])
    held = ElasticArm(robot, pose)
    lever = np.linalg.norm(held.bodies.jacobian(robot.tool, pose)[:3, 1])
    assert typical_hysteresis(held, pose) == pytest.approx(5e-5 * lever)
