"""Plug-in registry: every module of a package adds its kinds, found by name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module
from pkgutil import iter_modules
from typing import Protocol, TypeVar


class HasName(Protocol):
    """Entry of a registry."""

    @property
    def name(self) -> str:
        """Key in files and results."""


Kind = TypeVar("Kind", bound=HasName)


class Registry(Mapping[str, Kind]):
    """Kinds by name, in alphabetical order.

    `package`: package whose modules are imported on first access; each calls `add`.
    """

    def __init__(self, package: str) -> None:
        self._package = package
        self._kinds: dict[str, Kind] = {}
        self._loaded = False

    def add(self, kind: Kind) -> None:
        """Register a kind."""
        self._kinds[kind.name] = kind

    def discard(self, name: str) -> None:
        """Remove a kind."""
        self._kinds.pop(name, None)

    def _load_kinds(self) -> dict[str, Kind]:
        if not self._loaded:
            self._loaded = True
            package = import_module(self._package)
            for module in iter_modules(package.__path__):
                import_module(f"{self._package}.{module.name}")
        return self._kinds

    def __getitem__(self, name: str) -> Kind:
        return self._load_kinds()[name]

    def __iter__(self) -> Iterator[str]:
        # Sorted: the order does not depend on which module was imported first.
        return iter(sorted(self._load_kinds()))

    def __len__(self) -> int:
        return len(self._load_kinds())
