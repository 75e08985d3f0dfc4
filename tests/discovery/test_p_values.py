"""How likely nothing gives what was found: by what it spreads from part to part."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from linear_comparison import linear_comparison
from test_admissible_shapes import JOINT

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.located_effect import LocatedEffect, with_amplitudes
from stiffopt.discovery.diagnosis import Parameter
from stiffopt.discovery.search.uncertainty import (
    Estimate,
    estimate_parameters,
    null_probability,
)

RUNS, STRETCHES = 8, 40


def _estimate(values, spread, between):
    """One effect of so many amplitudes, no nominal values."""
    return Estimate(
        nuisance=(),
        values=values,
        effects=(SimpleNamespace(located=SimpleNamespace(is_run_specific=False)),),
        covariance=1e-6 * np.eye(len(values)),
        common=np.zeros((len(values),) * 2),
        spread=spread,
        between=between,
        added=np.zeros((len(values),) * 2),
        squares=np.eye(len(values)),
        sizes=(np.ones(len(values)),),
        shape_sizes=((),),
        parts=(STRETCHES, RUNS),
    )


def _of_mean(samples):
    """Mean of samples (b, k) and its covariance by them."""
    return samples.mean(axis=0), np.cov(samples.T).reshape(2 * samples.shape[1:]) / len(samples)


@pytest.mark.parametrize("amplitudes", [1, 3, 6, 10])
def test_p_value_without_effect_is_rarely_small(amplitudes):
    rng = np.random.default_rng(amplitudes)
    chances = []
    for _ in range(400):
        mean, between = _of_mean(rng.normal(size=(RUNS, amplitudes)))
        estimate = _estimate(mean, 1e-6 * np.eye(amplitudes), between)
        chances.append(estimate.p_value(0))
    assert np.mean(np.array(chances) < 0.05) < 0.08
    assert np.mean(np.array(chances) < 0.005) < 0.015


@pytest.mark.parametrize("amplitudes", [1, 6])
def test_p_value_of_repeated_effect_is_small(amplitudes):
    rng = np.random.default_rng(0)
    mean, between = _of_mean(5.0 + 0.5 * rng.normal(size=(RUNS, amplitudes)))
    estimate = _estimate(mean, 1e-6 * np.eye(amplitudes), between)
    assert estimate.p_value(0) < 1e-4


def test_nothing_added_is_as_likely_as_can_be():
    nothing = _estimate(np.zeros(2), np.eye(2), np.eye(2))
    assert nothing.deviations(0) == 0.0
    assert nothing.p_value(0) == 1.0


def test_p_value_uses_larger_covariance():
    sure, unsure = 1e-6 * np.eye(2), np.eye(2)
    values = np.array([1.0, 0.5])
    assert _estimate(values, sure, unsure).p_value(0) > 0.3
    assert _estimate(values, unsure, sure).p_value(0) > 0.3


def test_p_value_is_that_of_the_function_of_an_amplitude_and_a_shape():
    """An amplitude and a shape that only their product determines."""
    along, across = np.array([1.0, -1.0]), np.array([1.0, 1.0])
    spread = np.outer(along, along) + 1e-4 * np.outer(across, across)
    estimate = replace(
        _estimate(np.ones(1), spread, spread),
        covariance=1e-6 * np.eye(2),
        added=np.zeros((2, 2)),
        squares=np.ones((2, 2)),
        shape_sizes=((1.0,),),
    )
    assert estimate.deviations(0) == pytest.approx(50.0)
    assert estimate.p_value(0) < 1e-4


def test_null_probability_is_sellke_bound():
    # Table 1 of Sellke, Bayarri & Berger (2001), which rounds twice.
    for chance, error in (
        (0.2, 0.465),
        (0.1, 0.385),
        (0.05, 0.289),
        (0.01, 0.111),
        (0.001, 0.0184),
    ):
        assert null_probability(chance) == pytest.approx(error, abs=2e-3)
    assert null_probability(0.0) == 0.0
    assert null_probability(1.0) == 0.5
    # Three times the prior odds against it.
    assert null_probability(1.0, 3.0) == 0.75


@pytest.mark.parametrize(
    ("value", "sd", "prior_sd", "text"),
    [
        (0.34, 0.02, 2.0, "340 ± 20 mrad"),
        (0.001, 0.02, 2.0, "0 ± 20 mrad"),  # a place may be zero
        (1.0, 10.0, 2.0, "not determined"),
        (0.0, 1.9, 2.0, "not determined"),  # as before the recordings
    ],
)
def test_value_that_the_recordings_do_not_tell_is_not_printed(
    value: float, sd: float, prior_sd: float, text: str
) -> None:
    known = Parameter(name="q0", value=value, sd=sd, unit="rad", prior_sd=prior_sd)
    assert known.text == text


def test_prior_of_reported_values_is_that_of_amplitudes_and_initial_shapes() -> None:
    """Lost preload is reported as the torque that its contacts still carry."""
    loss, constants = effect("preload_loss"), JOINT
    located = LocatedEffect(effect=loss, joint=0, shapes=(0.1, 0.5))
    (found,) = with_amplitudes([located], np.ones(1), [np.ones(1)])
    estimate = replace(
        _estimate(np.ones(1), np.eye(1), np.eye(1)),
        effects=(found,),
        shape_sizes=(np.array([0.1, 0.5]),),
    )
    tried = loss.shapes[0].grid(constants)
    expected = (max(tried) - min(tried)) * constants.torque_rated
    assert estimate.prior_deviations(0, constants)["tp"] == pytest.approx(expected)


def test_a_function_is_told_where_the_values_that_describe_it_are_not_each():
    """Of two columns that are nearly one, the sum is told and the shares are not."""
    rng = np.random.default_rng(3)
    column, away = rng.normal(size=200), 1e-4 * rng.normal(size=200)
    columns, values = np.column_stack([column, column + away]), np.array([4.0, 6.0])
    target = columns @ values + rng.normal(size=200)
    comparison = linear_comparison(columns, target, values, runs=4, duration=1.0)
    located = SimpleNamespace(
        shapes=(),
        is_run_specific=False,
        sizes=lambda constants: np.ones(2),
        effect=SimpleNamespace(amplitudes=("A", "B")),
    )
    found = estimate_parameters(comparison, [located])
    sd = np.sqrt(np.diag(found.covariance))
    assert np.all(np.abs(found.values) < 10.0 * sd)
    # Both priors have unit deviation: the columns' sum counts as one value.
    size = np.sum((columns @ values) ** 2)
    linear = np.trace(columns.T @ columns @ found.covariance)
    assert found.deviations(0) <= np.sqrt(size / linear) * (1.0 + 1e-9)
    assert found.deviations(0) > 50.0
    assert found.p_value(0) < 1e-4


def test_a_function_is_as_uncertain_as_it_spreads_between_runs():
    rng = np.random.default_rng(3)
    run = np.repeat(np.arange(4), 50)
    column, per_run = rng.normal(size=200), np.array([8.0, 12.0, 9.0, 13.0])
    target = per_run[run] * column + 0.01 * rng.normal(size=200)
    amplitude = np.array([float(column @ target / (column @ column))])
    comparison = linear_comparison(column[:, None], target, amplitude, runs=4, duration=1.0)
    located = SimpleNamespace(
        shapes=(),
        is_run_specific=False,
        sizes=lambda constants: np.ones(1),
        effect=SimpleNamespace(amplitudes=("A",)),
    )
    found = estimate_parameters(comparison, [located])
    kept = [run != own for own in range(4)]
    left_out = [float(column[k] @ target[k] / (column[k] @ column[k])) for k in kept]
    sd = np.sqrt(3.0) * np.std(left_out)
    assert found.deviations(0) == pytest.approx(amplitude[0] / sd, rel=0.02)
