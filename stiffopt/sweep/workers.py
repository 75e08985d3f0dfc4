"""Who solves the cases: this process, processes of this machine, or a Dask cluster.

All take a call and give a `concurrent.futures.Future`; `Workers.lost` is what tells of a death.
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


def make_workers(count: int | None, scheduler: str | None) -> Workers:
    """Workers as the command line asks for them: None counts the cores."""
    if scheduler is not None:
        return Cluster(scheduler)
    count = cores() if count is None else count
    return InProcess() if count == 1 else Processes(count)
