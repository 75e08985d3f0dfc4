"""What displaces the ends of springs shows in the torque of an arm whose links swing."""

from __future__ import annotations

import pytest
from simulated_sets import diagnosed, said, short_case

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("robot", "effect", "joint", "severity"),
    [("planar2", "transmission_error", 2, 2.0), ("small3", "wrist_coupling", 2, 1.0)],
)
def test_effect_is_found_without_link_encoders(
    robot: str, effect: str, joint: int, severity: float
) -> None:
    spec = short_case((effect, joint, severity), seed=26, robot=robot, link_encoders=False)
    diagnosis = diagnosed(spec)
    named = [(found.effect.name, found.joint) for found in diagnosis.findings]
    assert named == [(effect, joint)], said(diagnosis)
