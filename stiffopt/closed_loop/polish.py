"""Fits of a closed loop to measured positions: leading values first, limits of drives, scores."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from stiffopt.closed_loop.arm import CommandedArm
from stiffopt.closed_loop.least_squares import LEADING_SECONDS, LoopFit, Polished, Score
from stiffopt.closed_loop.parameters import Parameters
from stiffopt.closed_loop.simulation import CommandedRun

# Limits of drives that a fit may begin with, over what filtered torques tell.
_LIMIT_FACTORS = np.linspace(0.8, 1.6, 17)


def polish(
    loop: CommandedArm,
    runs: Sequence[CommandedRun],
    prior: Parameters,
    deviations: np.ndarray,
    say: Callable[[str], object] = lambda _: None,
    *,
    scaled: bool = True,
    start: Parameters | None = None,
) -> Polished:
    """Fit the parameters that have a deviation to the positions of some runs.

    Least squares with the prior, bounded, by Levenberg-Marquardt steps with exact derivatives. The
    residual of a servo repeats itself from row to row: its noise is raised by the number of rows
    that repeat one another, so that neither prior nor deviations are overruled by mere samples.
    The leading parameters are fitted first, to less motion and without the others' derivatives.

    `prior`: expected values, with which the fit begins; `deviations` (p,): one standard deviation
    of each, 0 fixes a parameter; `say`: called with a sentence at every iteration; `scaled`: see
    `LoopFit`; `start`: values to begin with in place of a fit of the leading parameters.

    Raises
    ------
    FloatingPointError
        The simulation diverges with the prior.
    """
    prior = _begin_limits(loop, runs, prior, deviations)
    if start is None:
        start = polish_leading(loop, runs, prior, deviations, say, scaled=scaled).parameters
    return LoopFit(loop, runs, prior, deviations, scaled=scaled).polish(start, say)


def _begin_limits(
    loop: CommandedArm, runs: Sequence[CommandedRun], prior: Parameters, deviations: np.ndarray
) -> Parameters:
    """Return a prior with the limits of drives, of some about each, that simulate the runs best.

    One too low lets the joint drift, one too high never acts: no slope leads back from there.
    """
    fit = LoopFit(loop, runs, prior, deviations)
    for joint in loop.physics.limits:
        _, tried = _tried_limits(loop, prior, joint)
        prior = min((replace(prior, values=own) for own in tried), key=fit.misfit)
    return prior


def _tried_limits(
    loop: CommandedArm, prior: Parameters, joint: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the values without a limit of the drive of a joint (from 0), and (k, p) with some.

    Damping that nobody states is the actuator's own, within its limit, or friction.
    """
    symbols = ca.vertsplit(loop.physics.amplitudes.symbols)

    def place(symbol: ca.SX) -> int:
        same = [ca.is_equal(own, symbol) for own in symbols]
        return int(prior.amplitudes.start) + same.index(True)

    limit, none = place(loop.physics.limits[joint]), prior.values.copy()
    none[limit] = np.inf
    tried = np.tile(prior.values, (len(_LIMIT_FACTORS), 1))
    tried[:, limit] *= _LIMIT_FACTORS
    if (damped := loop.physics.damped.get(joint)) is not None:
        tried = np.vstack([tried, tried])
        tried[:, place(damped)] = np.repeat([0.0, 1.0], len(_LIMIT_FACTORS))
    return none, tried


def polish_leading(
    loop: CommandedArm,
    runs: Sequence[CommandedRun],
    prior: Parameters,
    deviations: np.ndarray,
    say: Callable[[str], object] = lambda _: None,
    *,
    scaled: bool = True,
) -> Polished:
    """Fit the leading parameters alone, to a part of the motion."""
    leading = np.where(prior.leading, deviations, 0.0)
    fit = LoopFit(loop, runs, prior, leading, scaled=scaled, seconds=LEADING_SECONDS)
    return fit.polish(prior, say)


def score_amplitudes(
    loop: CommandedArm,
    runs: Sequence[CommandedRun],
    fitted: Polished,
    groups: Sequence[Sequence[int]],
    joint: int,
) -> list[Score | None]:
    """Score groups of further amplitudes of a loop beside its fit; None without any effect.

    They are scored where the fit leaves most in a `joint` (from 0). `loop`: with the physics of the
    fit, then the further ones. `groups`: which of these are of one cause.

    Raises
    ------
    FloatingPointError
        The simulation diverges with the further physics, such as a spring that the servo excites.
    """
    own = loop.physics.amplitudes
    more = len(own.values) - len(fitted.parameters.amplitude_bounds)

    def extended(values: np.ndarray, added: np.ndarray) -> np.ndarray:
        return np.concatenate([values[:-1], added, values[-1:]])

    def with_none(known: Parameters) -> Parameters:
        whole = extended(known.values, np.zeros(more))
        return replace(known, values=whole, amplitude_bounds=own.bounds)

    deviations = extended(fitted.expected_deviations, own.deviations[len(own.values) - more :])
    fit = LoopFit(loop, runs, with_none(fitted.expected), deviations)
    parameters = with_none(fitted.parameters)
    fit.restrict(parameters, joint)
    return fit.score(parameters, groups, more)


def limit_gain(
    loop: CommandedArm, runs: Sequence[CommandedRun], prior: Parameters, joint: int
) -> float:
    """Return by how much the log residuals sink with the best limit of a joint (from 0).

    A drive gives no torque above its limit: where the highest level makes the simulation worse, the
    limit is not below it.
    """
    fit = LoopFit(loop, runs, prior, np.ones_like(prior.values))
    without, tried = _tried_limits(loop, prior, joint)
    highest = np.arange(1, 1 + len(tried)) % len(_LIMIT_FACTORS) == 0
    none, *misfits = (fit.misfit(replace(prior, values=own)) for own in (without, *tried[highest]))
    if min(misfits) <= none:
        misfits += [fit.misfit(replace(prior, values=own)) for own in tried[~highest]]
    return none - min(misfits)
