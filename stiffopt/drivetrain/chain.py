"""Series and parallel composition of connections, seen from the joint's output.

Series: wind-ups add at equal torque. Parallel (stages of one group): torques add at equal wind-up.
An element that turns `ratio` times faster than the joint carries the torque T/(ratio efficiency)
and its wind-up counts 1/ratio, so its stiffness counts ratio^2.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.connection.connection import Connection
from stiffopt.drivetrain.stage import Preloads, Stage
from stiffopt.errors import InputError, nearest
from stiffopt.symbolic import Quantity

# Unrolled, so that the split stays a differentiable expression. Three steps leave 1e-12 of the
# wind-up for a key beside a bolted flange.
_NEWTON_STEPS = 4

Law = Callable[[Quantity], Quantity]


@dataclass(frozen=True)
class Chain:
    """Drivetrain of one joint, from motor to link.

    Parameters
    ----------
    stages : tuple of Stage
    reflect : bool
        True (physics): the wind-up of an element counts 1/ratio at the joint, its stiffness
        ratio^2. False: the torque is still divided by the ratio, but the element's tangent
        stiffness is added as it is; a reading that a text silent about reflection allows, under
        which everything on the motor side dominates.

    Notes
    -----
    Torques and wind-ups are those of the joint [N m], [rad]. An empty chain is rigid.
    """

    stages: tuple[Stage, ...]
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

        Parameters
        ----------
        torque : scalar or (n,) or SX or MX [N m]
        preloads : mapping of element name to preload [N], optional
            In place of the elements' own; may be symbolic.
        smoothing : scalar [-]
            Factor on every smoothing width.

        Returns
        -------
        same kind as `torque` [rad]
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
        """Chains of the groups that hold one of these elements, and of the others.

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
        """Stages as a series of groups; a stage without a group stands alone.

        Raises `InputError` where a preload is of no element.
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
    """Share of the torque that each stage of a group carries; a smooth expression.

    Parameters
    ----------
    stages : sequence of Stage
        At least two.
    torque : scalar or (n,) or SX or MX [N m]

    Returns
    -------
    list, one a stage, same kind as `torque` [-]; they sum to 1
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
    """Shares at which all wind up alike, by Newton steps on the logarithms.

    Equal wind-up means ln S_e(s_e T) + ln s_e is the same for all elements e, with the secant
    compliance S_e = wind-up / torque and the share s_e. In these logarithms the stiffness laws
    (powers of the torque) are nearly straight lines, so few steps do, at T = 0 too.
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
