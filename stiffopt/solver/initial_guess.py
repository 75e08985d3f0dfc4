"""Initial guesses: from a baseline or an earlier motion, and random perturbations of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from stiffopt.path.path_timing import slowing_within_limits
from stiffopt.problem.formulation import static_variables
from stiffopt.problem.trajectory import ResolvedMotion, TrajectoryProblem
from stiffopt.result.assessment import Assessment
from stiffopt.result.joint_path import JointPath
from stiffopt.result.solution import Baseline
from stiffopt.solver.stage_plan import PATH_SAMPLES
from stiffopt.transcription.ocp import Guess, shortest_phase_share

# Intervals of a smoothed guess, and duration over the averaging window.
_SMOOTHED_INTERVALS = 2000
_WINDOWS_PER_DURATION = 25
# Projections onto the path's tangent after a motion is located on its samples.
_TANGENT_PROJECTIONS = 3
# Random perturbations: standard deviation of the detour [rad], of the timing's skew on a path [-],
# and range of the skew within which no motion reverses.
_DETOUR_DEVIATION, _TIMING_SKEW_DEVIATION, _TIMING_SKEW_RANGE = 0.2, 0.4, (-0.9, 0.9)


def initial_guess(
    problem: TrajectoryProblem, motion: ResolvedMotion, compared: dict[str, Baseline]
) -> Guess:
    """Return the motion of the first baseline that exists, toppra's or the quintic one."""
    source = next(b.assessment for b in (compared["toppra"], compared["quintic"]) if b.assessment)
    return guess_from_motion(problem, motion, source)


def guess_from_motion(
    problem: TrajectoryProblem, motion: ResolvedMotion, source: Assessment
) -> Guess:
    """Return a guess from an assessed motion; vias at the instants where it passes them.

    On a fixed path only its time law is used.
    """
    statics = _static_values(problem, motion, source)
    if problem.path is not None:
        return _path_guess(problem.path, source, statics)
    states, controls = np.hstack([source.position, source.velocity]), source.acceleration
    s, duration = source.time / source.duration, source.duration
    if problem.plans_links:
        s, states, controls, duration = _smooth_motion_guess(problem, source)
    return Guess(
        states=_make_interpolator(s, states),
        controls=_make_interpolator(s, controls),
        duration=duration,
        statics=statics,
        phase_fractions=_phase_fractions(source, motion),
    )


def perturb_guess(guess: Guess, problem: TrajectoryProblem, random: np.random.Generator) -> Guess:
    """Add a smooth random detour that vanishes at both ends; on a path, skew the timing."""
    if problem.path is not None:
        return _retime_guess(
            guess, float(np.clip(random.normal(scale=_TIMING_SKEW_DEVIATION), *_TIMING_SKEW_RANGE))
        )
    n = problem.joints
    amplitude = random.normal(scale=_DETOUR_DEVIATION, size=n)

    def moved(s: np.ndarray) -> np.ndarray:
        values = np.array(guess.states(s))
        bump = 16.0 * (np.asarray(s) * (1.0 - np.asarray(s))) ** 2
        slope = 32.0 * np.asarray(s) * (1.0 - np.asarray(s)) * (1.0 - 2.0 * np.asarray(s))
        values[:, :n] += bump[:, None] * amplitude
        values[:, n : 2 * n] += slope[:, None] * amplitude / guess.duration
        return values

    return replace(guess, states=moved)


def _retime_guess(guess: Guess, skew: float) -> Guess:
    """Return the guess on a path with the scaled time t replaced by w = t + skew t (1 - t)."""

    def warped(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return t + skew * t * (1.0 - t), (1.0 + skew * (1.0 - 2.0 * t))[:, None]

    def states(t: np.ndarray) -> np.ndarray:
        w, rate = warped(np.asarray(t))
        return np.asarray(guess.states(w) * np.hstack([np.ones_like(rate), rate]))

    def controls(t: np.ndarray) -> np.ndarray:
        w, rate = warped(np.asarray(t))
        speed = np.asarray(guess.states(w))[:, 1:]
        return np.asarray(guess.controls(w) * rate**2 - 2.0 * skew * speed / guess.duration)

    return replace(guess, states=states, controls=controls)


def _smooth_motion_guess(
    problem: TrajectoryProblem, source: Assessment
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Smooth a motion by five moving averages, compressed before to keep its duration.

    `s` (m,): scaled time. `states, controls` (m, 5 n), (m, n): position and its derivatives up to
    snap, and the fifth. And the duration [s]: a free one is as long as the limits of the
    derivatives ask, since toppra's motion with its jerk smoothed exceeds them by a factor of ten
    and more, from where convergence is a matter of rounding.
    """
    s = np.linspace(0.0, 1.0, _SMOOTHED_INTERVALS + 1)
    window = 2 * (_SMOOTHED_INTERVALS // (2 * _WINDOWS_PER_DURATION)) + 1
    spread = 5 * (window - 1) / _SMOOTHED_INTERVALS
    inside = np.clip((s - spread / 2.0) / (1.0 - spread), 0.0, 1.0)
    time = inside * source.duration
    columns = [np.interp(time, source.time, each) for each in source.position.T]
    values = np.stack(columns, axis=1)
    box = np.ones(window) / window
    for _ in range(5):
        padded = np.pad(values, ((window // 2, window // 2), (0, 0)), mode="edge")
        smooth = [np.convolve(each, box, mode="valid") for each in padded.T]
        values = np.stack(smooth, axis=1)
    orders = [values]
    for _ in range(5):
        orders.append(np.gradient(orders[-1], source.duration / _SMOOTHED_INTERVALS, axis=0))
    limits = problem.active_limits
    uses = {
        name: np.abs(own) / getattr(limits, name)
        for name, own in zip(("velocity", "acceleration", "jerk"), orders[1:4], strict=True)
    }
    longest = max(problem.duration[1], source.duration)
    slower = min(slowing_within_limits(uses), longest / source.duration)
    orders = [own / slower**order for order, own in enumerate(orders)]
    return s, np.hstack(orders[:5]), orders[5], slower * source.duration


def _make_interpolator(s: np.ndarray, values: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    def sample(at: np.ndarray) -> np.ndarray:
        columns = [np.interp(at, s, values[:, j]) for j in range(values.shape[1])]
        return np.stack(columns, axis=1)

    return sample


def _path_guess(path: JointPath, source: Assessment, statics: np.ndarray) -> Guess:
    """Return the time law of a motion along a path as a guess of the path coordinate."""
    s, speed, acceleration = _time_law(path, source)
    at = source.time / source.duration
    return Guess(
        states=_make_interpolator(at, np.stack([s, speed], axis=1)),
        controls=_make_interpolator(at, acceleration[:, None]),
        duration=source.duration,
        statics=statics,
        phase_fractions=np.ones(1),
    )


def _time_law(path: JointPath, source: Assessment) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the path coordinate of a motion along a path, its speed and its acceleration (K,).

    Arc length locates the piece, so that a self-intersecting path is followed in order; projection
    onto the tangent corrects the chord error of the arc length.
    """
    dense = np.linspace(0.0, 1.0, PATH_SAMPLES)
    covered, length = _arc_length(source.position), _arc_length(path(dense))
    s = np.interp(covered / covered[-1], length / length[-1], dense)
    for _ in range(_TANGENT_PROJECTIONS):
        tangent = path(s, 1)
        along = np.einsum("kj,kj->k", source.position - path(s), tangent)
        s = np.clip(s + along / np.einsum("kj,kj->k", tangent, tangent), 0.0, 1.0)
    s = np.maximum.accumulate(s)
    tangent = path(s, 1)
    square = np.einsum("kj,kj->k", tangent, tangent)
    speed = np.einsum("kj,kj->k", source.velocity, tangent) / square
    rest = source.acceleration - path(s, 2) * speed[:, None] ** 2
    return s, np.maximum(speed, 0.0), np.einsum("kj,kj->k", rest, tangent) / square


def _arc_length(points: np.ndarray) -> np.ndarray:
    """Return the length of the polygon through the points up to each of them (K,)."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _static_values(
    problem: TrajectoryProblem, motion: ResolvedMotion, source: Assessment
) -> np.ndarray:
    """Return the values of the static variables on a motion."""
    values = [variable.start(source) for variable in static_variables(problem, motion)]
    # On a baseline with slipping connections they are infinite: any finite start is as good.
    return np.asarray(np.nan_to_num(np.array(values), nan=1e-3, posinf=1e-3))


def _phase_fractions(source: Assessment, motion: ResolvedMotion) -> np.ndarray:
    """Return the shares of the duration between the vias, in order."""
    borders, first = [0.0], 0
    for via in motion.vias:
        distance = np.max(np.abs(source.position - via), axis=1)
        first += int(np.argmin(distance[first:]))
        borders.append(float(source.time[first]))
    shares = np.diff([*borders, source.duration]) / source.duration
    shares = np.maximum(shares, shortest_phase_share(len(shares)))
    return np.asarray(shares / shares.sum())
