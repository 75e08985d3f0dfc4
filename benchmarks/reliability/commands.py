"""The command line as a user runs it: another process, with limits of time and memory."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
SECONDS = 60.0
BYTES = 2 * 2**30


@dataclass(frozen=True)
class Outcome:
    """How a command ended.

    Parameters
    ----------
    code : int or None
        None: it did not end in time.
    error : str
        What it wrote to stderr.
    seconds : float
    """

    code: int | None
    error: str
    seconds: float

    @property
    def verdict(self) -> str:
        """One of "done", "told", "traceback", "crash", "hang", "silent"."""
        if self.code is None:
            return "hang"
        if "Traceback (most recent call last)" in self.error:
            return "traceback"
        if self.code < 0 or self.code > 130:
            return "crash"
        if self.code in (2, 3):
            return "told" if "stiffopt: " in self.error else "silent"
        return "done"


def stiffopt(
    arguments: Sequence[str],
    folder: Path,
    *,
    seconds: float = SECONDS,
    memory: int | None = BYTES,
    prepare: Callable[[], None] | None = None,
) -> Outcome:
    """Run `stiffopt` with `arguments` in `folder`; `memory` bytes at most."""
    began = time.monotonic()

    def limits() -> None:
        os.setpgrp()
        if memory is not None:
            resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        if prepare is not None:
            prepare()

    environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "COLUMNS": "200"}
    environment |= {"ARROW_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    process = subprocess.Popen(
        [sys.executable, "-m", "stiffopt", *arguments],
        cwd=folder,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        preexec_fn=limits,
        text=True,
        errors="replace",
    )
    try:
        _, error = process.communicate(timeout=seconds)
        code: int | None = process.returncode
    except subprocess.TimeoutExpired:
        process.kill()
        _, error = process.communicate()
        code = None
    return Outcome(code, error, time.monotonic() - began)
