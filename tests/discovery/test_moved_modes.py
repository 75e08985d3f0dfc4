"""Modes far from where the nominal model has them, in sharp motion: a soft joint, a payload."""

import pytest
from simulated_sets import diagnosed, said, simulated

from benchmarks.simulator import CaseSpec
from stiffopt.report.diagnosis.words import paragraph

SOFT = CaseSpec(
    robot="big6", seed=11, train=3, test=1, extrapolate=0, seconds=5.0, rate=250.0, substeps=8,
    payload=10.0, smoothing=0.2, effects=(("stiffness_linear", 2, 1.5),),
)  # fmt: skip
LOADED = CaseSpec(
    robot="big6", seed=12, train=3, test=1, extrapolate=0, seconds=5.0, rate=250.0, substeps=8,
    payload=5.0, smoothing=0.3, effects=(("payload", None, 3.0),),
)  # fmt: skip


@pytest.mark.slow
def test_soft_joint_is_found_with_stiffness_and_mode():
    found = diagnosed(SOFT)
    assert [f.located.label for f in found.findings] == ["stiffness_linear of joint 2"], said(found)
    factor = found.findings[0].parameters[0]
    truth = simulated(SOFT).truth
    stiffness = truth["effects"][0]["params"]["factor"] * truth["true_tolerances"]["k"][1]
    # Which share of it is tolerance cannot be told: that is in the standard deviation.
    assert abs(factor.value - stiffness) < 2.0 * factor.sd
    assert factor.sd < 0.02 * stiffness
    assert found.nrmse("test")[1] < 1.1
    moved = [mode for mode in found.modes if mode.is_shifted]
    assert moved
    assert moved[0].found < moved[0].nominal
    assert f"The mode of joint {moved[0].joint} has {moved[0].found:.1f} Hz, in the" in paragraph(
        found
    )


@pytest.mark.slow
def test_payload_shifts_modes_and_is_found():
    found = diagnosed(LOADED)
    assert [f.effect.name for f in found.findings] == ["payload"], said(found)
    assert found.nrmse("test")[1] < 1.1
    moved = [mode for mode in found.modes if mode.is_shifted]
    assert moved
    assert all(mode.found < mode.nominal for mode in moved)
    assert str(moved[0]) in paragraph(found)
