"""Worker processes of this machine, each at the end of its own pipe.

A pool of `concurrent.futures` shares a queue and its semaphores: a killed parent leaks them, which
Python reports on stderr, and one dead worker breaks the calls of all others. Pipes leave nothing
behind, and a dead worker costs its own call only.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from importlib import import_module
from itertools import pairwise
from multiprocessing import connection, forkserver, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from stiffopt.errors import InputError

_PRELOADED_MODULE = "stiffopt.solver.family"
# Forking is safe on Linux only: elsewhere libraries start threads when they are loaded.
_USES_FORK_SERVER = sys.platform == "linux"
# Processes start one at a time: `_worker_environment` changes the environment of all threads.
_start_lock = threading.Lock()

_Call = tuple[Callable[..., Any], tuple[Any, ...]]
_CallQueue = SimpleQueue["tuple[Future[Any], _Call] | None"]


class WorkerLost(Exception):
    """A worker process died during a call."""


class Processes:
    """Pool of worker processes on this machine."""

    lost: tuple[type[BaseException], ...] = (WorkerLost,)

    def __init__(self, count: int) -> None:
        self._count = count
        self._calls: _CallQueue = SimpleQueue()
        self._threads: list[_WorkerThread] = []
        # The fork server loads while the cases are being read.
        with _worker_environment():
            _start_fork_server()

    @property
    def slots(self) -> int:
        """Number of processes and one, so that none waits while its result is written."""
        return self._count + 1

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Queue a call; the first one starts all processes.

        Raises `InputError`: worker processes die at their start.
        """
        if any(thread.failed_to_start for thread in self._threads):
            raise InputError("worker processes die at their start; use --workers 1.")
        while len(self._threads) < self._count:
            self._threads.append(_WorkerThread(self._calls))
            self._threads[-1].start()
        future: Future[Any] = Future()
        self._calls.put((future, (function, arguments)))
        return future

    def close(self, *, now: bool) -> None:
        """End the processes after their current calls; `now`: immediately."""
        for thread in self._threads:
            thread.closed = True
            self._calls.put(None)
        if now:
            for thread in self._threads:
                thread.terminate()
        self._threads = []


def load_ahead(arguments: Sequence[str]) -> None:
    """Start loading the workers' modules before the command line is loaded, if workers are used."""
    words = [word for each in arguments for word in each.split("=", 1)]
    alone = cores() == 1 if "--workers" not in words else ("--workers", "1") in pairwise(words)
    if alone or "--scheduler" in words or not any(Path(word).is_file() for word in words):
        return
    with _worker_environment():
        _start_fork_server()


def cores() -> int:
    """Cores available to this process; on macOS all cores."""
    allowed = getattr(os, "sched_getaffinity", None)
    return len(allowed(0)) if allowed is not None else os.cpu_count() or 1


class _WorkerThread(threading.Thread):
    """Thread that passes calls to one worker process, and replaces the process when it dies.

    `calls`: calls of all threads; None ends one thread.
    """

    def __init__(self, calls: _CallQueue) -> None:
        super().__init__(daemon=True)
        self._calls = calls
        self._process: BaseProcess | None = None
        self.closed = False
        # True if a process died before its first call.
        self.failed_to_start = False

    def run(self) -> None:
        """Start a process and pass calls on until the queue ends."""
        pipe = self._start_process()
        while (call := self._calls.get()) is not None and not self.closed:
            future, work = call
            if self._process is None or not self._process.is_alive():
                pipe = self._start_process()
            try:
                pipe.send(work)
                result, error = pipe.recv()
            except (EOFError, OSError):
                pipe.close()
                self._process = None
                future.set_exception(WorkerLost("its worker process died"))
            else:
                future.set_result(result) if error is None else future.set_exception(error)
        pipe.close()

    def terminate(self) -> None:
        """End the process during its call."""
        if self._process is not None:
            self._process.terminate()

    def _start_process(self) -> Connection:
        """Start a process; return the pipe to it once its modules are loaded."""
        context: Any = multiprocessing.get_context("forkserver" if _USES_FORK_SERVER else "spawn")
        ends: tuple[Connection, Connection] = context.Pipe()
        pipe, other = ends
        with _start_lock, _worker_environment():
            _start_fork_server()
            process = context.Process(target=_serve_calls, args=(other,))
            process.start()
        # Set after the start: only a started process can be terminated.
        self._process = process
        other.close()
        try:
            pipe.recv()
        except (EOFError, OSError):
            self.failed_to_start = not self.closed
        return pipe


def _start_fork_server() -> None:
    """Start the fork server, which loads the modules of nearly all cases.

    It has no threads and no locks that a forked worker would lack.
    """
    if not _USES_FORK_SERVER:
        return
    forkserver.set_forkserver_preload([_PRELOADED_MODULE])
    # Started explicitly: its start unblocks Ctrl-C.
    resource_tracker.ensure_running()
    # The fork server inherits the blocked Ctrl-C, which the parent handles alone.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve_calls(pipe: Connection) -> None:
    """Run calls in a worker process until its parent ends; the parent handles Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_exit_with_parent, args=(parent.sentinel,), daemon=True).start()
    import_module(_PRELOADED_MODULE)
    with suppress(EOFError, OSError):
        pipe.send(None)
        while True:
            function, arguments = pipe.recv()
            result, failure = None, None
            try:
                result = function(*arguments)
            except BaseException as error:
                failure = error
            pipe.send((result, failure))


def _exit_with_parent(sentinel: int) -> None:
    # A killed parent cannot end its workers.
    connection.wait([sentinel])
    os._exit(1)


@contextmanager
def _worker_environment() -> Iterator[None]:
    """Environment of workers: one thread each, no imports from the working folder."""
    wanted = {"OMP_NUM_THREADS": "1", "PYTHONSAFEPATH": "1"}
    added = [name for name in wanted if name not in os.environ]
    os.environ.update({name: wanted[name] for name in added})
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]
