"""Terminal output of commands: status line, sections, and tables without truncated cells."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Self

from rich.console import Console
from rich.status import Status
from rich.table import Table
from rich.text import Text


def print_lines(lines: Iterable[str | Text | None]) -> None:
    """Print each text on its own line, without markup; None is skipped."""
    console = Console(highlight=False, soft_wrap=True)
    for line in lines:
        if line is not None:
            console.print(line, markup=False)


def print_table(
    head: Sequence[str],
    rows: Iterable[Sequence[str]],
    title: str | None = None,
    numbers: Collection[str] = (),
) -> None:
    """Print a table; the columns named in `numbers` are right-aligned."""
    console = Console(highlight=False)
    if not console.is_terminal:
        # Width of a table in a file or log, where rich would truncate cells at 80 columns.
        console = Console(highlight=False, width=160)
    table = Table(title=None if title is None else Text(title, style="table.title"))
    for name in head:
        table.add_column(Text(name), justify="right" if name in numbers else "left")
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    console.print(table)


@dataclass(frozen=True, kw_only=True)
class ReportSection:
    """Part of an answer that page and terminal both show: a table and sentences."""

    title: str = ""
    lines: Sequence[str] = ()
    head: Sequence[str] = ()  # column headings; none without a table
    # Cells; several values of a cell stand on lines of their own.
    rows: Sequence[Sequence[str]] = ()
    numbers: Collection[str] = ()  # columns that the terminal aligns on the right


def print_section(section: ReportSection) -> None:
    """Print the table of a section, if it has one, and its sentences."""
    if section.rows:
        print_table(section.head, section.rows, section.title or None, section.numbers)
    print_lines(section.lines)


class StatusLine(ExitStack):
    """Context manager that shows a line: updated in place on a terminal, else printed each time.

    The default of `console` is standard error, so that standard output stays free for results;
    `clock` gives seconds, and is replaced in tests.
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
        self._printed_at, self._pending = -math.inf, ""

    def __enter__(self) -> Self:
        self.callback(lambda: self._pending and self.show(self._pending))
        if self._console.is_terminal:
            self._status = self.enter_context(self._console.status(Text(self._title)))
        return self

    def show_limited(self, line: str, interval: float, *, at_once: bool = False) -> None:
        """Show a line; where lines are printed, at most one an `interval` [s], and the last one."""
        moment = 0.0 if self._status is not None else self._clock()
        if self._status is not None or at_once or moment - self._printed_at >= interval:
            self._printed_at, self._pending = moment, ""
            self.show(line)
        else:
            self._pending = line

    def show(self, line: str, *, stays: bool = False) -> None:
        """Show a line; `stays` also prints it permanently on a terminal."""
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
        """Show a step; findings remain on the screen."""
        line = f"{self._clock() - self._begin:.1f} s  {sentence}"
        self.show(line, stays=sentence.startswith("found "))
