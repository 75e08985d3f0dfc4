"""The tool's process can open what it was given and nothing else; whatever it does is recorded."""

import json
import subprocess
import sys
import threading

import pytest

from benchmarks.blind.sealed_tool import REFUSED
from benchmarks.blind.store import Store
from benchmarks.blind.tool import SCRIPT, answer

HERE = SCRIPT.parent


def sealed(code, folder):
    start = f"import sys; sys.path.append({str(HERE)!r}); import sealed_tool; sealed_tool.seal(); "
    return subprocess.run(
        [sys.executable, "-I", "-c", start + code], cwd=folder, capture_output=True, text=True
    )


def test_own_folder_and_package_are_open(tmp_path):
    (tmp_path / "given.txt").write_text("x")
    done = sealed("print(open('given.txt').read()); import stiffopt.errors", tmp_path)
    assert (done.returncode, done.stdout) == (0, "x\n"), done.stderr


@pytest.mark.parametrize(
    "code",
    [
        "open({secret!r})",
        "import os; os.listdir({folder!r})",
        "import os; os.open({secret!r}, os.O_RDONLY)",
        "import pathlib; pathlib.Path('../secret/truth.json').read_text()",
        "import os; os.symlink({secret!r}, 'link'); open('link')",
        "import subprocess; subprocess.run(['cat', {secret!r}])",
        "import os; os.system('ls')",
    ],
)
def test_everything_else_ends_the_process(tmp_path, code):
    own, other = tmp_path / "own", tmp_path / "secret"
    own.mkdir()
    other.mkdir()
    secret = other / "truth.json"
    secret.write_text("{}")
    done = sealed(code.format(secret=str(secret), folder=str(other)), own)
    assert done.returncode == REFUSED
    assert done.stderr.startswith("refused: ")


def test_failures_are_answers(tmp_path):
    store = Store(tmp_path)
    store.case("main_0000").mkdir(parents=True)
    (store.case("main_0000") / "recordings.toml").write_text("schema = 1\n")
    assert answer("main_0000", store, 60.0, threading.Event()) == "failed"
    said = json.loads((store.answer("main_0000") / "time.json").read_text())
    assert said["code"] == 2
    assert said["refused"] == []
    assert "recordings.toml" in (store.answer("main_0000") / "stderr.txt").read_text()


def test_slow_cases_end_and_interrupted_ones_stay_open(tmp_path):
    store = Store(tmp_path)
    for name in ("main_0000", "main_0001"):
        store.case(name).mkdir(parents=True)
    assert answer("main_0000", store, 0.05, threading.Event()) == "timeout"
    assert store.answered("main_0000")
    stop = threading.Event()
    stop.set()
    assert answer("main_0001", store, 60.0, stop) is None
    assert not store.answered("main_0001")
