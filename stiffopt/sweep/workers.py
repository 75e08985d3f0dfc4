"""Workers of a sweep: this process, processes of this machine, or a Dask cluster.

All return a `concurrent.futures.Future` for a call, which raises `Workers.lost` if its worker dies.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from importlib import import_module
from typing import Any, Protocol

from stiffopt.errors import InputError
from stiffopt.sweep.processes import Processes, cores

Call = Callable[..., Any]


class Workers(Protocol):
    """Executor of calls."""

    # Exceptions of a future whose worker died.
    lost: tuple[type[BaseException], ...]

    @property
    def slots(self) -> int:
        """Number of simultaneous calls that keeps all workers busy."""

    def submit(self, function: Call, *arguments: Any) -> Future[Any]:
        """Queue a call."""

    def close(self, *, now: bool) -> None:
        """End the workers; `now`: without waiting for their calls."""


class InProcess:
    """Worker that makes each call on submission in this process."""

    lost: tuple[type[BaseException], ...] = ()
    slots = 1

    def submit(self, function: Call, *arguments: Any) -> Future[Any]:
        """Make the call."""
        future: Future[Any] = Future()
        future.set_result(function(*arguments))
        return future

    def close(self, *, now: bool) -> None:
        """Do nothing."""


class Cluster:
    """Dask cluster, whose scheduler repeats the calls of dead workers.

    `address`: address of the scheduler, whose workers see the same files under the same paths.
    Raises `InputError`: `distributed` is not installed, or no scheduler answers.
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
        """Twice the number of worker threads, so that none waits for the next call."""
        return max(2 * int(sum(self._client.nthreads().values())), 1)

    def submit(self, function: Call, *arguments: Any) -> Future[Any]:
        """Queue a call."""
        future: Future[Any] = self._executor.submit(function, *arguments)
        return future

    def close(self, *, now: bool) -> None:
        """Disconnect from the cluster; pending calls are dropped."""
        self._executor.shutdown(wait=not now)
        self._client.close()


def make_workers(count: int | None, scheduler: str | None) -> Workers:
    """Make the workers of the command line: one per core for `count` None, or a Dask cluster."""
    if scheduler is not None:
        return Cluster(scheduler)
    count = cores() if count is None else count
    return InProcess() if count == 1 else Processes(count)
