"""Runs simulated from their commands: errors of position by joint and at the tool."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stiffopt.closed_loop.parameters import DELAY, JOINT_PARAMETERS, RATIO_UNITS
from stiffopt.discovery.extended.schema import ClosedLoopSection
from stiffopt.discovery.position_fit import PositionRun
from stiffopt.report.common.terminal import ReportSection
from stiffopt.report.common.text import joint_unit, pm, significant

_SECTION_TITLE = "Simulation from commands"
_ERROR_COLUMNS = ("position", "rms, before", "after", "largest, before", "after")
_VALUE_TITLE = "Values of the simulation"
_VALUE_COLUMNS = ("place", "fitted to the training runs", "value ± standard deviation")
# Deviations from zero of values that are listed.
_MIN_SHOWN_DEVIATIONS = 2.0
_VALUE_WORDS = {
    "gain": "relative change of the gain",
    "damping": "relative change of the damping",
    "armature": "rotor inertia",
    "viscous": "viscous friction",
    "coulomb": "dry friction",
    "load_friction": "friction per actuator torque",
    "creep": "speed below which dry friction creeps",
    "friction_slope": "change of dry friction over the stroke",
    "drag": "friction with the square of the speed",
    "offset": "torque offset",
    "zero": "encoder zero",
    "integral": "integral over proportional gain",
    "deadband": "deadband of the position error",
    "lateness": "delay beyond that of all joints",
    DELAY: "delay",
}
# Share of an error's power that lies below the upper frequency of its description.
_POWER_SHARE = 0.9


def error_table(runs: Sequence[PositionRun], prismatic: np.ndarray) -> dict[str, np.ndarray]:
    """Return root mean squares and largest errors (2, 2) by channel, before and after [rad], [m].

    Rows: before and after; columns: root mean square and largest.
    """
    found = {}
    for j in range(len(prismatic)):
        errors = [
            np.concatenate([(getattr(run, when) - run.measured)[:, j] for run in runs])
            for when in ("before", "after")
        ]
        found[f"joint {j + 1}"] = np.array([_summarize(error) for error in errors])
    tool = [
        np.concatenate([getattr(run, f"tool_{when}") for run in runs])
        for when in ("before", "after")
    ]
    found["tool"] = np.array([_summarize(error) for error in tool])
    return found


def _summarize(error: np.ndarray) -> tuple[float, float]:
    return float(np.sqrt(np.nanmean(error**2))), float(np.nanmax(np.abs(error)))


def position_section(runs: Sequence[PositionRun], prismatic: np.ndarray) -> ReportSection:
    """Return the errors of simulated held-out runs; an empty section without any."""
    if not runs:
        return ReportSection(title=_SECTION_TITLE)
    table = error_table(runs, prismatic)
    rows = []
    for name, errors in table.items():
        metres = name == "tool" or prismatic[int(name.removeprefix("joint ")) - 1]
        unit = "mm" if metres else "mrad"
        (first, largest), (second, most) = 1e3 * errors
        cells = (f"{significant(value, 3)} {unit}" for value in (first, second, largest, most))
        rows.append((name, *cells))
    angles = [1e3 * table[f"joint {j + 1}"] for j, slides in enumerate(prismatic) if not slides]
    lines = []
    if angles:
        before, after = np.sqrt(np.mean([each[:, 0] ** 2 for each in angles], axis=0))
        lines.append(
            "Held-out runs, simulated from their commands and their first position alone: error of"
            f" the joints from {significant(before, 3)} to {significant(after, 3)} mrad (root mean"
            f" square). {_describe_spectrum(runs)}"
        )
    return ReportSection(
        title=_SECTION_TITLE, lines=tuple(lines), head=_ERROR_COLUMNS, rows=tuple(rows)
    )


def value_section(section: ClosedLoopSection | None, prismatic: np.ndarray) -> ReportSection:
    """Return the fitted values of a simulation that stand out of their deviations."""
    rows: list[tuple[str, str, str]] = []
    if section is not None:
        for name, own in RATIO_UNITS.items():
            pairs = zip(
                section.ratios.get(name, ()), section.ratio_deviations.get(name, ()), strict=True
            )
            rows += [
                (
                    f"joint {j + 1}",
                    f"{_VALUE_WORDS[name]} over gain",
                    pm(value, sd, joint_unit(own, bool(prismatic[j]))),
                )
                for j, (value, sd) in enumerate(pairs)
                if abs(value) >= _MIN_SHOWN_DEVIATIONS * sd
            ]
        for name, unit in (*JOINT_PARAMETERS.items(), (DELAY, "s")):
            pairs = zip(section.values[name], section.deviations[name], strict=True)
            for j, (value, sd) in enumerate(pairs):
                if abs(value) < _MIN_SHOWN_DEVIATIONS * sd or not value:
                    continue
                own = joint_unit(unit, bool(prismatic[j])) if name != DELAY else unit
                place = f"joint {j + 1}" if name != DELAY else "commands"
                rows.append((place, _VALUE_WORDS[name], pm(value, sd, "" if own == "1" else own)))
    return ReportSection(title=_VALUE_TITLE, head=_VALUE_COLUMNS, rows=tuple(rows))


def _describe_spectrum(runs: Sequence[PositionRun]) -> str:
    """Describe the spectrum of the remaining error of the longest run."""
    longest = max(runs, key=lambda run: run.time[-1] - run.time[0])
    step = float(np.median(np.diff(longest.time)))
    error = np.nan_to_num(longest.after - longest.measured)
    power = np.sum(np.abs(np.fft.rfft(error - error.mean(axis=0), axis=0)) ** 2, axis=1)
    frequencies = np.fft.rfftfreq(len(error), step)
    share = np.cumsum(power) / max(float(power.sum()), 1e-300)
    half, most = (
        significant(float(frequencies[int(np.searchsorted(share, part))]), 2)
        for part in (0.5, _POWER_SHARE)
    )
    return f"Half of what remains lies below {half} Hz, {100 * _POWER_SHARE:.0f} % below {most} Hz."
