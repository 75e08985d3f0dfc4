"""Two changes of one joint since a model was made, a large one and a small one beside it."""

from dataclasses import replace

import numpy as np
import pytest
from small_arms import SWIVEL

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.search import model_changes as changing
from stiffopt.discovery.search import search as searching
from stiffopt.discovery.search.candidates import Scorer, scan
from stiffopt.discovery.search.model_changes import _find_single_change
from stiffopt.discovery.search.rivals import rank_rivals
from stiffopt.discovery.search.search import search
from stiffopt.discovery.settings import ZERO_TOLERANCE, Settings
from stiffopt.discovery.training import prepare_training
from stiffopt.recording.recording_set import load_recordings

SET = """schema = 1
name = "swivel"
robot = "robot.urdf"
joints = ["swivel"]
signals = { time = "t", position = ["q"], torque = ["tau"], torque_side = "motor" }
[noise]
torque = [0.1]
"""
CAUSES = tuple(effect(name) for name in ("coulomb", "viscous", "torque_offset"))
COULOMB, VISCOUS = 2.0, 0.6
# Of the link about its axis [kg m^2].
INERTIA = 0.09


@pytest.fixture(scope="module")
def training(tmp_path_factory):
    """Of a joint whose masses nobody vouches for."""
    folder, text = tmp_path_factory.mktemp("changed"), SET
    (folder / "robot.urdf").write_text(SWIVEL)
    rng, t = np.random.default_rng(0), np.arange(0.0, 12.0, 0.01)
    for name, rate in (("a", 1.3), ("b", 1.56), ("c", 1.43)):
        q = 0.8 * np.sin(rate * t) + 0.3 * np.sin(3.1 * rate * t + 1.0)
        v = np.gradient(q, t)
        tau = COULOMB * np.tanh(v / 0.02) + VISCOUS * v + INERTIA * np.gradient(v, t)
        np.savez(folder / f"{name}.npz", t=t, q=q, tau=tau + rng.normal(0.0, 0.1, t.size))
        role = "test" if name == "c" else "train"
        text += f'[[runs]]\nfile = "{name}.npz"\nrole = "{role}"\n'
    (folder / "recordings.toml").write_text(text)
    return prepare_training(load_recordings(folder), Settings(cutoff=12.0))


@pytest.fixture(scope="module")
def after_model(training):
    """Comparison with a model that left nothing of its own recordings."""
    return replace(training, least=np.ones(2), tolerance=ZERO_TOLERANCE).comparison()


def found(comparison, together=3):
    result = search(comparison, CAUSES, most=3, together=together)
    return result, [each.effect.name for each in result.effects]


def test_a_small_change_beside_a_large_one_stays(after_model):
    result, names = found(after_model)
    assert names == ["coulomb", "viscous"]
    assert result.comparison.inflation[0] == 1.0
    values = result.fit.amplitudes() * np.concatenate(
        [each.sizes(after_model.constants) for each in result.effects]
    )
    np.testing.assert_allclose(values, [COULOMB, VISCOUS], rtol=0.03)


def test_single_change_replaces_several(after_model):
    coulomb, viscous, offset = (LocatedEffect(effect=each, joint=0) for each in CAUSES)
    first = scan(Scorer(after_model), CAUSES)
    more = after_model.linearised_at(after_model.fit([coulomb, offset]))
    single = _find_single_change(after_model, after_model, more, [], [coulomb, offset], first)
    assert single is not None
    assert single[1] == [coulomb]
    both = after_model.linearised_at(after_model.fit([coulomb, viscous]))
    two = [coulomb, viscous]
    assert _find_single_change(after_model, after_model, both, [], two, first) is None


def test_equivalent_changes_are_chosen_by_residual(after_model, monkeypatch):
    """Over a noise that holds the change itself, what takes most of it has as much evidence."""
    plain = changing.scan

    def scanned(scorer, catalogue, **named):
        found = plain(scorer, catalogue, **named)
        likeliest = {"viscous": 102.0, "coulomb": 101.0}
        found = [replace(c, evidence=likeliest[c.located.effect.name]) for c in found]
        return sorted(found, key=lambda c: -c.evidence)

    monkeypatch.setattr(changing, "scan", scanned)
    about = after_model.linearised_at(after_model.fit())
    told, kept = [], []
    changing.find_changes(
        after_model, about, [], CAUSES[:2], 1, told.append, lambda _: None, keep=kept.append
    )
    assert [e.effect.name for e in kept[-1][1]] == ["coulomb"]
    assert told == ["found coulomb of joint 1 (log evidence 101)"]


def test_effect_without_evidence_is_no_rival(training):
    """Evidence counts in units of what the model left open; a prior alone is no explanation."""
    favoured = replace(
        training,
        least=np.ones(2),
        tolerance=ZERO_TOLERANCE,
        suspects={"saturation of joint 1": 1e3},
    ).comparison()
    friction = effect("asym_friction")
    catalogue = (friction, *CAUSES)
    two = [LocatedEffect(effect=each, joint=0) for each in CAUSES[:2]]
    current = favoured.linearised_at(favoured.fit(two))
    assert current.max_inherited_evidence > 1e5
    ranked = rank_rivals(current, two, two[0], catalogue)
    assert ranked.likelier is None
    assert ranked.rivals == ()


def test_superseded_change_is_dropped(after_model, monkeypatch):
    """Friction at one place stood for dry friction everywhere, until that is found."""
    place = LocatedEffect(effect=effect("position_friction"), joint=0, shapes=(0.0, 1.0))
    start, _ = changing.fit_jointly(after_model, [place])
    kept = []
    changing.find_changes(
        after_model, start, [place], CAUSES, 3, lambda _: None, lambda _: None, keep=kept.append
    )
    assert sorted(e.effect.name for e in kept[-1][1]) == ["coulomb", "viscous"]


@pytest.mark.parametrize(
    ("module", "stage", "with_model"),
    [
        (changing, "fit_jointly", True),
        (changing, "select_predictive", True),
        (searching, "fit_jointly", False),
    ],
)
def test_ctrl_c_at_the_second_finding_keeps_the_first(
    training, monkeypatch, module, stage, with_model
):
    least = np.ones(2) if with_model else None
    comparison = replace(training, least=least, tolerance=ZERO_TOLERANCE).comparison()
    plain, calls = getattr(module, stage), []

    def interrupted(comparison, effects):
        calls.append(len(effects))
        if calls.count(2) == 1 and len(effects) == 2:
            raise KeyboardInterrupt
        return plain(comparison, effects)

    monkeypatch.setattr(module, stage, interrupted)
    result, names = found(comparison, together=3 if with_model else 1)
    assert result.stopped
    assert names == ["coulomb"]


def test_ctrl_c_at_the_first_change_has_no_finding(after_model, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(changing, "select_predictive", interrupted)
    with pytest.raises(KeyboardInterrupt):
        found(after_model)


def test_ctrl_c_in_the_last_fit_keeps_findings(training, monkeypatch):
    """Where nothing was known before, so that nothing but these findings is there to tell."""
    plain, calls = searching.fit_jointly, []

    def interrupted(comparison, effects):
        calls.append(len(effects))
        if calls.count(2) == 2 and len(effects) == 2:
            raise KeyboardInterrupt
        return plain(comparison, effects)

    monkeypatch.setattr(searching, "fit_jointly", interrupted)
    result, names = found(replace(training, tolerance=ZERO_TOLERANCE).comparison(), together=1)
    assert calls == [1, 2, 2]
    assert result.stopped
    assert names == ["coulomb", "viscous"]


def test_a_second_ctrl_c_in_a_search_for_changes_keeps_the_first(after_model, monkeypatch):
    plain, told = changing.select_predictive, []

    def interrupted(comparison, effects):
        if len(effects) == 2:
            raise KeyboardInterrupt
        return plain(comparison, effects)

    def tell(line):
        told.append(line)
        if told.count(changing.STOPPED_MESSAGE) == 1 and line == changing.STOPPED_MESSAGE:
            raise KeyboardInterrupt

    monkeypatch.setattr(changing, "select_predictive", interrupted)
    result = search(after_model, CAUSES, most=3, together=3, report=tell)
    assert result.stopped
    assert [each.effect.name for each in result.effects] == ["coulomb"]


def test_ctrl_c_after_a_search_is_reported(after_model, monkeypatch):
    plain, calls = searching._relinearise_fit, []

    def interrupted(*arguments):
        calls.append(arguments)
        if len(calls) == 1:
            raise KeyboardInterrupt
        return plain(*arguments)

    monkeypatch.setattr(searching, "_relinearise_fit", interrupted)
    result, names = found(after_model)
    assert result.hurried
    assert not result.stopped
    assert names == ["coulomb", "viscous"]
