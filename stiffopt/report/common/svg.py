"""Style of all figures and their conversion to compact inline SVG and to PNG."""

from __future__ import annotations

import io
import itertools
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

# Okabe and Ito's colours: told apart by colour-blind readers and, by lightness, in grey print.
BLUE, VERMILLION, GREEN = "#0072B2", "#D55E00", "#009E73"
ORANGE, PURPLE, SKY, BLACK = "#E69F00", "#B0578D", "#56B4E9", "#222222"
PALETTE = (BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY, BLACK)
DASHES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (1.5, 1.2)), (0, (6, 1.5, 1.5, 1.5)))
GREY, PALE, INK = "#6b7280", "#d4d8de", "#1f2933"
FONTS = "'Helvetica Neue', Arial, 'DejaVu Sans', sans-serif"
POINTS = 600
# Width of every figure (the text column of a page) and margin around its content [inch].
WIDTH = 10.4

_FIGURE_STYLE: Any = {
    "svg.fonttype": "none",
    "path.simplify": True,
    "path.simplify_threshold": 0.2,
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    # A fixed place spares matplotlib the search for overlaps.
    "axes.titley": 1.0,
    "axes.labelsize": 9.0,
    "axes.edgecolor": GREY,
    "axes.linewidth": 0.7,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "axes.formatter.use_mathtext": False,
    "axes.unicode_minus": True,
    "grid.color": "#e7eaee",
    "grid.linewidth": 0.6,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.6,
    "lines.solid_capstyle": "round",
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    "savefig.dpi": 150,
    "text.parse_math": False,
}


@contextmanager
def figure_style() -> Iterator[None]:
    """Context in which figures are created and drawn."""
    with mpl.rc_context(_FIGURE_STYLE):
        yield


def subplots(height: float, *grid: int, width: float = WIDTH, **options: Any) -> tuple[Figure, Any]:
    """Return a figure [inch] and its axes, as `Figure.subplots` does."""
    figure = Figure(figsize=(width, height))
    return figure, figure.subplots(*grid, **options)


def panels(
    count: int, columns: int, size: tuple[float, float], **shared: Any
) -> tuple[Figure, list[Axes]]:
    """Return a figure [inch] and its `count` axes in rows of `columns`; the last may be shorter."""
    width, height = size
    rows = -(-count // columns)
    figure, grid = subplots(height, rows, columns, width=width, squeeze=False, **shared)
    grid = grid.ravel()
    for axes in grid[count:]:
        axes.set_visible(False)
    return figure, list(grid[:count])


def line_style(index: int) -> dict[str, Any]:
    """Return colour and dash pattern of curve number `index` (from 0); repeats after 28.

    Neighbours differ in both, so that coincident curves both remain visible.
    """
    colour, round_ = index % len(PALETTE), index // len(PALETTE)
    return {"color": PALETTE[colour], "linestyle": DASHES[(colour + round_) % len(DASHES)]}


def set_log_scale(axes: Axes, name: str) -> None:
    """Scale the axis "x" or "y" by decades, with numbers where the default ticks have mathtext."""
    axes.set(**{f"{name}scale": "log"})
    axis = getattr(axes, f"{name}axis")

    def label(value: float, _: int) -> str:
        low, high = axis.get_view_interval()
        # Numbers between decades would overlap on an axis of more than two.
        shown = (1,) if high > 100.0 * low else (1, 2, 3, 5)
        digit = value / 10 ** np.floor(np.log10(value) + 1e-9)
        return f"{value:g}" if round(digit) in shown else ""

    axis.set_major_formatter(label)
    axis.set_minor_formatter(label)


def decimate_curve(time: np.ndarray, values: np.ndarray, points: int = POINTS) -> tuple[Any, Any]:
    """Decimate a curve to at most `points` samples: ends, lowest and highest of each piece."""
    if len(time) <= points:
        return time, values
    edges = np.linspace(0, len(time), points // 2, dtype=int)
    keep = {0, len(time) - 1}
    for start, stop in itertools.pairwise(edges):
        piece = values[start:stop]
        keep.add(start + int(np.argmin(piece)))
        keep.add(start + int(np.argmax(piece)))
    chosen = np.array(sorted(keep))
    return time[chosen], values[chosen]


def shade_limits(axes: Axes, lower: float, upper: float) -> None:
    """Draw bounds as lines with the forbidden side shaded, where they are near the curves.

    A bound far outside the curves would flatten them: it is written in the corner instead.
    """
    low, high = axes.get_ylim()
    height = high - low
    reach = 0.6 * height
    notes = []
    shown = [low, high]
    for bound, side in ((lower, -1), (upper, 1)):
        if not np.isfinite(bound):
            continue
        if low - reach <= bound <= high + reach:
            edge = bound + side * 0.06 * height
            shown.append(edge)
            axes.axhline(bound, color=GREY, linewidth=0.9, linestyle=(0, (4, 2)), zorder=1)
            axes.axhspan(bound, bound + side * 1e3 * height, color=PALE, alpha=0.5, zorder=0)
        else:
            notes.append(bound)
    symmetric = lower == -upper
    if notes and not (symmetric and len(notes) == 1):
        # Space above the curve for the text.
        shown.append(high + 0.22 * height)
        values = ", ".join(f"{bound:.4g}" for bound in notes)
        text = f"limit ±{upper:.4g}" if symmetric else f"limit {values}"
        axes.text(
            0.985,
            0.97,
            text,
            transform=axes.transAxes,
            ha="right",
            va="top",
            fontsize=7,
            color=GREY,
        )
    axes.set_ylim(min(shown), max(shown))


def to_svg(figure: Figure, name: str, description: str) -> str:
    """Return a figure as inline SVG, cut to its content.

    `name`: unique on its page; prefixes the ids, which would otherwise clash between figures.
    `description`: text alternative for readers who cannot see the figure.
    """
    with mpl.rc_context({**_FIGURE_STYLE, "svg.hashsalt": name}):
        box = _content_box(figure)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", bbox_inches=box)
    text = buffer.getvalue()
    text = _compact_svg(text[text.index("<svg") :], name, description)
    times = time_axes(figure, box)
    mark = f' data-times="{json.dumps(times, separators=(",", ":"))}"' if times else ""
    return text.replace("<svg", f"<svg{mark}", 1)


def to_png(figure: Figure) -> bytes:
    """Return a figure as PNG, 150 dots per inch on white."""
    with mpl.rc_context(_FIGURE_STYLE):
        buffer = io.BytesIO()
        box = _content_box(figure)
        figure.savefig(buffer, format="png", bbox_inches=box, facecolor="white")
    return buffer.getvalue()


def _content_box(figure: Figure) -> Bbox:
    """Texts, axes and legends of a figure with a margin [inch]."""
    box: Bbox = figure.get_tightbbox().padded(0.06)
    return box


def time_axes(figure: Figure, extent: Bbox) -> list[list[float]]:
    """Return the axes over time, for the page's time cursor: place in the SVG, first and last time.

    An axis counts where its label, or that of an axis it is shared with, begins with "time".
    Returns list of [left, top, right, bottom, first, last]: in the SVG's units, the time in its
    own.
    """
    width, height = figure.get_size_inches()
    found = []
    for axes in figure.axes:
        siblings = axes.get_shared_x_axes().get_siblings(axes)
        if not axes.get_visible() or not any(
            each.get_xlabel().startswith("time") for each in [axes, *siblings]
        ):
            continue
        place = axes.get_position()
        left, right = (72.0 * (x * width - extent.x0) for x in (place.x0, place.x1))
        top, bottom = (72.0 * (extent.y1 - y * height) for y in (place.y1, place.y0))
        found.append([round(v, 3) for v in (left, top, right, bottom)] + list(axes.get_xlim()))
    return found


def _compact_svg(text: str, name: str, description: str) -> str:
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    used = set(re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', text))
    referenced = {first or second for first, second in used}
    text = re.sub(
        r' id="([^"]+)"',
        lambda match: f' id="{name}-{match[1]}"' if match[1] in referenced else "",
        text,
    )
    text = re.sub(r'href="#([^"]+)"', rf'href="#{name}-\1"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{name}-\1)", text)
    text = re.sub(r'font-family: [^;"]+', f"font-family: {FONTS}", text)
    text = re.sub(
        r'(?<= d=")[^"]+', lambda match: re.sub(r"-?\d+\.\d{2,}", _round_number, match[0]), text
    )
    text = re.sub(r"\n\s*", "\n", text)
    label = description.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
    return text.replace("<svg", f'<svg role="img" aria-label="{label}"', 1).strip()


def _round_number(match: re.Match[str]) -> str:
    return f"{float(match[0]):.2f}".rstrip("0").rstrip(".")
