"""End stop that was added since the model was made."""

import numpy as np
import pytest
from swivel_sets import recorded, swivel_model

from stiffopt.discovery.catalogue import effect
from stiffopt.discovery.diagnose import diagnose
from stiffopt.discovery.user_effects import sample_signals

STIFFNESS, PLACE = 40.0, 0.6


def stopped(folder, side):
    """Runs against a stop at one end of the stroke."""
    return recorded(
        folder, lambda q: STIFFNESS * side * np.maximum(side * q - PLACE, 0.0), swivel_model(0.2)
    )


@pytest.mark.parametrize("side", [1.0, pytest.param(-1.0, marks=pytest.mark.slow)])
def test_end_stop_is_found_with_its_angle(tmp_path, side):
    folder = stopped(tmp_path, side)
    found = diagnose(folder, model=folder / "extended.toml", experiment=False)
    assert [f.effect.name for f in found.findings] == ["end_stop"]
    values = {p.name: p.value for p in found.findings[0].parameters}
    assert values == pytest.approx({"k": STIFFNESS, "q0": side * PLACE}, rel=0.03)


@pytest.mark.slow
def test_end_stop_is_not_sought_without_earlier_model(tmp_path):
    found = diagnose(stopped(tmp_path, 1.0), experiment=False)
    assert "end_stop" not in {f.effect.name for f in found.findings}
    assert "end_stop" not in {limit.effect.name for limit in found.detection_limits}


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_end_stop_acts_only_beyond_its_angle(side):
    signals = sample_signals().of_joint(4)
    q0 = float(np.mean(signals.constants.stroke))
    torque = effect("end_stop").term(signals, [200.0], [q0, side]).link_torque
    beyond = side * (signals.link_position - q0)
    np.testing.assert_allclose(
        torque, 200.0 * side * np.maximum(beyond, 0.0), atol=200.0 * 2e-3 * np.log(2.0) * 1.01
    )
