"""What fits alike is told beside a finding, however much plainer that is."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.search import rivals
from stiffopt.discovery.search.candidates import Candidate

# A wrist that carries little: three laws of its wind-up fit alike.
FOUND = {"stiffness_linear": 226.4, "preload_loss": 224.3, "k1_softening": 223.9}


def candidate(name: str, evidence: float) -> Candidate:
    entry = effect(name)
    shapes = tuple(1.0 for _ in entry.shapes)
    return Candidate(
        located=LocatedEffect(effect=entry, joint=5, shapes=shapes),
        amplitudes=np.ones(1),
        covariance=np.zeros((1, 1)),
        evidence=evidence,
        deviations=21.4,
        gained=lambda: 8.2,
        change=lambda: (11, 0.5),
    )


@pytest.mark.parametrize(
    ("evidence", "told"),
    [
        (FOUND, ["preload_loss", "k1_softening"]),
        (FOUND | {"k1_softening": 219.0}, ["preload_loss"]),
    ],
)
def test_collinear_laws_are_listed(
    evidence: dict[str, float], told: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    every = [candidate(*pair) for pair in evidence.items()]
    scorer = SimpleNamespace(score=lambda located: every[0])
    monkeypatch.setattr(rivals, "Scorer", lambda comparison, others: scorer)
    monkeypatch.setattr(rivals, "scan", lambda scorer, catalogue, **_: every)
    comparison: Any = SimpleNamespace(after_model=False, max_inherited_evidence=0.0, constants=None)
    monkeypatch.setattr(rivals.LocatedEffect, "constants", lambda self, constants: None)
    located = every[0].located
    ranked = rivals.rank_rivals(comparison, [located], located, ())
    assert ranked is not None
    assert ranked.likelier is None
    assert [other.effect.name for other, _ in ranked.rivals] == told
