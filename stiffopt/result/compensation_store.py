"""command.csv, and what result.json says of compensation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.files import write_csv
from stiffopt.result.compensation import CompensatedMotion, Compensation, Spread, Spreads
from stiffopt.result.simulation import SimulatedMotion

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
