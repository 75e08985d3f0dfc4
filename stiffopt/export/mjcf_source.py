"""Text of an MJCF and its includes, changed attribute by attribute: all other bytes stay."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from xml.parsers import expat

from stiffopt.files import read_bytes
from stiffopt.robot.mjcf import mjcf_parts, names_in_common_folder

# Parents of the joints of bodies: joints also stand in classes, tendons and equalities.
_KINEMATIC_PARENTS = ("body", "frame", "replicate")
_START_TAG = re.compile(rb"""<[^\s/>]+(?:\s+[^\s=/>]+\s*=\s*(?:"[^"]*"|'[^']*'))*\s*/?>""")

ElementKind = Literal["joint", "body", "inertial", "actuator"]


@dataclass(frozen=True, kw_only=True)
class MjcfElement:
    """Start tag of an element."""

    file: str  # path of its file in the folder that holds all files of the model
    tag: str
    # Bytes of the start tag.
    begin: int
    end: int
    line: int


class MjcfSource:
    """Files of an MJCF, and changes of named elements.

    `path`: the MJCF. Elements that MuJoCo makes of others (replicas, attached models) have other
    names than in the files, and are not found.
    """

    def __init__(self, path: Path) -> None:
        files = names_in_common_folder(mjcf_parts(path))
        self._content = {name: read_bytes(file) for name, file in files.items()}
        self._elements: dict[tuple[str, str], MjcfElement] = {}
        self._edits: list[tuple[MjcfElement, dict[str, str | None]]] = []
        self._added: list[tuple[MjcfElement, dict[str, str]]] = []
        for file, content in self._content.items():
            self._index_elements(file, content)

    def element(self, kind: ElementKind, name: str) -> MjcfElement | None:
        """Return the element of this kind and name; None where the files have none.

        The name of an `<inertial>` is that of its body, whose shapes may give the mass instead.
        """
        return self._elements.get((kind, name))

    def change(self, element: MjcfElement, attributes: Mapping[str, str | None]) -> None:
        """Set attributes of an element; None removes one."""
        self._edits.append((element, dict(attributes)))

    def add_inertial(self, body: MjcfElement, attributes: Mapping[str, str]) -> None:
        """Add an `<inertial>` as the first part of a body."""
        self._added.append((body, dict(attributes)))

    def contents(self) -> dict[str, bytes]:
        """Return the content of every file, by its path in the folder that holds all of them."""
        pieces: dict[str, list[tuple[int, int, bytes]]] = {name: [] for name in self._content}
        for element in dict.fromkeys(element for element, _ in self._edits):
            tag = self._content[element.file][element.begin : element.end]
            for own, attributes in self._edits:
                if own == element:
                    for name, value in attributes.items():
                        tag = _set_attribute(tag, name, value)
            pieces[element.file].append((element.begin, element.end, tag))
        for body, given in self._added:
            values = " ".join(f'{name}="{value}"' for name, value in given.items())
            inertial = self._break_before(body) + f"  <inertial {values}/>".encode()
            pieces[body.file].append((body.end, body.end, inertial))
        changed = {}
        for name, content in self._content.items():
            for begin, end, text in sorted(pieces[name], reverse=True):
                content = content[:begin] + text + content[end:]
            changed[name] = content
        return changed

    def _break_before(self, element: MjcfElement) -> bytes:
        """Return the line break and indent before an element; b"" if it begins no line."""
        before = self._content[element.file][: element.begin]
        found = re.search(rb"\r?\n[ \t]*$", before)
        return found.group() if found else b""

    def _index_elements(self, file: str, content: bytes) -> None:
        parser: Any = expat.ParserCreate()
        path: list[tuple[str, str]] = []

        def begin(tag: str, attributes: dict[str, str]) -> None:
            parent, owner = path[-1] if path else ("", "")
            name = attributes.get("name", "")
            start = parser.CurrentByteIndex
            found = _START_TAG.match(content, start)
            if found is not None:
                element = MjcfElement(
                    file=file,
                    tag=tag,
                    begin=start,
                    end=found.end(),
                    line=parser.CurrentLineNumber,
                )
                if tag == "inertial":
                    self._elements[tag, owner] = element
                elif tag == "body" or (tag == "joint" and parent in _KINEMATIC_PARENTS):
                    self._elements[tag, name] = element
                elif parent == "actuator":
                    self._elements[parent, name] = element
            path.append((tag, name if tag == "body" else owner))

        parser.StartElementHandler = begin
        parser.EndElementHandler = lambda _: path.pop()
        parser.Parse(content, True)


def _set_attribute(tag: bytes, name: str, value: str | None) -> bytes:
    """Set an attribute in a start tag, behind the others where it is new; None removes it."""
    found = re.search(rb"""\s+%s\s*=\s*("[^"]*"|'[^']*')""" % name.encode(), tag)
    if found is None:
        if value is None:
            return tag
        end = re.search(rb"\s*/?>$", tag)
        assert end is not None
        return tag[: end.start()] + f' {name}="{value}"'.encode() + tag[end.start() :]
    if value is None:
        return tag[: found.start()] + tag[found.end() :]
    return tag[: found.start(1)] + f'"{value}"'.encode() + tag[found.end(1) :]
