"""Literature cited by a report, from the package's references.bib."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING

from stiffopt.errors import InputError, nearest

if TYPE_CHECKING:
    from stiffopt.discovery.effect import Effect
    from stiffopt.preload.study import PreloadStudy
    from stiffopt.problem.trajectory import TrajectoryProblem
    from stiffopt.robot.robot import Robot

_TRANSCRIPTION_KEYS = {"radau": "GargEtAl2010"}
_SOLVER_KEYS = ("WaechterBiegler2006", "AnderssonEtAl2019", "CarpentierEtAl2019")


@dataclass(frozen=True)
class Reference:
    """One entry of references.bib."""

    key: str
    fields: dict[str, str]

    @property
    def text(self) -> str:
        """Authors, title, place and year in one line."""
        place = self.fields.get("journal") or self.fields.get("booktitle")
        if place and "volume" in self.fields:
            place += f" {self.fields['volume']}"
        if place and "pages" in self.fields:
            place += f", {self.fields['pages'].replace('--', '–')}"
        authors = self.fields.get("author", "").replace(" and ", "; ")
        parts = [authors, self.fields["title"], place, self.fields.get("organization")]
        sentence = ". ".join(part.rstrip(".") for part in parts if part) + "."
        return f"{sentence[:-1]} ({self.fields['year']})." if "year" in self.fields else sentence

    @property
    def doi(self) -> str:
        """Digital object identifier, "" where there is none."""
        return self.fields.get("doi", "")


@functools.cache
def references() -> dict[str, Reference]:
    """Return all entries by key."""
    text = files("stiffopt").joinpath("references.bib").read_text(encoding="utf-8")
    found = {}
    for match in re.finditer(r"@\w+\{(\w+),(.*?)\n\}", text, flags=re.DOTALL):
        pairs = re.findall(r"(\w+)\s*=\s*\{(.*?)\}\s*(?:,|$)", match[2], flags=re.DOTALL)
        found[match[1]] = Reference(match[1], dict(pairs))
    return found


def cited(keys: Iterable[str]) -> list[Reference]:
    """Look up references of these keys, in the order given, each once."""
    known = references()
    chosen = list(dict.fromkeys(keys))
    for key in chosen:
        if key not in known:
            raise InputError(f"No reference {key!r} in references.bib. {nearest(key, known)}")
    return [known[key] for key in chosen]


def robot_references(robot: Robot) -> list[Reference]:
    """Collect the sources of the stiffness model of a robot."""
    chains = [chain for chain in robot.chains if chain is not None]
    return cited(
        key for chain in chains for each in chain.elements.values() for key in each.references
    )


def solve_references(problem: TrajectoryProblem, baselines: Iterable[str]) -> list[Reference]:
    """Collect the sources of a solve: model, transcription, solver, and the baselines shown."""
    keys = [reference.key for reference in robot_references(problem.robot)]
    keys.append(_TRANSCRIPTION_KEYS.get(problem.method.transcription, "Kelly2017"))
    keys += _SOLVER_KEYS
    if "toppra" in baselines:
        keys.append("PhamPham2018")
    return cited(keys)


def preload_references(study: PreloadStudy) -> list[Reference]:
    """Collect the sources of a preload study: fasteners, model, solver, and the front's knee."""
    keys = ["VDI2230", "ISO898", "ISO4762"]
    kinds = {row.kind for row in study.solution.rows}
    if "key pressure" in kinds:
        keys.append("DIN6892")
    if study.problem.choose is not None:
        keys.append("ISO3")
    keys += [reference.key for reference in robot_references(study.problem.robot)]
    if study.front is not None:
        keys.append("Das1999")
    keys += _SOLVER_KEYS[:2]
    return cited(keys)


def diagnosis_references(effects: Iterable[Effect]) -> list[Reference]:
    """Collect the sources of a diagnosis: identification, model comparison, effects found."""
    keys = ["SweversEtAl2007", "KassRaftery1995", _SOLVER_KEYS[2]]
    sources = list(dict.fromkeys(effect.reference for effect in effects if effect.reference))
    known = references()
    # A user's own effect may name its source in words.
    own = [Reference(text, {"title": text}) for text in sources if text not in known]
    return [*cited([*keys, *(key for key in sources if key in known)]), *own]
