"""Every effect changes the balance and joint that it should, and nothing else."""

from functools import cache

import numpy as np
import pytest
from balances import excess

from benchmarks.simulator import EFFECTS, CaseSpec, simulate

BASE = CaseSpec(robot="planar2", seed=12, train=1, test=1, extrapolate=0, seconds=1.2)
SILENT = 0.06  # of the sensor noise; what second-order integration leaves is below it
FRICTION = {
    "coulomb",
    "viscous",
    "viscous_power",
    "stribeck",
    "load_friction",
    "asym_friction",
    "position_friction",
    "thermal_friction",
    "neighbour_friction",
    "dragging_brake",
    "lubricated_friction",
    "friction_drift",
    "friction_warmup",
    "stroke_friction",
    "quadratic_drag",
    "dragging_bundle",
    "thinning_drag",
    "odd_ripple",
    "rattling_weight",
    "shared_bearing",
    "sticking_seal",
}
DRIVE = {
    "rotor_inertia",
    "torque_ripple",
    "torque_gain",
    "torque_offset",
    "saturation",
    "reading_limit",
    "slew_limit",
    "torque_sensor_drift",
    "gain_drift",
    "gain_warmup",
    "crosstalk",
    "joint_delay",
}
ELASTIC = {
    "backlash",
    "stiffness_linear",
    "k1_softening",
    "preload_loss",
    "belt_creep",
    "hysteresis",
    "encoder_offset",
    "encoder_zero_change",
    "softening_by_heat",
    "loose_encoder",
}
OUTER = {
    "gravity_spring",
    "cable_spring",
    "pulsing_load",
    "slosh",
    "pulling_hose",
    "balancing_rope",
    "clocked_pump",
    "trapped_liquid",
    "leaning_cover",
    "three_joint_hose",
    "magnet_pair",
    "loose_weight",
}
# Balance -> joints (from 1) where something shows; the rest has to stay silent.
OTHERS: dict[str, dict[str, set[int]]] = {
    "time_delay": {"motor": {1, 2}, "total": {1, 2}},
    "reading_filter": {"motor": {1, 2}, "total": {1, 2}},
    "clock_drift": {"motor": {1, 2}, "total": {1, 2}},
    "run_clock": {"motor": {1, 2}, "total": {1, 2}},
    "common_gain_drift": {"motor": {1, 2}, "total": {1, 2}},
    "encoder_skew": {"motor": {1, 2}, "link": {1, 2}, "deflection": {1, 2}},
    "payload": {"link": {1, 2}, "deflection": {1, 2}, "total": {1, 2}},
    "inertial_error": {"link": {1, 2}, "deflection": {1, 2}, "total": {1, 2}},
    "base_tilt": {"link": {1, 2}, "deflection": {1, 2}, "total": {1, 2}},
    "external_contact": {"link": {1, 2}, "deflection": {1, 2}, "total": {1, 2}},
    "tool_force": {"link": {1, 2}, "deflection": {1, 2}, "total": {1, 2}},
    "turning_tool_force": {"link": {1, 2}, "deflection": {1, 2}, "total": {1, 2}},
    "joint_zero": {"link": {1, 2}, "deflection": {1, 2}, "total": {1, 2}},
    "touched": {"link": {1, 2}, "deflection": {1, 2}, "total": {1, 2}},
    # Both carry a little torque back: on the motor of the joint, on that of the joint before.
    "transmission_error": {"motor": {2}, "link": {2}, "deflection": {2}, "total": {2}},
    "wrist_coupling": {"motor": {2}, "link": {2}, "deflection": {2}},
}


def expected(name: str) -> dict[str, set[int]]:
    if name in FRICTION | DRIVE:
        return {"motor": {2}, "total": {2}}
    if name in ELASTIC:
        return {"motor": {2}, "link": {2}, "deflection": {2}}
    if name in OUTER:
        return {"link": {2}, "deflection": {2}, "total": {2}}
    return OTHERS[name]


@cache
def lacking(name: str | None) -> dict[str, np.ndarray]:
    effects = ()
    if name:
        effects = ((name, None if EFFECTS[name].where in ("robot", "recording") else 2, 1.0),)
    robot = "small3" if name == "three_joint_hose" else BASE.robot
    return excess(simulate(CaseSpec(**{**BASE.__dict__, "effects": effects, "robot": robot})))


def test_nothing_is_missing_from_the_true_robot_itself():
    for balance, values in lacking(None).items():
        assert np.all(values < 0.01), (balance, values)


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_effect_shows_where_it_acts(name):
    found = lacking(name)
    shows = expected(name)
    for balance, values in found.items():
        for joint, value in enumerate(values, start=1):
            if joint in shows.get(balance, set()):
                assert value > 2 * SILENT, (balance, joint, found)
            else:
                assert value < SILENT, (balance, joint, found)


def test_the_catalogue_of_the_design_is_complete():
    alone = {"payload", "base_tilt", "external_contact", "time_delay", "inertial_error"}
    alone |= {"clock_drift", "run_clock", "common_gain_drift"}
    alone |= {"encoder_skew", "wrist_coupling", "transmission_error"}
    alone |= {"joint_zero", "tool_force", "turning_tool_force"}
    outside = {"pulsing_load", "neighbour_friction", "slosh", "torque_sensor_drift"}
    outside |= {"slew_limit", "dragging_brake"}
    later = {name for name, entry in EFFECTS.items() if not entry.drawn}
    named = (FRICTION | DRIVE | ELASTIC | OUTER | alone) - outside - later
    inside = {name for name, entry in EFFECTS.items() if not entry.outside} - later
    assert inside == named
    assert set(EFFECTS) - inside - later == outside


@pytest.mark.parametrize(
    ("effect", "what"),
    [
        (("coulomb", None, 1.0), "acts on a joint"),
        (("payload", 1, 1.0), "acts on the whole robot"),
        (("coulomb", 3, 1.0), "no joint 3"),
        (("rust", 1, 1.0), "no effect 'rust'"),
    ],
)
def test_wrong_requests_are_refused(effect, what):
    with pytest.raises((KeyError, ValueError), match=what):
        simulate(CaseSpec(**{**BASE.__dict__, "effects": (effect,)}))
