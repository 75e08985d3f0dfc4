"""Path rows between the points at which they hold, and bounds tightened where they are exceeded.

Rows hold at nodes and midpoints; between them a motion of high order bulges, and rows that are only
nearly right differ from the exact ones everywhere. Both are met by sequential correction: the exact
rows are evaluated densely on the motion that was found, and the bound of a row is drawn in by what
they exceed it by in the neighbourhood of its point. The programme stays, only its bounds change.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from stiffopt.transcription.nlp import Block, Nlp
from stiffopt.transcription.point_function import PointFunction
from stiffopt.transcription.transcription import Transcription

# Points in every interval at which rows are looked at.
_POINTS_PER_INTERVAL = 16
# Bounds are drawn in by a little more than the excess: where they move, the excess moves too.
_BACK_OFF_FACTOR, _MIN_BACK_OFF = 1.25, 2e-3
# What bulges between two points gives way slowly, and the objective hardly feels it: a bound that
# was drawn in and is still exceeded goes as far again, up to so many times what is needed. One that
# was not goes by what is needed: more would move the switches of the motion.
_MAX_BACK_OFF_GROWTH = 8.0


@dataclass(frozen=True)
class Excess:
    """What exact path rows of a motion exceed their bounds by, in units of the rows.

    Parameters
    ----------
    largest : dict of row name to float
    near : tuple of (block, index (k, m), upper (k, m), lower (k, m))
        Of every block its rows in the NLP, point by point in time, and the largest excess of either
        bound about each point.
    """

    largest: dict[str, float]
    near: tuple[tuple[Block, np.ndarray, np.ndarray, np.ndarray], ...]


@dataclass(frozen=True)
class KnownRows:
    """What rows of a name are in truth, where it is known apart from the programme.

    Parameters
    ----------
    times : array (K,)
        In time, from 0 [s].
    values : array (K, m)
        In the unit of the rows and in their order.
    """

    times: np.ndarray
    values: np.ndarray


def path_row_excess(
    transcription: Transcription,
    x: np.ndarray,
    parameters: np.ndarray,
    rows: PointFunction,
    found: Mapping[str, KnownRows] = MappingProxyType({}),
) -> Excess:
    """Excess of the exact path rows of a motion, at the points of the programme and between them.

    Parameters
    ----------
    transcription : Transcription
    x : array
        The NLP vector that was found.
    parameters : array (np,)
    rows : PointFunction
        Exact path rows.
    found : mapping of row name to KnownRows
        What counts besides: motors arrive later than the links by what rows do not know.
    """
    motion = transcription.guess_from(x)
    steps = transcription.intervals.shares @ transcription.phase_durations(x)
    breaks = np.concatenate([[0.0], np.cumsum(steps)])
    inside = np.linspace(0.0, 1.0, _POINTS_PER_INTERVAL, endpoint=False)
    times = np.append((breaks[:-1, None] + steps[:, None] * inside).ravel(), breaks[-1])
    share = times / breaks[-1]
    statics = np.tile(motion.statics, (len(times), 1))
    points = np.hstack([motion.states(share), motion.controls(share), statics])
    values = rows(points.T, parameters).T
    largest: dict[str, float] = {}
    near = []
    for block, entries in transcription.path_blocks:
        assert block.places is not None
        places = transcription.times_of(block.places, x)
        order = np.argsort(places)
        own = values[:, entries] / block.rows.scale
        index = block.offset + np.arange(block.size).reshape(len(places), -1)[order]
        name = block.rows.name
        seen = [(times, own)]
        if name in found:
            seen.append((found[name].times, found[name].values / block.rows.scale))
        both = []
        for limit, sign in ((block.rows.upper, 1.0), (block.rows.lower, -1.0)):
            beside = np.zeros((len(places), own.shape[1]))
            for when, known in seen:
                with np.errstate(invalid="ignore"):
                    excess = np.maximum(sign * (known - limit / block.rows.scale), 0.0)
                excess = np.nan_to_num(excess, nan=0.0, posinf=0.0)
                largest[name] = max(largest.get(name, 0.0), float(excess.max(initial=0.0)))
                beside = np.maximum(beside, largest_adjacent_excess(when, places[order], excess))
            both.append(beside)
        near.append((block, index, both[0], both[1]))
    return Excess(largest, tuple(near))


def back_off_exceeded(
    nlp: Nlp, excess: Excess, given: Nlp, *, most: float, limits: Container[str] = ()
) -> Nlp:
    """The NLP with the bounds of its path rows drawn in where a motion exceeds them.

    Parameters
    ----------
    nlp : Nlp
        That of the motion, or one tightened before.
    excess : Excess
    given : Nlp
        With the bounds as they were first.
    most : float
        Largest step by which a bound is drawn in, in units of its row.
    limits : container of str
        Names of rows that have to hold. The others are those of a peak, which is what it is: they
        are drawn in by just their excess.
    """
    lower, upper = nlp.lower_g.copy(), nlp.upper_g.copy()
    for block, index, above, below in excess.near:
        for bound, first, near, sign in (
            (upper, given.upper_g, above, 1.0),
            (lower, given.lower_g, below, -1.0),
        ):
            step = near
            if block.rows.name in limits:
                step = _BACK_OFF_FACTOR * near + _MIN_BACK_OFF
                with np.errstate(invalid="ignore"):
                    drawn = np.nan_to_num(sign * (first[index] - bound[index]))
                step = np.clip(drawn, step, _MAX_BACK_OFF_GROWTH * step)
            bound[index] -= sign * np.where(near > 0.0, np.minimum(step, most), 0.0)
    # Rows drawn in from both sides past themselves stay as they were.
    crossed = lower > upper
    lower[crossed], upper[crossed] = nlp.lower_g[crossed], nlp.upper_g[crossed]
    return replace(nlp, lower_g=lower, upper_g=upper)


def back_off_uniformly(nlp: Nlp, excess: Mapping[str, float]) -> Nlp:
    """The NLP with both bounds of all rows of these names drawn in, each by its excess.

    Parameters
    ----------
    nlp : Nlp
    excess : mapping row name -> float
        In units of the row; no bound is drawn to less than a twentieth of what it was.
    """
    lower, upper = nlp.lower_g.copy(), nlp.upper_g.copy()
    for block in nlp.rows.items:
        if block.rows.name in excess:
            own = slice(block.offset, block.offset + block.size)
            step = _BACK_OFF_FACTOR * excess[block.rows.name]
            upper[own] = np.maximum(upper[own] - step, 0.05 * upper[own])
            lower[own] = np.minimum(lower[own] + step, 0.05 * lower[own])
    return replace(nlp, lower_g=lower, upper_g=upper)


def largest_adjacent_excess(
    times: np.ndarray, places: np.ndarray, excess: np.ndarray
) -> np.ndarray:
    """Largest excess (K, m) between each place and the ones beside it (k, m)."""
    after = np.clip(np.searchsorted(places, times - 1e-12), 0, len(places) - 1)
    before = np.clip(np.searchsorted(places, times + 1e-12, side="right") - 1, 0, None)
    found = np.zeros((len(places), excess.shape[1]))
    np.maximum.at(found, before, excess)
    np.maximum.at(found, after, excess)
    return found
