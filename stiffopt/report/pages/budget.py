"""report.html and terminal output of an error budget."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from stiffopt.budget.budget import ORIENTATION, POSITION, ErrorBudget
from stiffopt.budget.measurements import Measurement
from stiffopt.budget.volume import VolumeBudget
from stiffopt.report.common.page import PageFigures, write_page
from stiffopt.report.common.svg import PALETTE, figure_style, subplots
from stiffopt.report.common.terminal import ReportSection, print_lines, print_section
from stiffopt.report.common.text import MAX_LISTED, percent, scale, si

# Share of the largest bound from which on a known error is told before the measurements.
_MIN_KNOWN_SHARE = 0.5


def write_budget_report(
    title: str,
    budget: ErrorBudget,
    volume: VolumeBudget,
    measurements: Sequence[Measurement],
    assumptions: Sequence[str],
    folder: Path,
) -> Path:
    """Write report.html and its figures as SVG and PNG into `folder`; return the page."""
    figures = PageFigures("budget")
    figures.draw("time", bounds_figure(budget), "Error bounds over time")
    figures.draw("volume", volume_figure(budget, volume), "Error bound over the work volume")
    context = {
        "title": f"{title}: error budget of the tool",
        "headline": headline(budget, volume),
        "advice": advice(budget, measurements),
        "shares": share_section(budget),
        "causes": largest_causes(budget),
        "measurements": measurement_section(budget, measurements),
        "volume": volume,
        "assumptions": assumptions,
    }
    return write_page("pages/budget.html.j2", folder / "report.html", context, figures)


def headline(budget: ErrorBudget, volume: VolumeBudget) -> str:
    """Return the largest bounds in words."""
    position, orientation = (budget.bound(rows) for rows in (POSITION, ORIENTATION))
    at = float(budget.states.time[int(np.argmax(position))])
    text = (
        f"With 95 % confidence the tool is within {si(position.max(), 'm', 3)} (largest at "
        f"{at:.3f} s) and {si(orientation.max(), 'rad', 3)} of its path"
    )
    if len(volume.budget.place):
        largest = si(volume.budget.bound(POSITION).max(), "m", 3)
        text += f"; over the work volume at rest within {largest}"
    return f"{text}."


def advice(budget: ErrorBudget, measurements: Sequence[Measurement]) -> str:
    """Return in words what narrows the bound most: a command, or a measurement."""
    bound = budget.bound(POSITION)
    known = float(np.linalg.norm(budget.mean[int(np.argmax(bound)), POSITION]))
    best = _best_measurement(measurements)
    if known < _MIN_KNOWN_SHARE * bound.max():
        return best
    return (
        f"{si(known, 'm', 3)} of the bound is a known error, which no measurement narrows: give the"
        f" folder of a solve with a command, which leads the wind-up. {best}"
    )


def _best_measurement(measurements: Sequence[Measurement]) -> str:
    # Gain below which a measurement is not recommended.
    if not measurements or measurements[0].gain < 0.01:
        return "No measurement narrows the bound by 1 % or more: it is a mean error, or hysteresis."
    best = measurements[0]
    return (
        f"The measurement that narrows the bound most is {best.name}: to {si(best.bound, 'm', 3)}, "
        f"{100.0 * best.gain:.0f} % less."
    )


def share_section(budget: ErrorBudget) -> ReportSection:
    """Return groups with their mean shares along the motion, of position and orientation."""
    first, second = (budget.shares(rows) for rows in (POSITION, ORIENTATION))
    means = {
        name: [float(np.mean(part.get(name, 0.0))) for part in (first, second)]
        for name in dict.fromkeys([*first, *second])
    }
    head = ("source", "share of position", "share of orientation")
    ordered = sorted(means.items(), key=lambda item: -item[1][0])
    rows = [(name, *(f"{100.0 * share:.1f} %" for share in shares)) for name, shares in ordered]
    return ReportSection(head=head, rows=rows, numbers=head[1:])


def measurement_section(budget: ErrorBudget, measurements: Sequence[Measurement]) -> ReportSection:
    """Return the bound after each measurement, and the sentence on the best one."""
    head = ("measurement", "largest bound after it", "less by")
    rows = [
        (each.name, si(each.bound, "m", 3), f"{100.0 * each.gain:.1f} %") for each in measurements
    ]
    return ReportSection(
        head=head, rows=rows, numbers=head[1:], lines=[advice(budget, measurements)]
    )


def largest_causes(budget: ErrorBudget) -> ReportSection:
    """Return the causes of the largest variance where the bound is largest."""
    k = int(np.argmax(budget.bound(POSITION)))
    squares: dict[str, float] = {}
    for source in budget.sources:
        size = float(np.sum(source.effect[k, POSITION] ** 2))
        squares[source.name] = squares.get(source.name, 0.0) + size
    whole = sum(squares.values()) or 1.0
    ordered = sorted(squares.items(), key=lambda item: -item[1])[:MAX_LISTED]
    rows = [
        (name, si(float(np.sqrt(size)), "m", 3), percent(size / whole, 3))
        for name, size in ordered
        if size
    ]
    return ReportSection(
        head=("cause", "standard deviation at the tool", "share of the variance"), rows=rows
    )


@figure_style()
def bounds_figure(budget: ErrorBudget) -> Figure:
    """Plot the bounds of position and orientation over time, and the shares of the position."""
    time = budget.states.time
    figure, (upper, middle, lower) = subplots(5.4, 3, 1, sharex=True)
    for axes, rows, unit, colour in (
        (upper, POSITION, "m", PALETTE[0]),
        (middle, ORIENTATION, "rad", PALETTE[1]),
    ):
        bound = budget.bound(rows)
        factor, name = scale(float(bound.max()), unit)
        mean = np.linalg.norm(budget.mean[:, rows], axis=1)
        axes.plot(time, factor * bound, color=colour, label="95 % bound")
        axes.plot(time, factor * mean, color=colour, linestyle="--", label="mean error")
        axes.set_ylabel(f"[{name}]")
        axes.set_ylim(bottom=0.0)
    # Beside the title, where no curve can be; line styles are the same in both.
    upper.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2)
    upper.set_title("Error of position and orientation")
    shares = budget.shares(POSITION)
    lower.stackplot(
        time,
        [100.0 * np.maximum(part, 0.0) for part in shares.values()],
        labels=list(shares),
        colors=PALETTE,
        alpha=0.8,
    )
    lower.set_ylabel("share [%]")
    lower.set_xlabel("time [s]")
    lower.set_ylim(0.0, 100.0)
    lower.legend(loc="upper left", bbox_to_anchor=(0.0, -0.28), ncols=len(shares))
    figure.subplots_adjust(left=0.07, right=0.98, hspace=0.25)
    return figure


@figure_style()
def volume_figure(budget: ErrorBudget, volume: VolumeBudget) -> Figure:
    """Plot the bound over the work volume, seen from above and from the side."""
    place = volume.budget.place
    bound = volume.budget.bound(POSITION) if len(place) else np.zeros(0)
    factor, unit = scale(float(bound.max(initial=0.0)), "m")
    figure, axes_pair = subplots(3.6, 1, 2)
    for axes, (a, b), title in zip(
        axes_pair, ((0, 1), (0, 2)), ("From above", "From the side"), strict=True
    ):
        axes.scatter(place[:, a], place[:, b], c=factor * bound, s=60, cmap="viridis")
        axes.plot(budget.place[:, a], budget.place[:, b], color="#222222", label="motion")
        axes.set_title(title)
        axes.set_xlabel(f"{'xyz'[a]} [m]")
        axes.set_ylabel(f"{'xyz'[b]} [m]")
        axes.set_aspect("equal", adjustable="datalim")
    figure.colorbar(
        axes_pair[0].collections[0],
        ax=list(axes_pair),
        label=f"95 % bound of the position [{unit}]",
    )
    return figure


def print_budget(
    budget: ErrorBudget, volume: VolumeBudget, measurements: Sequence[Measurement], folder: Path
) -> None:
    """Print bounds, shares, the best measurements and the path of the report."""
    print_lines([headline(budget, volume)])
    print_section(share_section(budget))
    print_section(measurement_section(budget, measurements))
    print_lines([f"Report: {folder / 'report.html'}"])
