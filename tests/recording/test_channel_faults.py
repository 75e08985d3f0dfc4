"""Every fault that sensors and loggers make is found, named and taken out; nothing else is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recording_sets import Columns, channels, motion

from stiffopt.errors import InputFileError
from stiffopt.recording.clean import clean_run
from stiffopt.recording.run import Fault, RecordedRun
from stiffopt.recording.signals import Signals

SIGNALS = Signals(
    time="t",
    position=("q1", "q2"),
    velocity=("qd1", "qd2"),
    link_position=("ql1", ""),
    torque=("tau1", "tau2"),
)


def cleaned(columns: Columns, signals: Signals = SIGNALS) -> RecordedRun:
    return clean_run(
        columns,
        signals,
        path=Path("run.npz"),
        name="run",
        file="run.npz",
        role="train",
        prismatic=np.array([False, True]),
    )


def only_fault(run: RecordedRun) -> Fault:
    assert len(run.faults) == 1, [str(fault) for fault in run.faults]
    return run.faults[0]


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("rate", [100.0, 500.0])
def test_valid_run_has_no_fault(seed: int, rate: float) -> None:
    run = cleaned(motion(rate=rate, seed=seed))
    assert run.faults == ()
    assert np.isfinite(run.torque).all()


def test_unused_zero_channel_is_removed(columns: Columns) -> None:
    signals = Signals(
        time="t",
        position=("q1", "q2"),
        velocity=("qd1", "qd2"),
        link_position=("ql1", "ql2"),
        torque=("tau1", "tau2"),
    )
    columns["ql2"] = np.zeros_like(columns["t"])
    fault = only_fault(run := cleaned(columns, signals))
    assert (fault.signal, fault.joint, fault.kind, fault.left_out) == (
        "link_position",
        2,
        "constant",
        True,
    )
    assert run.link_position is not None
    assert np.isnan(run.link_position[:, 1]).all()
    # Also in a joint that stands still, where a real encoder might not change either.
    columns["q2"] = np.full_like(columns["t"], 0.3)
    columns["qd2"] = np.zeros_like(columns["t"])
    assert only_fault(cleaned(columns, signals)).signal == "link_position"
    columns["ql1"] = columns["ql2"]
    run = cleaned(columns, signals)
    assert run.link_position is None


@pytest.mark.parametrize(("column", "signal"), [("tau2", "torque"), ("qd1", "velocity")])
@pytest.mark.parametrize("level", [0.0, 3.7])
def test_constant_channel_is_removed(
    columns: Columns, column: str, signal: str, level: float
) -> None:
    columns[column] = np.full_like(columns["t"], level)
    fault = only_fault(run := cleaned(columns))
    assert (fault.signal, fault.kind, fault.left_out) == (signal, "constant", True)
    assert f"{level:g}" in fault.detail
    array = run.torque if signal == "torque" else run.velocity
    assert array is not None
    j = int(column[-1]) - 1
    assert np.isnan(array[:, j]).all()
    assert np.isfinite(array[:, 1 - j]).all()


def test_stationary_joint_is_no_fault(columns: Columns) -> None:
    rng = np.random.default_rng(3)
    columns["q2"] = 0.2 + 1e-6 * rng.integers(-1, 2, len(columns["t"]))
    columns["qd2"] = np.zeros_like(columns["t"])
    assert cleaned(columns).faults == ()


def test_constant_motor_encoder_makes_the_run_unusable(columns: Columns) -> None:
    columns["q1"] = np.full_like(columns["t"], 0.4)
    run = cleaned(columns)
    assert (run.faults[0].signal, run.faults[0].kind) == ("position", "constant")
    assert not run.usable


@pytest.mark.parametrize(
    ("column", "factor", "says"),
    [
        ("qd1", 180.0 / np.pi, "57.3 times as much .* as degrees would"),
        ("qd2", -1.0, "the other way round"),
        ("ql1", 180.0 / np.pi, "as degrees would"),
        ("ql1", -1.0, "the other way round"),
    ],
)
def test_contradicting_sensors_are_removed(
    columns: Columns, column: str, factor: float, says: str
) -> None:
    columns[column] *= factor
    fault = only_fault(cleaned(columns))
    assert fault.kind == "contradicts position"
    assert fault.left_out
    import re

    assert re.search(says, fault.detail)


def test_swapped_encoders_are_reported(columns: Columns) -> None:
    columns["ql1"] = columns["q2"] + 1e-5 * np.random.default_rng(0).normal(size=2500)
    fault = only_fault(cleaned(columns))
    assert (fault.signal, fault.kind) == ("link_position", "contradicts position")
    assert "another joint" in fault.detail


def test_stuck_torque_samples_are_removed(columns: Columns) -> None:
    columns["tau1"][700:900] = columns["tau1"][700]
    fault = only_fault(run := cleaned(columns))
    assert (fault.kind, fault.left_out) == ("constant", False)
    lost = np.flatnonzero(np.isnan(run.torque[:, 0]))
    assert lost.tolist() == list(range(701, 900))
    assert fault.share == pytest.approx(199 / 2500)


def test_stuck_link_encoder_samples_are_removed(columns: Columns) -> None:
    columns["ql1"][1000:1100] = columns["ql1"][1000]
    fault = only_fault(cleaned(columns))
    assert (fault.signal, fault.kind) == ("link_position", "constant")
    assert fault.share == pytest.approx(99 / 2500)


def test_stuck_motor_encoder_samples_are_removed(columns: Columns) -> None:
    columns["q1"][1000:1100] = columns["q1"][1000]
    fault = only_fault(cleaned(columns))
    assert (fault.signal, fault.kind) == ("position", "constant")
    assert fault.share == pytest.approx(99 / 2500)


def held_by_friction(columns: Columns) -> None:
    """A motor that stands for 0.4 s while its link goes on on the spring, and starts again."""
    t, count = columns["t"], 2.0 * np.pi / 2**17 / 100.0
    before, after = np.minimum(t - 4.0, 0.0), np.maximum(t - 4.4, 0.0)
    motor = 0.5 * (1.0 - np.cos(1.3 * after)) - 0.5 * (1.0 - np.cos(1.3 * before))
    columns["q1"] = count * np.round(motor / count)
    columns["qd1"] = 0.65 * (np.sin(1.3 * after) - np.sin(1.3 * before))
    columns["ql1"] = columns["q1"] - 0.004 * np.sin(9.0 * t)


def stuck_faults(columns: Columns) -> list[Fault]:
    return [fault for fault in cleaned(columns).faults if "stuck" in fault.detail]


def test_motor_held_by_friction_is_not_stuck(columns: Columns) -> None:
    held_by_friction(columns)
    assert cleaned(columns).faults == ()


def test_motor_encoder_recovering_with_a_jump_is_stuck(columns: Columns) -> None:
    held_by_friction(columns)
    columns["q1"][columns["t"] > 4.4] += 0.004
    (fault,) = stuck_faults(columns)
    assert (fault.signal, fault.joint) == ("position", 1)


@pytest.mark.parametrize(("begin", "until"), [(3.3, 4.3), (9.0, 99.0)])
def test_motor_encoder_losing_counts_is_stuck(columns: Columns, begin: float, until: float) -> None:
    held_by_friction(columns)
    t, motor = columns["t"], columns["q1"]
    held = (t > begin) & (t < until)
    motor[t >= until] -= motor[held][-1] - motor[held][0]
    motor[held] = motor[held][0]
    (fault,) = stuck_faults(columns)
    assert (fault.signal, fault.joint) == ("position", 1)


def test_spikes_are_removed_individually(columns: Columns) -> None:
    places = [200, 777, 778, 1500]
    columns["tau1"][places] += [6.0, -9.0, -9.0, 25.0]
    columns["q1"][[444]] += 0.002
    run = cleaned(columns)
    assert {(fault.signal, fault.kind) for fault in run.faults} == {
        ("torque", "outlier"),
        ("position", "outlier"),
    }
    assert np.flatnonzero(np.isnan(run.torque[:, 0])).tolist() == places
    assert np.flatnonzero(np.isnan(run.position[:, 0])).tolist() == [444]


def test_friction_steps_and_contacts_are_no_spikes(columns: Columns) -> None:
    t = columns["t"]
    columns["tau1"] += np.where((t > 3.0) & (t < 3.4), 12.0, 0.0)
    columns["tau2"] += 8.0 * np.sign(np.sin(3.0 * t))
    assert cleaned(columns).faults == ()


def test_torque_saturation_is_reported_and_kept(columns: Columns) -> None:
    columns["tau1"] = np.clip(columns["tau1"], -6.0, 6.0)
    fault = only_fault(run := cleaned(columns))
    assert (fault.kind, fault.left_out) == ("saturated", False)
    assert fault.share == pytest.approx((np.abs(columns["tau1"]) == 6.0).mean())
    np.testing.assert_array_equal(run.torque[:, 0], columns["tau1"])


def test_wrapped_angles_are_unwrapped(columns: Columns) -> None:
    t = columns["t"]
    angle = 0.5 + 2.5 * np.sin(1.3 * t) + 1.5 * t
    rng = np.random.default_rng(7)
    for name, noise in (("q1", 1e-6), ("ql1", 1e-5)):
        full = angle + noise * rng.normal(size=len(t))
        columns[name] = np.mod(full + np.pi, 2.0 * np.pi) - np.pi
    columns["qd1"] = 3.25 * np.cos(1.3 * t) + 1.5 + 1e-3 * rng.normal(size=len(t))
    run = cleaned(columns)
    assert {(f.signal, f.kind, f.left_out) for f in run.faults} == {
        ("position", "wrapped", False),
        ("link_position", "wrapped", False),
    }
    np.testing.assert_allclose(run.position[:, 0], angle, atol=1e-5)
    assert run.link_position is not None
    np.testing.assert_allclose(run.link_position[:, 0], angle, atol=1e-4)


def test_coarse_quantisation_is_reported_and_kept(columns: Columns) -> None:
    step = 0.2
    columns["tau2"] = np.round(columns["tau2"] / step) * step
    fault = only_fault(run := cleaned(columns))
    assert (fault.signal, fault.kind, fault.left_out) == ("torque", "quantised", False)
    assert "steps of 0.2" in fault.detail
    assert np.isfinite(run.torque).all()


def test_samples_that_are_no_numbers_are_reported(columns: Columns) -> None:
    columns["tau1"][5:9] = np.nan
    columns["ql1"][:] = np.inf
    run = cleaned(columns)
    told = {(fault.signal, fault.kind, fault.left_out) for fault in run.faults}
    assert told == {
        ("torque", "not finite", False),
        ("link_position", "not finite", True),
    }
    assert run.link_position is None


def stamped(stamps: np.ndarray) -> Columns:
    return {"t": stamps, **channels(stamps, np.random.default_rng(4))}


def test_jitter_is_reported_with_its_size() -> None:
    rng = np.random.default_rng(5)
    stamps = np.cumsum(np.full(2000, 0.004) + 0.0006 * rng.uniform(-1.0, 1.0, 2000))
    fault = only_fault(cleaned(stamped(stamps)))
    assert fault.kind == "jitter"
    assert fault.share > 0.5


def test_dropped_samples_and_gaps_are_distinguished() -> None:
    keep = np.ones(2500, dtype=bool)
    keep[[300, 901, 902, 1500]] = False
    keep[2000:2100] = False
    run = cleaned(stamped(0.004 * np.arange(2500)[keep]))
    faults = {fault.kind: fault for fault in run.faults}
    assert set(faults) == {"dropped", "gap"}
    assert "about 4 samples" in faults["dropped"].detail
    assert "1 gap " in faults["gap"].detail
    assert "0.404 s" in faults["gap"].detail


def test_repeated_stamps_keep_the_first_row(columns: Columns) -> None:
    places = np.sort(np.append(np.arange(2500), [100, 100, 2000]))
    repeated = {name: values[places] for name, values in columns.items()}
    fault = only_fault(run := cleaned(repeated))
    assert fault.kind == "duplicate"
    np.testing.assert_array_equal(run.time, columns["t"])
    np.testing.assert_array_equal(run.stamps, repeated["t"])


def test_repeated_rows_under_new_stamps_are_removed(columns: Columns) -> None:
    stale = [250, 251, 1200]
    for name, values in columns.items():
        if name != "t":
            values[[250, 251]] = values[249]
            values[1200] = values[1199]
    fault = only_fault(run := cleaned(columns))
    assert fault.kind == "duplicate"
    assert np.isin(columns["t"][stale], run.time).sum() == 0
    assert len(run.time) == 2497


def test_the_motion_of_a_run_does_not_depend_on_its_torque(columns: Columns) -> None:
    """Whatever the torque is replaced by, time and positions stay the same."""
    columns["t"] = columns["t"] + 0.0003 * np.sin(columns["t"] * 900.0)
    first = cleaned(columns)
    for replacement in (np.zeros(2500), np.random.default_rng(1).normal(size=2500)):
        other = cleaned({**columns, "tau1": replacement, "tau2": replacement})
        np.testing.assert_array_equal(other.time, first.time)
        np.testing.assert_array_equal(other.position, first.position)
        np.testing.assert_array_equal(other.link_position, first.link_position)


@pytest.mark.parametrize(
    ("stamps", "says"),
    [
        (np.r_[np.arange(50.0), 20.0, np.arange(51.0, 90.0)] / 100.0, "row 51: .*backwards 1 time"),
        (np.zeros(100), "only 1 different times in 100 rows"),
        (np.full(100, np.nan), "has 0 time stamps"),
        (np.arange(8.0) / 100.0, "has 8 time stamps; a run needs 20"),
        (np.arange(100.0) * 4e6, "usual spacing is 4e.06; .*Convert the column to seconds"),
    ],
)
def test_unusable_clocks_are_refused(stamps: np.ndarray, says: str) -> None:
    with pytest.raises(InputFileError, match=says):
        cleaned({"t": stamps, **{name: np.arange(float(len(stamps))) for name in SIGNALS.wanted}})


def test_missing_stamps_are_interpolated(columns: Columns) -> None:
    columns["t"][[40, 41]] = np.nan
    run = cleaned(columns)
    assert {fault.kind for fault in run.faults} == {"not finite", "dropped"}
    assert len(run.time) == 2498
    np.testing.assert_allclose(run.stamps, 0.004 * np.arange(2500), atol=1e-12)


@pytest.mark.parametrize("held", [True, False], ids=["the row before", "zeros"])
def test_rows_of_a_lost_connection_are_removed(columns: Columns, held: bool) -> None:
    """All of them, though nothing moves between them: the arm is elsewhere behind them."""
    before = {name: values.copy() for name, values in columns.items()}
    lost = slice(1000, 1030)
    for name, values in columns.items():
        if name != "t":
            values[lost] = values[999] if held else 0.0
    run = cleaned(columns)
    kept = np.delete(before["t"], lost)
    np.testing.assert_array_equal(run.time, kept)
    (fault,) = [fault for fault in run.faults if fault.kind == "duplicate"]
    assert "in 30 rows, left out" in fault.detail
    assert ("read 0" in fault.detail) is not held
    np.testing.assert_array_equal(run.torque[:, 0], np.delete(before["tau1"], lost))


def resting(t: np.ndarray, progress: np.ndarray) -> RecordedRun:
    """Run of two joints on encoders of 1e-4 rad, whose torques have noise."""
    count = 1e-4
    rng = np.random.default_rng(0)
    signals = Signals(
        time="t", position=("q1", "q2"), velocity=None, link_position=None, torque=("a", "b")
    )
    columns = {"t": t, "q1": count * np.round(progress / count), "q2": np.cos(0.9 * t)}
    columns["q2"][t >= 10.0] = columns["q2"][t >= 10.0][0]
    columns["a"] = 10.0 * np.cos(progress) + 0.3 * rng.normal(size=len(t))
    columns["b"] = 3.0 * np.cos(columns["q2"]) + 0.3 * rng.normal(size=len(t))
    return cleaned(columns, signals)


@pytest.mark.parametrize(
    ("rate", "length", "samples"),
    [(100.0, 8e-4, 1), (1000.0, 8e-4, 1), (20.0, 0.01, 1), (10.0, 0.02, 2)],
    ids=["stick-slip", "stick-slip, fast", "inching", "inching in two samples"],
)
def test_rest_between_short_moves_is_no_lost_data(rate: float, length: float, samples: int) -> None:
    t = np.arange(0.0, 20.0, 1.0 / rate)
    seconds = np.maximum(0.0, t - 10.0)
    moved = np.floor(seconds) + np.minimum(1.0, ((seconds % 1.0) * rate + 1.0) / samples)
    run = resting(t, 0.5 * np.sin(1.1 * np.minimum(t, 10.0)) + length * moved * (t >= 10.0))
    assert "duplicate" not in {fault.kind for fault in run.faults}
    np.testing.assert_array_equal(run.time, t)


@pytest.mark.parametrize("rate", [5.0, 10.0, 100.0])
def test_pick_and_place_is_no_lost_data(rate: float) -> None:
    t = np.arange(0.0, 40.0, 1.0 / rate)
    s = np.minimum(1.0, (t % 2.0) / 0.25)
    s = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    run = resting(t, 0.6 * np.where(t // 2.0 % 2.0 == 0.0, s, 1.0 - s))
    np.testing.assert_array_equal(run.time, t)


def test_constant_positions_with_changing_torque_are_kept(columns: Columns) -> None:
    """Only what nothing shows a change of was not received."""
    for name, values in columns.items():
        if not name.startswith("t"):
            values[1000:1030] = values[999]
    assert len(cleaned(columns).time) == 2500


def test_missing_positions_are_reported_without_warnings(columns: Columns) -> None:
    """A warning of the numbers' library would fail."""
    columns["q1"][:] = np.nan
    for name, values in columns.items():
        if name != "t":
            values[1000:1030] = values[999]
    run = cleaned(columns)
    assert len(run.time) == 2470
    assert "no sample is a number" in run.faults[1].detail


@pytest.mark.parametrize("evenly", [True, False])
def test_stamps_that_jitter_are_told_from_samples_that_do(evenly: bool) -> None:
    """Motion is smooth over the instants at which it was sampled, whatever a logger wrote."""
    even, kept = 0.004 * np.arange(2000), np.ones(2000, dtype=bool)
    kept[[500, 1201]] = False
    kept[1500:1550] = False
    stamps = even + 0.0006 * np.random.default_rng(5).uniform(-1.0, 1.0, len(even))
    columns = {name: own[kept] for name, own in stamped(even if evenly else stamps).items()}
    columns["t"] = stamps[kept]
    run = cleaned(columns)
    np.testing.assert_array_equal(run.recorded_stamps, stamps[kept])
    if evenly:
        (fault,) = (each for each in run.faults if each.kind == "jitter")
        assert "even stamps" in fault.detail
        assert np.std(run.time - even[kept]) < 0.2 * np.std(stamps - even)
        np.testing.assert_array_equal(run.time, run.stamps)
    else:
        np.testing.assert_array_equal(run.time, stamps[kept])


@pytest.mark.parametrize("prismatic", [False, True])
def test_offset_and_noise_of_a_velocity_are_no_motion(columns: Columns, prismatic: bool) -> None:
    """A servo that reports half a count at rest: its resting encoder is not dead."""
    draw = np.random.default_rng(5)
    name = "2" if prismatic else "1"
    columns[f"q{name}"] = np.full_like(columns["t"], 0.0109)
    columns[f"qd{name}"] = -0.0073 + 0.0146 * draw.integers(0, 2, len(columns["t"]))
    columns["ql1"] = columns["q1"]
    run = cleaned(columns)
    assert run.usable
    assert not [fault for fault in run.faults if fault.signal == "position"]


def test_a_velocity_with_an_offset_follows_its_position() -> None:
    """The offset shows where the joint rests; a velocity of another unit still contradicts."""
    columns = motion()
    rest = np.repeat([0.0, 1.0], [1000, len(columns["t"])])
    for name in ("q1", "qd1", "ql1", "tau1", "q2", "qd2", "tau2"):
        first = 0.0 if name.startswith("qd") else columns[name][0]
        columns[name] = np.concatenate([np.full(1000, first), columns[name]])
    columns["t"] = np.arange(len(rest)) * (columns["t"][1] - columns["t"][0])
    columns["qd1"] = columns["qd1"] + 0.5
    kinds = {(f.signal, f.kind) for f in cleaned(columns).faults}
    assert ("velocity", "contradicts position") not in kinds
    columns["qd1"] = 57.3 * columns["qd1"]
    kinds = {(f.signal, f.kind) for f in cleaned(columns).faults}
    assert ("velocity", "contradicts position") in kinds


def test_noise_of_two_counts_is_no_saturation(columns: Columns) -> None:
    draw = np.random.default_rng(6)
    columns["tau1"] = -0.0396 + 0.0264 * draw.integers(0, 2, len(columns["t"]))
    assert not [fault for fault in cleaned(columns).faults if fault.kind == "saturated"]
