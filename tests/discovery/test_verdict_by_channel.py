"""Every channel is judged by itself: a finding at one joint does not answer for another."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from stiffopt.discovery.conclusions import decide_verdict
from stiffopt.discovery.diagnose import diagnose
from stiffopt.discovery.judging.unexplained import ChannelVerdict
from stiffopt.discovery.store import answer_document
from stiffopt.report.diagnosis.page import write_diagnosis_report
from stiffopt.report.diagnosis.sections import outside_lines
from tests.discovery.own_machines import SCARA, Machine
from tests.discovery.test_states_of_a_robot import UPRIGHT


def _write_set(machine: Machine, folder: Path, harder: float, pulse: float) -> Path:
    """More dry friction at joint 3, and a pump beside joint 1 that knows nothing of the motion."""
    phase = np.random.default_rng(7).uniform(0.0, 2.0 * np.pi, 4)

    def disturb(logs: list) -> None:
        for log, begin in zip(logs, phase, strict=True):
            log["tau"][:, 2] += harder * machine.coulomb[2] * np.tanh(log["v"][:, 2] / 0.01)
            log["tau"][:, 0] += pulse * np.sin(2.0 * np.pi * log["t"] / 0.71 + begin)

    return machine.write(folder, disturb)


@pytest.mark.parametrize("machine", [SCARA, UPRIGHT], ids=lambda each: each.name)
def test_finding_at_one_joint_does_not_hide_a_pump_at_another(machine, tmp_path):
    pulse = 3.0 * machine.noise[0]
    found = diagnose(_write_set(machine, tmp_path / "set", 0.6, pulse), experiment=False)
    verdicts = {each.channel: each.verdict for each in found.channel_verdicts}
    assert verdicts == {"torque_1": "outside", "torque_2": "nothing", "torque_3": "named"}
    assert found.verdict == "outside_catalogue"
    assert [(f.effect.name, f.joint) for f in found.findings] == [("coulomb", 3)]
    written = answer_document(found)["verdict_by_channel"]
    assert {name: each["verdict"] for name, each in written.items()} == verdicts
    assert "joint 1" in outside_lines(found)[0]
    assert "outside the catalogue" in write_diagnosis_report(found, tmp_path).read_text()


def test_findings_that_explain_all_leave_no_channel_open(tmp_path):
    found = diagnose(_write_set(SCARA, tmp_path / "set", 0.6, 0.0), experiment=False)
    verdicts = {each.channel: each.verdict for each in found.channel_verdicts}
    assert verdicts == {"torque_1": "nothing", "torque_2": "nothing", "torque_3": "named"}
    assert found.verdict == "named"


@pytest.mark.parametrize(
    ("outcome", "verdict"), [("nothing", "nothing_missing"), ("named", "outside_catalogue")]
)
def test_a_possible_finding_leaves_open_what_nominal_values_do_not_explain(outcome, verdict):
    possible = SimpleNamespace(certainty="possible")
    channel = ChannelVerdict(
        channel="torque_1", verdict=outcome, before=1.0, after=1.0, acted_on=True
    )
    assert decide_verdict((possible,), None, (channel,)) == verdict
