"""Something is missing that no entry of the catalogue explains: where, and what it depends on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline

from stiffopt.discovery.comparison.channel_noise import above_cutoff
from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.judging.modes import matches_mode
from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.search.search import SearchResult
from stiffopt.discovery.thresholds import (
    EXPLAINED_SHARE,
    FAINT_RATIO,
    FAINT_SHARE,
    PASSED_OVER_RATIO,
    REMAINDER_RATIO,
    REMAINDER_SHARE,
    UNEXPLAINED_RATIO,
)

# Of the flexible functions that a remainder may follow: knots, how many signals, the share of the
# residual that one more must take away, and the ridge.
_KNOT_COUNT = 8
_MAX_REGRESSORS = 3
_MIN_RELATIVE_GAIN = 0.03
_RIDGE_WEIGHT = 1.0
# How many times as much as any other a run must leave to be named for it.
_DOMINANT_RUN_RATIO = 5.0


@dataclass(frozen=True)
class Unexplained:
    """What remains beyond the catalogue.

    Parameters
    ----------
    channels : tuple of str
        "torque_3", "link_position_3"; the worst first.
    regressors : tuple of str
        What the remainder of the worst channel depends on: "q_5", "sign(qd_3)", "time".
    period : float or None
        Of a remainder that repeats in time, whatever the motion [s].
    gain : float
        Share of the remainder's excess that a flexible model of these explains in blocks that it
        was not fitted to.
    ratio : float
        Residual over noise in the worst channel.
    left : float
        Root mean square in that channel over what the nominal model leaves.
    brief : bool
        In bursts, faster than a fit's filter: `ratio` is that where they lie, `gain` their share.
    alone : tuple of (str, float) or None
        The training run that holds nearly all of what the nominal model leaves in the worst
        channel, and how many times as much as any other.
    """

    channels: tuple[str, ...]
    regressors: tuple[str, ...]
    period: float | None
    gain: float
    ratio: float
    left: float = 1.0
    brief: bool = False
    alone: tuple[str, float] | None = None


def assess_findings(result: SearchResult) -> tuple[tuple[Selected, ...], Unexplained | None]:
    """Findings that explain what they are about, and what is outside the catalogue.

    Parameters
    ----------
    result : SearchResult

    Returns
    -------
    findings : tuple of Selected
    unexplained : Unexplained or None
        None where nothing significant remains.
    """
    after = np.nan_to_num(result.after, nan=0.0)
    before = np.nan_to_num(result.calibrated, nan=0.0)
    # What an extended model that was started from had left of its own recordings is no new riddle.
    least = result.comparison.least
    beyond = after / least
    remaining = [c for c in np.argsort(-beyond) if beyond[c] > UNEXPLAINED_RATIO]
    if not remaining:
        return result.selected, None if result.selected else _find_faint_remainder(
            result, after, beyond
        )
    excess = np.maximum(before**2 - least**2, 1e-9)
    share = 1.0 - (after**2 - least**2) / excess
    poor = {int(c) for c in remaining if share[c] < EXPLAINED_SHARE}
    unstated = result.comparison.robot.recordings.unstated
    # A value that the nominal model does not give at all is there, however much else is missing.
    kept = tuple(
        s for s in result.selected if s.channel not in poor or s.located.effect.nominal in unstated
    )
    if not poor and kept and after[remaining].max() < PASSED_OVER_RATIO:
        # What formulas that differ from nature leave behind, small against what they explain.
        return kept, None
    found = _describe_remainder(result, [int(c) for c in remaining])
    if _is_elastic_mode(result, found):
        return kept, None
    small = found.ratio < REMAINDER_RATIO * _noise_excess(result)
    if not kept and small and found.gain < REMAINDER_SHARE:
        # Neither large nor depending on anything: noise that is larger than stated.
        return result.selected, None
    return kept, found


def _find_faint_remainder(
    result: SearchResult, after: np.ndarray, beyond: np.ndarray
) -> Unexplained | None:
    """A remainder near the noise, where runs left out bear out what it depends on."""
    best, most = None, FAINT_SHARE
    # Little more than a model left open far from the noise is as little a riddle.
    near = (beyond > FAINT_RATIO) & (after <= UNEXPLAINED_RATIO)
    for channel in [int(c) for c in np.argsort(-after)[:_MAX_REGRESSORS] if near[c]]:
        found = _describe_remainder(result, [channel])
        taken = found.gain * (1.0 - 1.0 / found.ratio**2)
        if taken > most and not _is_elastic_mode(result, found):
            best, most = found, taken
    return best


def _is_elastic_mode(result: SearchResult, found: Unexplained) -> bool:
    """Whether a remainder is the swing of the arm itself: its period is that of a mode."""
    return found.period is not None and matches_mode(result.comparison, result.fit, found.period)


def _noise_excess(result: SearchResult) -> float:
    """Noise of the worst channel above the filter's cutoff, over what is stated; 1 at least."""
    comparison = result.comparison
    worst = int(np.nanargmax(result.after))
    stated = np.concatenate([comparison.noise.torque, comparison.noise.deflection])
    held = above_cutoff(comparison.nominal_runs)
    return float(np.nanmax([1.0, held[worst] / stated[worst]]))


def channel_name(channel: int, joints: int) -> str:
    """Name of a channel in answers."""
    kind = "torque" if channel < joints else "link_position"
    return f"{kind}_{channel % joints + 1}"


def _find_dominant_run(comparison: Comparison, rows: np.ndarray) -> tuple[str, float] | None:
    """The run in which the nominal model leaves far more of these rows than in all others."""
    number = comparison.rows.sampled(lambda run: np.full(len(run.time), float(run.index)))[rows]
    left = {
        run.name: float(np.sqrt(np.mean(comparison.target[rows][number == run.index] ** 2)))
        for run in comparison.runs
        if (number == run.index).any()
    }
    if len(left) < 2:
        return None
    most, next_most = sorted(left, key=lambda name: -left[name])[:2]
    ratio = left[most] / max(left[next_most], 1e-12)
    return (most, ratio) if ratio > _DOMINANT_RUN_RATIO else None


def _describe_remainder(result: SearchResult, channels: Sequence[int]) -> Unexplained:
    comparison = result.comparison
    rows = comparison.rows
    worst = channels[0]
    own = np.flatnonzero(rows.channel == worst)
    residual, block = result.fit.residual[own], rows.block[own]
    time = rows.sampled(lambda run: run.time)[own]
    period = _find_period(residual, block, time)
    bases = dict(_spline_bases(comparison, own, worst % comparison.robot.n))
    chosen, fitted = _select_regressors(residual, block, bases)
    excess = max(float(np.sum(residual**2)) - len(residual), 1e-9)
    gain = float((np.sum(residual**2) - np.sum((residual - fitted) ** 2)) / excess)
    if period is not None and period[1] > gain:
        chosen, gain = ("time",), period[1]
    return Unexplained(
        channels=tuple(channel_name(c, comparison.robot.n) for c in channels),
        regressors=tuple(chosen),
        period=None if period is None or chosen != ("time",) else period[0],
        gain=float(np.clip(gain, 0.0, 1.0)),
        ratio=float(result.after[worst]),
        alone=_find_dominant_run(comparison, own),
        left=float(result.after[worst] / result.before[worst]),
    )


def _spline_bases(
    comparison: Comparison, own: np.ndarray, joint: int
) -> Iterator[tuple[str, np.ndarray]]:
    """Spline bases of what a remainder may depend on, (m, k) each."""
    rows = comparison.rows
    n = comparison.robot.n

    def samples(name: str) -> np.ndarray:
        return np.asarray(rows.sampled(lambda run: getattr(run.signals, name))[own])

    velocity = samples("motor_velocity")
    side = np.sign(velocity[:, joint])
    yield "session_time", _spline_basis(samples("session_time"))
    for name, label in (
        ("motor_position", "q"),
        ("motor_velocity", "qd"),
        ("spring_torque", "torque"),
        ("motor_acceleration", "qdd"),
    ):
        values = samples(name)
        for j in range(n):
            basis = _spline_basis(values[:, j])
            yield f"{label}_{j + 1}", basis
            yield f"{label}_{j + 1} x sign(qd_{joint + 1})", basis * side[:, None]


def _spline_basis(values: np.ndarray) -> np.ndarray:
    """Cubic B-splines over the range of the values, knots at their quantiles."""
    inner = np.unique(np.quantile(values, np.linspace(0.0, 1.0, _KNOT_COUNT - 2)))
    if len(inner) < 2 or not inner[-1] > inner[0]:
        return np.ones((len(values), 1))
    knots = np.concatenate([[inner[0]] * 3, inner, [inner[-1]] * 3])
    inside = np.clip(values, inner[0], np.nextafter(inner[-1], inner[0]))
    return np.asarray(BSpline.design_matrix(inside, knots, 3).toarray())


def _select_regressors(
    residual: np.ndarray, block: np.ndarray, bases: dict[str, np.ndarray]
) -> tuple[tuple[str, ...], np.ndarray]:
    """Regressors that predict blocks left out, and those predictions."""
    chosen: list[str] = []
    prediction = np.zeros_like(residual)
    left = float(np.sum(residual**2))
    while len(chosen) < _MAX_REGRESSORS:
        tries = {}
        for name in bases:
            if name in chosen:
                continue
            columns = np.hstack([bases[c] for c in (*chosen, name)])
            tries[name] = _predict_blocks(columns, residual, block)
        best = min(tries, key=lambda name: float(np.sum((residual - tries[name]) ** 2)))
        now = float(np.sum((residual - tries[best]) ** 2))
        if now > (1.0 - _MIN_RELATIVE_GAIN) * left:
            break
        chosen.append(best)
        prediction, left = tries[best], now
    return tuple(chosen), prediction


def _predict_blocks(columns: np.ndarray, target: np.ndarray, block: np.ndarray) -> np.ndarray:
    """Prediction of every block from a ridge fit to the others."""
    out = np.zeros_like(target)
    ridge = _RIDGE_WEIGHT * np.eye(columns.shape[1])
    gram, moment = columns.T @ columns, columns.T @ target
    for b in np.unique(block):
        own = block == b
        part = columns[own]
        rest = np.linalg.solve(gram - part.T @ part + ridge, moment - part.T @ target[own])
        out[own] = part @ rest
    return out


def _find_period(
    residual: np.ndarray, block: np.ndarray, time: np.ndarray
) -> tuple[float, float] | None:
    """Period in time that all blocks share, and the share of the excess that it explains.

    Phases are free from block to block: what comes from outside knows no run's begin.
    """
    span = min(float(np.ptp(time[block == b])) for b in np.unique(block))
    step = float(np.median(np.diff(np.unique(time))))
    if span <= 0.0 or step <= 0.0:
        return None
    frequencies = np.arange(2.0 / span, 0.35 / step, 0.2 / span)
    if not frequencies.size:
        return None  # blocks too short for two periods of anything that the rows resolve
    power = np.zeros(len(frequencies))
    for b in np.unique(block):
        own = block == b
        y, t = residual[own], time[own]
        for i, f in enumerate(frequencies):
            wave = np.column_stack([np.sin(2 * np.pi * f * t), np.cos(2 * np.pi * f * t)])
            # Few samples of a block may all lie on the nodes of a wave.
            power[i] += float((wave.T @ y) @ np.linalg.lstsq(wave.T @ wave, wave.T @ y)[0])
    best = int(np.argmax(power))
    excess = float(np.sum(residual**2)) - len(residual)
    blocks = len(np.unique(block))
    # Chance alone gives each block about ln(frequencies) at its own best place, shared far less.
    if power[best] < 12.0 * blocks + 4.0 * np.log(len(frequencies)) or excess <= 0.0:
        return None
    return 1.0 / float(frequencies[best]), float(min(power[best] / excess, 1.0))
