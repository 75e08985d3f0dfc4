"""Stiffness and damping other than nominal, and creep: of a joint, its reducer or its belt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stiffopt.connection.connection import Connection
from stiffopt.connection.constant import Constant
from stiffopt.connection.reducer import Reducer
from stiffopt.discovery.catalogue.common import (
    WEIGHT,
    Constants,
    first_order_lag,
    winds_up,
    working_compliance,
)
from stiffopt.discovery.catalogue.robot_change import (
    TORQUE_SHARES,
    chain_of,
    mean_windup,
    with_chain,
    with_element,
    with_series_spring,
)
from stiffopt.discovery.effect import (
    Amplitude,
    Effect,
    FittedEffect,
    Reported,
    RobotChange,
    Shape,
    Term,
    Values,
)
from stiffopt.discovery.signals import JointConstants, JointSignals
from stiffopt.exact.connection import reducer_windup
from stiffopt.robot.robot import Robot


def scale_stiffness(
    robot: Robot, found: FittedEffect, joint: int, constants: JointConstants
) -> RobotChange | None:
    """Scale the reducer so that the joint's mean wind-up changes by the factor."""
    chain = chain_of(robot, joint)
    factor = 1.0 / (1.0 + found.amplitudes[0])
    torques = TORQUE_SHARES * constants.torque_rated
    whole = mean_windup(chain, torques)
    if whole <= 0.0 or not np.isfinite(whole):
        return None
    for position, stage in enumerate(chain.stages):
        if isinstance(stage.element, Reducer | Constant):
            alone = mean_windup(replace(chain, stages=(stage,)), torques)
            wanted = whole / factor - (whole - alone)
            if wanted <= 0.0:
                return None
            element = _scale_element(stage.element, alone / wanted)
            return with_chain(
                robot,
                joint,
                with_element(chain, position, element),
                f"stiffness times {factor:.3g}, put into {element.name}"
                f" (its own times {alone / wanted:.3g}).",
            )
    return with_chain(robot, joint, *with_series_spring(chain, whole / factor - whole, constants))


def _scale_element(element: Reducer | Constant, factor: float) -> Connection:
    if isinstance(element, Constant):
        return replace(element, stiffness=element.stiffness * factor)
    return replace(element, K1=element.K1 * factor, K2=element.K2 * factor, K3=element.K3 * factor)


def k1_softening_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return the wind-up of a reducer with another first slope and corner, less the nominal one."""
    constants, s = signals.constants, signals.spring_torque
    if constants.slopes is None or constants.corners is None:
        return Term(deflection=0.0 * s)
    (k1, k2, k3), (t1, t2) = constants.slopes, constants.corners
    k1_factor, t1_factor = shapes
    first = t1 * t1_factor
    # The second corner moves only when the first passes it.
    worn = reducer_windup(s, (k1 * k1_factor, k2, k3), (first, np.fmax(t2, first)))
    added = worn - reducer_windup(s, constants.slopes, constants.corners)
    return Term(deflection=amplitudes[0] * added)


def _report_corners(amplitudes: Values, shapes: Values, constants: Constants) -> Reported:
    # The slope at zero torque is exact, also where the weight is not 1.
    softer = 1.0 + amplitudes[0] * (1.0 / shapes[0] - 1.0)
    return {"k1_factor": 1.0 / softer, "t1_factor": shapes[1]}


def wear_reducer(
    robot: Robot, found: FittedEffect, joint: int, constants: JointConstants
) -> RobotChange | None:
    """Change the first slope and corner of the reducer."""
    values = _report_corners(found.amplitudes, found.shapes, constants)
    chain = chain_of(robot, joint)
    for position, stage in enumerate(chain.stages):
        element = stage.element
        if isinstance(element, Reducer):
            first = element.T1 * values["t1_factor"]
            worn = replace(
                element,
                K1=element.K1 * values["k1_factor"],
                T1=first,
                T2=max(element.T2, first * (1.0 + 1e-6)),
            )
            return with_chain(
                robot,
                joint,
                with_element(chain, position, worn),
                f"first slope of {element.name} times {values['k1_factor']:.3g},"
                f" its corner times {values['t1_factor']:.3g}.",
            )
    return None


STIFFNESS_LINEAR = Effect(
    name="stiffness_linear",
    family="elastic",
    scope="joint",
    equation="d += (1/factor - 1)*D(s)",
    signature="wind-up off in proportion to the nominal one",
    title="stiffness",
    phrase=(
        "softer than the model, by a factor of {factor}",
        "stiffer than the model, by a factor of {factor}",
    ),
    remedy="Multiply the stiffness of {where} by {factor}, and check what was mounted there"
    " against the data sheet.",
    needs=("windup", "moves"),
    confused_with=("belt_creep", "preload_loss"),
    change_robot=scale_stiffness,
    term=lambda signals, a, s: Term(deflection=a[0] * signals.windup),
    amplitudes=(Amplitude("x", "", 0.3, -2.2, 7.8),),
    report=lambda a, s, constants: {"factor": 1.0 / (1.0 + a[0])},
    units={"factor": ""},
    applies=winds_up,
    separate="Use the whole range of torque on both sides, slowly and fast: an added belt is not"
    " proportional where the reducer's slope changes, and lags.",
)

K1_SOFTENING = Effect(
    name="k1_softening",
    family="elastic",
    scope="joint",
    equation="d += D(s; k1_factor*K1, t1_factor*T1) - D(s)",
    signature="wind-up off around zero torque that stops growing beyond the reducer's first corner",
    title="K1 softening",
    phrase="lost stiffness near zero torque, factor {k1_factor}",
    remedy="Check the gear of {where} for wear, and multiply its K1 by {k1_factor}.",
    needs=("windup", "moves", "load_changes_sign"),
    confused_with=("preload_loss",),
    reference="HarmonicDriveCSF",
    change_robot=wear_reducer,
    term=k1_softening_term,
    amplitudes=(WEIGHT,),
    shapes=(
        Shape("k1_factor", "", (0.2, 0.35, 0.55, 0.8), 0.15, 1.2),
        Shape("t1_factor", "", (0.7, 1.0, 1.6), 0.5, 3.0),
    ),
    report=_report_corners,
    applies=lambda constants: (
        constants.slopes is not None
        and constants.corners is not None
        and constants.slopes[0] != constants.slopes[2]
    ),
    separate="Reach torques well beyond the first corner: a worn reducer stops getting softer"
    " there, loosened contacts keep growing, backlash has no width in torque.",
)


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


def joint_damping_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return wind-up -dD (w - v) D'(s): the damper takes part of the torque from the spring."""
    rate = signals.motor_velocity - signals.link_velocity
    slope = signals.constants.compliance(signals.spring_torque)
    return Term(deflection=-amplitudes[0] * rate * slope)


def change_damping(
    robot: Robot, found: FittedEffect, joint: int, constants: JointConstants
) -> RobotChange:
    """Return the robot with the estimated damping."""
    damping = np.full(robot.n, np.nan) if robot.damping is None else robot.damping.copy()
    before = constants.joint_damping
    damping[joint] = max(before + found.amplitudes[0], 0.0)
    return RobotChange(
        replace(robot, damping=damping),
        f"Joint {joint + 1}: damping {before:.4g} to {damping[joint]:.4g} N m s/rad.",
    )


JOINT_DAMPING = Effect(
    name="joint_damping",
    family="elastic",
    scope="joint",
    equation="d += -dD*(w - v)*D'(s)",
    signature="vibration after sharp motion that decays faster or slower than nominal, at the"
    " frequency that the model has",
    title="joint damping",
    nominal="joint_damping",
    phrase=("{dD} more joint damping than the model", "{dD} less joint damping than the model"),
    remedy="Enter joint damping {new} for {where}.",
    needs=("windup", "moves"),
    confused_with=("hysteresis",),
    change_robot=change_damping,
    term=joint_damping_term,
    amplitudes=(
        Amplitude("dD", "N m s/rad", lambda constants: constants.joint_damping, -1.0, 20.0),
    ),
    # Without a damping value links are modelled quasi-static.
    applies=lambda constants: constants.elastic and constants.joint_damping > 0.0,
    separate="Stop sharply and stand still for a second, with and without load: damping takes the"
    " same share of every period, hysteresis most of small ones, a soft joint vibrates slower.",
)
