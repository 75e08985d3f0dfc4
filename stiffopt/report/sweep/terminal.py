"""What `stiffopt sweep` shows while it runs and when it is done."""

from __future__ import annotations

import math
from pathlib import Path

from stiffopt.report.common.status_line import StatusLine
from stiffopt.report.common.terminal import print_lines
from stiffopt.report.sweep.sentences import headline, knee_sentence, spread_sentence
from stiffopt.sweep.run import SweepProgress
from stiffopt.sweep.store import TABLE_FILE
from stiffopt.sweep.summary import SweepSummary

PLAIN_INTERVAL = 5.0


class SweepDisplay(StatusLine):
    """A status line that is called with each event of a sweep; without a terminal now and then."""

    _printed_at = -math.inf

    def __call__(self, event: SweepProgress) -> None:
        """Show how far the sweep is, and the time left."""
        now = self._clock()
        if self.moves or now - self._printed_at >= PLAIN_INTERVAL or event.done == event.total:
            self._printed_at = now
            self.show(progress_line(event))


def progress_line(event: SweepProgress) -> str:
    """How far a sweep is, in one line.

    >>> progress_line(SweepProgress(done=30, total=200, unusable=1, elapsed=60.0, left=340.0))
    '30 of 200 cases (1 without a usable result), 1 min 0 s, about 5 min 40 s left'
    """
    bad = f" ({event.unusable} without a usable result)" if event.unusable else ""
    line = f"{event.done} of {event.total} cases{bad}, {_format_duration(event.elapsed)}"
    if event.left is None or event.done == event.total:
        return line
    return f"{line}, about {_format_duration(event.left)} left"


def print_sweep(summary: SweepSummary, folder: Path) -> None:
    """How the cases ended, knee and spread, and where the files are."""
    print_lines(
        (
            f"{headline(summary)}.",
            knee_sentence(summary) or None,
            spread_sentence(summary) or None,
            "Interrupted: the same command goes on from here." if summary.interrupted else None,
            f"Table: {folder / TABLE_FILE}",
            f"Report: {folder / 'report.html'}",
        )
    )


def _format_duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"
