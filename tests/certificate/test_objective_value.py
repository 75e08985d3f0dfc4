"""The value of an objective: one term in its unit, several as the weighted sum to minimise."""

from types import SimpleNamespace

import pytest

from stiffopt.certificate.objective_value import improvement, is_maximised, objective_value


def term(value, weight=1.0, maximised=False, name="some", measure="peak"):
    kind = SimpleNamespace(certified_value=lambda own, motion: value * motion)
    return SimpleNamespace(
        kind=kind,
        weight=weight,
        maximised=maximised,
        name=name,
        shown_measure=measure,
        unit="m",
    )


def test_one_term_keeps_its_own_value_whatever_its_weight():
    problem = SimpleNamespace(objectives=[term(3.0, weight=7.0, maximised=True)])
    found = objective_value(problem, 2.0)
    assert (found.value, found.unit, found.measure) == (6.0, "m", "peak")
    assert is_maximised(problem)


def test_weighted_sum_subtracts_maximised_terms():
    problem = SimpleNamespace(
        objectives=[
            term(3.0, weight=5.0, name="deflection"),
            term(4.0, weight=0.5, name="stiffness", maximised=True, measure=""),
        ]
    )
    found = objective_value(problem, 2.0)
    assert found.value == pytest.approx(5.0 * 6.0 - 0.5 * 8.0)
    assert found.terms == {"deflection peak": 6.0, "stiffness": 8.0}
    assert not is_maximised(problem)


def test_improvement_is_below_one_where_it_is_better():
    least = SimpleNamespace(objectives=[term(1.0)])
    most = SimpleNamespace(objectives=[term(1.0, maximised=True)])
    assert improvement(least, 2.0, 8.0) == pytest.approx(0.25)
    assert improvement(most, 8.0, 2.0) == pytest.approx(0.25)
    assert improvement(least, -1.0, 2.0) is None
