"""Design the next experiment: a motion on which the two leading explanations differ most."""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.experiment.collocation import improve_motion
from stiffopt.discovery.experiment.commands import SentCommands, motion_commands
from stiffopt.discovery.experiment.motion import (
    LIMIT_USE,
    MotionLimits,
    motion_limits,
    prepared_motion,
    random_motion,
    repeated_motion,
)
from stiffopt.discovery.experiment.separation import Separation
from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.search.search import SearchResult
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import Training
from stiffopt.result.trajectory import Trajectory

Say = Callable[[str], object]

EXPERIMENT_FILE = "next_experiment.csv"
_MAX_DURATION = 10.0  # [s], of a designed motion
_EXPORT_RATE = 100.0  # [Hz], of the exported motion
_RANDOM_MOTIONS = 24
# Relative gain of separation below which collocation is not repeated.
_MIN_RELATIVE_GAIN = 0.02
# Least separation that is worth a recording [sigma].
_MIN_SEPARATION = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class ExperimentPlan:
    """A motion that separates two explanations.

    Parameters
    ----------
    joints : tuple of str (n,)
    motion : Trajectory
        Callable `motion(t, order)` [rad], [rad/s], [rad/s^2].
    first, second : LocatedEffect
        The explanations.
    separation : float
        Predicted on the motion [sigma].
    reference : float
        On the training run that separates them best, scaled to the motion's duration [sigma].
    reference_run : str
    method : str
        How the motion was found.
    commands : SentCommands, optional
        That move the arm so, where it follows commands.
    """

    joints: tuple[str, ...]
    motion: Trajectory
    first: LocatedEffect
    second: LocatedEffect
    separation: float
    reference: float
    reference_run: str
    method: str
    commands: SentCommands | None = None

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
            " arm's limits, but is not checked for collisions."
            f" ({self.method}) {self.first.effect.separate}"
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
    settings: Settings,
    pair: tuple[LocatedEffect, LocatedEffect],
    *,
    seconds: float = 18.0,
    say: Say = lambda _: None,
) -> ExperimentPlan | None:
    """Design the motion that separates two explanations best.

    Parameters
    ----------
    training : Training
    result : SearchResult
        Of these training runs.
    settings : Settings
    pair : (LocatedEffect, LocatedEffect)
        The explanations, such as a finding and its strongest rival.
    seconds : float
        Processor time of the design, so that the result does not depend on other load.
    say : callable
        Called with a sentence at every step.

    Returns
    -------
    ExperimentPlan or None
        None if no motion beats the training runs, or none separates the two.

    Notes
    -----
    Random Fourier series within the limits are rated by `Separation`, which includes all values
    that a refit could change. The best one and the best recorded motion are improved by collocation
    if both effects are instantaneous formulas (no memory). The best by the full criterion is kept.
    """
    begin, began = time.process_time(), time.perf_counter()
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
        run = prepared_motion(training, training.constants, motion, settings)
        return separation.of(run, step=step)

    def left() -> float:
        return seconds - (time.process_time() - begin)

    def on_the_clock(own: float) -> float:
        """Convert processor time to elapsed time at the present load."""
        passed, worked = time.perf_counter() - began, time.process_time() - begin
        return own * max(1.0, passed / max(worked, 1e-3))

    best, value = _search_random_motions(
        training, limits, duration, rated, lambda: left() > 0.6 * seconds
    )
    method = f"best of {_RANDOM_MOTIONS} Fourier motions"
    # A recorded motion may be the better initial guess.
    best_run = next(run for run in training.runs if run.name == name)
    starts = [repeated_motion(best_run, duration), *([] if best is None else [best])]
    if value > reference:
        starts.reverse()
    for k, start in enumerate(starts):
        motion, worth = start, 0.0
        while left() > 1.0:
            share = 0.5 if k + 1 < len(starts) else 0.8
            better = improve_motion(
                separation,
                prepared_motion(training, training.constants, motion, settings),
                motion,
                limits,
                seconds=on_the_clock(share * left()),
            )
            if better is None or limits.excess(training.robot, better) > 1.0 / LIMIT_USE:
                break
            reached = rated(better)
            if reached > value:
                best, value, method = better, reached, "by direct collocation"
            if reached <= worth * (1.0 + _MIN_RELATIVE_GAIN):
                break
            motion, worth = better, reached
    if best is None:
        return None
    # Less than one standard deviation separates nothing, even if training runs do less.
    if value <= reference or value < _MIN_SEPARATION:
        return None
    return ExperimentPlan(
        joints=training.robot.recordings.joints,
        motion=best,
        first=first,
        second=second,
        separation=value,
        reference=reference,
        reference_run=name,
        method=method,
        commands=motion_commands(training.robot, training.recorded, best),
    )


def _search_random_motions(
    training: Training,
    limits: MotionLimits,
    duration: float,
    rated: Callable[[Trajectory], float],
    more: Callable[[], bool],
) -> tuple[Trajectory | None, float]:
    """Return the best of some random motions with its separation."""
    random = np.random.default_rng(1)
    best, value = None, 0.0
    for _ in range(_RANDOM_MOTIONS):
        motion = random_motion(limits, training.robot, duration, random)
        if motion is not None:
            reached = rated(motion)
            if best is None or reached > value:
                best, value = motion, reached
        if not more():
            break
    return best, value
