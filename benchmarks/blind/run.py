"""The steps of a run over many cases: resumable, side by side, stoppable at any time."""

from __future__ import annotations

import multiprocessing
import signal
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from typing import Any

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from .cases import make
from .key import Key
from .mix import case_names
from .store import Store, write_json
from .tool import answer


def names(suites: dict[str, int]) -> list[str]:
    """All cases of a run, suites mixed, so that a part of a run is a fair part."""
    ranked = [
        ((i + 0.5) / count, name)
        for suite, count in suites.items()
        for i, name in enumerate(case_names(suite, count))
    ]
    return [name for _, name in sorted(ranked)]


def write_manifest(key: Key, store: Store, suites: dict[str, int]) -> None:
    write_json(
        store.manifest,
        {
            "key": key.text,
            "commit": key.commit,
            "development": key.development,
            "created": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            "suites": suites,
        },
    )


def _deaf() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def generate(key: Key, store: Store, cases: Sequence[str], jobs: int) -> None:
    """Make and seal the cases that are not there yet."""
    left = [name for name in cases if not store.made(name)]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context, initializer=_deaf) as pool:
        _each("make cases", pool, lambda name: pool.submit(make, key, name, store), left, cases)


def diagnose(store: Store, cases: Sequence[str], jobs: int, timeout: float) -> None:
    """Let the tool answer the cases that it has not answered yet."""
    cases = [name for name in cases if not store.unmade(name).exists()]
    missing = [name for name in cases if not store.made(name)]
    if missing:
        raise FileNotFoundError(
            f"{len(missing)} cases are not made yet, the first is {missing[0]}: generate them first"
        )
    left = [name for name in cases if not store.answered(name)]
    stop = threading.Event()
    with ThreadPoolExecutor(jobs) as pool:
        try:
            _each(
                "diagnose",
                pool,
                lambda name: pool.submit(answer, name, store, timeout, stop),
                left,
                cases,
            )
        finally:
            stop.set()


def _each(
    title: str,
    pool: Executor,
    submit: Callable[[str], Future[Any]],
    left: Sequence[str],
    cases: Sequence[str],
) -> None:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[last]}"),
    )
    with Progress(*columns) as progress:
        task = progress.add_task(title, total=len(cases), completed=len(cases) - len(left), last="")
        futures = {submit(name): name for name in left}
        try:
            open_ = set(futures)
            while open_:
                done, open_ = wait(open_, return_when=FIRST_COMPLETED)
                for future in done:
                    note = future.result()
                    last = f"{futures[future]} {note or ''}"
                    progress.update(task, advance=1, last=last.strip())
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
