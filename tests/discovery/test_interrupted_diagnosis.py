"""Ctrl-C during a diagnosis: what was found so far is told, and that it was stopped."""

import json
import signal
import sys
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from diagnosed_folders import written
from simulated_sets import COULOMB
from small_arms import SWIVEL

import stiffopt.discovery.diagnose as diagnosing
import stiffopt.discovery.search_training as searches
from stiffopt.cli import run
from stiffopt.discovery import conclusions
from stiffopt.discovery.judging import held_out
from stiffopt.discovery.judging.episodes import Episode
from stiffopt.discovery.search import rivals
from stiffopt.discovery.search import search as searching


def interrupted(monkeypatch, module, name, calls):
    """Ctrl-C in a function, from that call on."""
    plain, count = getattr(module, name), 0

    def function(*arguments, **keywords):
        nonlocal count
        count += 1
        if count == calls:
            raise KeyboardInterrupt
        return plain(*arguments, **keywords)

    monkeypatch.setattr(module, name, function)


def answered(tmp_path, *options):
    arguments = ["diagnose", str(written(COULOMB)), "--out", str(tmp_path / "out"), "--quiet"]
    code = run([*arguments, "--no-report", *options])
    path = tmp_path / "out" / "diagnosis.json"
    return code, json.loads(path.read_text()) if path.is_file() else None


UNVOUCHED = """schema = 1
name = "swivel"
robot = "robot.urdf"
joints = ["swivel"]
signals = { time = "t", position = ["q"], torque = ["tau"], torque_side = "motor" }
"""


def unvouched(folder):
    """A joint whose masses nobody vouches for, with friction."""
    rng, t, text = np.random.default_rng(0), np.arange(0.0, 8.0, 0.01), UNVOUCHED
    for name, role, rate in (("a", "train", 1.0), ("b", "train", 1.4), ("c", "test", 1.2)):
        q = 0.8 * np.sin(rate * t) + 0.3 * np.sin(3.1 * rate * t)
        v = np.gradient(q, t)
        tau = 0.4 * np.gradient(v, t) + 5.0 * np.tanh(v / 0.02) + 3.0 * v
        np.savez(folder / f"{name}.npz", t=t, q=q, tau=tau + rng.normal(0.0, 0.1, t.size))
        text += f'[[runs]]\nfile = "{name}.npz"\nrole = "{role}"\n'
    (folder / "robot.urdf").write_text(SWIVEL)
    (folder / "recordings.toml").write_text(text)
    return folder


@pytest.mark.parametrize(
    ("stage", "told", "left_out"),
    [
        (
            "build_left_open",
            "search the open residual for suspects",
            "was not searched for suspects",
        ),
        (
            "add_band_deviation",
            "fit the parameters again in half the band",
            "in half the band",
        ),
    ],
)
def test_ctrl_c_in_last_stages_keeps_findings(tmp_path, monkeypatch, stage, told, left_out):
    source, said = unvouched(tmp_path), []
    interrupted(monkeypatch, diagnosing, stage, 1)
    found = diagnosing.diagnose(source, experiment=False, progress=said.append)
    assert found.stopped
    assert told in said
    assert left_out in found.assumptions[0]
    assert {"coulomb", "viscous"} <= {finding.effect.name for finding in found.findings}
    assert not found.left_open.suspects
    assert 0.05 < found.left_open.torque[0] < 0.2


@pytest.mark.parametrize(
    ("module", "stage", "left_out"),
    [
        (searching, "reidentify_rigid_model", "more effects may be missing"),
        (searching, "select_predictive", "not compared with their rivals"),
        (rivals, "rank_rivals", "not compared with their rivals"),
        (diagnosing, "assess_findings", "after the search"),
        (conclusions, "left_out_gains", "after the search"),
        (diagnosing, "detection_limits", "detection limits"),
    ],
)
def test_ctrl_c_after_first_fit_keeps_findings(tmp_path, monkeypatch, module, stage, left_out):
    interrupted(monkeypatch, module, stage, 1)
    found = diagnosing.diagnose(unvouched(tmp_path), experiment=False)
    assert found.stopped
    assert any(left_out in each for each in found.assumptions)
    in_search = module in (searching, rivals)
    if not in_search:
        assert not any("more effects may be missing" in each for each in found.assumptions)
    by_name = {finding.effect.name: finding for finding in found.findings}
    assert {"coulomb", "viscous"} <= set(by_name)
    if in_search:
        assert by_name["coulomb"].probability <= 0.5
    assert by_name["coulomb"].parameters[0].value == pytest.approx(5.0, abs=0.5)


def test_ctrl_c_in_second_search_keeps_first_result(tmp_path, monkeypatch):
    """Without what touched the arm all is sought anew: what a stop leaves of that is no answer."""
    plain, answers = searches.TrainingSearch._search_once, []

    def searched(*arguments, **named):
        answers.append(plain(*arguments, **named))
        return answers[-1]

    touch = Episode(run="a", role="train", begin=3.0, end=3.5, joints=(1,), sizes=(1.0,))
    monkeypatch.setattr(searches, "_find_contacts", lambda result: (touch,))
    monkeypatch.setattr(searches.TrainingSearch, "_search_once", searched)
    # Behind the first effects, each time.
    interrupted(monkeypatch, searching, "reidentify_rigid_model", 2)
    found = diagnosing.diagnose(unvouched(tmp_path), experiment=False)
    first, second = answers
    assert second.stopped
    assert second.effects
    assert found.stopped
    assert found.search.fit is first.fit
    assert found.search.stopped
    assert found.training.runs[0].name == "a"
    assert np.isfinite(found.training.recorded[0].torque).all()
    assert not found.episodes


def test_ctrl_c_keeps_predicted_runs_consistent(monkeypatch):
    """At every line of the loop over runs left out."""
    names = ("a.npz", "b.npz")
    stands_for = SimpleNamespace
    for name in ("held_out_track", "mask_episodes", "decimate_run", "_choose_vibrating_links"):
        monkeypatch.setattr(held_out, name, lambda *_: stands_for(usable=True, at_rest=False))
    monkeypatch.setattr(held_out, "find_episodes", lambda *_: ())
    monkeypatch.setattr(held_out, "compare_predictions", lambda *_: stands_for())
    monkeypatch.setattr(
        held_out,
        "Predictor",
        lambda *_, **__: stands_for(velocity=0, predict_each=lambda _: (0, 0)),
    )
    recordings = stands_for(
        with_role=lambda *_: [stands_for(file=name) for name in names],
        open=lambda _: stands_for(usable=True, at_rest=False),
    )
    training = stands_for(before=(), recorded=(), robot=None, noise=stands_for(channels=None))
    stopped = 0
    for line in range(200):
        opened = held_out.HeldOutRuns(training, None, (), stands_for(add=lambda *_: None))
        opened.shares = stands_for(add=lambda *_: None)
        try:
            with interrupted_at(line, held_out.HeldOutRuns.predict_all):
                opened.predict_all(recordings, lambda _: None)
        except KeyboardInterrupt:
            stopped += 1
        assert opened.left in ([], *([list(names[len(opened.proofs) :])]))
    assert 20 < stopped < 200


@contextmanager
def interrupted_at(line, function):
    """Ctrl-C before that line of a function, counted as they are done."""
    count = 0

    def trace(frame, event, _):
        nonlocal count
        if frame.f_code is not function.__code__:
            return None
        if event == "line":
            count += 1
            if count > line:
                sys.settrace(None)
                raise KeyboardInterrupt
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        yield
    finally:
        sys.settrace(before)


@pytest.mark.parametrize(
    ("module", "stage"),
    [
        (diagnosing, "mode_shifts"),
        (diagnosing, "find_run_deviations"),
        (diagnosing, "describe_next_experiment"),
        (held_out.BlackBox, "found"),
    ],
)
def test_ctrl_c_after_last_prediction_keeps_all(tmp_path, monkeypatch, module, stage):
    interrupted(monkeypatch, module, stage, 1)
    found = diagnosing.diagnose(unvouched(tmp_path), experiment=False)
    assert not found.stopped
    assert {"coulomb", "viscous"} <= {finding.effect.name for finding in found.findings}
    assert [proof.run.name for proof in found.held_out] == ["c"]
    assert found.noise_ceiling is not None


def test_ctrl_c_skips_optional_steps(tmp_path, monkeypatch):
    """What proves the findings is not, and another Ctrl-C throws none of them away."""
    plain, calls, said = diagnosing.assess_findings, [], []

    def interrupted(result):
        calls.append(result)
        if len(calls) == 1:
            raise KeyboardInterrupt
        signal.raise_signal(signal.SIGINT)
        return plain(result)

    def unasked(*_, **__):
        pytest.fail("takes long, and can be left out")

    monkeypatch.setattr(diagnosing, "assess_findings", interrupted)
    for name in ("add_band_deviation", "detection_limits", "plan_experiment"):
        monkeypatch.setattr(diagnosing, name, unasked)
    monkeypatch.setattr(held_out, "BlackBox", unasked)
    found = diagnosing.diagnose(unvouched(tmp_path), progress=said.append)
    assert found.stopped
    assert len(calls) == 2
    assert {"coulomb", "viscous"} <= {finding.effect.name for finding in found.findings}
    assert [proof.run.name for proof in found.held_out] == ["c"]
    assert any("Ctrl-C again skips that" in line for line in said)
    told = " ".join(found.assumptions)
    for left_out in (
        "after the search",
        "in half the band",
        "detection limits",
        "no noise ceiling",
        "not searched for suspects",
    ):
        assert left_out in told
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_ctrl_c_in_noise_ceiling_keeps_proof(tmp_path, monkeypatch):
    interrupted(monkeypatch, held_out, "BlackBox", 1)
    found = diagnosing.diagnose(unvouched(tmp_path), experiment=False)
    assert "no noise ceiling was fitted" in found.assumptions[0]
    assert [proof.run.name for proof in found.held_out] == ["c"]
    assert found.noise_ceiling is None


@pytest.mark.slow
@pytest.mark.parametrize("later", [{"stopped": True}, {"hurried": True}])
def test_stopped_search_is_reported_beside_better_result(monkeypatch, later):
    """Where links swing otherwise than the model's: three searches, of which one is the answer."""
    plain, answers = searches.TrainingSearch._search_once, []

    def searched(*arguments, **named):
        if not answers:
            answers.append(plain(*arguments, **named))
            return answers[0]
        worse = replace(answers[0], after=2.0 * answers[0].after, **later)
        answers.append(worse)
        return worse

    monkeypatch.setattr(searches.TrainingSearch, "_search_once", searched)
    monkeypatch.setattr(searches, "MAX_VIBRATION_MISFIT", 0.0)
    monkeypatch.setattr(diagnosing, "leading_pair", lambda selected: selected)
    monkeypatch.setattr(diagnosing, "plan_experiment", lambda *_, **__: pytest.fail("takes long"))
    found = diagnosing.diagnose(written(COULOMB))
    assert len(answers) == 2
    assert found.stopped
    assert found.search.after is answers[0].after
    assert any("more effects may be missing" in each for each in found.assumptions) == (
        "stopped" in later
    )
    assert "Stopped by the user: no experiment was designed." in found.assumptions


@pytest.mark.slow
def test_ctrl_c_in_burst_search_is_reported(monkeypatch):
    """Where nothing is missing the last look is the one that is stopped."""
    interrupted(monkeypatch, diagnosing, "find_bursts", 1)
    found = diagnosing.diagnose(written(replace(COULOMB, effects=())), experiment=False)
    assert found.stopped
    assert not found.findings
    assert any("bursts" in each for each in found.assumptions)


@pytest.mark.slow
def test_ctrl_c_at_every_progress_line(tmp_path):
    """From the first fit on, wherever Ctrl-C comes."""
    source, every = unvouched(tmp_path), []
    diagnosing.diagnose(source, experiment=False, progress=every.append)
    first = next(k for k, line in enumerate(every) if line.startswith("re-identify"))
    for stop in range(first, len(every)):
        said = []

        def tell(line, said=said, stop=stop):
            said.append(line)
            if len(said) == stop + 1:
                raise KeyboardInterrupt

        found = diagnosing.diagnose(source, experiment=False, progress=tell)
        assert found.stopped, every[stop]
        assert any("Stopped by the user" in each for each in found.assumptions), every[stop]
        assert {"coulomb", "viscous"} <= {f.effect.name for f in found.findings}, every[stop]


@pytest.mark.slow
def test_ctrl_c_after_a_finding_keeps_it(tmp_path, monkeypatch, capsys):
    interrupted(monkeypatch, searching, "scan", 2)
    code, document = answered(tmp_path)
    assert code == 130
    assert document["stopped"]
    assert document["assumptions"][0].startswith("Stopped by the user: only findings")
    assert [finding["effect"] for finding in document["findings"]] == ["coulomb"]
    assert "Assumed: Stopped by the user" in capsys.readouterr().out


def test_ctrl_c_before_any_finding_has_no_result(tmp_path, monkeypatch, capsys):
    interrupted(monkeypatch, searching, "scan", 1)
    assert answered(tmp_path) == (130, None)
    assert "interrupted; nothing was written" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_ctrl_c_during_prediction(tmp_path, monkeypatch):
    interrupted(monkeypatch, held_out, "Predictor", 1)
    code, document = answered(tmp_path)
    assert code == 130
    first = document["assumptions"][0]
    assert "not all held-out runs were predicted" in first
    assert "test_1" in first
    assert document["findings"]
