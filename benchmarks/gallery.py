"""Gallery of the shipped problems, `.github/gallery.md`: `python -m benchmarks.gallery RESULTS`.

Pictures of motions show the arm along the baseline to beat, which takes no solve; those of preload
studies are taken from `report.html` of RESULTS/NAME, as `stiffopt preload` writes it to `out`. The
values are those that `stiffopt verify problems/` holds the project to.
"""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path
from typing import Any

from benchmarks.reliability.commands import ROOT
from stiffopt.baseline.baselines import baselines
from stiffopt.problem.files import load_problem
from stiffopt.problem.resolve import resolve
from stiffopt.report.common.svg import extent_of, to_svg
from stiffopt.report.scene.poses import poses_along
from stiffopt.report.scene.still import still_figure

_PAGE = ROOT / ".github" / "gallery.md"
_IMAGES = ROOT / ".github" / "images"
_HEAD = """# Gallery

The shipped problems and what they give; each solves with the command below it, and in its
`report.html` the arm turns and moves. Motions are drawn along toppra's, the one to beat: the tool's
path in blue, as
the arm yields in red. The values are checked by `stiffopt verify problems/`.
"""
_SVG = re.compile(r"<svg [^>]*aria-label=\"([^\"]*)\".*?</svg>", re.DOTALL)
# The figure of a study that shows most at a glance.
_FLANGES = "Load of each bolt"


def main() -> None:
    results, parts = Path(sys.argv[1]), [_HEAD]
    for problem in sorted((ROOT / "problems").glob("*.toml")):
        document = tomllib.loads(problem.read_text(encoding="utf-8"))
        image = _IMAGES / f"gallery_{problem.stem}.svg"
        if document["kind"] == "trajectory":
            image.write_text(on_white(motion_picture(problem)), encoding="utf-8")
        elif (results / problem.stem / "report.html").is_file():
            page = (results / problem.stem / "report.html").read_text(encoding="utf-8")
            figures = {found[1]: found[0] for found in _SVG.finditer(page)}
            image.write_text(
                on_white(figures.get(_FLANGES) or next(iter(figures.values()))), encoding="utf-8"
            )
        if document["kind"] in ("trajectory", "preload"):
            parts.append(section(problem, document, image))
    _PAGE.write_text("\n".join(parts), encoding="utf-8")


def motion_picture(path: Path) -> str:
    """The arm along the better known motion of a problem, bent by its largest deflection."""
    problem = load_problem(path).problem
    found = baselines(problem, resolve(problem))
    motion = next(b.assessment for b in (found["toppra"], found["quintic"]) if b.assessment)
    poses = poses_along(problem, motion)
    part = "dynamic" if "dynamic" in poses.bend else next(iter(poses.bend), "")
    figure = still_figure(problem.robot.tree, problem.robot.tool, [poses], part, 200.0)
    return to_svg(figure, f"gallery_{path.stem}", f"The arm of {path.stem}", extent_of(figure))


def on_white(svg: str) -> str:
    """A figure of a page as a file of its own: what shows it may be dark."""
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    return svg.replace("<svg ", '<svg style="background:#fff" ', 1) + "\n"


def section(problem: Path, document: dict[str, Any], image: Path) -> str:
    """Picture, the first words of the file, what it gives, and the command."""
    lines = problem.read_text(encoding="utf-8").splitlines()
    told = []
    for line in lines:
        if not line.startswith("#"):
            break
        told.append(line.lstrip("# "))
    title = document.get("title", problem.stem)
    shown = f"![{title}](images/{image.name})\n\n" if image.is_file() else ""
    command = "solve" if document["kind"] == "trajectory" else "preload"
    return f"""
## {title}

{shown}{" ".join(told)}

{"; ".join(values(document))}.

```sh
stiffopt {command} problems/{problem.name} --out out/{problem.stem}
```
"""


def values(document: dict[str, Any]) -> list[str]:
    """What the file expects, in words."""
    expected = document.get("expected", {})
    found = []
    if "objective" in expected:
        [term, *_] = document.get("minimise", [{"objective": "objective"}])
        name = f"{term['objective']} {term.get('measure', '')}".replace("_", " ").strip()
        value = _rounded(expected["objective"])
        found.append(f"**{name} {value} {expected.get('unit', '')}**".strip())
    for name, each in expected.get("values", {}).items():
        value = _rounded(each["value"])
        found.append(f"{name.replace('_', ' ')} {value} {each.get('unit', '')}".strip())
    return found or ["No value is expected of it"]


def _rounded(value: float) -> str:
    """To two digits: the page need not follow every digit that a better solve gains."""
    return f"{float(f'{value:.2g}'):g}"


if __name__ == "__main__":
    main()
