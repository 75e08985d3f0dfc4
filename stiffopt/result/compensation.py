"""What comes of a motion when its motors lead the links, on the arm as it is and as it may be."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stiffopt.files import write_csv
from stiffopt.result.assessment import Violation
from stiffopt.result.simulation import SimulatedMotion

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


COMMAND_FILE = "command.csv"


def write_command(compensation: Compensation | None, directory: str | Path) -> Path | None:
    """Write command.csv into `directory`; return its path.

    Position, velocity and acceleration of the motors every 2 ms, the drive torque that the links'
    motion then needs, and the links' positions. Where there is no command, one of an earlier solve
    is removed: it is not of this motion.
    """
    path = Path(directory) / COMMAND_FILE
    if compensation is None or compensation.command is None:
        path.unlink(missing_ok=True)
        return None
    command = compensation.command
    joints = range(1, command.position.shape[1] + 1)
    names = ["t", *(f"{quantity}{j}" for quantity in ("q", "qd", "qdd", "tau") for j in joints)]
    columns = [
        command.time[:, None],
        command.position,
        command.velocity,
        command.acceleration,
        command.torque,
    ]
    if command.link is not None:
        columns.append(command.link)
        names += [f"link{j}" for j in joints]
    write_csv(path, names, np.hstack(columns).tolist())
    return path


def compensation_document(compensation: Compensation | None) -> dict[str, Any] | None:
    """Content of `compensation` in result.json; lengths in m."""
    if compensation is None:
        return None
    return {
        "command": COMMAND_FILE if compensation.command is not None else None,
        "refusal": compensation.refusal,
        "uncertainty": compensation.uncertainty,
        "motions": {motion.name: _motion_document(motion) for motion in compensation.motions},
    }


def _motion_document(motion: CompensatedMotion) -> dict[str, Any]:
    return {
        "within_motor_limits": not motion.excess,
        "excess": [dict(vars(each)) for each in motion.excess],
        "knot_spacing": motion.spacing,
        "share_of_windup": motion.share,
        "as_planned": _spreads_document(motion.planned),
        "compensated": _spreads_document(motion.compensated),
        "simulated": _simulated_document(motion.simulated),
        "simulated_worst": None if motion.worst is None else _simulated_document(motion.worst),
    }


def _simulated_document(simulated: SimulatedMotion) -> dict[str, Any]:
    return {
        "in_flight": {"peak": simulated.peak, "rms": simulated.rms},
        "after_arrival": {"peak": simulated.peak_after, "rms": simulated.rms_after},
        "notes": simulated.notes,
    }


def _spreads_document(spreads: Spreads) -> dict[str, Any]:
    return {
        "in_flight": _spread_document(spreads.flight),
        "after_arrival": _spread_document(spreads.after),
    }


def _spread_document(spread: Spread) -> dict[str, Any]:
    return {
        "nominal": spread.nominal,
        "worst": spread.worst,
        "worst_case": spread.worst_case,
        "worst_arm": spread.worst_arm,
        "draws": spread.draws,
    }
