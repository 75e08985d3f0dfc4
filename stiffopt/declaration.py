"""Declaration of the fields of files and objects: unit, bounds and description in the annotation.

    diameter: Annotated[Length, POSITIVE, Doc("Diameter of the shaft.")]

declares a length in metres above zero. A frozen dataclass whose fields are declared like this

- is checked in Python: `check_fields(self, owner)` in its `__post_init__`
- is a section of a file: pydantic takes the dataclass itself as the type of a key, reads texts with
  units ("8 mm"), checks the same bounds with the same sentence, and gives the object
- has its keys, units, bounds and sentences in `stiffopt schema` and in the file reference

Conditions on several fields are checked in `__post_init__` after `check_fields`; an `InputError`
raised there is reported with the section's place in the file. `declared(cls)` returns the
declarations, to build a section from a part of an object. This module imports neither pint nor
pydantic: `stiffopt.validation` sets the reader of texts (`Unit.reader`), the catalogue its names
(`Named.tables`).
"""

from __future__ import annotations

import dataclasses
import functools
import math
import types
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from stiffopt.dimensions import DIMENSIONS, PRISMATIC
from stiffopt.errors import InputError, OutOfValidityError, nearest


@dataclass(frozen=True)
class Doc:
    """Description of a field, one sentence."""

    text: str

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> dict[str, Any]:
        return {**handler(core), "description": self.text}


# Keys of a plausible range and of bounds in pydantic's metadata of a quantity; the former also in
# JSON Schema.
_PLAUSIBLE_KEY, _BOUNDS_KEY = "plausible", "bounds"


@dataclass(frozen=True)
class Unit:
    """A number with a unit: an SI float in Python, in files also a text such as "8 mm"."""

    dimension: str  # a name in `DIMENSIONS`
    # Quantity of a joint: for a prismatic one the dimension is that of `PRISMATIC`.
    joint: bool = False
    bare: bool = False  # always in SI, as in recordings: texts with units are rejected
    # Conversion of an entry of a file to an SI number; set by `stiffopt.validation`.
    reader: ClassVar[Callable[[Unit], Callable[[object], float]]]

    @property
    def unit(self) -> str:
        """SI unit, of a revolute joint where it is one of a joint; "1" for a plain ratio."""
        return DIMENSIONS[self.dimension].unit or "1"

    @property
    def plausible(self) -> tuple[float, float]:
        """Plausible magnitudes, of either kind of joint where it is one of a joint."""
        low, high = DIMENSIONS[self.dimension].plausible
        if self.joint:
            other_low, other_high = DIMENSIONS[PRISMATIC[self.dimension]].plausible
            low, high = min(low, other_low), max(high, other_high)
        return low, high

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        # `Bounds` around this marker add themselves, and may bring a range of their own.
        metadata: dict[str, Any] = {_PLAUSIBLE_KEY: self.plausible, _BOUNDS_KEY: []}
        kind = DIMENSIONS[self.dimension]
        read = None if self.bare else Unit.reader(self)

        def read_and_ask(value: Any) -> float:
            number: float = value if read is None else read(value)
            if not isinstance(value, str):
                asked = metadata[_PLAUSIBLE_KEY]
                kind.ask(number, asked, si_only=self.bare, bounds=metadata[_BOUNDS_KEY])
            return number

        if self.bare:
            return core_schema.no_info_after_validator_function(
                read_and_ask, handler(source), metadata=metadata
            )
        return core_schema.no_info_plain_validator_function(read_and_ask, metadata=metadata)

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> dict[str, Any]:
        kind = DIMENSIONS[self.dimension]
        schema: dict[str, Any] = {"type": "number", _PLAUSIBLE_KEY: list(kind.plausible)}
        if not self.bare:
            schema = {"anyOf": [schema, {"type": "string"}]}
        schema["unit"] = self.unit
        if self.joint:
            sliding = DIMENSIONS[PRISMATIC[self.dimension]]
            schema["unit_prismatic"] = sliding.unit
            schema["plausible_prismatic"] = list(sliding.plausible)
        return schema


@dataclass(frozen=True)
class Bounds:
    """Range in which a number must lie."""

    above: float = -math.inf  # excluded
    least: float = -math.inf  # included
    most: float = math.inf  # included
    below: float = math.inf  # excluded
    finite: bool = True  # the number must be finite
    hint: str = ""  # sentence on the usual cause of a violation
    # Magnitudes beyond which a bare number of a file is asked about; default those of its unit.
    plausible: tuple[float, float] | None = None

    def check(self, name: str, value: object) -> None:
        """Raise `InputError` unless every number in `value` lies within the bounds."""
        for number in _iterate_numbers(value):
            if not self.contains(number):
                self._raise_out_of_bounds(name, number)

    def contains(self, number: float) -> bool:
        """Return whether a number lies within the bounds."""
        low = self.above < number and self.least <= number
        high = number <= self.most and (number < self.below or self.below == math.inf)
        return low and high and (math.isfinite(number) or not self.finite)

    def _raise_out_of_bounds(self, name: str, number: float) -> None:
        if math.isfinite(self.above) and math.isfinite(self.below):
            hint = "Both bounds are excluded."
            raise OutOfValidityError(name, number, self.above, self.below, hint)
        words = [
            f"{word} {bound:g}" if word != "or above" else f"{bound:g} {word}"
            for word, bound in (
                ("above", self.above),
                ("or above", self.least),
                ("below", self.below),
                ("at most", self.most),
            )
            if math.isfinite(bound)
        ]
        comma = "," if math.isfinite(self.least) else ""
        kind = "a finite number" if self.finite else "a number"
        raise InputError(
            f"{name} = {number:g} cannot be used; allowed is {kind}{comma} "
            f"{' and '.join(words)}. Correct {name.rpartition(' ')[2]}"
            f"{'' if isinstance(number, int) else ' (SI units)'}.{self.hint and ' ' + self.hint}"
        )

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        def check(value: Any, info: Any) -> Any:
            self.check(info.field_name or "value", value)
            return value

        inside = handler(source)
        for metadata in _quantity_metadata(inside):
            metadata[_BOUNDS_KEY].append(self)
            metadata[_PLAUSIBLE_KEY] = self.plausible or metadata[_PLAUSIBLE_KEY]
        return core_schema.with_info_after_validator_function(check, inside)

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> dict[str, Any]:
        words = {
            "exclusiveMinimum": self.above,
            "minimum": self.least,
            "maximum": self.most,
            "exclusiveMaximum": self.below,
        }
        limits: dict[str, Any] = {
            word: bound for word, bound in words.items() if math.isfinite(bound)
        }
        if self.plausible is not None:
            limits[_PLAUSIBLE_KEY] = list(self.plausible)
        return _add_limits(handler(core), limits)


def _quantity_metadata(schema: Any) -> Iterator[dict[str, Any]]:
    """Metadata of every quantity in a schema of pydantic's core."""
    if isinstance(schema, dict):
        if _PLAUSIBLE_KEY in schema.get("metadata", ()):
            yield schema["metadata"]
        for word in ("schema", "items_schema", "values_schema", "choices"):
            yield from _quantity_metadata(schema.get(word))
    elif isinstance(schema, list | tuple):
        for form in schema:
            yield from _quantity_metadata(form)


def _add_limits(schema: dict[str, Any], limits: dict[str, Any]) -> dict[str, Any]:
    """Add the limits to every numeric alternative of a JSON schema."""
    if schema.get("type") in ("number", "integer"):
        return {**schema, **limits}
    deeper: dict[str, Any] = {}
    if "anyOf" in schema:
        deeper["anyOf"] = [_add_limits(form, limits) for form in schema["anyOf"]]
    for word in ("items", "additionalProperties"):
        if isinstance(schema.get(word), dict):
            deeper[word] = _add_limits(schema[word], limits)
    if "prefixItems" in schema:
        deeper["prefixItems"] = [_add_limits(item, limits) for item in schema["prefixItems"]]
    return {**schema, **deeper}


@dataclass(frozen=True)
class Named:
    """Name of an entry of the catalogue; `table` is the kind of entry.

    Python objects look the name up when they use it; files are checked when they are read.
    """

    table: str
    # Names by kind of entry; filled by the catalogue.
    tables: ClassVar[dict[str, Callable[[], Iterable[str]]]] = {}

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        def check(value: Any) -> Any:
            names = list(Named.tables[self.table]())
            if value is not None and value not in names:
                raise InputError(
                    f"no {self.table} {value!r} in the catalogue. {nearest(value, names)}"
                )
            return value

        return core_schema.no_info_after_validator_function(check, handler(source))

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> dict[str, Any]:
        return {**handler(core), "examples": list(Named.tables[self.table]())}


POSITIVE = Bounds(above=0.0)
# Length of a machine part [m]; larger numbers are usually millimetres without a unit.
PART = Bounds(
    above=0.0,
    most=3.0,
    hint='A bare number is in m: write a text such as "63 mm".',
    plausible=(1e-5, 1.5),
)
# Length of a bolt or a detail of a part: teeth, keys, threads [m].
DETAIL = dataclasses.replace(PART, plausible=(1e-5, 0.5))
# Roughness of a technical surface [m].
ROUGHNESS = Bounds(above=0.0, most=1e-2, plausible=(1e-9, 1e-3))
# Young's modulus, shear modulus or hardness, from rubber to diamond [Pa].
MODULUS = Bounds(above=0.0, plausible=(1e5, 2e12))
# Coefficient of friction.
FRICTION = Bounds(
    above=0.0,
    most=5.0,
    hint="Metals have 0.05 to 0.3, rubber up to 1.5.",
    plausible=(0.005, 1.5),
)
NOT_NEGATIVE = Bounds(least=0.0)
FRACTION = Bounds(above=0.0, most=1.0)

Length = Annotated[float, Unit("length")]
Angle = Annotated[float, Unit("angle")]
Mass = Annotated[float, Unit("mass")]
Inertia = Annotated[float, Unit("inertia")]
Force = Annotated[float, Unit("force")]
Torque = Annotated[float, Unit("torque")]
ForcePerSpeed = Annotated[float, Unit("linear viscous friction")]
Energy = Annotated[float, Unit("energy")]
Time = Annotated[float, Unit("time")]
Frequency = Annotated[float, Unit("frequency")]
Pressure = Annotated[float, Unit("pressure")]
Area = Annotated[float, Unit("area")]
Speed = Annotated[float, Unit("speed")]
AngularVelocity = Annotated[float, Unit("angular velocity")]
Stiffness = Annotated[float, Unit("stiffness")]
LinearStiffness = Annotated[float, Unit("linear stiffness")]
WidthStiffness = Annotated[float, Unit("stiffness per width")]
TemperatureDifference = Annotated[float, Unit("temperature difference")]
Ratio = Annotated[float, Unit("ratio")]

# Quantities of joints that are revolute or prismatic; resolved by `stiffopt.units.fit_joint`.
JointPosition = Annotated[float, Unit("angle", joint=True)]
JointVelocity = Annotated[float, Unit("angular velocity", joint=True)]
JointAcceleration = Annotated[float, Unit("angular acceleration", joint=True)]
JointJerk = Annotated[float, Unit("angular jerk", joint=True)]
JointTorque = Annotated[float, Unit("torque", joint=True)]
JointStiffness = Annotated[float, Unit("stiffness", joint=True)]
JointInertia = Annotated[float, Unit("inertia", joint=True)]
JointViscous = Annotated[float, Unit("viscous friction", joint=True)]


@dataclass(frozen=True)
class Declared:
    """One declared field: its annotation with all markers, and its default (MISSING: required)."""

    annotation: Any
    default: Any
    default_factory: Any

    @property
    def required(self) -> bool:
        """Return whether the field has no default."""
        missing = dataclasses.MISSING
        return self.default is missing and self.default_factory is missing


@functools.cache
def _type_hints(cls: type) -> Mapping[str, Any]:
    """Annotations of a class with their markers."""
    return typing.get_type_hints(cls, include_extras=True)


@functools.cache
def declared(cls: type) -> Mapping[str, Declared]:
    """Fields of a dataclass that have a `Doc`, by name."""
    hints = _type_hints(cls)
    return {
        field.name: Declared(hints[field.name], field.default, field.default_factory)
        for field in dataclasses.fields(cls)
        if any(isinstance(m, Doc) for m in getattr(hints[field.name], "__metadata__", ()))
    }


def unit(cls: type, name: str) -> Unit:
    """Unit of a field of a dataclass or a section."""
    parts = _annotation_parts(_type_hints(cls)[name])
    return next(part for part in parts if isinstance(part, Unit))


def bounds(cls: type, name: str) -> Bounds:
    """Bounds of a field of a dataclass or a section."""
    parts = _annotation_parts(_type_hints(cls)[name])
    return next(part for part in parts if isinstance(part, Bounds))


def check_fields(
    instance: Any, owner: str = "", error: Callable[[str], InputError] = InputError
) -> None:
    """Raise `error` for a field outside its bounds or allowed words; `owner` begins the message."""
    try:
        _check_fields(instance, owner)
    except InputError as refused:
        if error is InputError:
            raise
        raise error(str(refused)) from refused


def _check_fields(instance: Any, owner: str) -> None:
    place = f"{owner}: " if owner else ""
    for name, limits, words in _field_checks(instance.__class__):
        value = getattr(instance, name)
        for limit in limits:
            limit.check(f"{place}{name}", value)
        if words and isinstance(value, str) and value not in words:
            raise InputError(f"{place}{name} = {value!r} is not known. {nearest(value, words)}")


@functools.cache
def _field_checks(cls: type) -> tuple[tuple[str, tuple[Bounds, ...], tuple[str, ...]], ...]:
    """Name, bounds and allowed words of the fields that have any."""
    found = []
    hints = typing.get_type_hints(cls, include_extras=True)
    for name in (field.name for field in dataclasses.fields(cls)):
        parts = list(_annotation_parts(hints[name]))
        limits = tuple(part for part in parts if isinstance(part, Bounds))
        words = tuple(part for part in parts if isinstance(part, str))
        if limits or words:
            found.append((name, limits, words))
    return tuple(found)


def _annotation_parts(annotation: Any) -> Iterator[Any]:
    """Markers and allowed words anywhere in an annotation."""
    yield from getattr(annotation, "__metadata__", ())
    origin = typing.get_origin(annotation)
    if origin is typing.Literal:
        yield from typing.get_args(annotation)
    elif origin is Annotated:
        yield from _annotation_parts(typing.get_args(annotation)[0])
    elif origin in (typing.Union, types.UnionType):
        for form in typing.get_args(annotation):
            yield from _annotation_parts(form)
    elif origin is not None:
        # Entries of a tuple, a list or a mapping share the bounds of their type.
        for form in typing.get_args(annotation):
            yield from _annotation_parts(form)


def _iterate_numbers(value: Any) -> Iterator[float]:
    if isinstance(value, bool) or value is None or isinstance(value, str):
        return
    if isinstance(value, Mapping):
        value = list(value.values())
    if isinstance(value, Sequence):
        for entry in value:
            yield from _iterate_numbers(entry)
    elif hasattr(value, "flat"):
        yield from (float(entry) for entry in value.flat)
    else:
        yield value
