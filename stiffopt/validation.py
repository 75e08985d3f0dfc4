"""Validation of file content by sections; all faults in one message, with their places."""

from __future__ import annotations

import dataclasses
import json
import re
import types
import typing
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from stiffopt.declaration import Doc, Unit
from stiffopt.errors import InputError, InputFileError, nearest, shortened
from stiffopt.units import entry_reader

Model = TypeVar("Model", bound=BaseModel)

# Texts with units become SI numbers when files are validated.
Unit.reader = entry_reader

# Faults that one message lists.
_MAX_LISTED_FAULTS = 30
# pydantic errors that only state that a value does not have this form.
_FORM_ERRORS = (
    "model_type",
    "dataclass_type",
    "list_type",
    "dict_type",
    "literal_error",
    "tuple_type",
)


class Section(BaseModel):
    """Base of every file section: unknown keys are errors, instances are immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)


def validate(model: type[Model], data: Mapping[str, Any], path: object) -> Model:
    """Validate data as an instance of `model`.

    Raises `InputFileError`: all faults in one message, the first with its dotted key.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        errors = error.errors(include_url=False)
    faults = _collect_faults(model, data, errors[:_MAX_LISTED_FAULTS])
    where, reason = faults[0]
    more = "".join(f"\nAlso {place}: {text}" for place, text in faults[1:])
    if len(errors) > _MAX_LISTED_FAULTS:
        more += f"\nAnd {len(errors) - _MAX_LISTED_FAULTS} more."
    raise InputFileError(path, where, reason + more)


def dotted(data: object, location: Sequence[str | int]) -> str:
    """Dotted key of a place in `data`; list items by their name if they have one, else from 1.

    >>> dotted({"joint": [{"name": "j1", "ratio": 1}, {}]}, ("joint", 0, "ratio"))
    'joint[j1].ratio'
    >>> dotted({"joint": [{"name": "j1", "ratio": 1}, {}]}, ("joint", 1, "ratio"))
    'joint[2].ratio'
    """
    text = ""
    for part in location:
        if isinstance(part, int) and not isinstance(data, Mapping):
            item = data[part] if isinstance(data, list | tuple) and part < len(data) else None
            name = item.get("name") if isinstance(item, dict) else None
            text += f"[{name}]" if isinstance(name, str) else f"[{part + 1}]"
            data = item
            continue
        if isinstance(data, Mapping):
            if part not in data and data.get("type") == part:
                continue  # pydantic's tag of a union, not a key of the file
            data = data.get(part)
        text += f".{part}" if text else str(part)
    return text


def _collect_faults(model: type[BaseModel], data: Any, errors: list[Any]) -> list[tuple[str, str]]:
    """Place and text of every error; of a key with several forms only the best match."""
    keys = [_error_keys(data, error) for error in errors]
    faults = []
    for error, own in zip(errors, keys, strict=True):
        rivals = [
            (other, place)
            for other, place in zip(errors, keys, strict=True)
            if other is not error and place[: len(own)] == own
        ]
        deeper = any(len(place) > len(own) for _, place in rivals)
        form = error["type"] in _FORM_ERRORS
        if deeper or (form and any(other["type"] not in _FORM_ERRORS for other, _ in rivals)):
            continue
        fault = _describe_fault(model, dotted(data, own), error)
        if fault not in faults:
            faults.append(fault)
    return faults


def _error_keys(data: Any, error: Any) -> tuple[str | int, ...]:
    """Location of an error without the names that pydantic adds for union members."""
    keys: list[str | int] = []
    last = len(error["loc"]) - 1
    for number, part in enumerate(error["loc"]):
        if isinstance(data, list | tuple):
            held = isinstance(part, int) and part < len(data)
        else:
            held = isinstance(data, Mapping) and part in data
        if held:
            data = data[part]
        elif not (number == last and error["type"] == "missing"):
            continue
        keys.append(part)
    return tuple(keys)


def _describe_fault(model: type[BaseModel], where: str, error: Any) -> tuple[str, str]:
    kind, given = error["type"], error.get("input")
    if kind in ("extra_forbidden", "unexpected_keyword_argument"):
        allowed = _allowed_keys(model, error["loc"][:-1])
        return (
            where,
            f"unknown key {shortened(error['loc'][-1])}. {nearest(error['loc'][-1], allowed)}",
        )
    if kind == "missing" and isinstance(error["loc"][-1], int):
        return where, "this entry of the list is required and missing."
    if kind == "missing":
        meaning = _describe_key(model, error["loc"])
        return where, f"this key is required and missing{f': {meaning}' if meaning else '.'}"
    if kind == "union_tag_not_found":
        return where, f"the key {error['ctx']['discriminator']} is required and missing."
    if kind == "union_tag_invalid":
        context = error["ctx"]
        allowed = re.findall(r"'([^']*)'", context["expected_tags"])
        key = context["discriminator"].strip("'")
        return (
            f"{where}.{key}",
            f"unknown {key} {shortened(context['tag'])}. {nearest(context['tag'], allowed)}",
        )
    if kind == "literal_error":
        allowed = re.findall(r"'([^']*)'", error["ctx"]["expected"])
        if allowed:
            return where, f"got {shortened(given)}. {nearest(str(given), allowed)}"
    if kind in ("model_type", "dataclass_type", "model_attributes_type"):
        inside = ", ".join(_allowed_keys(model, error["loc"]))
        keys = f" Its keys: {inside}." if inside else ""
        example = _section_example(model, error["loc"], where, given)
        return (
            where,
            f"needs a section with keys of its own, got {shortened(given)}.{keys}{example}",
        )
    if kind == "value_error":
        cause = error["ctx"]["error"]
        if isinstance(cause, InputError):
            return where, str(cause)
        if isinstance(given, Mapping):
            return where, f"{cause}."
    return where, f"{error['msg']}, got {shortened(given)}."


def _allowed_keys(model: Any, location: Sequence[str | int]) -> list[str]:
    """Names of the keys allowed at `location` inside `model`."""
    for part in location:
        model = _inner_annotation(model, part)
    for candidate in _union_members(model):
        keys = _key_annotations(candidate)
        if keys:
            return list(keys)
    return []


def _section_example(model: Any, location: Sequence[str | int], where: str, given: object) -> str:
    """Return what to write for a value that stands in place of a section, "" where it is unclear.

    The value belongs to the one key that the section requires.
    """
    for part in location:
        model = _inner_annotation(model, part)
    for candidate in _union_members(model):
        fields = getattr(candidate, "model_fields", {}).items()
        required = [(name, field.annotation) for name, field in fields if field.is_required()]
        if len(required) == 1 and type(given) in _union_members(required[0][1]):
            return f" Write {required[0][0]} = {json.dumps(given)} in a section [{where}]."
    return ""


def _describe_key(model: Any, location: Sequence[str | int]) -> str:
    """Return the description of the key at `location` inside `model`, or ""."""
    *above, key = location
    for part in above:
        model = _inner_annotation(model, part)
    for candidate in _union_members(model):
        field = getattr(candidate, "model_fields", {}).get(key)
        for note in () if field is None else field.metadata:
            if isinstance(note, Doc):
                return note.text
    return ""


def _key_annotations(section: Any) -> dict[str, Any]:
    """Annotations by key of a section: a pydantic model, or a dataclass."""
    if not isinstance(section, type):
        return {}
    if issubclass(section, BaseModel):
        return {
            field.alias or name: field.annotation for name, field in section.model_fields.items()
        }
    return typing.get_type_hints(section) if dataclasses.is_dataclass(section) else {}


def _inner_annotation(annotation: Any, part: str | int) -> Any:
    for member in _union_members(annotation):
        keys = _key_annotations(member)
        if keys:
            if part in keys:
                return keys[str(part)]
            if part in typing.get_args(keys.get("type")) or part == member.__name__:
                return member
            if "__pydantic_extra__" in member.__annotations__:
                # Value type of the keys that the user may choose.
                return typing.get_args(typing.get_type_hints(member)["__pydantic_extra__"])[1]
        elif isinstance(part, int) and typing.get_origin(member) in (list, tuple):
            return typing.get_args(member)[0]
        elif typing.get_origin(member) is dict:
            return typing.get_args(member)[1]
    return None


def _union_members(annotation: Any) -> list[Any]:
    """Flat list of the types of an annotation, through Annotated and unions."""
    origin = typing.get_origin(annotation)
    if origin is typing.Annotated:
        return _union_members(typing.get_args(annotation)[0])
    if origin in (typing.Union, types.UnionType):
        return [m for a in typing.get_args(annotation) for m in _union_members(a)]
    return [annotation]
