"""Simulation of recorded runs from their commands, several stretches at once, with derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from stiffopt.actuator.law import mean_command
from stiffopt.closed_loop.arm import CommandedArm
from stiffopt.closed_loop.parameters import Parameters
from stiffopt.interpreter.batched import POINTS

# Longest duration of a stretch that is judged, and of the motion before it that forgets the state
# that it began with, several times the settling of a servo [s]. Of shorter stretches than half the
# longest, the rest of that state would be a third of the residual of a fit that lacks nothing.
STRETCH_SECONDS, _LEAD_SECONDS = 2.0, 0.5
_GOLDEN_RATIO = 0.5 * (5.0**0.5 - 1.0)
# Longest step of the integrator [s]: a servo's own motion takes ten or more of them.
_MAX_STEP = 1e-3
# Commands at the beginning of a run that bound its initial velocity [s], and steps in which this
# settles while the position is held.
_BEGINNING_SECONDS, _SETTLING_STEPS = 0.05, 200


@dataclass(frozen=True, eq=False)
class CommandedRun:
    """Commands and measured positions of one run, in the joint order of the robot."""

    name: str
    time: np.ndarray  # (K,) [s]
    # (K, n) [rad], complete.
    command: np.ndarray
    position: np.ndarray
    velocity: np.ndarray  # (K, n) smoothed, to begin stretches of a fit with [rad/s]


@dataclass(frozen=True, eq=False)
class Stretch:
    """Rows of a run from `begin` to `end`, both included, that are simulated from one state."""

    run: CommandedRun
    begin: int
    end: int
    velocity: np.ndarray  # (n,) at the beginning [rad/s]


@dataclass(frozen=True, eq=False)
class RunRows:
    """Rows of a run from `first` until `end` that are judged; those before lead into them."""

    run: CommandedRun
    first: int
    end: int


def rows_after_leads(runs: Sequence[CommandedRun], step: float) -> list[RunRows]:
    """Return the judged rows of every run: all but those that lead into it."""
    lead = round(_LEAD_SECONDS / step)
    return [RunRows(run, min(lead, len(run.time) // 4), len(run.time)) for run in runs]


def moving_rows(runs: Sequence[CommandedRun], step: float, seconds: float) -> list[RunRows]:
    """Return judged rows of a duration at most, of all runs, in which every joint moves.

    Recordings begin at rest, and joints may move in turn: pieces are taken by how much of the usual
    travel of a stretch they add to each joint. Of equal ones those far apart come first.
    """
    whole = rows_after_leads(runs, step)
    if step * sum(part.end - part.first for part in whole) <= seconds:
        return whole
    size = max(round(STRETCH_SECONDS / step), 2)
    pieces = [
        RunRows(part.run, first, min(first + size, part.end))
        for part in whole
        for first in range(part.first, part.end, size)
    ]
    travel = np.array([np.ptp(own.run.position[own.first : own.end], axis=0) for own in pieces])
    usual = np.sqrt(np.mean(travel**2, axis=0))
    share = np.minimum(travel / np.where(usual > 0.0, usual, np.inf), 1.0)
    # Fractions of multiples of the golden ratio are spread evenly, however many there are.
    left = np.argsort(_GOLDEN_RATIO * np.arange(len(pieces)) % 1.0).tolist()
    covered, chosen, rows = np.zeros(share.shape[1]), [], 0
    while left and step * rows < seconds:
        added = np.log1p(share[left] / (1.0 + covered)).sum(axis=1)
        best = left.pop(int(np.argmax(added)))
        covered += share[best]
        chosen.append(best)
        rows += pieces[best].end - pieces[best].first
    return _joined([pieces[k] for k in sorted(chosen)])


def _joined(pieces: Sequence[RunRows]) -> list[RunRows]:
    """Return pieces of rows with those that follow one another in one."""
    found = [pieces[0]]
    for own in pieces[1:]:
        last = found[-1]
        if own.run is last.run and own.first == last.end:
            found[-1] = RunRows(own.run, last.first, own.end)
        else:
            found.append(own)
    return found


def divide_rows(parts: Sequence[RunRows], step: float) -> tuple[list[Stretch], list[int]]:
    """Return stretches of judged rows and the leads of each.

    As many as fill calls of a step, from half the longest duration to that.
    """
    lead, longest = (round(seconds / step) for seconds in (_LEAD_SECONDS, STRETCH_SECONDS))
    counts = np.array([part.end - part.first for part in parts])
    calls = np.ceil(counts.sum() / (POINTS * max(longest, 2)))
    pieces = np.maximum(POINTS * calls * counts // counts.sum(), 1).astype(int)
    stretches, leads = [], []
    for part, own in zip(parts, pieces, strict=True):
        own = min(own, max(2 * (part.end - part.first) // max(longest, 4), 1))
        edges = np.linspace(part.first, part.end, own + 1)
        for first, end in pairwise(np.round(edges).astype(int).tolist()):
            begin = max(first - lead, 0)
            stretches.append(Stretch(part.run, begin, end - 1, part.run.velocity[begin]))
            leads.append(first - begin)
    return stretches, leads


@dataclass(frozen=True, eq=False)
class Simulated:
    """Simulated positions (K, n) [rad] and their derivatives (K, n, m) by free parameters."""

    position: np.ndarray
    slopes: np.ndarray


def simulate(loop: CommandedArm, run: CommandedRun, parameters: Parameters) -> np.ndarray:
    """Return positions (K, n) [rad], simulated from the commands and the first position."""
    velocity = initial_velocity(loop, run, parameters)
    whole = Stretch(run, 0, len(run.time) - 1, velocity)
    return simulate_stretches(loop, [whole], parameters)[0].position


def simulate_stretches(
    loop: CommandedArm,
    stretches: Sequence[Stretch],
    parameters: Parameters,
    free: np.ndarray | None = None,
    refinement: float = 1.0,
) -> list[Simulated]:
    """Simulate stretches side by side, each from its first measured position.

    `free`: parameters to derive by, beside the delay; default no derivatives. `refinement`: divides
    the longest step.
    """
    lanes, _ = loop.lanes(free)
    found: list[Simulated] = []
    for first in range(0, len(stretches), lanes):
        found += _simulate_together(
            loop, stretches[first : first + lanes], parameters, free, refinement
        )
    return found


def _simulate_together(
    loop: CommandedArm,
    stretches: Sequence[Stretch],
    parameters: Parameters,
    free: np.ndarray | None,
    refinement: float,
) -> list[Simulated]:
    """Simulate as many stretches as a call has lanes for."""
    n, m = loop.n, 0 if free is None else len(free) + 1
    lanes, step = loop.lanes(free)
    late = parameters.delay + parameters.of("lateness")
    drives = [_drive(own, late, _MAX_STEP / refinement) for own in stretches]
    steps = max(len(drive.width) for drive in drives)
    # Steps of no width change nothing: they fill lanes up.
    given, width = np.zeros((steps, lanes, 2 * n)), np.zeros((steps, lanes))
    state = np.zeros((lanes, loop.size * (1 + m)))
    row = np.zeros((steps, lanes), dtype=int)  # that each step ends at, 0 for none
    rows = max(len(drive.ends) for drive in drives) + 1
    position, slopes = np.zeros((lanes, rows, n)), np.zeros((lanes, rows, n, m))
    for lane, (own, drive) in enumerate(zip(stretches, drives, strict=True)):
        given[: len(drive.width), lane], width[: len(drive.width), lane] = drive.given, drive.width
        row[drive.ends - 1, lane] = np.arange(1, len(drive.ends) + 1)
        position[lane, 0] = own.run.position[own.begin]
        before = _before(own, late) if loop.integrating else [position[lane, 0]] * 3
        begun = loop.begin(position[lane, 0], own.velocity, parameters.values, before, free)
        state[lane, : loop.size] = begun[0]
        if begun[1].size:  # the last sensitivity is that by the delay
            state[lane, loop.size : -loop.size] = begun[1].T.reshape(-1)
    state[len(stretches) :] = state[0]
    after = state.reshape(-1)
    for own_given, own_width, own_row in zip(given, width, row, strict=True):
        (after,) = step(after, own_given.reshape(-1), parameters.values, own_width)
        met = np.flatnonzero(own_row)
        if len(met):
            reading = after.reshape(lanes, 1 + m, loop.size)[met, :, :n]
            position[met, own_row[met]] = reading[:, 0]
            slopes[met, own_row[met]] = reading[:, 1:].transpose(0, 2, 1)
    return [
        Simulated(position[lane, : len(drive.ends) + 1], slopes[lane, : len(drive.ends) + 1])
        for lane, drive in enumerate(drives)
    ]


def _before(own: Stretch, delays: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return readings and errors (n,) at the beginning of the run, and the errors' integral since.

    Commands come late by `delays` (n,).
    """
    run, rows = own.run, slice(0, own.begin + 1)
    first, span = run.time[0], float(run.time[own.begin] - run.time[0])
    since = -np.trapezoid(run.position[rows], run.time[rows], axis=0)
    for j, delay in enumerate(delays if span else ()):
        ends = np.array([first - delay]), np.array([first + span - delay])
        since[j] += span * float(mean_command(run.time, run.command[:, j : j + 1], *ends)[0][0, 0])
    return run.position[0], run.command[0] - run.position[0], since


@dataclass(frozen=True, eq=False)
class _Drive:
    """Commands and their rates (k, 2 n) at steps of some width (k,), and steps until each row."""

    given: np.ndarray
    width: np.ndarray
    ends: np.ndarray


def _drive(own: Stretch, delays: np.ndarray, max_step: float) -> _Drive:
    """Return the steps of a stretch, by delays (n,) of commands: rows are divided evenly."""
    run = own.run
    time = run.time[own.begin : own.end + 1]
    steps = np.maximum(np.ceil(np.diff(time) / max_step - 1e-9).astype(int), 1)
    width = np.repeat(np.diff(time) / steps, steps)
    grid = time[0] + np.concatenate([[0.0], np.cumsum(width)])
    means = [
        mean_command(run.time, own_command[:, None], grid[:-1] - delay, grid[1:] - delay)
        for own_command, delay in zip(run.command.T, delays, strict=True)
    ]
    command, rate = (np.hstack(each) for each in zip(*means, strict=True))
    return _Drive(np.hstack([command, -rate]), width, np.cumsum(steps))


def initial_velocity(loop: CommandedArm, run: CommandedRun, parameters: Parameters) -> np.ndarray:
    """Return the velocity (n,) at which a run begins, from its commands and first position alone.

    A recording may begin in motion. Its velocity is that at which the actuators balance friction
    and weight at the first position error, in the direction and within the rate of the commands
    that follow; an arm that its friction holds begins at rest.
    """
    span = int(np.searchsorted(run.time, run.time[0] + _BEGINNING_SECONDS))
    span = min(max(span, 1), len(run.time) - 1)
    rate = (run.command[span] - run.command[0]) / (run.time[span] - run.time[0])
    step = loop.step_function()
    given = np.concatenate([run.command[0], np.zeros(loop.n)])
    n = loop.n
    before = run.position[0], run.command[0] - run.position[0], np.zeros(n)
    state, _ = loop.begin(run.position[0], np.zeros(n), parameters.values, before)
    for _ in range(_SETTLING_STEPS):
        state = np.asarray(step(state, given, parameters.values, _MAX_STEP))[:, 0]
        state[:n] = run.position[0]
    velocity: np.ndarray = state[n : 2 * n]
    return velocity.clip(np.minimum(rate, 0.0), np.maximum(rate, 0.0))
