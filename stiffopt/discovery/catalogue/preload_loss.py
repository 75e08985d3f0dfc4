"""Lost preload of a connection: contact stiffness that grows with a power of pressure."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stiffopt.discovery.catalogue.common import (
    Constants,
    carried_share,
    contact_compliance,
    shares_of_carried,
    winds_up,
)
from stiffopt.discovery.catalogue.robot_change import (
    TORQUE_SHARES,
    chain_of,
    mean_windup,
    with_chain,
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
from stiffopt.drivetrain.chain import Chain
from stiffopt.exact.chain import windup_shares
from stiffopt.robot.robot import Robot

# Smallest slip torque of a loosened connection over the largest torque of the joint.
_SLIP_MARGIN = 1.1
# Share of the preload above which a connection counts as intact.
_MIN_INTACT_SHARE = 0.999
# Smallest torque, over the rated one, whose contact pressure equals the remaining preload.
_MIN_PRESSURE_RATIO = 5e-4


def preload_loss_term(signals: JointSignals, amplitudes: Values, shapes: Values) -> Term:
    """Return the wind-up c ((|s| + tp)^b - tp^b) sgn(s) of contacts that load presses together."""
    constants, s = signals.constants, signals.spring_torque
    rated = constants.torque_rated
    left, power = shapes
    pressed = (np.abs(s) / rated + left) ** power - left**power
    size = rated * contact_compliance(constants)
    return Term(deflection=amplitudes[0] * size * np.sign(s) * pressed)


def _report_pressure_and_windup(
    amplitudes: Values, shapes: Values, constants: Constants
) -> Reported:
    """Return the torque that presses as the preload left does, and the wind-up added at rated load.

    Recordings that hardly turn the torque around tell the wind-up, not the pressure.
    """
    assert isinstance(constants, JointConstants)
    left, power = shapes
    size = constants.torque_rated * contact_compliance(constants)
    pressed = (1.0 + left) ** power - left**power
    return {"tp": left * constants.torque_rated, "windup": amplitudes[0] * size * pressed}


def lose_preload(
    robot: Robot, found: FittedEffect, joint: int, constants: JointConstants
) -> RobotChange:
    """Loosen the weakest preloaded connection until the joint winds up as estimated."""
    chain, torques = chain_of(robot, joint), TORQUE_SHARES * constants.torque_rated
    wanted = _added_windup(found, constants, torques)
    position = _find_weakest_connection(chain, constants.torque_rated)
    if position is None:
        return with_chain(robot, joint, *with_series_spring(chain, wanted, constants))
    stage = chain.stages[position]
    tight = stage.element.preload
    assert tight is not None
    before = mean_windup(chain, torques)

    def loosened(share: float) -> Chain:
        return chain.with_preloads({stage.element.name: share * tight})

    def added(share: float) -> float:
        return mean_windup(loosened(share), torques) - before

    holds = float(np.asarray(stage.element.slip_torque(tight))) * stage.reduction
    least = max(_SLIP_MARGIN * constants.torque_max / holds, 1e-3)
    if least >= _MIN_INTACT_SHARE:
        return with_chain(robot, joint, *with_series_spring(chain, wanted, constants))
    share = _solve_preload_share(added, wanted, least)
    changed, rest = loosened(share), wanted - added(share)
    sentence = (
        f"preload of {stage.element.name} {tight:.4g} to {share * tight:.4g} N"
        f" ({100.0 * share:.3g} %)."
    )
    if rest > 1e-2 * wanted:
        changed, spring = with_series_spring(changed, rest, constants)
        sentence += (
            f" This is the least preload that carries the largest torque; it explains"
            f" {100.0 * (1.0 - rest / wanted):.0f} % of the added wind-up. The rest: {spring}"
        )
    return with_chain(robot, joint, changed, sentence)


def _solve_preload_share(added: Callable[[float], float], wanted: float, least: float) -> float:
    """Return the share of preload with the wanted added wind-up, or the least allowed."""
    from scipy.optimize import brentq

    if added(least) <= wanted:
        return least
    # The added wind-up decreases monotonically with preload.
    return float(brentq(lambda share: added(share) - wanted, least, 1.0, xtol=1e-6))


def _find_weakest_connection(chain: Chain, torque: float) -> int | None:
    """Return the preloaded connection with the largest share of wind-up, bolted ones first."""
    candidates = [i for i, s in enumerate(chain.stages) if s.element.preload is not None]
    bolted = [i for i in candidates if chain.stages[i].element.kind == "bolted_flange"]
    candidates = bolted or candidates
    if not candidates:
        return None
    shares = windup_shares(chain, torque)
    return max(candidates, key=lambda i: shares[chain.stages[i].element.name])


def _added_windup(found: FittedEffect, constants: JointConstants, torques: np.ndarray) -> float:
    """Return the mean wind-up that a loss of preload adds [rad]."""
    signals = JointSignals.of_known(constants, 0.0 * torques, spring_torque=torques)
    term = preload_loss_term(signals, found.amplitudes, found.shapes)
    return float(np.mean(np.asarray(term.deflection)))


PRELOAD_LOSS = Effect(
    name="preload_loss",
    family="elastic",
    scope="joint",
    equation="d += c*((abs(s) + tp)^b - tp^b)*sgn(s)",
    signature="wind-up off that is steep around zero torque and keeps growing, ever more slowly",
    phrase="a connection that lost preload",
    remedy="Check bolts and pins of {where}, and tighten them to their torque.",
    needs=("windup", "moves"),
    confused_with=("belt_creep",),
    change_robot=lose_preload,
    term=preload_loss_term,
    amplitudes=(Amplitude("c", "", 1.0, 0.0, 20.0),),
    shapes=(
        Shape("left", "", shares_of_carried(0.005, 0.05, 0.5), 1e-7, 10.0),
        Shape("power", "", (0.35, 0.65), 0.3, 0.9),
    ),
    report=_report_pressure_and_windup,
    units={"tp": "N m", "windup": "rad"},
    applies=winds_up,
    possible=lambda shapes, constants: shapes[0] >= _MIN_PRESSURE_RATIO * carried_share(constants),
    separate="Climb to the rated torque on both sides in steps: loosened contacts stiffen all the"
    " way, a worn reducer only up to its corner.",
)
