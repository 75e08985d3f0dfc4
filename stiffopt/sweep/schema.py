"""Schema of a sweep file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, field_validator, model_validator

from stiffopt.declaration import Bounds, Doc
from stiffopt.validation import Section

# Largest number of cases; more are an input error.
MAX_CASES = 100_000


class RangeSection(Section):
    """Range between two bounds; texts have the same unit."""

    lower: Annotated[float | str, Doc("Least value.")]
    upper: Annotated[float | str, Doc("Largest value.")]


class HypercubeSection(Section):
    """Latin hypercube: every other key is an entry of the base file, with { lower, upper }."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, RangeSection]

    count: Annotated[int, Bounds(least=1, most=MAX_CASES), Doc("Number of points.")]
    seed: Annotated[int, Bounds(least=0), Doc("Random seed.")] = 1

    @property
    def ranges(self) -> dict[str, RangeSection]:
        """Range of each entry."""
        return dict(self.__pydantic_extra__)


class FrontSection(Section):
    """Trade-off front of one entry and the objective, on a grid, with its knee."""

    over: Annotated[str, Doc("Entry of the base file, such as motion.duration.")]
    lower: Annotated[float | str, Doc("Least value; a text has the unit of `upper`.")]
    upper: Annotated[float | str, Doc("Largest value.")]
    points: Annotated[int, Bounds(least=3, most=1000), Doc("Number of values.")] = 9


class SweepFile(Section):
    """Sweep file. All combinations of its axes (front, grid, lists, hypercube) are cases."""

    schema_: Annotated[int, Field(alias="schema"), Doc("Version of the file format, 1.")]
    kind: Annotated[Literal["sweep"], Doc("Kind of file.")]
    title: Annotated[str, Doc("Heading of the report; default the file's name.")] = ""
    base: Annotated[
        str | list[str],
        Doc(
            "Trajectory problem, preload study or recording set to vary, relative to this file; "
            "several form an axis."
        ),
    ]
    grid: Annotated[
        dict[str, list[Any]],
        Doc("Values by entry of the base file, named as in --set; all combinations."),
    ] = Field(default_factory=dict)
    lists: Annotated[
        dict[str, list[Any]],
        Doc("Values by entry that vary together: the first of each, the second of each, .."),
    ] = Field(default_factory=dict)
    latin_hypercube: Annotated[HypercubeSection | None, Doc("Points spread over ranges.")] = None
    front: Annotated[FrontSection | None, Doc("Trade-off front with its knee.")] = None
    starts: Annotated[
        int,
        Bounds(least=1, most=1000),
        Doc("Initial guesses of each case; those after the first are random smooth detours."),
    ] = 1
    baselines: Annotated[
        bool, Doc("Compare each motion with its baselines, which takes longer.")
    ] = False

    @field_validator("grid", "lists", mode="before")
    @classmethod
    def _flatten_axes(cls, value: object) -> object:
        """Flatten nested tables: TOML reads `motion.duration` without quotes as such."""
        return dict(_flatten_tables(value)) if isinstance(value, Mapping) else value

    @field_validator("latin_hypercube", mode="before")
    @classmethod
    def _flatten_ranges(cls, value: object) -> object:
        return dict(_flatten_tables(value)) if isinstance(value, Mapping) else value

    @model_validator(mode="after")
    def _check_axes(self) -> SweepFile:
        empty = [key for key, values in (self.grid | self.lists).items() if not values]
        if empty:
            raise ValueError(f"{empty[0]} has no value; give at least one")
        if len({len(values) for values in self.lists.values()}) > 1:
            counts = ", ".join(f"{key}: {len(values)}" for key, values in self.lists.items())
            raise ValueError(f"the lists of [lists] vary together and differ in length ({counts})")
        places = [*self.grid, *self.lists]
        places += self.latin_hypercube.ranges if self.latin_hypercube else ()
        places += [self.front.over] if self.front else ()
        twice = {place for place in places if places.count(place) > 1}
        if twice:
            raise ValueError(f"{min(twice)} is in two axes; keep one")
        return self


def _flatten_tables(table: Mapping[str, Any], where: str = "") -> list[tuple[str, Any]]:
    """Entries of nested tables by dotted key; ranges are values."""
    found: list[tuple[str, Any]] = []
    for key, value in table.items():
        place = f"{where}.{key}" if where else str(key)
        if isinstance(value, Mapping) and not {"lower", "upper"} & set(value):
            found += _flatten_tables(value, place)
        else:
            found.append((place, value))
    return found
