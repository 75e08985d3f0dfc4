"""Gates that an ablation takes out: each is there, and is called where it is taken out."""

from contextlib import nullcontext

import pytest

from benchmarks.blind.gates import GATES, noticing, without_gate
from stiffopt.discovery.judging import unexplained


@pytest.mark.parametrize("gate", GATES, ids=lambda gate: gate.name)
def test_every_gate_can_be_taken_out(gate):
    with without_gate(gate), noticing([gate]) as acted:
        assert not acted


def test_a_gate_that_changes_a_result_is_noticed():
    (excess,) = (gate for gate in GATES if gate.name == "noise_excess")
    for taken, notice, told in (
        (nullcontext(), {"noise_excess"}, 2.0),
        (without_gate(excess), set(), 1.0),
    ):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(unexplained, "_noise_excess", lambda _: 2.0)
            with taken, noticing([excess]) as acted:
                found = unexplained._noise_excess(None)
        assert acted == notice
        assert found == told
