"""Free smooth functions of signals: what any law of these signals could explain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from stiffopt.discovery.judging.splines import inner_knots, predict_blocks, splines_at
from stiffopt.discovery.law_search.open_channel import OpenChannel
from stiffopt.discovery.laws.law import Factor
from stiffopt.discovery.laws.sources import LawSource
from stiffopt.discovery.laws.table import ResidualTable

# Pairs of signals whose products are tried as splines times a signal.
_MAX_PRODUCTS = 4
# Inner knots of a spline, and its ridge over the mean square of its columns.
_KNOT_COUNT, _RELATIVE_RIDGE = 7, 1e-3
# Points of a table of such a function.
_TABLE_POINTS = 25
# Maximum number of splines in a sum, and the least share of the left squares that one more removes.
_MAX_TERMS, _MIN_RELATIVE_GAIN = 3, 0.03


# Factor of a free function of a signal, without shapes; none for 1.
Carrier = tuple[Factor, ...]


@dataclass(frozen=True, eq=False)
class FreeTerm:
    """A spline of one signal times a carrier."""

    carrier: Carrier
    source: LawSource
    columns: np.ndarray  # (m, k) projected rows
    left: float  # squares that it leaves in blocks left out, alone


def carriers(channel: OpenChannel) -> list[Carrier]:
    """Return the carriers of a channel: 1, and simple functions of the joint's own signals."""
    j = channel.joint
    load = Factor(LawSource("load", j), "linear")
    if channel.kind == "deflection":
        return [(), (load,), (Factor(LawSource("windup", j), "linear"),)]
    sign = Factor(LawSource("direction", j), "linear")
    return [
        (),
        (sign,),
        (Factor(LawSource("speed", j), "linear"),),
        (Factor(LawSource("friction", j), "linear"),),
        (load,),
        (sign, Factor(LawSource("load", j), "magnitude")),
        (Factor(LawSource("acceleration", j), "linear"),),
        (Factor(LawSource("drive", j), "linear"),),
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

    `base`: factors that take the place of the carriers. `sources`: by default all that vary.
    """
    found = []
    every = [tuple(base)] if base else carriers(channel)
    runs = channel.comparison.runs
    for source in sources or channel.sources:
        if any(factor.source == source for factor in base):
            continue
        inner = _inner_knots(channel, source)
        splines = [splines_at(inner, np.asarray(source.value(run.signals))) for run in runs]
        # Splines sum to one: a carrier alone is among the functions.
        for carrier in every:
            if any(factor.source == source and not factor.shapes for factor in carrier):
                continue
            values = []
            for run, own in zip(runs, splines, strict=True):
                times: np.ndarray | float = 1.0
                for factor in carrier:
                    times = times * factor.values(run.signals)[0]
                values.append(list((own * np.reshape(times, (-1, 1))).T))
            columns = channel.columns(values)
            found.append(FreeTerm(carrier, source, columns, float(predict(channel, columns).sum())))
    return sorted(found, key=lambda term: term.left)


def _inner_knots(channel: OpenChannel, source: LawSource) -> np.ndarray:
    """Return knots at quantiles of a signal over all runs."""
    values = [np.asarray(source.value(run.signals)) for run in channel.comparison.runs]
    return inner_knots(np.concatenate(values), _KNOT_COUNT)


def residual_tables(channel: OpenChannel, terms: Sequence[FreeTerm]) -> tuple[ResidualTable, ...]:
    """Return a sum of free functions as tables over the range that was seen."""
    if not terms:
        return ()
    columns = np.hstack([term.columns for term in terms])
    scale = np.sqrt(np.mean(columns**2, axis=0)) + 1e-12
    ridge = _ridge(columns) * np.eye(columns.shape[1])
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
                carrier=term.carrier,
                source=term.source,
                at=tuple(at.tolist()),
                values=tuple((splines_at(inner, at) @ own).tolist()),
            )
        )
    return tuple(tables)


def predict(channel: OpenChannel, columns: np.ndarray) -> np.ndarray:
    """Return the squares (b,) left in every block by a ridge fit to the others."""
    scale = np.sqrt(np.mean(columns**2, axis=0)) + 1e-12
    predicted = predict_blocks(columns / scale, channel.target, channel.block, _ridge(columns))
    squares = (channel.target - predicted) ** 2
    return np.array([np.sum(squares[channel.block == b]) for b in np.unique(channel.block)])


def _ridge(columns: np.ndarray) -> float:
    count, width = columns.shape
    return float(_RELATIVE_RIDGE * count / width)


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
