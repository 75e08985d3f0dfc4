"""Gains and delay of an actuator from commands and motion, where the arm's weight tells them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from stiffopt.actuator.law import UNSTATED_GAIN_DEVIATION, ActuatorLaw
from stiffopt.closed_loop.parameters import Parameters
from stiffopt.discovery.comparison.filtering import SLOW_CUTOFF, filter_slow_motion
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.loop_fit import (
    DRIVE_PARAMETERS,
    UNVOUCHED_MASS_SCALE,
    fit_loop,
    nominal_parameters,
)
from stiffopt.discovery.progress import Say
from stiffopt.discovery.sanity.command_doubts import doubt_commands
from stiffopt.discovery.sanity.doubt import format_joints
from stiffopt.discovery.sanity.torque_fit import MIN_MOVING_INSTANTS
from stiffopt.discovery.settings import DEFAULT_TOLERANCE, MIN_MOVING_SPEED
from stiffopt.discovery.signals import smooth_sign
from stiffopt.discovery.thresholds import NAMED_EVIDENCE
from stiffopt.formatting import pm, significant
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun, delayed_command

_DERIVED_NOTE: tuple[str, ...] = ("Torques are not recorded: the actuator's law gives them.",)


# Delays that are tried [s]: a fieldbus needs some milliseconds, a serial bus of servos some tens.
_MAX_DELAY = 0.06
_TRIED_DELAYS = np.arange(0.0, _MAX_DELAY + 1e-9, 0.0025)
# Log likelihood ratio beyond which a joint that contradicts the others counts less.
_ROBUST_SCALE = 9.0
# Log likelihood ratio from which a delay is taken to differ from none.
_MIN_DELAY_EVIDENCE = 6.0
# Relative standard deviation of a gain up to which it is told, once nothing but noise is left.
_MAX_GAIN_DEVIATION = 0.1
# Largest deviation of a told gain over that of one that nothing tells.
_LOOSEST_TOLD = 0.5
# One standard deviation of an estimated delay [s].
_DELAY_DEVIATION = 1e-3
# Shortest delay that a simulation tells without evidence of a regression [s].
_MIN_DELAY = 2e-3
# Angular frequency of a servo on its link where the motion tells nothing [rad/s].
_USUAL_FREQUENCY = 30.0
# Stretches that are left out in turn: physics that the regressors lack differs between them.
_JACKKNIFE_STRETCHES = 8
# Least integral gain over the proportional one that is one [1/s]: slower, an error that lasts for
# ten seconds adds less than itself, as the drift of an offset does.
_MIN_INTEGRAL_RATE = 0.1
# Rounds in which the gain that scales stated tolerances follows the estimated one.
_SCALE_ROUNDS = 5


@dataclass(frozen=True, eq=False)
class JointRows:
    """Rows of one joint: regressors (m, k), weight and inertia (m,), error by delay.

    The first three regressors are acceleration, velocity and direction, the last is constant;
    `stated` (3, 2) are nominal factors of the first and deviations, infinite where no value is
    stated. `integral`: of the error over time by delay, from its mean in each `run` (m,).
    """

    columns: np.ndarray
    load: np.ndarray
    velocity: np.ndarray
    error: Callable[[float], np.ndarray]
    integral: Callable[[float], np.ndarray]
    run: np.ndarray
    independent: float
    stated: np.ndarray

    @property
    def begins(self) -> np.ndarray:
        """Indicators (m, r) of the runs: integrals begin at an unknown value in each."""
        return np.asarray(self.run[:, None] == np.unique(self.run), dtype=float)

    def with_integral(self, rate: float) -> JointRows:
        """Return the rows of a controller that integrates its error."""
        if rate == 0.0:
            return self
        return replace(
            self,
            columns=np.column_stack([self.columns[:, :-1], self.begins]),
            error=lambda delay: self.error(delay) + rate * self.integral(delay),
        )


@dataclass(frozen=True, eq=False)
class ActuatorGuess:
    """Law of an actuator by regression, to begin a simulation with."""

    law: ActuatorLaw  # complete
    evidence: float  # log likelihood ratio of the delay to none
    # (3, n) rotor inertia, viscous and dry friction; nan where the gain is stated.
    drives: np.ndarray


@dataclass(frozen=True, eq=False)
class ResolvedActuator:
    """Recording set whose actuators are known as well as its training runs tell them."""

    recordings: RecordingSet
    runs: list[RecordedRun]  # with torques by the law, nan where it gives them no scale
    notes: tuple[str, ...]  # what was estimated, one sentence each
    # Of the simulation that told gains and delay; None where all were stated.
    parameters: Parameters | None = None


def resolve_actuator(
    recordings: RecordingSet,
    runs: Sequence[RecordedRun],
    say: Say = lambda _: None,
) -> ResolvedActuator:
    """Estimate the unknown values of a set's actuators.

    Sets with recorded torques are returned unchanged. Commands that contradict the positions are
    not simulated: the gate doubts them.
    """
    law = recordings.actuator
    if law is None:
        return ResolvedActuator(recordings, list(runs), ())
    parameters = None
    guess = estimate_actuator(RobotModel(recordings), runs, law)
    found = guess.law
    asked = not law.known or bool(found.integral.any())
    if asked and not any(doubt_commands(recordings, runs)):
        found, parameters = _refine_law(recordings, runs, guess, say)
    notes = (*_DERIVED_NOTE, *_describe(law, found, guess.evidence))
    known = recordings.with_actuator(found)
    derived = [known.derive_torque(run) for run in runs]
    return ResolvedActuator(known, derived, notes, parameters)


def estimate_actuator(
    robot: RobotModel, runs: Sequence[RecordedRun], law: ActuatorLaw
) -> ActuatorGuess:
    """Estimate unknown gains and the delay by least squares of the equation of motion.

    With an unknown gain k the position error is (weight and inertia + friction + ...) / k: masses
    are known, so that the factor of their torque is 1 / k, and so are stated friction and rotor
    inertia. Where that is not significant, the gain is guessed from the acceleration.
    """
    rows, rates = [joint_rows(robot, runs, j) for j in range(robot.n)], np.zeros(robot.n)
    for k in range(robot.n):
        if (own := rows[k]) is not None:
            rate, _, gain = integral_rate(own, law.delay if np.isfinite(law.delay) else 0.0)
            rates[k] = rate if gain > NAMED_EVIDENCE and rate > _MIN_INTEGRAL_RATE else 0.0
            rows[k] = own.with_integral(rates[k])
    delay, evidence = law.delay, np.inf
    if not np.isfinite(delay):
        delay, evidence = _estimate_delay(rows, law)
    stiffness, asked = law.stiffness.copy(), ~np.isfinite(law.stiffness)
    inertia, factors = _joint_inertias(robot, runs), np.zeros(4)
    drives = np.full((len(DRIVE_PARAMETERS), robot.n), np.nan)
    for j in np.flatnonzero(asked):
        own, per_acceleration = rows[j], 1.0 / _USUAL_FREQUENCY**2
        if own is not None:
            factors, spread = _load_factor(own, delay)
            if factors[0] > spread:
                stiffness[j] = 1.0 / factors[0]
                drives[:, j] = np.maximum(factors[1:4], 0.0) * stiffness[j]
                continue
            factors = least_squares(own.columns, own.error(delay), own.independent)[0]
            per_acceleration = max(float(factors[0]), 0.1 * per_acceleration)
        # As if rotors had the inertia of the links.
        stiffness[j] = 2.0 * inertia[j] / per_acceleration
        drives[:, j] = inertia[j], *np.maximum(factors[1:3], 0.0) * stiffness[j]
    found = replace(
        law,
        stiffness=stiffness,
        tolerance=np.where(asked, UNSTATED_GAIN_DEVIATION, law.tolerance),
        estimated=asked if asked.any() else law.estimated,
        integral=rates,
        delay=delay,
        delay_deviation=law.delay_deviation if np.isfinite(law.delay) else _DELAY_DEVIATION,
    )
    return ActuatorGuess(found, evidence, drives)


def _refine_law(
    recordings: RecordingSet,
    runs: Sequence[RecordedRun],
    guess: ActuatorGuess,
    say: Say,
) -> tuple[ActuatorLaw, Parameters | None]:
    """Return the law with gains and delay of a simulation fitted to the runs, and its parameters.

    A regression of filtered position errors takes what friction does at reversals for weight; a
    simulation has reversals where the arm has them. Where masses are vouched for, a gain is told
    if noise alone would leave it sure: effects not yet found make it uncertain until they are.
    """
    law, order = guess.law, recordings.order
    known = recordings.with_actuator(law)
    prior = nominal_parameters(known, known.robot)
    for name, own in zip(DRIVE_PARAMETERS.values(), guess.drives, strict=True):
        inside = own[np.argsort(order)]
        prior.values[prior.place(name)] = np.where(
            np.isfinite(inside) & (prior.of(name) == 0.0), inside, prior.of(name)
        )
    fit = fit_loop(known, runs, prior, say, leading=True)
    if fit is None:
        return law, None
    fitted = fit[1]
    factor = (1.0 + fitted.parameters.of("gain"))[order]
    place = fitted.parameters.place("gain")
    spread, attainable = (
        each[place][order] / factor for each in (fitted.deviations, fitted.attainable)
    )
    # Beside masses that nobody vouches for, the residual may be their error: a gain need not be
    # better known than these.
    vouched = recordings.tolerance.mass is not None
    told = attainable <= _MAX_GAIN_DEVIATION if vouched else spread <= UNVOUCHED_MASS_SCALE
    spread = np.minimum(spread, _LOOSEST_TOLD * UNSTATED_GAIN_DEVIATION)
    spread[~told] = UNSTATED_GAIN_DEVIATION
    refined = law
    if law.estimated is not None:
        refined = replace(
            law,
            stiffness=np.where(law.estimated, law.stiffness * factor, law.stiffness),
            tolerance=np.where(law.estimated, spread, law.tolerance),
        )
    refined = replace(refined, integral=fitted.parameters.of("integral")[order])
    if law.delay_deviation:
        spread = max(float(fitted.deviations[-1]), _DELAY_DEVIATION)
        # Whole microseconds: a bound is met to within rounding.
        # That of all joints may lie before those of single ones, and before none.
        delay = max(round(fitted.parameters.delay, 6), 0.0)
        refined = replace(refined, delay=delay, delay_deviation=spread)
    return refined, fitted.parameters


def _describe(law: ActuatorLaw, found: ActuatorLaw, evidence: float) -> list[str]:
    asked = ~np.isfinite(law.stiffness)
    told = asked & found.scaled
    notes = []
    if told.any():
        each = ", ".join(
            f"joint {j + 1}: "
            f"{pm(found.stiffness[j], found.tolerance[j] * found.stiffness[j], 'N m/rad')}"
            for j in np.flatnonzero(told)
        )
        notes.append(
            f"The gain of the position error is estimated from the arm's weight ({each}): its scale"
            " is that of the nominal masses. What damps by velocity counts as viscous friction."
        )
    if (silent := asked & ~found.scaled).any():
        which = format_joints(np.flatnonzero(silent))
        notes.append(
            f"Weight and inertia do not tell the gain of {which}: torques there have no scale and"
            " are left out. Give kp in [actuator]; only ratios of friction to gain are known."
        )
    if found.integral.any():
        each = ", ".join(
            f"joint {j + 1}: {significant(found.integral[j], 2)} 1/s"
            for j in np.flatnonzero(found.integral)
        )
        notes.append(
            "Position errors fade under a lasting load: controllers have an integral part, over"
            f" the proportional gain {each}."
        )
    if not np.isfinite(law.delay):
        notes.append(
            f"The delay of commands is estimated to {1e3 * found.delay:.3g} ms."
            if evidence > _MIN_DELAY_EVIDENCE or found.delay > _MIN_DELAY
            else "No delay of commands is assumed: the motion does not tell one."
        )
    return notes


def joint_rows(robot: RobotModel, runs: Sequence[RecordedRun], joint: int) -> JointRows | None:
    """Return the filtered rows of one joint over all runs; None if it hardly moves."""
    parts: list[tuple[np.ndarray, ...]] = []
    commands: list[tuple[CubicSpline, np.ndarray, np.ndarray, np.ndarray]] = []
    seconds = 0.0
    for run in runs:
        if run.command is None or not np.isfinite(run.command[:, joint]).any() or not run.usable:
            continue
        slow = filter_slow_motion(run)
        settling = slow.low_pass.settling
        # A delayed command begins later.
        inside = slice(settling + round(_MAX_DELAY / slow.dt), -settling)
        motion = (slow.position, slow.velocity, slow.acceleration)
        load = robot.spring_torque(*motion)[:, joint]
        own, speed, rate = (x[:, joint] for x in motion)
        direction = smooth_sign(speed)
        columns = np.column_stack(
            [rate, speed, direction, np.abs(load) * direction, np.ones_like(own)]
        )
        chosen = np.arange(len(own))[inside]
        chosen = chosen[np.abs(speed[chosen]) >= MIN_MOVING_SPEED]
        smooth = slow.low_pass(delayed_command(run, 0.0)[:, joint : joint + 1])[:, 0]
        commands.append((CubicSpline(run.time, smooth), slow.time, own, chosen))
        parts.append(tuple(x[chosen] for x in (columns, load, speed)))
        seconds += len(chosen) * run.step
    if not parts or sum(len(part[0]) for part in parts) < MIN_MOVING_INSTANTS:
        return None

    def error(delay: float) -> np.ndarray:
        return np.concatenate(
            [spline(time[rows] - delay) - own[rows] for spline, time, own, rows in commands]
        )

    def integral(delay: float) -> np.ndarray:
        found = []
        for spline, time, own, rows in commands:
            whole = np.cumsum(spline(time - delay) - own) * (time[1] - time[0])
            found.append(whole[rows] - whole.mean())
        return np.concatenate(found)

    columns, load, speed = (np.concatenate(each) for each in zip(*parts, strict=True))
    independent = max(2.0 * SLOW_CUTOFF * seconds, 1.0)
    run_of_row = np.repeat(np.arange(len(commands)), [len(each[-1]) for each in commands])
    stated = _stated_factors(robot, joint)
    return JointRows(columns, load, speed, error, integral, run_of_row, independent, stated)


def _stated_factors(robot: RobotModel, joint: int) -> np.ndarray:
    """Return nominal rotor inertia, viscous and dry friction with deviations (3, 2)."""
    tolerance, found = robot.recordings.tolerance, []
    for key in ("rotor_inertia", "viscous", "coulomb"):
        relative = getattr(tolerance, key)
        relative = getattr(DEFAULT_TOLERANCE, key) if relative is None else relative
        value = float(getattr(robot, key)[joint])
        known = key not in robot.recordings.unstated and value > 0.0
        found.append((value, max(relative * value, 1e-9) if known else np.inf))
    return np.array(found)


def integral_rate(rows: JointRows, delay: float) -> tuple[float, float, float]:
    """Return the integral over the proportional gain [1/s], its deviation, and log likelihood gain.

    The error is (weight and inertia + friction) / k less the rate times its own integral, which
    begins at an unknown value in every run.
    """
    table = np.column_stack([rows.load, rows.columns[:, :-1], rows.begins])
    error = rows.error(delay)
    _, _, without = least_squares(table, error, rows.independent)
    whole = np.column_stack([table, -rows.integral(delay)])
    factors, spread, square = least_squares(whole, error, rows.independent)
    gain = 0.5 * rows.independent * float(np.log(without / square)) if square > 0.0 else 0.0
    return float(factors[-1]), float(spread[-1]), gain


def _estimate_delay(rows: Sequence[JointRows | None], law: ActuatorLaw) -> tuple[float, float]:
    """Return the likeliest delay [s] and its log likelihood ratio to none; 0 where none shows.

    A delay acts as viscous friction k d does: stated friction and rotor inertia of all joints
    tell them apart, and a joint that departs from them does not overrule the others.
    """
    used = [(j, own) for j, own in enumerate(rows) if own is not None]

    def misfits(delays: np.ndarray) -> np.ndarray:
        return np.array([[_misfit(own, j, law, delay) for j, own in used] for delay in delays])

    if not used:
        return 0.0, 0.0
    coarse = misfits(_TRIED_DELAYS)
    least = coarse.min(axis=0)

    def total(each: np.ndarray) -> np.ndarray:
        excess = np.maximum(each - least, 0.0)
        return np.asarray(_ROBUST_SCALE * np.log1p(excess / _ROBUST_SCALE).sum(axis=1))

    first = float(_TRIED_DELAYS[int(np.argmin(total(coarse)))])
    step = float(_TRIED_DELAYS[1] - _TRIED_DELAYS[0])
    fine = np.clip(first + np.linspace(-step, step, 21), 0.0, _MAX_DELAY)
    found = total(misfits(fine))
    best = int(np.argmin(found))
    evidence = float(total(coarse[:1])[0] - found[best])
    if evidence < _MIN_DELAY_EVIDENCE or fine[best] >= _MAX_DELAY:
        return 0.0, 0.0
    return float(fine[best]), evidence


def _misfit(own: JointRows, joint: int, law: ActuatorLaw, delay: float) -> float:
    """Return minus the log likelihood of one joint's error at a delay."""
    error, count = own.error(delay), len(own.load)
    if not np.isfinite(law.stiffness[joint]):
        table = np.column_stack([own.load, own.columns])
        return 0.5 * own.independent * float(np.log(least_squares(table, error, count)[2]))
    target = law.stiffness[joint] * error - law.damping[joint] * own.velocity - own.load
    left = least_squares(own.columns, target, count)[2]
    # Rows that repeat one another count once; stated values are rows of their own.
    known = np.isfinite(own.stated[:, 1])
    weight = np.sqrt(left * count / own.independent) / own.stated[known, 1]
    extra = np.zeros((int(known.sum()), own.columns.shape[1]))
    extra[np.arange(len(weight)), np.flatnonzero(known)] = weight
    table = np.vstack([own.columns, extra])
    wanted = np.concatenate([target, weight * own.stated[known, 0]])
    return 0.5 * own.independent * float(np.log(least_squares(table, wanted, count)[2]))


def _load_factor(own: JointRows, delay: float) -> tuple[np.ndarray, float]:
    """Return the factors in the error and the deviation of the first, the load, over stretches.

    Stated friction and rotor inertia weigh as much as their tolerance allows: over the gain, which
    is sought, they are known relative to its own factor.
    """
    table, target = np.column_stack([own.load, own.columns]), own.error(delay)
    factors, spread, square = least_squares(table, target, own.independent)
    known = np.flatnonzero(np.isfinite(own.stated[:, 1]))
    noise = float(np.sqrt(square * len(target) / own.independent))
    parts = np.array_split(np.arange(len(target)), _JACKKNIFE_STRETCHES)

    def fit(rows: np.ndarray, scale: float, independent: float) -> tuple[np.ndarray, ...]:
        value, deviation = own.stated[known].T
        extra = np.zeros((len(known), table.shape[1]))
        extra[:, 0], extra[range(len(known)), 1 + known] = -value, 1.0
        extra *= (noise / (deviation * scale))[:, None]
        whole = np.vstack([table[rows], extra])
        found = least_squares(whole, np.append(target[rows], np.zeros(len(known))), independent)
        return found[0], found[1]

    scale = 1.0
    if len(known):
        # Begin with the gain by the stated value that shows best.
        best = known[int(np.argmax(factors[1 + known] / spread[1 + known]))]
        scale = max(factors[1 + best], spread[1 + best]) / own.stated[best, 0]
        if factors[0] > spread[0]:
            scale = factors[0]
        for _ in range(_SCALE_ROUNDS):
            factors, spread = fit(np.arange(len(target)), scale, own.independent)
            scale = factors[0] if factors[0] > 0.0 else scale
    left_out = [
        fit(np.delete(np.arange(len(target)), part), scale, own.independent)[0][0] for part in parts
    ]
    jackknife = np.sqrt(
        (_JACKKNIFE_STRETCHES - 1)
        / _JACKKNIFE_STRETCHES
        * np.sum((left_out - np.mean(left_out)) ** 2)
    )
    return factors, float(max(spread[0], jackknife))


def _joint_inertias(robot: RobotModel, runs: Sequence[RecordedRun]) -> np.ndarray:
    """Return the inertia (n,) of the links about each joint amid the motion [kg m^2]."""
    middle = np.nanmean(np.vstack([run.position for run in runs]), axis=0)
    pose, still = np.tile(middle, (robot.n, 1)), np.zeros((robot.n, robot.n))
    moved = robot.spring_torque(pose, still, np.eye(robot.n))
    return np.diagonal(moved - robot.spring_torque(pose, still, still))


def least_squares(
    table: np.ndarray, target: np.ndarray, independent: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return factors, their standard deviations (k,) and the mean square of the residual.

    Filtered rows repeat one another: deviations count the independent ones.
    """
    size = np.linalg.norm(table, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    inverse = np.linalg.pinv(table / size)
    factors = inverse @ target
    left = target - (table / size) @ factors
    square = float(left @ left) / max(len(target) - len(factors), 1)
    spread = np.sqrt(square * np.sum(inverse**2, axis=1) * max(len(target) / independent, 1.0))
    return factors / size, spread / size, square
