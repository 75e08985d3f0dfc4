"""Motions as the elastic arm does them: table, figure, and what they rest on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from stiffopt.report.common.svg import BLACK, BLUE, GREEN, GREY, VERMILLION, WIDTH, figure_style
from stiffopt.report.common.text import listed, scale, si
from stiffopt.result.simulation import ElasticMotion, Simulation

_MOTION_STYLES: tuple[dict[str, Any], ...] = (
    {"color": BLUE, "linewidth": 2.2},
    {"color": VERMILLION, "linestyle": (0, (5, 1.5))},
    {"color": GREEN, "linestyle": (0, (1.5, 1.2))},
    {"color": BLACK, "linestyle": (0, (1.0, 2.5))},
)
# Shown after the arrival [s].
_TIME_AFTER_ARRIVAL = 0.4


def simulation_table(simulation: Simulation) -> tuple[list[str], list[list[str]]]:
    """Head and rows of text, the optimised motion first."""
    band = si(simulation.optimised.simulated.band, "m")
    head = [
        *("motion", "duration", "planned peak", "simulated peak"),
        *("simulated rms", "peak after arrival", "rms after arrival"),
        *(f"within {band} after", "verdict"),
    ]
    return head, [_motion_row(motion) for motion in simulation.motions]


def _motion_row(motion: ElasticMotion) -> list[str]:
    found = motion.simulated
    settled = "–"
    if found.settling_time is not None:
        settled = si(found.settling_time, "s", 3)
    elif found.peak_after is not None:
        settled = "not in 1 s"
    after = [
        "–" if size is None else si(size, "m", 3) for size in (found.peak_after, found.rms_after)
    ]
    return [
        motion.name,
        si(found.duration, "s"),
        si(motion.planned.peak, "m", 3),
        si(found.peak, "m", 3),
        si(found.rms, "m", 3),
        *after,
        settled,
        "counted" if motion.counted else "not counted",
    ]


def simulation_notes(simulation: Simulation) -> list[str]:
    """Assumed damping, slip and hysteresis; what holds for all motions is said once."""
    notes = assumed_damping_note(simulation.assumed_damping) + _hysteresis_note(simulation)
    told = [motion.simulated.notes for motion in simulation.motions]
    shared = [note for note in told[0] if all(note in each for each in told)] if told else []
    notes += shared
    for motion in simulation.motions:
        notes += [f"{motion.name}: {n}" for n in motion.simulated.notes if n not in shared]
    return notes


def assumed_damping_note(joints: Sequence[int]) -> list[str]:
    """Sentence on joints (from 1) whose damping is assumed; none where there are none."""
    if not joints:
        return []
    named = f"joint{'s' if len(joints) > 1 else ''} {listed(str(j) for j in joints)}"
    return [
        f"The damping of {named} is assumed, 2 % of critical for each swinging alone, of which "
        "modes have more or less; give its damping in the robot file where it has been measured."
    ]


def _hysteresis_note(simulation: Simulation) -> list[str]:
    """How much of the result hysteresis of the usual size would take, where none is stated."""
    reach, peak = simulation.typical_hysteresis, simulation.optimised.simulated.peak
    if reach is None or peak <= 0.0:
        return []
    return [
        "No joint states its hysteresis: loops of 0.05 mrad half width in all of them, as measured "
        f"on reducers, could hold the tool {si(reach, 'm', 2)} from where it would hang, "
        f"{100.0 * reach / peak:.0f} % of the optimised peak; give hysteresis in the robot file "
        "where it has been measured."
    ]


def deviation_figure(simulation: Simulation) -> Figure:
    """Size of the tool's deviation over time, all motions."""
    with figure_style():
        figure = Figure(figsize=(WIDTH, 3.7))
        axes = figure.subplots()
        largest = max(motion.simulated.peak for motion in simulation.motions)
        factor, unit = scale(largest, "m")
        for motion, style in zip(simulation.motions, _MOTION_STYLES, strict=False):
            found = motion.simulated
            shown = found.time <= found.duration + _TIME_AFTER_ARRIVAL
            values = factor * found.distance[shown]
            axes.plot(found.time[shown], values, label=motion.name, **style)
            at = int(np.searchsorted(found.time, found.duration))
            axes.plot(found.duration, factor * found.distance[at], "o", color=style["color"])
        axes.axhline(factor * simulation.optimised.simulated.band, color=GREY, linewidth=0.8)
        axes.set_xlabel("time [s]")
        axes.set_ylabel(f"deviation of the tool [{unit}]")
        axes.set_ylim(bottom=0.0)
        axes.margins(x=0.01)
        axes.legend(loc="upper right")
        figure.subplots_adjust(left=0.06, right=0.995)
        return figure
