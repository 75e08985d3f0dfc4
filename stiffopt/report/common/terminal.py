"""What commands print when they are done: sentences, and tables that nothing cuts."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

# Of a table in a file or a log, where cells must not be cut.
_LOG_COLUMNS = 160


def print_lines(lines: Iterable[str | Text | None]) -> None:
    """Print each on a line of its own, as it is; None is left out."""
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
    """Print a table; columns of these headings to the right."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=_LOG_COLUMNS)
    table = Table(title=title)
    for name in head:
        table.add_column(Text(name), justify="right" if name in numbers else "left")
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    console.print(table)
