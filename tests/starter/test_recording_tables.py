"""Tables as loggers and spreadsheets write them: heads, clocks, units, and what has no factor."""

from __future__ import annotations

import json
import re
import tomllib
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from small_arms import ROOT

from stiffopt.cli import run
from stiffopt.errors import InputError, InputFileError
from stiffopt.recording.readers.clocks import parse_stamps
from stiffopt.recording.readers.read import read_tables
from stiffopt.recording.recording_set import load_recordings
from stiffopt.robot.files import load_robot
from stiffopt.starter.guessing import guess_columns
from stiffopt.starter.table_layouts import _joint_fields, join_signal_files, name_blocks

URDF = ROOT / "problems" / "recordings" / "two_link_friction" / "robot.urdf"
NAMES = ["t", "q1", "q2", "tau1", "tau2"]
TIME = np.arange(0.0, 4.0, 0.005)
VALUES = [np.sin(TIME), 0.8 * np.cos(2.0 * TIME), 9.0 * np.sin(3.0 * TIME), 4.0 * np.cos(TIME)]


def lines(names=NAMES, columns=None, mark=",", form="{:.9g}"):
    rows = np.column_stack([TIME, *VALUES] if columns is None else columns)
    body = [mark.join(form.format(value) for value in row) for row in rows]
    return [mark.join(names), *body] if names else body


def table(folder, text):
    path = folder / "log.csv"
    path.write_text("\n".join(text))
    return read_tables(path)[""]


def guessed(folder, text):
    return guess_columns(table(folder, text), load_robot(URDF))


def comma(text):
    return [line.replace(",", ";").replace(".", ",") for line in text]


@pytest.mark.parametrize(
    "text",
    [
        ["sep=;", *comma(lines())],
        ["Robot: KR6", "Date: 2024-05-01", "Operator: Meier, H.", "", *lines()],
        ["t,q1,q2,tau1,tau2", "s,rad,rad,Nm,Nm", *lines(names=None)],
        lines(names=['"t"', '"q1"', '"q2"', '"tau1"', '"tau2"']),
        [lines()[0]]
        + [",".join(f'"{c}"'.replace(".", ",") for c in row.split(",")) for row in lines(None)],
        [*lines(), "3.99"],
    ],
    ids=["excel", "prose", "units", "quotes", "quoted decimal commas", "cut off"],
)
def test_table_headers_are_read(text, tmp_path):
    found = guess_columns(table(tmp_path, text), load_robot(URDF))
    assert [found.columns["torque"][k][:4] for k in (0, 1)] == ["tau1", "tau2"]
    assert found.rate == pytest.approx(200.0)
    assert not any(found.units.values())


@pytest.mark.parametrize(
    "form",
    ["%Y-%m-%d %H:%M:%S.%f", "%H:%M:%S.%f", "%d.%m.%Y %H:%M:%S.%f", "%m/%d/%Y %I:%M:%S.%f %p",
     "%I:%M:%S.%f %p"],
)  # fmt: skip
@pytest.mark.parametrize("hour", [11, 23])
def test_time_formats_are_read(form, hour, tmp_path):
    begin = datetime(2024, 5, 1, hour, 59, 58)
    stamps = [(begin + timedelta(seconds=float(t))).strftime(form) for t in TIME]
    text = [row.split(",", 1)[1] for row in lines(names=None)]
    head = [
        ";".join(NAMES),
        *(f"{s};{r.replace(',', ';')}" for s, r in zip(stamps, text, strict=True)),
    ]
    found = table(tmp_path, head)
    assert found["t"] == pytest.approx(TIME, abs=1e-6)


def test_midnight_within_a_gap_is_unwrapped(tmp_path):
    """The stamps about midnight are missing."""
    begin = datetime(2024, 5, 1, 23, 59, 58)
    stamps = [f"{begin + timedelta(seconds=float(t)):%H:%M:%S.%f}" for t in TIME]
    stamps[395:405] = [""] * 10
    rows = [row.split(",", 1)[1] for row in lines(names=None)]
    text = [",".join(NAMES), *(f"{s},{r}" for s, r in zip(stamps, rows, strict=True))]
    found = table(tmp_path, text)["t"]
    there = np.isfinite(found)
    assert np.sum(~there) == 10
    assert found[there] == pytest.approx(TIME[there], abs=1e-6)


@pytest.mark.parametrize("mark", [".", ","])
def test_minutes_and_seconds_of_a_spreadsheet(mark):
    """`mm:ss.000`, which shows no hours."""
    begin = datetime(2024, 5, 1, 10, 59, 58)
    cells = [f"{begin + timedelta(seconds=float(t)):%M:%S.%f}".replace(".", mark) for t in TIME]
    assert (cells[0][:5], cells[-1][:5]) == ("59:58", "00:01")
    assert parse_stamps(cells) == pytest.approx(TIME, abs=1e-6)
    assert parse_stamps(["00:01.5", "00:01.6", "00:02.0"]) == pytest.approx([0.0, 0.1, 0.5])
    # Hours and minutes have no decimals.
    assert parse_stamps(["00:01", "00:03"]) == pytest.approx([0.0, 120.0])


@pytest.mark.parametrize("form", ["%Y-%m-%d %H:%M:%S", "%d.%m.%Y %H:%M:%S", "%m/%d/%Y %H:%M:%S"])
def test_dates_that_step_back_stay_as_they_are(form):
    at = [datetime(2024, 5, day, 12) for day in (2, 3, 1, 2)]
    found = parse_stamps([each.strftime(form) for each in at])
    assert np.any(np.diff(found) < 0.0)
    if form.startswith("%Y"):
        assert found == pytest.approx([0.0, 86400.0, -86400.0, 0.0])


@pytest.mark.parametrize(
    ("second", "rest", "name"),
    [
        ("header.stamp.sec", "header.stamp.nanosec", "header.stamp"),
        ("sec", "nsec", "stamp"),
        ("%time.secs", "time.nsecs", "time"),
    ],
)
def test_seconds_with_nanoseconds_are_one_clock(second, rest, name, tmp_path):
    whole = np.floor(TIME)
    columns = [whole + 1.7e9, np.round(1e9 * (TIME - whole)), *VALUES]
    text = lines([second, rest, *NAMES[1:]], columns, form="{:.12g}")
    found = guessed(tmp_path, text)
    assert (found.time, found.units["time"]) == (name, "")
    assert found.rate == pytest.approx(200.0)
    assert table(tmp_path, text)[name] == pytest.approx(TIME, abs=1e-9)


def test_row_counter_is_not_a_time(tmp_path, capsys):
    text = lines(["sample", *NAMES[1:]], [np.arange(len(TIME)), *VALUES])
    with pytest.raises(InputError, match="Give --rate HZ"):
        guessed(tmp_path, text)
    arguments = ["init", "recording", str(tmp_path / "log.csv"), "--urdf", str(URDF)]
    assert run([*arguments, "--rate", "-1"]) == 2
    assert run([*arguments, "--rate", "200"]) == 0
    assert "200 rows a second" in capsys.readouterr().out
    document = tomllib.loads((tmp_path / "log_set" / "recordings.toml").read_text())
    assert document["signals"]["time"] == "counted_time"


def test_units_in_names(tmp_path):
    names = ["t", "q1 [mrad]", "q2 [mrad]", "tau1 [Ncm]", "tau2 [Ncm]"]
    found = guessed(tmp_path, lines(names))
    assert found.units["position"] == "mrad"
    assert found.units["torque"] == "N*cm"


def test_unused_columns_are_listed(tmp_path):
    found = guessed(tmp_path, lines([*NAMES, "q3", "temp"], [TIME, *VALUES, TIME, TIME]))
    assert "not used: q3, temp" in found.reasons


@pytest.mark.parametrize(
    ("names", "factor", "asked", "said"),
    [
        (["t", "q1", "q2", "torque1 [%]", "torque2 [%]"], 1.0, "are stated in %.", "N m per %"),
        (NAMES, 1e6, "signals.scale.position", "rad per count"),
    ],
)
def test_unknown_scale_factor_is_required_from_user(names, factor, asked, said, tmp_path, capsys):
    columns = [TIME, *(factor * v for v in VALUES[:2]), *VALUES[2:]]
    (tmp_path / "log.csv").write_text("\n".join(lines(names, columns)))
    arguments = ["init", "recording", str(tmp_path / "log.csv"), "--urdf", str(URDF)]
    assert run(arguments) == 0
    assert said in capsys.readouterr().out
    folder = tmp_path / "log_set"
    assert run(["recording", "check", str(folder)]) == 2
    assert asked in capsys.readouterr().err
    text = (folder / "recordings.toml").read_text()
    unit = '"%"' if "%" in said else '"counts"'
    (folder / "recordings.toml").write_text(text.replace(unit, "1e-6"))
    assert load_recordings(folder).runs


def test_motor_currents_are_recognised_by_letter(tmp_path):
    found = guessed(tmp_path, lines(["t", "q1", "q2", "i1", "i2"]))
    assert found.columns["torque"] == ("i1", "i2")
    assert found.units["torque"] == "A"


def test_a_table_without_names_is_told_what_to_write(tmp_path):
    found = table(tmp_path, lines(names=None, columns=[TIME, *VALUES[:2]]))
    with pytest.raises(InputError, match=r"3 columns without names.*Give it one line of 3"):
        name_blocks(found, load_robot(URDF))


def test_a_table_of_one_row_is_no_recording(tmp_path):
    with pytest.raises(InputError, match="increases as a time"):
        guessed(tmp_path, lines()[:2])


def test_one_counted_row_is_no_recording(tmp_path, capsys):
    (tmp_path / "log.csv").write_text("\n".join(lines()[:2]))
    arguments = ["init", "recording", str(tmp_path / "log.csv"), "--urdf", str(URDF)]
    assert run([*arguments, "--rate", "200"]) == 2
    assert "shows no motion" in capsys.readouterr().err


def test_increasing_clock_precedes_constant_or_restarting_ones(tmp_path):
    names = ["stamp.sec", "stamp.nsec", "stamp", *NAMES[1:]]
    seconds, rest = np.floor(TIME), np.round(1e9 * (TIME % 1.0))
    assert guessed(tmp_path, lines(names, [seconds, rest, TIME, *VALUES])).time == "stamp"
    with pytest.raises(InputError, match="increases as a time"):
        guessed(tmp_path, lines(columns=[0.0 * TIME, *VALUES]))


def test_repeated_stamps_are_not_counted_as_steps(tmp_path):
    stamps = np.repeat(TIME[::5], 5)
    assert guessed(tmp_path, lines(columns=[stamps, *VALUES])).rate == pytest.approx(40.0)


@pytest.mark.parametrize(
    ("position", "factor", "unit", "unsure"),
    [
        ("rad", 1.0, "", False),
        ("rad", 57.3, "deg/s", False),
        ("mrad", 57.3, "deg/s", False),
        ("deg", 9.549, "rpm", False),
        ("rad", 1000.0, "", True),
        ("counts", 57.3, "", True),
    ],
)
def test_speed_unit_is_guessed_from_positions(position, factor, unit, unsure, tmp_path):
    each = {"rad": 1.0, "deg": 57.3, "mrad": 1e3, "counts": 1e6}[position]
    columns = [each * v for v in VALUES[:2]] + [factor * np.gradient(v, TIME) for v in VALUES[:2]]
    names = ["t", f"q1 [{position}]", f"q2 [{position}]", "qd1", "qd2", *NAMES[3:]]
    found = guessed(tmp_path, lines(names, [TIME, *columns, *VALUES[2:]]))
    assert found.units["velocity"] == unit
    (said,) = (reason for reason in found.reasons if reason.startswith("velocity"))
    assert said.endswith("check") == unsure


@pytest.mark.parametrize(
    ("beyond", "unit"), [(0.5 * np.pi, ""), (0.9 * np.pi, ""), (1.2 * np.pi, "deg")]
)
def test_angles_beyond_a_limit_are_degrees_only_where_no_zero_explains_them(beyond, unit, tmp_path):
    """Another zero or a sum of two joints is still in rad: dynamics tell it later."""
    upper = load_robot(URDF).position_upper[0]
    first = (upper + beyond) * VALUES[0] / VALUES[0].max()
    assert upper + beyond < 4.0 * np.pi
    assert guessed(tmp_path, lines(columns=[TIME, first, *VALUES[1:]])).units["position"] == unit


@pytest.mark.parametrize("name", [[["x"]], [{"a": 1}], np.array([1.0, 2.0]), 5, "arm"])
def test_message_names_other_than_joints_are_ignored(name):
    found = _joint_fields("/t", {"name": name, "position": [1.0, 2.0]}, ["a", "b"])
    assert found == ["/t.position[0]", "/t.position[1]"]


def test_files_of_one_signal_are_joined_in_the_order_of_the_joints():
    """Each lists the joints backwards, as ROS lists them by the alphabet."""
    robot = load_robot(URDF)
    names = [f"- {joint}" for joint in reversed(robot.joint_names)]
    tables = {
        Path(f"logs/{file}.csv"): {"t": TIME, names[0]: second, names[1]: first}
        for file, first, second in (("q", *VALUES[:2]), ("tau", *VALUES[2:]))
    }
    (joined,) = join_signal_files(tables, robot).values()
    assert list(joined) == ["t", "q[0]", "q[1]", "tau[0]", "tau[1]"]
    for name, values in zip(list(joined)[1:], VALUES, strict=True):
        np.testing.assert_array_equal(joined[name], values)


def test_signal_files_of_one_run_with_unequal_rows_are_refused():
    robot = load_robot(URDF)
    names = ["t", *robot.joint_names]
    tables = {
        Path(f"logs/{file}.csv"): dict.fromkeys(names, TIME[:rows])
        for file, rows in (("q", 90), ("tau", 80))
    }
    with pytest.raises(InputFileError, match=r"tau.csv: has 80 rows, q.csv 90") as error:
        join_signal_files(tables, robot)
    assert "Cut off the rows" in str(error.value)
    # Without torques they may be runs of their own.
    runs = {path.with_stem(f"x{k}"): table for k, (path, table) in enumerate(tables.items())}
    assert join_signal_files(runs, robot) == runs


def test_a_joined_file_of_several_signals_loses_none():
    robot = load_robot(URDF)
    state = dict(zip(["t", "q1", "q2", "qd1", "qd2"], [TIME, *VALUES], strict=True))
    torque = {"t": TIME, "1": VALUES[3], "2": VALUES[2]}
    tables = {Path("logs/state.csv"): state, Path("logs/tau.csv"): torque}
    (joined,) = join_signal_files(tables, robot).values()
    assert list(joined) == [*state, "tau[0]", "tau[1]"]
    for name, values in state.items():
        np.testing.assert_array_equal(joined[name], values)


def german(folder, factor=(9.5, 4.2)):
    """Logs of the shipped arm as a test bench writes them: two heads, ms, degrees, currents."""
    shipped = URDF.parent
    for k, run_ in enumerate(("train_1", "train_2", "train_3", "test_1"), start=1):
        with np.load(shipped / f"{run_}.npz") as stored:
            every = {name: stored[name][::2] for name in stored.files}
        angles = [np.degrees(every[q]) for q in ("q1", "q2")]
        currents = [every[f"tau{j}"] / factor[j - 1] for j in (1, 2)]
        warmth = np.full(len(every["t"]), 31.5)
        columns = [1e3 * every["t"], *angles, *currents, warmth]
        head = [f"Prüfstand 7;Messung {k}",
                "Zeit;Achse 1 Winkel;Achse 2 Winkel;Achse 1 Strom;Achse 2 Strom;Achse 1 Temperatur",
                "[ms];[°];[°];[A];[A];[°C]"]  # fmt: skip
        body = [";".join(f"{v:.9g}" for v in row).replace(".", ",")
                for row in np.column_stack(columns)]  # fmt: skip
        (folder / f"messung_{k}.csv").write_text("\n".join([*head, *body]), encoding="latin-1")
    return [str(folder / f"messung_{k}.csv") for k in range(1, 5)]


def test_a_german_test_bench_to_a_set_in_three_commands(tmp_path, capsys):
    files = german(tmp_path)
    assert run(["diagnose", files[0]]) == 2
    assert "`stiffopt init recording" in capsys.readouterr().err
    assert run(["diagnose", str(tmp_path)]) == 2
    assert "no recordings.toml" in capsys.readouterr().err
    folder = tmp_path / "set"
    assert run(["init", "recording", *files, "--urdf", str(URDF), "--out", str(folder)]) == 0
    said = capsys.readouterr().out
    assert "in ms by" in said
    assert "in deg by" in said
    assert "not used: Achse 1 Temperatur" in said
    signals = tomllib.loads((folder / "recordings.toml").read_text())["signals"]
    assert signals["position"] == ["Achse 1 Winkel [°]", "Achse 2 Winkel [°]"]
    assert signals["scale"] == {"time": "ms", "position": "deg", "torque": "A"}
    # Currents are no torques; what the arm's weight makes of them is told.
    assert run(["recording", "check", str(folder)]) == 2
    errors = capsys.readouterr().err
    assert "N m per A" in errors
    first, second = re.search(r"write torque = \[([\d.]+), ([\d.]+)\]", errors).groups()
    assert float(first) == pytest.approx(9.5, rel=0.02)
    assert float(second) == pytest.approx(4.2, rel=0.02)
    scale = "signals.scale.torque=[9.5,4.2]"
    assert run(["recording", "check", str(folder), "--set", scale]) == 0


def test_currents_with_unit_torque_constant_need_a_factor(tmp_path, capsys):
    """No gain shows there: only that nobody has said what one A is."""
    files, folder = german(tmp_path, factor=(1.1, 0.9)), tmp_path / "set"
    assert run(["init", "recording", *files, "--urdf", str(URDF), "--out", str(folder)]) == 0
    assert run(["recording", "check", str(folder)]) == 2
    assert "N m per A" in capsys.readouterr().err


def test_columns_of_one_name_do_not_hide_each_other(tmp_path):
    text = lines(["t", "Winkel [deg]", "Winkel [deg]", "Moment", "Moment"])
    found = guessed(tmp_path, text)
    assert found.columns["position"] == ("Winkel 1 [deg]", "Winkel 2 [deg]")
    assert found.columns["torque"] == ("Moment 1", "Moment 2")


def test_units_of_single_columns(tmp_path):
    """One angle in degrees beside one in rad: the velocities tell, else a person is asked."""
    degrees = np.degrees(VALUES[0]) * 1.5
    found = guessed(tmp_path, lines(columns=[TIME, degrees, *VALUES[1:]]))
    assert found.units["position"] == "deg"
    (told,) = [reason for reason in found.reasons if "QUESTION" in reason]
    assert 'position = ["deg", 1.0]' in told
    speeds = [1.5 * np.cos(TIME), -1.6 * np.sin(2.0 * TIME)]
    names = ["t", "q1", "q2", "qd1", "qd2", "tau1", "tau2"]
    columns = [TIME, degrees, VALUES[1], *speeds, *VALUES[2:]]
    found = guessed(tmp_path, lines(names, columns))
    assert found.units["position"] == ("deg", "")
    assert not found.units["velocity"]
    out = tmp_path / "set"
    assert run(["init", "recording", str(tmp_path / "log.csv"), "--urdf", str(URDF), "--out",
                str(out)]) == 0  # fmt: skip
    document = tomllib.loads((out / "recordings.toml").read_text())
    assert document["signals"]["scale"]["position"] == ["deg", 1.0]
    scale = load_recordings(out).signals.scale_of("position", 2)
    np.testing.assert_allclose(scale, [np.pi / 180.0, 1.0])


@pytest.mark.parametrize("place", ["{} [{}] {}", "{} {} [{}]"])
def test_foreign_columns_are_recognised_by_units(tmp_path, place):
    heads = [("Achswinkel", "°"), ("Achsgeschw.", "°/s"), ("Moment der Achse", "Nm")]
    names = ["Zeit [ms]"]
    for word, unit in heads:
        for joint in (1, 2):
            parts = (word, unit, joint) if place.endswith("{}") else (word, joint, unit)
            names.append(place.format(*parts))
    angles = [np.degrees(v) for v in VALUES[:2]]
    columns = [1e3 * TIME, *angles, *(np.gradient(v, TIME) for v in angles), *VALUES[2:]]
    found = guessed(tmp_path, lines(names, columns))
    assert [found.columns[kind][1] for kind in ("position", "velocity", "torque")] == [
        names[2],
        names[4],
        names[6],
    ]
    assert (found.units["time"], found.units["position"]) == ("ms", "deg")


def test_a_torque_about_an_axis_is_no_position(tmp_path):
    names = ["t", "axis 1 [deg]", "axis 2 [deg]", "axis 1 [Nm]", "axis 2 [Nm]"]
    found = guessed(tmp_path, lines(names))
    assert found.columns["torque"] == ("axis 1 [Nm]", "axis 2 [Nm]")


def french(*heads):
    return ["t", *(f"{word} axe {joint} [{unit}]" for word, unit in heads for joint in (1, 2))]


@pytest.mark.parametrize("first", ["A", "Nm"])
def test_torque_columns_precede_currents_in_any_language(first, tmp_path):
    own = sorted((("Couple", "Nm"), ("Courant", "A")), key=lambda head: head[1] != first)
    names = french(("Angle", "rad"), *own)
    found = guessed(tmp_path, lines(names, [TIME, *VALUES, *VALUES[2:]]))
    assert found.columns["torque"] == ("Couple axe 1 [Nm]", "Couple axe 2 [Nm]")
    assert not any("QUESTION" in reason for reason in found.reasons)


@pytest.mark.parametrize(("first", "asks"), [("Consigne", False), ("Erreur", True)])
def test_measured_angles_precede_set_points_or_are_questioned(first, asks, tmp_path, capsys):
    names = french((first, "rad"), ("Mesure", "rad"), ("Couple", "Nm"))
    text = lines(names, [TIME, *VALUES[:2], *VALUES])
    found = guessed(tmp_path, text)
    assert found.columns["position"] == tuple(names[1:3] if asks else names[3:5])
    questions = [reason for reason in found.reasons if "QUESTION" in reason]
    assert len(questions) == asks
    out = tmp_path / "set"
    assert run(["init", "recording", str(tmp_path / "log.csv"), "--urdf", str(URDF), "--out",
                str(out)]) == 0  # fmt: skip
    assert ("QUESTION" in capsys.readouterr().out) == asks
    if asks:
        assert f"{names[3]}, {names[4]} may be the position as well" in questions[0]
        # As the question says: the set holds these columns too.
        written = (out / "recordings.toml").read_text()
        assert "QUESTION" in written
        put = written.replace(f'position = ["{names[1]}", "{names[2]}"]',
                              f'position = ["{names[3]}", "{names[4]}"]')  # fmt: skip
        assert put != written
        (out / "recordings.toml").write_text(put)
        assert load_recordings(out).runs


def test_vague_column_words_raise_no_question(tmp_path):
    """As a robot's real-time interface names its signals."""
    heads = ("joint_control_output", "target_q", "actual_q", "joint_temperatures", "target_moment",
             "actual_current")  # fmt: skip
    names = ["t", *(f"{head}_{joint}" for head in heads for joint in (0, 1))]
    found = guessed(tmp_path, lines(names, [TIME, *VALUES * 3]))
    assert found.columns["position"] == ("actual_q_0", "actual_q_1")
    assert found.columns["torque"] == ("actual_current_0", "actual_current_1")
    assert not any("QUESTION" in reason for reason in found.reasons)


def test_zeros_and_columns_without_numbers_are_no_warnings(tmp_path):
    """A warning of the numbers' library would fail; mixed units are looked for all the same."""
    degrees, absent = np.degrees(VALUES[0]) * 1.5, np.full(len(TIME), np.nan)
    names = ["t", "q1", "q2", "qd1", "qd2", "tau1", "tau2"]
    speeds = [1.5 * np.cos(TIME), 0.0 * TIME]
    found = guessed(tmp_path, lines(names, [TIME, degrees, VALUES[1], *speeds, *VALUES[2:]]))
    assert "QUESTION: q2 reach no more than 0.8: in rad?" in " ".join(found.reasons)
    robot = load_robot("er3a_c60")
    signals = {"q": [degrees, VALUES[1], absent], "qd": [*speeds, absent], "tau": VALUES[:3]}
    table = {f"{name}{k + 1}": (own * 2)[k] for name, own in signals.items() for k in range(6)}
    found = guess_columns({"t": TIME, **table}, robot)
    assert "QUESTION: q2, q5 reach no more than 0.8: in rad?" in " ".join(found.reasons)


def test_clock_reset_splits_runs(tmp_path, capsys):
    t = np.concatenate([np.arange(500.0), np.arange(450.0)])
    text = ["t_ms,q1,q2,tau1,tau2"]
    text += [f"{5.0 * s:g},{np.sin(0.01 * s)},{np.cos(0.01 * s)},{k},1" for k, s in enumerate(t)]
    (tmp_path / "log.csv").write_text("\n".join(text))
    out = tmp_path / "set"
    log = str(tmp_path / "log.csv")
    assert run(["init", "recording", log, "--urdf", str(URDF), "-o", str(out)]) == 0
    said = capsys.readouterr().out
    assert "The clock of log.csv restarts 1 time(s): it is stored as 2 runs, log_1, log_2" in said
    document = tomllib.loads((out / "recordings.toml").read_text())
    assert [(each["file"], each["role"]) for each in document["runs"]] == [
        ("log_1.npz", "train"),
        ("log_2.npz", "test"),
    ]
    with np.load(out / "log_2.npz") as stored:
        assert len(stored["t_ms"]) == 450
        assert stored["tau1"][0] == 500.0


def test_run_parts_have_unique_names(tmp_path):
    """Every run has a file of its own, with its own rows, and one role."""
    lengths = {"log": (500, 450), "log_1": (420,), "log_2": (430,)}
    for name, parts in lengths.items():
        t = np.concatenate([np.arange(float(n)) for n in parts])
        rows = (f"{5.0 * s:g},{np.sin(0.01 * s)},{np.cos(0.01 * s)},{k},1" for k, s in enumerate(t))
        (tmp_path / f"{name}.csv").write_text("\n".join(["t_ms,q1,q2,tau1,tau2", *rows]))
    logs, out = [str(tmp_path / f"{name}.csv") for name in lengths], tmp_path / "set"
    assert run(["init", "recording", *logs, "--urdf", str(URDF), "-o", str(out)]) == 0
    document = tomllib.loads((out / "recordings.toml").read_text())
    found = {}
    for each in document["runs"]:
        with np.load(out / each["file"]) as stored:
            assert each["file"] not in found
            found[each["file"]] = (len(stored["t_ms"]), each["role"])
    assert found == {
        "log_part_1.npz": (500, "train"),
        "log_part_2.npz": (450, "train"),
        "log_1.npz": (420, "train"),
        "log_2.npz": (430, "test"),
    }


@pytest.mark.parametrize("last", ["", "Bemerkung"])
def test_header_with_unit_row_and_empty_last_column(last, tmp_path):
    text = [f"Zeit;Achse 1 Istposition;Achse 1 Strom;{last}", "[ms];[Grad];[A];"]
    text += [f"{k};{k},5;0,{k};" for k in range(40)]
    (tmp_path / "log.csv").write_text("\n".join(text), encoding="cp1252")
    assert list(read_tables(tmp_path / "log.csv")[""]) == [
        "Zeit [ms]", "Achse 1 Istposition [Grad]", "Achse 1 Strom [A]",
    ]  # fmt: skip


def test_set_points_only_are_questioned(tmp_path, capsys):
    text = ["t,q_cmd_1,q_cmd_2,tau_1,tau_2"]
    text += [f"{0.01 * k:g},{np.sin(0.02 * k)},{np.cos(0.02 * k)},{k % 7},1" for k in range(900)]
    (tmp_path / "log.csv").write_text("\n".join(text))
    out, log = tmp_path / "set", str(tmp_path / "log.csv")
    assert run(["init", "recording", log, "--urdf", str(URDF), "-o", str(out)]) == 0
    said = capsys.readouterr().out
    assert "QUESTION: set points by their names, and no measured position" in said
    assert run(["recording", "check", str(out)]) == 2
    assert "positions are set points" in capsys.readouterr().err


@pytest.mark.parametrize("named", [True, False])
def test_a_lerobot_dataset_is_a_recording_set(named, tmp_path, capsys):
    """Vectors whose entries meta/info.json names, two episodes in one file, actions beside them."""
    arrow = pytest.importorskip("pyarrow")
    import pyarrow.parquet as parquet

    motors = ["pan", "lift"]
    features = {
        "action": {"names": motors},
        "observation.state": {"names": [f"{motor}.pos" for motor in motors]},
        "observation.effort": {"names": {"motors": motors}},
    }
    (tmp_path / "set" / "meta").mkdir(parents=True)
    (tmp_path / "set" / "meta" / "info.json").write_text(
        json.dumps({"features": features if named else {}})
    )
    file = tmp_path / "set" / "data" / "chunk-000" / "file-000.parquet"
    file.parent.mkdir(parents=True)
    position, torque = (np.stack(VALUES[k : k + 2], axis=1) for k in (0, 2))
    vectors = {
        "action": 0.9 * position,
        "observation.state": position,
        "observation.effort": torque,
    }
    columns = {
        name: arrow.array(np.vstack([rows, 0.5 * rows]).tolist(), arrow.list_(arrow.float64()))
        for name, rows in vectors.items()
    }
    columns |= {
        "observation.image": arrow.array([b"x"] * 2 * len(TIME)),
        "timestamp": np.tile(TIME, 2),
        "episode_index": np.repeat([0, 1], len(TIME)),
    }
    parquet.write_table(arrow.table(columns), file)
    out = tmp_path / "out"
    arguments = ["init", "recording", str(tmp_path / "set"), "--urdf", str(URDF)]
    assert run([*arguments, "--out", str(out)]) == 0
    assert "restarts 1 time(s): it is stored as 2 runs" in capsys.readouterr().out
    signals = tomllib.loads((out / "recordings.toml").read_text())["signals"]
    entries = ["pan.pos", "lift.pos"] if named else ["0", "1"]
    assert signals["position"] == [f"observation.state[{entry}]" for entry in entries]
    second = np.load(out / "file-000_2.npz")
    np.testing.assert_allclose(second[signals["torque"][1]], 0.5 * VALUES[3])


def test_stamps_of_a_data_frame_are_seconds(tmp_path):
    arrow = pytest.importorskip("pyarrow")
    import pyarrow.parquet as parquet

    stamped = (1e9 * TIME).astype("datetime64[ns]") + np.timedelta64(1, "D")
    columns = dict(zip(NAMES, [stamped, *VALUES], strict=True))
    parquet.write_table(arrow.table(columns), tmp_path / "log.parquet")
    np.testing.assert_allclose(read_tables(tmp_path / "log.parquet")[""]["t"], TIME, atol=1e-9)


@pytest.mark.parametrize(
    ("cell", "value"),
    [
        ("1.234,5", 1234.5),
        ("-12.345.678,25", -12345678.25),
        ("1,234.5", 1234.5),
        ("1.234.567", 1234567.0),
        ("1'234.5", 1234.5),
        ("1\N{NARROW NO-BREAK SPACE}234,5", 1234.5),
        ("1.234", 1.234),
        ("1,234", 1.234),
        ("1e3", 1e3),
    ],
)
def test_thousands_separators_are_read(cell, value, tmp_path):
    """As spreadsheets write them: left out, large torques would be missing without a word."""
    text = ["sep=;", '"Zeit in ms";"q1";"tau1"', *(f'"{k},5";"0,25";"{cell}"' for k in range(5))]
    found = table(tmp_path, text)
    assert found["tau1"].tolist() == [value] * 5
    assert found["Zeit in ms"][1] == 1.5


@pytest.mark.parametrize(
    ("names", "held_out"),
    [
        (["test", "train"], {"test"}),
        (["arm_val", "arm_x", "arm_z"], {"arm_val"}),
        (["latest", "older"], {"older"}),
        (["test_1", "test_2"], {"test_2"}),
    ],
)
def test_recordings_named_as_tests_are_held_out(names, held_out, tmp_path):
    for name in names:
        (tmp_path / f"{name}.csv").write_text("\n".join(lines()))
    files = [str(tmp_path / f"{name}.csv") for name in names]
    folder = tmp_path / "set"
    assert run(["init", "recording", *files, "--urdf", str(URDF), "--out", str(folder)]) == 0
    runs = tomllib.loads((folder / "recordings.toml").read_text())["runs"]
    assert {r["file"].removesuffix(".npz") for r in runs if r["role"] == "test"} == held_out


def test_recorded_arm_is_a_shipped_robot_by_its_name(tmp_path, capsys):
    log = tmp_path / "log.csv"
    names = ["t", *(f"q{k}" for k in range(1, 7)), *(f"tau{k}" for k in range(1, 7))]
    columns = [TIME, *VALUES, *VALUES, *VALUES[::-1]]
    log.write_text("\n".join(lines(names=names, columns=columns)))
    assert run(["init", "recording", str(log), "--robot", "ur10", "-o", str(tmp_path / "set")]) == 0
    assert len(load_recordings(tmp_path / "set").joints) == 6
    assert run(["init", "recording", str(log), "--robot", "ur11", "-o", str(tmp_path / "no")]) == 2
    assert "ur10" in capsys.readouterr().err


def test_signal_files_of_several_folders_are_a_run_each(tmp_path):
    """One file a joint and signal, in a folder a motion: their names repeat."""
    for number, folder in enumerate(("slow", "fast"), start=1):
        (tmp_path / folder).mkdir()
        for name, values in zip(NAMES[1:], VALUES, strict=True):
            np.savetxt(tmp_path / folder / f"{name}.txt", number * values)
    out = tmp_path / "set"
    folders = [str(tmp_path / name) for name in ("slow", "fast")]
    assert (
        run(
            ["init", "recording", *folders, "--rate", "200", "--urdf", str(URDF), "--out", str(out)]
        )
        == 0
    )
    found = load_recordings(out)
    assert [(entry.name, entry.role) for entry in found.runs] == [
        ("slow", "train"),
        ("fast", "test"),
    ]
    assert found.signals.position == ("q1", "q2")


def test_files_of_one_name_in_two_folders_are_named_after_these(tmp_path):
    for folder in ("before", "after"):
        (tmp_path / folder).mkdir()
        for name in ("run1.csv", "run2.csv"):
            (tmp_path / folder / name).write_text("\n".join(lines()))
    out = tmp_path / "set"
    folders = [str(tmp_path / name) for name in ("before", "after")]
    assert run(["init", "recording", *folders, "--urdf", str(URDF), "--out", str(out)]) == 0
    assert [(entry.name, entry.role) for entry in load_recordings(out).runs] == [
        ("before_run1", "train"),
        ("before_run2", "train"),
        ("after_run1", "train"),
        ("after_run2", "test"),
    ]


def test_whole_numbers_of_a_drive_are_torques_without_a_factor(tmp_path, capsys):
    """The sign of a joint is told beside its factor; a joint without weight keeps its unit."""
    motion = dict(np.load(URDF.parent / "train_1.npz"))
    columns = [motion[name] for name in ("t", "q1", "q2")]
    columns += [np.round(motion["tau1"] / 0.02), np.round(motion["tau2"] / -0.02)]
    (tmp_path / "log.csv").write_text("\n".join(lines(columns=columns)))
    out = tmp_path / "set"
    log = str(tmp_path / "log.csv")
    assert run(["init", "recording", log, "--urdf", str(URDF), "--out", str(out)]) == 0
    assert "whole numbers" in capsys.readouterr().out
    assert load_recordings(out).signals.torque_units == ("counts", "counts")
    assert run(["recording", "check", str(out)]) == 2
    told = capsys.readouterr().err
    first, second = re.search(r"write torque = \[([-\d.]+), ([-\d.]+)\]", told).groups()
    assert float(first) == pytest.approx(0.02, rel=0.1)
    assert float(second) == pytest.approx(-0.02, rel=0.1)
    assert "N m per count" in told


def test_last_link_is_the_hand_of_a_new_set(tmp_path):
    (tmp_path / "log.csv").write_text("\n".join(lines()))
    out = tmp_path / "set"
    log = str(tmp_path / "log.csv")
    assert run(["init", "recording", log, "--urdf", str(URDF), "--out", str(out)]) == 0
    assert load_recordings(out).tool_frame == load_robot(URDF).tool.link


def test_poses_without_a_time_need_no_rate_and_few_rows(tmp_path, capsys):
    rng = np.random.default_rng(3)
    poses = [*rng.uniform(-1.0, 1.0, (2, 30)), *rng.uniform(-20.0, 20.0, (2, 30))]
    body = [
        "q1,q2,tau1,tau2",
        *(",".join(f"{x:.6g}" for x in row) for row in zip(*poses, strict=True)),
    ]
    log, out = tmp_path / "poses.csv", tmp_path / "set"
    log.write_text("\n".join(body))
    assert run(["init", "recording", str(log), "--urdf", str(URDF), "--out", str(out)]) == 0
    assert "poses at rest" in capsys.readouterr().out
    assert load_recordings(out).signals.at_rest
    log.write_text("\n".join(body[:12]))
    assert (
        run(["init", "recording", str(log), "--urdf", str(URDF), "--out", str(tmp_path / "few")])
        == 2
    )
    assert "needs 20" in capsys.readouterr().err
