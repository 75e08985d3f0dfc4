"""Free smooth functions of signals: what any law of these signals could explain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.interpolate import BSpline

from stiffopt.discovery.law_search.open_channel import OpenChannel
from stiffopt.discovery.laws.law import Factor
from stiffopt.discovery.laws.sources import LawSource
from stiffopt.discovery.laws.table import ResidualTable

# Pairs of signals whose products are tried as splines times a signal.
_MAX_PRODUCTS = 4
# Inner knots of a spline, its degree, and its ridge over the mean square of its columns.
_KNOT_COUNT, _SPLINE_DEGREE, _RELATIVE_RIDGE = 7, 3, 1e-3
# Points of a table of such a function.
_TABLE_POINTS = 25
# Maximum number of splines in a sum, and the least share of the left squares that one more removes.
_MAX_TERMS, _MIN_RELATIVE_GAIN = 3, 0.03


@dataclass(frozen=True, eq=False)
class Carrier:
    """Factor of a free function of a signal.

    Parameters
    ----------
    factors : tuple of Factor
        Without shapes; none for 1.
    """

    factors: tuple[Factor, ...]


@dataclass(frozen=True, eq=False)
class FreeTerm:
    """A spline of one signal times a carrier.

    Parameters
    ----------
    carrier : Carrier
    source : LawSource
    columns : array (m, k)
        Projected rows.
    left : float
        Squares that it leaves in blocks left out, alone.
    """

    carrier: Carrier
    source: LawSource
    columns: np.ndarray
    left: float


def carriers(channel: OpenChannel) -> list[Carrier]:
    """Return the carriers of a channel: 1, and simple functions of the joint's own signals."""
    j = channel.joint
    load = Factor(LawSource("load", j), "linear")
    if channel.kind == "deflection":
        return [Carrier(()), Carrier((load,)), Carrier((Factor(LawSource("windup", j), "linear"),))]
    sign = Factor(LawSource("direction", j), "linear")
    return [
        Carrier(()),
        Carrier((sign,)),
        Carrier((Factor(LawSource("speed", j), "linear"),)),
        Carrier((Factor(LawSource("friction", j), "linear"),)),
        Carrier((load,)),
        Carrier((sign, Factor(LawSource("load", j), "magnitude"))),
        Carrier((Factor(LawSource("acceleration", j), "linear"),)),
    ]


def screen_products(channel: OpenChannel) -> list[FreeTerm]:
    """Return splines of one signal times another signal, for the pairs that promise most.

    Pairs are compared as bilinear functions, which few columns describe.
    """
    sources = [s for s in channel.sources if s.kind != "direction"]
    runs = channel.comparison.runs
    scaled = []
    for source in sources:
        extent = channel.extent(source)
        middle = 0.5 * (extent.low + extent.high)
        scaled.append([(np.asarray(source.value(r.signals)) - middle) / extent.span for r in runs])
    singles = channel.columns([[own[k] for own in scaled] for k in range(len(runs))])
    constant = channel.columns([[np.ones(len(run.time))] for run in runs])
    pairs = list(combinations(range(len(sources)), 2))
    products = channel.columns(
        [[scaled[i][k] * scaled[j][k] for i, j in pairs] for k in range(len(runs))]
    )
    left = []
    for number, (i, j) in enumerate(pairs):
        columns = np.hstack([constant, singles[:, [i, j]], products[:, [number]]])
        left.append(float(predict(channel, columns).sum()))
    found = []
    for number in np.argsort(left)[:_MAX_PRODUCTS]:
        for one, other in (pairs[number], pairs[number][::-1]):
            base = Factor(sources[one], "linear")
            found += screen(channel, (base,), (sources[other],))
    return sorted(found, key=lambda term: term.left)


def screen(
    channel: OpenChannel, base: Sequence[Factor] = (), sources: Sequence[LawSource] = ()
) -> list[FreeTerm]:
    """Return free functions of every signal times every carrier, the best first.

    Parameters
    ----------
    channel : OpenChannel
    base : sequence of Factor
        Factors that take the place of the carriers.
    sources : sequence of LawSource
        Default: all that vary.
    """
    found = []
    every = [Carrier(tuple(base))] if base else carriers(channel)
    runs = channel.comparison.runs
    for source in sources or channel.sources:
        if any(factor.source == source for factor in base):
            continue
        inner = _inner_knots(channel, source)
        splines = [_splines_at(inner, np.asarray(source.value(run.signals))) for run in runs]
        # Splines sum to one: a carrier alone is among the functions.
        for carrier in every:
            if any(factor.source == source and not factor.shapes for factor in carrier.factors):
                continue
            values = []
            for run, own in zip(runs, splines, strict=True):
                times: np.ndarray | float = 1.0
                for factor in carrier.factors:
                    times = times * factor.values(run.signals)[0]
                values.append(list((own * np.reshape(times, (-1, 1))).T))
            columns = channel.columns(values)
            found.append(FreeTerm(carrier, source, columns, float(predict(channel, columns).sum())))
    return sorted(found, key=lambda term: term.left)


def _inner_knots(channel: OpenChannel, source: LawSource) -> np.ndarray:
    """Return knots at quantiles of a signal over all runs."""
    values = [np.asarray(source.value(run.signals)) for run in channel.comparison.runs]
    return np.unique(np.quantile(np.concatenate(values), np.linspace(0.0, 1.0, _KNOT_COUNT)))


def _splines_at(inner: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return cubic B-splines (K, k) at values of a signal."""
    if len(inner) < 2 or not inner[-1] > inner[0]:
        return np.ones((len(values), 1))
    knots = np.concatenate([[inner[0]] * _SPLINE_DEGREE, inner, [inner[-1]] * _SPLINE_DEGREE])
    inside = np.clip(values, inner[0], np.nextafter(inner[-1], inner[0]))
    return np.asarray(BSpline.design_matrix(inside, knots, _SPLINE_DEGREE).toarray())


def residual_tables(channel: OpenChannel, terms: Sequence[FreeTerm]) -> tuple[ResidualTable, ...]:
    """Return a sum of free functions as tables over the range that was seen."""
    if not terms:
        return ()
    columns = np.hstack([term.columns for term in terms])
    scale = np.sqrt(np.mean(columns**2, axis=0)) + 1e-12
    ridge = _RELATIVE_RIDGE * len(columns) * np.eye(columns.shape[1]) / columns.shape[1]
    scaled = columns / scale
    weights = np.linalg.solve(scaled.T @ scaled + ridge, scaled.T @ channel.target) / scale
    tables = []
    for term in terms:
        own, weights = weights[: term.columns.shape[1]], weights[term.columns.shape[1] :]
        inner = _inner_knots(channel, term.source)
        at = np.linspace(inner[0], inner[-1], _TABLE_POINTS)
        tables.append(
            ResidualTable(
                joint=channel.joint,
                place="drive_torque" if channel.kind == "torque" else "deflection",
                carrier=term.carrier.factors,
                source=term.source,
                at=tuple(at.tolist()),
                values=tuple((_splines_at(inner, at) @ own).tolist()),
            )
        )
    return tuple(tables)


def predict(channel: OpenChannel, columns: np.ndarray) -> np.ndarray:
    """Return the squares (b,) left in every block by a ridge fit to the others."""
    scale = np.sqrt(np.mean(columns**2, axis=0)) + 1e-12
    columns = columns / scale
    ridge = _RELATIVE_RIDGE * len(columns) * np.eye(columns.shape[1]) / columns.shape[1]
    gram, moment = columns.T @ columns, columns.T @ channel.target
    blocks = int(channel.block.max()) + 1
    left = np.empty(blocks)
    for b in range(blocks):
        own = channel.block == b
        part = columns[own]
        values = np.linalg.solve(
            gram - part.T @ part + ridge, moment - part.T @ channel.target[own]
        )
        left[b] = float(np.sum((channel.target[own] - part @ values) ** 2))
    return left


def best_sum(channel: OpenChannel, terms: Sequence[FreeTerm]) -> tuple[list[FreeTerm], float]:
    """Return the sum of free functions that predicts blocks left out best, and what it leaves."""
    chosen: list[FreeTerm] = []
    left = channel.square
    candidates = list(terms[:24])
    while len(chosen) < _MAX_TERMS and candidates:
        tries = [
            float(predict(channel, np.hstack([*(c.columns for c in chosen), each.columns])).sum())
            for each in candidates
        ]
        best = int(np.argmin(tries))
        if tries[best] > (1.0 - _MIN_RELATIVE_GAIN) * left:
            break
        left = tries[best]
        chosen.append(candidates.pop(best))
    return chosen, left
