"""Which cases a suite consists of: every choice follows from the key."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from benchmarks.simulator import EFFECTS, ROBOTS

from .key import Key

T = TypeVar("T")

# `arms` and `armsnone` repeat `main` and `none` on machines that nothing was developed on.
SUITES = ("main", "none", "sweep", "arms", "armsnone")
SECONDS, RATE, SUBSTEPS = 5.0, 250.0, 8  # integrated at 2 kHz
KINDS = ("single",) * 15 + ("outside",) * 3 + ("pair",) * 2
SEVERITIES = (0.35, 0.7, 1.0, 1.0, 1.0, 1.5, 1.5, 1.5, 3.0, 3.0)
SWEPT = (0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0)
FURTHER_ARMS = (("rv6", 1 / 3), ("scara4", 1 / 3), ("arm7", 1 / 3))
ROBOT_SHARES = {
    "main": (("small3", 0.6), ("arm6", 0.25), ("big6", 0.15)),
    "none": (("planar2", 0.4), ("small3", 0.45), ("arm6", 0.15)),
    "sweep": (("small3", 1.0),),
    "arms": FURTHER_ARMS,
    "armsnone": FURTHER_ARMS,
}
WITHOUT_LINK_ENCODERS = 0.15

CATALOGUE = tuple(
    sorted(name for name, entry in EFFECTS.items() if entry.drawn and not entry.outside)
)
LAWS = tuple(sorted(name for name, entry in EFFECTS.items() if entry.family == "law"))
OUTSIDE = tuple(sorted(name for name, entry in EFFECTS.items() if entry.drawn and entry.outside))
INVISIBLE_TO_MOTORS = frozenset({"encoder_offset", "encoder_zero_change", "encoder_skew"})


@dataclass(frozen=True, kw_only=True)
class Plan:
    """A case before anything of it is computed.

    Parameters
    ----------
    effects : tuple of tuple of str
        For each effect that is to be missing, the order in which effects are tried.
    severity : float
        In units of what the oracle sees; 0 with nothing missing.
    """

    name: str
    suite: str
    kind: str
    robot: str
    seed: int
    link_encoders: bool
    effects: tuple[tuple[str, ...], ...]
    severity: float

    def joints(self, key: Key, effect: str) -> list[int | None]:
        """Where an effect can be, in the order in which places are tried."""
        return places_of(key, self.robot, self.name, effect)


def places_of(key: Key, robot: str, name: str, effect: str) -> list[int | None]:
    """Joints of a case's robot that an effect can be at, in the order in which they are tried."""
    if EFFECTS[effect].where in ("robot", "recording"):
        return [None]
    arm = ROBOTS[robot]
    places: Sequence[int | None] = range(1, arm.joints + 1)
    if effect == "wrist_coupling":  # of the joint before it
        places = places[1:]
    if effect == "inertial_error":  # one of the last link is a payload, by another name
        places = places[:-1]
    if effect == "belt_creep":
        places = [j for j in range(1, arm.joints + 1) if "belt" in arm.connections[j - 1]]
    return key.shuffled(places, name, "joint", effect)


def case_names(suite: str, count: int) -> list[str]:
    return [f"{suite}_{index:04d}" for index in range(count)]


def plan(key: Key, name: str) -> Plan:
    """The plan of a case, whatever else is in its suite."""
    suite, _, number = name.partition("_")
    index, draw = int(number), key.draw(name)
    kind = _kind(key, suite, index)
    link_encoders = suite == "sweep" or bool(draw.uniform() >= WITHOUT_LINK_ENCODERS)
    robots, shares = zip(*ROBOT_SHARES[suite], strict=True)
    robot, seed = str(draw.choice(robots, p=shares)), int(draw.integers(2**62))
    effects: list[tuple[str, ...]] = []
    severity = 0.0
    if kind != "none":
        pool = OUTSIDE if kind == "outside" else CATALOGUE
        # How many of its kind came before: so that every effect has its turn.
        turn = sum(_kind(key, suite, i) == kind for i in range(index))
        for member in range(2 if kind == "pair" else 1):
            first = dealt(key, pool, turn, suite, kind, "effect", member)
            rest = key.shuffled(pool, name, "next", member)
            effects.append((first, *(e for e in rest if e != first)))
        sizes = SWEPT if suite == "sweep" else SEVERITIES
        severity = dealt(key, sizes, turn, suite, kind, "severity")
    if not link_encoders:
        effects = [tuple(e for e in order if e not in INVISIBLE_TO_MOTORS) for order in effects]
    return Plan(
        name=name,
        suite=suite,
        kind=kind,
        robot=robot,
        seed=seed,
        link_encoders=link_encoders,
        effects=tuple(effects),
        severity=severity,
    )


def _kind(key: Key, suite: str, index: int) -> str:
    if suite in ("main", "arms"):
        return dealt(key, KINDS, index, suite, "kind")
    return "single" if suite == "sweep" else "none"


def dealt(key: Key, items: Sequence[T], index: int, *purpose: str | int) -> T:
    """Items in turn, each round in an order of its own."""
    turn, place = divmod(index, len(items))
    return key.shuffled(items, *purpose, turn)[place]
