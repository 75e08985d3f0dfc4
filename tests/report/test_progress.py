import io
import itertools
from types import SimpleNamespace

import pytest
from rich.console import Console

from stiffopt.discovery.progress import RoundProgress, throttle_progress
from stiffopt.report.common.progress import ProgressDisplay, StudyProgress
from stiffopt.report.common.terminal import print_table
from stiffopt.report.common.text import percent, si, significant
from stiffopt.solver.monitor import Progress


def event(**changes):
    values = {
        "stage": "stage 1 of 2, 30 intervals",
        "iteration": 7,
        "objective": 2.97e-4,
        "violation": 0.012,
        "row": "torque, joint 2",
        "elapsed": 0.8,
    }
    return SimpleNamespace(**{**values, **changes})


def display(terminal, clock=None):
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=terminal, width=120, legacy_windows=False)
    options = {} if clock is None else {"clock": clock}
    return ProgressDisplay("cycle [1]", "m", console, **options), stream


def test_plain_lines_are_limited_to_one_per_second_and_stage():
    ticks = iter([0.0, 0.2, 0.9, 1.1, 1.2])
    progress, stream = display(False, lambda: next(ticks))
    with progress:
        for number in range(4):
            progress(event(iteration=number))
        progress(event(iteration=4, stage="stage 2 of 2, 60 intervals"))
    lines = stream.getvalue().splitlines()
    assert [line.split("iteration ")[1].split()[0] for line in lines] == ["0", "3", "4"]
    assert lines[0] == (
        "0.8 s  stage 1 of 2, 30 intervals  iteration 0  objective 0.297 mm  "
        "violation 1.2 % torque, joint 2"
    )


def test_the_last_event_is_always_printed():
    progress, stream = display(False, lambda: 0.0)
    with progress:
        progress(event(iteration=1))
        progress(event(iteration=2))
    assert stream.getvalue().count("\n") == 2
    assert "iteration 2" in stream.getvalue()


def test_a_negligible_violation_names_no_row():
    progress, stream = display(False)
    with progress:
        progress(event(violation=1e-9))
    assert "violation none" in stream.getvalue()
    assert "joint" not in stream.getvalue()


def test_the_terminal_shows_the_latest_event():
    progress, stream = display(True)
    with progress:
        progress(event())
        progress(event(iteration=8, row="[red]velocity, joint 3"))
    text = stream.getvalue()
    assert "cycle [1]" in text
    assert "[red]velocity, joint 3" in text


def test_the_display_closes_when_the_solve_fails():
    progress, stream = display(True)
    with pytest.raises(KeyboardInterrupt), progress:
        raise KeyboardInterrupt
    assert "\x1b[?25h" in stream.getvalue()  # the cursor is shown again


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (2.97e-4, "m", "0.297 mm"),
        (2.97e-6, "m", "2.97 µm"),
        (1.5, "m", "1.5 m"),
        (3.1e-5, "rad/(N m)", "31 µrad/(N m)"),
        (0.31234567, "s", "0.3123 s"),
        (5.4e4, "N m/rad", "54000 N m/rad"),
        (float("nan"), "m", "–"),
        (0.7, "", "0.7"),
    ],
)
def test_units_suit_the_size(value, unit, text):
    assert si(value, unit) == text


def test_significant_digits():
    assert significant(0.99996) == "1"
    assert significant(-1234.5678) == "-1235"
    assert significant(1e-9) == "1.000e-09"
    assert percent(0.0251) == "2.5 %"


def test_short_solves_are_summed_without_repeated_lines():
    ticks = itertools.count(0.0, 0.7)
    progress, stream = display(False, lambda: next(ticks))
    with progress:
        study = StudyProgress(progress, after=0.0, clock=lambda: next(ticks))
        for _ in range(4):
            for number, objective in ((0, 0.79), (1, 0.6), (2, 0.45)):
                study(Progress(number, objective, 0.0, "", 0.0))
    lines = [line.split("  ", 1)[1] for line in stream.getvalue().splitlines()]
    assert len(lines) > 3
    assert len(set(lines)) == len(lines)
    assert not any("0.79" in line for line in lines)
    assert lines[-1].startswith("preloads  iteration 8")


def test_many_small_steps_print_few_lines(monkeypatch):
    said, now = [], itertools.count(0.0, 1.0)
    monkeypatch.setattr("stiffopt.discovery.progress.time.monotonic", lambda: next(now))
    tell = throttle_progress(said.append, seconds=5.0)
    for number in range(20):
        tell(str(number))
    assert 2 <= len(said) <= 4


def test_round_shows_the_remaining_time(monkeypatch):
    clock = iter([100.0, 103.0, 112.0])
    monkeypatch.setattr("time.monotonic", lambda: next(clock))
    pace = RoundProgress(4)
    assert pace.words(0) == "1 of 4"
    assert pace.words(1) == "2 of 4, about 9 s of this round left"
    assert pace.words(3) == "4 of 4, about 4 s of this round left"


def test_units_in_brackets_stay_in_the_title_of_a_table(capsys):
    print_table(["motion", "error"], [["quintic", "0.3"]], "Deviations [mm]")
    assert "Deviations [mm]" in " ".join(capsys.readouterr().out.split())
