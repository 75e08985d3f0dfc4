"""Findings in a closed loop: torques of effects by angle, velocity and actuator torque."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from stiffopt.closed_loop.arm import LoopTorque
from stiffopt.discovery.comparison.located_effect import EstimatedEffect
from stiffopt.discovery.extended.model import ExtendedModel
from stiffopt.discovery.extended.planning import joint_constants, planner_model
from stiffopt.discovery.signals import JointConstants, JointSignals
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.robot.added_torque import AddedTorque, MotionState
from stiffopt.robot.robot import Robot
from stiffopt.symbolic import Quantity

# Samples of angle, velocity and torque at which a formula is compared with the term, over a time
# in which memory would show; and the difference allowed over its size.
_SAMPLE_COUNT, _FORMULA_TOLERANCE = 50, 1e-6


def robot_in_loop(
    recordings: RecordingSet, model: ExtendedModel
) -> tuple[Robot, LoopTorque | None, dict[int, float]]:
    """Return the robot with findings, the torques of those it cannot hold, and encoder zeros.

    Zeros [rad] are readings less angles, by the joint (from 0) of the robot. Effects with memory,
    of accelerations, of sensors, of single runs and of the whole arm are in none of these; of those
    of several joints only laws are.
    """
    planner = planner_model(recordings.robot, model)
    zeros, terms = {}, []
    for each in planner.not_in_robot:
        joint = each.located.joint
        if joint is None or each.located.run is not None or each.effect.only_in:
            continue
        place = int(recordings.order[joint])
        if each.effect.moves_zero:
            zeros[place] = -each.amplitudes[0]
            continue
        if each.effect.couples_joints:
            continue
        own = recordings.robot.chains[place]
        formula = _torque_formula(each, joint_constants(model, joint, own))
        if formula is not None:
            terms.append((place, formula))
    n, torques = recordings.n, planner.robot.added_torques
    laws = [each for each in torques if not _needs_acceleration(each, n)]
    if not (terms or laws):
        return planner.robot, None, zeros

    def added(q: ca.SX, v: ca.SX, direction: ca.SX, torque: ca.SX) -> ca.SX:
        total = ca.SX.zeros(n)
        for place, formula in terms:
            total[place] += formula(q[place], v[place], direction[place], torque[place])
        state = _motion_state(q, v, ca.SX(np.full(n, np.nan)), direction, torque)
        for each in laws:
            total[each.joint] += each.value(state)
        return total

    return planner.robot, added, zeros


def _motion_state(q: ca.SX, v: ca.SX, a: ca.SX, direction: ca.SX, torque: ca.SX) -> MotionState:
    position, velocity, acceleration, sign, load = map(ca.vertsplit, (q, v, a, direction, torque))
    return MotionState(
        position=position, velocity=velocity, acceleration=acceleration, direction=sign, load=load
    )


def _needs_acceleration(law: AddedTorque, joints: int) -> bool:
    """Return True for a torque by accelerations, which only follow from the torques."""
    symbols = [ca.SX.sym(name, joints) for name in ("q", "v", "a", "direction", "torque")]
    return bool(ca.depends_on(ca.SX(law.value(_motion_state(*symbols))), symbols[2]))


def _torque_formula(each: EstimatedEffect, constants: JointConstants) -> ca.Function | None:
    """Return (angle, velocity, direction, torque) -> torque that the effect takes [N m].

    None where the term is no formula of these: it has memory, or acts on readings.
    """
    arguments = [ca.SX.sym(name) for name in ("q", "v", "direction", "torque")]
    try:
        formula = _evaluate_term(each, constants, arguments, 0.0)
    except (TypeError, NotImplementedError, RuntimeError, ValueError):  # written for arrays alone
        return None
    function = ca.Function("torque", arguments, [ca.SX(formula)])
    rng = np.random.default_rng(0)
    q, v = rng.uniform(-1.5, 1.5, (2, _SAMPLE_COUNT))
    direction, torque = (
        np.tanh(v / 0.02),
        constants.torque_max * rng.uniform(-1.0, 1.0, _SAMPLE_COUNT),
    )
    # What a formula does not know takes any values: terms that depend on it differ.
    other = np.cumsum(rng.uniform(0.5, 1.5, _SAMPLE_COUNT))
    along = _evaluate_term(each, constants, [q, v, direction, torque], other) * np.ones(
        _SAMPLE_COUNT
    )
    found = np.asarray(function.map(_SAMPLE_COUNT)(q, v, direction, torque))[0]
    size = float(np.abs(along).max())
    same = size > 0.0 and float(np.abs(along - found).max()) <= _FORMULA_TOLERANCE * size
    return function if same else None


def _evaluate_term(
    each: EstimatedEffect, constants: JointConstants, arguments: Sequence[Any], other: Quantity
) -> Quantity:
    """Return the torque of an effect on rigid links, of arrays or symbols; all else is `other`."""
    q, v, direction, torque = arguments
    signals = JointSignals.of_known(
        constants,
        0.0 * q + other,
        motor_position=q,
        motor_velocity=v,
        motor_direction=direction,
        link_position=q,
        link_velocity=v,
        transmitted_torque=torque,
        spring_torque=torque,
        windup=0.0 * q,
        drive_torque=torque,
    )
    term = each.effect.term(signals, [float(x) for x in each.amplitudes], each.shapes)
    return term.drive_torque + term.link_torque
