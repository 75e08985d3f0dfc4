"""Who solves the cases: this process, processes of this machine, or a Dask cluster.

All take a call and give a `concurrent.futures.Future`; `Workers.lost` is what tells of a death.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from importlib import import_module
from multiprocessing import connection, forkserver, resource_tracker
from typing import Any, Protocol

from stiffopt.errors import InputError

Call = Callable[..., Any]

_NEEDED = "stiffopt.solver.family"
# Copies of a process are safe where no library begins threads of the system's own when it loads.
_FORKS = sys.platform == "linux"


class Workers(Protocol):
    """Takes calls; `slots` is how many to give it at once."""

    # What a future raises whose worker died.
    lost: tuple[type[BaseException], ...]

    @property
    def slots(self) -> int:
        """How many calls keep it busy."""

    def submit(self, function: Call, *arguments: Any) -> Future[Any]:
        """Have a call made."""

    def close(self, *, now: bool) -> None:
        """Let the workers go; `now`: without waiting for what they do."""


class InProcess:
    """Makes each call at once, here."""

    lost: tuple[type[BaseException], ...] = ()
    slots = 1

    def submit(self, function: Call, *arguments: Any) -> Future[Any]:
        """Make the call."""
        future: Future[Any] = Future()
        future.set_result(function(*arguments))
        return future

    def close(self, *, now: bool) -> None:
        """Nothing to let go."""


class Processes:
    """Processes of this machine.

    Parameters
    ----------
    count : int
    """

    lost: tuple[type[BaseException], ...] = (BrokenProcessPool,)

    def __init__(self, count: int) -> None:
        self._count = count
        self._pool: Executor | None = None
        self._context = multiprocessing.get_context("forkserver" if _FORKS else "spawn")
        # What all begin from loads while the cases are still being read.
        with _environment():
            _load_once()

    @property
    def slots(self) -> int:
        """One more than processes, so that none waits while its answer is written."""
        return self._count + 1

    def submit(self, function: Call, *arguments: Any) -> Future[Any]:
        """Have a call made; after a death by new processes."""
        for _ in range(2):
            # Each process works on one core; it starts with the first call.
            with suppress(BrokenProcessPool), _environment():
                if self._pool is None:
                    _load_once()
                    own = self._context
                    self._pool = ProcessPoolExecutor(self._count, own, initializer=_begin)
                    for _ in range(self._count):
                        # All load at once, also where only one case can be begun.
                        self._pool.submit(_load)
                return self._pool.submit(function, *arguments)
            if self._pool is not None:
                self._pool.shutdown(wait=False)
                self._pool = None
        raise InputError("worker processes die as soon as they begin; try --workers 1.")

    def close(self, *, now: bool) -> None:
        """Let the processes go."""
        if self._pool is not None:
            if now:
                for process in multiprocessing.active_children():
                    process.terminate()
            # They leave while the answer is written.
            self._pool.shutdown(wait=False, cancel_futures=True)
            self._pool = None


class Cluster:
    """A Dask cluster; its scheduler gives a call whose worker died to another one.

    Parameters
    ----------
    address : str
        Of the scheduler. Its workers see the same files under the same paths.

    Raises
    ------
    InputError
        `distributed` is not installed, or no scheduler answers.
    """

    def __init__(self, address: str) -> None:
        try:
            distributed: Any = import_module("distributed")
        except ImportError as error:
            raise InputError(
                "--scheduler needs `distributed`: pip install 'stiffopt[cluster]'."
            ) from error
        self.lost: tuple[type[BaseException], ...] = (distributed.scheduler.KilledWorker,)
        try:
            self._client: Any = distributed.Client(address, timeout="10s", set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise InputError(f"--scheduler {address}: no Dask scheduler answers there.") from error
        self._executor = self._client.get_executor(pure=False)

    @property
    def slots(self) -> int:
        """Twice the threads of all workers, so that none waits for the next call."""
        return max(2 * int(sum(self._client.nthreads().values())), 1)

    def submit(self, function: Call, *arguments: Any) -> Future[Any]:
        """Have a call made."""
        future: Future[Any] = self._executor.submit(function, *arguments)
        return future

    def close(self, *, now: bool) -> None:
        """Let the cluster go; what it has not begun is dropped."""
        self._executor.shutdown(wait=not now)
        self._client.close()


def workers(count: int | None, scheduler: str | None) -> Workers:
    """Workers as the command line asks for them: None counts the cores."""
    if scheduler is not None:
        return Cluster(scheduler)
    count = _cores() if count is None else count
    return InProcess() if count == 1 else Processes(count)


def _cores() -> int:
    """Cores that this process may use; macOS tells only how many there are."""
    allowed = getattr(os, "sched_getaffinity", None)
    return len(allowed(0)) if allowed is not None else os.cpu_count() or 1


def _load_once() -> None:
    """Have one process load what nearly all cases need, of which the workers are copies.

    It does nothing else: there are no threads and no locks that a copy could miss.
    """
    if not _FORKS:
        return
    forkserver.set_forkserver_preload([_NEEDED])
    # This one comes with it, and lets Ctrl-C through again when it has begun.
    resource_tracker.ensure_running()
    # Ctrl-C while it loads is its parent's to take as well.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _load() -> None:
    """What nearly all cases need."""
    import_module(_NEEDED)


def _begin() -> None:
    """A worker process begins: Ctrl-C is its parent's to take, whose end is its own."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: int) -> None:
    # A parent that was killed cannot tell its workers.
    connection.wait([sentinel])
    os._exit(1)


@contextmanager
def _environment() -> Iterator[None]:
    """Of processes that begin: of one thread each, and nothing in the working folder is run."""
    wanted = {"OMP_NUM_THREADS": "1", "PYTHONSAFEPATH": "1"}
    added = [name for name in wanted if name not in os.environ]
    os.environ.update({name: wanted[name] for name in added})
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]
