"""Series and parallel composition of connections, seen from the joint's output.

Series: wind-ups add at equal torque. Parallel (stages of one group): torques add at equal wind-up.
An element that turns `ratio` times faster than the joint carries the torque T/(ratio efficiency)
and its wind-up counts 1/ratio, so its stiffness counts ratio^2.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from stiffopt.connection.connection import Connection
from stiffopt.declaration import FRACTION, POSITIVE, Doc, Ratio, check_fields
from stiffopt.errors import InputError, nearest
from stiffopt.symbolic import Quantity

Preloads = Mapping[str, Quantity] | None


@dataclass(frozen=True)
class Stage:
    """One element of a chain with its gear ratio and its parallel group.

    The element carries T/(ratio efficiency) and its wind-up counts 1/ratio. `reflect` is that of
    the `stiffopt.drivetrain.chain.Chain`, which sets it for all its stages.
    """

    element: Connection
    ratio: Annotated[Ratio, POSITIVE, Doc("Turns of the element for one turn of the joint.")] = 1.0
    efficiency: Annotated[
        Ratio, FRACTION, Doc("Of the way from the element to the joint; 1 is without losses.")
    ] = 1.0
    group: Annotated[
        str | None,
        Doc("Group of elements that act in parallel; without it in series with the rest."),
    ] = None
    reflect: bool = True

    def __post_init__(self) -> None:
        check_fields(self, self.element.owner)

    @property
    def reduction(self) -> float:
        """Joint torque for a unit of the element's torque [-]."""
        return self.ratio * self.efficiency

    @property
    def windup_factor(self) -> float:
        """Wind-up of the joint for a unit of the element's wind-up [-]."""
        return 1.0 / self.ratio if self.reflect else self.reduction

    def windup(self, torque: Quantity, preloads: Preloads, smoothing: Quantity) -> Quantity:
        """Wind-up at the joint [rad] for the joint torque [N m] that flows through this stage."""
        own = torque / self.reduction
        return self.windup_factor * self.element.windup(
            own, preload=self._select_preload(preloads), smoothing=smoothing
        )

    def tangent_compliance(
        self, torque: Quantity, preloads: Preloads, smoothing: Quantity
    ) -> Quantity:
        """Slope of `windup` [rad/(N m)]."""
        own = torque / self.reduction
        slope = self.element.tangent_compliance(
            own, preload=self._select_preload(preloads), smoothing=smoothing
        )
        return self.windup_factor / self.reduction * slope

    def secant_compliance(
        self, torque: Quantity, preloads: Preloads, smoothing: Quantity
    ) -> Quantity:
        """Wind-up over torque [rad/(N m)], with its limit at zero."""
        own = torque / self.reduction
        stiffness = self.element.secant_stiffness(
            own, preload=self._select_preload(preloads), smoothing=smoothing
        )
        return self.windup_factor / self.reduction / stiffness

    def slip_torque(self, preloads: Preloads = None) -> float:
        """Joint torque at which this stage alone would slip [N m]."""
        return float(self.element.slip_torque(self._select_preload(preloads))) * self.reduction

    def _select_preload(self, preloads: Preloads) -> Quantity | None:
        return (preloads or {}).get(self.element.name)


# Newton steps of the torque split, unrolled so that it stays differentiable. Three steps reduce the
# error to 1e-12 of the wind-up for a key beside a bolted flange.
_NEWTON_STEPS = 4

Law = Callable[[Quantity], Quantity]


@dataclass(frozen=True)
class Chain:
    """Drivetrain of one joint, from motor to link.

    Torques and wind-ups are those of the joint [N m], [rad]. An empty chain is rigid.
    """

    stages: tuple[Stage, ...]
    # True (physics): the wind-up of an element counts 1/ratio at the joint, its stiffness ratio^2.
    # False: the torque is still divided by the ratio, but the element's tangent stiffness is added
    # as it is; an interpretation of texts that do not mention reflection, in which everything on
    # the motor side dominates.
    reflect: bool = True

    def __post_init__(self) -> None:
        names = [s.element.name for s in self.stages]
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise InputError(
                f"element names must differ within a joint, used twice: {', '.join(twice)}. "
                "Rename one."
            )
        stages = tuple(replace(s, reflect=self.reflect) for s in self.stages)
        object.__setattr__(self, "stages", stages)

    # ---- smooth law: floats, arrays, SX, MX

    def windup(
        self, torque: Quantity, *, preloads: Preloads = None, smoothing: Quantity = 1.0
    ) -> Quantity:
        """Wind-up of the joint under a torque.

        `torque` (n,) or SX or MX [N m]. `preloads` [N]: replaces the elements' own; may be
        symbolic. `smoothing` [-]: factor on every smoothing width. Returns same kind as `torque`
        [rad].
        """
        total = 0.0 * torque
        for group in self.groups(preloads):
            if len(group) == 1:
                total = total + group[0].windup(torque, preloads, smoothing)
            else:
                total = total + torque * _group_secant(group, torque, preloads, smoothing)
        return total

    def tangent_compliance(
        self, torque: Quantity, *, preloads: Preloads = None, smoothing: Quantity = 1.0
    ) -> Quantity:
        """Slope of the wind-up at a torque [rad/(N m)]; arguments as in `windup`."""
        total = 0.0 * torque
        for group in self.groups(preloads):
            shares = smooth_shares(group, torque, preloads, smoothing)
            slopes = [
                s.tangent_compliance(f * torque, preloads, smoothing)
                for s, f in zip(group, shares, strict=True)
            ]
            total = total + 1.0 / sum(1.0 / c for c in slopes)
        return total

    def tangent_stiffness(
        self, torque: Quantity, *, preloads: Preloads = None, smoothing: Quantity = 1.0
    ) -> Quantity:
        """Slope of torque over wind-up [N m/rad]; arguments as in `windup`."""
        return 1.0 / self.tangent_compliance(torque, preloads=preloads, smoothing=smoothing)

    def secant_stiffness(
        self, torque: Quantity, *, preloads: Preloads = None, smoothing: Quantity = 1.0
    ) -> Quantity:
        """Torque divided by wind-up [N m/rad], with its limit at zero; arguments as in `windup`."""
        total = 0.0 * torque
        for group in self.groups(preloads):
            total = total + _group_secant(group, torque, preloads, smoothing)
        return 1.0 / total

    # ---- parts

    @property
    def elements(self) -> dict[str, Connection]:
        """Elements by name, from motor to link."""
        return {s.element.name: s.element for s in self.stages}

    def reducer_only(self) -> Chain:
        """Return the chain without contacts and shafts: reducers and constant stiffnesses."""
        kept = tuple(s for s in self.stages if s.element.kind in ("reducer", "constant"))
        return replace(self, stages=kept)

    def split(self, names: Iterable[str]) -> tuple[Chain, Chain]:
        """Return the chain of the groups that contain one of these elements, and that of the rest.

        The two are in series, so their wind-ups and compliances add up to those of the whole.
        """
        wanted = set(names)
        self._check_names(dict.fromkeys(wanted, 0.0))
        inside: list[Stage] = []
        outside: list[Stage] = []
        for group in self.groups(None):
            held = any(stage.element.name in wanted for stage in group)
            (inside if held else outside).extend(group)
        return replace(self, stages=tuple(inside)), replace(self, stages=tuple(outside))

    def slip_torques(self) -> dict[str, float]:
        """Joint torque at which each element alone would slip [N m]; infinite where none can."""
        return {s.element.name: s.slip_torque() for s in self.stages}

    def with_preloads(self, preloads: Mapping[str, float]) -> Chain:
        """Copy with other preloads [N], by element name."""
        self._check_names(preloads)
        stages = tuple(
            replace(s, element=s.element.with_preload(preloads[s.element.name]))
            if s.element.name in preloads
            else s
            for s in self.stages
        )
        return replace(self, stages=stages)

    def groups(self, preloads: Preloads = None) -> list[tuple[Stage, ...]]:
        """Return the stages as a series of groups; a stage without a group is one by itself.

        Raises `InputError` where a preload names no element.
        """
        self._check_names(preloads)
        groups: dict[object, list[Stage]] = {}
        for index, stage in enumerate(self.stages):
            groups.setdefault(index if stage.group is None else stage.group, []).append(stage)
        return [tuple(group) for group in groups.values()]

    def _check_names(self, preloads: Preloads) -> None:
        for name in preloads or {}:
            if name not in self.elements:
                raise InputError(f"no element {name!r} to preload. {nearest(name, self.elements)}")


def _group_secant(
    group: tuple[Stage, ...], torque: Quantity, preloads: Preloads, smoothing: Quantity
) -> Quantity:
    shares = smooth_shares(group, torque, preloads, smoothing)
    parts = [
        s.secant_compliance(f * torque, preloads, smoothing)
        for s, f in zip(group, shares, strict=True)
    ]
    return 1.0 / sum(1.0 / c for c in parts)


def smooth_shares(
    stages: Sequence[Stage], torque: Quantity, preloads: Preloads, smoothing: Quantity
) -> list[Quantity]:
    """Return the share of the torque [N m] that each stage of a group carries, a smooth expression.

    At least two stages; the shares are of the torque's kind and sum to 1.
    """
    if len(stages) == 1:
        return [1.0 + 0.0 * torque]
    extra = {"preloads": preloads, "smoothing": smoothing}
    return _newton_step(
        [functools.partial(s.secant_compliance, **extra) for s in stages],
        [functools.partial(s.tangent_compliance, **extra) for s in stages],
        torque,
    )


def _newton_step(
    secants: Sequence[Law], tangents: Sequence[Law], torque: Quantity
) -> list[Quantity]:
    """Return the shares of equal wind-up, by Newton steps on the logarithms.

    Equal wind-up means ln S_e(s_e T) + ln s_e is the same for all elements e, with the secant
    compliance S_e = wind-up / torque and the share s_e. In these logarithms the stiffness laws
    (powers of the torque) are nearly straight lines, so few steps suffice, also at T = 0.
    """
    count = len(secants)
    even = 1.0 / count + 0.0 * torque
    weights = [1.0 / secant(even * torque) for secant in secants]
    shares = [w / sum(weights) for w in weights]
    for _ in range(_NEWTON_STEPS):
        residuals, slopes = [], []
        for secant, tangent, share in zip(secants, tangents, shares, strict=True):
            compliance = secant(share * torque)
            residuals.append(np.log(compliance) + np.log(share))
            slopes.append(tangent(share * torque) / compliance)
        level = sum(f * r / b for f, r, b in zip(shares, residuals, slopes, strict=True)) / sum(
            f / b for f, b in zip(shares, slopes, strict=True)
        )
        raw = [
            f * np.exp((level - r) / b) for f, r, b in zip(shares, residuals, slopes, strict=True)
        ]
        whole = sum(raw)
        shares = [f / whole for f in raw]
    return shares
