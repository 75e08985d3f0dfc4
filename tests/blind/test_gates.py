"""Gates that an ablation takes out: each is there, and is called where it is taken out."""

from contextlib import nullcontext

import pytest

from benchmarks.blind.gates import GATES, noticing, without_gate
from stiffopt.discovery.search import joint_fit


@pytest.mark.parametrize("gate", GATES, ids=lambda gate: gate.name)
def test_every_gate_can_be_taken_out(gate):
    with without_gate(gate), noticing([gate]) as acted:
        assert not acted


def test_a_gate_that_changes_a_result_is_noticed():
    (exempt,) = (gate for gate in GATES if gate.name == "nominal")
    for taken, notice in ((nullcontext(), {"nominal"}), (without_gate(exempt), set())):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(joint_fit, "_is_supported_by_nominal", lambda *_: True)
            with taken, noticing([exempt]) as acted:
                supported = joint_fit._is_supported_by_nominal(None, [], 0)
        assert acted == notice
        assert supported == bool(notice)
