"""Live progress of a solve in the terminal; plain lines where the output is not a terminal.

Only the latest event is drawn, so that drawing never delays the solver.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import ExitStack

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from stiffopt.report.common.text import si
from stiffopt.solver.monitor import Progress
from stiffopt.solver.solve_run import SolveProgress

PLAIN_INTERVAL = 1.0
DRAWS_PER_SECOND = 8
NEGLIGIBLE = 1e-6  # relative violation below which "none" is shown


class ProgressDisplay(ExitStack):
    """Context manager that is called with each event.

    Parameters
    ----------
    title : str
        Title of the problem.
    unit : str
        SI unit of the objective; shown with a suitable prefix (mm, ms, ...).
    console : rich.console.Console or None
        None: standard error, so that standard output stays free for results.
    clock : callable
        Seconds; replaced in tests.

    Examples
    --------
    >>>     >>> from rich.console import Console
    >>> event = SimpleNamespace(stage="homotopy 1 of 2", iteration=7, objective=2.97e-4,
    ...                         violation=0.012, row="torque, joint 2", elapsed=0.8)
    >>> with ProgressDisplay("demo", "m", Console(width=120, force_terminal=False)) as progress:
    ...     progress(event)
    0.8 s  homotopy 1 of 2  iteration 7  objective 0.297 mm  violation 1.2 % torque, joint 2
    """

    def __init__(
        self,
        title: str = "",
        unit: str = "",
        console: Console | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__()
        self.title, self.unit = title, unit
        self._console = Console(stderr=True) if console is None else console
        self._clock = clock
        self._live: Live | None = None
        self._event: SolveProgress | None = None
        self._stage = ""
        self._printed_at = -math.inf
        self._pending = False

    def __enter__(self) -> ProgressDisplay:
        self.callback(lambda: self._print_event() if self._pending else None)
        if self._console.is_terminal:
            self._live = self.enter_context(
                Live(
                    get_renderable=self._event_table,
                    console=self._console,
                    refresh_per_second=DRAWS_PER_SECOND,
                    transient=True,
                )
            )
        return self

    def __call__(self, event: SolveProgress) -> None:
        """Show the event; without a terminal print at most one line per second and stage."""
        self._event = event
        self._pending = True
        if self._live is not None:
            return
        now = self._clock()
        if event.stage != self._stage or now - self._printed_at >= PLAIN_INTERVAL:
            self._stage, self._printed_at = event.stage, now
            self._print_event()

    def _print_event(self) -> None:
        assert self._event is not None
        self._pending = False
        line = "  ".join(
            f"{label} {value}".strip() for label, value in _event_fields(self._event, self.unit)
        )
        self._console.print(Text(line), soft_wrap=True)

    def _event_table(self) -> Table:
        table = Table.grid(padding=(0, 2))
        table.add_row(Text(self.title or "solving", style="bold"))
        if self._event is not None:
            grid = Table.grid(padding=(0, 1))
            for label, value in _event_fields(self._event, self.unit):
                grid.add_row(Text(label or "", style="dim"), Text(value))
            table.add_row(grid)
        return table


class StudyProgress:
    """Adapter from the events of a preload study to a display, with totals over its many solves.

    Each short solve counts time and iterations from zero and has no stage: these events are summed.
    Events of motions are passed on unchanged.

    Parameters
    ----------
    display : callable
        Called with events that have a stage.
    stage : str
        Stage shown for events that have none.
    after : float
        Time before which nothing is shown [s].
    clock : callable
        Seconds; replaced in tests.
    """

    def __init__(
        self,
        display: Callable[[SolveProgress], object],
        stage: str = "preloads",
        after: float = 2.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._display, self._stage, self._after, self._clock = display, stage, after, clock
        self._begin = clock()
        self._iterations = 0

    def __call__(self, event: Progress | SolveProgress) -> None:
        """Pass an event on."""
        if isinstance(event, SolveProgress):
            self._display(event)
            return
        elapsed = self._clock() - self._begin
        self._iterations += event.iteration > 0
        # Every solve starts from the same point: only later iterations are informative.
        if elapsed >= self._after and event.iteration > 0:
            values = {**vars(event), "elapsed": elapsed, "iteration": self._iterations}
            self._display(SolveProgress(stage=self._stage, **values))


def _event_fields(event: SolveProgress, unit: str) -> list[tuple[str, str]]:
    worst = "none"
    if event.violation > NEGLIGIBLE:
        worst = f"{100 * event.violation:.2g} % {event.row}".strip()
    return [
        ("", f"{event.elapsed:.1f} s"),
        ("", event.stage),
        ("iteration", str(event.iteration)),
        ("objective", si(event.objective, unit)),
        ("violation", worst),
    ]
