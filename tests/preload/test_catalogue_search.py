"""The search of catalogue designs against trying every combination."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stiffopt.preload.catalogue_programme import ChoiceProgramme
from stiffopt.preload.catalogue_search import CombinationSearch, Goal


def instance(seed, sizes, rows, tightness, vectors=0):
    """Designs that trade cost for use, as preloads trade force for compliance."""
    rng = np.random.default_rng(seed)
    costs, ties, uses, turns = [], [], [], []
    for size in sizes:
        cost = np.round(rng.uniform(1, 9, size), 1)
        costs.append(cost)
        uses.append(rng.uniform(0.5, 1.5, (size, rows)) / cost[:, None] ** 0.7)
        ties.append(rng.integers(1, 5, size).astype(float))
        axis = rng.uniform(-1, 1, (vectors, 3))
        turns.append(rng.uniform(0.5, 1.5, (size, vectors, 1)) / cost[:, None, None] * axis)
    programme = ChoiceProgramme(
        price=tuple(np.zeros(m) for m in sizes),
        names=tuple(f"row {r}" for r in range(rows + vectors)),
        joints=(None,) * (rows + vectors),
        cost=tuple(costs),
        tie=tuple(ties),
        use=tuple(uses),
        vectors=tuple(turns),
        base=rng.uniform(0, 1, rows),
        rest=rng.uniform(-0.5, 0.5, (vectors, 3)),
        cap=np.full(rows + vectors, np.inf),
        weight=rng.uniform(0.5, 2, rows + vectors),
    )
    amounts = [programme.amounts(p) for p in rng.integers(0, sizes, (200, len(sizes)))]
    low, high = np.min(amounts, axis=0), np.max(amounts, axis=0)
    return replace(programme, cap=low + tightness * (high - low))


def everything(programme, peak):
    """Best of all combinations: objective, then ties."""
    best = (math.inf, math.inf)
    for picks in itertools.product(*(range(len(c)) for c in programme.cost)):
        used = programme.amounts(picks)
        if (used > programme.cap * (1 + 1e-12)).any():
            continue
        if peak:
            value = float((used * programme.weight).max())
        else:
            value = round(total(programme.cost, picks), 9)
        best = min(best, (value, total(programme.tie, picks)))
    return best


def total(values, picks):
    return sum(float(v[i]) for v, i in zip(values, picks, strict=True))


def goal(programme, peak):
    return Goal(weight=programme.weight) if peak else Goal(cost=programme.cost)


@settings(max_examples=100, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    sizes=st.lists(st.integers(1, 7), min_size=1, max_size=4),
    rows=st.integers(1, 3),
    vectors=st.integers(0, 2),
    tightness=st.floats(-0.02, 0.7),
    peak=st.booleans(),
)
def test_finds_the_best_of_all(seed, sizes, rows, vectors, tightness, peak):
    programme = instance(seed, sizes, rows, tightness, vectors)
    search = CombinationSearch(programme)
    found = search.minimise(goal(programme, peak))
    value, tie = everything(programme, peak)
    assert found.complete
    if value == math.inf:
        assert found.picks is None
        assert search.conflicting_rows()
        return
    assert found.value == pytest.approx(value, rel=1e-12)
    assert found.gap <= 1e-9
    second = search.minimise(Goal(cost=programme.tie))
    assert goal(programme, peak).value(programme, second.picks) == pytest.approx(value, rel=1e-12)
    assert second.value == tie


@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_the_best_is_the_best_in_any_unit(unit):
    """Deflections are some 1e-6 m, preloads some 1e5 N: how near the bound is near is relative."""
    for seed in range(20):
        programme = instance(seed, [6, 6, 6], 1, 0.6, 2)
        programme = replace(programme, weight=unit * programme.weight)
        found = CombinationSearch(programme).minimise(goal(programme, True))
        value, _ = everything(programme, True)
        assert found.complete
        assert found.value == pytest.approx(value, rel=1e-12)
        assert found.gap <= 1e-9


def test_conflicting_rows_are_named_after_solver_failure():
    # HiGHS ends without an answer once this instance has its first cut.
    programme = instance(2012, [5, 5, 5], 2, 0.015625, 2)
    search = CombinationSearch(programme)
    assert search.minimise(goal(programme, False)).picks is None
    named = search.conflicting_rows()
    assert named
    assert set(named) <= set(programme.names)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.0, 0.5))
def test_designs_that_break_a_row_alone_are_in_no_combination(seed, tightness):
    programme = instance(seed, [5, 4, 5], 2, tightness, 1)
    broken = programme.broken_alone()
    for picks in itertools.product(range(5), range(4), range(5)):
        if (programme.amounts(picks) <= programme.cap).all():
            assert not any(i in own for i, own in zip(picks, broken, strict=True))
        assert (programme.amounts(picks) >= programme.least_amounts() * (1 - 1e-12)).all()


def test_many_elements_tied_together_by_one_row():
    """Fifteen elements of forty designs: 1e24 combinations, one row over all of them."""
    programme = instance(3, [40] * 15, 1, 0.4)
    found = CombinationSearch(programme).minimise(Goal(cost=programme.cost))
    assert found.complete
    assert found.gap <= 1e-9
    assert found.nodes < 1_000


def test_time_limit_leaves_a_valid_bound():
    programme = instance(5, [12] * 6, 3, 0.35)
    best = CombinationSearch(programme).minimise(Goal(cost=programme.cost))
    short = CombinationSearch(programme, seconds=0.0).minimise(Goal(cost=programme.cost))
    assert not short.complete
    assert short.bound <= best.value * (1 + 1e-12)
    assert short.value >= best.value
