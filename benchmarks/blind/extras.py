"""Sections of the results page that studies beside the main run leave behind as JSON."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

# Files under KEY/extras, in the order of the page.
STUDIES = ("rivals", "controls", "ablation", "real")


def key_folder(text: str) -> Path:
    """Folder of a key, as an argument of a study's command line."""
    folder = Path(text)
    if not (folder / "manifest.json").is_file():
        raise argparse.ArgumentTypeError(
            f"{text} is no folder of a key: it has no manifest.json."
            " `python -m benchmarks.blind run` makes one below its --work folder."
        )
    return folder


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    lines += ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def save(folder: Path, study: str, content: dict[str, object]) -> Path:
    """Leave what a study found: "title", "text" and "head" and "rows" of a table."""
    path = folder / "extras" / f"{study}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return path


def extra_sections(folder: Path) -> list[str]:
    """Markdown of the studies that were made; a sentence for each that was not."""
    sections = []
    for study in STUDIES:
        path = folder / "extras" / f"{study}.json"
        if not path.exists():
            sections.append(
                f"## {study.capitalize()}\n\nNot run: `python -m benchmarks.blind.{study}`.\n"
            )
            continue
        found = json.loads(path.read_text(encoding="utf-8"))
        sections.append(_section(found))
    return sections


def _section(found: dict[str, object]) -> str:
    head, rows = found["head"], found["rows"]
    assert isinstance(head, list)
    assert isinstance(rows, list)
    return f"## {found['title']}\n\n{found['text']}\n\n{table(head, rows)}"
