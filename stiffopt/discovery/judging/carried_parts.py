"""Parts that the arm carries for a while: intervals from grasp to release, by hidden Markov model.

A gripper takes a part and lets it go in the middle of a run, or one run is made with a tool that
the others lack. Bodies of a model are constant: their fit takes half of the part for a mass, the
other half for friction. An instant is with or without the part; Viterbi's algorithm finds the
intervals, least squares the part, in turn (Rabiner 1989), beside any base parameters and friction.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.prepared_run import PreparedRun
from stiffopt.discovery.judging.two_states import MIN_VARIANCE, Instants, intervals_of
from stiffopt.discovery.signals import PARAMETERS_PER_BODY
from stiffopt.discovery.thresholds import NAMED_EVIDENCE
from stiffopt.recording.run import Interval

# Instants of all runs together: an interval's ends are resolved by a few hundredths of a second in
# minutes of recording, and a fit takes a tenth of a second.
_MAX_INSTANTS = 4000
# Mass and first moments among the inertial parameters of a body; its inertia follows in the search.
_LOAD_PARAMETERS = 4
# Halvings of a run into the windows that a part is sought in, and the best ones that are refined.
_WINDOW_HALVINGS, _REFINED_WINDOWS = 3, 3
# Alternations of intervals and part.
_MAX_ALTERNATIONS = 60
# Fits with joints weighted by the residual of the fit before.
_REWEIGHTING_ROUNDS = 3
# Knots of a force by the tool's place, and of a torque by the joint's angle.
_KNOT_COUNT = 8
# Relative eigenvalue below which a combination of base parameters is not excited.
_MIN_EIGENVALUE = 1e-9


def find_carried_parts(
    robot: RobotModel, runs: Sequence[PreparedRun]
) -> tuple[tuple[Interval, ...], ...]:
    """Return for each run the intervals (begin, end) [s] in which the arm carries a part.

    Empty for all runs unless a part explains their torques better than base parameters and friction
    of each joint alone, and than an offset of each joint in these intervals, one force there, a
    force at the tool by its place, as of a contact, or a torque of each joint by its angle.
    """
    total = sum(len(run.time) for run in runs)
    step = max(max(run.low_pass.step for run in runs), -(-total // _MAX_INSTANTS))
    nothing: tuple[tuple[Interval, ...], ...] = ((),) * len(runs)
    instants = Instants(
        run=np.concatenate([np.full(len(run.time[::step]), k) for k, run in enumerate(runs)]),
        time=np.concatenate([run.time[::step] for run in runs]),
        used=np.concatenate([(run.torque_used & run.moving)[::step] for run in runs]),
    )
    if not instants.used.any():
        return nothing
    base = _BaseFit(robot, runs, instants, step)
    carried = base.best()
    if carried is None:
        return nothing
    inside = carried[:, None, None]
    levers = np.concatenate([run.signals.tool_levers[::step, :, :3] for run in runs])
    places = np.concatenate([run.signals.tool_position[::step] for run in runs])
    angles = np.concatenate([run.signals.link_position[::step] for run in runs])
    rivals = (
        None,
        levers * inside,
        _offsets(instants, carried),
        _by_value(levers, places),
        _by_value(np.broadcast_to(np.eye(robot.n), (len(angles), robot.n, robot.n)), angles),
    )
    gains = base.evidence_over(base.load * inside, rivals)
    gains[0] -= instants.switch_price(carried)
    if min(gains) < NAMED_EVIDENCE:
        return nothing
    each = [instants.run == k for k in range(len(runs))]
    return tuple(intervals_of(instants.time[own], carried[own]) for own in each)


def find_known_part(
    time: np.ndarray, used: np.ndarray, without: np.ndarray, beside: np.ndarray
) -> tuple[Interval, ...]:
    """Return the intervals in which a run carries a part of known torques.

    `used` (K, n): samples to compare. `without`, `beside` (K, n): residuals of the torques without
    and with the part [N m].
    """
    every = max(1, -(-len(time) // _MAX_INSTANTS))
    known = used[::every]
    instants = Instants(np.zeros(len(known), dtype=int), time[::every], known)
    carried, _ = instants.assign_states(without[::every], beside[::every])
    return intervals_of(instants.time, carried)


def _base_columns(robot: RobotModel, run: PreparedRun, step: int) -> np.ndarray:
    """Return columns (m, n, p) of offsets, friction and rotor of each joint, and of all bodies."""
    signals, places = run.signals, slice(None, None, step)
    speed, load = signals.motor_velocity[places], signals.spring_torque[places]
    side, rotor = signals.motor_direction[places], signals.motor_acceleration[places]
    terms = (np.ones_like(speed), side, np.abs(load) * side, speed, speed * np.abs(speed), rotor)
    # Each joint has terms of its own.
    own = np.concatenate([term[..., None] * np.eye(robot.n) for term in terms], axis=2)
    links = run.links
    motion = (links.position, links.velocity, links.acceleration)
    return np.concatenate([own, robot.body_regressor(*(x[places] for x in motion))], axis=2)


def _offsets(instants: Instants, carried: np.ndarray) -> np.ndarray:
    """Return columns (m, n, p) of an offset of each joint in each interval."""
    n, columns = instants.used.shape[1], []
    edges = np.flatnonzero(np.diff(carried, prepend=0) | np.diff(instants.run, prepend=-1))
    for first, last in zip(edges, [*edges[1:], len(carried)], strict=True):
        if carried[first]:
            inside = np.zeros(len(carried))
            inside[first:last] = 1.0
            columns.append(inside[:, None, None] * np.eye(n))
    return np.concatenate(columns, axis=2)


def _by_value(columns: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return columns (m, n, k) times piecewise linear functions of values (m, k): (m, n, p)."""
    found = []
    for column, value in zip(np.moveaxis(columns, 2, 0), values.T, strict=True):
        knots = np.linspace(value.min(), value.max(), _KNOT_COUNT)
        step = max(float(knots[1] - knots[0]), 1e-9)
        hats = np.maximum(1.0 - np.abs(value[:, None] - knots) / step, 0.0)
        found.append(column[:, :, None] * hats[:, None])
    return np.concatenate(found, axis=2)


class _BaseFit:
    """Least squares of base parameters and friction beside columns that act for a while."""

    def __init__(
        self, robot: RobotModel, runs: Sequence[PreparedRun], instants: Instants, step: int
    ) -> None:
        self._instants, used = instants, instants.used
        self._columns = np.concatenate([_base_columns(robot, run, step) for run in runs])
        # (m, n, 4) torques per load parameter of the last body, which ends the columns.
        first = self._columns.shape[2] - PARAMETERS_PER_BODY * (robot.n - np.argmax(robot.order))
        self.load = self._columns[..., first : first + _LOAD_PARAMETERS]
        left = np.concatenate([_filtered_residual(run)[::step] for run in runs])
        self._residuals = np.where(used, left, 0.0)
        self._set_noise(np.sqrt(instants.mean_squares(self._residuals)))
        self._set_noise_beside(None)

    def _set_noise_beside(self, columns: np.ndarray | None) -> None:
        """Weight joints by the residual that the base and columns (m, n, p) leave."""
        left, _ = self._residual(columns)
        self._set_noise(self._noise * np.sqrt(self._instants.mean_squares(left)))

    def _set_noise(self, noise: np.ndarray) -> None:
        """Weight joints by their noise (n,), and span the weighted columns."""
        self._noise = np.maximum(noise, 1e-9 * noise.max())
        weighted = self._rows(self._columns)
        size = np.linalg.norm(weighted, axis=0)
        weighted = weighted[:, size > 0.0] / size[size > 0.0]
        values, vectors = np.linalg.eigh(weighted.T @ weighted)
        kept = values > _MIN_EIGENVALUE * values[-1]
        self._span = weighted @ (vectors[:, kept] / np.sqrt(values[kept]))
        target = (self._residuals / self._noise)[self._instants.used]
        self._target = target - self._span @ (self._span.T @ target)

    def _rows(self, columns: np.ndarray) -> np.ndarray:
        """Return the used rows (r, p) of columns (m, n, p), over the noise."""
        return np.asarray((columns / self._noise[:, None])[self._instants.used])

    def _beside_base(self, columns: np.ndarray) -> np.ndarray:
        rows = self._rows(columns)
        return np.asarray(rows - self._span @ (self._span.T @ rows))

    def _part(self, carried: np.ndarray) -> np.ndarray:
        """Return the load parameters (4,) that fit best if carried at these instants."""
        columns = self._beside_base(self._load_while(carried))
        return np.asarray(np.linalg.lstsq(columns, self._target)[0])

    def _load_while(self, carried: np.ndarray) -> np.ndarray:
        """Return the torques (m, n, 4) per load parameter while a part is carried."""
        return np.asarray(self.load * carried[:, None, None])

    def evidence_over(
        self, columns: np.ndarray, rivals: Sequence[np.ndarray | None]
    ) -> list[float]:
        """Return the log evidence of columns (m, n, p) over each rival's, by BIC.

        Residuals of inexact models are correlated: the likelihood counts the independent ones that
        the columns leave.
        """
        instants = self._instants
        left, count = self._residual(columns)
        square = np.maximum(instants.mean_squares(left), MIN_VARIANCE)
        independent = instants.independent(left)
        price = 0.5 * float(np.log(max(independent.sum(), 1.0)))
        gains = []
        for rival in rivals:
            other, more = self._residual(rival)
            ratio = np.maximum(instants.mean_squares(other), MIN_VARIANCE) / square
            fit = 0.5 * float(independent @ np.log(ratio))
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
            self._set_noise_beside(self._load_while(carried))
        return self._alternate(carried)

    def _windows(self) -> list[np.ndarray]:
        """Return the windows (m,) in which an added part explains most."""
        scored: list[tuple[float, int, np.ndarray]] = []
        load = self._rows(self.load)
        instant = np.nonzero(self._instants.used)[0]
        for run in np.unique(self._instants.run):
            own = self._instants.run == run
            time = self._instants.time[own]
            for halving in range(_WINDOW_HALVINGS + 1):
                length = float(np.ptp(time)) / 2**halving
                for begin in time[0] + 0.5 * length * np.arange(2 ** (halving + 1) - 1):
                    inside = own & (self._instants.time >= begin)
                    window = (inside & (self._instants.time <= begin + length)).astype(int)
                    # Of a window's rows alone: the target has no part in the span of the base.
                    rows = window[instant] > 0
                    inner = self._span[rows].T @ load[rows]
                    squares = load[rows].T @ load[rows] - inner.T @ inner
                    moment = load[rows].T @ self._target[rows]
                    gain = float(moment @ np.linalg.lstsq(squares, moment)[0])
                    scored.append((gain, len(scored), window))
        return [window for *_, window in sorted(scored, reverse=True)[:_REFINED_WINDOWS]]

    def _alternate(
        self, carried: np.ndarray, *, correlated: bool = True
    ) -> tuple[np.ndarray, float]:
        """Alternate the part and its instants (m,); return them with their log likelihood."""
        likelihood = -np.inf
        for _ in range(_MAX_ALTERNATIONS):
            part = self._part(carried)
            own = self.load @ part
            rows = self._rows((own * carried[:, None])[..., None])[:, 0]
            without = np.zeros(self._instants.used.shape)
            # Residual of the base that was fitted beside the part.
            without[self._instants.used] = self._target + self._span @ (self._span.T @ rows)
            without *= self._noise
            now, likelihood = self._instants.assign_states(
                without, without - own, correlated=correlated
            )
            if np.array_equal(now, carried):
                break
            carried = now
        return carried, likelihood


def _filtered_residual(run: PreparedRun) -> np.ndarray:
    """Return the filtered torques (K, n) less those of the nominal model [N m]; 0 if unknown."""
    known = np.isfinite(run.torque)
    return run.low_pass(np.where(known, run.torque - run.signals.drive_torque, 0.0))
