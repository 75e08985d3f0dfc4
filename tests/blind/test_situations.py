"""Situations of users: every cause shows in the logs and is named by effects that exist."""

import numpy as np
import pytest

from benchmarks.situations.arms import draw_arm
from benchmarks.situations.causes import CAUSES, Programme, conceal
from benchmarks.situations.world import World, program
from stiffopt.discovery.catalogue import CATALOGUE

RUNS, SECONDS = 4, 1.0
# What a diagnosis tells beside its findings.
NO_EFFECTS = {"episode", "fault"}


def logged(world: World, way: np.ndarray) -> np.ndarray:
    """Return the logs of all runs, with the same noise whatever is concealed."""
    rng = np.random.default_rng(1)
    return np.vstack([world.run(k, k * SECONDS, way, rng, 4) for k in range(RUNS)])


@pytest.fixture(scope="module", name="healthy_program")
def simulate_healthy_arm():
    rng = np.random.default_rng(0)
    arm = draw_arm(rng)
    way = program(rng, arm, SECONDS, rng.uniform(-1.0, 1.0, (4, len(arm.masses))), 0.6)
    return arm, way, logged(World(arm), way)


@pytest.mark.parametrize("kind", CAUSES)
def test_a_cause_shows_in_the_logs_and_has_a_name(kind, healthy_program):
    (arm, way, healthy), rng = healthy_program, np.random.default_rng(2)
    asked = healthy[:, 1 + len(arm.masses) :]
    world = World(arm)
    truth = conceal(kind, world, rng, Programme(asked, RUNS, RUNS * SECONDS))
    names = {each.name for each in CATALOGUE}
    assert set(truth.effects) <= names | NO_EFFECTS
    changed = logged(world, way) - healthy
    joint = slice(None) if truth.joint is None else truth.joint - 1
    moved, torque = (
        changed[:, 1 + k * len(arm.masses) :][:, : len(arm.masses)][:, joint] for k in (0, 1)
    )
    noise = 0.006 * np.abs(asked).max(axis=0)[joint]
    # By all samples together.
    seen = np.linalg.norm(torque, axis=0) / noise
    assert np.abs(moved).max() > 1e-3 or np.max(seen) > 10.0
