"""report.html and terminal output of an improved motion."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.improvement.improvement import JOINT_LIMITS, Improvement, LimitUse
from stiffopt.report.common import svg
from stiffopt.report.common.page import PageFigures, write_page
from stiffopt.report.common.terminal import ReportSection, print_lines, print_section
from stiffopt.report.common.text import MAX_LISTED, scale, si
from stiffopt.result.compensation import COMMAND_FILE
from stiffopt.units import joint_unit

GIVEN = "given"


def write_improvement_report(
    title: str, found: Improvement, folder: Path, reasons: Sequence[str] = ()
) -> Path:
    """Write report.html and its figures into `folder`; return the page."""
    figures = PageFigures("improvement")
    if found.given.both is not None and found.compensation is not None:
        figures.draw("error", error_figure(found), "Tool error of the given and improved motion")
    figures.draw("limits", limits_figure(found), "Use of the limits over time")
    context = {
        "title": f"{title}: improved motion",
        "headline": headline(found),
        "answer": answer(found),
        "faults": faults(found),
        "uses": limit_section(found),
        "errors": error_section(found),
        "notes": [*reasons, *notes(found)],
        "file": COMMAND_FILE if found.kept else "",
    }
    return write_page("pages/improvement.html.j2", folder / "report.html", context, figures)


def _tried(found: Improvement) -> str:
    """Name the motion that was found: one that exceeds a limit is no improvement."""
    return "improved" if found.kept else "tried"


def headline(found: Improvement) -> str:
    """Return durations and tool errors in words, of the improved motion if it keeps all limits."""
    before, after = found.given.assessment.duration, found.plan.duration
    text = f"{before:.3f} s as given"
    if found.kept:
        text += f", {after:.3f} s improved"
    if found.given.both is not None:
        text += f"; largest tool error {si(found.given.both.peak, 'm', 3)} as given"
        if found.kept and found.compensation is not None:
            own = found.compensation.optimised.simulated
            text += f", {si(own.peak, 'm', 3)} improved"
    return f"{text}."


def answer(found: Improvement) -> str:
    """Return what was done, in words."""
    if not found.kept:
        refusal = "" if found.compensation is None else found.compensation.refusal
        worst = found.improved.exceeded[:1]
        why = refusal or f"The plan exceeds {worst[0].describe()}."
        return f"No motion that keeps every limit was found. {why}"
    how = "The timing is as given"
    if found.compensation is None:
        how = "Timing and places are as given, but for noise"
    if found.retimed:
        how = "The motion is slowed "
        how += "where it exceeds a limit" if found.given.exceeded else "for the lead of the motors"
    if found.is_timed_anew:
        how = "The motion is timed anew"
    lead = "" if found.compensation is None else "; the motors lead the links by the wind-up"
    return (
        f"{how}{lead}. The tool's largest distance from the given path is "
        f"{si(found.path_deviation, 'm', 2)}, and every limit is certified."
    )


def faults(found: Improvement) -> list[str]:
    """Return what the given motion does wrong, one sentence each."""
    robot = found.problem.robot
    told = [
        f"{robot.joint_names[use.joint - 1]}: {use.quantity} of "
        f"{_with_unit(found, use, use.value)} is {use.share:.3g} times the limit, at "
        f"{use.time:.3f} s."
        for use in found.given.uses
        if use.share > 1.0 + CERTIFICATE_TOLERANCE
    ]
    named = {"velocity", "acceleration", "jerk", "torque"}
    told += [
        f"It exceeds {each.describe()}."
        for each in found.given.exceeded
        if each.limit not in named and not each.limit.startswith(("start_", "end_"))
    ]
    told += [
        f"It {'begins' if each.limit.startswith('start') else 'ends'} with a jump of the "
        f"{each.limit.partition('_')[2]} of joint {each.joint}."
        for each in found.given.exceeded
        if each.limit in ("start_acceleration", "end_acceleration")
    ]
    if found.given.uses and not told:
        limited = dict.fromkeys(use.quantity for use in found.given.uses)
        told.append(f"It keeps every limit of the joints: {', '.join(limited)}.")
    both = found.given.both
    if both is not None:
        told.append(f"The tool leaves its path by up to {si(both.peak, 'm', 3)} in flight.")
        if both.peak_after is not None:
            settled = both.settling_time
            band = si(both.band, "m", 2)
            told.append(
                f"After arrival it rings by {si(both.peak_after, 'm', 3)} and "
                + (
                    f"does not settle to {band} within a second."
                    if settled is None
                    else f"stays within {band} after {1e3 * settled:.0f} ms."
                    if settled
                    else f"stays within {band} from there on."
                )
            )
    return told


def _with_unit(found: Improvement, use: LimitUse, value: float) -> str:
    prismatic = bool(found.problem.robot.prismatic[use.joint - 1])
    return f"{value:.4g} {joint_unit(JOINT_LIMITS[use.quantity], prismatic)}"


def limit_section(found: Improvement) -> ReportSection:
    """Return the largest use of each limit, given and improved."""
    after = {(use.joint, use.quantity): use for use in found.improved.uses}
    rows: list[tuple[str, ...]] = []
    for use in found.given.uses[:MAX_LISTED]:
        own = after[use.joint, use.quantity]
        rows.append(
            (
                found.problem.robot.joint_names[use.joint - 1],
                use.quantity,
                _with_unit(found, use, use.value),
                f"{use.time:.3f} s",
                _with_unit(found, use, own.value),
                _with_unit(found, use, use.limit),
                f"{100.0 * use.share:.0f} % → {100.0 * own.share:.0f} %",
            )
        )
    head = (
        "joint",
        "quantity",
        "largest as given",
        "at",
        _tried(found),
        "limit",
        "share of the limit",
    )
    return ReportSection(head=head, rows=rows)


def error_section(found: Improvement) -> ReportSection:
    """Return sources of the tool error, with the peak in flight and after arrival."""
    given, led = found.given, found.compensation
    head = ("tool error", "largest in flight", "largest after arrival")
    if given.both is None or given.servo is None or given.elastic is None:
        return ReportSection(head=head)
    flight, after = given.both.error.flight, given.both.error.after
    peaks: list[tuple[str, float | None, float | None]] = [
        ("given: servo alone", _peak(given.servo, flight), _peak(given.servo, after)),
        ("given: elasticity alone", given.elastic.peak, given.elastic.peak_after),
        ("given: together", given.both.peak, given.both.peak_after),
    ]
    if led is not None:
        own, worst = led.optimised.simulated, led.optimised.compensated
        peaks.append((f"{_tried(found)}: together", own.peak, own.peak_after))
        name = f"{_tried(found)}: worst of uncertain arms"
        peaks.append((name, worst.flight.worst, worst.after.worst))
    rows = [(name, *(si(size, "m", 3) for size in sizes)) for name, *sizes in peaks]
    return ReportSection(head=head, rows=rows, numbers=head[1:])


def _peak(values: np.ndarray, mask: np.ndarray) -> float | None:
    return float(values[mask].max()) if mask.any() else None


def notes(found: Improvement) -> list[str]:
    """Return assumptions and limitations."""
    told = list(found.notes)
    if found.margins:
        left = ", ".join(f"{name} {100.0 * part:.0f} %" for name, part in found.margins.items())
        told.append(
            f"Left to the lead of the motors where it needs them: up to {left} of the limits."
        )
    if found.compensation is not None:
        told += [f"Uncertain: {each}" for each in found.compensation.uncertainty]
        if found.compensation.ahead:
            told.append(
                f"The command is to be sent {1e3 * found.compensation.ahead:.3g} ms ahead, the "
                "known dead time of the servo."
            )
    return told


@svg.figure_style()
def error_figure(found: Improvement) -> Figure:
    """Plot the tool error over time, given and improved."""
    before = found.given.both
    assert before is not None
    assert found.compensation is not None
    after = found.compensation.optimised.simulated
    most = max(before.distance.max(), after.distance.max())
    factor, unit = scale(float(most), "m")
    figure, axes = svg.subplots(3.0)
    for own, name, colour in ((before, GIVEN, svg.VERMILLION), (after, _tried(found), svg.BLUE)):
        axes.plot(*svg.decimate_curve(own.time, factor * own.distance), color=colour, label=name)
        axes.axvline(own.duration, color=colour, linewidth=0.8, linestyle=":")
    axes.set_xlabel("time [s]")
    axes.set_ylabel(f"tool error [{unit}]")
    axes.set_ylim(bottom=0.0)
    axes.set_title("Tool error on the elastic arm with its servo; dotted: arrival")
    axes.legend(loc="upper right")
    return figure


@svg.figure_style()
def limits_figure(found: Improvement) -> Figure:
    """Plot the largest use of each limit over the joints, given and improved, over time."""
    limits = found.problem.active_limits
    shown = [name for name in JOINT_LIMITS if np.isfinite(getattr(limits, name)).any()]
    figure = Figure(figsize=(svg.WIDTH, 1.5 * max(len(shown), 1) + 0.6))
    rows = np.atleast_1d(figure.subplots(max(len(shown), 1), 1, sharex=True))
    for axes, name in zip(rows, shown, strict=False):
        for own, colour, label in (
            (found.given.assessment, svg.VERMILLION, GIVEN),
            (found.improved.assessment, svg.BLUE, _tried(found)),
        ):
            share = np.max(np.abs(getattr(own, name)) / getattr(limits, name), axis=1)
            axes.plot(*svg.decimate_curve(own.time, 100.0 * share), color=colour, label=label)
        axes.axhline(100.0, color=svg.GREY, linewidth=0.9, linestyle=(0, (4, 2)))
        axes.set_ylabel("[%]")
        top = axes.get_ylim()[1]
        axes.set_ylim(0.0, min(top, 400.0))
        axes.set_title(f"Largest {name} of all joints, share of its limit")
    rows[0].legend(loc="upper right", ncols=2)
    rows[-1].set_xlabel("time [s]")
    figure.subplots_adjust(hspace=0.55)
    return figure


def print_improvement(found: Improvement, folder: Path, reasons: Sequence[str]) -> None:
    """Print headline, faults of the given motion, notes, the tool errors and the report's path."""
    print_lines([headline(found), answer(found), *faults(found)])
    print_lines([f"Note: {each}" for each in [*reasons, *found.notes]])
    print_section(error_section(found))
    print_lines([f"Report: {folder / 'report.html'}"])
