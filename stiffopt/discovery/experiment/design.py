"""Design the next experiment: a motion on which the two leading explanations differ most."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.discovery.comparison.channel_rows import ChannelNoise
from stiffopt.discovery.comparison.comparison import Comparison, Fit
from stiffopt.discovery.comparison.design_matrix import DesignMatrix
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.comparison.prepared_run import PreparedRun
from stiffopt.discovery.experiment.motion import (
    DRAWS_PER_JOINT,
    MotionLimits,
    SentCommands,
    fourier_motion,
    motion_commands,
    motion_limits,
    prepared_motion,
)
from stiffopt.discovery.names import ValueName
from stiffopt.discovery.progress import Say
from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.search.search import SearchResult
from stiffopt.discovery.training import Training
from stiffopt.result.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class _Explanation:
    """One explanation, fitted to the training runs."""

    names: list[ValueName]
    effects: tuple[LocatedEffect, ...]
    fit: Fit


class Separation:
    """Predicted separation of two explanations of the same training runs.

    `comparison`: of the training runs. `others`: effects common to both explanations.

    Both predict the channels of a motion with values fitted to the training runs. Amplitudes of one
    and nominal values are then refitted to the prediction of the other, with the posterior of the
    training runs as prior; the remaining difference is the separation, the lesser of both
    directions. This is the criterion of Box and Hill (1967) for a linear Gaussian model.
    """

    def __init__(
        self,
        comparison: Comparison,
        first: LocatedEffect,
        second: LocatedEffect,
        others: Sequence[LocatedEffect] = (),
    ) -> None:
        self.comparison = comparison
        names, _ = comparison.priors
        self.first, self.second = (
            _Explanation(names, effects, comparison.fit(effects))
            for effects in ((first, *others), (second, *others))
        )

    def of(self, run: PreparedRun, *, step: float | None = None) -> float:
        """Return the separation on a motion [sigma].

        `step`: sampling time of the recording [s]; default: that of the run.
        """
        columns = self._columns_along(run, step)
        if not columns.rows.size:
            return 0.0  # joints that hardly move are not compared
        here = Comparison(columns, inflation=self.comparison.inflation)
        parts = [self._parameter_columns(here, each) for each in (self.first, self.second)]
        means = [each.fit.posterior.mean for each in (self.first, self.second)]
        difference = parts[0] @ means[0] - parts[1] @ means[1]
        left = [
            _unabsorbed_square(difference, columns, each.fit.posterior.covariance)
            for columns, each in zip(parts, (self.first, self.second), strict=True)
        ]
        return float(np.sqrt(max(min(left), 0.0)))

    def _columns_along(self, run: PreparedRun, step: float | None) -> DesignMatrix:
        base = self.comparison
        # More samples of the same motion lower the noise that passes the filter.
        finer = 1.0 if step is None else float(np.sqrt(step / run.signals.dt))
        noise = ChannelNoise(base.noise.torque * finer, base.noise.deflection * finer)
        along = replace(run, signals=replace(run.signals, constants=base.constants))
        return DesignMatrix(base.robot, (along,), noise, base.tolerance)

    def _parameter_columns(self, here: Comparison, each: _Explanation) -> np.ndarray:
        names, _ = here.priors
        own = dict(zip(names, here.stack_columns().T, strict=True))
        nothing = np.zeros(here.rows.size)
        # A stationary joint has no column of friction.
        nuisance = [own.get(name, nothing) for name in each.names]
        effects = [here.effect_columns(located) for located in each.effects]
        return np.column_stack([*nuisance, *effects])


def _unabsorbed_square(difference: np.ndarray, columns: np.ndarray, spread: np.ndarray) -> float:
    """Return the chi-square of a difference after a refit with this prior covariance."""
    root = np.linalg.cholesky(spread + 1e-14 * np.diag(np.diag(spread)))
    reach = columns @ root
    inner = np.eye(len(spread)) + reach.T @ reach
    along = reach.T @ difference
    return float(difference @ difference - along @ np.linalg.solve(inner, along))


EXPERIMENT_FILE = "next_experiment.csv"
_MAX_DURATION = 10.0  # [s], of a designed motion
_EXPORT_RATE = 100.0  # [Hz], of the exported motion
# Motions that are drawn at random, and variations of the best of these.
_RANDOM_MOTIONS, _VARIED_MOTIONS = 24, 96
# Share of the draws that a variation changes; its first step, and the change of the step by a
# success and by a failure: steady at one success in five.
_VARIED_SHARE, _FIRST_STEP, _STEP_GROWTH, _STEP_DECREASE = 0.3, 0.3, 1.3, 0.93
# Least separation that is worth a recording [sigma].
_MIN_SEPARATION = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class ExperimentPlan:
    """A motion that separates two explanations."""

    joints: tuple[str, ...]  # (n,)
    motion: Trajectory  # callable `motion(t, order)` [rad], [rad/s], [rad/s^2]
    # first, second: the explanations.
    first: LocatedEffect
    second: LocatedEffect
    separation: float  # predicted on the motion [sigma]
    # On the training run that separates them best, scaled to the motion's duration [sigma].
    reference: float
    reference_run: str
    commands: SentCommands | None = None  # that move the arm so, where it follows commands

    @property
    def sentence(self) -> str:
        """Instruction with the predicted separation."""
        what = f"Record {EXPERIMENT_FILE}"
        if self.commands is not None:
            every = 1e3 * float(self.commands.time[1] - self.commands.time[0])
            what = f"Send cmd1.. of {EXPERIMENT_FILE}, one row every {every:.3g} ms, and record"
        return (
            f"{what} ({self.motion.duration:.1f} s): it is predicted to separate"
            f" {self.first.label} from {self.second.label} by {self.separation:.1f} sigma, where"
            f" another run like {self.reference_run} would by {self.reference:.1f}. It keeps the"
            f" arm's limits, but is not checked for collisions. {self.first.effect.separate}"
        )

    def csv(self) -> str:
        """Return columns t, q1.., qd1.. in SI at 100 Hz; cmd1.. and q1.. whenever one is sent."""
        joints = range(1, len(self.joints) + 1)
        if self.commands is not None:
            times, heads = self.commands.time, ("cmd", "q")
            columns = [self.commands.position, self.motion(times)]
        else:
            times, heads = np.arange(0.0, self.motion.duration, 1.0 / _EXPORT_RATE), ("q", "qd")
            times = np.append(times, self.motion.duration)
            columns = [self.motion(times), self.motion(times, 1)]
        names = ["t", *(f"{head}{j}" for head in heads for j in joints)]
        table = np.column_stack([times, *columns])
        stream = io.StringIO()
        np.savetxt(stream, table, fmt="%.9g", delimiter=",", header=",".join(names), comments="")
        return stream.getvalue()


def leading_pair(selected: Sequence[Selected]) -> tuple[LocatedEffect, LocatedEffect] | None:
    """Return the strongest finding with rivals, and its strongest rival; None without rivals."""
    for each in selected:
        for rival, _ in each.rivals:
            # An effect of one run cannot be reproduced in another.
            if not (each.located.is_run_specific or rival.is_run_specific):
                return each.located, rival
    return None


def plan_experiment(
    training: Training,
    result: SearchResult,
    pair: tuple[LocatedEffect, LocatedEffect],
    say: Say = lambda _: None,
) -> ExperimentPlan | None:
    """Design the motion that separates two explanations best.

    `result`: of these training runs. `pair` (LocatedEffect, LocatedEffect): the explanations, such
    as a finding and its strongest rival. `say`: called with a sentence at every step. None if no
    motion beats the training runs, or none separates the two.

    Fourier series within the limits are rated by `Separation`, which includes all values that a
    refit could change: random ones first, then variations of the best one (an evolution strategy of
    one parent and one child, whose step grows with success).
    """
    first, second = pair
    say(f"design the motion that separates {first.label} from {second.label}")
    others = tuple(e for e in result.effects if e.key not in (first.key, second.key))
    separation = Separation(result.comparison, first, second, others)
    limits = motion_limits(training)
    durations = [float(run.time[-1] - run.time[0]) for run in training.runs]
    duration = min(_MAX_DURATION, float(np.median(durations)))
    step = float(np.median([run.signals.dt for run in training.runs]))
    known = [
        (separation.of(run) * float(np.sqrt(duration / own)), run.name)
        for run, own in zip(training.runs, durations, strict=True)
    ]
    reference, name = max(known)

    def rated(motion: Trajectory) -> float:
        return separation.of(prepared_motion(training, motion), step=step)

    best, value = _search_motions(training, limits, duration, rated)
    # Less than one standard deviation separates nothing, even if training runs do less.
    if best is None or value <= reference or value < _MIN_SEPARATION:
        return None
    return ExperimentPlan(
        joints=training.robot.recordings.joints,
        motion=best,
        first=first,
        second=second,
        separation=value,
        reference=reference,
        reference_run=name,
        commands=motion_commands(training.robot, training.recorded, best),
    )


def _search_motions(
    training: Training, limits: MotionLimits, duration: float, rated: Callable[[Trajectory], float]
) -> tuple[Trajectory | None, float]:
    """Return the best motion found, with its separation."""
    random = np.random.default_rng(1)
    best, value, step = None, 0.0, _FIRST_STEP
    own = np.zeros((training.robot.n, DRAWS_PER_JOINT))
    for k in range(_RANDOM_MOTIONS + _VARIED_MOTIONS):
        draws = random.normal(size=own.shape)
        if k >= _RANDOM_MOTIONS:
            # The sum is standard normal as well.
            varied = np.sqrt(1.0 - step**2) * own + step * draws
            draws = np.where(random.random(own.shape) < _VARIED_SHARE, varied, own)
        motion = fourier_motion(limits, training.robot, duration, draws)
        reached = 0.0 if motion is None else rated(motion)
        if reached > value:
            best, value, own = motion, reached, draws
        if k >= _RANDOM_MOTIONS:
            step = min(step * _STEP_GROWTH, 1.0) if own is draws else step * _STEP_DECREASE
    return best, value
