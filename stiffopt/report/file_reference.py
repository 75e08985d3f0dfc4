"""Reference of the input files, from their declarations: each key with unit, range and default.

`python -m stiffopt.report.file_reference > .github/files.md` regenerates the page.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import Any

from stiffopt.dimensions import range_text
from stiffopt.discovery.extended.schema import ExtendedFile
from stiffopt.errors import InputError
from stiffopt.preload.schema import PreloadFile
from stiffopt.problem.schema import problem_file
from stiffopt.recording.schema import RecordingsFile, StaticFile
from stiffopt.report.common.text import MAX_LISTED
from stiffopt.result.store import COLUMNS
from stiffopt.robot.own_catalogue import CatalogueFile
from stiffopt.robot.schema import robot_file_schema
from stiffopt.sweep.schema import SweepFile
from stiffopt.validation import Section

_PAGE_HEAD = """# Files

Every key of the files that people write, generated from their declarations; `stiffopt schema KIND`
gives the same as JSON Schema, for editors. A bare number is SI; where a unit is given, a text with
another unit of the same kind is converted: `"45 deg"`, `"0.3 mm"`, `"12 kN"`, `"5 N*m/arcmin"`
(not in recordings). A second unit in brackets is that of prismatic joints. Joints count from 1.
Unknown keys are errors that name the nearest known one. A bare number whose magnitude lies outside
the plausible range, which is in SI, is asked about: written with its unit, it is taken as meant."""

_MOTION_SECTION = """## Motions (`trajectory.csv` and `command.csv`, written by `stiffopt solve`)

One row every 2 ms. `command.csv` has the columns t, q, qd, qdd, tau and link. `stiffopt export`
writes qN, qdN and qddN of the motors, or the same of the links (`--of link`), without torques; the
header of an exported file says whose they are (`of`) and has the hashes of motion, robot, payload
and limits.

`cycle.csv` of a cycle has the columns t, leg (from 1), payload [kg], q, qd and qdd of the motors,
and link, over all legs and rests."""

_KIND_TITLES = {
    "trajectory": "Trajectory problem",
    "preload": "Preload study",
    "sweep": "Sweep",
    "robot": "Robot",
    "catalogue": "One's own catalogue of reducers",
    "recordings": "Recording set (`recordings.toml`)",
    "static": "Static deflections (`static.toml`)",
    "extended": "Extended model (`extended.toml`, written by `stiffopt diagnose`)",
}


def file_models() -> dict[str, type[Section]]:
    """Return the pydantic model of each kind of file."""
    return {
        "trajectory": problem_file(),
        "preload": PreloadFile,
        "sweep": SweepFile,
        "robot": robot_file_schema(),
        "catalogue": CatalogueFile,
        "recordings": RecordingsFile,
        "static": StaticFile,
        "extended": ExtendedFile,
    }


def file_schema(kind: str) -> dict[str, Any]:
    """Return the JSON Schema of a kind of file."""
    return file_models()[kind].model_json_schema(by_alias=True)


def reference_page() -> str:
    """Return the reference page as Markdown."""
    parts = [_PAGE_HEAD]
    for kind, title in _KIND_TITLES.items():
        parts.append(f"## {title}")
        parts.extend(_format_sections(file_schema(kind)))
    parts += [_MOTION_SECTION, _column_table()]
    return "\n\n".join(parts) + "\n"


def _column_table() -> str:
    """Return the table of the columns of trajectory.csv."""
    rows = ["| column | unit | |", "|---|---|---|"]
    rows += [f"| `{name}` | {unit} | {text} |" for name, (unit, text) in COLUMNS.items()]
    return "\n".join(rows)


def sentence(field: dict[str, Any], definitions: dict[str, Any]) -> str:
    """Return the description of a key, or of the section that it contains."""
    if "description" in field:
        return " ".join(field["description"].split())
    held = [form["$ref"].rpartition("/")[2] for form in forms(field) if "$ref" in form]
    return _section_sentence(definitions[held[0]]) if len(held) == 1 else ""


def units(field: dict[str, Any]) -> list[str]:
    """Return the units of a key; that of a prismatic joint follows in brackets."""
    found = [
        f"{form['unit']} ({form['unit_prismatic']})" if "unit_prismatic" in form else form["unit"]
        for form in forms(field)
        if "unit" in form
    ]
    return list(dict.fromkeys(found))


def plausible(field: dict[str, Any]) -> str:
    """Return the plausible range [SI]; that of a prismatic joint follows in brackets."""
    ranges = {
        word: [range_text(form[word]) for form in forms(field) if word in form]
        for word in ("plausible", "plausible_prismatic")
    }
    turning, sliding = ranges["plausible"], ranges["plausible_prismatic"]
    texts = [f"{own} ({other})" for own, other in zip(turning, sliding, strict=False)]
    return ", ".join(dict.fromkeys(texts or turning))


def forms(field: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the schema of a key and, recursively, those of its alternatives and items."""
    yield field
    for word in ("anyOf", "oneOf", "prefixItems"):
        for form in field.get(word, ()):
            yield from forms(form)
    for word in ("items", "additionalProperties"):
        if isinstance(field.get(word), dict):
            yield from forms(field[word])


@dataclass(frozen=True)
class FileKey:
    """A key of a file as text: place, type, unit, plausible range, default and description."""

    place: str
    value: str
    unit: str
    plausible: str
    default: str
    sentence: str
    owner: str = ""  # such as `type = "key"`, of a section with several types


def file_keys(kind: str) -> Iterator[FileKey]:
    """Yield every key of a kind of file; its place reads such as "motion.start.rpy"."""
    schema = file_schema(kind)
    definitions = schema.get("$defs", {})
    for places, section in _section_places(schema):
        inside = [heading.strip("[]") for heading in places] or [""]
        for cells in _key_rows(section, definitions):
            key, *rest = cells
            for place in inside:
                named = f"{place}.{key.strip('`')}".lstrip(".")
                yield replace(FileKey(named, *rest), owner=_type_entry(section))


def _format_sections(schema: dict[str, Any]) -> Iterator[str]:
    """Yield description and table of the file and of each of its sections."""
    definitions = schema.get("$defs", {})
    for used, section in _section_places(schema):
        if used:
            kind = _type_entry(section)
            tag = f", `{kind}`" if kind else ""
            yield f"### {', '.join(f'`{place}`' for place in used)}{tag}"
        yield _section_sentence(section)
        yield _key_table(section, definitions)


def _type_entry(section: dict[str, Any]) -> str:
    """Return the entry that chooses a section among those at its place; "" without any."""
    kind = section["properties"].get("type", {}).get("const")
    return f'type = "{kind}"' if kind else ""


def _section_places(schema: dict[str, Any]) -> Iterator[tuple[list[str], dict[str, Any]]]:
    """Yield the sections of a file with their headings; the file itself has none."""
    definitions = schema.get("$defs", {})
    places: dict[str, list[str]] = {}
    waiting = [(schema, "")]
    while waiting:
        section, place = waiting.pop(0)
        for key, field in section["properties"].items():
            for name, inside, heading in _section_references(field, f"{place}.{key}".lstrip(".")):
                known = places.setdefault(name, [])
                if not known:
                    waiting.append((definitions[name], inside))
                if heading not in known:
                    known.append(heading)
    yield [], schema
    for name, used in places.items():
        yield used, definitions[name]


def _section_references(field: dict[str, Any], place: str) -> Iterator[tuple[str, str, str]]:
    """Yield name, place and heading of the sections that a key contains."""
    for form in forms(field):
        if "$ref" in form:
            inside = f"{place}.NAME" if _is_in_mapping(field, form) else place
            heading = f"[[{inside}]]" if _is_in_list(field, form) else f"[{inside}]"
            yield form["$ref"].rpartition("/")[2], inside, heading


def _is_in_list(field: dict[str, Any], form: dict[str, Any]) -> bool:
    return any(form in forms(f["items"]) for f in forms(field) if "items" in f)


def _is_in_mapping(field: dict[str, Any], form: dict[str, Any]) -> bool:
    held = [f["additionalProperties"] for f in forms(field) if "additionalProperties" in f]
    return any(isinstance(inside, dict) and form in forms(inside) for inside in held)


def _section_sentence(section: dict[str, Any]) -> str:
    return " ".join(section.get("description", "").split())


def _key_table(section: dict[str, Any], definitions: dict[str, Any]) -> str:
    rows = ["| key | value | unit | plausible | default | |", "|---|---|---|---|---|---|"]
    for cells in _key_rows(section, definitions):
        rows.append(f"| {' | '.join(cell.replace('|', '/') for cell in cells)} |")
    return "\n".join(rows)


def _key_rows(section: dict[str, Any], definitions: dict[str, Any]) -> Iterator[tuple[str, ...]]:
    """Yield key, type, unit, plausible range, default and description of a section's keys."""
    required = section.get("required", ())
    for key, field in section["properties"].items():
        if "const" in field and key == "type":
            continue
        default = "required" if key in required else _format_default(field)
        text = sentence(field, definitions) + _format_examples(field)
        yield (
            f"`{key}`",
            _format_type(field),
            ", ".join(units(field)),
            plausible(field),
            default,
            text,
        )


def _format_type(field: dict[str, Any]) -> str:
    """Return the type of a key in words."""
    if "const" in field:
        return f"`{field['const']!r}`".replace("'", '"')
    if "enum" in field:
        return " or ".join(f'`"{word}"`' for word in field["enum"])
    if "unit" in field:
        return f"number{_format_bounds(field)}"
    if "$ref" in field or "oneOf" in field:
        return "section"
    if "anyOf" in field:
        forms = [_format_type(form) for form in field["anyOf"] if form.get("type") != "null"]
        return " or ".join(dict.fromkeys(forms))
    kind = field.get("type")
    if kind == "array":
        if "prefixItems" in field:
            entries = list(dict.fromkeys(_format_type(item) for item in field["prefixItems"]))
            return f"{len(field['prefixItems'])} entries: {', '.join(entries)}"
        return f"list: {_format_type(field.get('items', {}))}"
    if kind == "object":
        return f"by name: {_format_type(field.get('additionalProperties', {}))}"
    words = {"number": "number", "integer": "whole number", "boolean": "true or false"}
    return words.get(kind or "", "text") + _format_bounds(field)


def _format_bounds(field: dict[str, Any]) -> str:
    """Return the bounds of a number, from any of its alternatives."""
    texts = {
        "exclusiveMinimum": "above",
        "minimum": "at least",
        "exclusiveMaximum": "below",
        "maximum": "at most",
    }
    found = [
        f"{text} {form[word]:.4g}"
        for form in forms(field)
        for word, text in texts.items()
        if word in form
    ]
    return " " + " and ".join(found) if found else ""


def _format_default(field: dict[str, Any]) -> str:
    value = field.get("default")
    if value is None or value in ("", [], {}) or isinstance(value, dict):
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, list):
        return f"[{', '.join(_format_default({'default': entry}) for entry in value)}]"
    return f"{value:.6g}"


def _format_examples(field: dict[str, Any]) -> str:
    """Return the catalogue names that a key accepts, shortened."""
    names = [name for form in forms(field) for name in form.get("examples", ())]
    more = ", ..." if len(names) > MAX_LISTED else ""
    return f" One of {', '.join(names[:MAX_LISTED])}{more}." if names else ""


if __name__ == "__main__":
    print(reference_page(), end="")


def explain_key(key: str) -> Iterator[str]:
    """Yield lines on every key of a name or place, such as "prepressure" or "motion.duration".

    Allowed values, such as the name of an objective, are found as well. Raises `InputError`: no
    file has such a key or value; the message suggests a similar one.
    """
    wanted = key.strip().strip("[]").replace("[[", "").replace("]]", "").replace(" ", "")
    every = [(kind, each) for kind in file_models() for each in file_keys(kind)]
    found = [(kind, each) for kind, each in every if _matches_place(each.place, wanted)]
    if not found:
        found = [(kind, each) for kind, each in every if wanted in _allowed_words(each)]
    if not found:
        names = {each.place.rpartition(".")[2] for _, each in every}
        names |= {choice for _, each in every for choice in _allowed_words(each)}
        # difflib ratio from which another word is suggested: "durration" and "duration" have 0.94,
        # "shaped_deviation" and "head_friction" 0.62.
        close = get_close_matches(wanted.rpartition(".")[2], sorted(names), 1, 0.8)
        hint = f" Did you mean {close[0]!r}?" if close else ""
        raise InputError(f"no file has a key or a value {key!r}.{hint}")
    told: dict[tuple[str, str, str, str, str], list[str]] = {}
    for kind, each in found:
        about = (each.value, each.unit, each.plausible, each.default, each.sentence)
        told.setdefault(about, []).append(
            f"{each.place} ({', '.join(filter(None, (kind, each.owner)))})"
        )
    for number, (about, places) in enumerate(told.items()):
        if number:
            yield ""
        more = f" and {len(places) - MAX_LISTED} more" if len(places) > MAX_LISTED else ""
        yield ", ".join(places[:MAX_LISTED]) + more
        yield from _describe_key(*about)


def _allowed_words(key: FileKey) -> list[str]:
    """Return the words that a key accepts as value."""
    return re.findall(r'"([^"]+)"', key.value)


def _matches_place(place: str, wanted: str) -> bool:
    bare = place.replace(".NAME", "")
    return bare == wanted or bare.endswith(f".{wanted}") or place.endswith(f".{wanted}")


def _describe_key(
    value: str, unit: str, plausible: str, default: str, sentence: str
) -> Iterator[str]:
    if sentence:
        yield f"  {sentence}"
    yield (
        f"  {value.replace('`', '')}"
        + (f" [{unit}]" if unit else "")
        + (f", plausible {plausible}" if plausible else "")
        + ("; required" if default == "required" else f"; default {default}" if default else "")
    )
