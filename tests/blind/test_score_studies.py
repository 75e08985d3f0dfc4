"""Rivals, controls and the results page on small made-up data."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind.controls import relabelled, right, with_phases
from benchmarks.blind.extras import extra_sections, save
from benchmarks.blind.nominal import Motion
from benchmarks.blind.results import case_table, results_page
from benchmarks.blind.rival_models import BlackBox, Friction, Sparse, stlsq
from benchmarks.blind.score import CaseScore, Named
from benchmarks.blind.sets import description, toml_text
from benchmarks.blind.tally import targets
from stiffopt.recording.nominal import Nominal


def _motion(seed: int) -> Motion:
    """Two joints; the second has 0.7 N m more dry and 0.2 N m s/rad more viscous friction."""
    rng = np.random.default_rng(seed)
    time = np.arange(3000) / 500.0
    position = np.column_stack([np.sin(2.0 * time + seed), np.cos(1.3 * time + seed)])
    velocity = np.gradient(position, time, axis=0)
    acceleration = np.gradient(velocity, time, axis=0)
    rigid = 4.0 * np.sin(position)
    torque = rigid + 0.3 * acceleration
    added = np.column_stack([0.0 * time, 0.7 * np.sign(velocity[:, 1]) + 0.2 * velocity[:, 1]])
    return Motion(
        time=time,
        session_time=0.0,
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        rigid=rigid,
        torque=torque,
        windup=0.0 * torque,
        moving=np.abs(velocity) >= 0.03,
        measured=torque + added + 0.05 * rng.standard_normal(torque.shape),
    )


@pytest.mark.parametrize(
    "rival",
    [
        Friction(),
        Sparse(Nominal(gear_ratio=np.array([100.0, 80.0])), threshold=0.05, ridge=1e-6),
        BlackBox(length=5.0, ridge=1e-5, features=80),
    ],
    ids=["friction", "sparse", "black box"],
)
def test_rivals_predict_friction_of_a_run_they_have_not_seen(
    rival: Friction | Sparse | BlackBox,
) -> None:
    rival.fit([_motion(s) for s in (0, 1, 2)])
    run = _motion(3)
    left = (run.measured - run.torque - rival.predict(run))[run.moving[:, 1], 1]
    before = (run.measured - run.torque)[run.moving[:, 1], 1]
    assert np.std(left) < 0.2 * np.sqrt(np.mean(before**2))


def test_sparse_regression_keeps_the_terms_that_made_the_data() -> None:
    rng = np.random.default_rng(1)
    x = rng.standard_normal((400, 6))
    weights = np.array([0.0, 0.8, 0.0, 0.0, -0.4, 0.0])
    found = stlsq(x, x @ weights + 0.02 * rng.standard_normal(400), threshold=0.1, ridge=1e-8)
    assert np.flatnonzero(found).tolist() == [1, 4]
    np.testing.assert_allclose(found, weights, atol=5e-3)
    assert not stlsq(x, 0.01 * rng.standard_normal(400), threshold=0.1, ridge=1e-8).any()


@pytest.mark.parametrize("count", [512, 513])
def test_scrambling_keeps_mean_and_spectrum(count: int) -> None:
    rng = np.random.default_rng(2)
    samples = np.cumsum(rng.standard_normal(count))
    phases = np.exp(2j * np.pi * rng.uniform(size=count // 2 + 1))
    turned = with_phases(samples, phases)
    np.testing.assert_allclose(np.abs(np.fft.rfft(turned)), np.abs(np.fft.rfft(samples)))
    assert np.mean(turned) == pytest.approx(np.mean(samples))
    assert abs(np.corrcoef(turned, samples)[0, 1]) < 0.9


def _set(folder: Path) -> Path:
    folder.mkdir()
    (folder / "robot.urdf").write_text("<robot/>")
    np.savez(folder / "a.npz", t=np.arange(3.0), tau1=np.ones(3))
    told = {
        "schema": 1,
        "robot": "robot.urdf",
        "joints": ["one", "two", "three"],
        "gravity": [0.0, 0.0, -9.81],
        "signals": {"time": "t", "torque": ["tau1", "tau2", "tau3"]},
        "nominal": {"coulomb": [1.0, 2.0, 3.0], "reducer": {"K1": [1.0, float("inf"), 5.0]}},
        "runs": [{"file": "a.npz", "role": "train", "housing_temperature": [20.0, 21.0, 22.0]}],
    }
    (folder / "recordings.toml").write_text(toml_text(told))
    assert description(folder) == told
    return folder


def test_relabelling_turns_joints_and_nothing_else(tmp_path: Path) -> None:
    turned = description(relabelled(_set(tmp_path / "set"), tmp_path / "turned", [2, 1, 0]))
    assert turned["joints"] == ["three", "two", "one"]
    assert turned["signals"]["torque"] == ["tau3", "tau2", "tau1"]
    assert turned["nominal"]["reducer"]["K1"] == [5.0, float("inf"), 1.0]
    assert turned["runs"][0]["housing_temperature"] == [22.0, 21.0, 20.0]
    assert turned["gravity"] == [0.0, 0.0, -9.81]


def _score(name: str, kind: str, **changes: object) -> CaseScore:
    base: dict[str, object] = {
        "id": name, "suite": "main", "kind": kind, "robot": "planar2", "severity": 1.0,
        "link_encoders": True, "z": 26.0, "sealed": True, "void": False, "status": "ok",
        "truth": (Named("coulomb", 1),) if kind == "single" else (), "verdict": "named",
        "said": (Named("coulomb", 1),), "seconds": 30.0,
    }  # fmt: skip
    return CaseScore(**(base | changes))  # type: ignore[arg-type]


def test_right_answers_to_controls() -> None:
    score = _score("a", "single")
    finding = {"effect": "coulomb", "joint": 3, "link": None, "run": None}
    named = {"verdict": "named", "findings": [finding]}
    nothing = {"verdict": "nothing_missing", "findings": []}
    outside = {"verdict": "outside_catalogue", "findings": []}
    assert right("relabelled", score, named, 3)
    assert not right("noise_half single", score, named, 3)
    assert right("scrambled", score, nothing, 3)
    assert not right("scrambled", score, named, 3)
    assert right("effect_out", score, outside, 3)
    assert not right("effect_out", score, nothing, 3)
    assert not right("scrambled", score, None, 3)


def test_page_says_what_is_not_reached_and_lists_failures(tmp_path: Path) -> None:
    scores = [_score(f"s{k}", "single", exact=True, detected=True) for k in range(100)]
    scores += [
        _score("bad", "single", exact=False, detected=True, said=(Named("viscous", 2),)),
        _score("quiet", "none", false_alarm=False, verdict="nothing_missing", said=()),
        _score("alarm", "none", false_alarm=True),
        _score("void", "single", exact=False, void=True),
    ]
    words = {t.what: t for t in targets(scores)}
    assert words["effect and joint named first"].reached
    assert words["effect and joint named first"].measured.startswith("100 of 101")
    assert words["false alarms"].reached is False
    assert words["outside the catalogue recognised, severity 1 and above"].reached is None
    text = {"title": "Ablation", "text": "Two parts.", "head": ["a"], "rows": [["b"]]}
    save(tmp_path, "ablation", text)
    manifest = {"key": "dev-x", "commit": "c", "development": True}
    page = results_page(scores, manifest, ["confusion"], extra_sections(tmp_path))
    assert "Development results" in page
    assert "## Failures one by one: 2 of 103 cases" in page
    assert "| bad | coulomb J1 | planar2 | 1 | 26 | viscous J2 |" in page
    assert "Two parts." in page
    assert "benchmarks.blind.rivals" in page
    assert len(case_table(scores).splitlines()) == len(scores) + 1
