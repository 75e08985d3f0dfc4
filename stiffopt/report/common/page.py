"""Templates to pages: filters for the cells, figures as SVG and their files, all in one step."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from stiffopt.files import atomic_write
from stiffopt.report.common.svg import to_png, to_svg
from stiffopt.report.common.text import FILTERS

Filters = dict[str, Callable[..., Any]]


class PageFigures(dict[str, Markup]):
    """SVG of the figures of a page by name, and their files where they are wanted.

    Parameters
    ----------
    prefix : str
        Of the file names.
    svg, png : bool
        Write files of this kind beside the page.

    Attributes
    ----------
    files : dict of str to str or bytes
        Contents by file name.
    """

    def __init__(self, prefix: str, *, svg: bool = True, png: bool = True) -> None:
        super().__init__()
        self._prefix, self._svg, self._png = prefix, svg, png
        self.files: dict[str, str | bytes] = {}

    def draw(self, name: str, figure: Figure, description: str) -> None:
        """Add a figure; the description is for readers that cannot see it."""
        full = f"{self._prefix}_{name}"
        svg = to_svg(figure, full, description)
        # Made by this package, so that it may enter the page unescaped.
        self[name] = Markup(svg)
        if self._svg:
            self.files[f"{full}.svg"] = svg
        if self._png:
            self.files[f"{full}.png"] = to_png(figure)


def add_contents(page: str) -> str:
    """Page whose sections can be reached: a list of them behind its header."""
    titles: list[str] = []

    def marked(match: re.Match[str]) -> str:
        titles.append(match[1])
        return f'<h2 id="section-{len(titles)}">{match[1]}</h2>'

    page = re.sub(r"<h2>(.*?)</h2>", marked, page)
    items = "".join(
        f'<li><a href="#section-{number}">{title}</a></li>'
        for number, title in enumerate(titles, start=1)
    )
    contents = f'<nav class="contents" aria-label="Contents"><ol>{items}</ol></nav>'
    return page.replace("</header>", f"</header>\n{contents}", 1) if len(titles) > 2 else page


def write_page(
    template: str,
    path: Path,
    context: Mapping[str, Any],
    figures: PageFigures,
    filters: Filters | None = None,
) -> Path:
    """Render a template of `stiffopt.report` and write it after the files of its figures.

    Everything is escaped but the figures. An interruption takes back the files that are new.

    Parameters
    ----------
    template : str
        Such as "solve/page.html.j2".
    path : Path
        Of the page; the figures lie beside it.
    context : mapping
        What the template speaks of, beside `figures`.
    figures : PageFigures
    filters : dict of name to callable, optional
        Of this page, beside those of `common.text`.
    """
    environment = Environment(
        loader=PackageLoader("stiffopt.report", ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        extensions=["jinja2.ext.do"],
    )
    environment.tests["finite"] = math.isfinite
    environment.filters |= FILTERS | (filters or {})
    page = add_contents(environment.get_template(template).render(context, figures=figures))
    contents = {path.parent / name: content for name, content in figures.files.items()}
    contents[path] = page
    new = [each for each in contents if not each.exists()]
    try:
        for each, content in contents.items():
            atomic_write(each, content)
    except BaseException:
        for each in filter(Path.exists, new):
            each.unlink()
        raise
    return path
