"""Registry of everything that can be wrong with the true robot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from .world import World

Where = Literal["joint", "robot", "link", "run", "recording"]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What an effect turned out to be.

    `parameters` mean the same in any model of the effect; `law` are those of the simulated law
    alone. `run` names the recording that an effect of one recording is in.
    """

    parameters: dict[str, float] = field(default_factory=dict)
    law: dict[str, Any] = field(default_factory=dict)
    run: str | None = None


Builder = Callable[[World, int, float, np.random.Generator], Outcome]


@dataclass(frozen=True)
class Entry:
    """`drawn`: in the sealed cases; those of a key stay what they are when laws are added."""

    build: Builder
    where: Where
    family: str
    outside: bool = False
    drawn: bool = True


EFFECTS: dict[str, Entry] = {}


def effect(
    family: str, where: Where = "joint", *, outside: bool = False, drawn: bool = True
) -> Callable[[Builder], Builder]:
    """Register a builder under its function's name."""

    def register(build: Builder) -> Builder:
        EFFECTS[build.__name__] = Entry(build, where, family, outside, drawn)
        return build

    return register


def apply(
    world: World, name: str, joint: int | None, severity: float, rng: np.random.Generator
) -> dict[str, Any]:
    """Change the true robot; the line of the truth that says what was done.

    The joint counts from 1; an effect of the whole robot has none.
    """
    if name not in EFFECTS:
        raise KeyError(f"no effect {name!r}; there are {', '.join(sorted(EFFECTS))}")
    entry = EFFECTS[name]
    placed = entry.where in ("joint", "link", "run")
    if placed != (joint is not None):
        raise ValueError(f"{name} acts on {'a joint' if placed else 'the whole robot'}")
    if joint is not None and not 1 <= joint <= world.robot.joints:
        raise ValueError(f"{world.robot.name} has no joint {joint}")
    index = -1 if joint is None else joint - 1
    outcome = entry.build(world, index, severity, rng)
    return {
        "effect": name,
        "joint": None if entry.where == "link" else joint,
        "link": f"link{joint}" if entry.where == "link" else None,
        "run": outcome.run,
        "severity": severity,
        "family": entry.family,
        "outside": entry.outside,
        "params": outcome.parameters,
        "law": outcome.law,
    }


def spread(rng: np.random.Generator) -> float:
    """Scatter of a size about its severity."""
    return float(rng.uniform(0.9, 1.1))


def sign(rng: np.random.Generator, positive: float = 0.5) -> float:
    return 1.0 if rng.uniform() < positive else -1.0
