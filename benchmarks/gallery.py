"""Gallery of the shipped problems, `.github/gallery.md`: `python -m benchmarks.gallery RESULTS`.

Pictures show the optimised motion, which is solved for; those of preload studies are taken from
`report.html` of RESULTS/NAME, as `stiffopt preload` writes it to `out`. Names of problems after
RESULTS: pictures of these alone are drawn. The values are those that `stiffopt verify problems/`
holds the project to.
"""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path
from typing import Any

from benchmarks.reliability.commands import ROOT
from stiffopt.cycle.solve_cycle import solve_cycle
from stiffopt.problem.cycle_files import is_cycle, load_cycle
from stiffopt.problem.files import load_problem
from stiffopt.report.common.svg import to_svg
from stiffopt.report.scene.poses import poses_along
from stiffopt.report.scene.still import still_figure
from stiffopt.solver.solve import solve

_PAGE = ROOT / ".github" / "gallery.md"
_IMAGES = ROOT / ".github" / "images"
_HEAD = """# Gallery

The shipped problems and what they give; each solves with the command below it, and in its
`report.html` the arm turns and moves. The tool's path is blue, as the arm yields red; boxes of the
cell are grey. The values are checked by `stiffopt verify problems/`.
"""
_SVG = re.compile(r"<svg [^>]*aria-label=\"([^\"]*)\".*?</svg>", re.DOTALL)
# The figure of a study that shows most at a glance.
_FLANGES = "Load of each bolt"


def main() -> None:
    results, names, parts = Path(sys.argv[1]), sys.argv[2:], [_HEAD]
    for problem in sorted((ROOT / "problems").glob("*.toml")):
        document = tomllib.loads(problem.read_text(encoding="utf-8"))
        image = _IMAGES / f"gallery_{problem.stem}.svg"
        drawn = not names or problem.stem in names
        if document["kind"] == "trajectory" and drawn:
            image.write_text(on_white(motion_picture(problem)), encoding="utf-8")
        elif (
            document["kind"] == "preload"
            and drawn
            and (results / problem.stem / "report.html").is_file()
        ):
            page = (results / problem.stem / "report.html").read_text(encoding="utf-8")
            figures = {found[1]: found[0] for found in _SVG.finditer(page)}
            image.write_text(
                on_white(figures.get(_FLANGES) or next(iter(figures.values()))), encoding="utf-8"
            )
        if document["kind"] in ("trajectory", "preload"):
            parts.append(section(problem, document, image))
    _PAGE.write_text("\n".join(parts), encoding="utf-8")


def motion_picture(path: Path) -> str:
    """The arm along the optimised motion, bent by its largest deflection; of a cycle, each leg."""
    if is_cycle(path):
        solved = solve_cycle(load_cycle(path).cycle, simulate=False)
        found = [(leg.problem, leg.solution.assessment) for leg in solved.legs]
    else:
        stated = load_problem(path).problem
        found = [(stated, solve(stated).assessment)]
    poses = [poses_along(problem, motion) for problem, motion in found if motion is not None]
    part = "dynamic" if "dynamic" in poses[0].bend else next(iter(poses[0].bend), "")
    robot, cell = found[0][0].robot, found[0][0].cell
    figure = still_figure(robot.tree, robot.tool, poses, part, 200.0, cell)
    return to_svg(figure, f"gallery_{path.stem}", f"The arm of {path.stem}")


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
