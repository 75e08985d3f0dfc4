"""Creep of a belt under load: the standard linear solid in series with the joint."""

from __future__ import annotations

import numpy as np

from stiffopt.discovery.catalogue.common import first_order_lag, winds_up, working_compliance
from stiffopt.discovery.catalogue.robot_change import (
    TORQUE_SHARES,
    chain_of,
    with_chain,
    with_series_spring,
)
from stiffopt.discovery.effect import (
    Amplitude,
    Effect,
    FittedEffect,
    RobotChange,
    Shape,
    Term,
    Values,
)
from stiffopt.discovery.signals import JointConstants, JointSignals
from stiffopt.robot.robot import Robot


def belt_creep_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return the wind-up C_now s + C_creep y, dy/dt = (s - y)/tau_r."""
    s = signals.spring_torque
    # A belt has settled under the load at the begin of the run.
    slow = first_order_lag(s, np.exp(-signals.dt / shapes[0]))
    return Term(deflection=amplitudes[0] * s + amplitudes[1] * slow)


def put_belt_in_series(
    robot: Robot, found: FittedEffect, joint: int, constants: JointConstants
) -> RobotChange | None:
    """Return the robot with a spring in series as soft as the settled belt."""
    compliance = float(sum(found.amplitudes))
    if compliance <= 0.0:
        return None
    mean = compliance * float(np.mean(TORQUE_SHARES)) * constants.torque_rated
    chain, sentence = with_series_spring(chain_of(robot, joint), mean, constants)
    return with_chain(robot, joint, chain, f"{sentence[:-1]}, a belt that has settled under load.")


BELT_CREEP = Effect(
    name="belt_creep",
    family="elastic",
    scope="joint",
    equation="d += C_now*s + C_creep*y, dy/dt = (s - y)/tau_r",
    signature="added wind-up that lags the load by a fixed time",
    phrase="a belt that creeps, {C} within {tau_r}",
    remedy="Check tension and age of the belt of {where}.",
    needs=("windup", "moves"),
    change_robot=put_belt_in_series,
    term=belt_creep_term,
    amplitudes=(
        Amplitude("C_now", "rad/(N m)", working_compliance, 0.0, 2.0),
        Amplitude("C_creep", "rad/(N m)", working_compliance, 0.0, 2.0),
    ),
    shapes=(Shape("tau_r", "s", (0.03, 0.1, 0.3, 1.0), 0.01, 5.0),),
    report=lambda a, s, constants: {"C": a[0] + a[1], "tau_r": s[0]},
    units={"C": "rad/(N m)"},
    applies=lambda constants: winds_up(constants) and constants.belt is not False,
    lags=True,
    separate="Run one path fast and slowly: creep shows in the difference, a plain change of"
    " stiffness and hysteresis do not.",
)
