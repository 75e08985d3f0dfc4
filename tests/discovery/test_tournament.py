"""Tournament of models and perturbation ensemble on the shipped two-link set."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shipped_set import SHIPPED

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.inertial_parameters import (
    body_units,
    is_consistent,
    nominal_bodies,
)
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.judging.ensemble import _mean_by_kind, odds_in_member, recurrence
from stiffopt.discovery.search import search as search_module
from stiffopt.discovery.search.candidates import Candidate
from stiffopt.discovery.search.cross_validation import (
    FoldPredictions,
    number_folds,
    stack_columns,
)
from stiffopt.discovery.search.joint_fit import prune_effects
from stiffopt.discovery.search.rigid_model import HELD_WIDTH, _as_real_body
from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.search.tournament import (
    CATALOGUE_MODEL,
    FRICTION_LINES,
    SINGLE_BODY,
    describe_tournament,
    hold_tournament,
)
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.thresholds import NAMED_EVIDENCE
from stiffopt.discovery.training import prepare_training
from stiffopt.recording.recording_set import load_recordings

# The set lacks dry friction of joint 2; friction of joint 1 is nominal.
PRESENT = LocatedEffect(effect=effect("coulomb"), joint=1)
ABSENT = LocatedEffect(effect=effect("load_friction"), joint=0, shapes=(0.02,))


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    start = prepare_training(load_recordings(SHIPPED), Settings()).comparison()
    return start.linearised_at(start.fit([PRESENT]))


def _selected(located: LocatedEffect) -> Selected:
    return Selected(located, 1.0, 1.0, 1.0, (), 1)


def test_present_effect_is_named_by_all_members_and_absent_by_none(comparison: Comparison) -> None:
    found = [_selected(PRESENT), _selected(ABSENT)]
    again, _ = recurrence(comparison, found, None, free_bodies=False)
    np.testing.assert_allclose(again, [1.0, 0.0], atol=0.01)


def test_value_without_evidence_is_not_named_again(comparison: Comparison) -> None:
    """A value that every arm has is kept without evidence; less of it is no recurrence."""
    absent = LocatedEffect(effect=effect("coulomb"), joint=0, calibrated=True)
    found = [
        Selected(located, loss, 1.0, 1.0, (), 1)
        for located, loss in [(PRESENT, -3.0), (absent, -3.0)]
    ]
    again, _ = recurrence(comparison, found, None, free_bodies=False)
    np.testing.assert_allclose(again, [1.0, 0.0], atol=0.01)


def test_share_of_members_falls_steadily_with_the_evidence(comparison: Comparison) -> None:
    found = comparison.extension_of(comparison.fit([PRESENT]))
    ranked = [Selected(PRESENT, NAMED_EVIDENCE, 1.0, 1.0, (), 1)]
    shares = []
    for noise in np.geomspace(10.0, 300.0, 12):
        loud = comparison.with_extension(found, noise * comparison.inflation)
        again, _ = recurrence(loud, ranked, None, free_bodies=False)
        shares.append(float(again[0]))
    assert shares == sorted(shares, reverse=True)
    assert sum(0.05 < share < 0.95 for share in shares) >= 2


@pytest.mark.parametrize("width", [1.5, 5.0])
def test_a_rival_ahead_in_all_members_alike_takes_nothing_beyond_its_odds(
    comparison: Comparison, width: float
) -> None:
    """Its lead over a bump, dry friction in all but name, is in the odds of the ranking already."""
    bump = LocatedEffect(effect=effect("position_friction"), joint=1, shapes=(0.5, width))
    ranked = Selected(bump, 1.0, 1.0, 0.6, ((PRESENT, 0.4),), 1)
    again, (found,) = recurrence(comparison, [ranked], None, free_bodies=False)
    assert again == [1.0]
    assert found.probability + found.rivals[0][1] == pytest.approx(1.0, abs=1e-9)
    assert found.probability == pytest.approx(0.6, abs=0.15)


def test_a_rival_that_gains_in_members_takes_the_probability_of_the_finding() -> None:
    found = Selected(ABSENT, 1.0, 1.0, 0.9, ((PRESENT, 0.1),), 1)
    ranked = np.array([40.0, 8.0])
    same = odds_in_member(found, np.array([20.0, 4.0]), ranked)
    assert same == pytest.approx([0.9, 0.1])
    one = odds_in_member(found, np.array([20.0, 5.0]), ranked)
    assert one[1] / one[0] == pytest.approx(np.exp(1.0) / 9.0)
    assert odds_in_member(found, np.array([20.0, 24.0]), ranked)[1] > 0.999


def test_model_with_the_present_effect_wins(comparison: Comparison) -> None:
    calibrated = LocatedEffect(effect=effect("viscous"), joint=0, calibrated=True)
    best, *others = hold_tournament(comparison, [calibrated], None, [calibrated, PRESENT])
    assert best.name == CATALOGUE_MODEL
    assert all(best.residual < each.residual for each in others)
    assert best.name in describe_tournament([best, *others])[0]


def test_friction_lines_win_over_an_effect_that_only_fits_noise(comparison: Comparison) -> None:
    calibrated = LocatedEffect(effect=effect("coulomb"), joint=1, calibrated=True)
    useless = [
        LocatedEffect(effect=effect("load_friction"), joint=j, shapes=(0.02,)) for j in (0, 1)
    ]
    found = hold_tournament(comparison, [calibrated], None, [calibrated, *useless])
    order = [each.name for each in found]
    assert order.index(FRICTION_LINES) < order.index(CATALOGUE_MODEL)


def test_models_are_judged_with_their_own_noise(comparison: Comparison) -> None:
    """Noise beside another model hides what this one explains, and its priors hold."""
    calibrated = LocatedEffect(effect=effect("viscous"), joint=0, calibrated=True)
    effects = [calibrated, PRESENT]
    noise = comparison.inflation.copy()
    noise[PRESENT.joint] *= 30.0
    loud = comparison.with_extension(comparison.extension_of(comparison.fit(effects)), noise)
    residuals = [
        {each.name: each.residual for each in hold_tournament(start, [calibrated], None, effects)}
        for start in (comparison, loud)
    ]
    assert residuals[1] == pytest.approx(residuals[0], rel=0.02)


def test_negative_masses_predict_no_stretch_left_out(comparison: Comparison) -> None:
    """No answer has them: without bounds they won, and the answer fitted far worse."""
    model = comparison.with_bodies(body_units(comparison.robot))
    columns, prior, _ = stack_columns(model, ())
    change = np.zeros(len(prior))
    change[: model.bodies.size] = -2.0 * nominal_bodies(model.robot).ravel()
    prior[: model.bodies.size] *= 1e3
    target, limits, fold = columns @ change, model.limits(len(prior)), number_folds(model)
    folds = FoldPredictions(columns, target, prior, limits, fold)
    size = np.linalg.norm(target)
    assert np.linalg.norm(folds.residual()) < 1e-3 * size
    assert np.linalg.norm(folds.residual_within_bounds(model)) > 0.1 * size


def test_a_single_body_is_one_that_can_exist(comparison: Comparison) -> None:
    """A first moment that its mass is too small for costs what the likeliest real body lacks."""
    robot = comparison.robot
    payload = LocatedEffect(effect=effect("payload"))
    sizes = payload.sizes(comparison.constants)
    nominal, units = nominal_bodies(robot)[-1:], body_units(robot)[-1:]
    change = np.zeros(10)
    change[:2] = -0.5 * nominal[0, 0], 3.0 * units[0, 1]
    found = Candidate(
        located=payload,
        amplitudes=change / sizes,
        covariance=np.diag(0.1 * units[0] / sizes) ** 2,
        evidence=100.0,
        deviations=20.0,
        gained=lambda: 100.0,
        change=lambda: (0, 0.5),
    )
    assert not is_consistent(nominal + change, units)
    real = _as_real_body(comparison, found)
    moved = real.amplitudes * sizes
    assert is_consistent(nominal + moved, units)
    lost = 0.5 * np.sum(((moved - change) / (0.1 * units[0])) ** 2)
    assert real.gain == pytest.approx(100.0 - lost)
    assert real.evidence == pytest.approx(100.0 - lost)
    assert lost > 1.0
    assert _as_real_body(comparison, real) is real


def test_a_single_body_competes_without_an_effect_of_its_own(comparison: Comparison) -> None:
    calibrated = LocatedEffect(effect=effect("coulomb"), joint=1, calibrated=True)
    payload = LocatedEffect(effect=effect("payload"))
    found = hold_tournament(comparison, [calibrated], payload, [calibrated])
    single = next(each for each in found if each.name == SINGLE_BODY)
    assert single.effects == (calibrated,)
    bodies = single.comparison.bodies / body_units(comparison.robot)
    assert np.all(bodies[:-1] == HELD_WIDTH)
    assert np.all(bodies[-1] > HELD_WIDTH)


def test_kinds_of_perturbation_have_equal_weight() -> None:
    """Named without each of nine stretches, but not with free masses."""
    acts, yes, no = np.ones(1, dtype=bool), np.ones(1, dtype=bool), np.zeros(1, dtype=bool)
    share = _mean_by_kind([[(yes, acts)] * 9, [(no, acts)], [(yes, ~acts)]])
    np.testing.assert_array_equal(share, [0.5])


def test_a_value_found_again_is_still_one_that_the_set_does_not_state(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Dry friction that leaves its bounds beside what is missing is no new effect afterwards."""
    start = prepare_training(load_recordings(SHIPPED), Settings()).comparison()
    pruned = []

    def prune(comparison: Comparison, effects: list[LocatedEffect]) -> list[LocatedEffect]:
        pruned.append(effects)
        return prune_effects(comparison, effects) if len(pruned) > 1 else []

    monkeypatch.setattr(search_module, "prune_effects", prune)
    unstated = replace(PRESENT, calibrated=True)
    found = search_module.search(start, [PRESENT.effect], start=[unstated])
    assert [each.located for each in found.selected] == [unstated]
