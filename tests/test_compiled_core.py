"""The compiled core: how it is found, and the same answer without it."""

import os
import subprocess
import sys
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from small_arms import ROOT

from stiffopt import native, solve
from stiffopt.problem.files import load_problem


@pytest.fixture
def extension(tmp_path, monkeypatch):
    """A stand-in for the extension module, beside sources of its own."""
    monkeypatch.setattr(native, "__file__", str(tmp_path / "native.py"))
    path, source = tmp_path / "_native.so", tmp_path / "one.c"
    path.touch()
    source.touch()
    os.utime(source, (1e9, 1e9))
    found = SimpleNamespace(origin=str(path))
    monkeypatch.setattr(native.importlib.util, "find_spec", lambda _: found)
    native.library.cache_clear()
    yield path, source
    native.library.cache_clear()


def test_the_extension_is_found(extension):
    assert native.library() == extension[0]


def test_a_core_older_than_its_sources_is_not_used(extension):
    _, source = extension
    os.utime(source, (4e9, 4e9))
    with pytest.warns(UserWarning, match=r"older than its sources.*pip install -e"):
        assert native.library() is None


def test_a_missing_core_is_told_once(extension, monkeypatch):
    monkeypatch.setattr(native.importlib.util, "find_spec", lambda _: None)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        assert [native.library(), native.library(), native.loaded()] == [None] * 3
    assert [str(each.message).split(",")[0] for each in told] == [
        "stiffopt runs without its compiled core"
    ]


def test_a_problem_is_solved_without_the_core_as_with_it(monkeypatch):
    problem = load_problem(ROOT / "problems" / "two_link.toml").problem
    quick = solve(problem)
    monkeypatch.setattr(native, "library", lambda: None)
    slow = solve(problem)
    assert slow.objective.value == pytest.approx(quick.objective.value, rel=1e-6)
    q = np.linspace(0.0, quick.trajectory.duration, 50)
    np.testing.assert_allclose(slow.trajectory(q), quick.trajectory(q), atol=1e-5)


def test_the_command_line_tells_of_a_missing_core_in_one_sentence(tmp_path):
    problem, out = str(ROOT / "problems" / "two_link.toml"), str(tmp_path / "out")
    code = (
        "import sys\nfrom stiffopt import cli\nsys.modules['stiffopt._native'] = None\n"
        f"cli.run({['solve', problem, '--out', out]!r})\n"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    lines = [line for line in told.stderr.splitlines() if "compiled core" in line]
    assert len(lines) == 1
    assert lines[0].startswith("stiffopt: stiffopt runs without its compiled core")
