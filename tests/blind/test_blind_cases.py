"""Sealed cases: drawn from the key alone, sized by an oracle, kept from the tool."""

import json
import subprocess
import sys
from collections import Counter
from dataclasses import asdict, replace
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind.cases import make
from benchmarks.blind.key import Key, key_under_test
from benchmarks.blind.mix import CATALOGUE, KINDS, OUTSIDE, SEVERITIES, case_names, plan
from benchmarks.blind.oracle import balances, held_out, without_effects
from benchmarks.blind.severity import ALLOWED, START, sized
from benchmarks.blind.store import Store, whole_folder
from benchmarks.simulator import ROBOTS, CaseSpec, simulate

ROOT = Path(__file__).resolve().parents[2]
KEY = Key("dev-test", "0" * 40)
SHORT = CaseSpec(robot="planar2", seed=4, train=2, test=1, extrapolate=0, seconds=1.5, rate=250.0)


def test_nothing_that_makes_cases_knows_the_tool():
    code = (
        "import sys; import benchmarks.blind.cases, benchmarks.blind.oracle, benchmarks.blind.run;"
        "print([m for m in sys.modules if m.split('.')[0] == 'stiffopt'])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


def test_key_is_the_hash_of_the_commit():
    key = key_under_test()
    assert key.text.removesuffix("-dirty") == sha256(key.commit.encode()).hexdigest()
    assert key_under_test("dev-x").development
    with pytest.raises(ValueError, match="dev-"):
        key_under_test("0" * 64)
    with pytest.raises(ValueError, match="no commit"):
        key_under_test(commit="nothing-like-it")


def test_draws_follow_from_key_and_purpose_alone():
    again = Key(KEY.text, "1" * 40)
    names = case_names("main", 30)
    assert [plan(KEY, n) for n in names] == [plan(again, n) for n in reversed(names)][::-1]
    other = Key("dev-other", KEY.commit)
    assert [plan(KEY, n).seed for n in names] != [plan(other, n).seed for n in names]


def test_every_effect_has_its_turn():
    plans = [plan(KEY, name) for name in case_names("main", 200)]
    kinds = Counter(p.kind for p in plans)
    assert kinds == {k: KINDS.count(k) * 10 for k in ("single", "outside", "pair")}
    with_encoders = [p for p in plans if p.link_encoders]
    assert 0.75 < len(with_encoders) / len(plans) < 0.95
    assert len([p for p in plans if len(p.effects) == 2]) == kinds["pair"]
    first = {p.effects[0][0] for p in plans if p.kind == "single"}
    assert first >= set(CATALOGUE) - {"encoder_offset", "encoder_skew", "encoder_zero_change"}
    assert {p.effects[0][0] for p in plans if p.kind == "outside"} == set(OUTSIDE)
    assert {p.severity for p in plans} == set(SEVERITIES)
    assert all(plan(KEY, n).effects == () for n in case_names("none", 5))


def test_places_suit_the_effect():
    for name in case_names("main", 40):
        drawn = plan(KEY, name)
        assert drawn.joints(KEY, "payload") == [None]
        assert 1 not in drawn.joints(KEY, "wrist_coupling")
        for joint in drawn.joints(KEY, "belt_creep"):
            assert "belt" in ROBOTS[drawn.robot].connections[joint - 1]


def test_every_effect_has_a_first_guess():
    assert set(START) == set(CATALOGUE) | set(OUTSIDE)


def test_oracle_sees_nothing_where_nothing_is_missing():
    assert balances(simulate(SHORT)).z < 0.5


def test_oracle_counts_standard_deviations():
    """An offset of known size in one channel, all of whose rivals are bounded by tolerances."""
    size, joint = 0.5, 2
    case = simulate(replace(SHORT, effects=(("torque_offset", joint, size),), tolerance=1e-9))
    off = case.truth["effects"][0]["params"]["off"]
    counted = sum(
        (np.abs(run.clean[f"qd{joint}"])[5:-5] > 0.03).sum() for run in case.runs[: SHORT.train]
    )
    expected = abs(off) / case.robot.torque_noise[joint - 1] * np.sqrt(counted)
    assert balances(case).z == pytest.approx(expected, rel=0.03)
    blurred = simulate(replace(SHORT, effects=(("torque_offset", joint, size),)))
    assert balances(blurred).z < 0.999 * expected


def test_without_effects_is_the_exact_signal_where_nothing_is_missing():
    case = simulate(SHORT)
    r = len(case.runs) - 1
    healthy = without_effects(case, r, tolerances=True)
    nominal = without_effects(case, r, tolerances=False)
    for j in range(case.robot.joints):
        exact = case.runs[r].clean
        moving = np.abs(exact[f"qd{j + 1}"]) > 0.03
        for column, noise in (
            (f"tau{j + 1}", case.robot.torque_noise[j]),
            (f"ql{j + 1}", case.robot.link_noise),
        ):
            wrong = np.abs(healthy[column] - exact[column])[moving]
            assert wrong.max() < 0.05 * noise
            assert np.abs(nominal[column] - exact[column])[moving].max() > wrong.max()


def test_oracle_leaves_the_noise():
    found = held_out(simulate(SHORT))
    assert found["test"] == pytest.approx(1.0, abs=0.05)
    assert not found["void"]
    believed = held_out(simulate(replace(SHORT, stated_noise=0.5)))
    assert believed["test"] == pytest.approx(2.0, rel=0.1)
    assert believed["void"]


def test_severity_one_is_what_the_oracle_sees():
    found = sized(SHORT, "backlash", 2, START["backlash"])
    assert ALLOWED[0] <= found.z <= ALLOWED[1]
    without = replace(SHORT, link_encoders=False)
    assert sized(without, "encoder_offset", 1, START["encoder_offset"]) is None


def test_case_is_sealed(tmp_path, monkeypatch):
    monkeypatch.setattr("benchmarks.blind.cases.SECONDS", 1.0)
    store = Store(tmp_path)
    make(KEY, "none_0000", store)
    truth = store.truth("none_0000").read_bytes()
    commitment = (store.case("none_0000") / "commitment.txt").read_text().strip()
    assert sha256(truth).hexdigest() == commitment
    said = json.loads(truth)
    assert said["kind"] == "none"
    assert CaseSpec(**{**said["spec"], "effects": ()}).name == "none_0000"
    assert set(asdict(CaseSpec())) == set(said["spec"])
    oracle = json.loads(store.oracle("none_0000").read_text())
    assert {run["role"] for run in oracle["runs"]} == {"test", "extrapolate"}
    for run in oracle["runs"]:
        for kind in ("pred", "healthy", "nominal"):
            with np.load(store.oracle_predictions("none_0000") / f"{kind}_{run['run']}.npz") as f:
                assert "tau1" in f.files
    written = {p.name for p in store.case("none_0000").iterdir()}
    assert not {name for name in written if "truth" in name or "pred" in name}


def test_folder_is_whole_or_absent(tmp_path):
    def fails():
        with whole_folder(tmp_path / "x") as folder:
            (folder / "half").write_text("")
            raise RuntimeError("on the way")

    with pytest.raises(RuntimeError):
        fails()
    assert not list(tmp_path.iterdir())
