"""Effects of the catalogue against plain loops, spectra, energy and their limits."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.user_effects import sample_signals

ROBOT = sample_signals()


def loaded(signals, load):
    """Signals of a motor that winds up under a load while its link stands."""
    windup = signals.constants.windup(load)
    still = np.zeros_like(load)
    places = {"motor_position": windup, "link_position": still}
    return replace(signals, spring_torque=load, windup=windup, **places)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 3.0])
def test_hysteresis_slope_is_that_of_its_wind_up(exponent):
    """A sample moved by little: the past stays, and the friction of sliders that hold grows."""
    load = np.concatenate([np.linspace(-9.0, 9.0, 300), np.linspace(9.0, 4.0, 80)])
    signals = loaded(sample_signals(count=4).of_joint(4), load)
    hysteresis, values, moved = effect("hysteresis"), ([1.3], [3e-4, exponent]), 1e-9
    slopes = hysteresis.deflection_slope(signals, *values)
    assert np.all(slopes <= 0.0)
    for k in (40, 150, 260, 310, 370):
        ends = []
        for step in (-moved, moved):
            motor = signals.motor_position.copy()
            motor[k:] += step
            own = replace(signals, motor_position=motor)
            ends.append(float(hysteresis.term(own, *values).deflection[k]))
        assert (ends[1] - ends[0]) / (2.0 * moved) == pytest.approx(slopes[k], rel=1e-4, abs=1e-9)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 3.0])
def test_hysteresis_matches_sliders_parallel_to_spring(exponent):
    signals = sample_signals(count=1500, dt=0.002).of_joint(4)
    h, reach, sliders = 1.3, 3e-4, 2000
    # Springs of one stiffness with dry friction each, sample by sample.
    limits = [reach * ((k + 0.5) / sliders) ** exponent for k in range(sliders)]
    strains, states = [0.0] * sliders, [0.0]
    for travel in np.diff(signals.windup):
        strains = [
            max(-limit, min(limit, strain + travel))
            for limit, strain in zip(limits, strains, strict=True)
        ]
        states.append(sum(strains) / sum(limits))
    # What the friction carries, the spring does not: the difference of its law, by plain slopes.
    load = signals.spring_torque

    def wound(torque):
        size = np.abs(torque)
        bent = np.minimum(size, 7.0) / 1.6e4 + np.clip(size - 7.0, 0.0, 18.0) / 2.5e4
        bent += np.maximum(size - 25.0, 0.0) / 2.9e4
        return np.sign(torque) * bent + torque / 6.5e4

    expected = wound(load - h * np.array(states)) - wound(load)
    found = np.asarray(effect("hysteresis").term(signals, [h], [reach, exponent]).deflection)
    # Near a bend the mean slope stands for its law's difference.
    bend = np.minimum(np.abs(np.abs(load) - 7.0), np.abs(np.abs(load) - 25.0)) < 1.7
    assert 0.1 < np.mean(bend) < 0.5
    largest = np.abs(expected).max()
    # Ten sliders stand for many.
    np.testing.assert_allclose(found[~bend], expected[~bend], atol=0.02 * largest)
    assert np.abs(found - expected)[bend].max() < 0.5 * h * (1.0 / 1.6e4 - 1.0 / 2.5e4)


def test_hysteresis_is_continuous_at_reducer_corners():
    signals = sample_signals(count=4001, dt=0.002).of_joint(4)
    load = np.linspace(6.0, 8.0, 4001)
    signals = loaded(signals, load)
    found = np.asarray(effect("hysteresis").term(signals, [1.3], [1e-5, 1.0]).deflection)
    jump = 1.3 * (1.0 / 1.6e4 - 1.0 / 2.5e4)
    assert np.abs(np.diff(found[1000:])).max() < 1e-3 * jump


def test_hysteresis_loops_close_where_they_began():
    """A small loop within a large one changes nothing after it: contacts remember reversals."""
    signals = sample_signals(count=4, dt=0.002).of_joint(4)

    def end(turns):
        load = np.concatenate([np.linspace(a, b, 200) for a, b in pairwise(turns)])
        own = loaded(signals, load)
        return float(effect("hysteresis").term(own, [1.3], [3e-4, 1.5]).deflection[-1])

    assert end([0.0, 4.0, 2.5, 3.5, 2.5, 4.0, 5.0]) == pytest.approx(end([0.0, 5.0]), rel=1e-9)
    assert end([0.0, 5.0, 2.0, 3.0, 2.0, 1.0]) == pytest.approx(end([0.0, 5.0, 1.0]), rel=1e-9)
    assert abs(end([0.0, 5.0, 1.0]) / end([0.0, 1.0]) - 1.0) > 0.5


def test_hysteresis_dissipates_independent_of_rate():
    losses = []
    for dt in (0.002, 0.0005):
        signals = sample_signals(count=3000, dt=0.002).of_joint(4)
        signals = replace(signals, dt=dt, time=dt * np.arange(3000))
        d = effect("hysteresis").term(signals, [1.3], [3e-4, 1.0]).deflection
        angle = signals.windup + d
        losses.append(
            float(
                np.sum(
                    0.5 * (signals.spring_torque[1:] + signals.spring_torque[:-1]) * np.diff(angle)
                )
            )
        )
    assert losses[0] > 0.0
    assert losses[0] == pytest.approx(losses[1], rel=1e-12)


def test_belt_creep_matches_standard_linear_solid():
    signals = sample_signals(count=1000, dt=0.002).of_joint(4)
    now, later, lag = 2e-5, 3e-5, 0.15
    s, slow, expected = signals.spring_torque, signals.spring_torque[0], []
    for before, after in zip([s[0], *s[:-1]], s, strict=True):
        for k in range(1, 51):
            load = before + (after - before) * k / 50
            slow += (load - slow) * 0.002 / 50 / lag
        expected.append(now * after + later * slow)
    found = np.asarray(effect("belt_creep").term(signals, [now, later], [lag]).deflection)
    # The law holds the load through a step of the clock: off by half a step.
    np.testing.assert_allclose(found, expected, atol=1.0e-2 * np.abs(expected).max())


def test_belt_creep_is_complete_under_steady_load():
    signals = sample_signals(count=400).of_joint(4)
    signals = replace(signals, spring_torque=np.full(400, 12.0))
    found = effect("belt_creep").term(signals, [2e-5, 3e-5], [0.2]).deflection
    np.testing.assert_allclose(found, 12.0 * 5e-5, rtol=1e-12)


def test_k1_softening_changes_first_slope_and_corner():
    torque = np.linspace(-60.0, 60.0, 4001)
    signals = replace(ROBOT.of_joint(0), spring_torque=torque)
    nominal = signals.constants.windup(torque) - torque / signals.constants.contact_stiffness

    def worn(k1_factor: float, t1_factor: float) -> np.ndarray:
        term = effect("k1_softening").term(signals, [1.0], [k1_factor, t1_factor])
        return nominal + np.asarray(term.deflection)

    np.testing.assert_allclose(worn(1.0, 1.0), nominal, atol=1e-15)
    slopes = np.gradient(worn(0.5, 2.0), torque)
    for load, slope in ((5.0, 1 / 8e3), (13.0, 1 / 8e3), (20.0, 1 / 2.5e4), (40.0, 1 / 2.9e4)):
        assert np.interp(load, torque, slopes) == pytest.approx(slope, rel=1e-6)
    # A first corner beyond the second leaves no middle slope.
    wide = np.gradient(worn(1.0, 5.0), torque)
    assert np.interp(30.0, torque, wide) == pytest.approx(1 / 1.6e4, rel=1e-6)
    assert np.interp(45.0, torque, wide) == pytest.approx(1 / 2.9e4, rel=1e-6)


def test_backlash_spans_its_width():
    signals = ROBOT.of_joint(4)
    signals = replace(signals, spring_torque=np.linspace(-40.0, 40.0, 60))
    jump = effect("backlash").term(signals, [4e-4], [0.005]).deflection
    assert jump[-1] - jump[0] == pytest.approx(4e-4, rel=1e-4)
    assert np.all(np.diff(jump) >= 0.0)


def test_preload_loss_is_odd_and_softest_at_zero():
    torque = np.linspace(-40.0, 40.0, 801)
    signals = replace(ROBOT.of_joint(4), spring_torque=torque)
    angle = effect("preload_loss").term(signals, [1.0], [0.05, 0.5]).deflection
    slope = np.gradient(angle, torque)
    np.testing.assert_allclose(angle, -angle[::-1], atol=1e-18)
    assert np.all(slope > 0.0)
    assert np.all(np.diff(slope[402:-1]) < 0.0)


def test_ripple_and_transmission_error_have_expected_orders():
    turn = np.linspace(0.0, 2.0 * np.pi / 101.0, 4096, endpoint=False)
    still = np.zeros_like(turn)
    signals = replace(
        ROBOT.of_joint(4),
        motor_position=turn,
        motor_velocity=still,
        spring_torque=np.ones_like(turn),
    )
    error = effect("transmission_error")
    amplitudes = [3e-5, 4e-5, 0.0, 1.2e-4, 0.0, 0.0]
    term = error.term(signals, amplitudes, [])
    lines = np.abs(np.fft.rfft(term.deflection)) / 2048
    assert np.flatnonzero(lines > 1e-9).tolist() == [1, 2]
    assert error.parameters(amplitudes, [], signals.constants) == pytest.approx(
        {"A1": lines[1], "A2": lines[2], "A4": 0.0}
    )
    # Virtual work: what the drive gives less is the slope of the error.
    np.testing.assert_allclose(
        term.drive_torque[1:-1], -np.gradient(term.deflection, turn)[1:-1], atol=1e-4
    )
    ripple = effect("torque_ripple").term(signals, [0.5, 0.0, 0.0, 0.2], []).drive_torque
    lines = np.abs(np.fft.rfft(ripple)) / 2048
    assert np.flatnonzero(lines > 1e-9).tolist() == [4, 24]
    # Of the sixth harmonic, which passes once from sample to sample, nothing is made a slow wave.
    fast = replace(signals, motor_velocity=still + 2.0 * np.pi / (24.0 * 101.0 * signals.dt))
    ripple = effect("torque_ripple").term(fast, [0.5, 0.0, 0.0, 0.2], []).drive_torque
    lines = np.abs(np.fft.rfft(ripple)) / 2048
    assert lines[4] == pytest.approx(0.5, rel=0.06)
    assert lines[24] < 1e-5
    waves = effect("rotor_ripple")
    lines = np.abs(np.fft.rfft(waves.term(signals, [0.3, 0.4], [2.0]).drive_torque)) / 2048
    assert np.flatnonzero(lines > 1e-9).tolist() == [2]
    assert waves.parameters([0.3, 0.4], [2.0], signals.constants) == pytest.approx(
        {"B": lines[2], "waves": 2.0}
    )


def test_wrist_coupling_does_no_work():
    signals = ROBOT.of_joint(4)
    term = effect("wrist_coupling").term(signals, [0.02], [0.0, 0.0])
    before = ROBOT.motor_velocity[:, 3]
    # The link turns by c of the joint before, so the spring's work is what that joint gives.
    given = term.previous_torque * before
    taken = signals.spring_torque * (0.02 * before)
    np.testing.assert_allclose(term.deflection, -0.02 * signals.previous_position)
    np.testing.assert_allclose(given, taken, rtol=1e-12)


def test_friction_and_rotor_at_the_link_of_a_coupled_wrist_take_the_power_of_its_motion():
    share = 1e-5
    constants = replace(ROBOT.of_joint(4).constants, coulomb=0.7, viscous=0.3, rotor_inertia=0.05)
    signals = replace(
        ROBOT.of_joint(4), constants=constants, spring_torque=np.zeros(len(ROBOT.time))
    )
    own, rate, before = (
        signals.motor_velocity, signals.motor_acceleration, signals.previous_velocity
    )  # fmt: skip

    def taken(c: float) -> np.ndarray:
        """Power of friction and rotor at the link."""
        speed, faster = own + c * before, rate + c * signals.previous_acceleration
        torque = 0.7 * np.tanh(speed / 0.01) + 0.3 * speed + 0.05 * faster
        return torque * speed

    # A servo damps by the speed that it reads, coupled or not.
    drive = 0.7 * np.tanh(own / 0.01) + 0.3 * own + 0.05 * rate + 5.0 * own
    term = effect("wrist_coupling").term(
        replace(signals, drive_torque=drive), [share], [share, 1.0]
    )
    given = term.drive_torque * own + term.previous_torque * before
    wanted = taken(share) - taken(0.0)
    np.testing.assert_allclose(given, wanted, atol=1e-3 * np.abs(wanted).max())


def test_a_motor_behind_the_encoder_takes_the_impulses_of_its_travel():
    signals = ROBOT.of_joint(4)
    width, rounding = 0.02, 3.0
    time = np.arange(400) * 1e-3
    load = 10.0 * np.cos(2.0 * np.pi * 5.0 * time)
    constants = replace(signals.constants, rotor_inertia=0.05, viscous=1e-9, coulomb=1e-9)
    own = replace(
        signals,
        constants=constants,
        dt=1e-3,
        spring_torque=load,
        motor_velocity=np.ones_like(time),
        motor_direction=np.ones_like(time),
    )
    shapes = [width, rounding / constants.torque_rated]
    torque = effect("output_backlash").term(own, [width, 0.0], shapes).drive_torque
    travel = 0.5 * width * load / np.hypot(load, rounding)
    # Impulses of the rotor from one flank to the other: as much to start it as to stop it.
    middle = slice(0, 100)
    np.testing.assert_allclose(np.trapezoid(torque[middle], dx=1e-3), 0.0, atol=1e-4)
    given = np.cumsum(torque) * 1e-3
    peak = np.abs(given[middle]).max()
    speed = np.abs(np.gradient(travel, 1e-3))[middle].max()
    np.testing.assert_allclose(peak, 0.05 * speed, rtol=0.05)


def test_coupled_drive_power_balance():
    signals = ROBOT.of_joint(4)
    dry, viscous, inertia, share = 2.0, 3.0, 0.1, -1.0
    term = effect("coupled_drive").term(signals, [dry, viscous, inertia], [share])
    before, own = ROBOT.motor_velocity[:, 3], signals.motor_velocity
    speed = own + share * before
    rate = signals.motor_acceleration + share * ROBOT.motor_acceleration[:, 3]
    power = term.drive_torque * own + term.previous_torque * before
    wanted = dry * np.abs(speed) + viscous * speed**2 + inertia * rate * speed
    fast = np.abs(speed) > 0.05
    np.testing.assert_allclose(power[fast], wanted[fast], rtol=1e-3, atol=1e-9)


def test_saturated_drive_gives_its_limit_of_the_recorded_demand():
    asked = np.linspace(-120.0, 120.0, 60)
    signals = replace(ROBOT.of_joint(4), asked_torque=asked)
    entry = effect("saturation")
    soft, hard = (
        asked - entry.term(signals, [1.0], [0.5, sharpness]).drive_torque
        for sharpness in (14.0, 200.0)
    )
    np.testing.assert_allclose(hard, np.clip(asked, -60.0, 60.0), atol=0.3)
    np.testing.assert_allclose(soft, asked / (1.0 + np.abs(asked / 60.0) ** 14.0) ** (1.0 / 14.0))
    assert entry.parameters([1.0], [0.5, 14.0], signals.constants) == {"limit": 60.0}


def test_reading_beyond_its_limit_stays_there():
    needed = np.linspace(-120.0, 120.0, 60)
    signals = replace(ROBOT.of_joint(4), drive_torque=needed)
    entry = effect("reading_limit")
    read = needed + entry.term(signals, [1.0], [0.5]).drive_torque
    np.testing.assert_allclose(read, np.clip(needed, -60.0, 60.0), atol=1.0)
    assert np.abs(read).max() < 60.0 + 1e-9


def test_external_contact_acts_only_below_its_height():
    entry = effect("external_contact")
    torque = entry.term(ROBOT, [1e4], [0.35]).link_torque
    depth = np.maximum(0.35 - ROBOT.tool_position[:, 2], 0.0)
    high = ROBOT.tool_position[:, 2] > 0.37
    assert high.any()
    assert (~high).any()
    assert np.abs(torque[high]).max() < 1e4 * 2e-7
    # Power: the drives give what the force does not do by itself.
    given = np.sum(torque * ROBOT.link_velocity, axis=1)
    tool = np.einsum("kj,kj->k", ROBOT.tool_jacobian[:, 2], ROBOT.link_velocity)
    np.testing.assert_allclose(given, -1e4 * depth * tool, atol=1e4 * 1e-4 * np.abs(tool).max())


def test_inertial_effects_sum_regressor_columns():
    for name, body in (("payload", ROBOT.last_link), ("inertial_error", 2)):
        amplitudes = [0.7, 0.01, -0.02, 0.03]
        columns = ROBOT.body_regressor[:, :, 10 * body : 10 * body + 4]
        found = effect(name).term(ROBOT, amplitudes, []).link_torque
        np.testing.assert_allclose(found, columns @ np.array(amplitudes), rtol=1e-12, atol=1e-14)
    values = effect("payload").parameters([0.5, 0.01, 0.0, -0.02], [], ROBOT.constants)
    assert values == pytest.approx({"dm": 0.5, "cx": 0.02, "cy": 0.0, "cz": -0.04})
    amplitudes = [0.5, 0.03, 0.0, -0.04, 0.2, 7.0, 0.0, 7.0, 7.0, -0.1]
    link = effect("inertial_error").parameters(amplitudes, [], ROBOT.constants)
    assert link["dmc"] == pytest.approx(0.05)
    assert link["dI"] == pytest.approx(0.05**0.5)


def test_reading_and_spring_terms_have_expected_signs():
    signals = ROBOT.of_joint(4)
    for name in ("encoder_offset", "encoder_zero_change"):
        np.testing.assert_allclose(effect(name).term(signals, [2e-4], []).reading, -2e-4)
    shift = effect("encoder_skew").term(ROBOT, [2e-3], []).reading
    np.testing.assert_allclose(shift, 2e-3 * ROBOT.link_velocity)


@pytest.mark.parametrize("delay", [1e-3, 0.013, 0.05, -0.012])
def test_time_delay_shifts_torque(delay: float):
    """Long against the motion too, where no slope tells what it does."""
    time = 0.01 * np.arange(400)
    wave = np.sin(9.0 * time[:, None] + np.arange(6))
    late = effect("time_delay").term(replace(ROBOT, drive_torque=wave), [delay], [delay])
    expected = np.sin(9.0 * (time[:, None] - delay) + np.arange(6)) - wave
    np.testing.assert_allclose(late.drive_torque[10:-4], expected[10:-4], atol=1e-4)
    if abs(delay) < 0.01:
        slope = -delay * 9.0 * np.cos(9.0 * time[:, None] + np.arange(6))
        np.testing.assert_allclose(late.drive_torque[10:-2], slope[10:-2], atol=1e-4)
    own = replace(ROBOT, drive_torque=wave, link=2)
    one = effect("joint_delay").term(own, [delay], [delay]).drive_torque
    np.testing.assert_array_equal(one, late.drive_torque * (np.arange(6) == 2))


@pytest.mark.parametrize("step", [1e-3, 0.01])
@pytest.mark.parametrize("constant", [2e-3, 0.05])
def test_reading_filter_is_a_first_order_lag_at_any_sampling_rate(constant: float, step: float):
    time, rate = np.arange(0.0, 4.0, step), 9.0
    wave = np.sin(rate * time)[:, None] * np.ones(6)
    run = replace(ROBOT, time=time, dt=step, drive_torque=wave)
    filtered = effect("reading_filter").term(run, [constant], [constant]).drive_torque
    gain, behind = 1.0 / np.hypot(1.0, constant * rate), np.arctan(constant * rate)
    expected = gain * np.sin(rate * time - behind) - np.sin(rate * time)
    settled = time > 1.0
    np.testing.assert_allclose(filtered[settled, 0], expected[settled], atol=1e-3)


@pytest.mark.parametrize("bend", [1.0, 1.5, 10.0])
def test_gravity_spring_reports_stiffness_at_rest_angle(bend: float):
    signals = ROBOT.of_joint(4)
    spring = effect("gravity_spring")
    amplitudes = [4.0, -3.0, 1.5]
    found = spring.parameters(amplitudes, [bend], replace(signals.constants, stroke=(0.0, 1.0)))
    angles = found["offset"] + np.array([-1e-4, 0.0, 1e-4])
    at_rest = replace(signals, link_position=angles)
    torque = spring.term(at_rest, amplitudes, [bend]).link_torque
    assert abs(found["offset"] - 0.5) <= np.pi * bend
    assert torque[1] == pytest.approx(0.0, abs=1e-12)
    assert (torque[2] - torque[0]) / 2e-4 == pytest.approx(found["k"])


def test_belt_creep_applies_only_with_a_belt():
    joint = ROBOT.of_joint(1).constants
    creep = effect("belt_creep")
    assert creep.applies is not None
    assert creep.applies(joint)
    assert creep.applies(replace(joint, belt=True))
    assert not creep.applies(replace(joint, belt=False))


def test_weighted_shape_reports_slope_at_zero():
    signals = ROBOT.of_joint(4)
    torque = np.linspace(-60.0, 60.0, 12001)
    loaded = replace(signals, spring_torque=torque)
    entry = effect("k1_softening")
    slopes = []
    for weight in (1.0, 0.6):
        angle = entry.term(loaded, [weight], [0.4, 1.2]).deflection
        nominal = signals.constants.windup(torque) - torque / signals.constants.contact_stiffness
        slope = np.interp(1.0, torque, np.gradient(angle + nominal, torque))
        slopes.append(entry.parameters([weight], [0.4, 1.2], signals.constants)["k1_factor"])
        assert 1.0 / (slope * 1.6e4) == pytest.approx(slopes[-1], rel=1e-9)
    assert slopes[0] == pytest.approx(0.4)
    warm = effect("thermal_friction")
    values = []
    for rise in (1e-3, -1e-3):
        heated = replace(signals, temperature_rise=np.full(60, rise))
        values.append(warm.term(heated, [0.7, 0.0], [0.03]).drive_torque)
    lost = -(values[0] - values[1]) / 2e-3 / (3.0 * signals.motor_velocity)
    reported = warm.parameters([0.7, 0.0], [0.03], signals.constants)["b"]
    np.testing.assert_allclose(lost, reported, rtol=1e-6)


@pytest.mark.parametrize("name", ["backlash", "load_friction", "preload_loss"])
def test_initial_shapes_scale_with_carried_load(name: str):
    """Shares of a rated torque of 333 kN m, as of a limit of 1e6 N m, are no load of any arm's."""
    usual = replace(ROBOT.of_joint(4).constants, torque_rated=60.0, torque_max=180.0)
    placeholder = replace(usual, torque_rated=333e3, torque_max=1e6)
    shape = effect(name).shapes[0]
    carried = np.array(shape.grid(placeholder)) * placeholder.torque_rated
    assert carried == pytest.approx(np.array(shape.grid(usual)) * usual.largest_torque)
    rule = effect(name).possible
    assert rule is not None
    for constants, rated in ((usual, 60.0), (placeholder, usual.largest_torque)):
        least = 1e-6 * rated / constants.torque_rated
        others = [s.grid(constants)[0] for s in effect(name).shapes[1:]]
        assert rule([shape.grid(constants)[0], *others], constants)
        assert not rule([least, *others], constants)


@pytest.mark.parametrize("name", ["backlash", "load_friction", "preload_loss"])
def test_initial_shapes_are_within_bounds_and_continuous(name: str):
    """Whatever a joint carries of its limit: a shape below its bound no file could state."""
    constants, shape = ROBOT.of_joint(4).constants, effect(name).shapes[0]
    before = None
    for ratio in np.geomspace(1.0, 1e7, 400):  # 4 % apart
        rated = ratio * constants.largest_torque
        starts = shape.grid(replace(constants, torque_rated=rated, torque_max=3.0 * rated))
        assert all(shape.lower <= start <= shape.upper for start in starts)
        if before is None or ratio <= 13.0:  # a wrist of usual size
            first = starts[0]
        assert starts[0] == first or 0.9 * before <= starts[0] <= before
        before = starts[0]
    nothing = replace(constants, largest_torque=1e-9)
    assert shape.grid(nothing) == (shape.lower,)
