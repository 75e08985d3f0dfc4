"""Templates to pages, pages to files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from stiffopt.files import atomic_write


@dataclass(frozen=True)
class PageFigure:
    """A figure of a page. `svg` is inserted as it is; title and caption are escaped."""

    svg: Markup
    caption: str
    title: str = ""


def page_figure(svg: str, caption: str, title: str = "") -> PageFigure:
    """Figure whose SVG was made by this package, so that it may enter the page unescaped."""
    return PageFigure(Markup(svg), caption, title)


def write_page(template: str, path: Path, context: dict[str, Any]) -> Path:
    """Render a template of this package, everything escaped, and write it in one step."""
    environment = Environment(
        loader=PackageLoader("stiffopt.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
    )
    atomic_write(path, environment.get_template(template).render(context))
    return path
