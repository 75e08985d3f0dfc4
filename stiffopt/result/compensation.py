"""Compensated motions on nominal and uncertain arms, and their files."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.files import pick
from stiffopt.result.assessment import Assessment, Violation
from stiffopt.result.motion_table import write_motion_table
from stiffopt.result.simulation import SimulatedMotion, simulated_document


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

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return self.simulated.duration


@dataclass(frozen=True, kw_only=True)
class RivalComparison:
    """Worst-case errors beside those of one rival, at equal duration."""

    # Optimised motion; slowed to the duration of a slower rival, unless that is better in no error.
    own: CompensatedMotion
    rival: CompensatedMotion

    @property
    def ratio(self) -> float:
        """Sum of both phases over the rival's; zero beside one without error."""
        worst = self.rival.compensated.worst_case
        return self.own.compensated.worst_case / worst if worst > 0.0 else 0.0

    @property
    def ratios(self) -> dict[str, float]:
        """Errors over the rival's by name, without those of which it has none."""
        mine, theirs = (
            {
                "in flight": spreads.flight,
                "after arrival": spreads.after,
                "across the path": spreads.flight.parts.get("across"),
            }
            for spreads in (self.own.compensated, self.rival.compensated)
        )
        return {
            name: own.worst / other.worst
            for name, own in mine.items()
            if own is not None and (other := theirs[name]) is not None and other.worst > 0.0
        }


@dataclass(frozen=True, kw_only=True)
class Compensation:
    """Compensation of the optimised motion and the baselines, with the command."""

    motions: tuple[CompensatedMotion, ...]  # the optimised motion first
    # Optimised motion slowed to the durations of slower rivals that are better in any error, by
    # the rivals' names.
    slowed: dict[str, CompensatedMotion] = field(default_factory=dict)
    command: Assessment | None  # motor motion every 2 ms; None where it exceeds a limit
    refusal: str  # reason for a missing command; else ""
    uncertainty: tuple[str, ...]  # description of the uncertain quantities
    draws: int
    loop: str = ""  # description of the position loops of all arms; "" where servos are uncertain
    file: str = ""  # file of the assessed command; "" for one computed with the motion
    # Known dead time of the servo, by which the command is sent ahead of the plan [s].
    ahead: float = 0.0
    # Motion and command of the best rival, where it is better in a phase.
    rival_plan: Assessment | None = None
    rival_command: Assessment | None = None

    @property
    def optimised(self) -> CompensatedMotion:
        """Optimised motion."""
        return self.motions[0]

    @property
    def beside_rivals(self) -> tuple[RivalComparison, ...]:
        """Comparisons with the rivals whose commands keep every limit."""
        return tuple(
            RivalComparison(own=self.slowed.get(each.name, self.optimised), rival=each)
            for each in self.motions[1:]
            if not each.excess
        )

    @property
    def beside_best(self) -> RivalComparison | None:
        """Comparison with the best rival; None without one whose command keeps every limit.

        Where no command of the optimised motion does, the best one has the least error itself.
        """
        if self.optimised.excess:
            return min(
                self.beside_rivals, key=lambda x: x.rival.compensated.worst_case, default=None
            )
        return max(self.beside_rivals, key=lambda x: x.ratio, default=None)

    @property
    def best_rival(self) -> CompensatedMotion | None:
        """Rival beside which the worst-case error is largest, at equal duration."""
        best = self.beside_best
        return None if best is None else best.rival

    @property
    def rival_wins(self) -> bool:
        """True where the best rival has less worst-case error, or the only command."""
        best = self.beside_best
        return best is not None and (bool(self.optimised.excess) or best.ratio > MAX_RIVAL_RATIO)

    @property
    def ratios(self) -> tuple[float, float] | None:
        """Worst-case errors over those of the best rival, in flight and after arrival.

        None where one is missing or an error of the rival is zero.
        """
        found = self._ratios
        both = {"in flight", "after arrival"} <= found.keys()
        return (found["in flight"], found["after arrival"]) if both else None

    @property
    def rival_better_in(self) -> tuple[str, ...]:
        """Phases and directions in which the best rival has less worst-case error."""
        return tuple(name for name, ratio in self._ratios.items() if ratio > MAX_RIVAL_RATIO)

    @property
    def _ratios(self) -> dict[str, float]:
        best = self.beside_best
        return {} if best is None or self.optimised.excess else best.ratios


COMMAND_FILE = "command.csv"
# Motion and command of the best rival, where it is better in a phase.
RIVAL_TRAJECTORY_FILE, RIVAL_COMMAND_FILE = "rival_trajectory.csv", "rival_command.csv"
# Error over a rival's from which the rival is better: less is within the model's agreement.
MAX_RIVAL_RATIO = 1.02
# Relative difference of durations that counts: those of rivals are found in 0.2 %.
MIN_SLOWDOWN = 2e-3


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
    arrays = {
        "t": command.time,
        "q": command.position,
        "qd": command.velocity,
        "qdd": command.acceleration,
        "tau": command.torque,
        "link": command.link,
    }
    write_motion_table(path, arrays)
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
        "slowed_to": {name: _motion_document(each) for name, each in compensation.slowed.items()},
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
        "rival_better_in": compensation.rival_better_in,
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
        **pick(spread, "nominal", "worst"),
        "bound_95": spread.bound,
        **pick(spread, "worst_case", "worst_arm"),
        "parts": {name: dict(vars(part)) for name, part in spread.parts.items()},
        "draws": spread.draws,
    }
