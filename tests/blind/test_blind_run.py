"""Steps over many cases: fair parts, resumed, and the least that is asked."""

import threading
from dataclasses import replace

import pytest

from benchmarks.blind import run
from benchmarks.blind.demands import unmet
from benchmarks.blind.mix import case_names
from benchmarks.blind.score import CaseScore
from benchmarks.blind.store import Store, write_json

RIGHT = CaseScore(
    id="main_0000",
    suite="main",
    kind="single",
    robot="small3",
    severity=1.0,
    link_encoders=True,
    z=26.0,
    sealed=True,
    void=False,
    status="ok",
    truth=(),
    verdict="named",
    exact=True,
)
QUIET = replace(RIGHT, id="none_0000", kind="none", severity=0.0, exact=None, false_alarm=False)


def test_a_part_of_a_run_is_a_fair_part():
    names = run.names({"main": 20, "none": 10, "sweep": 0})
    assert sorted(names) == sorted(case_names("main", 20) + case_names("none", 10))
    assert sum(name.startswith("none") for name in names[:15]) == 5


def test_answered_cases_are_left_alone_and_unmade_ones_skipped(tmp_path, monkeypatch):
    store, asked = Store(tmp_path), []
    for name in ("none_0000", "none_0001"):
        store.case(name).mkdir(parents=True)
        (store.case(name) / "commitment.txt").write_text("x")
    write_json(store.answer("none_0000") / "time.json", {})
    write_json(store.unmade("none_0002"), {"reason": "nothing to see"})

    def answer(name, store, timeout, stop):
        assert isinstance(stop, threading.Event)
        asked.append(name)
        return "ok"

    monkeypatch.setattr(run, "answer", answer)
    run.diagnose(store, case_names("none", 3), 2, 1.0)
    assert asked == ["none_0001"]
    with pytest.raises(FileNotFoundError, match="none_0003"):
        run.diagnose(store, case_names("none", 4), 2, 1.0)


def test_demands_say_what_is_not_met():
    assert unmet([RIGHT, QUIET]) == []
    wrong = replace(RIGHT, exact=False)
    assert unmet([wrong, QUIET]) == ["effect and joint right first in 0 of 1 cases"]
    assert "none_0000" in unmet([RIGHT, replace(QUIET, false_alarm=True)])[0]
    assert "timeout" in unmet([replace(RIGHT, status="timeout"), RIGHT, QUIET])[0]
    assert "committed" in unmet([replace(RIGHT, sealed=False), RIGHT, QUIET])[0]
    assert len(unmet([])) == 1
