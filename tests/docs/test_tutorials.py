"""Every file, command and Python block of the tutorials works in the order in which it stands."""

import re
import shlex

import pytest
from small_arms import ROOT

from stiffopt.cli import run

TUTORIALS = sorted((ROOT / ".github" / "docs" / "tutorials").glob("*.md"))
BLOCK = re.compile(r"(?:Save as `(?P<name>[\w.]+)`[^`]*)?```(?P<kind>\w+)\n(?P<text>.*?)```", re.S)


@pytest.mark.slow
@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_tutorial_runs(path, tmp_path, monkeypatch):
    (tmp_path / "problems").symlink_to(ROOT / "problems")
    monkeypatch.chdir(tmp_path)
    kinds = []
    for block in BLOCK.finditer(path.read_text(encoding="utf-8")):
        kind, text = block["kind"], block["text"]
        kinds.append(kind)
        if kind == "toml":
            (tmp_path / block["name"]).write_text(text, encoding="utf-8")
        elif kind == "sh":
            for line in text.splitlines():
                program, *arguments = shlex.split(line)
                assert program == "stiffopt"
                assert run(arguments) == 0, line
        elif kind == "python":
            exec(compile(text, str(path), "exec"), {"__name__": "tutorial"})
    assert {"sh", "python"} <= set(kinds)
