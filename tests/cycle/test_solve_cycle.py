"""A small cycle from file to result, page and exported motion."""

import csv
import io
import itertools
import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from small_cycles import GRIP, write_cycle_file

from stiffopt.cli import run
from stiffopt.cycle.solve_cycle import solve_cycle
from stiffopt.export.folder_motions import read_stored
from stiffopt.export.format import FORMATS, read_seal
from stiffopt.files import read_table
from stiffopt.problem.cycle_files import load_cycle


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Result folder of the small cycle."""
    place = tmp_path_factory.mktemp("cycle")
    path = write_cycle_file(place)
    assert run(["solve", str(path), "--out", str(place / "out"), "--quiet"]) == 0
    return place / "out"


@pytest.mark.slow
def test_results_of_a_cycle(folder):
    document = json.loads((folder / "cycle.json").read_text())
    assert document["status"] == "optimal"
    assert document["duration"] == pytest.approx(3.0)
    legs = document["legs"]
    assert [leg["event"] for leg in legs] == ["grip", "release", ""]
    for before, after in itertools.pairwise(legs):
        assert after["start"] == pytest.approx(before["arrival"] + before["dwell"])
    # The best split of the time gives all legs the same peak.
    peaks = [leg["objective"] for leg in legs]
    assert max(peaks) == pytest.approx(min(peaks), rel=0.03)
    assert document["objective"]["value"] == pytest.approx(max(peaks))
    assert all(rival["objective"] > document["objective"]["value"] for rival in document["rivals"])
    assert document["rivals"]
    # The part makes the tool sag: the arm vibrates by that in the rest after the grip.
    jump = legs[0]["tool_error"]["jump"]
    assert legs[0]["tool_error"]["rest"] == pytest.approx(jump, rel=0.2)
    assert jump > 1e-5
    assert len(document["duty"]["joints"]) == 3


@pytest.mark.slow
def test_table_and_export_are_one_continuous_motion(folder, tmp_path, capsys):
    with (folder / "cycle.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    q = np.array([[float(row[f"q{j}"]) for j in (1, 2, 3)] for row in rows])
    qd = np.array([[float(row[f"qd{j}"]) for j in (1, 2, 3)] for row in rows])
    time = np.array([float(row["t"]) for row in rows])
    np.testing.assert_allclose(np.gradient(q, time, axis=0)[1:-1], qd[1:-1], atol=2e-2)
    assert {row["payload"] for row in rows} == {"0.2", "1.2"}
    for to in ("csv", "ros2"):
        assert run(["export", str(folder), "--to", to, "--out", str(tmp_path / to)]) == 0
    text = read_seal((tmp_path / "csv" / "motor.csv").read_text())[1]
    exported = list(csv.DictReader(io.StringIO(text)))
    events = [row["event"] for row in exported if row["event"]]
    assert events == ["grip", "release"]
    own = np.array([float(row["shoulder"]) for row in exported])
    np.testing.assert_allclose(own, q[:, 1], atol=1e-6)
    assert "Event: grip at" in (tmp_path / "ros2" / "joint_trajectory.yaml").read_text()
    capsys.readouterr()
    assert run(["check", str(tmp_path / "csv" / "motor.csv"), "--result", str(folder)]) == 0
    assert "All limits are met" in capsys.readouterr().out


@pytest.mark.slow
def test_programs_of_points_stop_at_events(folder):
    stored, form = read_stored(folder), FORMATS["staubli-val3"]
    motion = form.sample(stored, 20.0)
    steps = form.steps(motion)
    at = [k for k, step in enumerate(steps) if step.event]
    assert [steps[k].event.kind for k in at] == ["grip", "release"]
    for k in at:
        assert steps[k - 1].stop
        pose = motion.position[steps[k - 1].sample]
        np.testing.assert_allclose(pose, stored.curve(steps[k].event.time), atol=1e-9)
    legs = json.loads((folder / "cycle.json").read_text())["legs"]
    rests = sum(step.rest for step in steps)
    assert rests == pytest.approx(sum(leg["dwell"] for leg in legs), abs=0.05 * len(legs))


@pytest.mark.slow
def test_page_names_legs_postures_and_duty(folder):
    page = (folder / "report.html").read_text()
    for words in ("above, pick", "grip: 0.2 to 1.2 kg", "Postures", "Duty", "Rivals"):
        assert words in page


@pytest.mark.slow
def test_shortest_cycle_is_the_sum_of_the_shortest_legs(tmp_path):
    path = write_cycle_file(tmp_path, duration="{ upper = 5.0 }", objective="duration")
    cycle = load_cycle(path).cycle
    found = solve_cycle(cycle, simulate=False)
    assert found.status.usable
    moving = sum(leg.solution.duration for leg in found.legs)
    assert found.duration == pytest.approx(moving + 0.1)
    assert found.objective.value == pytest.approx(found.duration)


@pytest.mark.slow
def test_cycle_under_an_error_limit_is_as_short_as_it_allows(tmp_path):
    limit = 1e-3
    duration = "{ upper = 5.0 }\nerror_limit = '1 mm'"
    found = solve_cycle(load_cycle(write_cycle_file(tmp_path, duration=duration)).cycle,
                        simulate=False)  # fmt: skip
    assert found.status.usable
    errors = [leg.solution.objective.value for leg in found.legs]
    assert max(errors) <= limit
    assert min(errors) > 0.985 * limit
    assert found.objective.name == "duration"
    assert found.objective.value == pytest.approx(found.duration)


@pytest.mark.slow
def test_cycle_without_enough_time_says_so(tmp_path):
    path = write_cycle_file(tmp_path, duration='"0.3 s"')
    found = solve_cycle(load_cycle(path).cycle, simulate=False)
    assert not found.status.usable
    assert "motion.duration" in found.message


@pytest.mark.slow
def test_commands_of_the_legs_are_simulated_as_one(tmp_path):
    """Before the first event the error is that of the leg alone; then the part's sag rings on."""
    moves = GRIP + 'dwell = 0.1\n[[move]]\nto = "home"\n'
    path = write_cycle_file(tmp_path, moves=moves, duration='"1.4 s"', objective="tool_deviation")
    found = solve_cycle(load_cycle(path).cycle)
    first, second = found.simulation.legs
    own = found.legs[0].solution.compensation
    assert own.command is not None
    alone = own.optimised.simulated
    assert first.flight == pytest.approx(alone.peak, rel=0.02)
    assert first.rest == pytest.approx(first.jump, rel=0.1)
    # Two percent of damping leave most of the vibration at the next departure.
    assert 0.3 * first.jump < second.flight < 1.5 * first.jump


def test_a_leg_without_a_command_says_why(tmp_path, monkeypatch):
    missing = SimpleNamespace(refusal="No command.csv: too fast.", command=None)
    monkeypatch.setattr(
        "stiffopt.cycle.solve_cycle.with_simulation",
        lambda problem, solution, progress: replace(solution, compensation=missing),
    )
    moves = GRIP + '[[move]]\nto = "home"\n'
    path = write_cycle_file(tmp_path, moves=moves, duration='"2 s"', objective="torque_squared")
    found = solve_cycle(load_cycle(path).cycle)
    assert [leg.name for leg in found.legs] == ["pick", "home"]
    for leg in found.legs:
        assert f"{leg.name}: No command.csv: too fast." in found.notes


@pytest.mark.slow
def test_a_cycle_starts_from_an_earlier_one(folder, tmp_path):
    path = write_cycle_file(tmp_path)
    out = tmp_path / "out"
    arguments = ["solve", str(path), "--out", str(out), "--guess", str(folder), "--quiet"]
    assert run(arguments) == 0
    first, again = (json.loads((each / "cycle.json").read_text()) for each in (folder, out))
    assert again["objective"]["value"] <= 1.01 * first["objective"]["value"]


def test_the_first_split_and_motions_are_those_of_the_guesses(tmp_path, monkeypatch):
    class SolvedError(Exception):
        pass

    def watched(problem, *, guess, **others):
        raise SolvedError(problem.duration[0], guess)

    monkeypatch.setattr("stiffopt.cycle.solve_cycle.solve", watched)
    cycle = load_cycle(write_cycle_file(tmp_path)).cycle
    guesses = [SimpleNamespace(duration=each) for each in (1.3, 0.9, 0.7)]
    with pytest.raises(SolvedError) as found:
        solve_cycle(cycle, guesses=guesses)
    duration, guess = found.value.args
    assert duration == pytest.approx(1.3)
    assert guess is guesses[0]


@pytest.mark.slow
def test_a_guess_of_other_legs_is_refused(folder, tmp_path, capsys):
    path = write_cycle_file(tmp_path, moves=f'{GRIP}[[move]]\nto = "home"\n')
    arguments = ["solve", str(path), "--out", str(tmp_path / "out"), "--guess", str(folder)]
    assert run(arguments) == 2
    assert "the earlier cycle has 3 legs, this one 2" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_sweep_varies_the_time_and_the_part_of_a_cycle(tmp_path, capsys):
    write_cycle_file(tmp_path)
    sweep = tmp_path / "sweep.toml"
    sweep.write_text(
        'schema = 1\nkind = "sweep"\nbase = "cycle.toml"\n[grid]\n"motion.duration" = [3.0, 3.4]\n'
    )
    out = tmp_path / "out"
    arguments = ["sweep", str(sweep), "--out", str(out), "--workers", "1", "--quiet"]
    assert run(arguments) == 0
    columns = ["objective", "duration", "leg_1", "leg_2", "leg_3", "energy"]
    table = read_table(out / "table.csv", columns)
    legs = np.sum([table[f"leg_{k}"] for k in (1, 2, 3)], axis=0)
    assert legs == pytest.approx([2.9, 3.3])
    assert table["objective"][1] < table["objective"][0]


@pytest.mark.slow
def test_a_stored_cycle_is_simulated_again_with_other_servos_and_damping(folder, tmp_path, capsys):
    stated = json.loads((folder / "cycle.json").read_text())
    same, damped, slow = (tmp_path / name for name in ("same", "damped", "slow"))
    assert run(["simulate", str(folder), "--out", str(same)]) == 0
    assert run(["simulate", str(folder), "--out", str(damped), "--damping", "0.2"]) == 0
    assert run(["simulate", str(folder), "--out", str(slow), "--feed-forward", "0.8"]) == 0
    found, less, more = (
        json.loads((each / "simulation.json").read_text()) for each in (same, damped, slow)
    )
    for leg, own in zip(stated["legs"], found["legs"], strict=True):
        assert own["flight"] == pytest.approx(leg["tool_error"]["flight"], rel=0.02)
    assert less["legs"][2]["flight"] < 0.6 * found["legs"][2]["flight"]
    assert more["in_flight"] > 2.0 * found["in_flight"]
    table = read_table(same / "simulation.csv", ["t", "distance"])
    assert max(table["distance"]) >= found["in_flight"]
    capsys.readouterr()
    assert run(["simulate", str(folder), "--set", "uncertainty.stiffness=0.3"]) == 2
    assert "Omit --set" in capsys.readouterr().err
