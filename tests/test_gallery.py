"""The gallery shows every shipped problem with the values that are expected of it now."""

from __future__ import annotations

import re
import tomllib

import pytest
from small_arms import ROOT

from benchmarks.gallery import section

PAGE = ROOT / ".github" / "gallery.md"
PROBLEMS = [
    path
    for path in sorted((ROOT / "problems").glob("*.toml"))
    if tomllib.loads(path.read_text(encoding="utf-8"))["kind"] in ("trajectory", "preload")
]


@pytest.mark.parametrize("problem", PROBLEMS, ids=lambda path: path.stem)
def test_each_problem_has_its_section(problem):
    """Else: python -m benchmarks.gallery RESULTS."""
    document = tomllib.loads(problem.read_text(encoding="utf-8"))
    image = PAGE.parent / "images" / f"gallery_{problem.stem}.svg"
    assert section(problem, document, image) in PAGE.read_text(encoding="utf-8")
    assert image.is_file() or document["kind"] == "preload"


def test_pictures_are_there_and_small():
    shown = re.findall(r"\]\((images/[^)]+)\)", PAGE.read_text(encoding="utf-8"))
    assert len(shown) >= 14
    for name in shown:
        text = (PAGE.parent / name).read_text(encoding="utf-8")
        assert text.startswith("<svg")
        assert len(text) < 100_000
