"""Names, numbers and fasteners of a preload study as people say them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import TYPE_CHECKING

from stiffopt.connection import BoltedFlange, ClampingPins
from stiffopt.report.common.quantities import engineering, significant

if TYPE_CHECKING:
    from stiffopt.preload.problem import FreeElement, PreloadProblem
    from stiffopt.preload.utilisation import UtilisationRow

# Marks an estimated number.
MARK = " *"
# A relative change below this is none.
UNCHANGED = 5e-5
_OBJECTIVES = {
    "total_preload": "least total preload",
    "bolt_utilisation": "least utilisation of bolts and pins",
    "joint_stiffness": "most joint stiffness",
    "tool_deflection": "least tool deflection",
}
_METHODS = {
    "torque_wrench": "torque wrench",
    "angle": "angle of rotation",
    "yield": "yield-controlled",
}


def spoken(text: str) -> str:
    """Keys of elements as people say them, also within a sentence; keys of files stay.

    >>> spoken("joint_2.flexspline_flange"), spoken("4.5 kN in motor_key.")
    ('joint 2 flexspline flange', '4.5 kN in motor key.')
    >>> spoken("a smaller require.least_preload")
    'a smaller require.least_preload'
    """
    return re.sub(r"[A-Za-z][\w.]*\w", _as_words, text)


def _as_words(word: re.Match[str]) -> str:
    """Dots and underscores of a key as spaces, unless it is a key of a study file."""
    key = word[0]
    return key if key.startswith("require.") else key.replace(".", " ").replace("_", " ")


def prose(text: str) -> str:
    """Sentence with keys of elements spoken and a space before each per cent.

    >>> prose("15% more in joint_2.motor_key")
    '15 % more in joint 2 motor key'
    """
    return re.sub(r"(?<=\d)%", " %", spoken(text))


def objective_name(problem: PreloadProblem) -> str:
    """Objective in words."""
    return _OBJECTIVES[problem.objective]


def method_name(problem: PreloadProblem) -> str:
    """Tightening method in words."""
    return _METHODS[problem.tightening.method]


def owner_name(row: UtilisationRow) -> str:
    """Element, else joint, else the tool."""
    if row.element:
        return spoken(row.element)
    return f"joint {row.joint}" if row.joint else "tool"


def fasteners(element: FreeElement) -> str:
    """Count, size and grade: "9 × M5 12.9"."""
    connection = element.stage.element
    if isinstance(connection, BoltedFlange) and connection.bolt is not None:
        return f"{element.count} × {connection.bolt.size} {connection.bolt.grade}"
    if isinstance(connection, ClampingPins) and connection.screw is not None:
        return f"{element.count} × {connection.screw.size} set screw"
    return f"{element.count} pins"


def fastener_words(elements: Iterable[FreeElement]) -> str:
    """Count bolts and pins: "12 bolts", "1 pin", "109 bolts and pins"."""
    counts = {"bolt": 0, "pin": 0}
    for element in elements:
        name = "bolt" if element.stage.element.kind == "bolted_flange" else "pin"
        counts[name] += element.count
    if all(counts.values()):
        return f"{sum(counts.values())} bolts and pins"
    name = "bolt" if counts["bolt"] else "pin"
    return f"{counts[name]} {name}{'s' if counts[name] > 1 else ''}"


def present_preload(element: FreeElement) -> float:
    """Preload that the robot file gives one bolt or pin of a connection [N]."""
    preload = element.stage.element.preload
    assert preload is not None  # bolted flanges and pins are not built without
    return preload


def listed(names: Iterable[str]) -> str:
    """Join with commas and an "and".

    >>> listed(["slip", "head pressure", "stiffness"]), listed(["slip"])
    ('slip, head pressure and stiffness', 'slip')
    """
    each = list(names)
    return each[0] if len(each) == 1 else f"{', '.join(each[:-1])} and {each[-1]}" if each else ""


def change(ratio: float) -> str:
    """Relative change with its sign.

    >>> change(1.0031), change(0.98), change(1.0)
    ('+0.31 %', '−2 %', '0 %')
    """
    size = ratio - 1.0
    if abs(size) < UNCHANGED:
        return "0 %"
    return f"{'+' if size > 0 else '−'}{significant(100 * abs(size), 2)} %"


def quantity(value: float, unit: str, digits: int = 4) -> str:
    """Value as text; forces in kN, pressures in MPa."""
    if unit == "N":
        return f"{significant(value / 1e3, digits)} kN"
    if unit == "Pa":
        return f"{significant(value / 1e6, digits)} MPa"
    return engineering(value, unit, digits)
