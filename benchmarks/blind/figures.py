"""Figures of the results page, from scores and prediction files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.blind.score import CaseScore, held_out
from benchmarks.blind.tally import counted, curve, of_kind, probabilities
from benchmarks.blind.wilson import Rate

SEVERITIES = (0.05, 0.15, 0.3, 0.5, 0.75, 1.25, 2.0, 4.0, 20.0)
SIGMAS = (1.0, 3.0, 6.0, 10.0, 15.0, 25.0, 40.0, 70.0, 150.0, 1e4)
BLUE, ORANGE, GREY, GREEN = "#0072b2", "#d55e00", "#777777", "#009e73"

matplotlib.rcParams.update(
    {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "svg.hashsalt": "blind"}
)


def draw_all(scores: Sequence[CaseScore], folder: Path, directory: Path) -> list[str]:
    """Draw every figure that the cases allow; names of the files.

    Parameters
    ----------
    scores : sequence of CaseScore
    folder : Path
        Of the key: recordings and predictions.
    directory : Path
        Where the figures go.
    """
    directory.mkdir(parents=True, exist_ok=True)
    drawn = []
    for name, figure in (
        ("confusion", _confusion(scores)),
        ("detection", _detection(scores)),
        ("calibration", _calibration(scores)),
        ("improvement", _improvement(scores)),
        ("fits", _fits(scores, folder)),
    ):
        if figure is not None:
            figure.savefig(directory / f"{name}.svg", bbox_inches="tight", metadata={"Date": None})
            drawn.append(name)
    return drawn


def _said(score: CaseScore) -> str:
    if score.verdict is None:
        return "no answer"
    return score.said[0].effect if score.said else score.verdict.replace("_", " ")


def _true(score: CaseScore) -> str:
    return {"none": "nothing missing", "outside": "outside catalogue"}.get(
        score.kind, score.truth[0].effect if score.truth else ""
    )


def _confusion(scores: Sequence[CaseScore]) -> Figure | None:
    own = [s for s in counted(scores) if s.kind != "pair"]
    if not own:
        return None
    last = ["nothing missing", "outside catalogue", "no answer"]
    rows = sorted({_true(s) for s in own} - set(last))
    columns = sorted(({_said(s) for s in own} | set(rows)) - set(last))
    rows += [n for n in last[:2] if any(_true(s) == n for s in own)]
    columns += [n for n in last if n in rows or any(_said(s) == n for s in own)]
    table = np.zeros((len(rows), len(columns)), dtype=int)
    for s in own:
        table[rows.index(_true(s)), columns.index(_said(s))] += 1
    figure = Figure(figsize=(2.6 + 0.24 * len(columns), 1.8 + 0.24 * len(rows)))
    axes = figure.subplots()
    share = table / np.maximum(table.sum(axis=1, keepdims=True), 1)
    axes.imshow(share, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for (i, j), count in np.ndenumerate(table):
        if count:
            shade = "white" if share[i, j] > 0.6 else "black"
            axes.text(j, i, str(count), ha="center", va="center", fontsize=7, color=shade)
    axes.set_xticks(range(len(columns)), columns, rotation=90)
    axes.set_yticks(range(len(rows)), rows)
    axes.set_xlabel("said first")
    axes.set_ylabel("true")
    axes.spines[["left", "bottom"]].set_visible(False)
    axes.tick_params(length=0)
    return figure


def _detection(scores: Sequence[CaseScore]) -> Figure | None:
    own = of_kind(scores, "single")
    if not own:
        return None
    figure = Figure(figsize=(8.0, 3.2))
    left, right = figure.subplots(1, 2, sharey=True)
    _rates(left, curve(own, lambda s: s.severity, SEVERITIES), "severity")
    _rates(right, curve(own, lambda s: s.z, SIGMAS), "what the oracle sees [sigma]")
    left.set_ylabel("share of cases")
    left.legend(frameon=False, loc="lower right")
    return figure


def _rates(axes: Axes, lines: list[tuple[float, Rate, Rate]], label: str) -> None:
    x = [middle for middle, _, _ in lines]
    for which, name, colour in ((1, "detected", BLUE), (2, "effect and joint first", ORANGE)):
        rates: list[Rate] = [entry[which] for entry in lines]  # type: ignore[misc]
        y = [r.share for r in rates]
        low = [r.share - r.interval[0] for r in rates]
        high = [r.interval[1] - r.share for r in rates]
        axes.errorbar(
            x, y, yerr=[low, high], color=colour, marker="o", ms=4, lw=1.2, elinewidth=0.7,
            label=name,
        )  # fmt: skip
    axes.set_xscale("log")
    axes.minorticks_off()
    axes.set_xticks(x, [f"{value:.2g}" if value < 10.0 else f"{value:.0f}" for value in x])
    axes.set_ylim(-0.03, 1.05)
    axes.set_xlabel(label)
    axes.grid(alpha=0.25, lw=0.5)


def _calibration(scores: Sequence[CaseScore]) -> Figure | None:
    _, lines = probabilities(scores)
    if not lines:
        return None
    figure = Figure(figsize=(3.4, 3.2))
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color=GREY, lw=0.8)
    for stated, right, count in lines:
        low, high = Rate(round(right * count), count).interval
        axes.plot([stated, stated], [low, high], color=BLUE, lw=0.8)
        axes.plot(stated, right, "o", color=BLUE, ms=4)
        axes.annotate(f"{count}", (stated, right), xytext=(5, -9), textcoords="offset points")
    axes.set_xlabel("stated probability of the first finding")
    axes.set_ylabel("share right")
    axes.set_xlim(0, 1.03)
    axes.set_ylim(0, 1.03)
    return figure


def _improvement(scores: Sequence[CaseScore]) -> Figure | None:
    own = [s for s in counted(scores) if s.kind in ("single", "pair") and s.fit]
    if not own:
        return None
    figure = Figure(figsize=(8.0, 3.4))
    for axes, role in zip(figure.subplots(1, 2, sharey=True), ("test", "extrapolate"), strict=True):
        for kind, colour in (("single", BLUE), ("pair", GREEN)):
            fits = [s.fit[role] for s in own if s.kind == kind and role in s.fit]
            if fits:
                axes.plot(
                    [f.before for f in fits], [f.after for f in fits], "o", ms=3.5, color=colour,
                    alpha=0.7, label={"single": "one effect", "pair": "two effects"}[kind],
                )  # fmt: skip
        low, high = 0.9, max(f.before for s in own for f in s.fit.values()) * 1.1
        axes.plot([low, high], [low, high], color=GREY, lw=0.8)
        axes.axhline(1.0, color=ORANGE, lw=0.8)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel(f"{role} runs: residual / noise before")
        if role == "test":
            axes.set_ylabel("after")
            axes.legend(frameon=False)
    return figure


def _fits(scores: Sequence[CaseScore], folder: Path, most: int = 6) -> Figure | None:
    """Residuals of one held-out run before and after, in the channel that changed most."""
    chosen = _examples(scores, most)
    if not chosen:
        return None
    figure = Figure(figsize=(9.0, 1.9 * len(chosen)))
    panels = np.atleast_1d(figure.subplots(len(chosen), 1))
    for axes, score in zip(panels, chosen, strict=True):
        case, answer = folder / "cases" / score.id, folder / "answers" / score.id
        run = next(run for run, role in held_out(case) if role == "test")
        with (
            np.load(case / f"{run}.npz") as read,
            np.load(answer / f"pred_before_{run}.npz") as before,
            np.load(answer / f"pred_after_{run}.npz") as after,
        ):
            names = [n for n in before.files if n != "t"]
            change = [np.std(before[n] - after[n]) / np.std(read[n] - after[n]) for n in names]
            name = names[int(np.argmax(change))]
            scale, unit = (1.0, "N m") if name.startswith("tau") else (1e3, "mrad")
            for each, label, colour in ((before, "before", ORANGE), (after, "after", BLUE)):
                left = scale * (read[name] - each[name])
                axes.plot(read["t"], left, lw=0.6, color=colour, label=label)
        said = ", ".join(n.label for n in score.said) or str(score.verdict)
        true = ", ".join(n.label for n in score.truth) or "nothing missing"
        axes.set_title(f"{score.id}: {true}; said: {said}", fontsize=8, loc="left")
        axes.set_ylabel(f"{name} [{unit}]")
    panels[0].legend(frameon=False, ncols=2, loc="upper right", fontsize=8)
    panels[-1].set_xlabel("time [s]; measured less predicted")
    figure.tight_layout()
    return figure


def _examples(scores: Sequence[CaseScore], most: int) -> list[CaseScore]:
    """Evenly spread over the shares reached: the worst, the best and what lies between."""
    own = [
        s for s in counted(scores)
        if s.kind == "single" and s.severity >= 1.0 and "test" in s.fit
        and np.isfinite(s.fit["test"].share)
    ]  # fmt: skip
    own.sort(key=lambda s: s.fit["test"].share)
    if len(own) <= most:
        return own
    return [own[round(i)] for i in np.linspace(0, len(own) - 1, most)]
