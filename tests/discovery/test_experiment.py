"""The next experiment: predicted separation, limits kept, and a rival told apart by it."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from benchmarks.simulator import CaseSpec, simulate, write_case
from stiffopt.discovery.catalogue import CATALOGUE
from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.design_matrix import DesignMatrix
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.experiment.design import (
    ExperimentPlan,
    Separation,
    leading_pair,
    plan_experiment,
)
from stiffopt.discovery.experiment.motion import (
    DRAWS_PER_JOINT,
    MotionLimits,
    fourier_motion,
    motion_limits,
    prepared_motion,
)
from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.search.search import SearchResult
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import Training, prepare_training
from stiffopt.recording.recording_set import load_recordings
from stiffopt.result.trajectory import Trajectory

SETTINGS = Settings()


@dataclass(frozen=True, eq=False)
class Found:
    """Training runs of a simulated arm with what a search would hand over."""

    training: Training
    comparison: Comparison
    result: SearchResult


def effect(name: str, joint: int | None = 0, shapes: tuple[float, ...] = ()) -> LocatedEffect:
    return LocatedEffect(
        effect=next(e for e in CATALOGUE if e.name == name), joint=joint, shapes=shapes
    )


COULOMB = effect("coulomb")
STRIBECK = effect("stribeck", shapes=(0.5, 0.5))
GAIN = effect("torque_gain")


@cache
def found() -> Found:
    """A planar arm with a higher Coulomb level in its first joint."""
    spec = CaseSpec(
        robot="planar2",
        effects=(("coulomb", 1, 0.5),),
        seed=3,
        train=3,
        test=1,
        extrapolate=0,
        seconds=5.0,
        rate=200.0,
    )
    with tempfile.TemporaryDirectory(prefix="stiffopt-") as folder:
        recordings = load_recordings(write_case(simulate(spec), Path(folder) / "set"))
        training = prepare_training(recordings, SETTINGS)
    comparison = training.comparison()
    ratio = comparison.channel_ratio(comparison.target)
    result = SearchResult(
        (), comparison, comparison.fit((COULOMB,)), None, ratio, ratio, ratio, comparison.target
    )
    return Found(training, comparison, result)


@cache
def plan() -> ExperimentPlan:
    own = found()
    designed = plan_experiment(own.training, own.result, (COULOMB, STRIBECK))
    assert designed is not None
    return designed


def random_motion(
    limits: MotionLimits, duration: float, random: np.random.Generator
) -> Trajectory | None:
    robot = found().training.robot
    return fourier_motion(limits, robot, duration, random.normal(size=(robot.n, DRAWS_PER_JOINT)))


def test_same_explanation_has_no_separation() -> None:
    own = found()
    separation = Separation(own.comparison, COULOMB, COULOMB)
    assert separation.of(own.training.runs[0]) == pytest.approx(0.0, abs=1e-6)


def test_motion_that_hardly_moves_separates_nothing() -> None:
    own = found()
    limits = motion_limits(own.training)
    still = replace(limits, velocity=1e-3 * limits.velocity)
    motion = random_motion(still, 5.0, np.random.default_rng(2))
    assert motion is not None
    run = prepared_motion(own.training, motion)
    assert not run.torque_used.any()
    # As an arm without link encoders has it.
    run = replace(run, deflection_used=np.zeros_like(run.deflection_used))
    assert Separation(own.comparison, COULOMB, STRIBECK).of(run) == 0.0


def test_separation_is_residual_of_rival_refit() -> None:
    """Brute force: least squares with the posterior as pseudo-measurements of the parameters."""
    own = found()
    run = own.training.runs[0]
    base = own.comparison
    single = Comparison(DesignMatrix(base.robot, (run,), base.noise, base.tolerance))
    left = []
    fits = [base.fit((e,)) for e in (COULOMB, STRIBECK)]
    columns = [single.stack_columns([e]) for e in (COULOMB, STRIBECK)]
    gap = columns[0] @ fits[0].posterior.mean - columns[1] @ fits[1].posterior.mean
    for own_columns, fit in zip(columns, fits, strict=True):
        root = np.linalg.inv(np.linalg.cholesky(fit.posterior.covariance))
        stacked = np.vstack([own_columns, root])
        target = np.concatenate([gap, np.zeros(len(root))])
        best, *_ = np.linalg.lstsq(stacked, target, rcond=None)
        left.append(float(np.sum((target - stacked @ best) ** 2)))
    expected = np.sqrt(min(left))
    assert Separation(base, COULOMB, STRIBECK).of(run) == pytest.approx(expected, rel=1e-4)


def test_separation_is_independent_of_design_sampling() -> None:
    """One motion sampled at 100 Hz, and told to be recorded at 200 Hz, counts as 200 Hz."""
    own = found()
    limits = motion_limits(own.training)
    motion = random_motion(limits, 5.0, np.random.default_rng(2))
    assert motion is not None
    run = prepared_motion(own.training, motion)
    separation = Separation(own.comparison, COULOMB, STRIBECK)
    plain, finer = separation.of(run), separation.of(run, step=run.signals.dt / 4.0)
    # What four times the samples say is at most twice as much, since parameters stay open.
    assert plain < finer <= 2.0 * plain


def test_random_motions_keep_the_limits_and_start_at_rest() -> None:
    own = found()
    limits, random = motion_limits(own.training), np.random.default_rng(5)
    for _ in range(5):
        motion = random_motion(limits, 4.0, random)
        assert motion is not None
        assert limits.excess(own.training.robot, motion) <= 1.0
        times = np.linspace(0.0, motion.duration, 4001)
        assert np.all(np.abs(motion(times, 1)) <= limits.velocity * (1.0 + 1e-6))
        assert motion(0.0, 1) == pytest.approx(np.zeros(2), abs=1e-9)
        assert np.abs(motion(motion.duration, 1)).max() < 1e-3


def test_designed_motion_beats_the_training_runs_within_the_limits() -> None:
    designed, own = plan(), found()
    assert designed.separation > 1.2 * designed.reference
    robot, constants = own.training.robot, own.training.constants
    times = np.linspace(0.0, designed.motion.duration, 2000)
    q, v, a = (designed.motion(times, order) for order in range(3))
    arm, order = robot.arm, robot.order
    assert np.all(q >= arm.position_lower[order])
    assert np.all(q <= arm.position_upper[order])
    assert np.all(np.abs(v) <= arm.velocity_max[order])
    torque = robot.rotor_inertia * a + robot.spring_torque(q, v, a) + robot.friction(v)
    assert np.all(np.abs(torque) <= [j.torque_max for j in constants.joints])


def test_variations_improve_on_random_motions() -> None:
    """Also for an effect of several joints."""
    own = found()
    crosstalk = effect("crosstalk", shapes=(2.0,))
    separation = Separation(own.comparison, COULOMB, crosstalk)
    limits, random = motion_limits(own.training), np.random.default_rng(1)
    values = []
    for _ in range(24):
        motion = random_motion(limits, 5.0, random)
        assert motion is not None
        run = prepared_motion(own.training, motion)
        values.append(separation.of(run, step=own.training.runs[0].signals.dt))
    designed = plan_experiment(own.training, own.result, (COULOMB, crosstalk))
    assert designed is not None
    assert designed.separation > 1.1 * max(values)


def test_experiment_sentence_and_file() -> None:
    designed = plan()
    text = designed.sentence
    assert text.startswith("Record next_experiment.csv (5.0 s)")
    assert f"by {designed.separation:.1f} sigma" in text
    assert f"would by {designed.reference:.1f}" in text
    assert text.endswith(COULOMB.effect.separate)
    head, *rows = designed.csv().splitlines()
    assert head == "t,q1,q2,qd1,qd2"
    table = np.array([[float(x) for x in row.split(",")] for row in rows])
    assert table[-1, 0] == pytest.approx(designed.motion.duration)
    # Positions and velocities belong together.
    slope = np.gradient(table[:, 1], table[:, 0])[1:-1]
    assert slope == pytest.approx(table[1:-1, 3], abs=0.02 * np.abs(table[:, 3]).max())


def test_leading_pair_is_the_first_finding_with_rivals() -> None:
    def selected(located: LocatedEffect, *rivals: LocatedEffect) -> Selected:
        shares = tuple((r, 0.2) for r in rivals)
        return Selected(located, 50.0, 10.0, 0.6, shares, 0)

    of_a_run = replace(effect("encoder_zero_change"), run="train_1")
    assert leading_pair((selected(COULOMB),)) is None
    assert leading_pair((selected(COULOMB), selected(GAIN, of_a_run, STRIBECK))) == (GAIN, STRIBECK)
