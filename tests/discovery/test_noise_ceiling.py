"""A black box says what is left to explain, single values what a run has of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from shipped_set import LACKS, SHIPPED

from stiffopt.discovery.comparison.located_effect import Extension
from stiffopt.discovery.judging.noise_ceiling import BlackBox, NoiseCeiling, fit_smooth_function
from stiffopt.discovery.judging.run_deviations import Drift, NotCarriedOver, find_run_deviations
from stiffopt.discovery.judging.unexplained import Unexplained
from stiffopt.discovery.prediction import Predictor, RunProof, compare_predictions
from stiffopt.discovery.settings import MIN_MOVING_SPEED, Settings
from stiffopt.discovery.training import Training, prepare_training
from stiffopt.recording.recording_set import load_recordings
from stiffopt.recording.run import RecordedRun
from stiffopt.report.diagnosis.mismatch import noise_ceiling_sentence


@cache
def _training() -> Training:
    return prepare_training(load_recordings(SHIPPED), Settings())


def _left_out() -> RecordedRun:
    recordings = load_recordings(SHIPPED)
    return recordings.open(recordings.with_role("test")[0])


def _rod(found: Extension) -> NoiseCeiling:
    training = _training()
    box = BlackBox(training, found)
    predictor = Predictor(training, _left_out())
    box.add(predictor, predictor.predict(), predictor.predict(found))
    rod = box.found()
    assert rod is not None
    return rod


def test_smooth_function_predicts_stretches_left_out() -> None:
    """A sine of one of three signals is; noise of none is not."""
    draw = np.random.default_rng(3)
    signals, stretch = draw.normal(size=(600, 3)), np.arange(600) // 100
    values = np.sin(2.0 * signals[:, 1])
    found = fit_smooth_function(signals, values + 0.1 * draw.normal(size=600), stretch)
    assert found is not None
    assert found.held_out_share > 0.7
    fresh = draw.normal(size=(200, 3))
    assert np.std(found(fresh) - np.sin(2.0 * fresh[:, 1])) < 0.4
    nothing = fit_smooth_function(signals, draw.normal(size=600), stretch)
    assert nothing is None or nothing.held_out_share < 0.05


def test_noise_ceiling_exceeds_missing_effect_and_names_signal() -> None:
    """Without the missing friction much is left, and it goes with the speed of joint 2."""
    lacking, whole = _rod(Extension()), _rod(LACKS)
    assert lacking.explained < 0.1
    assert lacking.depends[0].channel == "torque_2"
    assert lacking.depends[0].signal == "qd_2"
    side = lacking.depends[0]
    assert side.mean[side.at > 0.1].mean() - side.mean[side.at < -0.1].mean() > 0.6
    assert whole.explained > 0.9
    assert whole.channels["torque_2"][0] < 0.6 * lacking.channels["torque_2"][0]


@pytest.mark.parametrize(
    ("kind", "value"), [("constant", 2.0), ("dry friction", 1.5), ("viscous friction", 3.0)]
)
def test_offset_of_one_run_is_reported(kind: str, value: float) -> None:
    """And of a run that has none nothing is said."""
    training, run = _training(), _left_out()
    predictor = Predictor(training, run)
    speed = predictor.velocity
    shape = {
        "constant": np.ones_like(speed[:, 0]),
        "dry friction": np.sign(speed[:, 0]),
        "viscous friction": speed[:, 0],
    }[kind]
    torque = run.torque.copy()
    torque[:, 0] += value * shape
    proofs = [_proof(training, predictor, each) for each in (run, replace(run, torque=torque))]
    assert not find_run_deviations(proofs[:1])
    (said,) = find_run_deviations(proofs[1:])
    assert (said.channel, said.kind) == ("torque_1", kind)
    assert said.value == pytest.approx(value, rel=0.2)
    few = torque.copy()
    few[np.flatnonzero(np.abs(speed[:, 0]) > MIN_MOVING_SPEED)[10:], 0] = np.nan
    proof = _proof(training, predictor, replace(run, torque=few))
    assert "torque_1" in [channel.name for channel in proof.channels]
    assert not find_run_deviations([proof])


ALONG = {"constant": np.ones_like, "dry friction": np.sign, "viscous friction": lambda v: v}


@pytest.mark.parametrize(
    ("shift", "kind", "drift"),
    [
        ("constant", "constant", (0.5, 0.0)),
        ("dry friction", "friction drift", (0.5, 0.0)),
        ("viscous friction", "viscous friction", (0.5, 0.0)),
        ("dry friction", "dry friction", (0.0, 0.5)),
        ("viscous friction", "friction drift", (0.0, 0.5)),
        ("dry friction", "dry friction", (0.0, 0.0)),
    ],
)
def test_known_friction_drift_replaces_collinear_friction(
    shift: str, kind: str, drift: tuple[float, float]
) -> None:
    """A shift of another kind is told as what it is, and without a spread there is no drift."""
    known = Drift(joint=0, dry=drift[0], viscous=drift[1])
    found = _shifted(lambda speed: 2.0 * ALONG[shift](speed), known)
    (said,) = found
    assert said.kind == kind
    spread = sum(drift) if kind == "friction drift" else 1.0
    assert said.value == pytest.approx(2.0 / spread, rel=0.2)


def test_friction_deviation_needs_both_directions() -> None:
    """In one direction a drift is no other than an offset."""
    known = Drift(joint=0, dry=0.5, viscous=0.0)
    (said,) = _shifted(np.ones_like, known, lambda speed: speed > 0.0)
    assert said.kind == "constant"


def _shifted(
    shift: Callable[[np.ndarray], np.ndarray],
    drift: Drift,
    kept: Callable[[np.ndarray], np.ndarray] = np.isfinite,
) -> tuple[NotCarriedOver, ...]:
    """What is said of a run with more torque at the first joint."""
    training, run = _training(), _left_out()
    predictor = Predictor(training, run)
    speed = predictor.velocity
    torque = run.torque.copy()
    torque[:, 0] = np.where(kept(speed[:, 0]), torque[:, 0] + shift(speed[:, 0]), np.nan)
    proof = _proof(training, predictor, replace(run, torque=torque))
    return find_run_deviations([proof], [drift])


def _proof(training: Training, predictor: Predictor, run: RecordedRun) -> RunProof:
    before, after = predictor.predict(), predictor.predict(LACKS)
    return compare_predictions(run, predictor.velocity, before, after, training.noise)


def _answer(
    rod: NoiseCeiling | None, left: Unexplained | None = None, kinds: Sequence[str] = ("torque",)
) -> Any:
    channels = [SimpleNamespace(kind=kind) for kind in kinds]
    return SimpleNamespace(
        noise_ceiling=rod, unexplained=left, held_out=[SimpleNamespace(channels=channels)]
    )


def test_residual_unknown_to_black_box_is_reported_consistently() -> None:
    """All that is explainable, beside something that follows the load within the training runs."""
    rod = NoiseCeiling(explained=1.0, channels={"torque_1": (2.0, 2.0)}, depends=())
    left = Unexplained(
        channels=("torque_1",), regressors=("torque_1",), period=None, gain=0.26, ratio=14.0
    )
    said = noise_ceiling_sentence(_answer(rod, left))
    assert "100 %" not in said
    assert "the load of joint 1 within the training runs does not carry over" in said
    encoders = replace(left, channels=("link_position_1", "torque_1"))
    said = noise_ceiling_sentence(_answer(rod, encoders, ("torque", "link_position")))
    assert said.startswith("Noise ceiling of the torques")
    assert said.endswith("Link encoders are not included; more of them is unexplained.")
    assert "carry over" not in noise_ceiling_sentence(_answer(replace(rod, explained=0.6)))


def test_channel_without_mismatch_has_no_share() -> None:
    box = object.__new__(BlackBox)
    box._boxes = [None, None]
    box._squares = np.array([[0.0, 0.0, 0.0, 50.0], [4.0, np.nan, 1.0, 50.0]])
    assert box.found() is None
    box._squares[1] = (4.0, 8.0, 8.0, 50.0)
    found = box.found()
    assert found is not None
    assert set(found.channels) == {"torque_2"}
    assert found.explained == 0.0
    assert ": 0 % of the explainable" in noise_ceiling_sentence(_answer(found))


def test_harmful_model_explains_nothing() -> None:
    found = NoiseCeiling(explained=-0.4, channels={"torque_1": (2.0, 1.0)}, depends=())
    assert "Noise ceiling: 0 % of" in noise_ceiling_sentence(_answer(found))


def test_joint_that_no_training_run_assesses_does_not_lower_the_ceiling() -> None:
    """A joint that a training run moves too slowly has no model that could be judged."""
    training = _training()
    unseen = [run.torque_used.copy() for run in training.runs]
    for used in unseen:
        used[:, 0] = False
    runs = tuple(
        replace(run, torque_used=used) for run, used in zip(training.runs, unseen, strict=True)
    )
    box = BlackBox(replace(training, runs=runs), Extension())
    predictor = Predictor(training, _left_out())
    box.add(predictor, predictor.predict(), predictor.predict())
    rod = box.found()
    assert rod is not None
    assert list(rod.channels) == ["torque_2"]
