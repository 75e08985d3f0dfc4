"""In which swing training runs begin, as what the nominal model leaves of them tells.

Links are taken to begin near their slow motion, which is all that the motors tell. Of light damping
and sharp motions that is off by several times the noise in some run; springs bend, so that what it
makes is no free swing of the model, and damping moves to meet it. Free swings count as noise in a
fit anyway: nothing is hidden by beginning with them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stiffopt.discovery.comparison.columns import NEAR
from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.prepare import PreparedRun
from stiffopt.discovery.comparison.swung_run import with_links

# Times that starts are told anew: springs bend. And squares that a swing takes away over those of
# one row that stay, by which it is more than what chance gives beside all that is missing.
_ROUNDS, _CHANCE = 2, 3.0


def begun(comparison: Comparison) -> tuple[PreparedRun, ...]:
    """The runs, their links begun so that less is left of them; as they are where nothing is won.

    Parameters
    ----------
    comparison : Comparison
        With the nominal model.
    """
    left = _left(comparison)
    for _ in range(_ROUNDS):
        states = _states(comparison)
        if all(state is None for state in states):
            break
        runs = [
            run if state is None else begin_by(run, comparison, state)
            for run, state in zip(comparison.nominal_runs, states, strict=True)
        ]
        moved = comparison.along(runs)
        now = _left(moved)
        rows, swings = comparison.columns.unknown.shape
        if left - now <= _CHANCE * swings * now / rows:
            break
        comparison, left = moved, now
    return comparison.nominal_runs


def _left(comparison: Comparison) -> float:
    """Squares over noise that neither nominal values nor free swings take away."""
    return float(np.sum(comparison.fit().residual ** 2))


def _states(comparison: Comparison) -> list[np.ndarray | None]:
    """Likeliest displacement and speed (2 n,) by which each run begins otherwise.

    None where links would move by less than is let be.
    """
    columns = comparison.columns
    names, _, nuisance = columns.nuisance
    left = columns.target - nuisance @ comparison.fit().posterior.mean[: len(names)]
    rows, unknown = comparison.rows, columns.unknown
    sizes = np.linalg.solve(unknown.T @ unknown + np.eye(unknown.shape[1]), unknown.T @ left)
    usual = np.maximum(np.bincount(rows.channel) / len(comparison.runs), 1.0)
    states: list[np.ndarray | None] = []
    first = 0
    for run in comparison.runs:
        modes = run.starts()
        own = slice(first, first + modes.shape[1])
        first = own.stop
        square = np.bincount(rows.channel, (unknown[:, own] @ sizes[own]) ** 2)
        moves = bool(np.any(square > NEAR**2 * usual))
        states.append(modes @ sizes[own] if moves else None)
    return states


def begin_by(run: PreparedRun, comparison: Comparison, state: np.ndarray) -> PreparedRun:
    """The run with links that begin by a state (2 n,) beside where they did."""
    assert run.swing is not None
    begun = state if run.begun is None else run.begun + state
    springs = run.springs(comparison.robot)
    links = springs.started(run.swing.begin, run.swing, aside=begun)
    if links is None:
        return run
    return replace(with_links(run, comparison.robot, links), begun=begun)
