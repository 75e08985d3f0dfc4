"""Loads of the tool for a while, a part or a force: their intervals, by hidden Markov model.

A gripper takes a part and lets it go in the middle of a run, or somebody pushes the arm. Bodies of
a model are constant: their fit takes half of the load for a mass, the other half for friction, and
leaves a residual in all runs. An instant is with or without the load; Viterbi's algorithm finds the
intervals, least squares the load, in turn (Rabiner 1989), beside any base parameters and friction.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

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
# Halvings of a run into the windows that a load is sought in, and the best ones that are refined.
_WINDOW_HALVINGS, _REFINED_WINDOWS = 3, 3
# Alternations of intervals and load.
_MAX_ALTERNATIONS = 60
# Fits with joints weighted by the residual of the fit before.
_REWEIGHTING_ROUNDS = 3
# Knots of a force by the tool's place, and of a torque by the joint's angle.
_KNOT_COUNT = 8
# Speed over the largest one below which more friction is usual.
_SLOW_SHARE = 0.03
# Relative eigenvalue below which a combination of base parameters is not excited.
_MIN_EIGENVALUE = 1e-9


@dataclass(frozen=True, eq=False)
class TemporaryLoad:
    """A load that acts on the tool for a while, the same in all its intervals."""

    is_part: bool  # a body; else a force along fixed axes of the base
    intervals: tuple[tuple[Interval, ...], ...]  # begin and end of each, by run [s]
    torques: np.ndarray  # (n,) largest torque of every joint under the load [N m]
    noise: np.ndarray  # (n,) torques that are left beside it, root mean square [N m]


def find_temporary_load(robot: RobotModel, runs: Sequence[PreparedRun]) -> TemporaryLoad | None:
    """Return the part or the force that acts on the tool for a while; None if neither does.

    It explains the torques better than base parameters and friction of each joint alone, and than
    the other one of both, an offset or dry friction of each joint in these intervals, a force at
    the tool by its place, as of a contact, or a torque of each joint by its angle.
    """
    total = sum(len(run.time) for run in runs)
    step = max(max(run.low_pass.step for run in runs), -(-total // _MAX_INSTANTS))
    instants = Instants(
        run=np.concatenate([np.full(len(run.time[::step]), k) for k, run in enumerate(runs)]),
        time=np.concatenate([run.time[::step] for run in runs]),
        used=np.concatenate([(run.torque_used & run.moving)[::step] for run in runs]),
    )
    if not instants.used.any():
        return None
    levers = np.concatenate([run.signals.tool_levers[::step, :, :3] for run in runs])
    places = np.concatenate([run.signals.tool_position[::step] for run in runs])
    angles = np.concatenate([run.signals.link_position[::step] for run in runs])
    sides = np.concatenate([run.signals.motor_direction[::step] for run in runs])
    each = np.broadcast_to(np.eye(robot.n), (len(angles), robot.n, robot.n))
    part = _BaseFit(robot, runs, instants, step)
    force = part.of_force(levers)
    found: list[tuple[float, TemporaryLoad]] = []
    for fit, other in ((part, force), (force, part)):
        acts = fit.best()
        if acts is None:
            continue
        inside = acts[:, None, None]
        rivals = (
            None,
            other.load * inside,
            _offsets(instants, acts),
            sides[..., None] * each * inside,
            _by_value(levers, places),
            _by_value(each, angles),
        )
        gains = fit.evidence_over(fit.load * inside, rivals)
        gains[0] -= instants.switch_price(acts)
        if min(gains) >= NAMED_EVIDENCE:
            found.append((gains[0], fit.loaded(acts, len(runs))))
    return max(found, key=lambda own: own[0])[1] if found else None


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
    slow = _SLOW_SHARE * np.array([max(j.fastest, 1e-9) for j in signals.constants.joints])
    dry = (side, np.abs(load) * side, side * np.exp(-((speed / slow) ** 2)))
    terms = (np.ones_like(speed), *dry, speed, speed * np.abs(speed), rotor)
    # Each joint has terms of its own.
    own = np.concatenate([term[..., None] * np.eye(robot.n) for term in terms], axis=2)
    links = run.links
    motion = (links.position, links.velocity, links.acceleration)
    return np.concatenate([own, robot.body_regressor(*(x[places] for x in motion))], axis=2)


def _offsets(instants: Instants, acts: np.ndarray) -> np.ndarray:
    """Return columns (m, n, p) of an offset of each joint in each interval."""
    n, columns = instants.used.shape[1], []
    edges = np.flatnonzero(np.diff(acts, prepend=0) | np.diff(instants.run, prepend=-1))
    for first, last in zip(edges, [*edges[1:], len(acts)], strict=True):
        if acts[first]:
            inside = np.zeros(len(acts))
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
        self.is_part = True
        left = np.concatenate([_filtered_residual(run)[::step] for run in runs])
        self._residuals = np.where(used, left, 0.0)
        self._set_noise(np.sqrt(instants.mean_squares(self._residuals)))
        self._set_noise_beside(None)

    def of_force(self, levers: np.ndarray) -> _BaseFit:
        """Return the fit beside a force at the tool, with torques (m, n, 3) per component."""
        found = copy(self)
        found.load, found.is_part = levers, False
        return found

    def loaded(self, acts: np.ndarray, runs: int) -> TemporaryLoad:
        """Return the load that acts at these instants (m,) of so many runs."""
        own = self._load_while(acts)
        left, _ = self._residual(own)
        instants, torques = self._instants, np.abs(own @ self._values(acts))
        each = [instants.run == k for k in range(runs)]
        return TemporaryLoad(
            is_part=self.is_part,
            intervals=tuple(intervals_of(instants.time[k], acts[k]) for k in each),
            torques=torques.max(axis=0, where=instants.used, initial=0.0),
            noise=self._noise * np.sqrt(instants.mean_squares(left)),
        )

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

    def _values(self, acts: np.ndarray) -> np.ndarray:
        """Return the load's parameters (k,) that fit best if it acts at these instants (m,)."""
        columns = self._beside_base(self._load_while(acts))
        return np.asarray(np.linalg.lstsq(columns, self._target)[0])

    def _load_while(self, acts: np.ndarray) -> np.ndarray:
        """Return the torques (m, n, k) per parameter of the load while it acts."""
        return np.asarray(self.load * acts[:, None, None])

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
        """Return the likeliest instants (m,) with the load; None if it is none or all."""
        tried, start = [], self._noise
        for window in self._windows():
            self._set_noise(start)
            tried.append((*self._refine(window), self._noise))
        acts, _, noise = max(tried, key=lambda found: found[1])
        if not acts.any() or acts.all():
            return None
        self._set_noise(noise)
        # With the load at all other times the base differs by it, and the fit is the same: a mass
        # is positive, a force acts for the shorter time.
        other = self._values(acts)[0] < 0.0 if self.is_part else 2 * acts.sum() > len(acts)
        return 1 - acts if other else acts

    def _refine(self, acts: np.ndarray) -> tuple[np.ndarray, float]:
        """Refine the instants (m,) with the load and the noise; return them with their likelihood.

        While the load is missing elsewhere, residuals there look like correlated noise that hides
        it: instants are first assigned as if they were independent.
        """
        for _ in range(_REWEIGHTING_ROUNDS):
            acts, _ = self._alternate(acts, correlated=False)
            self._set_noise_beside(self._load_while(acts))
        return self._alternate(acts)

    def _windows(self) -> list[np.ndarray]:
        """Return the windows (m,) in which an added load explains most."""
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

    def _alternate(self, acts: np.ndarray, *, correlated: bool = True) -> tuple[np.ndarray, float]:
        """Alternate the load and its instants (m,); return them with their log likelihood."""
        likelihood = -np.inf
        for _ in range(_MAX_ALTERNATIONS):
            values = self._values(acts)
            own = self.load @ values
            rows = self._rows((own * acts[:, None])[..., None])[:, 0]
            without = np.zeros(self._instants.used.shape)
            # Residual of the base that was fitted beside the load.
            without[self._instants.used] = self._target + self._span @ (self._span.T @ rows)
            without *= self._noise
            now, likelihood = self._instants.assign_states(
                without, without - own, correlated=correlated
            )
            if np.array_equal(now, acts):
                break
            acts = now
        return acts, likelihood


def _filtered_residual(run: PreparedRun) -> np.ndarray:
    """Return the filtered torques (K, n) less those of the nominal model [N m]; 0 if unknown."""
    known = np.isfinite(run.torque)
    return run.low_pass(np.where(known, run.torque - run.signals.drive_torque, 0.0))
