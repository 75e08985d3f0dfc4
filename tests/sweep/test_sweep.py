"""Sweeps from file to table: resumption, dead workers, front and spread."""

import csv
import json
import os
import subprocess
import sys
import time
from concurrent.futures import Future

import numpy as np
import pytest
from small_arms import ROOT
from test_cases import sweep_file

from stiffopt.cli import run
from stiffopt.errors import InputError
from stiffopt.sweep.cases import load_sweep
from stiffopt.sweep.processes import Processes, WorkerLost, load_ahead
from stiffopt.sweep.run import SweepProgress, run_sweep
from stiffopt.sweep.summary import SweepSummary, knee
from stiffopt.sweep.workers import InProcess, make_workers

GRID = '[grid]\n"motion.duration" = ["1 s", "1.2 s", "1.5 s"]\n"payload.mass" = [0.0, 0.5]'


def rows(folder):
    with (folder / "table.csv").open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_sweep_writes_a_row_and_a_file_per_case(tmp_path, capsys):
    path = sweep_file(tmp_path, GRID)
    out = tmp_path / "out"
    assert run(["sweep", str(path), "--out", str(out), "--workers", "1", "--quiet"]) == 0
    assert "6 cases: 6 optimal." in capsys.readouterr().out
    table = rows(out)
    assert [row["motion.duration"] for row in table] == [
        "1 s", "1 s", "1.2 s", "1.2 s", "1.5 s", "1.5 s"
    ]  # fmt: skip
    assert [float(row["payload.mass"]) for row in table] == 3 * [0.0, 0.5]
    # Slower is easier, heavier is harder.
    objectives = np.array([float(row["objective"]) for row in table]).reshape(3, 2)
    assert (np.diff(objectives, axis=0) < 0).all()
    assert (np.diff(objectives, axis=1) > 0).all()
    assert len(list((out / "cases").glob("*.json"))) == 6
    assert "Sweep: sweep" in (out / "report.html").read_text()
    document = json.loads((out / "sweep.json").read_text())
    assert document["status"] == {"optimal": 6}
    parquet = pytest.importorskip("pyarrow.parquet")
    assert parquet.read_table(out / "table.parquet").to_pylist()[0]["motion.duration"] == "1 s"


def test_finished_cases_are_not_repeated(tmp_path):
    sweep = load_sweep(sweep_file(tmp_path, GRID))
    seen: list[SweepProgress] = []

    def stop_after_two(event):
        seen.append(event)
        if event.done == 2:
            raise KeyboardInterrupt

    results, interrupted = run_sweep(sweep, tmp_path, InProcess(), stop_after_two)
    assert interrupted
    assert sum(each is not None for each in results) == 2
    files = {path: path.stat().st_mtime_ns for path in (tmp_path / "cases").glob("*.json")}
    again: list[SweepProgress] = []
    results, interrupted = run_sweep(sweep, tmp_path, InProcess(), again.append)
    assert not interrupted
    assert None not in results
    assert [event.done for event in again] == [2, 3, 4, 5, 6]
    assert {path.suffix for path in (tmp_path / "cases").iterdir()} == {".json"}
    assert again[1].left > 0.0
    assert again[-1].left == 0.0
    assert all(path.stat().st_mtime_ns == then for path, then in files.items())


def test_invalid_case_does_not_affect_others(tmp_path):
    sweep = load_sweep(sweep_file(tmp_path, '[grid]\n"payload.mass" = [-1.0, 0.5, "2 s"]'))
    results, _ = run_sweep(sweep, tmp_path, InProcess())
    assert [each["status"] for each in results] == ["invalid", "optimal", "invalid"]
    assert "mass" in results[0]["message"]
    table = SweepSummary(sweep, results, False).columns()
    assert table["objective"][0] is None
    assert table["message"][1] == ""


class Dying:
    """Workers of which the one with a certain case dies, a number of times."""

    lost = (WorkerLost,)
    slots = 2

    def __init__(self, number, times):
        self.number, self.times, self.calls = number, times, []

    def submit(self, function, case, warm):
        self.calls.append(case.number)
        future = Future()
        if case.number == self.number and self.calls.count(case.number) <= self.times:
            future.set_exception(WorkerLost("gone"))
        else:
            future.set_result(function(case, warm))
        return future

    def close(self, *, now):
        self.closed = now


@pytest.mark.parametrize(("times", "status"), [(1, "optimal"), (2, "optimal"), (9, "failed")])
def test_case_of_a_dead_worker_is_retried(tmp_path, times, status):
    sweep = load_sweep(sweep_file(tmp_path, GRID))
    pool = Dying(3, times)
    results, _ = run_sweep(sweep, tmp_path, pool)
    assert [each["status"] for each in results].count("optimal") == 6 - (status == "failed")
    assert results[2]["status"] == status
    assert pool.calls.count(3) == min(times + 1, 3)
    assert pool.closed is False
    # A failed case is tried again by the next run.
    assert run_sweep(sweep, tmp_path, InProcess())[0][2]["status"] == "optimal"


@pytest.mark.slow
def test_dead_process_is_replaced():
    pool = Processes(2)
    assert pool.submit(abs, -1).result() == 1
    with pytest.raises(WorkerLost):
        pool.submit(os._exit, 1).result()
    assert pool.submit(abs, -2).result() == 2
    pool.close(now=False)


@pytest.mark.slow
def test_killed_parent_leaves_no_workers_and_no_messages(tmp_path):
    """Nor do workers outlive who employed them."""
    program = """
import os, time
from stiffopt.sweep.processes import Processes
if __name__ == "__main__":
    pool = Processes(2)
    print(pool.submit(os.getpid).result(), pool.submit(os.getpid).result(), flush=True)
    pool.submit(time.sleep, 600)
    time.sleep(600)
"""
    path = tmp_path / "employer.py"
    path.write_text(program)
    process = subprocess.Popen(
        [sys.executable, str(path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    numbers = [int(number) for number in process.stdout.readline().split()]
    process.kill()
    # Its end comes when all have closed what they inherited.
    assert process.communicate(timeout=60) == ("", "")
    # One that has ended is known until the system's first process has taken notice.
    until = time.monotonic() + 60.0
    while time.monotonic() < until and any(map(is_known, numbers)):
        time.sleep(0.1)
    for number in numbers:
        with pytest.raises(ProcessLookupError):
            os.kill(number, 0)


def is_known(number):
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.slow
def test_processes_that_die_at_their_start_are_reported(monkeypatch):
    monkeypatch.setattr("stiffopt.sweep.processes._serve_calls", os.abort)
    pool = Processes(2)
    with pytest.raises(WorkerLost):
        pool.submit(abs, -1).result()
    with pytest.raises(InputError, match="--workers 1"):
        pool.submit(abs, -1)
    pool.close(now=True)


@pytest.mark.parametrize(
    ("arguments", "ahead"),
    [
        (["FILE"], True),
        (["FILE", "--workers", "2"], True),
        (["--workers=2", "FILE"], True),
        (["FILE", "--workers", "1"], False),
        (["FILE", "--workers=1"], False),
        (["FILE", "--scheduler", "tcp://127.0.0.1:1"], False),
        (["--help"], False),
        (["missing.toml"], False),
    ],
)
def test_workers_load_ahead_if_the_command_uses_them(tmp_path, monkeypatch, arguments, ahead):
    begun = []
    monkeypatch.setattr("stiffopt.sweep.processes._start_fork_server", lambda: begun.append(True))
    monkeypatch.setattr("stiffopt.sweep.processes.cores", lambda: 4)
    file = str(sweep_file(tmp_path, GRID))
    load_ahead([file if each == "FILE" else each for each in arguments])
    assert bool(begun) == ahead
    begun.clear()
    monkeypatch.setattr("stiffopt.sweep.processes.cores", lambda: 1)
    load_ahead([file])
    assert not begun


def test_one_worker_is_this_process():
    assert isinstance(make_workers(1, None), InProcess)
    # One more than processes waits, so that none idles.
    assert make_workers(3, None).slots == 4


def test_several_starts_give_the_spread(tmp_path, capsys):
    path = sweep_file(tmp_path, 'starts = 4\n[grid]\n"motion.duration" = ["1.5 s"]')
    assert run(["sweep", str(path), "--out", str(tmp_path / "o"), "--workers", "1"]) == 0
    assert "4 of 4 usable starts end within 1 %" in capsys.readouterr().out
    (spread,) = json.loads((tmp_path / "o" / "sweep.json").read_text())["spread"]
    assert spread["usable"] == spread["starts"] == 4
    assert 0.0 <= spread["worst"] - spread["best"] < 1e-6 * spread["best"]


def test_front_decreases_and_has_its_knee_marked(tmp_path, capsys):
    text = '[front]\nover = "motion.duration"\nlower = "0.8 s"\nupper = "2.4 s"\npoints = 5'
    path = sweep_file(tmp_path, text)
    assert run(["sweep", str(path), "--out", str(tmp_path / "o"), "--workers", "1"]) == 0
    assert "Knee of the front: motion.duration = 1.2 s, objective" in capsys.readouterr().out
    front = json.loads((tmp_path / "o" / "sweep.json").read_text())["front"]
    assert (np.diff(front["objectives"]) < 0).all()
    # Of torques without gravity: proportional to the inverse fourth power of the duration.
    assert knee(np.linspace(0.8, 2.4, 5), np.linspace(0.8, 2.4, 5) ** -4.0) == 1


@pytest.mark.slow
def test_killed_sweep_resumes_with_the_results_of_an_undisturbed_one(tmp_path):
    text = '[latin_hypercube]\ncount = 12\n"motion.duration" = { lower = "1 s", upper = "2 s" }'
    path = sweep_file(tmp_path, text)
    command = [sys.executable, "-m", "stiffopt", "sweep", str(path), "--workers", "2", "--out"]
    out = tmp_path / "killed"
    process = subprocess.Popen([*command, str(out)], cwd=ROOT, start_new_session=True)
    while len(list((out / "cases").glob("*.json"))) < 3 and process.poll() is None:
        time.sleep(0.02)
    process.kill()
    process.wait()
    held = {each: each.stat().st_mtime_ns for each in (out / "cases").glob("*.json")}
    assert 3 <= len(held) < 12
    assert run(["sweep", str(path), "--out", str(out), "--workers", "1"]) == 0
    assert all(each.stat().st_mtime_ns == then for each, then in held.items())
    undisturbed = tmp_path / "undisturbed"
    assert run(["sweep", str(path), "--out", str(undisturbed), "--workers", "1"]) == 0
    one, other = rows(out), rows(undisturbed)
    assert len(one) == len(other) == 12
    # To the last digit: no case begins from what its worker did before.
    for name in ("case", "motion.duration", "status", "message", "objective"):
        assert [row[name] for row in one] == [row[name] for row in other]


@pytest.mark.slow
def test_cluster_with_a_killed_worker_finishes_all_cases(tmp_path):
    pytest.importorskip("distributed")
    text = '[latin_hypercube]\ncount = 16\n"motion.duration" = { lower = "1 s", upper = "2 s" }'
    path = sweep_file(tmp_path, text)
    begun_with = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": ROOT}
    started = []

    def begin(*words):
        command = [sys.executable, "-m", "distributed.cli." + words[0], *words[1:]]
        process = subprocess.Popen(command, **begun_with)
        started.append(process)
        return process

    try:
        address = tmp_path / "address.json"
        begin("dask_scheduler", "--port", "0", "--dashboard-address", ":0",
              "--scheduler-file", str(address))  # fmt: skip
        one, _ = (
            begin("dask_worker", "--scheduler-file", str(address), "--no-nanny", "--nthreads", "1",
                  "--no-dashboard")
            for _ in range(2)
        )  # fmt: skip
        while not address.exists():
            time.sleep(0.05)
        where = json.loads(address.read_text())["address"]
        out = tmp_path / "out"
        sweep = subprocess.Popen(
            [sys.executable, "-m", "stiffopt", "sweep", str(path), "--out", str(out), "--scheduler",
             where], cwd=ROOT)  # fmt: skip
        started.append(sweep)
        while len(list((out / "cases").glob("*.json"))) < 3 and sweep.poll() is None:
            time.sleep(0.02)
        assert sweep.poll() is None
        one.kill()
        assert sweep.wait(timeout=60) == 0
    finally:
        for process in started:
            process.kill()
            process.wait()
    assert [row["status"] for row in rows(out)] == 16 * ["optimal"]


def test_missing_scheduler_is_a_command_line_error(tmp_path, capsys):
    pytest.importorskip("distributed")
    path = sweep_file(tmp_path, GRID)
    out = tmp_path / "o"
    assert run(["sweep", str(path), "--out", str(out), "--scheduler", "nonsense"]) == 2
    assert "no Dask scheduler answers" in capsys.readouterr().err
    assert not out.exists()


def test_sweep_of_invalid_cases_is_refused(tmp_path, capsys):
    path = sweep_file(tmp_path, GRID.replace("motion.duration", "motion.duratoin"))
    out = tmp_path / "out"
    assert run(["sweep", str(path), "--out", str(out), "--workers", "1", "--quiet"]) == 2
    assert "duratoin" in capsys.readouterr().err
    assert not (out / "table.csv").exists()
