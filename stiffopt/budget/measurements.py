"""Measurements that would narrow a budget, by their effect on the worst bound of the position.

A measurement is linear in the sources; the sources given its result are again normally
distributed (Gauss-Markov), with a covariance that does not depend on the values measured.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.budget.budget import POSITION, ErrorBudget, ErrorModel, magnitude_bound
from stiffopt.budget.sources import States

# Standard deviation of one component of a laser tracker at a few metres [m].
TRACKER_DEVIATION = 2e-5
# Poses of a usual calibration or static set, spread over the joints' ranges.
_POSE_COUNT, _POSE_SEED = 30, 1
# Half range of a joint without position limits [rad].
_UNLIMITED_RANGE = np.pi
# Of the joints' largest torques, that a load for deflections may reach.
_LOAD_SHARE = 0.5


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """A measurement, and the bound of the position that it would leave."""

    name: str
    bound: float  # largest 95 % bound of the position along the motion after it [m]
    gain: float  # share by which that is below the bound before


def rank_measurements(model: ErrorModel, budget: ErrorBudget) -> list[Measurement]:
    """Return the measurements that narrow a budget, the best first."""
    before = float(np.max(budget.bound(POSITION)))
    if before == 0.0:
        return []
    effects = np.array([source.effect[:, POSITION] for source in budget.sources])
    mean = budget.mean[:, POSITION]
    found = []
    for name, information in _informations(model, budget):
        left = np.linalg.inv(np.eye(len(effects)) + information)
        covariance = np.einsum("ski,st,tkj->kij", effects, left, effects)
        bound = float(np.max(magnitude_bound(mean, covariance)))
        found.append(Measurement(name=name, bound=bound, gain=1.0 - bound / before))
    return sorted(found, key=lambda each: each.bound)


def _informations(model: ErrorModel, budget: ErrorBudget) -> Iterator[tuple[str, np.ndarray]]:
    """Yield names of measurements and their information (s, s) on the sources."""
    robot = model.robot
    groups = np.array([source.group for source in budget.sources])
    random = np.random.default_rng(_POSE_SEED)
    lower = np.where(np.isfinite(robot.position_lower), robot.position_lower, -_UNLIMITED_RANGE)
    upper = np.where(np.isfinite(robot.position_upper), robot.position_upper, _UNLIMITED_RANGE)
    poses = States.at_rest(random.uniform(lower, upper, (_POSE_COUNT, robot.n)))
    # Another loop state in every pose: hysteresis is noise here, and no measurement narrows it.
    unloaded = _position_effects(replace(model, process_force=np.zeros(3)), poses, budget)
    loop = groups == "hysteresis"
    accuracy = f"{1e3 * TRACKER_DEVIATION:g} mm in {_POSE_COUNT} poses"
    yield (
        f"calibration: tool position within {accuracy}",
        _information(np.where(loop[:, None, None], 0.0, unloaded), unloaded[loop]),
    )
    if np.any(groups == "torsion"):
        force, words = _test_force(model, poses)
        loaded = _position_effects(replace(model, process_force=force), poses, budget)
        change = np.where(loop[:, None, None], 0.0, loaded - unloaded)
        # Loop states before and after the load are independent, as are the two positions.
        noise = np.sqrt(2.0) * unloaded[loop]
        yield (
            f"identify-stiffness: deflection by {words} within {accuracy}",
            _information(change, noise, deviation=np.sqrt(2.0) * TRACKER_DEVIATION),
        )
    for group, name in (
        ("payload", "weighing of the payload"),
        ("servo", "recording of command and motor position (servo)"),
        ("thermal growth", "temperature of the links"),
    ):
        if np.any(groups == group):
            yield name, np.diag(np.where(groups == group, _KNOWN_INFORMATION, 0.0))


# Information on a source that is measured far better than it was known.
_KNOWN_INFORMATION = 1e6


def _position_effects(model: ErrorModel, states: States, budget: ErrorBudget) -> np.ndarray:
    """Effects (s, K, 3) of the budget's sources in other states; 0 where there is none."""
    found: dict[str, list[np.ndarray]] = {}
    for source in model.errors(states)[0]:
        found.setdefault(source.name, []).append(source.effect[:, POSITION])
    nothing = np.zeros((len(states.time), 3))
    effects = []
    for source in budget.sources:
        own = found.get(source.name)
        effects.append(own.pop(0) if own else nothing)
    return np.array(effects)


def _information(
    effects: np.ndarray, noise: np.ndarray, deviation: float = TRACKER_DEVIATION
) -> np.ndarray:
    """Information (s, s) of displacements (s, K, 3) with further noise (h, K, 3)."""
    spread = deviation**2 * np.eye(3) + np.einsum("hki,hkj->kij", noise, noise)
    weighted = np.einsum("kij,skj->ski", np.linalg.inv(spread), effects)
    return np.asarray(np.einsum("ski,tki->st", effects, weighted))


def _test_force(model: ErrorModel, poses: States) -> tuple[np.ndarray, str]:
    """Test force (3,) [N] that loads no joint beyond a share of its torque, and its words.

    A weight; where no joint carries weight, as with vertical axes alone, a horizontal pull.
    """
    robot = model.robot
    bodies = robot.rigid_bodies()
    arms = np.array([np.abs(bodies.jacobian(robot.tool, q)[:3]) for q in poses.position]).max(
        axis=0
    )
    with np.errstate(divide="ignore"):
        most = np.min(_LOAD_SHARE * robot.torque_max / arms, axis=1)
    axis = next((k for k in (2, 0, 1) if np.isfinite(most[k])), 0)
    size = float(most[axis]) if np.isfinite(most[axis]) else 0.0
    force = (-size if axis == 2 else size) * np.eye(3)[axis]
    return force, f"{size:.3g} N" + ("" if axis == 2 else f" along {'xy'[axis]}")
