"""Worker processes of this machine, each at the end of a pipe of its own.

Pipes are known to nobody else: when all are killed at once, nothing is left that anybody would have
to clear away, as the semaphores of the standard library's pool are.
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

_NEEDED = "stiffopt.solver.family"
# Copies of a process are safe where no library begins threads of the system's own when it loads.
_FORKS = sys.platform == "linux"
# One process begins at a time: what it finds in the environment is everybody's.
_beginning = threading.Lock()

_Work = tuple[Callable[..., Any], tuple[Any, ...]]
_Calls = SimpleQueue["tuple[Future[Any], _Work] | None"]


class WorkerLost(Exception):
    """A worker process died with a call."""


class Processes:
    """Processes of this machine.

    Parameters
    ----------
    count : int
    """

    lost: tuple[type[BaseException], ...] = (WorkerLost,)

    def __init__(self, count: int) -> None:
        self._count = count
        self._calls: _Calls = SimpleQueue()
        self._hands: list[_Hand] = []
        # What all begin from loads while the cases are still being read.
        with _environment():
            _load_once()

    @property
    def slots(self) -> int:
        """One more than processes, so that none waits while its answer is written."""
        return self._count + 1

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Have a call made; all processes begin with the first one."""
        if any(hand.stillborn for hand in self._hands):
            raise InputError("worker processes die as soon as they begin; try --workers 1.")
        while len(self._hands) < self._count:
            self._hands.append(_Hand(self._calls))
            self._hands[-1].start()
        future: Future[Any] = Future()
        self._calls.put((future, (function, arguments)))
        return future

    def close(self, *, now: bool) -> None:
        """Let the processes go; they leave while the answer is written."""
        for hand in self._hands:
            hand.closed = True
            self._calls.put(None)
        if now:
            for hand in self._hands:
                hand.end()
        self._hands = []


def load_ahead(arguments: Sequence[str]) -> None:
    """Begin to load what workers need before the command line itself is, where it asks for some.

    Parameters
    ----------
    arguments : sequence of str
        Of `stiffopt sweep`. What is wrong with them is not told here.
    """
    words = [word for each in arguments for word in each.split("=", 1)]
    alone = cores() == 1 if "--workers" not in words else ("--workers", "1") in pairwise(words)
    if alone or "--scheduler" in words or not any(Path(word).is_file() for word in words):
        return
    with _environment():
        _load_once()


def cores() -> int:
    """Cores that this process may use; macOS tells only how many there are."""
    allowed = getattr(os, "sched_getaffinity", None)
    return len(allowed(0)) if allowed is not None else os.cpu_count() or 1


class _Hand(threading.Thread):
    """Hands calls to a worker process, and to another one when it has died.

    Parameters
    ----------
    calls : queue
        Of all hands; None is the end.
    """

    def __init__(self, calls: _Calls) -> None:
        super().__init__(daemon=True)
        self._calls = calls
        self._process: BaseProcess | None = None
        self.closed = False
        # Whether its process died before it could take a call.
        self.stillborn = False

    def run(self) -> None:
        """Begin a process, and hand calls on until there are no more."""
        pipe = self._begun()
        while (call := self._calls.get()) is not None and not self.closed:
            future, work = call
            if self._process is None or not self._process.is_alive():
                pipe = self._begun()
            try:
                pipe.send(work)
                found, error = pipe.recv()
            except (EOFError, OSError):
                pipe.close()
                self._process = None
                future.set_exception(WorkerLost("its worker process died"))
            else:
                future.set_result(found) if error is None else future.set_exception(error)
        pipe.close()

    def end(self) -> None:
        """End the process, whatever it does."""
        if self._process is not None:
            self._process.terminate()

    def _begun(self) -> Connection:
        """A new process: the pipe to it, once it has loaded."""
        context: Any = multiprocessing.get_context("forkserver" if _FORKS else "spawn")
        ends: tuple[Connection, Connection] = context.Pipe()
        pipe, other = ends
        with _beginning, _environment():
            _load_once()
            process = context.Process(target=_work, args=(other,))
            process.start()
        # Only what has begun can be ended.
        self._process = process
        other.close()
        try:
            pipe.recv()
        except (EOFError, OSError):
            self.stillborn = not self.closed
        return pipe


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


def _work(pipe: Connection) -> None:
    """A worker process: makes calls until there are no more.

    Ctrl-C is its parent's to take, whose end is its own.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()
    import_module(_NEEDED)
    with suppress(EOFError, OSError):
        pipe.send(None)
        while True:
            function, arguments = pipe.recv()
            found, failed = None, None
            try:
                found = function(*arguments)
            except BaseException as error:
                failed = error
            pipe.send((found, failed))


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
