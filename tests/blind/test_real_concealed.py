"""What is hidden in a recording is of the size and the value that the page says."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.blind.key import Key
from benchmarks.blind.score import Named
from benchmarks.real_concealed import __main__ as concealed
from benchmarks.real_concealed import from_nominal
from benchmarks.real_concealed.draw import Plan, plans
from benchmarks.real_concealed.hide import KINDS, hidden, size
from benchmarks.real_concealed.motion import MOVING, PublicSet
from benchmarks.real_concealed.page import page

SET = Path(__file__).parents[2] / "problems" / "recordings" / "two_link_friction"


@pytest.mark.parametrize("name", ["coulomb", "viscous", "offset", "motor gain", "payload"])
def test_the_size_is_what_was_added_to_the_torque(name: str, tmp_path: Path) -> None:
    """Root mean square over moving samples, of the runs that show less of it."""
    known = PublicSet(SET)
    kind = next(k for k in KINDS if k.name == name)
    changed = PublicSet(hidden(known, kind, 1, 0.5, tmp_path / "set"))
    pairs = zip(known.trained + known.tested, changed.trained + changed.tested, strict=True)
    added = {id(a): b.torque - a.torque for a, b in pairs}
    found = known.size(lambda run: added[id(run)])
    assert found == pytest.approx(size(known, kind, 1, 0.5))
    for runs in (known.trained, known.tested):
        moving = [np.where(np.abs(r.velocity) > MOVING, added[id(r)], np.nan) for r in runs]
        assert found[1] <= np.sqrt(np.nanmean(np.vstack(moving)[:, 1] ** 2)) * (1.0 + 1e-9)
    # A mass at the last link weighs on all joints before it, the others act on their own alone.
    assert (found[0] > 0.1) == (name == "payload")


def test_a_delay_does_ever_less_and_noise_is_not_late() -> None:
    known = PublicSet(SET)
    delay = next(k for k in KINDS if k.name == "delay")
    sizes = [size(known, delay, 0, ms)[0] for ms in (2.0, 4.0, 300.0)]
    assert sizes[1] == pytest.approx(2.0 * sizes[0], rel=0.1)
    assert sizes[2] < 100.0 * sizes[0]
    raw = known.size(lambda run: -2e-3 * np.gradient(run.torque, run.time, axis=0))[0]
    assert sizes[0] < raw


def test_play_is_on_the_side_of_what_the_gear_carries() -> None:
    """The torque of a motor holds friction, the gear's load does not."""
    known = PublicSet(SET)
    run = known.trained[0]
    carried = known.carried(run)[:, 1]
    rigid = known.rigid_torques(known.folder / known.told["robot"], run)[:, 1]
    assert np.corrcoef(carried, rigid)[0, 1] > 0.99
    side = np.mean(np.sign(run.velocity[:, 1]) == np.sign(carried))
    assert side < np.mean(np.sign(run.velocity[:, 1]) == np.sign(run.torque[:, 1]))


def test_draws_follow_from_the_key_and_the_page_counts_them() -> None:
    """The same key hides the same; a truth that is named counts, another does not."""
    sets = {"ur10e": PublicSet(SET), "dfki_a0815": PublicSet(SET)}
    key = Key("dev-1", "0" * 40)
    made = plans(key, sets, 16, 2)
    assert made == plans(key, sets, 16, 2)
    assert made != plans(Key("dev-2", "0" * 40), sets, 16, 2)
    assert len(made) == 18
    control = next(p for p, *_ in made if p.kind is None)
    case = next(p for p, *_ in made if p.kind is not None and p.kind.name == "coulomb")
    assert case.kind is not None
    assert case.kind.truth(sets["ur10e"], case.joints[0]) == (Named("coulomb", case.joints[0] + 1),)
    finding = {
        "effect": "coulomb",
        "joint": case.joints[0] + 1,
        "parameters": {"dFc": {"value": 2.1, "sd": 0.1}},
        "confused_with": [],
    }
    truth = [{"effect": "coulomb", "joint": case.joints[0] + 1}]
    answer = {
        "joint": 0,
        "truth": truth,
        "amount": 2.0,
        "size": case.size,
        "stopped": False,
        "verdict": "named",
        "without": [],
        "from_nominal": None,
    }
    rows = [
        (case, answer | {"findings": [finding]}),
        (control, answer | {"findings": [], "verdict": "nothing_missing"}),
    ]
    text = page(key, rows, len(made))
    assert f"| {case.size:g} | 1 | 1 of 1" in text
    assert "Named where nothing is hidden: 0 of 1" in text
    assert "hold the truth: 1 of 1" in text
    finding["parameters"] = {"dFc": {"value": 2.1, "sd": None}}
    assert "hold the truth: none counted" in page(key, rows, len(made))


def test_what_repeats_a_case_is_drawn_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Play has three axes of one set: what is hidden already takes another place or size."""
    sets = {"ur10e": PublicSet(SET), "kuka_kr300": PublicSet(SET)}
    ways = next(
        ways
        for ways in plans(Key("dev-1", "0" * 40), sets, 30, 0)
        if ways[0].kind is not None and ways[0].kind.name == "coulomb"
    )
    assert len({(way.source, way.joints, way.size) for way in ways}) > 3
    monkeypatch.setattr(concealed, "answers", lambda *_: [{}])
    monkeypatch.setattr(concealed, "_amount", lambda plan, *_: (plan.size, 1.0, plan.joints[0]))
    made: list[tuple[Any, ...]] = []

    def diagnosed(plan: Plan, s: PublicSet, folder: Path, first: Any, case: Any) -> None:
        made.append(concealed.identity(plan, case))

    monkeypatch.setattr(concealed, "_diagnose", diagnosed)
    for _ in range(3):
        concealed._run(ways, sets, tmp_path, made)
    assert len(set(made)) == 3
    every = [concealed.identity(w, {"joint": w.joints[0], "amount": w.size}) for w in ways]
    concealed._run(ways, sets, tmp_path, every)
    assert len(made) == 3
    kept = json.loads((tmp_path / ways[0].name / "case.json").read_text())
    assert kept == {"drawn": None}


def _told(effect, value=1.0, sd=0.1, probability=0.9):
    return {
        "effect": effect,
        "joint": 2,
        "probability": probability,
        "parameters": {"dFc": {"value": value, "sd": sd}},
        "confused_with": [],
    }


@pytest.mark.parametrize(
    ("without", "findings", "expected", "false"),
    [
        ([], [_told("coulomb", 3.0)], "right", [False]),
        ([_told("coulomb", 1.0)], [_told("coulomb", 3.0)], "right", [False]),
        ([_told("coulomb", 1.0)], [_told("coulomb", 1.1)], "in group", [False]),
        ([], [_told("viscous") | {"confused_with": [_told("coulomb")]}], "in group", [True]),
        ([_told("viscous")], [_told("viscous")], "missed", [False]),
        ([], [_told("viscous", probability=0.7)], "missed", []),
    ],
)
def test_answers_from_the_nominal_model_are_judged(without, findings, expected, false):
    truth = [{"effect": "coulomb", "joint": 2}]
    found = {"truth": truth, "without": without, "from_nominal": findings}
    assert from_nominal.outcome(found, "dFc", 2.0) == expected
    assert from_nominal.claims(found) == false
    assert not any(from_nominal.claims(found, frozenset({"viscous"})))
