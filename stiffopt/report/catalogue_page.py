"""Catalogue of effects: its page in Markdown, and tables of all catalogues for the terminal.

``python -m stiffopt.report.catalogue_page > .github/catalogue.md`` regenerates it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal, get_args

from stiffopt.discovery.catalogue import CATALOGUE, confused_with
from stiffopt.discovery.effect import NEEDS, Effect
from stiffopt.discovery.identifiable import required_signals
from stiffopt.drivetrain import catalogue
from stiffopt.drivetrain.tables import rows
from stiffopt.errors import InputError
from stiffopt.report.common.text import DASH
from stiffopt.robot.files import load_robot, shipped_robots

CatalogueKind = Literal["reducers", "bolts", "keys", "belts", "surfaces", "robots", "effects"]
Table = tuple[tuple[str, ...], list[tuple[str, ...]]]
_FILE_ENTRIES = {
    "reducers": 'catalogue = "NAME" of an element of type "reducer"',
    "bolts": 'bolt = { size = "SIZE", grade = "12.9" or "A2-70" } of a flange',
    "keys": 'width and height of an element of type "key"',
    "belts": 'profile = "NAME" of an element of type "timing_belt"',
    "surfaces": 'surface = "NAME" of keys, flanges and pins',
    "robots": 'robot = "NAME" of problems, studies and recording sets',
    "effects": "effects that `stiffopt diagnose` can identify",
}


def catalogue_table(kind: CatalogueKind) -> Table:
    """Return header and rows of one catalogue as text."""
    return _TABLE_BUILDERS[kind]()


def catalogue_kinds() -> list[tuple[str, str, str]]:
    """Return each catalogue with its number of entries and the key that refers to it in files."""
    return [
        (kind, str(len(_TABLE_BUILDERS[kind]()[1])), _FILE_ENTRIES[kind])
        for kind in get_args(CatalogueKind)
    ]


def _reducer_table() -> Table:
    head = ("name", "K1", "K2", "K3 [N m/rad]", "T1", "T2", "repeated peak [N m]", "provenance")
    found = []
    for name in catalogue.reducer_names():
        entry = catalogue.reducer(name)
        peak = DASH if entry.ratings is None else f"{entry.ratings[1]:g}"
        values = (f"{v:g}" for v in (entry.K1, entry.K2, entry.K3, entry.T1, entry.T2))
        found.append((name, *values, peak, _format_provenance(entry)))
    return head, found


def _bolt_table() -> Table:
    head = (
        "size",
        "pitch [mm]",
        "stress area [mm2]",
        "head [mm]",
        "hole [mm]",
        "provenance",
        "washer [mm]",
    )
    found = []
    for size in catalogue.bolt_sizes():
        bolt = catalogue.bolt(size)
        lengths = (f"{1e3 * v:g}" for v in (bolt.head_diameter, bolt.hole))
        area = f"{1e6 * bolt.stress_area:.4g}"
        pitch = f"{1e3 * bolt.pitch:g}"
        found.append((size, pitch, area, *lengths, _format_provenance(bolt), _format_washer(size)))
    return head, found


def _format_washer(size: str) -> str:
    try:
        found = catalogue.washer(size)
    except InputError:
        return DASH
    return f"{1e3 * found.diameter:g} x {1e3 * found.thickness:g}, {_format_provenance(found)}"


def _key_table() -> Table:
    head = ("width x height [mm]", "shaft above [mm]", "up to [mm]", "provenance", "source")
    found: list[tuple[str, ...]] = [
        (
            size,
            f"{1e3 * row['shaft_min']:g}",
            f"{1e3 * row['shaft_max']:g}",
            *_provenance_cells(row),
        )
        for size, row in rows("keys", "key", "size").items()
    ]
    return head, found


def _belt_table() -> Table:
    head = ("profile", "pitch [mm]", "widths [mm]", "provenance")
    found: list[tuple[str, ...]] = []
    for name in catalogue.belt_names():
        belt = catalogue.belt(name)
        widths = ", ".join(f"{1e3 * float(w):g}" for w in belt.span_stiffness)
        found.append((name, f"{1e3 * belt.pitch:g}", widths, _format_provenance(belt)))
    return head, found


def _surface_table() -> Table:
    head = ("name", "first", "second", "friction", "provenance", "source")
    found: list[tuple[str, ...]] = [
        (name, row["first"], row["second"], f"{row['friction']:g}", *_provenance_cells(row))
        for name, row in rows("surfaces", "surface", "name").items()
    ]
    return head, found


def _robot_table() -> Table:
    arms = [load_robot(name) for name in shipped_robots()]
    head = ("name", "title", "joints", "estimated numbers")
    found: list[tuple[str, ...]] = [
        (arm.name, arm.title, str(arm.n), str(len(arm.estimated()))) for arm in arms
    ]
    return head, found


def _effect_table() -> Table:
    head = ("effect", "family", "scope", "equation", "signature")
    return head, [(e.name, e.family, e.scope, e.equation, e.signature) for e in CATALOGUE]


def _format_provenance(entry: catalogue.Entry) -> str:
    guessed = f" ({', '.join(entry.estimated)} estimated)" if entry.estimated else ""
    return f"{entry.provenance}{guessed}"


def _provenance_cells(row: dict[str, str]) -> tuple[str, str]:
    return str(row["provenance"]), str(row["source"])


_TABLE_BUILDERS: dict[str, Callable[[], Table]] = {
    "reducers": _reducer_table,
    "bolts": _bolt_table,
    "keys": _key_table,
    "belts": _belt_table,
    "surfaces": _surface_table,
    "robots": _robot_table,
    "effects": _effect_table,
}


_PAGE_HEAD = """# Catalogue of effects

Effects that `stiffopt diagnose` can identify. An effect is located at a joint, a link, a run or the
whole robot (scope). Symbols: motor angle th, speed w, link angle q and velocity v (angles of the
motor through the ratio), spring torque s, drive torque tau, wind-up D(s), and d for motor less link
angle; sg is a sign function smoothed within 0.01 rad/s. All SI. "Needs" are the signals and motions
that a joint's recordings must have; effects listed under "confounded with" are separated only by a
suitable motion; `stiffopt solve --model` plans with those marked "yes". Generated by
`stiffopt.report.catalogue_page`.

| effect | family | scope | equation | signature | needs | confounded with | planned with | source |
|---|---|---|---|---|---|---|---|---|
"""


def catalogue_page(effects: Sequence[Effect] = CATALOGUE) -> str:
    """Return the page as Markdown."""
    return _PAGE_HEAD + "".join(
        f"| {' | '.join(_effect_cells(each, effects))} |\n" for each in effects
    )


def _effect_cells(effect: Effect, effects: Sequence[Effect]) -> tuple[str, ...]:
    return (
        f"`{effect.name}`",
        effect.family,
        effect.scope,
        f"`{effect.equation}`",
        effect.signature,
        ", ".join(NEEDS[need].phrase for need in required_signals(effect)),
        ", ".join(f"`{name}`" for name in confused_with(effect, effects)),
        "yes" if effect.change_robot else "",
        effect.reference,
    )


if __name__ == "__main__":
    print(catalogue_page(), end="")
