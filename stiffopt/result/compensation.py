"""Compensated motions on nominal and uncertain arms, and their files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stiffopt.files import write_csv
from stiffopt.result.assessment import Violation
from stiffopt.result.simulation import SimulatedMotion, simulated_document

if TYPE_CHECKING:
    from stiffopt.result.assessment import Assessment


@dataclass(frozen=True, kw_only=True)
class PartPeaks:
    """Peaks of one part of the tool error: on the nominal arm, and the worst over all arms."""

    nominal: float
    worst: float


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Peaks of the tool's position error over uncertain arms, in flight or after arrival [m]."""

    nominal: float  # peak on the nominal arm
    worst: float  # worst case
    worst_case: str  # description of the worst arm
    # Worst arm as factors on nominal values: stiffness (a list), damping, payload; and servo, the
    # share of the worst servo's lag.
    worst_arm: dict[str, Any]
    draws: np.ndarray  # (D,) peaks on arms sampled from the uncertainties
    parts: dict[str, PartPeaks]  # "along" and "across" the path [m], and "orientation" [rad]

    def quantile(self, share: float) -> float:
        """Quantile of the sampled peaks."""
        return float(np.quantile(self.draws, share))

    @property
    def bound(self) -> float:
        """Bound of 95 % of the arms, with 99 % confidence: an order statistic (Wilks 1941) [m]."""
        # Of scipy.special: loading scipy.stats takes longer than many a solve.
        from scipy.special import bdtr

        count = len(self.draws)
        rank = int(np.searchsorted(bdtr(np.arange(count), count, 0.95), 0.99))
        return float(np.sort(self.draws)[min(rank, len(self.draws) - 1)])


@dataclass(frozen=True, kw_only=True)
class Spreads:
    """Peaks in flight and after arrival."""

    flight: Spread
    after: Spread

    @property
    def worst_case(self) -> float:
        """Sum of the worst peaks in flight and after arrival [m]."""
        return self.flight.worst + self.after.worst


@dataclass(frozen=True, kw_only=True)
class CompensatedMotion:
    """Motion as planned and with compensation, the motors leading by the wind-up."""

    name: str  # "optimised" or the name of a baseline
    planned: Spreads  # peaks with motors that follow the plan
    compensated: Spreads  # peaks with motors that follow the compensating command
    simulated: SimulatedMotion  # elastic simulation of the compensated motion on the nominal arm
    worst: SimulatedMotion | None  # the same on the worst arm, for the optimised motion
    # Knot spacing of the spline through the plan [s]; None for plans that are smooth enough.
    spacing: float | None
    share: float  # lead as a share of the nominal wind-up, chosen for the worst case
    # Motor limits that the command exceeds; such a motion is not compared.
    excess: tuple[Violation, ...]
    servo_share: float = 1.0  # lead as a share of the servo's known lag


@dataclass(frozen=True, kw_only=True)
class Compensation:
    """Compensation of the optimised motion and the baselines, with the command."""

    motions: tuple[CompensatedMotion, ...]  # the optimised motion first
    command: Assessment | None  # motor motion every 2 ms; None where it exceeds a limit
    refusal: str  # reason for a missing command; else ""
    uncertainty: tuple[str, ...]  # description of the uncertain quantities
    draws: int
    loop: str = ""  # description of the position loops of all arms; "" where servos are uncertain
    file: str = ""  # file of the assessed command; "" for one computed with the motion
    # Known dead time of the servo, by which the command is sent ahead of the plan [s].
    ahead: float = 0.0
    # Motion and command of the best rival, where it wins.
    rival_plan: Assessment | None = None
    rival_command: Assessment | None = None

    @property
    def optimised(self) -> CompensatedMotion:
        """Optimised motion."""
        return self.motions[0]

    @property
    def best_rival(self) -> CompensatedMotion | None:
        """Rival with the least worst-case error whose command keeps every limit."""
        kept = [each for each in self.motions[1:] if not each.excess]
        return min(kept, key=lambda each: each.compensated.worst_case, default=None)

    @property
    def rival_wins(self) -> bool:
        """True where the best rival has less worst-case error, or the only command."""
        best, own = self.best_rival, self.optimised
        if best is None:
            return False
        needed = (1.0 - MIN_RIVAL_GAIN) * own.compensated.worst_case
        return bool(own.excess) or best.compensated.worst_case < needed

    @property
    def ratios(self) -> tuple[float, float] | None:
        """Worst-case errors over those of the best rival, in flight and after arrival.

        None where one is missing or an error of the rival is zero.
        """
        best, own = self.best_rival, self.optimised
        if best is None or own.excess:
            return None
        mine, theirs = own.compensated, best.compensated
        if not (theirs.flight.worst > 0.0 and theirs.after.worst > 0.0):
            return None
        return mine.flight.worst / theirs.flight.worst, mine.after.worst / theirs.after.worst


COMMAND_FILE = "command.csv"
# Motion and command of the best rival, where it wins.
RIVAL_TRAJECTORY_FILE, RIVAL_COMMAND_FILE = "rival_trajectory.csv", "rival_command.csv"
# Relative gain from which a rival wins: smaller ones are within the model's agreement.
MIN_RIVAL_GAIN = 0.02


def write_command(compensation: Compensation | None, directory: str | Path) -> Path | None:
    """Write command.csv into `directory` and return its path.

    Without a command, the file of an earlier solve is removed, as it belongs to another motion.
    """
    command = None if compensation is None else compensation.command
    return write_motors(command, Path(directory) / COMMAND_FILE)


def write_motors(command: Assessment | None, path: Path) -> Path | None:
    """Write a command of the motors and return its path; without one the file is removed.

    Columns are position, velocity and acceleration of the motors every 2 ms, the drive torque of
    the links' motion, and the link positions.
    """
    if command is None:
        path.unlink(missing_ok=True)
        return None
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
        "command_ahead": compensation.ahead,
        "uncertainty": compensation.uncertainty,
        **_rival_document(compensation),
        "motions": {motion.name: _motion_document(motion) for motion in compensation.motions},
    }


def _rival_document(compensation: Compensation) -> dict[str, Any]:
    best, ratios = compensation.best_rival, compensation.ratios
    handed = compensation.rival_command is not None
    return {
        "best_rival": None if best is None else best.name,
        "rival_wins": compensation.rival_wins,
        "ratio_to_best_rival": (
            None if ratios is None else {"in_flight": ratios[0], "after_arrival": ratios[1]}
        ),
        "rival_trajectory": RIVAL_TRAJECTORY_FILE if handed else None,
        "rival_command": RIVAL_COMMAND_FILE if handed else None,
    }


def _motion_document(motion: CompensatedMotion) -> dict[str, Any]:
    return {
        "duration": motion.simulated.duration,
        "within_motor_limits": not motion.excess,
        "excess": [dict(vars(each)) for each in motion.excess],
        "knot_spacing": motion.spacing,
        "share_of_windup": motion.share,
        "as_planned": _spreads_document(motion.planned),
        "compensated": _spreads_document(motion.compensated),
        "simulated": simulated_document(motion.simulated),
        "simulated_worst": None if motion.worst is None else simulated_document(motion.worst),
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
        "bound_95": spread.bound,
        "worst_case": spread.worst_case,
        "worst_arm": spread.worst_arm,
        "parts": {name: dict(vars(part)) for name, part in spread.parts.items()},
        "draws": spread.draws,
    }
