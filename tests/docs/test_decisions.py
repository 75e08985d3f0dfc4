"""Decisions are short; their measurements stand in `benchmarks/decisions`."""

import pytest
from small_arms import ROOT

DECISIONS = sorted((ROOT / ".github" / "docs" / "decisions").glob("*.md"))
MAX_LINES = 15


@pytest.mark.parametrize("path", DECISIONS, ids=lambda path: path.stem)
def test_a_decision_has_few_lines_and_its_own_number(path):
    title, *lines = path.read_text(encoding="utf-8").splitlines()
    assert title.startswith(f"# {path.stem[:4]} ")
    assert sum(bool(line.strip()) for line in lines) <= MAX_LINES


def test_decisions_have_different_numbers():
    numbers = [path.stem[:4] for path in DECISIONS]
    assert len(set(numbers)) == len(numbers)
