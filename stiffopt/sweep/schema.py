"""Schema of a sweep file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, field_validator, model_validator

from stiffopt.declaration import Bounds, Doc
from stiffopt.validation import Section

# More cases than this are a slip of the pen.
MAX_CASES = 100_000


class RangeSection(Section):
    """Values between two bounds; texts carry the same unit."""

    lower: Annotated[float | str, Doc("Least value.")]
    upper: Annotated[float | str, Doc("Largest value.")]


class HypercubeSection(Section):
    """A Latin hypercube: every other key is a place in the base file, with { lower, upper }."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, RangeSection]

    count: Annotated[int, Bounds(least=1, most=MAX_CASES), Doc("Number of points.")]
    seed: Annotated[int, Bounds(least=0), Doc("Of the random numbers.")] = 1

    @property
    def ranges(self) -> dict[str, RangeSection]:
        """Range of each place."""
        return dict(self.__pydantic_extra__)


class FrontSection(Section):
    """Trade-off between one entry and the objective: a grid over it, its knee marked."""

    over: Annotated[str, Doc("Place in the base file, such as motion.duration.")]
    lower: Annotated[float | str, Doc("Least value; a text carries the unit of `upper`.")]
    upper: Annotated[float | str, Doc("Largest value.")]
    points: Annotated[int, Bounds(least=3, most=1000), Doc("Number of values.")] = 9


class SweepFile(Section):
    """A whole sweep file. Its axes (front, grid, lists, hypercube) are combined, each with each."""

    schema_: Annotated[int, Field(alias="schema"), Doc("Version of the file format, 1.")]
    kind: Annotated[Literal["sweep"], Doc("Says that the file is a sweep.")]
    title: Annotated[str, Doc("Heading of the report; default the file's name.")] = ""
    base: Annotated[
        str | list[str],
        Doc(
            "Trajectory problem, preload study or recording set that is varied, relative to this "
            "file; several are an axis of their own."
        ),
    ]
    grid: Annotated[
        dict[str, list[Any]],
        Doc("Values by place in the base file, as --set has it; all combinations."),
    ] = Field(default_factory=dict)
    lists: Annotated[
        dict[str, list[Any]],
        Doc("Values by place that go together: the first of each, the second of each, .."),
    ] = Field(default_factory=dict)
    latin_hypercube: Annotated[HypercubeSection | None, Doc("Points spread over ranges.")] = None
    front: Annotated[FrontSection | None, Doc("Trade-off front with its knee.")] = None
    starts: Annotated[
        int,
        Bounds(least=1, most=1000),
        Doc("Starts of each case; those after the first begin with a random smooth detour."),
    ] = 1
    baselines: Annotated[
        bool, Doc("Whether each motion is compared with its baselines, which takes longer.")
    ] = False

    @field_validator("grid", "lists", mode="before")
    @classmethod
    def _flatten_axes(cls, value: object) -> object:
        """`motion.duration` may be written without quotes, which TOML reads as nested tables."""
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
            told = ", ".join(f"{key}: {len(values)}" for key, values in self.lists.items())
            raise ValueError(f"the values of [lists] go together and differ in number ({told})")
        places = [*self.grid, *self.lists]
        places += self.latin_hypercube.ranges if self.latin_hypercube else ()
        places += [self.front.over] if self.front else ()
        twice = {place for place in places if places.count(place) > 1}
        if twice:
            raise ValueError(f"{min(twice)} stands in two axes; keep one")
        return self


def _flatten_tables(table: Mapping[str, Any], where: str = "") -> list[tuple[str, Any]]:
    """Entries of nested tables by dotted key; a range is no table."""
    found: list[tuple[str, Any]] = []
    for key, value in table.items():
        place = f"{where}.{key}" if where else str(key)
        if isinstance(value, Mapping) and not {"lower", "upper"} & set(value):
            found += _flatten_tables(value, place)
        else:
            found.append((place, value))
    return found
