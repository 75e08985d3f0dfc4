"""Constraint back-off: bounds of path rows reduced where the exact rows exceed them.

Rows hold at nodes and midpoints; between them a motion of high order may exceed a bound, and
approximated rows differ from the exact ones everywhere. Both are corrected sequentially: the exact
rows are evaluated densely on the last solution, and the bound of a row is reduced by the excess in
the neighbourhood of its point. The programme stays, only its bounds change.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from stiffopt.transcription.nlp import Block, Nlp
from stiffopt.transcription.point_function import PointFunction
from stiffopt.transcription.transcription import Transcription

_POINTS_PER_INTERVAL = 16  # at which the exact rows are evaluated
# Back-off over excess, and its least value in units of the row: the excess moves with the bounds.
_BACK_OFF_FACTOR, _MIN_BACK_OFF = 1.25, 2e-3
# An excess between two points decreases slowly with the bound, at little cost of the objective: a
# bound that is exceeded again is reduced as far again, up to this multiple of the excess. The first
# back-off is just the excess: more would move the switching times.
_MAX_BACK_OFF_GROWTH = 8.0


@dataclass(frozen=True)
class Excess:
    """Excess of exact path rows over their bounds, in units of the rows."""

    largest: dict[str, float]  # by row name
    # (block, index (k, m), upper (k, m), lower (k, m)) for every block its NLP rows, point by point
    # in time, and the largest excess of either bound in the neighbourhood of each point.
    near: tuple[tuple[Block, np.ndarray, np.ndarray, np.ndarray], ...]


@dataclass(frozen=True)
class KnownRows:
    """Exact values of rows that were computed outside the programme."""

    times: np.ndarray  # (K,) from 0 [s]
    values: np.ndarray  # (K, m) in the unit of the rows and in their order


def path_row_excess(
    transcription: Transcription,
    x: np.ndarray,
    parameters: np.ndarray,
    rows: PointFunction,
    found: Mapping[str, KnownRows] = MappingProxyType({}),
) -> Excess:
    """Excess of the exact path rows of a motion, at the points of the programme and between them.

    `x`: solution of the NLP. `parameters` (np,). `rows`: exact path rows. `found`: further values
    to be considered, as of motors, which arrive later than the links.
    """
    motion, times = transcription.guess_from(x), _dense_times(transcription, x)
    share = times / times[-1]
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
    """Return the NLP with the bounds of path rows backed off where a motion exceeds them.

    `given` has the original bounds; one step is at most `most`, in units of the row. Rows of the
    names in `limits` must hold; the others bound a peak that is minimised: their back-off is just
    the excess.
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
    # Rows whose bounds would cross stay.
    crossed = lower > upper
    lower[crossed], upper[crossed] = nlp.lower_g[crossed], nlp.upper_g[crossed]
    return replace(nlp, lower_g=lower, upper_g=upper)


def back_off_states(
    nlp: Nlp, transcription: Transcription, x: np.ndarray, motors: KnownRows | None = None
) -> Nlp:
    """Return the NLP with bounds of states backed off beside nodes between which `x` exceeds them.

    `motors`: positions that have to keep the bounds of the first states as well. Of splines, whose
    states are bounded by rows, the positions' are backed off. Given states keep their bounds.
    """
    ocp, times = transcription.ocp, _dense_times(transcription, x)
    found = [(times, transcription.guess_from(x).states(times / times[-1]))]
    found += [] if motors is None else [(motors.times, motors.values)]
    blocks, names = [transcription.states], ("lower_x", "upper_x")
    if transcription.splines is not None:
        blocks = [block for block in nlp.rows.items if block.rows.name == "position"]
        names = "lower_g", "upper_g"
    lower, upper = (getattr(nlp, name).copy() for name in names)
    for block in blocks:
        assert block.places is not None
        places = transcription.times_of(block.places, x)
        order = np.argsort(places)
        index = block.offset + np.arange(block.size).reshape(len(places), -1)[order]
        states = [ocp.states.index(label) for label in block.rows.labels]
        for when, values in found:
            own = [k for k, state in enumerate(states) if state < values.shape[1]]
            at, scale = [states[k] for k in own], block.rows.scale[own]
            for bound, excess, sign in (
                (upper, values[:, at] - ocp.state_upper[at], 1.0),
                (lower, ocp.state_lower[at] - values[:, at], -1.0),
            ):
                near = largest_adjacent_excess(when, places[order], np.maximum(excess, 0.0))
                bound[index[:, own]] -= sign * _BACK_OFF_FACTOR * near / scale
    before = getattr(nlp, names[0]), getattr(nlp, names[1])
    crossed = lower > upper
    lower[crossed], upper[crossed] = before[0][crossed], before[1][crossed]
    return replace(nlp, **dict(zip(names, (lower, upper), strict=True)))


def back_off_uniformly(nlp: Nlp, excess: Mapping[str, float]) -> Nlp:
    """Return the NLP with both bounds of all rows of these names backed off by their excess.

    `excess`: in units of the row; bounds are reduced to 5 % of their value at least.
    """
    lower, upper = nlp.lower_g.copy(), nlp.upper_g.copy()
    for block in nlp.rows.items:
        if block.rows.name in excess:
            own = slice(block.offset, block.offset + block.size)
            step = _BACK_OFF_FACTOR * excess[block.rows.name]
            upper[own] = np.maximum(upper[own] - step, 0.05 * upper[own])
            lower[own] = np.minimum(lower[own] + step, 0.05 * lower[own])
    return replace(nlp, lower_g=lower, upper_g=upper)


def _dense_times(transcription: Transcription, x: np.ndarray) -> np.ndarray:
    """Return points (K,) of every interval of a motion [s]."""
    steps, breaks = transcription.steps(x), transcription.breaks(x)
    inside = np.linspace(0.0, 1.0, _POINTS_PER_INTERVAL, endpoint=False)
    return np.append((breaks[:-1, None] + steps[:, None] * inside).ravel(), breaks[-1])


def backed_off(margin: float, excess: float) -> float:
    """Return the relative back-off of a limit after a motion has exceeded it by a share.

    The bound is divided by the relative excess: it stays above zero however often it is backed off.
    """
    return 1.0 - (1.0 - margin) / (1.0 + excess)


def largest_adjacent_excess(
    times: np.ndarray, places: np.ndarray, excess: np.ndarray
) -> np.ndarray:
    """Return the largest excess (k, m) between each place and its neighbours."""
    after = np.clip(np.searchsorted(places, times - 1e-12), 0, len(places) - 1)
    before = np.clip(np.searchsorted(places, times + 1e-12, side="right") - 1, 0, None)
    found = np.zeros((len(places), excess.shape[1]))
    np.maximum.at(found, before, excess)
    np.maximum.at(found, after, excess)
    return found
