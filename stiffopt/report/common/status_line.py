"""One line that says how far a long command is; without a terminal a line now and then."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from typing import Self

from rich.console import Console
from rich.status import Status
from rich.text import Text


class StatusLine(ExitStack):
    """Context manager that shows a line: on a terminal one that moves, elsewhere each on its own.

    Parameters
    ----------
    title : str
    console : rich.console.Console or None
        None: standard error, so that standard output stays free for results.
    clock : callable
        Seconds; replaced in tests.
    """

    def __init__(
        self,
        title: str,
        console: Console | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__()
        self._title = title
        self._console = Console(stderr=True) if console is None else console
        self._clock = clock
        self._status: Status | None = None

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._status = self.enter_context(self._console.status(Text(self._title)))
        return self

    @property
    def moves(self) -> bool:
        """Whether there is one line that moves."""
        return self._status is not None

    def show(self, line: str, *, stays: bool = False) -> None:
        """Show a line; on a terminal one that `stays` is left on the screen as well."""
        if self._status is not None:
            self._status.update(Text(f"{self._title}: {line}"))
        if self._status is None or stays:
            self._console.print(Text(line), soft_wrap=True)


class StepDisplay(StatusLine):
    """A status line that is called with a sentence at every step."""

    def __enter__(self) -> Self:
        self._begin = self._clock()
        return super().__enter__()

    def __call__(self, sentence: str) -> None:
        """Show a step; what was found stays on the screen."""
        line = f"{self._clock() - self._begin:.1f} s  {sentence}"
        self.show(line, stays=sentence.startswith("found "))
