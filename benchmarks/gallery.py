"""Gallery of the shipped problems, `.github/gallery.md`: `python -m benchmarks.gallery RESULTS`.

RESULTS holds a folder of each solved problem or study under the name of its file, as `stiffopt
solve` and `stiffopt preload` write them to `out`. Pictures are taken from their pages.
"""

from __future__ import annotations

import json
import re
import sys
import tomllib
from pathlib import Path

from benchmarks.common import ROOT

_PAGE = ROOT / ".github" / "gallery.md"
_IMAGES = ROOT / ".github" / "images"
_HEAD = """# Gallery

What the shipped problems give: solve one with the command below it, and open its `report.html`,
where the arm turns and moves. Pictures and numbers are those of the pages;
`python -m benchmarks.gallery` writes this one anew.
"""
_SVG = re.compile(r"<svg [^>]*aria-label=\"([^\"]*)\".*?</svg>", re.DOTALL)
# The picture of a page that shows most at a glance.
_WANTED = ("The arm with the paths of its tool", "Load of each bolt", "Joint diagram")


def main() -> None:
    results, parts = Path(sys.argv[1]), [_HEAD]
    for problem in sorted((ROOT / "problems").glob("*.toml")):
        folder = results / problem.stem
        if not (folder / "report.html").is_file():
            continue
        _IMAGES.mkdir(exist_ok=True)
        image = _IMAGES / f"gallery_{problem.stem}.svg"
        image.write_text(picture((folder / "report.html").read_text(encoding="utf-8")))
        parts.append(section(problem, folder, image))
    _PAGE.write_text("\n".join(parts), encoding="utf-8")


def picture(page: str) -> str:
    """The telling figure of a page as a file of its own, on white: pages may be dark."""
    figures = {found[1]: found[0] for found in _SVG.finditer(page)}
    label = next(
        (name for want in _WANTED for name in figures if name.startswith(want)), next(iter(figures))
    )
    svg = re.sub(r"<metadata>.*?</metadata>", "", figures[label], flags=re.DOTALL)
    svg = re.sub(r" data-times=\"[^\"]*\"", "", svg)
    return svg.replace("<svg ", '<svg style="background:#fff" ', 1) + "\n"


def section(problem: Path, folder: Path, image: Path) -> str:
    text = problem.read_text(encoding="utf-8")
    told = [line.lstrip("# ") for line in text.splitlines()[:8] if line.startswith("#")]
    title = str(tomllib.loads(text).get("title", problem.stem))
    study = (folder / "study.json").is_file()
    command = "preload" if study else "solve"
    found = _page_sentence((folder / "report.html").read_text(encoding="utf-8"))
    if study:
        status = json.loads((folder / "study.json").read_text())["status"]
    else:
        status = json.loads((folder / "result.json").read_text())["status"]
    return f"""
## {title}

![{title}](images/{image.name})

{" ".join(told)}

**{found}** ({status})

```sh
stiffopt {command} problems/{problem.name} --out out/{problem.stem}
```
"""


def _page_sentence(page: str) -> str:
    """The headline of a page."""
    found = re.search(r'<div class="headline">(.*?)</div>', page, re.DOTALL)
    return "" if found is None else " ".join(re.sub(r"<[^>]+>", "", found[1]).split())


if __name__ == "__main__":
    main()
