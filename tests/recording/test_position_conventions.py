"""Positions with another zero, or reported as sums of two joints, become those of the joints."""

import numpy as np
import pytest

from stiffopt.errors import InputFileError
from stiffopt.recording.schema import SignalsSection
from stiffopt.recording.signals import build_signals

NAMES = {
    "time": "t",
    "position": ("q1", "q2", "q3"),
    "velocity": ("v1", "v2", "v3"),
    "torque": ("tau1", "tau2", "tau3"),
}
TIME = np.linspace(0.0, 1.0, 9)
ANGLES = {f"q{j}": np.sin(j * TIME) for j in (1, 2, 3)}
SPEEDS = {f"v{j}": j * np.cos(j * TIME) for j in (1, 2, 3)}


def signals(**changes):
    return build_signals(SignalsSection(**NAMES, **changes), 3, "recordings.toml")


def recorded():
    torques = {f"tau{j}": np.ones(9) for j in (1, 2, 3)}
    return {"t": TIME} | ANGLES | SPEEDS | torques


def test_sum_is_separated_in_position_and_velocity():
    file = recorded()
    file["q3"], file["v3"] = file["q3"] + file["q2"], file["v3"] + file["v2"]
    read = signals(position_includes=(0, 0, 2)).to_si(file)
    np.testing.assert_allclose(read["q3"], ANGLES["q3"], atol=1e-15)
    np.testing.assert_allclose(read["v3"], SPEEDS["v3"], atol=1e-15)
    np.testing.assert_array_equal(read["q2"], ANGLES["q2"])


def test_difference_is_separated():
    file = recorded()
    file["q3"] = file["q3"] - file["q2"]
    read = signals(position_includes=(0, 0, -2)).to_si(file)
    np.testing.assert_allclose(read["q3"], ANGLES["q3"], atol=1e-15)


def test_offset_is_added_after_the_unit_is_converted():
    degrees = {"scale": {"position": "deg"}, "offset": (1.5, 0.0, -0.25)}
    read = signals(**degrees).to_si(recorded())
    np.testing.assert_allclose(read["q1"], np.radians(ANGLES["q1"]) + 1.5)
    np.testing.assert_allclose(read["q3"], np.radians(ANGLES["q3"]) - 0.25)


def test_conversion_back_is_the_inverse():
    both = signals(position_includes=(0, 0, 2), offset=(0.1, -0.2, 0.3))
    there = both.as_recorded(both.to_si(recorded()))
    for name, values in recorded().items():
        np.testing.assert_allclose(there[name], values, atol=1e-15, err_msg=name)


@pytest.mark.parametrize("includes", [(0, 0, 3), (0, 0, 4), (0, 1, 2), (0, 2)])
def test_impossible_sums_are_refused(includes):
    with pytest.raises(InputFileError, match="position_includes"):
        signals(position_includes=includes)
