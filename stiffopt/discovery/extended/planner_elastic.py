"""What was found to yield in a joint, as elements of its drivetrain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.connection.connection import Connection
from stiffopt.connection.constant import Constant
from stiffopt.connection.reducer import Reducer
from stiffopt.discovery.catalogue.elastic import preload_loss_term
from stiffopt.discovery.comparison.extension import EstimatedEffect
from stiffopt.discovery.comparison.signals import JointConstants, JointSignals
from stiffopt.drivetrain.chain import Chain
from stiffopt.drivetrain.stage import Stage
from stiffopt.exact.chain import exact_windup, windup_shares

# Torques up to the rated one at which wind-ups are matched, as shares of it.
_SHARES = np.linspace(0.05, 1.0, 20)
# Slip torque that a loosened connection keeps, over the largest torque of the joint.
_HOLDS = 1.1
# Of a share of preload that is as good as none lost.
_WHOLE = 0.999
ADDED = "found_compliance"


@dataclass(frozen=True, kw_only=True, eq=False)
class Yielding:
    """A drivetrain with a finding in it.

    Parameters
    ----------
    chain : Chain
    sentence : str
        What was changed.
    """

    chain: Chain
    sentence: str


def yielding(
    chain: Chain | None, estimated: EstimatedEffect, constants: JointConstants
) -> Yielding | None:
    """Put an elastic finding into a drivetrain; None where it has no place there.

    Parameters
    ----------
    chain : Chain or None
        Of the planner's robot; None is rigid.
    estimated : EstimatedEffect
        One of `ELASTIC`.
    constants : JointConstants
        That the finding was fitted with.
    """
    own = Chain(()) if chain is None else chain
    return ELASTIC[estimated.located.effect.name](own, estimated, constants)


def _mean_windup(chain: Chain, torques: np.ndarray) -> float:
    return float(np.mean(exact_windup(chain, torques))) if chain.stages else 0.0


def _stiffness_linear(
    chain: Chain, estimated: EstimatedEffect, constants: JointConstants
) -> Yielding | None:
    """Scale the reducer so that the joint's mean wind-up changes by the factor."""
    factor = 1.0 / (1.0 + estimated.amplitudes[0])
    torques = _SHARES * constants.torque_rated
    whole = _mean_windup(chain, torques)
    if whole <= 0.0 or not np.isfinite(whole):
        return None
    for position, stage in enumerate(chain.stages):
        if isinstance(stage.element, Reducer | Constant):
            alone = _mean_windup(replace(chain, stages=(stage,)), torques)
            wanted = whole / factor - (whole - alone)
            if wanted <= 0.0:
                return None
            element = _scaled(stage.element, alone / wanted)
            return Yielding(
                chain=_with_element(chain, position, element),
                sentence=f"stiffness times {factor:.3g}, put into {element.name}"
                f" (its own times {alone / wanted:.3g}).",
            )
    return _softened(chain, whole / factor - whole, constants)


def _scaled(element: Reducer | Constant, factor: float) -> Connection:
    if isinstance(element, Constant):
        return replace(element, stiffness=element.stiffness * factor)
    return replace(
        element,
        K1=element.K1 * factor,
        K2=element.K2 * factor,
        K3=element.K3 * factor,
    )


def _k1_softening(
    chain: Chain, estimated: EstimatedEffect, constants: JointConstants
) -> Yielding | None:
    """Another first slope and corner of the reducer."""
    effect, shapes = estimated.located.effect, estimated.located.shapes
    values = effect.parameters(estimated.amplitudes, shapes, constants)
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
            return Yielding(
                chain=_with_element(chain, position, worn),
                sentence=f"first slope of {element.name} times {values['k1_factor']:.3g},"
                f" its corner times {values['t1_factor']:.3g}.",
            )
    return None


def _preload_loss(
    chain: Chain, estimated: EstimatedEffect, constants: JointConstants
) -> Yielding | None:
    """Loosen the weakest preloaded connection until the joint winds up as found."""
    torques = _SHARES * constants.torque_rated
    found = _found_windup(estimated, constants, torques)
    position = _weakest(chain, constants.torque_rated)
    if position is None:
        return _softened(chain, found, constants)
    stage = chain.stages[position]
    tight = stage.element.preload
    assert tight is not None
    before = _mean_windup(chain, torques)

    def loosened(share: float) -> Chain:
        return chain.with_preloads({stage.element.name: share * tight})

    def added(share: float) -> float:
        return _mean_windup(loosened(share), torques) - before

    holds = float(np.asarray(stage.element.slip_torque(tight))) * stage.reduction
    least = max(_HOLDS * constants.torque_max / holds, 1e-3)
    if least >= _WHOLE:
        return _softened(chain, found, constants)
    share = _share(added, found, least)
    changed, rest = loosened(share), found - added(share)
    sentence = (
        f"preload of {stage.element.name} {tight:.4g} to {share * tight:.4g} N"
        f" ({100.0 * share:.3g} %)."
    )
    if rest > 1e-2 * found:
        more = _softened(changed, rest, constants)
        changed = more.chain
        sentence += (
            f" That still holds the largest torque and explains"
            f" {100.0 * (1.0 - rest / found):.0f} % of the added wind-up; the rest: {more.sentence}"
        )
    return Yielding(chain=changed, sentence=sentence)


def _share(added: Callable[[float], float], wanted: float, least: float) -> float:
    """Share of the preload at which the added wind-up is as wanted, or the least allowed."""
    from scipy.optimize import brentq

    if added(least) <= wanted:
        return least
    # The looser, the more it winds up.
    return float(brentq(lambda share: added(share) - wanted, least, 1.0, xtol=1e-6))


def _weakest(chain: Chain, torque: float) -> int | None:
    """Preloaded connection with the largest share of the wind-up, bolts before all others."""
    candidates = [i for i, s in enumerate(chain.stages) if s.element.preload is not None]
    bolted = [i for i in candidates if chain.stages[i].element.kind == "bolted_flange"]
    candidates = bolted or candidates
    if not candidates:
        return None
    shares = windup_shares(chain, torque)
    return max(candidates, key=lambda i: shares[chain.stages[i].element.name])


def _found_windup(
    estimated: EstimatedEffect, constants: JointConstants, torques: np.ndarray
) -> float:
    """Mean of the wind-up that a loss of preload adds [rad]."""
    zero = np.zeros_like(torques)
    still = dict.fromkeys(
        (
            "session_time",
            "temperature_rise",
            "motor_position",
            "motor_velocity",
            "motor_acceleration",
            "link_position",
            "link_velocity",
            "link_acceleration",
            "drive_torque_rate",
            "previous_position",
        ),
        zero,
    )
    signals = JointSignals(
        time=np.arange(len(torques), dtype=float),
        dt=1.0,
        spring_torque=torques,
        windup=constants.windup(torques),
        drive_torque=torques,
        constants=constants,
        **still,
    )
    term = preload_loss_term(signals, estimated.amplitudes, estimated.located.shapes)
    return float(np.mean(np.asarray(term.deflection)))


def _belt_creep(
    chain: Chain, estimated: EstimatedEffect, constants: JointConstants
) -> Yielding | None:
    """A spring in series as soft as the belt is once it has settled."""
    compliance = float(sum(estimated.amplitudes))
    if compliance <= 0.0:
        return None
    mean = compliance * float(np.mean(_SHARES)) * constants.torque_rated
    changed = _softened(chain, mean, constants)
    return replace(
        changed, sentence=f"{changed.sentence[:-1]}, a belt that has settled under its load."
    )


def _softened(chain: Chain, added: float, constants: JointConstants) -> Yielding:
    """A spring in series that adds a mean wind-up [rad]."""
    stiffness = float(np.mean(_SHARES)) * constants.torque_rated / added
    names = chain.elements
    name = next(
        n for k in range(len(names) + 1) if (n := ADDED + (f"_{k + 1}" if k else "")) not in names
    )
    element = Constant(name=name, torque_max=constants.torque_max, stiffness=stiffness)
    return Yielding(
        chain=replace(chain, stages=(*chain.stages, Stage(element))),
        sentence=f"a spring of {stiffness:.4g} N m/rad in series.",
    )


def _with_element(chain: Chain, position: int, element: Connection) -> Chain:
    stages = list(chain.stages)
    stages[position] = replace(stages[position], element=element)
    return replace(chain, stages=tuple(stages))


# By name of the effect; (chain, finding, constants) -> Yielding or None.
ELASTIC: dict[str, Callable[[Chain, EstimatedEffect, JointConstants], Yielding | None]] = {
    "stiffness_linear": _stiffness_linear,
    "k1_softening": _k1_softening,
    "preload_loss": _preload_loss,
    "belt_creep": _belt_creep,
}
