"""What a set states of its robot comes back from extended.toml as it was."""

from __future__ import annotations

import tomllib

from stiffopt.discovery.extended.store import nominal_tables
from stiffopt.recording.schema import NominalSection

STATED = """
gear_ratio = [101.0, -50.0]
coulomb = [1.0, 2.0]
friction_temperature = 25.0
contact_stiffness = [2e4, inf]
connections = ["belt+key", "none"]

[reducer]
K1 = [1e4, inf]
K2 = [2e4, inf]
K3 = [3e4, inf]
T1 = [7.0, 7.0]
T2 = [25.0, 25.0]

[[counterbalance]]
type = "spring"
joint = "swing"
stiffness = 20.0
offset = 0.1

[[counterbalance]]
type = "table"
joint = 2
angle = [0.0, 1.0]
torque = [0.0, 4.0]
"""


def test_stated_values_are_written_as_they_were_read() -> None:
    stated = NominalSection.model_validate(tomllib.loads(STATED))
    written = tomllib.loads("\n".join(nominal_tables(stated)))
    assert NominalSection.model_validate(written["nominal"]) == stated


def test_a_single_counterbalance_is_written_too() -> None:
    one = {"counterbalance": {"type": "spring", "joint": 1, "stiffness": 20.0}}
    stated = NominalSection.model_validate(one)
    written = tomllib.loads("\n".join(nominal_tables(stated)))
    (balance,) = NominalSection.model_validate(written["nominal"]).counterbalance
    assert balance == stated.counterbalance
