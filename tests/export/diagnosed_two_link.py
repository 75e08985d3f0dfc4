"""The shipped recording set, diagnosed once a session."""

import atexit
import shutil
import tempfile
from functools import cache
from pathlib import Path

from small_arms import ROOT

from stiffopt.cli import run

TWO_LINK = ROOT / "problems" / "recordings" / "two_link_friction"


@cache
def diagnosed() -> Path:
    """Folder of its diagnosis."""
    folder = Path(tempfile.mkdtemp(prefix="stiffopt-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    out = folder / "out"
    assert run(["diagnose", str(TWO_LINK), "--out", str(out), "--quiet", "--no-experiment"]) == 0
    return out
