"""Figure of the held-out residual in two states of a robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from stiffopt.report.common.svg import BLUE, GREY, PALE, VERMILLION, WIDTH, figure_style
from stiffopt.report.diagnosis.words import channels_in_words

if TYPE_CHECKING:
    from stiffopt.discovery.diagnosis import Diagnosis


def state_figure(diagnosis: Diagnosis) -> Figure:
    """Plot residual over noise of held-out runs by channel and state, before and after the fit."""
    with figure_style():
        names = list(dict.fromkeys(c.name for p in diagnosis.held_out for c in p.channels))
        figure = Figure(figsize=(WIDTH, 1.0 + 0.24 * max(len(names), 3)))
        grid = figure.subplots(1, 2, sharey=True)
        for axes, state in zip(grid, ("before", "after"), strict=True):
            proofs = [p for p in diagnosis.held_out if p.run.name.startswith(f"{state}_")]
            for row, name in enumerate(names):
                own = [c for p in proofs for c in p.channels if c.name == name]
                count = sum(c.samples for c in own)
                if not count:
                    continue
                old, new = (
                    (sum(getattr(c, key) for c in own) / count) ** 0.5 / own[0].noise
                    for key in ("before", "after")
                )
                axes.plot([old, new], [row, row], color=PALE, linewidth=3.0, zorder=1)
                axes.plot(old, row, "o", mfc="white", mec=VERMILLION, mew=1.5, ms=6)
                axes.plot(new, row, "o", color=BLUE, ms=5)
            axes.axvline(1.0, color=GREY, linewidth=1.0, zorder=0)
            axes.set_title(f"held-out runs {state} the change")
            axes.set_xlabel("residual over noise")
            axes.grid(visible=False, axis="y")
        grid[0].set_yticks(range(len(names)), [channels_in_words([name]) for name in names])
        grid[0].invert_yaxis()
        return figure
