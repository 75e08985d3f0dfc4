"""What benchmarks tell where a peer gives no answer, and of where their records come from."""

from __future__ import annotations

import json
import runpy
import signal
import sys

import pytest

from benchmarks.identification_peers import __main__ as identification
from benchmarks.peers import __main__ as peers
from benchmarks.peers.judge import Judged
from benchmarks.random_problems import __main__ as random_problems

RUN = {"build_s": 1.0, "first_s": 2.0, "second_s": 0.5, "process_s": 4.0}


def python(source, **limits):
    return peers.finished([sys.executable, "-c", source], **limits)


@pytest.mark.parametrize(
    ("source", "limits", "why"),
    [
        ("import time; time.sleep(60)", {"clock": 0.5}, "no answer in 0.5 s by the clock"),
        ("while True: pass", {"seconds": 1}, "no answer in 1 CPU s"),
        (
            f"import os; os.kill(os.getpid(), {int(signal.SIGKILL)})",
            {},
            "no answer: ended by SIGKILL",
        ),
        ("raise ValueError('no numbers')", {}, "no answer: ValueError: no numbers"),
    ],
)
def test_why_a_peer_gave_no_answer_is_told(source, limits, why):
    assert python(source, **limits) == peers.NoAnswer(why)
    assert python("print('{}')") == "{}\n"


def test_the_limit_leaves_a_process_a_fine_clock():
    source = """
import statistics, time
seen = [time.process_time() for _ in range(2000)]
print(statistics.median(b - a for a, b in zip(seen, seen[1:])) > 0.0)
"""
    assert python(source) == "True\n"


@pytest.mark.parametrize(("fails", "number"), [("stiffopt", 1), ("toppra", 2)])
def test_a_peer_that_fails_has_no_numbers_and_leaves_the_others_theirs(monkeypatch, fails, number):
    asked = {"stiffopt": 0, "toppra": 0}

    def answer(name, _):
        asked[name] += 1
        ended = name == fails and asked[name] == number
        return peers.NoAnswer("no answer: it fell") if ended else dict(RUN)

    monkeypatch.setattr(peers, "asked", answer)
    monkeypatch.setattr(peers, "task_of", lambda _: {})
    worth = Judged(objective=1.0, excess=0.0, miss=0.0)
    monkeypatch.setattr(peers, "judge", lambda *_: worth)
    there = dict.fromkeys(asked, sys.executable)
    monkeypatch.setattr(type(peers.PEERS), "python", lambda _, name: there.get(name))
    monkeypatch.setattr(type(peers.PEERS), "absence", lambda *_: "not installed")
    lines = peers.measure(peers.TASKS["two_link"], 2)
    rows = {name: next(each for each in lines if each.startswith(f"| {name} |")) for name in asked}
    assert f"round {number} of 2: no answer: it fell" in rows.pop(fails)
    (other,) = rows.values()
    # The ratio is to stiffopt's.
    assert ("| 0.5 | – |" in other) if fails == "stiffopt" else ("| 0.5 | 1.00 |" in other)


def test_random_problems_of_another_seed_have_a_file_of_their_own(monkeypatch, tmp_path, capsys):
    def run(*options):
        monkeypatch.setattr(sys, "argv", ["x", "--feasible", "1", "--infeasible", "0", *options])
        random_problems.main()

    monkeypatch.setattr(random_problems, "HERE", tmp_path)
    monkeypatch.setattr(random_problems, "feasible", lambda number, seed: (number, seed))
    monkeypatch.setattr(
        random_problems, "solved", lambda p: {"title": f"{p}", "status": "optimal", "cpu": 1.0}
    )
    monkeypatch.setattr(random_problems, "commit", lambda: "abc1234")
    run()
    run("--seed", "15")
    for folder, seed in (("work", random_problems.SEED), ("work/seed_15", 15)):
        (line,) = (tmp_path / folder / "feasible.jsonl").read_text().splitlines()
        record = json.loads(line)
        assert (record["seed"], record["commit"]) == (seed, "abc1234")
    with pytest.raises(SystemExit):
        run("--seed", "16", "--work", str(tmp_path / "work"))
    assert "give another --work" in capsys.readouterr().err


def test_the_page_says_of_its_records_what_they_say():
    record = {"status": "optimal", "fine": 0.0, "cpu": 1.0, "title": "x", "message": ""}
    known = {**record, "commit": "abc1234"}
    told = random_problems.page([record, known, known], [], [known])
    assert "Solved: 2 at abc1234, 1 at commits that their records do not name." in told
    assert "Solved: 1 at abc1234." in told
    assert "once" not in told


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (["nowhere"], "No set 'nowhere': take one of here."),
        (["here", "nowhere"], "No set 'nowhere'"),
        (["install", "nothing"], "No peer 'nothing': take one of figaroh, mujoco, pysindy."),
        ([], "No recordings in"),
        (["here"], "recordings.toml"),
    ],
)
def test_unknown_sets_and_peers_end_in_a_sentence(monkeypatch, tmp_path, capsys, names, said):
    if names:
        (tmp_path / "here").mkdir()
        (tmp_path / "here" / "recordings.toml").write_text("schema = 1\n")
    monkeypatch.setattr(identification, "RECORDINGS", tmp_path)
    monkeypatch.setattr(identification, "HERE", tmp_path)
    monkeypatch.setattr(sys, "argv", ["identification_peers", *names])
    with pytest.raises(SystemExit) as stopped:
        identification.main()
    assert stopped.value.code == 2
    assert said in capsys.readouterr().err


def test_a_missing_package_of_loop_peers_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "cma", None)
    with pytest.raises(SystemExit, match=r"cma.* Install the packages mujoco\[sysid\] and cma"):
        runpy.run_module("benchmarks.loop_peers", run_name="__main__")
