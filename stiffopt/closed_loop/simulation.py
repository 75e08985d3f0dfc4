"""Simulation of a recorded run from its commands, by stretches, with derivatives."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stiffopt.actuator.law import mean_command
from stiffopt.closed_loop.arm import CommandedArm
from stiffopt.closed_loop.parameters import Parameters

# Longest step of the integrator [s]: a thirtieth of the period of a 12 Hz motion.
_MAX_STEP = 2.5e-3
# Commands at the beginning of a run that bound its initial velocity [s], and steps in which this
# settles while the position is held.
_BEGINNING_SECONDS, _SETTLING_STEPS = 0.05, 200


@dataclass(frozen=True, eq=False)
class CommandedRun:
    """Commands and measured positions of one run, in the joint order of the robot.

    Parameters
    ----------
    name : str
    time : array (K,) [s]
    command, position : array (K, n)
        [rad], complete.
    velocity : array (K, n)
        Smoothed, to begin stretches of a fit with [rad/s].
    """

    name: str
    time: np.ndarray
    command: np.ndarray
    position: np.ndarray
    velocity: np.ndarray

    def until(self, end: float) -> CommandedRun:
        """Return the beginning of the run up to a time [s]."""
        rows = slice(0, int(np.searchsorted(self.time, end, side="right")))
        arrays = ("time", "command", "position", "velocity")
        return replace(self, **{name: getattr(self, name)[rows] for name in arrays})


@dataclass(frozen=True, eq=False)
class Simulated:
    """Simulated positions (K, n) [rad] and their derivatives (K, n, m) by free parameters."""

    position: np.ndarray
    slopes: np.ndarray


def simulate(
    loop: CommandedArm,
    run: CommandedRun,
    parameters: Parameters,
    free: np.ndarray | None = None,
    stretch: int | None = None,
) -> Simulated:
    """Simulate a run from its first measured position.

    Parameters
    ----------
    loop : CommandedArm
    run : CommandedRun
    parameters : Parameters
    free : array of int, optional
        Parameters to derive by, beside the delay; default none.
    stretch : int, optional
        Rows after which the simulation begins anew at the measured state, for fits: errors of a
        long run do not add up. Default: one stretch that sees no position but the first.
    """
    free = np.zeros(0, dtype=int) if free is None else free
    count = len(run.time)
    whole = Simulated(np.empty_like(run.position), np.zeros((*run.position.shape, len(free) + 1)))
    for begin in range(0, count - 1, stretch or count):
        end = min(begin + (stretch or count), count - 1)
        velocity = run.velocity[begin] if stretch else initial_velocity(loop, run, parameters)
        part = _simulate_stretch(loop, run, parameters, free, (begin, end), velocity)
        rows = slice(begin, end + 1)
        whole.position[rows], whole.slopes[rows] = part.position, part.slopes
    return whole


def initial_velocity(loop: CommandedArm, run: CommandedRun, parameters: Parameters) -> np.ndarray:
    """Return the velocity (n,) at which a run begins, from its commands and first position alone.

    A recording may begin in motion. Its velocity is that at which the actuators balance friction
    and weight at the first position error, in the direction and within the rate of the commands
    that follow; an arm that its friction holds begins at rest.
    """
    span = int(np.searchsorted(run.time, run.time[0] + _BEGINNING_SECONDS))
    span = min(max(span, 1), len(run.time) - 1)
    rate = (run.command[span] - run.command[0]) / (run.time[span] - run.time[0])
    step = loop.step_function(np.zeros(0, dtype=int))
    given = np.concatenate([run.command[0], np.zeros(loop.n)])
    velocity = np.zeros(loop.n)
    for _ in range(_SETTLING_STEPS):
        state = np.concatenate([run.position[0], velocity, np.zeros(2 * loop.n)])
        after = np.asarray(step(state, given, parameters.values, _MAX_STEP))[:, 0]
        velocity = after[loop.n : 2 * loop.n]
    return np.clip(velocity, np.minimum(rate, 0.0), np.maximum(rate, 0.0))


def _simulate_stretch(
    loop: CommandedArm,
    run: CommandedRun,
    parameters: Parameters,
    free: np.ndarray,
    rows: tuple[int, int],
    velocity: np.ndarray,
) -> Simulated:
    """Simulate from one row to another."""
    n, m = loop.n, len(free) + 1
    time = run.time[rows[0] : rows[1] + 1]
    steps = np.maximum(np.ceil(np.diff(time) / _MAX_STEP - 1e-9).astype(int), 1)
    width = np.repeat(np.diff(time) / steps, steps)
    grid = time[0] + np.concatenate([[0.0], np.cumsum(width)])
    delay = parameters.delay
    command, rate = mean_command(run.time, run.command, grid[:-1] - delay, grid[1:] - delay)
    start = np.concatenate([run.position[rows[0]], velocity, np.zeros(2 * n * m)])
    function = loop.step_function(free).mapaccum(len(width))
    given = np.hstack([command, -rate]).T
    values = np.tile(parameters.values[:, None], (1, len(width)))
    states = np.asarray(function(start, given, values, width[None]))
    states = np.hstack([start[:, None], states])[:, np.concatenate([[0], np.cumsum(steps)])]
    slopes = states[2 * n :].reshape(m, 2 * n, -1)[:, :n].transpose(2, 1, 0)
    return Simulated(states[:n].T, slopes)
