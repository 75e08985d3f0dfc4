"""Largest deviation of the tool after arrival."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stiffopt.declaration import Length
from stiffopt.problem.limit import LIMITS, Limits
from stiffopt.problem.limits.upper_bound import ArrivalBound
from stiffopt.result.assessment import Assessment, Violation

if TYPE_CHECKING:
    from stiffopt.problem.arrival_modes import ArrivalModes
    from stiffopt.problem.stage_terms import PathRows
    from stiffopt.result.simulation import SimulatedMotion


class ResidualVibrationLimit(ArrivalBound):
    """Peak of the tool's deviation once the motors stand still, as simulated."""

    def arrival_rows(self, limits: Limits, arrival: ArrivalModes) -> list[PathRows]:
        """The sum of the modes' sizes at the tool: never less than the peak."""
        return [arrival.row(self.name, limits.residual_vibration, 0.0)]

    def violations(self, limits: Limits, motion: Assessment) -> list[Violation]:
        """Of the simulated motion."""
        swing = motion.swing
        if swing is None:
            return []
        if swing.peak_after is None:
            return [self.rest_missing(swing)]
        after = np.where(swing.time >= swing.duration, swing.distance, 0.0)
        when = float(swing.time[int(np.argmax(after))])
        return [Violation(self.overshoot(limits, swing), self.name, None, when)]

    def overshoot(self, limits: Limits, swing: SimulatedMotion) -> float:
        """Of the peak over the limit."""
        return float((swing.peak_after or 0.0) / limits.residual_vibration) - 1.0


LIMITS.add(
    ResidualVibrationLimit(
        "residual_vibration",
        Length,
        "m",
        "Largest deviation of the tool after arrival from where it hangs at rest, on the elastic "
        "arm [m].",
    )
)
