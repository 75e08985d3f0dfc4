"""End of the forward search."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from stiffopt.discovery.search import search as module


@pytest.mark.parametrize("first", [{"dry friction"}, {"drag", "Stribeck"}])
def test_effects_that_replace_one_another_end_the_search(first, monkeypatch):
    """Each of two sets is likelier to add to than to keep, such as friction and drag."""
    follows = {
        frozenset({"dry friction"}): ("drag", {"drag", "Stribeck"}),
        frozenset({"drag", "Stribeck"}): ("dry friction", {"dry friction"}),
    }
    rounds: list[str] = []

    def labels(effects: Any) -> frozenset[str]:
        return frozenset(each.label for each in effects)

    def located(names: Any) -> list[Any]:
        return [SimpleNamespace(label=name) for name in sorted(names)]

    def best(found: Any, scorer: Any, room: int) -> list[Any]:
        name, _ = follows[labels(search.effects)]
        rounds.append(name)
        assert len(rounds) < 10
        return [SimpleNamespace(located=SimpleNamespace(label=name), evidence=50.0)]

    def fit(effects: Any) -> None:
        _, kept = follows[labels(search.effects)]
        search.effects = located(kept)

    monkeypatch.setattr(module, "Scorer", lambda current, effects: None)
    monkeypatch.setattr(module, "scan", lambda scorer, catalogue, tell: ())
    monkeypatch.setattr(module, "_select_best", best)
    search: Any = module._Search(
        start=None, current=None, catalogue=(), most=12, together=3, say=lambda _: None
    )
    search.effects = located(first)
    monkeypatch.setattr(search, "_as_unstated", lambda each: each)
    monkeypatch.setattr(search, "_fit_and_prune", fit)
    monkeypatch.setattr(search, "_fit", lambda effects: None)
    search._add_forward(12)
    assert len(rounds) == 2
    assert labels(search.effects) == frozenset(first)
