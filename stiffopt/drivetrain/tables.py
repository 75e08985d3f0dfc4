"""Packaged tables: rows with provenance, looked up by name, user entries first."""

from __future__ import annotations

import functools
import re
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from importlib import resources
from types import MappingProxyType
from typing import Any

from stiffopt.errors import InputError, nearest


@dataclass(frozen=True, kw_only=True)
class Entry:
    """Name and provenance of a catalogue entry."""

    name: str
    provenance: str
    source: str
    estimated: tuple[str, ...] = ()


@functools.cache
def read_table(name: str) -> dict[str, Any]:
    """Return one file of the packaged data."""
    text = (
        resources.files("stiffopt.drivetrain").joinpath("data", f"{name}.toml").read_text("utf-8")
    )
    return tomllib.loads(text)


def source_text(table: Mapping[str, Any], text: str) -> str:
    """Return the source with the short names of the file's [sources] written out."""
    for short, full in table.get("sources", {}).items():
        text = re.sub(rf"\b{short}\b", full, text)
    return text


def _find_entry(table: Mapping[str, Any], row: Mapping[str, Any]) -> dict[str, Any]:
    return {
        **row,
        "source": source_text(table, row["source"]),
        "estimated": tuple(row.get("estimated", ())),
    }


# User entries by kind ("bolt", "reducer", ...) and name.
OwnEntries = Mapping[str, Mapping[str, Any]]
_USER_ENTRIES: ContextVar[OwnEntries] = ContextVar("own entries", default=MappingProxyType({}))


@contextmanager
def with_own(entries: OwnEntries) -> Iterator[None]:
    """Give user entries precedence over packaged ones within the context."""
    token = _USER_ENTRIES.set(entries)
    try:
        yield
    finally:
        _USER_ENTRIES.reset(token)


def own_entries(kind: str) -> Mapping[str, Any]:
    """Return the user entries of a kind; the source defaults to "own catalogue"."""
    found = _USER_ENTRIES.get().get(kind, {})
    return {
        name: {**row, "source": row.get("source") or "own catalogue"} for name, row in found.items()
    }


def rows(table_name: str, list_name: str, key: str) -> dict[str, dict[str, Any]]:
    """Return the rows of one list of a file by the value of `key`, user entries first."""
    own, packaged = own_entries(list_name), _load_packaged(table_name, list_name, key)
    return {**own, **{name: row for name, row in packaged.items() if name not in own}}


@functools.cache
def _load_packaged(table_name: str, list_name: str, key: str) -> dict[str, dict[str, Any]]:
    table = read_table(table_name)
    return {row[key]: _find_entry(table, row) for row in table[list_name]}


def find(kind: str, name: str, known: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    """Return a row by name, or raise `InputError` with the nearest name."""
    if name not in known:
        raise InputError(f"no {kind} {name!r} in the catalogue. {nearest(name, known)}")
    return known[name]
