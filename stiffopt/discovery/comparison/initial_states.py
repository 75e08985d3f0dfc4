"""Initial vibration of training runs, estimated from the residual of the nominal model.

Links are assumed to begin near their slow motion, which is all that the motors determine. With
light damping and sharp motions that is wrong by several times the noise in some run; springs are
nonlinear, so the resulting error is no free vibration of the model, and the damping is biased. Free
vibration counts as noise in a fit anyway: initial states hide no effect.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.design_matrix import MAX_LINEARISATION_ERROR
from stiffopt.discovery.comparison.extended_run import with_link_motion
from stiffopt.discovery.comparison.prepared_run import PreparedRun

# Rounds of the estimate, since springs are nonlinear; and the squares explained per initial state
# over the residual mean square, above which they are significant in spite of missing effects.
_MAX_ROUNDS, _MIN_SIGNIFICANT_GAIN = 2, 3.0


def estimate_initial_states(comparison: Comparison) -> tuple[PreparedRun, ...]:
    """Return the runs with initial states that reduce the residual, or unchanged.

    `comparison`: comparison with the nominal model.
    """
    left = _residual_square(comparison)
    for _ in range(_MAX_ROUNDS):
        states = _initial_state_changes(comparison)
        if all(state is None for state in states):
            break
        runs = [
            run if state is None else with_initial_state(run, state)
            for run, state in zip(comparison.nominal_runs, states, strict=True)
        ]
        moved = comparison.with_runs(runs)
        now = _residual_square(moved)
        rows, modes = comparison.columns.initial_state_columns.shape
        if left - now <= _MIN_SIGNIFICANT_GAIN * modes * now / rows:
            break
        comparison, left = moved, now
    return comparison.nominal_runs


def _residual_square(comparison: Comparison) -> float:
    """Return the squares over noise that nuisance values and free vibration leave."""
    return float(np.sum(comparison.fit().residual ** 2))


def _initial_state_changes(comparison: Comparison) -> list[np.ndarray | None]:
    """Return the likeliest change of displacement and velocity (2 n,) of each run.

    None where the links would move by less than the linearisation error allowed.
    """
    columns = comparison.columns
    left = columns.target - columns.nominal_rows(comparison.fit().posterior.mean)
    rows, unknown = comparison.rows, columns.initial_state_columns
    sizes = np.linalg.solve(unknown.T @ unknown + np.eye(unknown.shape[1]), unknown.T @ left)
    usual = np.maximum(np.bincount(rows.channel) / len(comparison.runs), 1.0)
    states: list[np.ndarray | None] = []
    first = 0
    for run in comparison.runs:
        modes = run.initial_states()
        own = slice(first, first + modes.shape[1])
        first = own.stop
        square = np.bincount(rows.channel, (unknown[:, own] @ sizes[own]) ** 2)
        moves = bool(np.any(square > MAX_LINEARISATION_ERROR**2 * usual))
        states.append(modes @ sizes[own] if moves else None)
    return states


def with_initial_state(run: PreparedRun, state: np.ndarray) -> PreparedRun:
    """Return the run with links that begin at an added state (2 n,)."""
    assert run.vibration is not None
    state = state if run.initial_state is None else run.initial_state + state
    springs = run.springs()
    links = springs.solve_from_slow(run.vibration.reference, run.vibration, aside=state)
    if links is None:
        return run
    return replace(with_link_motion(run, links), initial_state=state)
