"""The rigid model re-identified: all bodies are free together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shipped_set import SHIPPED

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.inertial_parameters import body_units
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.comparison.prepared_run import PreparedRun
from stiffopt.discovery.search.rigid_model import PRIOR_WIDTHS, reidentify_rigid_model
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import Training, prepare_training
from stiffopt.recording.recording_set import load_recordings

THERE = LocatedEffect(effect=effect("coulomb"), joint=1)


@pytest.fixture(scope="module")
def training() -> Training:
    return prepare_training(load_recordings(SHIPPED), Settings(), vibrating=False)


def _balanced(training: Training) -> Comparison:
    """Gas in a cylinder on a crank holds the first joint: no mass of any link."""

    def held(run: PreparedRun) -> PreparedRun:
        angle = run.signals.link_position[:, 0] + 0.5
        length = np.sqrt(1.09 - 0.6 * np.cos(angle))
        added = np.zeros_like(run.torque)
        added[:, 0] = 60.0 * (1.2 / (1.9 - length)) ** 1.3 * 0.3 * np.sin(angle) / length
        nothing = np.zeros_like(run.deflection_used)
        return replace(run, torque=run.torque + added, deflection_used=nothing)

    return replace(training, runs=tuple(map(held, training.runs))).comparison()


def test_all_bodies_are_as_free_as_one_another(training: Training) -> None:
    comparison = _balanced(training)
    stage = reidentify_rigid_model(comparison, [THERE], ())
    assert stage.single is None
    assert stage.widths == (PRIOR_WIDTHS[-1],) * comparison.robot.n
    assert stage.bodies(comparison) == pytest.approx(
        PRIOR_WIDTHS[-1] * body_units(comparison.robot)
    )


def test_unphysical_body_is_compared_with_counterbalance(training: Training) -> None:
    """The law of a lever predicts parts left out better than any mass; nothing has moved else."""
    balancer = (effect("gravity_spring"),)
    (found,) = reidentify_rigid_model(_balanced(training), [THERE], balancer).counterweights
    assert (found.joint, found.balanced) == (0, True)
    assert found.change > found.nominal
    nothing = reidentify_rigid_model(training.comparison(), [THERE], balancer)
    assert nothing.counterweights == ()
