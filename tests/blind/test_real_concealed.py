"""What is hidden in a recording is of the size and the value that the page says."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.blind.key import Key
from benchmarks.blind.score import Named
from benchmarks.real_concealed.draw import plans
from benchmarks.real_concealed.hide import KINDS, hidden, unit_size
from benchmarks.real_concealed.motion import PublicSet
from benchmarks.real_concealed.page import page

SET = Path(__file__).parents[2] / "problems" / "recordings" / "two_link_friction"


@pytest.mark.parametrize("name", ["coulomb", "viscous", "offset", "motor gain", "payload"])
def test_the_size_is_what_was_added_to_the_torque(name: str, tmp_path: Path) -> None:
    """Root mean square over moving samples of the runs that are never fitted."""
    known = PublicSet(SET)
    kind = next(k for k in KINDS if k.name == name)
    changed = PublicSet(hidden(known, kind, 1, 0.5, tmp_path / "set"))
    added = [b.torque - a.torque for a, b in zip(known.tested, changed.tested, strict=True)]
    assert known.size(added) == pytest.approx(0.5 * unit_size(known, kind, 1))
    # A mass at the last link weighs on all joints before it, the others act on their own alone.
    assert (known.size(added)[0] > 0.1) == (name == "payload")


def test_draws_follow_from_the_key_and_the_page_counts_them() -> None:
    """The same key hides the same; a truth that is named counts, another does not."""
    sets = {"ur10e": PublicSet(SET), "dfki_a0815": PublicSet(SET)}
    key = Key("dev-1", "0" * 40)
    made = plans(key, sets, 16, 2)
    assert made == plans(key, sets, 16, 2)
    assert made != plans(Key("dev-2", "0" * 40), sets, 16, 2)
    assert len(made) == 18
    control = next(p for p in made if p.kind is None)
    case = next(p for p in made if p.kind is not None and p.kind.name == "coulomb")
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
