"""Initial guess: toppra's motion, or the quintic one where toppra finds none."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stiffopt.problem.formulation import static_variables
from stiffopt.problem.trajectory import ResolvedMotion, TrajectoryProblem
from stiffopt.result.assessment import Assessment
from stiffopt.result.joint_path import JointPath
from stiffopt.result.solution import Baseline
from stiffopt.transcription.ocp import Guess

# Samples of a smoothed guess, and how many of the windows it is averaged over fill its duration.
_FINE = 2000
_WINDOWS = 25
# Of a path where a motion's place on it is sought, and projections onto its tangent after that.
_PATH_SAMPLES, _PROJECTIONS = 20001, 3


def initial_guess(
    problem: TrajectoryProblem, motion: ResolvedMotion, beside: dict[str, Baseline]
) -> Guess:
    """The motion of the first baseline that exists, as a guess."""
    source = next(b.assessment for b in (beside["toppra"], beside["quintic"]) if b.assessment)
    return guess_along(problem, motion, source)


def guess_along(problem: TrajectoryProblem, motion: ResolvedMotion, source: Assessment) -> Guess:
    """A guess from an assessed motion, sampled; vias at the instants where it passes them.

    On a fixed path its time law is taken over.
    """
    statics = _statics(problem, motion, source)
    if problem.path is not None:
        return _path_guess(JointPath.through(problem.path), source, statics)
    states, controls = np.hstack([source.position, source.velocity]), source.acceleration
    s = source.time / source.duration
    if problem.plans_links:
        s, states, controls = _smoothed(source)
    return Guess(
        states=_sampler(s, states),
        controls=_sampler(s, controls),
        duration=source.duration,
        statics=statics,
        phase_fractions=_phase_fractions(source, motion),
    )


def _smoothed(source: Assessment) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A motion compressed and then averaged five times over a short window, back to its duration.

    Returns
    -------
    s : array (m,)
        Scaled time.
    states, controls : array (m, 5 n), (m, n)
        Position and its derivatives up to snap, and the fifth.
    """
    s = np.linspace(0.0, 1.0, _FINE + 1)
    window = 2 * (_FINE // (2 * _WINDOWS)) + 1
    spread = 5 * (window - 1) / _FINE
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
        orders.append(np.gradient(orders[-1], source.duration / _FINE, axis=0))
    return s, np.hstack(orders[:5]), orders[5]


def _sampler(s: np.ndarray, values: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    def sample(at: np.ndarray) -> np.ndarray:
        columns = [np.interp(at, s, values[:, j]) for j in range(values.shape[1])]
        return np.stack(columns, axis=1)

    return sample


def _path_guess(path: JointPath, source: Assessment, statics: np.ndarray) -> Guess:
    """Time law of the motion as a guess of the path coordinate."""
    s, speed, acceleration = _time_law(path, source)
    at = source.time / source.duration
    return Guess(
        states=_sampler(at, np.stack([s, speed], axis=1)),
        controls=_sampler(at, acceleration[:, None]),
        duration=source.duration,
        statics=statics,
        phase_fractions=np.ones(1),
    )


def _time_law(path: JointPath, source: Assessment) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Path coordinate of a motion along a path, its speed and its acceleration (K,).

    Arc length tells the piece of the path, so that one that meets itself is followed in order;
    projection on the tangent removes what chords are shorter than the path.
    """
    dense = np.linspace(0.0, 1.0, _PATH_SAMPLES)
    covered, length = _arc_length(source.position), _arc_length(path(dense))
    s = np.interp(covered / covered[-1], length / length[-1], dense)
    for _ in range(_PROJECTIONS):
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
    """Length of the polygon through the points up to each of them (K,)."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _statics(problem: TrajectoryProblem, motion: ResolvedMotion, source: Assessment) -> np.ndarray:
    """Static variables as they are on the motion."""
    values = [variable.start(source) for variable in static_variables(problem, motion)]
    # A baseline far too fast makes connections slip: any finite bound will do then.
    return np.asarray(np.nan_to_num(np.array(values), nan=1e-3, posinf=1e-3))


def _phase_fractions(source: Assessment, motion: ResolvedMotion) -> np.ndarray:
    """Share of the duration between the vias, in order."""
    borders, first = [0.0], 0
    for via in motion.vias:
        distance = np.max(np.abs(source.position - via), axis=1)
        first += int(np.argmin(distance[first:]))
        borders.append(float(source.time[first]))
    shares = np.diff([*borders, source.duration]) / source.duration
    return np.asarray(np.maximum(shares, 0.02) / np.sum(np.maximum(shares, 0.02)))
