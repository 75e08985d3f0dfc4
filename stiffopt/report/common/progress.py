"""Live progress of a solve in the terminal, and of the many solves of a preload study."""

from __future__ import annotations

import time
from collections.abc import Callable

from rich.console import Console

from stiffopt.report.common.terminal import StatusLine
from stiffopt.report.common.text import si
from stiffopt.result.status import SolveProgress
from stiffopt.solver.monitor import Progress


class ProgressDisplay(StatusLine):
    """A status line that is called with each event.

    Parameters
    ----------
    title : str
        Title of the problem.
    unit : str
        SI unit of the objective; shown with a suitable prefix (mm, ms, ...).

    Examples
    --------
    >>> from types import SimpleNamespace
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
        super().__init__(title or "solving", console, clock)
        self._unit, self._stage = unit, ""

    def __call__(self, event: SolveProgress) -> None:
        """Show the event; without a terminal print at most one line per second and stage."""
        # Smaller relative violations are none.
        worst = f"{100 * event.violation:.2g} % {event.row}" if event.violation > 1e-6 else "none"
        line = (
            f"{event.elapsed:.1f} s  {event.stage}  iteration {event.iteration}  "
            f"objective {si(event.objective, self._unit)}  violation {worst.strip()}"
        )
        self.show_limited(line, 1.0, at_once=event.stage != self._stage)
        self._stage = event.stage


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
