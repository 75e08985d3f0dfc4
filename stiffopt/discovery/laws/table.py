"""Residual table: what is left of a channel as a free function of a signal, within the range seen.

It claims no physics. Predictions improve by it; planners leave it out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from stiffopt.discovery.effect import Amplitude, Effect, Term
from stiffopt.discovery.laws.law import Factor, Place, at_joint
from stiffopt.discovery.laws.sources import LawSource
from stiffopt.discovery.signals import RobotSignals
from stiffopt.symbolic import Quantity

TABLE_NAME = "residual"


@dataclass(frozen=True)
class ResidualTable:
    """Table of one signal times factors without shapes; constant beyond its ends."""

    joint: int  # from 0
    place: Place  # "drive_torque" or "deflection"
    carrier: tuple[Factor, ...]  # empty for 1
    source: LawSource
    at: tuple[float, ...]  # values of the signal, rising
    values: tuple[float, ...]  # residual per unit of the carrier [N m] or [rad]

    def value(self, signals: RobotSignals) -> np.ndarray:
        """Return the residual (K,) along a motion."""
        found = np.interp(np.asarray(self.source.value(signals)), self.at, self.values)
        for factor in self.carrier:
            found = found * factor.values(signals)[0]
        return np.asarray(found)

    @property
    def effect(self) -> Effect:
        """The table as an effect of its joint, with a weight of 1."""
        return Effect(
            name=TABLE_NAME,
            family="table",
            scope="joint",
            couples_joints=True,
            equation=f"{self.place} += table({self.source.symbol})",
            signature="a residual that no law explains, by a table of signals",
            term=partial(_table_term, self),
            amplitudes=(Amplitude(name="weight", unit=""),),
        )


def _table_term(
    table: ResidualTable,
    signals: RobotSignals,
    amplitudes: Sequence[Quantity],
    shapes: Sequence[Quantity],
) -> Term:
    return Term(**{table.place: at_joint(signals, amplitudes[0] * table.value(signals))})


def table_of(effect: Effect) -> ResidualTable | None:
    """Return the table that an effect was made from; None of other effects."""
    term = effect.term
    if isinstance(term, partial) and term.func is _table_term:
        table: ResidualTable = term.args[0]
        return table
    return None
