"""report.html and terminal output of a cycle: legs, postures, tool error, duty, rivals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from stiffopt.problem.cycle import Cycle
from stiffopt.report.common import svg
from stiffopt.report.common.page import PageFigures, write_page
from stiffopt.report.common.terminal import print_lines, print_table
from stiffopt.report.common.text import DASH, capital, percent, scale, si, significant, words
from stiffopt.report.solve.wording import objective_amount, objective_phrase
from stiffopt.result.cycle import CycleSimulation, CycleSolution, LegResult
from stiffopt.result.duty import JointDuty
from stiffopt.units import joint_unit

_MAX_SHOWN_LIFE = 1e6  # [h]
LEG_HEAD = ("leg", "moves", "start", "motion", "rest", "event", "carries", "objective", "in flight",
            "in the rest", "settled after", "status")  # fmt: skip
DUTY_HEAD = ("joint", "rms torque", "peak torque", "peak speed", "mean speed", "peak power",
             "work", "regenerated", "reducer mean torque", "reducer L10")  # fmt: skip


def headline(solution: CycleSolution) -> str:
    """Return time and objective of the cycle in words."""
    if solution.objective is None:
        failed = [leg for leg in solution.legs if not leg.solution.status.usable]
        where = f": {words(failed[0].solution.status)} in leg {failed[0].name}" if failed else ""
        return f"no usable motion of the whole cycle{where}"
    value = solution.objective
    text = f"cycle of {si(solution.duration, 's', 4)}"
    if value.name != "duration":
        amount = objective_amount(value.name, value.value, value.unit, 3)
        text += f", {objective_phrase(value.name, value.measure)} {amount}"
    found = solution.simulation
    if found is not None:
        text += f"; simulated tool error {si(found.peak, 'm', 3)} in flight"
        if any(leg.rest is not None for leg in found.legs):
            text += f", {si(found.rest_peak, 'm', 3)} in the rests"
    return text


def comparison(solution: CycleSolution) -> str:
    """Return a sentence on the best rival, each move by itself."""
    value = solution.objective
    if value is None:
        return ""
    # At a given time of the cycle, a slower rival is no rival.
    longest = np.inf if value.name == "duration" else solution.duration * (1.0 + 1e-6)
    rivals = [each for each in solution.rivals if each.duration <= longest]
    if not rivals:
        return "No kind of rival keeps every limit in all moves."
    best = min(rivals, key=lambda each: each.objective)
    if not best.objective > 0.0:
        return ""
    change = value.value / best.objective - 1.0
    what = "time" if value.name == "duration" else objective_phrase(value.name, value.measure)
    amount = objective_amount(value.name, best.objective, value.unit, 3)
    side = "less" if change < 0.0 else "more"
    return (
        f"{percent(abs(change), 2)} {side} {what} than the best rival move by move, "
        f"{best.name} with {amount}, each within every limit."
    )


def leg_rows(solution: CycleSolution) -> list[list[str]]:
    """Rows of the table of legs."""
    found = solution.simulation
    rows = []
    for k, leg in enumerate(solution.legs):
        error = None if found is None else found.legs[k]
        settled = DASH
        if error is not None and error.rest is not None:
            settled = "not" if error.settling_time is None else si(error.settling_time, "s", 3)
        objective = leg.solution.objective
        rows.append(
            [
                leg.name,
                ", ".join(map(str, leg.moves)),
                si(leg.start, "s", 4),
                si(leg.arrival - leg.start, "s", 4),
                si(leg.dwell, "s", 3) + (" (until settled)" if leg.until_settled else ""),
                _event_text(leg),
                si(leg.mass_before, "kg", 4),
                DASH
                if objective is None
                else objective_amount(objective.name, objective.value, objective.unit, 3),
                DASH if error is None else si(error.flight, "m", 3),
                DASH if error is None or error.rest is None else si(error.rest, "m", 3),
                settled,
                str(leg.solution.status),
            ]
        )
    return rows


def _event_text(leg: LegResult) -> str:
    if not leg.event:
        return DASH
    return f"{words(leg.event)}: {leg.mass_before:.4g} to {leg.mass_after:.4g} kg"


def duty_rows(solution: CycleSolution) -> list[list[str]]:
    """Rows of the table of duties."""
    if solution.duty is None:
        return []
    return [
        [
            each.name,
            _share_text(each, each.rms_torque, each.torque_max),
            _share_text(each, each.peak_torque, each.torque_max),
            si(each.peak_speed, joint_unit("rad/s", each.prismatic), 3),
            si(each.mean_speed, joint_unit("rad/s", each.prismatic), 3),
            si(each.peak_power, "W", 3),
            si(each.energy, "J", 3),
            si(each.regenerated, "J", 3),
            _share_text(each, each.mean_torque, None if each.life is None else each.rating.torque),
            _life_text(each),
        ]
        for each in solution.duty.joints
    ]


def _share_text(joint: JointDuty, torque: float, whole: float | None) -> str:
    text = si(torque, joint_unit("N m", joint.prismatic), 3)
    return text if whole is None else f"{text} ({percent(torque / whole, 2)})"


def _life_text(joint: JointDuty) -> str:
    if joint.life is None:
        return DASH
    hours = joint.life / 3600.0
    if hours > _MAX_SHOWN_LIFE:
        return f"above {_MAX_SHOWN_LIFE:.0e} h"
    return f"{significant(hours, 2)} h"


def duty_text(solution: CycleSolution) -> str:
    """Return a sentence on energy, shortest life and the drive with the highest load."""
    duty = solution.duty
    if duty is None:
        return ""
    loaded = duty.most_loaded
    text = (
        f"The drives give {si(duty.energy, 'J', 3)} of work in a cycle and take "
        f"{si(duty.regenerated, 'J', 3)}; the highest rms torque is "
        f"{percent(loaded.rms_torque / loaded.torque_max, 2)} of the limit, in {loaded.name}"
    )
    shortest = duty.shortest_life
    if shortest is not None:
        text += (
            f"; the reducer of {shortest.name} has the shortest life L10, {_life_text(shortest)}"
        )
    return f"{text}."


def posture_rows(solution: CycleSolution) -> list[list[str]]:
    """Rows of the table of postures."""
    return [
        [
            posture.name,
            posture.branch or DASH,
            f"chosen of {posture.candidates}" if posture.chosen else "given",
            ", ".join(
                f"{1e3 * place:.4g} mm" if slides else f"{round(np.degrees(place), 3) + 0.0:.4g}"
                for place, slides in zip(posture.joints, posture.prismatic, strict=True)
            ),
        ]
        for posture in solution.postures
    ]


def write_cycle_report(cycle: Cycle, solution: CycleSolution, folder: Path) -> Path:
    """Write report.html into `folder`; return its path."""
    figures = PageFigures("cycle", svg=False, png=False)
    solved = all(leg.solution.assessment is not None for leg in solution.legs)
    if solved:
        figures.draw("motion", motion_figure(cycle, solution), "Joint velocities over the cycle")
        figures.draw("torque", torque_speed_figure(cycle, solution), "Torque over speed of drives")
    if solution.simulation is not None:
        figures.draw("error", error_figure(solution), "Tool error over the cycle")
    context = {
        "title": solution.title,
        "headline": capital(headline(solution)),
        "comparison": comparison(solution),
        "solution": solution,
        "notes": [*solution.notes, *(solution.simulation.notes if solution.simulation else ())],
        "leg_head": LEG_HEAD,
        "legs": leg_rows(solution),
        "postures": posture_rows(solution),
        "duty_head": DUTY_HEAD,
        "duty": duty_rows(solution),
        "duty_text": duty_text(solution),
        "rivals": [
            [each.name, si(each.duration, "s", 4), _rival_amount(solution, each.objective)]
            for each in solution.rivals
        ],
        "own": _rival_amount(
            solution, None if solution.objective is None else solution.objective.value
        ),
    }
    return write_page("pages/cycle.html.j2", folder / "report.html", context, figures)


def _rival_amount(solution: CycleSolution, value: float | None) -> str:
    own = solution.objective
    return DASH if own is None or value is None else objective_amount(own.name, value, own.unit, 4)


def print_cycle(solution: CycleSolution, folder: Path) -> None:
    """Print status, legs, postures, duty and the path of the report."""
    lines = [f"{solution.status}: {solution.message}", capital(headline(solution))]
    lines += [comparison(solution)] if solution.duty is not None else []
    print_lines([*lines, *(f"Note: {note}" for note in solution.notes)])
    short = [k for k, name in enumerate(LEG_HEAD) if name not in ("carries", "moves")]
    print_table(
        [LEG_HEAD[k] for k in short],
        [[row[k] for k in short] for row in leg_rows(solution)],
        title="Legs",
    )
    print_table(("pose", "branch", "", "joints [deg]"), posture_rows(solution), title="Postures")
    print_lines([duty_text(solution), f"Report: {folder / 'report.html'}"])


def print_simulated_cycle(cycle: Cycle, found: CycleSimulation) -> None:
    """Print the tool error of each leg of a simulated cycle."""
    rows = [
        [
            leg.name,
            si(error.flight, "m", 3),
            DASH if error.rest is None else si(error.rest, "m", 3),
            DASH
            if error.rest is None
            else "not"
            if error.settling_time is None
            else si(error.settling_time, "s", 3),
        ]
        for leg, error in zip(cycle.legs, found.legs, strict=True)
    ]
    print_table(("leg", "in flight", "in the rest", "settled after"), rows, title="Tool error")
    print_lines(list(found.notes))


def _mark_legs(axes: object, solution: CycleSolution) -> None:
    """Shade the rests and mark the events."""
    for leg in solution.legs:
        if leg.dwell > 0.0:
            axes.axvspan(leg.arrival, leg.departure, color=svg.PALE, alpha=0.7, zorder=0)  # type: ignore[attr-defined]
        if leg.event:
            axes.axvline(leg.arrival, color=svg.VERMILLION, linewidth=0.9, linestyle="--")  # type: ignore[attr-defined]
            axes.annotate(  # type: ignore[attr-defined]
                words(leg.event), (leg.arrival, 1.0), xycoords=("data", "axes fraction"),
                xytext=(2, -9), textcoords="offset points", fontsize=7.5, color=svg.VERMILLION,
            )  # fmt: skip


@svg.figure_style()
def motion_figure(cycle: Cycle, solution: CycleSolution) -> Figure:
    """Plot the joint velocities over the cycle, as shares of their limits."""
    limit = cycle.first.active_limits.velocity
    figure, axes = svg.subplots(3.2)
    for j, name in enumerate(cycle.first.robot.joint_names):
        times, values = [], []
        for leg in solution.legs:
            motion = leg.solution.assessment
            assert motion is not None
            times.append(leg.start + motion.time)
            values.append(100.0 * motion.velocity[:, j] / limit[j])
        curve = svg.decimate_curve(np.concatenate(times), np.concatenate(values))
        axes.plot(*curve, label=name, **svg.line_style(j))
    _mark_legs(axes, solution)
    axes.set_ylabel("velocity over limit [%]")
    axes.set_xlabel("time [s]")
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    figure.subplots_adjust(left=0.07, right=0.88)
    return figure


@svg.figure_style()
def error_figure(solution: CycleSolution) -> Figure:
    """Plot the simulated tool error over the cycle."""
    assert solution.simulation is not None
    found = solution.simulation.simulated
    inside = found.time <= solution.duration
    factor, unit = scale(float(found.distance[inside].max()), "m")
    figure, axes = svg.subplots(2.8)
    axes.plot(*svg.decimate_curve(found.time[inside], factor * found.distance[inside]),
              color=svg.PALETTE[0])  # fmt: skip
    axes.axhline(factor * found.band, color=svg.GREY, linewidth=0.9)
    _mark_legs(axes, solution)
    axes.set_ylabel(f"tool error [{unit}]")
    axes.set_xlabel("time [s]")
    axes.set_ylim(bottom=0.0)
    figure.subplots_adjust(left=0.07, right=0.98)
    return figure


@svg.figure_style()
def torque_speed_figure(cycle: Cycle, solution: CycleSolution) -> Figure:
    """Plot the torque of each drive over its speed, as shares of the limits."""
    limits = cycle.first.active_limits
    robot = cycle.first.robot
    size = svg.WIDTH, 1.9 * -(-robot.n // 4)
    figure, grid = svg.panels(robot.n, min(robot.n, 4), size)
    for j, axes in enumerate(grid):
        for leg in solution.legs:
            motion = leg.solution.assessment
            assert motion is not None
            step = max(1, len(motion.time) // 300)
            axes.plot(
                100.0 * motion.velocity[::step, j] / limits.velocity[j],
                100.0 * motion.torque[::step, j] / limits.torque[j],
                color=svg.PALETTE[0],
                linewidth=0.9,
            )
        axes.set_xlim(-105, 105)
        axes.set_ylim(-105, 105)
        axes.set_title(robot.joint_names[j])
    figure.supxlabel("velocity over limit [%]", fontsize=9)
    figure.supylabel("torque over limit [%]", fontsize=9)
    figure.subplots_adjust(left=0.08, right=0.98, hspace=0.5, wspace=0.3, bottom=0.16)
    return figure
