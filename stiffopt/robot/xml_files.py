"""XML files of robots, bounded in size and without entities."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np

from stiffopt.errors import InputFileError, shortened
from stiffopt.files import read_bytes

# Levels of nested elements; a URDF with its extensions for simulators stays below 15.
MAX_DEPTH = 40
# Number of elements; an arm of 50 joints with shapes, sensors and transmissions has some 2000.
MAX_ELEMENTS = 100_000


def parse_xml(path: str | os.PathLike[str], *, comments: bool = False) -> ET.Element:
    """Parse an XML file and return its root.

    Raises `InputFileError`: no file, no XML, declared entities, or too many or too deep elements.
    """
    path = Path(path)
    content = read_bytes(path)
    try:
        return _build_tree(content, path, comments)
    except InputFileError:
        raise
    except (expat.ExpatError, LookupError, ValueError) as error:
        # Unknown and multi-byte encodings raise no ExpatError.
        raise InputFileError(path, "", f"is not a URDF or MJCF: {shortened(error)}.") from error


def numbers_text(values: Iterable[float]) -> str:
    """Return numbers in full, as attributes hold them."""
    return " ".join(repr(float(value)) for value in values)


def set_inertial(
    link: ET.Element, mass: float, centre: np.ndarray, inertia: np.ndarray, **origin: str
) -> None:
    """Set the `<inertial>` of a URDF's link.

    `centre` (3,) of mass [m]; `inertia` (3, 3) about it [kg m^2]; `origin`: further attributes.
    """
    for found in link.findall("inertial"):
        link.remove(found)
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", {"xyz": numbers_text(centre), **origin})
    ET.SubElement(inertial, "mass", value=repr(float(mass)))
    moments = ET.SubElement(inertial, "inertia")
    for a, b in combinations_with_replacement(range(3), 2):
        moments.set(f"i{'xyz'[a]}{'xyz'[b]}", repr(float(inertia[a, b])))


def _build_tree(content: bytes, path: Path, comments: bool) -> ET.Element:
    """Build the tree of elements; `InputFileError` as soon as they are too deep or too many.

    Names keep their prefixes, declared or not: readers of URDFs know no namespaces, and files with
    extensions of simulators often declare none.
    """
    parser: Any = expat.ParserCreate()
    builder = ET.TreeBuilder(insert_comments=comments)
    depth = elements = 0

    def begin(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth, elements
        depth, elements = depth + 1, elements + 1
        if depth > MAX_DEPTH:
            raise InputFileError(
                path, _current_line(), f"elements are nested deeper than {MAX_DEPTH}."
            )
        if elements > MAX_ELEMENTS:
            raise InputFileError(path, "", f"has more than {MAX_ELEMENTS} elements.")
        builder.start(name, attributes)

    def end(name: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(name)

    def refuse_entity(name: str, *_: object) -> None:
        raise InputFileError(
            path,
            _current_line(),
            f"declares the entity {shortened(name)}: write its text in its place.",
        )

    def _current_line() -> str:
        return f"line {parser.CurrentLineNumber}"

    parser.StartElementHandler, parser.EndElementHandler = begin, end
    parser.CharacterDataHandler, parser.CommentHandler = builder.data, builder.comment
    parser.EntityDeclHandler = refuse_entity
    parser.buffer_text = True
    parser.Parse(content, True)
    return builder.close()
