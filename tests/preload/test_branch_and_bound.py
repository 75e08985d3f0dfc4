"""The search of catalogue designs against trying every combination."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stiffopt.preload.branch_and_bound import Search
from stiffopt.preload.menus import Menu, Rows, dominated


def instance(seed, sizes, blocks, rows, tightness):
    """Designs that trade cost for use, as preloads trade force for compliance."""
    rng = np.random.default_rng(seed)
    menus = []
    for size, block in zip(sizes, blocks, strict=True):
        cost = np.round(rng.uniform(1, 9, size), 1)
        use = rng.uniform(0.5, 1.5, (size, rows)) / cost[:, None] ** 0.7
        tie = rng.integers(1, 5, size).astype(float)
        menus.append(Menu(block, cost, tie, use, use))
    low = sum(m.use.min(axis=0) for m in menus)
    high = sum(m.use.max(axis=0) for m in menus)
    base = rng.uniform(0, 1, rows)
    cap = base + low + tightness * (high - low)
    weight = rng.uniform(0.5, 2, rows)
    names = tuple(f"row {r}" for r in range(rows))
    return menus, Rows(names, base, cap, weight)


def everything(menus, rows, peak, amounts=None):
    """Best of all combinations: objective, then ties."""
    best = (math.inf, math.inf)
    for picks in itertools.product(*(range(len(m.cost)) for m in menus)):
        used = rows.base + sum(m.use[i] for m, i in zip(menus, picks, strict=True))
        used = used if amounts is None else amounts(picks)
        if (used > rows.cap * (1 + 1e-12)).any():
            continue
        if peak:
            key = (float((used * rows.weight).max()), 0.0)
        else:
            key = (
                round(sum(float(m.cost[i]) for m, i in zip(menus, picks, strict=True)), 9),
                sum(float(m.tie[i]) for m, i in zip(menus, picks, strict=True)),
            )
        best = min(best, key)
    return best


cases = st.tuples(
    st.integers(0, 10**6),
    st.lists(st.integers(1, 7), min_size=1, max_size=4),
    st.integers(1, 3),
    st.floats(-0.02, 0.7),
    st.integers(1, 3),
)


@settings(max_examples=60, deadline=None)
@given(cases, st.booleans())
def test_finds_the_best_of_all(case, peak):
    seed, sizes, rows, tightness, width = case
    blocks = [i // width for i in range(len(sizes))]
    menus, limits = instance(seed, sizes, blocks, rows, tightness)
    found = Search(menus, limits, peak=peak).run()
    value, tie = everything(menus, limits, peak)
    assert found.proof.accounted == found.proof.combinations == math.prod(sizes)
    assert found.proof.complete
    if value == math.inf:
        assert found.picks is None
        assert found.stoppers[0].startswith("row")
        return
    assert found.value == pytest.approx(value, rel=1e-12)
    assert found.proof.bound == found.value
    if not peak:
        ties = sum(m.tie[i] for m, i in zip(menus, found.picks, strict=True))
        assert ties == tie


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.booleans(), st.floats(0.0, 0.5))
def test_use_may_be_a_lower_bound_of_the_true_amounts(seed, peak, tightness):
    menus, limits = instance(seed, [5, 4, 5], [0, 1, 1], 2, tightness)
    rng = np.random.default_rng(seed)
    extra = rng.uniform(0, 0.3, (5, 4, 5, 2))
    # A larger use of one design must never help: dominance then holds in no column.
    menus = [
        Menu(
            m.block,
            m.cost,
            m.tie,
            m.use,
            np.column_stack([np.arange(len(m.cost)) * s for s in (1, -1)]),
        )
        for m in menus
    ]

    def amounts(picks):
        linear = limits.base + sum(m.use[i] for m, i in zip(menus, picks, strict=True))
        return linear + extra[picks]

    found = Search(menus, limits, peak=peak, amounts=amounts).run()
    value, _ = everything(menus, limits, peak, amounts)
    assert found.proof.accounted == 100
    assert (found.picks is None) == (value == math.inf)
    if found.picks is not None:
        assert found.value == pytest.approx(value, rel=1e-12)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.booleans())
def test_dominated_designs_never_change_the_optimum(seed, peak):
    menus, limits = instance(seed, [6, 6, 5], [0, 0, 1], 2, 0.3)
    thin = [m.kept(np.setdiff1d(np.arange(len(m.cost)), dominated(m, peak))) for m in menus]
    assert everything(thin, limits, peak) == pytest.approx(everything(menus, limits, peak))


def test_many_elements_tied_together_by_one_row():
    """Fifteen elements of forty designs: 1e24 combinations, one row over all of them."""
    menus, limits = instance(3, [40] * 15, [i // 3 for i in range(15)], 1, 0.4)
    found = Search(menus, limits, peak=False).run()
    assert found.proof.complete
    assert found.proof.combinations == 40**15 == found.proof.accounted
    assert found.proof.nodes < 50_000


def test_a_node_limit_leaves_an_honest_bound():
    menus, limits = instance(5, [12] * 6, [0] * 6, 3, 0.35)
    best = Search(menus, limits, peak=False).run()
    short = Search(menus, limits, peak=False, node_limit=10).run()
    assert not short.proof.complete
    assert short.proof.accounted == 12**6
    assert short.proof.bound <= best.value * (1 + 1e-12)
    assert short.value >= best.value
