"""Residual that no finding explains: when a dependence on signals is told."""

from __future__ import annotations

import pytest
from shipped_set import SHIPPED

from stiffopt.discovery.judging import unexplained
from stiffopt.discovery.judging.unexplained import Unexplained, assess_findings
from stiffopt.discovery.search.search import search
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import prepare_training
from stiffopt.recording.recording_set import load_recordings


@pytest.mark.parametrize(("gain", "told"), [(0.05, False), (0.3, True)])
def test_a_dependence_that_explains_little_is_not_told(
    monkeypatch: pytest.MonkeyPatch, gain: float, told: bool
) -> None:
    """A period that explains 5 % of a residual was told of a torque of a mobile arm."""
    result = search(prepare_training(load_recordings(SHIPPED), Settings()).comparison(), [])
    found = Unexplained(("torque_2",), ("time",), 0.3, gain, 5.0)
    monkeypatch.setattr(unexplained, "_describe_remainder", lambda *_: found)
    _, left = assess_findings(result)
    assert left is not None
    assert left.gain == gain
    assert (left.regressors, left.period) == ((("time",), 0.3) if told else ((), None))
