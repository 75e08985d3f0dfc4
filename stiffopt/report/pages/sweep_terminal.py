"""Terminal output and sentences of `stiffopt sweep`."""

from __future__ import annotations

from pathlib import Path

from stiffopt.formatting import pm
from stiffopt.report.common.terminal import ReportSection, StatusLine, print_lines, print_section
from stiffopt.report.common.text import DASH, listed, si, words
from stiffopt.sweep.run import SweepProgress
from stiffopt.sweep.shared_values import SharedValue
from stiffopt.sweep.summary import TABLE_FILE, SweepSummary

# Standard deviations from zero beyond which a common value is told.
_MIN_DEVIATIONS = 2.0


class SweepDisplay(StatusLine):
    """A status line that is called with each event of a sweep."""

    def __call__(self, event: SweepProgress) -> None:
        """Show progress and remaining time."""
        self.show_limited(progress_line(event), 5.0, at_once=event.done == event.total)


def progress_line(event: SweepProgress) -> str:
    """Return the progress of a sweep in one line.

    >>> progress_line(SweepProgress(done=30, total=200, unusable=1, elapsed=60.0, left=340.0))
    '30 of 200 cases (1 without a usable result), 1 min 0 s, about 5 min 40 s left'
    """
    bad = f" ({event.unusable} without a usable result)" if event.unusable else ""
    line = f"{event.done} of {event.total} cases{bad}, {_format_duration(event.elapsed)}"
    if event.left is None or event.done == event.total:
        return line
    return f"{line}, about {_format_duration(event.left)} left"


def print_sweep(summary: SweepSummary, folder: Path) -> None:
    """Print counts by status, knee, spread of optima, shared values and paths of the files."""
    print_lines(
        (
            f"{headline(summary)}.",
            knee_sentence(summary) or None,
            spread_sentence(summary) or None,
        )
    )
    print_section(shared_section(summary))
    print_lines(
        (
            "Interrupted: the same command resumes the sweep." if summary.interrupted else None,
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


def headline(summary: SweepSummary) -> str:
    """Return the number of cases by status."""
    counts = [f"{number} {words(name)}" for name, number in summary.statuses().items()]
    return f"{len(summary.sweep.cases)} cases: {listed(counts)}"


def knee_sentence(summary: SweepSummary) -> str:
    """Return a sentence on the knee of the Pareto front; "" without a front."""
    front = summary.front()
    if front is None:
        return ""
    if front.knee is None:
        return f"Fewer than three cases trade {front.over} for the objective: no knee."
    value = si(float(front.objectives[front.knee]), summary.units["objective"])
    at = f"{front.values[front.knee]:.4g} {front.unit}".rstrip()
    return f"Knee of the front: {front.over} = {at}, objective {value}."


def shared_section(summary: SweepSummary) -> ReportSection:
    """Return what several arms share in the simulation from commands, and what is each arm's own.

    Common values that are not clearly different from zero are left out.
    """
    values = [
        each
        for each in summary.shared_values()
        if not each.common or abs(each.value) > _MIN_DEVIATIONS * each.sd
    ]
    names = list(dict.fromkeys(name for each in values for name, _, _ in each.arms))
    rows = []
    for each in values:
        told = {name: pm(value, sd, each.unit) for name, value, sd in each.arms}
        common = pm(each.value, each.sd, each.unit) if each.common else "each arm's own"
        rows.append([_place_words(each), *(told.get(name, DASH) for name in names), common])
    lines = [
        f"{title}: {'; '.join(places)}."
        for title, common in (("Common to all arms", True), ("Each arm's own", False))
        if (places := [_place_words(each) for each in values if each.common == common])
    ]
    head = ["value", *names, "of all arms"]
    return ReportSection(title="Values of several arms", head=head, rows=rows, lines=lines)


def _place_words(value: SharedValue) -> str:
    name = words(value.parameter)
    name += "" if value.joint is None else f" of joint {value.joint}"
    return f"{name} ({value.case})" if value.case else name


def spread_sentence(summary: SweepSummary) -> str:
    """Return a sentence on the spread of optima over several starts; "" with one start."""
    spreads = list(summary.spreads().values())
    if not spreads:
        return ""
    furthest = max(spreads, key=lambda each: abs(each.worst - each.best) / (abs(each.best) or 1.0))
    near = sum(each.near for each in spreads)
    usable = sum(each.usable for each in spreads)
    return (
        f"{near} of {usable} usable starts end within 1 % of the best of their case; the widest "
        f"spread is {si(furthest.best, furthest.unit)} to {si(furthest.worst, furthest.unit)}."
    )
