"""Friction that is another one from run to run: a random effect by run, its mean and its spread.

The housing of yesterday, the grease that has settled, a night of rest: no signal of a recording
tells. Every run has a level of its own, drawn about a mean that all share; what a further run has
is the mean, give or take the spread. As mixed models have it (Laird and Ware 1982), the levels of
runs count as drawn, not as parameters of the robot.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from stiffopt.discovery.catalogue.common import dry_friction, viscous_friction
from stiffopt.discovery.comparison.signals import JointConstants, JointSignals, smooth_sign
from stiffopt.discovery.effect import Amplitude, Effect, Shape, Term
from stiffopt.symbolic import Quantity

# Before a name of a run, in the names of amplitudes.
OF_RUN = "of "
# Share of friction that differs from run to run, typically.
_TYPICAL = 0.2


def _term(
    seen: Sequence[str],
    signals: JointSignals,
    amplitudes: Sequence[Quantity],
    shapes: Sequence[Quantity],
) -> Term:
    """Friction by the level of a run that was seen, by the mean of all in any other."""
    if signals.run in seen:
        level = amplitudes[0] + amplitudes[1 + seen.index(signals.run)]
    else:
        level = _mean(amplitudes)
    constants, w, viscous = signals.constants, signals.motor_velocity, shapes[0]
    dry = (1.0 - viscous) * dry_friction(constants) * smooth_sign(w)
    return Term(drive_torque=level * (dry + viscous * viscous_friction(constants) * w))


def _mean(amplitudes: Sequence[Any]) -> Any:
    """Mean level of the runs that were seen."""
    level, *own = amplitudes
    return level + sum(own) / len(own) if own else level


def _sizes(shapes: Sequence[float], constants: JointConstants) -> tuple[float, float]:
    """Dry and viscous friction of a unit level [N m], [N m s/rad]."""
    return (
        (1.0 - shapes[0]) * dry_friction(constants),
        shapes[0] * viscous_friction(constants),
    )


def _report(
    amplitudes: Sequence[float], shapes: Sequence[float], constants: JointConstants
) -> Mapping[str, float]:
    own = np.array(amplitudes[1:])
    mean = float(_mean(amplitudes))
    spread = float(own.std(ddof=1)) if own.size > 1 else 0.0
    dry, viscous = _sizes(shapes, constants)
    return {
        "dFc": mean * dry,
        "dFc_spread": spread * dry,
        "dFv": mean * viscous,
        "dFv_spread": spread * viscous,
    }


def _drawn(
    amplitudes: Sequence[float], shapes: Sequence[float], constants: JointConstants
) -> Mapping[str, float]:
    """What the mean and the spread of so few runs may be off by from those of all [N m], ..."""
    count = max(len(amplitudes) - 1, 2)
    found = _report(amplitudes, shapes, constants)
    return {
        name: found[f"{name.removesuffix('_spread')}_spread"]
        / np.sqrt(2.0 * (count - 1) if name.endswith("_spread") else count)
        for name in found
    }


def friction_drift(runs: Sequence[str], *, seen: bool = True) -> Effect:
    """The effect with a level for each of some runs.

    Parameters
    ----------
    runs : sequence of str
    seen : bool
        Whether runs of these names are those that the levels are of.
    """
    return Effect(
        name="friction_drift",
        family="friction",
        scope="joint",
        equation="tau += (m + a_run)*(share of Fc*sg(w) + share of Fv*w), a_run ~ N(0, spread^2)",
        signature="motor torque off against the motion by a level that is another one in every"
        " run, whatever the motion and the temperature",
        title="friction drift between runs",
        phrase="friction that differs from run to run",
        needs=("torque", "moves", "reverses", "three_runs"),
        confused_with=("thermal_friction",),
        reference="LairdWare1982",
        term=partial(_term, tuple(runs) if seen else ()),
        amplitudes=(
            Amplitude(name="mean", unit="", scale=1.0, lower=-1.0, upper=5.0),
            *(
                Amplitude(name=f"{OF_RUN}{run}", unit="", scale=_TYPICAL, lower=-5.0, upper=25.0)
                for run in runs
            ),
        ),
        shapes=(Shape(name="viscous", unit="", starts=(0.0, 0.5, 1.0), lower=0.0, upper=1.0),),
        report=_report,
        drawn=_drawn,
        units={
            "dFc": "N m",
            "dFc_spread": "N m",
            "dFv": "N m s/rad",
            "dFv_spread": "N m s/rad",
        },
        of_runs=friction_drift,
        separate="Repeat one motion on several days, and several times on one: what differs"
        " between days alone is drift, what goes with the housing's warmth is oil.",
    )


FRICTION_DRIFT = friction_drift(())
