"""Least squares of a closed loop's parameters: residuals of simulated stretches, and the prior."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import lsq_linear

from stiffopt.closed_loop.arm import CommandedArm
from stiffopt.closed_loop.parameters import Parameters
from stiffopt.closed_loop.simulation import (
    STRETCH_SECONDS,
    CommandedRun,
    RunRows,
    divide_rows,
    moving_rows,
    simulate_stretches,
)

# The decrease of the squared deviations that ends a fit: expected of a step, or reached; and
# iterations at most, of a fit that does not come to that (a leg's took 38).
_LEAST_DECREASE, _MAX_ITERATIONS = 0.1, 100
# Decrease over that foreseen by derivatives, from which they need not be simulated anew.
_FOLLOWED_SHARE = 0.5
# Levenberg-Marquardt damping over the curvature: at first, and least after a step that failed. It
# vanishes with steps that succeed: what stated values alone tell, as the scale of all torques, has
# a curvature far below that of the motion, and any damping by the latter holds it. Where no stated
# value tells that scale, it is held so: what a simulation does not follow exactly would drag it.
_FIRST_DAMPING = 1e-3
# Duration of all runs that a fit judges at most, times joints: more adds but time [s]; and that the
# leading parameters are fitted to, and scores read.
MAX_FIT_SECONDS, LEADING_SECONDS = 120.0, 40.0
# Degrees of freedom of the prior: what is expected holds within its deviation or is wrong, and a
# wrong value is not held as if its deviation were known.
_PRIOR_FREEDOM = 4.0
# Division of steps by which the fit's dependence on them is told.
_REFINEMENT_RATIO = 2.0
# Variance of the third difference of independent values over theirs: 1 + 9 + 9 + 1.
_THIRD_DIFFERENCE = 20.0
# Longest lag over which residuals repeat one another [s].
_MAX_REPETITION = 1.0


@dataclass(frozen=True, eq=False)
class Polished:
    """Fitted parameters of a closed loop."""

    parameters: Parameters
    deviations: np.ndarray  # (p,) one standard deviation of each; 0 of those that were not fitted
    # (p,) the same if nothing but the encoders' noise were left.
    attainable: np.ndarray
    # (n,) root mean square of the positions' residual in the training runs [rad].
    residual: np.ndarray
    # (n,) standard deviation of the encoders' noise [rad]; nan of readings that never change.
    noise: np.ndarray
    # (n,) root mean square of what no steps would change [rad].
    discretisation: np.ndarray
    places: np.ndarray  # (m,) fitted parameters
    covariance: np.ndarray  # (m, m) of the fitted parameters
    expected: Parameters  # before the fit
    # (p,) one standard deviation of each; 0 of those that were held.
    expected_deviations: np.ndarray

    def whole_covariance(self) -> np.ndarray:
        """Return the covariance (p, p) of all parameters, 0 of those that were not fitted."""
        found = np.zeros((len(self.deviations),) * 2)
        found[np.ix_(self.places, self.places)] = self.covariance
        np.fill_diagonal(found, self.deviations**2)  # with that of an unstated mass scale
        return found

    def over_gain(self, name: str, stiffness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return a joint parameter over the fitted gain, and its standard deviations (n,).

        Such ratios are told where nothing gives torque a scale. `stiffness` (n,) is the gain that
        the fit began with.
        """
        gain = 1.0 + self.parameters.of("gain")
        value, spread = self.parameters.of(name) / gain, np.zeros_like(gain)
        of_gain, own = (self.parameters.place(each).start for each in ("gain", name))
        for j in range(len(gain)):
            slope = np.zeros(len(self.places))
            slope[self.places == own + j] = 1.0
            slope[self.places == of_gain + j] -= value[j]
            spread[j] = np.sqrt(slope @ self.covariance @ slope) / gain[j]
        return value / stiffness, spread / stiffness


@dataclass(frozen=True, kw_only=True)
class Score:
    """Amplitudes that a fit lacks: what they would be, and how sure they are."""

    evidence: float  # log evidence, by the slopes at the fit
    deviations: float  # largest amplitude over its standard deviation
    amplitudes: tuple[float, ...]
    explained: float  # share of the weighted squares that they would remove


@dataclass(frozen=True, eq=False)
class SimulatedPoint:
    """Residuals (K, n) of all runs, nan where nothing was measured, and derivatives (K, n, m)."""

    residual: np.ndarray
    slopes: np.ndarray
    bounded: bool = True  # squares of simulated positions and derivatives can be summed

    def followed_to(self, residual: np.ndarray, step: np.ndarray) -> SimulatedPoint:
        """Return the point after a step (m,), its derivatives changed by their error there.

        The least change that follows the step (Broyden, Mathematics of Computation 19, 1965).
        """
        missed = np.nan_to_num(residual - self.residual - self.slopes @ step)
        change = missed[..., None] * (step / (step @ step))
        return SimulatedPoint(residual, self.slopes + change)

    def require_bounded(self) -> SimulatedPoint:
        """Return this; raise `FloatingPointError` if the simulation diverges."""
        if not self.bounded:
            raise FloatingPointError("the simulation diverges")
        return self


def _size(point: SimulatedPoint) -> np.ndarray:
    """Return the root mean square (n,) of the residuals, not zero."""
    return np.asarray(np.maximum(np.sqrt(np.nanmean(point.residual**2, axis=0)), 1e-9))


class LoopFit:
    """Normal equations of a fit in units of the prior's deviations.

    `scaled`: a stated value tells the scale of all torques; otherwise it stays where a fit begins.
    `seconds`: duration of all runs that is judged, times joints [s].
    """

    def __init__(
        self,
        loop: CommandedArm,
        runs: Sequence[CommandedRun],
        prior: Parameters,
        deviations: np.ndarray,
        *,
        scaled: bool = True,
        seconds: float = MAX_FIT_SECONDS,
    ) -> None:
        self._loop, self._prior = loop, prior
        self._least_damping = 0.0 if scaled else _FIRST_DAMPING
        # The delay is last and always derived by.
        self._free = np.flatnonzero(deviations[:-1] > 0.0)
        self.places = np.append(self._free, len(deviations) - 1)
        self._size = np.maximum(deviations[self.places], 1e-12)
        self._step = float(np.median(np.concatenate([np.diff(run.time) for run in runs])))
        self._judge(moving_rows(runs, self._step, seconds / loop.n))

    def _judge(self, parts: Sequence[RunRows]) -> None:
        """Judge some rows of the runs."""
        self._stretches, self._leads = divide_rows(parts, self._step)
        self._ends = np.cumsum([part.end - part.first for part in parts])[:-1]

    def polish(self, start: Parameters, say: Callable[[str], object]) -> Polished:
        """Return the fit that begins with some parameters."""
        current, point = self.descend(start, self.evaluate(start).require_bounded(), say)
        spread, expected, attainable = np.zeros((3, len(start.values)))
        covariance, discretisation = self.covariance(current, point)
        if not (np.diag(covariance) > 0.0).all():  # derivatives that grow without bound
            raise FloatingPointError("the simulation diverges")
        noise = self.encoder_noise(point)
        known = np.maximum(np.hypot(np.nan_to_num(noise), discretisation), 1e-9)
        curvature, _ = self._normal_equations(current, point, known)
        attainable[self.places] = self._size * np.sqrt(np.diag(np.linalg.inv(curvature)))
        current, covariance = self._share_delay(current, covariance)
        # A controller reads its encoder: a deadband within its noise is none.
        least = np.zeros(len(start.values))
        least[start.place("deadband")] = np.nan_to_num(noise) ** 2
        covariance += np.diag(least[self.places])
        spread[self.places] = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        expected[self.places] = self._size
        return Polished(
            parameters=current,
            deviations=spread,
            attainable=attainable,
            residual=np.sqrt(np.nanmean(point.residual**2, axis=0)),
            noise=noise,
            discretisation=discretisation,
            places=self.places,
            covariance=covariance,
            expected=self._prior,
            expected_deviations=expected,
        )

    def score(
        self, parameters: Parameters, groups: Sequence[Sequence[int]], more: int
    ) -> list[Score | None]:
        """Score groups of the last `more` amplitudes, with all other parameters free."""
        point = self.evaluate(parameters).require_bounded()
        noise = self.noise(point)
        hessian, gradient = self._normal_equations(parameters, point, noise)
        last = len(hessian) - 1
        new, old = np.arange(last - more, last), np.append(np.arange(last - more), last)
        across = np.linalg.solve(hessian[np.ix_(old, old)], hessian[np.ix_(old, new)]).T
        curvature = hessian[np.ix_(new, new)] - across @ hessian[np.ix_(old, new)]
        slope = gradient[new] - across @ gradient[old]
        whole = float(np.nansum((point.residual / noise) ** 2))
        found: list[Score | None] = []
        for group in groups:
            square, right = curvature[np.ix_(group, group)], slope[group]
            if not group or not np.isfinite(square).all():
                found.append(None)
                continue
            inverse = np.linalg.inv(square)
            moved = -inverse @ right
            gain = 0.5 * float(-moved @ right)
            amplitudes = moved * self._size[new[group]]
            bounds = parameters.amplitude_bounds[-more:][group].T
            if (amplitudes != np.clip(amplitudes, *bounds)).any():
                found.append(None)
                continue
            found.append(
                Score(
                    evidence=gain - 0.5 * float(np.linalg.slogdet(square)[1]),
                    deviations=float(np.max(np.abs(moved) / np.sqrt(np.diag(inverse)))),
                    amplitudes=tuple(amplitudes.tolist()),
                    explained=min(2.0 * gain / whole, 1.0),
                )
            )
        return found

    def misfit(self, parameters: Parameters) -> float:
        """Return the sum of the logarithms of the residuals; infinite if they diverge."""
        point = self.simulate(parameters)
        if not point.bounded:
            return np.inf
        return 0.5 * float(np.log(np.nanmean(point.residual**2, axis=0)).sum())

    def restrict(self, parameters: Parameters, joint: int) -> None:
        """Judge the stretches in which a joint leaves most, of the duration of a leading fit."""
        residual = self.simulate(parameters).require_bounded().residual[:, joint]
        means = np.array([np.nanmean(own**2) for own in self._by_stretch(residual)])
        pairs = list(zip(self._stretches, self._leads, strict=True))
        parts = [RunRows(own.run, own.begin + lead, own.end + 1) for own, lead in pairs]
        rows = np.array([part.end - part.first for part in parts])
        order = np.argsort(means)[::-1]
        most = LEADING_SECONDS / self._loop.n / self._step
        count = max(1, int(np.searchsorted(np.cumsum(rows[order]), most)))
        self._judge([parts[k] for k in sorted(order[:count])])

    @property
    def _stretch_ends(self) -> np.ndarray:
        """Number of judged rows until the end of every stretch but the last."""
        pairs = zip(self._stretches, self._leads, strict=True)
        return np.cumsum([own.end - own.begin + 1 - lead for own, lead in pairs])[:-1]

    def _by_stretch(self, rows: np.ndarray) -> list[np.ndarray]:
        return np.split(rows, self._stretch_ends)

    def evaluate(self, parameters: Parameters) -> SimulatedPoint:
        """Simulate all runs by stretches."""
        return self.simulate(parameters, self._free)

    def simulate(
        self, parameters: Parameters, free: np.ndarray | None = None, refinement: float = 1.0
    ) -> SimulatedPoint:
        """Simulate all runs by stretches, with derivatives by some parameters."""
        found = simulate_stretches(self._loop, self._stretches, parameters, free, refinement)
        residual = [
            each.position[lead:] - own.run.position[own.begin + lead : own.end + 1]
            for each, own, lead in zip(found, self._stretches, self._leads, strict=True)
        ]
        slopes = [each.slopes[lead:] for each, lead in zip(found, self._leads, strict=True)]
        whole = np.concatenate(slopes) * (1.0 if free is None else self._size)
        with np.errstate(over="ignore", invalid="ignore"):
            squares = sum(np.sum(each.position**2) for each in found) + np.sum(whole**2)
        return SimulatedPoint(np.vstack(residual), whole, bool(np.isfinite(squares)))

    def encoder_noise(self, point: SimulatedPoint) -> np.ndarray:
        """Return the standard deviation (n,) of readings that change independently [rad].

        The third difference of white noise has 20 times its variance, that of what else a
        simulation leaves vanishes: held commands, whose steps bend the motion itself, are in it.
        NaN of readings that never change.
        """
        squares, counts = np.zeros((2, self._loop.n))
        for part, own in zip(self._by_stretch(point.residual), self._stretches, strict=True):
            moved = np.ptp(own.run.position[own.begin : own.end + 1], axis=0) > 0.0
            jumps = np.where(moved, np.diff(part, n=3, axis=0), np.nan)
            squares += np.nansum(jumps**2, axis=0)
            counts += np.isfinite(jumps).sum(axis=0)
        mean = squares / np.where(counts > 0.0, counts, np.nan)
        return np.asarray(np.sqrt(mean / _THIRD_DIFFERENCE))

    def noise(self, point: SimulatedPoint) -> np.ndarray:
        """Return the standard deviation (n,) that a residual has as if rows were independent."""
        return np.asarray(_size(point) * np.sqrt(self._repetition(point)))

    def _repetition(self, point: SimulatedPoint) -> np.ndarray:
        """Return the number (n,) of rows of a residual that repeat one another."""
        most = max(1, round(_MAX_REPETITION / self._step))
        found = []
        for own in point.residual.T:
            parts = [np.nan_to_num(part) for part in np.split(own, self._ends)]
            square = sum(float(part @ part) for part in parts)
            repeated = 1.0
            for lag in range(1, most):
                share = sum(float(part[lag:] @ part[:-lag]) for part in parts) / square
                if share <= 0.0:
                    break
                repeated += 2.0 * share
            found.append(repeated)
        return np.array(found)

    def descend(
        self, parameters: Parameters, point: SimulatedPoint, say: Callable[[str], object]
    ) -> tuple[Parameters, SimulatedPoint]:
        """Minimise residuals over noise and distances from the prior.

        Noise is what the fit leaves: at every step it is estimated anew, so that what the start
        leaves does not let the prior rule.
        """
        damping, repeated = _FIRST_DAMPING, np.full(self._loop.n, np.inf)
        exact = True
        for number in range(_MAX_ITERATIONS):
            largest = 1e3 * float(np.sqrt(np.nanmean(point.residual**2)))
            say(f"simulate from commands: step {number + 1}, residual {largest:.2f} mrad")
            # A joint that gets worse repeats itself more: its weight would sink with each step.
            repeated = np.minimum(repeated, self._repetition(point))
            noise = _size(point) * np.sqrt(repeated)
            hessian, gradient = self._normal_equations(parameters, point, noise)
            decrease = 0.0
            while decrease <= 0.0:
                moved = self._moved(parameters, hessian, gradient, damping)
                step = (moved.values - parameters.values)[self.places] / self._size
                expected = -float(step @ (2.0 * gradient + hessian @ step))
                if expected < _LEAST_DECREASE:
                    break
                ahead = self.simulate(moved)
                decrease = self._decrease(parameters, moved, point, ahead, noise)
                if decrease > 0.0:
                    parameters, point = moved, point.followed_to(ahead.residual, step)
                    damping = max(0.1 * damping, self._least_damping)
                elif exact:
                    damping = max(10.0 * damping, _FIRST_DAMPING)
                else:
                    break
            if exact and decrease <= 0.0:
                return parameters, point
            ended = exact and decrease < _LEAST_DECREASE
            exact = decrease < max(_FOLLOWED_SHARE * expected, _LEAST_DECREASE)
            if exact:
                point = self.evaluate(parameters).require_bounded()
            if ended:
                return parameters, point
        return parameters, point if exact else self.evaluate(parameters).require_bounded()

    def covariance(
        self, parameters: Parameters, point: SimulatedPoint
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the covariance (m, m) of the fitted parameters, and the discretisation error (n,).

        Where the fit would go with infinitely short steps, by their halves and the second order of
        the integrator, is a deviation; what they change besides is an error of positions. Where
        stretches pull a value apart by more than noise does, since the simulation lacks something,
        its deviation is as much larger (White, Econometrica 48, 1980).
        """
        noise = self.noise(point)
        hessian, _ = self._normal_equations(parameters, point, noise)
        inverse, weighted = np.linalg.inv(hessian), point.slopes / noise[:, None]
        finer = self.simulate(parameters, refinement=_REFINEMENT_RATIO).residual - point.residual
        finer /= 1.0 - _REFINEMENT_RATIO**-2
        moved = inverse @ np.einsum("kjm,kj->m", weighted, np.nan_to_num(finer) / noise)
        error = np.sqrt(np.nanmean((finer - point.slopes @ moved) ** 2, axis=0))
        scores = np.einsum("kjm,kj->km", weighted, np.nan_to_num(point.residual) / noise)
        pulls = self._pulls(scores)
        spread = np.var(pulls @ inverse, axis=0) * len(pulls) ** 2 / max(len(pulls) - 1, 1)
        wider = np.sqrt(np.maximum(spread / np.diag(inverse), 1.0))
        whole = wider[:, None] * inverse * wider + np.outer(moved, moved)
        return np.asarray(self._size[:, None] * whole * self._size), error

    def _pulls(self, scores: np.ndarray) -> np.ndarray:
        """Return sums of scores (K, m) over times that are independent of one another."""
        found: dict[tuple[int, int], np.ndarray] = {}
        for part, own in zip(self._by_stretch(scores), self._stretches, strict=True):
            time = own.run.time[[own.end, 0]]
            key = id(own.run), int((time[0] - time[1]) / STRETCH_SECONDS)
            found[key] = found.get(key, 0.0) + part.sum(axis=0)
        return np.array(list(found.values()))

    def _share_delay(
        self, found: Parameters, covariance: np.ndarray
    ) -> tuple[Parameters, np.ndarray]:
        """Return parameters and covariance with the delay of the joint that is in the middle.

        Delay and lateness are one where all joints are as late.
        """
        late = found.place("lateness")
        middle = late.start + int(np.argsort(found.of("lateness"))[(found.n - 1) // 2])
        if middle not in self.places:
            return found, covariance
        own = self.places == middle
        change = np.eye(len(self.places))
        change[-1, own] = 1.0
        change[np.ix_((self.places >= late.start) & (self.places < late.stop), own)] -= 1.0
        values = found.values.copy()
        values[self.places] = change @ values[self.places]
        return replace(found, values=values), change @ covariance @ change.T

    def _decrease(
        self,
        parameters: Parameters,
        moved: Parameters,
        point: SimulatedPoint,
        ahead: SimulatedPoint,
        noise: np.ndarray,
    ) -> float:
        """Return by how much less likely the point is than that ahead, in squared deviations.

        That of residuals of unknown noise goes with the logarithm of their squares.
        """
        if not ahead.bounded:
            return -np.inf
        before, after = (np.nansum(own.residual**2, axis=0) for own in (point, ahead))
        least = 1e-300
        gained = before / noise**2 * np.log((before + least) / (after + least))
        here, there = self._distance(parameters)[0], self._distance(moved)[0]
        return float(gained.sum() + here @ here - there @ there)

    def _distance(self, parameters: Parameters) -> tuple[np.ndarray, np.ndarray]:
        """Return the distances from the prior, of Student's distribution, and their slopes."""
        away = (parameters.values - self._prior.values)[self.places] / self._size
        distance = np.sign(away) * np.sqrt(_PRIOR_FREEDOM * np.log1p(away**2 / _PRIOR_FREEDOM))
        here = distance == 0.0  # or so near that its square is none
        share = np.where(here, 1.0, away) / np.where(here, 1.0, distance)
        return distance, share / (1.0 + away**2 / _PRIOR_FREEDOM)

    def _normal_equations(
        self, parameters: Parameters, point: SimulatedPoint, noise: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        known = np.isfinite(point.residual)
        weighted = (point.slopes / noise[:, None])[known]
        right = (point.residual / noise)[known]
        distance, slope = self._distance(parameters)
        return weighted.T @ weighted + np.diag(slope**2), weighted.T @ right + slope * distance

    def _moved(
        self, parameters: Parameters, hessian: np.ndarray, gradient: np.ndarray, damping: float
    ) -> Parameters:
        """Return the parameters after one bounded step."""
        try:
            factor = np.linalg.cholesky(hessian + damping * np.diag(np.diag(hessian)))
        except np.linalg.LinAlgError as error:  # derivatives beyond all resolution
            raise FloatingPointError("the simulation diverges") from error
        bounds = parameters.bounds
        left = (bounds - parameters.values[:, None])[self.places] / self._size[:, None]
        found = lsq_linear(
            factor.T,
            -np.linalg.solve(factor, gradient),
            (np.minimum(left[:, 0], -1e-12), np.maximum(left[:, 1], 1e-12)),
            method="bvls",
        )
        values = parameters.values.copy()
        values[self.places] += self._size * found.x
        return replace(parameters, values=np.clip(values, *bounds.T))
