"""What is hidden where: every choice follows from the key, nobody chooses anything by hand."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.blind.key import Key

from .hide import KINDS, Kind
from .motion import PublicSet

SIZES = (1.0, 2.0, 4.0, 8.0)
# How often a set is drawn: those that take minutes less often.
WEIGHTS = {
    "airbot": 1, "dfki_a0815": 2, "emps": 1, "kuka_kr300": 2, "panda_gaz": 1, "tx40_first": 1,
    "unisa_ur10": 3, "ur10e": 1,
}  # fmt: skip
# Factors on a nominal stiffness, which has no multiples.
FACTORS = (0.5, 2.0)
# How often a case is drawn at most, for one that is no repeat of another.
DRAWS = 12


@dataclass(frozen=True, kw_only=True)
class Plan:
    """One concealment, or a control.

    Parameters
    ----------
    name : str
    source : str
        Name of the set.
    kind : Kind or None
        None where nothing is hidden: the training runs lose a little of their beginning.
    joints : tuple of int
        From 0: the one drawn, then those that are taken in its place.
    size : float
        Times the residual that the answer without the concealment leaves on runs left out, in the
        torque where it is largest; a factor of a stiffness; a share for controls.
    sign : float
    """

    name: str
    source: str
    kind: Kind | None
    joints: tuple[int, ...]
    size: float
    sign: float


def plans(
    key: Key, sets: dict[str, PublicSet], hidden: int, controls: int
) -> list[tuple[Plan, ...]]:
    """All of a run, controls between the others: of each the one drawn, then those in its place.

    Some kinds have little choice; what repeats another case is drawn again.
    """
    kinds: list[Kind] = []
    sizes: list[float] = []
    possible = [k for k in KINDS if not k.sets or set(k.sets) & set(sets)]
    while len(kinds) < hidden:
        kinds += key.shuffled(possible, "real", "kinds", len(kinds))
        sizes += key.shuffled(SIZES * 4, "real", "sizes", len(sizes))
    found = [
        tuple(_drawn(key, sets, number, kind, size, again) for again in range(DRAWS))
        for number, (kind, size) in enumerate(zip(kinds[:hidden], sizes, strict=False), start=1)
    ]
    for number in range(1, controls + 1):
        draw = key.draw("real", "control", number)
        names = list(sets)
        source = names[(number - 1) % len(names)]
        control = Plan(
            name=f"control_{number:03d}", source=source, kind=None, joints=(),
            size=float(draw.uniform(0.02, 0.15)), sign=1.0,
        )  # fmt: skip
        found.insert(number * (hidden // max(controls, 1) + 1) - 1, (control,))
    return found


def _drawn(
    key: Key, sets: dict[str, PublicSet], number: int, kind: Kind, size: float, again: int
) -> Plan:
    """A case; drawn anew so many times, from the second on in any size."""
    draw = key.draw("real", "case", number, *([again] if again else []))
    names = [s for s in sets if not kind.sets or s in kind.sets]
    weights = [WEIGHTS[s] for s in names]
    source = names[int(draw.choice(len(names), p=[w / sum(weights) for w in weights]))]
    joints = tuple(int(j) for j in draw.permutation(_joints(sets[source], kind)))
    if kind.name == "stiffness":
        size = float(draw.choice(FACTORS))
    elif again > 1:
        size = float(draw.choice(SIZES))
    sign = float(draw.choice([-1.0, 1.0])) if kind.name in ("motor gain", "offset") else 1.0
    return Plan(
        name=f"case_{number:03d}", source=source, kind=kind, joints=joints, size=size, sign=sign
    )


def _joints(s: PublicSet, kind: Kind) -> list[int]:
    n = len(s.joints)
    if kind.every:
        return [0]
    if kind.links == "last":
        return [n - 1]
    if kind.links:
        # The first link of an upright arm shows nothing but inertia about its axis.
        return list(range(1, n)) if n > 2 else list(range(n))
    if kind.where in ("link", "stiffness"):
        seen = [k for k, name in enumerate(s.told["signals"]["link_position"]) if name]
        return seen if kind.where == "stiffness" else [k for k in seen if s.turns_over(k)]
    size = s.size(lambda run: run.velocity)
    return [j for j in range(n) if size[j] > 0.0]
