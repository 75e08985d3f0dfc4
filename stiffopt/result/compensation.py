"""What comes of a motion when its motors lead the links, on the arm as it is and as it may be."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from stiffopt.result.assessment import Violation

if TYPE_CHECKING:
    from stiffopt.result.assessment import Assessment
    from stiffopt.result.simulation import SimulatedMotion


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Peaks of the tool's deviation on many arms, in flight or after arrival [m].

    Parameters
    ----------
    nominal : float
        On the arm as it is modelled.
    worst : float
        The largest of all.
    worst_case : str
        Which arm that is, in words.
    worst_arm : dict
        The same as factors on nominal values: stiffness (a list), damping, payload; and servo, how
        much of the worst servo's lag.
    draws : array (D,)
        On arms drawn from within the uncertainties.
    """

    nominal: float
    worst: float
    worst_case: str
    worst_arm: dict[str, Any]
    draws: np.ndarray

    def quantile(self, share: float) -> float:
        """Peak that this share of the draws does not exceed."""
        return float(np.quantile(self.draws, share))


@dataclass(frozen=True, kw_only=True)
class Spreads:
    """The same in flight and after arrival."""

    flight: Spread
    after: Spread


@dataclass(frozen=True, kw_only=True)
class CompensatedMotion:
    """A motion as planned, and with motors that lead its links by the wind-up.

    Parameters
    ----------
    name : str
        "optimised" or that of a baseline.
    planned : Spreads
        The motors follow the plan.
    compensated : Spreads
        The motors follow the command that makes the links do it.
    simulated : SimulatedMotion
        The compensated motion on the nominal arm, by the full simulation.
    worst : SimulatedMotion or None
        The same on the worst arm; of the optimised motion.
    spacing : float or None
        Of the knots of the spline through the plan [s]; None where it was smooth enough.
    share : float
        How much of the nominal wind-up the motors lead by, chosen for the worst case.
    excess : tuple of Violation
        Motor limits that the command exceeds; not counted then.
    """

    name: str
    planned: Spreads
    compensated: Spreads
    simulated: SimulatedMotion
    worst: SimulatedMotion | None
    spacing: float | None
    share: float
    excess: tuple[Violation, ...]


@dataclass(frozen=True, kw_only=True)
class Compensation:
    """The command of the optimised motion, and what compensation gives of it and the baselines.

    Parameters
    ----------
    motions : tuple of CompensatedMotion
        The optimised one first.
    command : Assessment or None
        Motion of the motors every 2 ms; None where it exceeds a limit.
    refusal : str
        Why there is none; "" where there is.
    uncertainty : tuple of str
        What was taken as uncertain, in words.
    draws : int
    loop : str
        Of the position loops that all arms have, in words; "" where servos are uncertain.
    file : str
        Where the command lies that was judged; "" where it was made with the motion.
    """

    motions: tuple[CompensatedMotion, ...]
    command: Assessment | None
    refusal: str
    uncertainty: tuple[str, ...]
    draws: int
    loop: str = ""
    file: str = ""

    @property
    def optimised(self) -> CompensatedMotion:
        """The optimised motion."""
        return self.motions[0]
