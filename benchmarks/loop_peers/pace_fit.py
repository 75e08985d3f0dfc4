"""Fit as PACE (Bjelonic et al. 2025) does it: CMA-ES over whole simulated runs.

Armature, viscous and dry friction and encoder bias of each joint, one delay of all; the gains are
those stated, bodies are nominal. Bounds are those that its authors' followers use for this robot,
with the encoder bias of the method's own default. Needs the package `cma`.
"""

from __future__ import annotations

import copy
from typing import Any

import cma
import numpy as np

from .leg import JOINTS, Run, build_spec, simulate

# Lower and upper bound of each joint's parameters, in the order of a candidate; then of the delay.
BOUNDS = {
    "armature": (1e-5, 1.0),
    "damping": (0.0, 7.0),
    "frictionloss": (0.0, 1.0),
    "bias": (-0.1, 0.1),
}
DELAY_BOUNDS = (0.0, 0.025)  # [s]
# Initial width of the search over that of the normalised bounds (2), as there.
_INITIAL_WIDTH = 0.5


def fit(urdf: Any, run: Run, generations: int, population: int, seed: int = 1) -> tuple[Any, ...]:
    """Return a simulation of runs by the fitted model, and the fitted values."""
    count = len(JOINTS)
    low, high = (
        np.array([*np.repeat([b[k] for b in BOUNDS.values()], count), DELAY_BOUNDS[k]])
        for k in (0, 1)
    )
    compiled = build_spec(urdf).compile()

    def simulated(values: np.ndarray, own: Run) -> np.ndarray:
        models, controls, biases = [], [], []
        for each in values:
            model = copy.copy(compiled)
            model.dof_armature[:], damping, model.dof_frictionloss[:], bias = np.split(
                each[:-1], len(BOUNDS)
            )
            np.reshape(model.dof_damping, (count, -1))[:, 0] = damping
            models.append(model)
            controls.append(own.mean_command(each[-1]))
            biases.append(bias)
        return simulate(models, own, controls, biases)

    def costs(candidates: list[np.ndarray]) -> list[float]:
        values = low + 0.5 * (np.array(candidates) + 1.0) * (high - low)
        error = simulated(values, run) - run.position
        return np.mean(error**2, axis=(1, 2)).tolist()

    search = cma.CMAEvolutionStrategy(
        np.zeros(len(low)),
        _INITIAL_WIDTH,
        {"bounds": [-1.0, 1.0], "popsize": population, "seed": seed, "verbose": -9},
    )
    for _ in range(generations):
        if search.stop():
            break
        candidates = search.ask()
        search.tell(candidates, costs(candidates))
    best = low + 0.5 * (np.array(search.result.xbest) + 1.0) * (high - low)
    table = dict(zip(BOUNDS, np.split(best[:-1], len(BOUNDS)), strict=True))
    return lambda own: simulated(best[None], own)[0], {**table, "delay": best[-1:]}
