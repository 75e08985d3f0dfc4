"""Style of all figures and their way into a page: small SVG with text as text and unique ids."""

from __future__ import annotations

import functools
import io
import itertools
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis, Tick
from matplotlib.backends.backend_svg import RendererSVG
from matplotlib.figure import Figure
from matplotlib.path import Path
from matplotlib.text import Text
from matplotlib.transforms import Affine2D, Bbox

# Okabe and Ito's colours: told apart by colour-blind readers and, by lightness, in grey print.
BLUE, VERMILLION, GREEN = "#0072B2", "#D55E00", "#009E73"
ORANGE, PURPLE, SKY, BLACK = "#E69F00", "#B0578D", "#56B4E9", "#222222"
PALETTE = (BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY, BLACK)
DASHES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (1.5, 1.2)), (0, (6, 1.5, 1.5, 1.5)))
GREY, PALE, INK = "#6b7280", "#d4d8de", "#1f2933"
FONTS = "'Helvetica Neue', Arial, 'DejaVu Sans', sans-serif"
POINTS = 600
# Matplotlib's own names for laying out the ticks of an axis and a text.
_TICKS, _LAYOUT = "_update_ticks", "_get_layout"
# Of every figure, in inches: the text column of a page, and what is left free around it.
WIDTH, _MARGIN_INCH = 10.4, 0.06
# Of an SVG in an inch.
_DOTS = 72.0

_FIGURE_STYLE: Any = {
    "svg.fonttype": "none",
    "path.simplify": True,
    "path.simplify_threshold": 0.2,
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    # Else it is looked for what else is up there.
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
    """Context in which figures are made and drawn."""
    with mpl.rc_context(_FIGURE_STYLE):
        yield


def line_style(index: int) -> dict[str, Any]:
    """Colour and dash pattern of the curve number `index` (from 0); repeats after 28.

    Neighbours differ in both, so that equal curves stay visible on top of each other.
    """
    colour, round_ = index % len(PALETTE), index // len(PALETTE)
    return {"color": PALETTE[colour], "linestyle": DASHES[(colour + round_) % len(DASHES)]}


def decimate_curve(time: np.ndarray, values: np.ndarray, points: int = POINTS) -> tuple[Any, Any]:
    """Curve with at most `points` samples that keeps every visible peak.

    The curve is cut into pieces and each keeps its lowest and highest sample.

    Parameters
    ----------
    time, values : array (K,)

    Returns
    -------
    (array, array)
        The samples kept, ends included.
    """
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
        # Room above the curve, so that the text stands free.
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
    """Figure as inline SVG, cut to what it covers.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    name : str
        Unique on its page; prefixes the ids, which would else clash between figures.
    description : str
        What the figure shows, for readers that cannot see it.
    """
    with mpl.rc_context({**_FIGURE_STYLE, "svg.hashsalt": name}):
        buffer = io.StringIO()
        drawn = _Measured(figure, buffer)
        with _ticks_once(figure):
            figure.draw(drawn)
        drawn.finalize()
    box = drawn.extent(figure)
    text = _compact_svg(_cut(buffer.getvalue(), box, figure), name, description)
    times = time_axes(figure, box)
    mark = f' data-times="{json.dumps(times, separators=(",", ":"))}"' if times else ""
    return text.replace("<svg", f"<svg{mark}", 1)


# Matplotlib does not say its types.
_Renderer: Any = RendererSVG


class _Measured(_Renderer):  # type: ignore[misc]
    """Draws a figure and keeps the places of its texts: what it covers is known then.

    Asked for that beforehand, or for a figure cut to it, matplotlib lays all of it out once more.
    """

    def __init__(self, figure: Figure, file: io.StringIO) -> None:
        dots = figure.dpi
        figure.dpi = _DOTS
        width, height = figure.get_size_inches()
        super().__init__(_DOTS * width, _DOTS * height, file, image_dpi=dots)
        self._texts: list[Bbox] = []

    def _convert_path(self, path: Path, transform: Any = None, *_: Any, **more: Any) -> str:
        # Matplotlib leaves lines beside the figure out, such as those of a legend below it.
        return str(super()._convert_path(path, transform, **{**more, "clip": None}))

    def draw_text(self, *given: Any, mtext: Text | None = None, ismath: Any = False) -> None:
        super().draw_text(*given, ismath=ismath, mtext=mtext)
        if mtext is not None:
            self._texts.append(mtext.get_window_extent(self))
            return
        # A line of several.
        _, x, y, line, font, angle, *_ = given
        width, height, descent = self.get_text_width_height_descent(line, font, False)
        corners = np.array([[0.0, -descent], [width, height - descent]])
        turn = Affine2D().rotate_deg(angle).translate(x, self.height - y)
        self._texts.append(Bbox(corners).transformed(turn))

    def extent(self, figure: Figure) -> Bbox:
        """Texts, axes and legends, with a margin [inch]."""
        axes = [each for each in figure.axes if each.get_visible()]
        legends = [*figure.legends, *(each.get_legend() for each in axes)]
        boxes = [*self._texts, *(each.bbox for each in axes)]
        boxes += [each.get_window_extent(self) for each in legends if each is not None]
        covered = Bbox.union([box for box in boxes if box.width or box.height])
        return covered.transformed(Affine2D().scale(1.0 / _DOTS)).padded(_MARGIN_INCH)


def _cut(text: str, box: Bbox, figure: Figure) -> str:
    """SVG of a whole figure moved and cut to a box [inch]."""
    width, height = (f"{_DOTS * size:.6g}" for size in (box.width, box.height))
    left = -_DOTS * box.x0
    top = _DOTS * (box.y1 - figure.get_figheight())
    head, rest = text[text.index("<svg") :].split(">", 1)
    for side, size in (("width", width), ("height", height)):
        head = re.sub(rf'(?<= {side}=")[^"]*', f"{size}pt", head, count=1)
    head = re.sub(r'(?<= viewBox=")[^"]*', f"0 0 {width} {height}", head, count=1)
    body = rest.rstrip().removesuffix("</svg>")
    return f'{head}>\n<g transform="translate({left:.2f} {top:.2f})">{body}</g>\n</svg>'


def time_axes(figure: Figure, extent: Bbox) -> list[list[float]]:
    """Axes over time, for a cursor that moves along them: place in the SVG, first and last time.

    Those whose label begins with "time", and those that share their axis.

    Returns
    -------
    list of [left, top, right, bottom, first, last]
        In the SVG's units, the time in its own.
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


def to_png(figure: Figure) -> bytes:
    """Figure as PNG, 150 dots per inch on white."""
    with mpl.rc_context(_FIGURE_STYLE):
        buffer = io.BytesIO()
        with _ticks_once(figure):
            # `bbox_inches="tight"` draws every figure once more only to know this.
            box = figure.get_tightbbox().padded(_MARGIN_INCH)
            figure.savefig(buffer, format="png", bbox_inches=box, facecolor="white")
    return buffer.getvalue()


@contextmanager
def _ticks_once(figure: Figure) -> Iterator[None]:
    """Context in which the ticks of an axis are laid out once, their labels too.

    Matplotlib does so for each of its labels, spines and lines: half of what a figure costs. Where
    it moves the axes meanwhile, to make room, ticks follow them.
    """
    moves = figure.get_layout_engine() is not None
    flat = [] if moves else [axes for axes in figure.axes if axes.name != "3d"]
    changed: list[tuple[Artist, str]] = []

    def once(artist: Artist, method: str) -> None:
        vars(artist)[method] = functools.cache(getattr(artist, method))
        changed.append((artist, method))

    def laid_out(axis: Axis) -> list[Tick]:
        ticks: list[Tick] = getattr(type(axis), _TICKS)(axis)
        for tick in ticks:
            once(tick.label1, _LAYOUT)
        return ticks

    for axis in [axis for axes in flat for axis in (axes.xaxis, axes.yaxis)]:
        vars(axis)[_TICKS] = functools.partial(laid_out, axis)
        once(axis, _TICKS)
    try:
        yield
    finally:
        for artist, method in changed:
            vars(artist).pop(method, None)


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
