"""Chains of more than two integrators behind a piecewise-linear control, integrated exactly.

With five, position, velocity, acceleration, jerk and snap behind a crackle, positions are pieces of
degree 6 with five continuous derivatives. Nodes are those of `PiecewiseLinear`; such motions bend
so little between them that bounds of states need no rows within the intervals.
"""

from __future__ import annotations

import functools
import math
import operator
from collections.abc import Iterator

import casadi as ca
import numpy as np

from stiffopt.transcription.nlp import Places
from stiffopt.transcription.ocp import Rows
from stiffopt.transcription.piecewise_linear import PiecewiseLinear
from stiffopt.transcription.scheme import Defect, Symbols

_NAMES = ("position", "velocity", "acceleration", "jerk", "snap")


class IntegratorChain(PiecewiseLinear):
    """Control linear in each interval and continuous; every state belongs to a chain."""

    def defects(self, s: Symbols) -> Iterator[Defect]:
        """Exact integration over every interval, the last integrator first."""
        places = s.intervals.places(np.array([0.5]))
        for order in reversed(range(len(s.chain[:-1]))):
            own = s.chain[order]
            moved = functools.reduce(operator.add, _terms(s, order, 1.0))
            step = s.states[own, 1:] - s.states[own, :-1] - moved
            yield f"{_NAMES[order]} step", own, step, places

    def middle(self, s: Symbols) -> tuple[ca.MX, ca.MX]:
        """States and controls in the middles of the intervals."""
        parts = [
            functools.reduce(operator.add, _terms(s, order, 0.5), s.states[own, :-1])
            for order, own in enumerate(s.chain[:-1])
        ]
        order = [i for own in s.chain[:-1] for i in own]
        controls = (s.controls[:, :-1] + s.controls[:, 1:]) / 2.0
        return ca.vertcat(*parts)[np.argsort(order).tolist(), :], controls

    def extra_rows(self, s: Symbols) -> Iterator[tuple[Rows, ca.MX, Places]]:
        """None."""
        return iter(())


def _terms(s: Symbols, order: int, share: float) -> list[ca.MX]:
    """Taylor terms by which states of the chains move in the first share of every interval.

    The k-th adds h^k / k! of the derivative k orders up; the last that of the linear control.
    """
    *states, control = s.chain
    h = share * s.step(len(control))
    power, terms = h, []
    for k, own in enumerate(states[order + 1 :], start=1):
        terms.append(power * s.states[own, :-1] / math.factorial(k))
        power = power * h
    n = len(states) - order
    start, end = s.controls[control, :-1], s.controls[control, 1:]
    mean = start + share * (end - start) / (n + 1)
    terms.append(power * mean / math.factorial(n))
    return terms
