"""Geometric causes in recordings: wrong zeros, summed positions, a tilted base."""

from pathlib import Path

import numpy as np
import pytest

from stiffopt.discovery.answer import action
from stiffopt.discovery.diagnose import diagnose
from stiffopt.discovery.sanity.doubt import DoubtfulRecordings
from stiffopt.recording.recording_set import load_recordings

CASES = Path(__file__).resolve().parents[3] / "shared" / "cases" / "diagnosis"


def shared_case(name):
    if not (CASES / name).is_dir():
        pytest.skip("the shared recordings are not beside this repository")
    return CASES / name


@pytest.mark.parametrize(
    ("name", "joint", "degrees"), [("small_offset", 3, -2.0), ("offset5", 2, -5.0)]
)
def test_wrong_zero_is_named_with_its_size(name, joint, degrees):
    diagnosis = diagnose(shared_case(name), experiment=False)
    found = diagnosis.findings
    assert [(f.effect.name, f.joint) for f in found] == [("joint_zero", joint)]
    (dq,) = found[0].parameters
    assert abs(dq.value - np.radians(degrees)) < 3.0 * dq.sd
    assert dq.sd < np.radians(0.3)
    assert "offset = [" in action(diagnosis)


@pytest.mark.parametrize(("name", "degrees"), [("tiltd9", 9.0), ("tiltd16", 16.0)])
def test_tilt_is_named_with_its_size(name, degrees):
    found = diagnose(shared_case(name), experiment=False).findings
    assert [f.effect.name for f in found] == ["base_tilt"]
    rx, ry = found[0].parameters
    angle = np.hypot(rx.value, ry.value)
    assert abs(angle - np.radians(degrees)) < 3.0 * max(rx.sd, ry.sd)


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("zero_offset", "offset = [0.0, -1.5708, 0.0, 0.0, 0.0, 0.0] in [signals]"),
        ("fanuc_coupled", "position_includes = [0, 0, 2, 0, 0, 0] in [signals]"),
    ],
)
def test_convention_is_told_with_its_line(name, line):
    with pytest.raises(DoubtfulRecordings) as raised:
        diagnose(shared_case(name), experiment=False)
    assert [doubt.line for doubt in raised.value.doubts] == [line]


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("zero_offset", "signals.offset=[0.0, -1.5708, 0.0, 0.0, 0.0, 0.0]"),
        ("fanuc_coupled", "signals.position_includes=[0, 0, 2, 0, 0, 0]"),
    ],
)
def test_line_of_a_convention_leaves_nothing_missing(name, change):
    recordings = load_recordings(shared_case(name), [change])
    assert diagnose(recordings, experiment=False).verdict == "nothing_missing"


def test_hand_that_guides_the_arm_is_told_as_a_force_at_the_tool():
    found = diagnose(shared_case("hand_guided"), experiment=False)
    assert found.findings == ()
    assert found.unexplained is not None
    force = found.unexplained.tool_force
    assert force is not None
    assert force.explained > 0.95
    assert 60.0 < force.size < 110.0
