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
    (mode,) = (gate for gate in GATES if gate.name == "elastic_mode")
    for taken, notice in ((nullcontext(), {"elastic_mode"}), (without_gate(mode), set())):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(unexplained, "_is_elastic_mode", lambda *_: True)
            with taken, noticing([mode]) as acted:
                found = unexplained._is_elastic_mode(None, [], 0)
        assert acted == notice
        assert found == bool(notice)
