"""Residual that no effect of the catalogue explains: channels, and signals that it depends on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from stiffopt.discovery.comparison.channel_rows import noise_above_cutoff
from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.judging.splines import inner_knots, predict_blocks, splines_at
from stiffopt.discovery.names import channel_name
from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.search.search import SearchResult
from stiffopt.discovery.search.tournament import EQUAL_RESIDUALS
from stiffopt.discovery.thresholds import (
    EXPLAINED_SHARE,
    FAINT_SHARE,
    MIN_ACTIVE_SHARE,
    PASSED_OVER_RATIO,
    REMAINDER_RATIO,
    REMAINDER_SHARE,
    UNEXPLAINED_RATIO,
)

# Spline regression of a residual: inner knots, maximum number of signals, least decrease by one
# more.
_KNOT_COUNT = 6
_MAX_REGRESSORS = 3
# Number of phases of waves in memory at a time.
_MAX_PHASES = 2**17
_MIN_RELATIVE_GAIN = 0.03
# Least ratio of the residual of the dominant run to that of any other.
_DOMINANT_RUN_RATIO = 5.0


@dataclass(frozen=True)
class HeldOutExcess:
    """The part of a held-out run whose residual exceeds that of all training runs."""

    run: str
    # begin, end: times of the run [s].
    begin: float
    end: float
    ratio: float  # largest residual over the noise


@dataclass(frozen=True)
class Unexplained:
    """Residual beyond the catalogue."""

    channels: tuple[str, ...]  # "torque_3", "link_position_3"; the worst first
    # Signals that the residual of the worst channel depends on: "q_5", "sign(qd_3)", "time".
    regressors: tuple[str, ...]
    period: float | None  # of a residual that is periodic in time, independent of the motion [s]
    # Share of the residual's excess that a spline model of these explains in blocks left out.
    gain: float
    ratio: float  # normalised residual of the worst channel
    left: float = 1.0  # root mean square in that channel over that of the nominal model
    # True for bursts above the filter's band: `ratio` is that of the bursts, `gain` their share.
    brief: bool = False
    # Training run with nearly all of the nominal residual in the worst channel, and the ratio to
    # any other run.
    alone: tuple[str, float] | None = None
    tool_force: ToolForce | None = None  # forces at the tool that explain it
    held_out: HeldOutExcess | None = None  # of a held-out run alone: training leaves nothing


ChannelOutcome = Literal["named", "nothing", "outside"]


@dataclass(frozen=True, kw_only=True)
class ChannelVerdict:
    """Verdict on one channel, whatever is found in others."""

    channel: str  # such as "torque_3"
    # "named": findings explain its residual; "nothing": nominal values within tolerance do;
    # "outside": a residual remains that findings do not explain.
    verdict: ChannelOutcome
    # before, after: residual over noise with nominal values within tolerance, and with the
    # findings.
    before: float
    after: float
    acted_on: bool  # a finding contributes to the channel


def judge_channels(
    result: SearchResult, findings: Sequence[LocatedEffect], unexplained: Unexplained | None
) -> tuple[ChannelVerdict, ...]:
    """Return the verdict on every recorded channel.

    `unexplained`: of all channels, beside the findings.
    """
    comparison, n = result.comparison, result.comparison.robot.n
    acted = _mark_affected_channels(comparison, findings)
    open_names = () if unexplained is None else unexplained.channels
    found = []
    for c in (int(each) for each in comparison.rows.channels):
        name, before = channel_name(c, n), float(result.calibrated[c])
        needed = before > UNEXPLAINED_RATIO * comparison.least[c]
        verdict: ChannelOutcome = "named" if needed and acted[c] else "nothing"
        seen = unexplained is None or not (unexplained.brief or unexplained.held_out)
        if name in open_names and (not seen or not acted[c] or _is_open(result, c)):
            verdict = "outside"
        found.append(
            ChannelVerdict(
                channel=name,
                verdict=verdict,
                before=before,
                after=float(result.after[c]),
                acted_on=bool(acted[c]),
            )
        )
    return tuple(found)


def _is_open(result: SearchResult, channel: int) -> bool:
    """Return True where the findings leave a channel's residual unexplained."""
    least = float(result.comparison.least[channel])
    before, after = float(result.calibrated[channel]), float(result.after[channel])
    if not after > UNEXPLAINED_RATIO * least:
        return False
    explained = _explained_share(before, after, least)
    return explained < EXPLAINED_SHARE or after > PASSED_OVER_RATIO * least


def _mark_affected_channels(
    comparison: Comparison, findings: Sequence[LocatedEffect]
) -> np.ndarray:
    """Return True for channels (2 n,) that a finding contributes to."""
    affected = np.zeros(2 * comparison.robot.n, dtype=bool)
    for located in findings:
        squares = np.sum(comparison.effect_columns(located) ** 2, axis=1)
        by_channel = np.bincount(comparison.rows.channel, squares, minlength=len(affected))
        affected |= by_channel > MIN_ACTIVE_SHARE * by_channel.max()
    return affected


def assess_findings(result: SearchResult) -> tuple[tuple[Selected, ...], Unexplained | None]:
    """Select findings that explain their channels, and describe the unexplained residual.

    The latter is None without a significant residual.
    """
    after = np.nan_to_num(result.after, nan=0.0)
    before = np.nan_to_num(result.calibrated, nan=0.0)
    # The open residual of a starting model counts as noise.
    least = result.comparison.least
    beyond = after / least
    remaining = [c for c in np.argsort(-beyond) if beyond[c] > UNEXPLAINED_RATIO]
    if not remaining:
        return result.selected, None
    excess = np.maximum(before**2 - least**2, 1e-9)
    share = 1.0 - (after**2 - least**2) / excess
    poor = {int(c) for c in remaining if share[c] < EXPLAINED_SHARE}
    # Calibrated values exist in any case, even beside a large residual.
    kept = tuple(s for s in result.selected if s.channel not in poor or s.located.calibrated)
    if not poor and kept and after[remaining].max() < PASSED_OVER_RATIO:
        valued = _residual_beside_values(result)
        if all(
            _explained_share(valued[c], after[c], least[c]) > EXPLAINED_SHARE for c in remaining
        ):
            # Error of inexact formulas, small against the part that they explain.
            return kept, None
    # The worst first that findings leave open.
    ordered = [int(c) for c in remaining]
    ordered.sort(key=lambda c: (not _is_open(result, c), -beyond[c]))
    found = _describe_remainder(result, ordered)
    small = found.ratio < REMAINDER_RATIO * _noise_excess(result)
    told = [s for s in kept if not s.located.calibrated]
    if not told and small and found.gain < REMAINDER_SHARE:
        # Neither large nor predictable: the noise exceeds the stated one.
        return result.selected, None
    if found.gain < FAINT_SHARE:
        # Hardly a dependence: some signal or frequency explains a little of any residual.
        found = replace(found, regressors=(), period=None)
    return kept, found


def _explained_share(before: float, after: float, least: float) -> float:
    """Return the share of a channel's excess over its noise that a model removes."""
    return 1.0 - (after**2 - least**2) / max(before**2 - least**2, 1e-9)


def _residual_beside_values(result: SearchResult) -> np.ndarray:
    """Return the normalised residual (2 n,) with values that the nominal model does not state.

    Friction that every joint has explains much of a torque, but nothing of what is left beside it.
    """
    values = [each.located for each in result.selected if each.located.calibrated]
    if not values:
        return np.asarray(result.calibrated)
    return result.comparison.channel_ratio(result.comparison.fit(values).residual)


def _noise_excess(result: SearchResult) -> float:
    """Return the noise of the worst channel above the cutoff over the stated noise; at least 1."""
    comparison = result.comparison
    worst = int(np.nanargmax(result.after))
    held = noise_above_cutoff(comparison.nominal_runs) / comparison.noise.stacked
    return float(np.nanmax([1.0, held[worst]]))


def _find_dominant_run(comparison: Comparison, rows: np.ndarray) -> tuple[str, float] | None:
    """Return the run with by far the largest nominal residual in these rows, and the ratio."""
    number, target = comparison.rows.run[rows], comparison.target[rows]
    left = {
        run.name: float(np.sqrt(np.mean(target[number == k] ** 2)))
        for k, run in enumerate(comparison.runs)
        if (number == k).any()
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
    time = rows.sample_signal(lambda run: run.time)[own]
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
    """Yield spline bases (m, k) of the signals that a residual may depend on."""
    rows = comparison.rows
    n = comparison.robot.n

    def samples(name: str) -> np.ndarray:
        return np.asarray(rows.sample_signal(lambda run: getattr(run.signals, name))[own])

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
    return splines_at(inner_knots(values, _KNOT_COUNT), values)


def _select_regressors(
    residual: np.ndarray, block: np.ndarray, bases: dict[str, np.ndarray]
) -> tuple[tuple[str, ...], np.ndarray]:
    """Select signals that predict blocks left out; return them and the prediction."""
    chosen: list[str] = []
    prediction = np.zeros_like(residual)
    left = float(np.sum(residual**2))
    while len(chosen) < _MAX_REGRESSORS:
        tries = {}
        for name in bases:
            if name in chosen:
                continue
            columns = np.hstack([bases[c] for c in (*chosen, name)])
            tries[name] = predict_blocks(columns, residual, block, ridge=1.0)
        squares = {name: float(np.sum((residual - fit) ** 2)) for name, fit in tries.items()}
        now = min(squares.values())
        # Of collinear signals the first, whatever the rounding.
        best = next(name for name in tries if squares[name] <= (1.0 + EQUAL_RESIDUALS) * now)
        if now > (1.0 - _MIN_RELATIVE_GAIN) * left:
            break
        chosen.append(best)
        prediction, left = tries[best], now
    return tuple(chosen), prediction


def _wave_power(residual: np.ndarray, time: np.ndarray, frequencies: np.ndarray) -> np.ndarray:
    """Return the squares (f,) that a wave of each frequency removes from a residual (m,)."""
    turns = 2.0 * np.pi * frequencies[:, None] * time
    waves = np.stack([np.sin(turns), np.cos(turns)], axis=1)
    moments = waves @ residual
    # A block with few samples can make the normal equations singular.
    inverse = np.linalg.pinv(waves @ waves.swapaxes(1, 2), hermitian=True)
    return np.asarray(np.einsum("fi,fij,fj->f", moments, inverse, moments))


def _find_period(
    residual: np.ndarray, block: np.ndarray, time: np.ndarray
) -> tuple[float, float] | None:
    """Return the common period of all blocks and the share of the excess that it explains.

    The phase is free in each block, since external causes are not synchronous with runs.
    """
    span = min(float(np.ptp(time[block == b])) for b in np.unique(block))
    step = float(np.median(np.diff(np.unique(time))))
    if span <= 0.0 or step <= 0.0:
        return None
    frequencies = np.arange(2.0 / span, 0.35 / step, 0.2 / span)
    if not frequencies.size:
        return None  # blocks are shorter than two resolvable periods
    power = np.zeros(len(frequencies))
    for b in np.unique(block):
        own = block == b
        many = max(1, _MAX_PHASES // int(own.sum()))
        for part in (slice(k, k + many) for k in range(0, len(frequencies), many)):
            power[part] += _wave_power(residual[own], time[own], frequencies[part])
    best = int(np.argmax(power))
    excess = float(np.sum(residual**2)) - len(residual)
    blocks = len(np.unique(block))
    # By chance the best frequency of one block has a power of about ln(frequencies), a common one
    # far less.
    if power[best] < 12.0 * blocks + 4.0 * np.log(len(frequencies)) or excess <= 0.0:
        return None
    return 1.0 / float(frequencies[best]), float(min(power[best] / excess, 1.0))


# Least residual over noise that is tested, and largest share of its square, per degree of freedom,
# that forces at the tool may leave.
_MIN_RATIO, _MAX_LEFT_SHARE = 3.0, 0.05
# Joints with torque beyond the three that any force explains.
_MIN_SPARE_JOINTS = 1
# Percentile of the forces that is stated as their size.
_SIZE_PERCENTILE = 95.0


@dataclass(frozen=True, kw_only=True)
class ToolForce:
    """Forces at the tool that explain a residual."""

    explained: float  # share of the squared residual of the torques
    size: float  # force exceeded in a twentieth of the time [N]
    # Length of the mean force in the base frame over the root mean square, 0 to 1.
    steadiness: float


def explain_by_tool_force(
    result: SearchResult, unexplained: Unexplained | None
) -> Unexplained | None:
    """Return an unexplained residual with the forces at the tool that explain it, if any do.

    A force that changes along the motion (a person who guides the arm, a hose, a touch) predicts
    nothing of other runs and is no effect of the catalogue. But three numbers an instant explain
    the torques of all joints, where anything else needs as many numbers as there are joints.
    """
    if unexplained is None or unexplained.ratio < _MIN_RATIO:
        return unexplained
    found = [_fit_tool_force(result, rows) for rows in (result.fit.residual, result.target)]
    best = max((each for each in found if each), key=lambda each: each.explained, default=None)
    return replace(unexplained, tool_force=best)


def _fit_tool_force(result: SearchResult, residual: np.ndarray) -> ToolForce | None:
    """Fit a force at every instant; None where too little of the residual is explained by it."""
    comparison = result.comparison
    rows, n = comparison.rows, comparison.robot.n
    forces, before, after, spare = [], 0.0, 0.0, 0
    for index, run in enumerate(comparison.runs):
        own = (rows.run == index) & (rows.channel < n)
        instants, at = np.unique(rows.sample[own], return_inverse=True)
        left = np.zeros((len(instants), n))
        seen = np.zeros(left.shape, dtype=bool)
        left[at, rows.channel[own]] = residual[own]
        seen[at, rows.channel[own]] = True
        size = run.low_pass.noise_gain * rows.noise.torque
        lever = -run.signals.tool_jacobian[instants] / size
        for torque, columns, known in zip(left, lever, seen, strict=True):
            rank = int(np.linalg.matrix_rank(columns[:, known]))
            if known.sum() < rank + _MIN_SPARE_JOINTS:
                continue
            force, *_ = np.linalg.lstsq(columns[:, known].T, torque[known], rcond=1e-3)
            rest = torque[known] - force @ columns[:, known]
            forces.append(force)
            before += float(torque[known] @ torque[known]) * (known.sum() - rank) / known.sum()
            after += float(rest @ rest)
            spare += int(known.sum()) - rank
    if not spare or before < _MIN_RATIO**2 * spare or after > _MAX_LEFT_SHARE * before:
        return None
    every = np.array(forces)
    rms = float(np.sqrt(np.mean(np.sum(every**2, axis=1))))
    return ToolForce(
        explained=1.0 - after / before,
        size=float(np.percentile(np.linalg.norm(every, axis=1), _SIZE_PERCENTILE)),
        steadiness=float(np.linalg.norm(every.mean(axis=0))) / max(rms, 1e-12),
    )
