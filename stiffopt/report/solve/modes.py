"""Modes of an arm: a table in the terminal, a figure over a motion."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from stiffopt.elastic.modes import PoseModes
from stiffopt.files import atomic_write
from stiffopt.report.common.svg import WIDTH, house_style, line_style, to_svg
from stiffopt.report.common.terminal import print_lines, print_table
from stiffopt.report.common.text import percent, significant
from stiffopt.report.solve.swing import assumed_damping_note


def print_modes(rows: Sequence[PoseModes]) -> None:
    """A table of each pose, lowest mode first, and what the damping rests on."""
    head = ("mode", "frequency", "damping", "shape")
    for row in rows:
        cells = [
            (
                str(k),
                f"{significant(mode.frequency, 4)} Hz",
                percent(mode.damping, 2),
                mode.describe(),
            )
            for k, mode in enumerate(row.modes, start=1)
        ]
        print_table(head, cells, title=row.name, numbers=head[:3])
    print_lines(assumed_damping_note(rows[0].assumed_damping))


def write_modes_figure(rows: Sequence[PoseModes], path: Path) -> Path:
    """Write the frequencies over a motion as SVG; return the path."""
    with house_style():
        figure = Figure(figsize=(WIDTH, 3.7))
        axes = figure.subplots()
        times = [row.time for row in rows]
        for k in range(len(rows[0].modes)):
            frequencies = [row.modes[k].frequency for row in rows]
            axes.plot(times, frequencies, label=f"mode {k + 1}", **line_style(k))
        axes.set_yscale("log")
        axes.set_xlabel("time [s]")
        axes.set_ylabel("frequency [Hz]")
        axes.margins(x=0.01)
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        svg = to_svg(figure, "modes", "Frequencies of the arm's modes along the motion")
    atomic_write(path, svg)
    return path
