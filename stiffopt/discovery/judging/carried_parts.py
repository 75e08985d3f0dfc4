"""Parts that the arm carries for a while: intervals from grasp to release, by hidden Markov model.

A gripper takes a part and lets it go in the middle of a run, or one run is made with a tool that
the others lack. Bodies of a model are constant: their fit takes half of the part for a mass, the
other half for friction. An instant is with or without the part; Viterbi's algorithm finds the
intervals, least squares the part, in turn (Rabiner 1989), beside any base parameters and friction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.prepared_run import PreparedRun
from stiffopt.discovery.thresholds import NAMED_EVIDENCE
from stiffopt.recording.run import Interval

# Instants of all runs together: an interval's ends are resolved by a few hundredths of a second in
# minutes of recording, and a fit takes a tenth of a second.
_MAX_INSTANTS = 4000
# Mass and first moments among the inertial parameters of a body; its inertia follows in the search.
_LOAD_PARAMETERS = 4
# Halvings of a run into the windows that a part is sought in, and the best ones that are refined.
_WINDOW_HALVINGS, _REFINED_WINDOWS = 3, 3
# Alternations of intervals and part, and of intervals and noise.
_MAX_ALTERNATIONS, _MAX_NOISE_ROUNDS = 60, 4
# Fits with joints weighted by the residual of the fit before.
_REWEIGHTING_ROUNDS = 3
# Relative eigenvalue below which a combination of base parameters is not excited.
_MIN_EIGENVALUE = 1e-9


@dataclass(frozen=True, eq=False)
class _Instants:
    """Torque residuals and torques of a body at the hand, at instants (m,) of several runs."""

    run: np.ndarray  # (m,) index of the run
    time: np.ndarray  # (m,) [s]
    used: np.ndarray  # (m, n) compared: the joint moves and its torque is known
    residual: np.ndarray  # (m, n) torque that the model leaves [N m]; 0 where not used
    body: np.ndarray  # (m, n, 10) torques per inertial parameter of the last body; 0 alike


def find_carried_parts(
    robot: RobotModel, runs: Sequence[PreparedRun]
) -> tuple[tuple[Interval, ...], ...]:
    """Return for each run the intervals (begin, end) [s] in which the arm carries a part.

    Empty for all runs unless a part explains their torques better than base parameters and friction
    of each joint alone, and than an offset of each joint in these intervals, or one force.
    """
    nothing: tuple[tuple[Interval, ...], ...] = ((),) * len(runs)
    step = _step(runs)
    rows = [_instants_of(robot, run, k, step) for k, run in enumerate(runs)]
    fields = zip(*(vars(own).values() for own in rows), strict=True)
    instants = _Instants(*(np.concatenate(part) for part in fields))
    if not instants.used.any():
        return nothing
    columns = np.concatenate([_base_columns(robot, run, step) for run in runs])
    base = _BaseFit(instants, columns)
    found = base.best()
    if found is None:
        return nothing
    carried = found
    part = _load_columns(instants, carried)
    levers = np.concatenate([run.signals.tool_levers[::step, :, :3] for run in runs])
    rivals = (None, levers * carried[:, None, None], _offsets(instants, carried))
    gains = base.evidence_over(part, rivals)
    gains[0] -= _switch_price(instants, carried)
    if min(gains) < NAMED_EVIDENCE:
        return nothing
    return tuple(
        _intervals(instants.time[instants.run == k], carried[instants.run == k])
        for k in range(len(runs))
    )


def find_known_part(
    time: np.ndarray, used: np.ndarray, without: np.ndarray, beside: np.ndarray
) -> tuple[Interval, ...]:
    """Return the intervals in which a run carries a part of known torques.

    `used` (K, n): samples to compare. `without`, `beside` (K, n): residuals of the torques without
    and with the part [N m].
    """
    every = max(1, -(-len(time) // _MAX_INSTANTS))
    known, first, second = used[::every], without[::every], beside[::every]
    instants = _Instants(
        run=np.zeros(len(known), dtype=int),
        time=time[::every],
        used=known,
        residual=first,
        body=np.empty((0,)),
    )
    carried, _ = _segment(instants, first, second)
    return _intervals(instants.time, carried)


# ---- rows


def _step(runs: Sequence[PreparedRun]) -> int:
    total = sum(len(run.time) for run in runs)
    return max(max(run.low_pass.step for run in runs), -(-total // _MAX_INSTANTS))


def _instants_of(robot: RobotModel, run: PreparedRun, index: int, step: int) -> _Instants:
    signals, places = run.signals, slice(None, None, step)
    motion = (
        getattr(signals, f"link_{kind}")[places]
        for kind in ("position", "velocity", "acceleration")
    )
    known = run.torque_used & run.moving
    left = np.where(np.isfinite(run.torque), run.torque - signals.drive_torque, 0.0)
    used = known[places]
    body = robot.body_torques(int(np.argmax(robot.order)), *motion)
    return _Instants(
        run=np.full(len(used), index),
        time=run.time[places],
        used=used,
        residual=np.where(used, run.low_pass(left)[places], 0.0),
        body=np.where(used[..., None], body, 0.0),
    )


def _base_columns(robot: RobotModel, run: PreparedRun, step: int) -> np.ndarray:
    """Return columns (m, n, p) of offsets, friction and rotor of each joint, and of all bodies."""
    signals, places = run.signals, slice(None, None, step)
    speed, load = signals.motor_velocity[places], signals.spring_torque[places]
    side = signals.motor_direction[places]
    of_joint = np.stack(
        [
            np.ones_like(speed),
            side,
            np.abs(load) * side,
            speed,
            speed * np.abs(speed),
            signals.motor_acceleration[places],
        ],
        axis=2,
    )
    n = robot.n
    own = np.zeros((*speed.shape, n, of_joint.shape[2]))
    for j in range(n):
        own[:, j, j] = of_joint[:, j]
    motion = (
        getattr(signals, f"link_{kind}")[places]
        for kind in ("position", "velocity", "acceleration")
    )
    return np.concatenate([own.reshape(*speed.shape, -1), robot.body_regressor(*motion)], axis=2)


def _load_columns(instants: _Instants, carried: np.ndarray) -> np.ndarray:
    """Return the torques (m, n, 4) per mass and first moment while a part is carried."""
    return np.asarray(instants.body[..., :_LOAD_PARAMETERS] * carried[:, None, None])


def _offsets(instants: _Instants, carried: np.ndarray) -> np.ndarray:
    """Return columns (m, n, p) of an offset of each joint in each interval."""
    n, columns = instants.used.shape[1], []
    edges = np.flatnonzero(np.diff(carried, prepend=0) | np.diff(instants.run, prepend=-1))
    for first, last in zip(edges, [*edges[1:], len(carried)], strict=True):
        if carried[first]:
            inside = np.zeros(len(carried))
            inside[first:last] = 1.0
            columns.append(inside[:, None, None] * np.eye(n))
    return np.concatenate(columns, axis=2)


def _intervals(time: np.ndarray, carried: np.ndarray) -> tuple[Interval, ...]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], carried, [0]])))
    return tuple(
        (float(time[first]), float(time[last - 1]))
        for first, last in zip(edges[::2], edges[1::2], strict=True)
    )


# ---- estimation


class _BaseFit:
    """Least squares of base parameters and friction beside columns that act for a while."""

    def __init__(self, instants: _Instants, columns: np.ndarray) -> None:
        self._instants, self._columns = instants, columns
        self._set_noise(np.sqrt(_mean_squares(instants.residual, instants.used)))
        self._set_noise_beside(None)

    def _set_noise_beside(self, columns: np.ndarray | None) -> None:
        """Weight joints by the residual that the base and columns (m, n, p) leave."""
        left, _ = self._residual(columns)
        self._set_noise(self._noise * np.sqrt(_mean_squares(left, self._instants.used)))

    def _set_noise(self, noise: np.ndarray) -> None:
        """Weight joints by their noise (n,), and span the weighted columns."""
        self._noise = np.maximum(noise, 1e-9 * noise.max())
        weighted = self._rows(self._columns)
        size = np.linalg.norm(weighted, axis=0)
        weighted = weighted[:, size > 0.0] / size[size > 0.0]
        values, vectors = np.linalg.eigh(weighted.T @ weighted)
        kept = values > _MIN_EIGENVALUE * values[-1]
        self._span = weighted @ (vectors[:, kept] / np.sqrt(values[kept]))
        target = (self._instants.residual / self._noise)[self._instants.used]
        self._target = target - self._span @ (self._span.T @ target)

    def _rows(self, columns: np.ndarray) -> np.ndarray:
        """Return the used rows (r, p) of columns (m, n, p), over the noise."""
        return np.asarray((columns / self._noise[:, None])[self._instants.used])

    def _beside_base(self, columns: np.ndarray) -> np.ndarray:
        rows = self._rows(columns)
        return np.asarray(rows - self._span @ (self._span.T @ rows))

    def _part(self, carried: np.ndarray) -> np.ndarray:
        """Return the load parameters (4,) that fit best if carried at these instants."""
        columns = self._beside_base(_load_columns(self._instants, carried))
        return np.asarray(np.linalg.lstsq(columns, self._target)[0])

    def evidence_over(
        self, columns: np.ndarray, rivals: Sequence[np.ndarray | None]
    ) -> list[float]:
        """Return the log evidence of columns (m, n, p) over each rival's, by BIC.

        Residuals of inexact models are correlated: the likelihood counts the independent ones that
        the columns leave.
        """
        used = self._instants.used
        left, count = self._residual(columns)
        square = _mean_squares(left, used)
        independent = used.sum(axis=0) / _correlation(left, used, self._instants.run)
        price = 0.5 * float(np.log(max(independent.sum(), 1.0)))
        gains = []
        for rival in rivals:
            other, more = self._residual(rival)
            ratio = _mean_squares(other, used) / np.maximum(square, 1e-30)
            fit = 0.5 * float(independent @ np.log(np.maximum(ratio, 1e-30)))
            gains.append(fit + (more - count) * price)
        return gains

    def _residual(self, columns: np.ndarray | None) -> tuple[np.ndarray, int]:
        """Return the residual (m, n) beside base and columns over the noise, and their number."""
        rest, count = self._target, 0
        if columns is not None:
            own = self._beside_base(columns)
            values, _, count, _ = np.linalg.lstsq(own, rest)
            rest = rest - own @ values
        left = np.zeros(self._instants.used.shape)
        left[self._instants.used] = rest
        return left, int(count)

    def best(self) -> np.ndarray | None:
        """Return the likeliest instants (m,) with a part; None if it is none or all."""
        tried, start = [], self._noise
        for window in self._windows():
            self._set_noise(start)
            tried.append((*self._refine(window), self._noise))
        carried, _, noise = max(tried, key=lambda found: found[1])
        if not carried.any() or carried.all():
            return None
        self._set_noise(noise)
        if self._part(carried)[0] < 0.0:
            # With the part at all other times the base differs by it, and the fit is the same.
            carried = 1 - carried
        return carried

    def _refine(self, carried: np.ndarray) -> tuple[np.ndarray, float]:
        """Refine the instants (m,) with a part and the noise; return them with their likelihood.

        While a part is missing elsewhere, residuals there look like correlated noise that hides it:
        instants are first assigned as if they were independent.
        """
        for _ in range(_REWEIGHTING_ROUNDS):
            carried, _ = self._alternate(carried, correlated=False)
            self._set_noise_beside(_load_columns(self._instants, carried))
        return self._alternate(carried)

    def _windows(self) -> list[np.ndarray]:
        """Return the windows (m,) in which an added part explains most."""
        scored: list[tuple[float, int, np.ndarray]] = []
        for run in np.unique(self._instants.run):
            own = self._instants.run == run
            time = self._instants.time[own]
            for halving in range(_WINDOW_HALVINGS + 1):
                length = float(np.ptp(time)) / 2**halving
                for begin in time[0] + 0.5 * length * np.arange(2 ** (halving + 1) - 1):
                    inside = own & (self._instants.time >= begin)
                    window = (inside & (self._instants.time <= begin + length)).astype(int)
                    rows = self._beside_base(_load_columns(self._instants, window))
                    fit = rows @ np.linalg.lstsq(rows, self._target)[0]
                    scored.append((float(fit @ fit), len(scored), window))
        return [window for *_, window in sorted(scored, reverse=True)[:_REFINED_WINDOWS]]

    def _alternate(
        self, carried: np.ndarray, *, correlated: bool = True
    ) -> tuple[np.ndarray, float]:
        """Alternate the part and its instants (m,); return them with their log likelihood."""
        likelihood = -np.inf
        for _ in range(_MAX_ALTERNATIONS):
            part = self._part(carried)
            own = self._instants.body[..., :_LOAD_PARAMETERS] @ part
            rows = self._rows((own * carried[:, None])[..., None])[:, 0]
            without = np.zeros(self._instants.used.shape)
            # Residual of the base that was fitted beside the part.
            without[self._instants.used] = self._target + self._span @ (self._span.T @ rows)
            without *= self._noise
            now, likelihood = _segment(
                self._instants, without, without - own, correlated=correlated
            )
            if np.array_equal(now, carried):
                break
            carried = now
        return carried, likelihood


def _segment(
    instants: _Instants, without: np.ndarray, beside: np.ndarray, *, correlated: bool = True
) -> tuple[np.ndarray, float]:
    """Return the likeliest instants (m,) with the part, and their log likelihood.

    `without`, `beside` (m, n): residuals without and with the part [N m]; both are noise whose size
    and correlation are estimated with the instants.
    """
    used = instants.used
    carried = np.sum(np.where(used, without**2 - beside**2, 0.0), axis=1) > 0.0
    likelihood = -np.inf
    for _ in range(_MAX_NOISE_ROUNDS):
        left = np.where(used & carried[:, None], beside, np.where(used, without, 0.0))
        variance = np.maximum(_mean_squares(left, used), 1e-30)
        samples = _correlation(left, used, instants.run) if correlated else np.ones(used.shape[1])
        gain = np.sum((without**2 - beside**2) / (variance * samples), axis=1, where=used)
        before, carried = carried, _viterbi(0.5 * gain, instants.run)
        likelihood = -0.5 * float(used.sum(axis=0) @ np.log(variance))
        if np.array_equal(before, carried):
            break
    carried = carried.astype(int)
    return carried, likelihood - _switch_price(instants, carried)


def _viterbi(gain: np.ndarray, run: np.ndarray) -> np.ndarray:
    """Return True at the instants (m,) of the likelier of two states.

    `gain` (m,): log likelihood of the second state over the first. A change costs the log of the
    number of instants; the first state of a run is free.
    """
    price = np.log(len(gain))
    # Advantage of the second state, and whether each state's best past was the other one.
    came_from_other = np.zeros((len(gain), 2), dtype=bool)
    ahead = 0.0
    advantage = np.empty(len(gain))
    for k, value in enumerate(gain):
        if k and run[k] != run[k - 1]:
            ahead = 0.0
        came_from_other[k] = ahead > price, ahead < -price
        ahead = min(max(ahead, -price), price) + value
        advantage[k] = ahead
    states = np.zeros(len(gain), dtype=bool)
    state = False
    for k in range(len(gain) - 1, -1, -1):
        if k == len(gain) - 1 or run[k] != run[k + 1]:
            state = bool(advantage[k] > 0.0)
        states[k] = state
        if came_from_other[k, int(state)]:
            state = not state
    return states


def _switch_price(instants: _Instants, carried: np.ndarray) -> float:
    """Return the log number of places of all changes, and of all runs begun with the part."""
    same = instants.run[1:] == instants.run[:-1]
    changes = int(np.sum((carried[1:] != carried[:-1]) & same))
    return float((changes + len(np.unique(instants.run))) * np.log(len(carried)))


def _mean_squares(values: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Return the mean squares (n,) of the used values (m, n)."""
    return np.asarray(np.sum(values**2, axis=0, where=used) / np.maximum(used.sum(axis=0), 1))


def _correlation(left: np.ndarray, used: np.ndarray, run: np.ndarray) -> np.ndarray:
    """Return the integrated autocorrelation (n,) of residuals: samples per independent one."""
    found = np.ones(left.shape[1])
    for j, column in enumerate(left.T):
        square = float(column @ column)
        if square == 0.0:
            continue
        for lag in range(1, len(column) // 2):
            same = run[lag:] == run[:-lag]
            value = float(np.sum(column[lag:] * column[:-lag], where=same)) / square
            if value <= 0.0:
                break
            found[j] += 2.0 * value
    return found
