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
    """Limit on the simulated peak of the tool's deviation after arrival."""

    def arrival_rows(self, limits: Limits, arrival: ArrivalModes) -> list[PathRows]:
        """Row on the sum of the modal amplitudes at the tool, an upper bound of the peak."""
        return [arrival.row(self.name, limits.residual_vibration, 0.0)]

    def violations(self, limits: Limits, motion: Assessment) -> list[Violation]:
        """Violation of the simulated motion."""
        simulated = motion.simulated
        if simulated is None:
            return []
        if simulated.peak_after is None:
            return [self.rest_missing(simulated)]
        after = np.where(simulated.time >= simulated.duration, simulated.distance, 0.0)
        when = float(simulated.time[int(np.argmax(after))])
        return [Violation(self.overshoot(limits, simulated), self.name, None, when)]

    def overshoot(self, limits: Limits, simulated: SimulatedMotion) -> float:
        """Relative excess of the peak over the limit."""
        return float((simulated.peak_after or 0.0) / limits.residual_vibration) - 1.0


LIMITS.add(
    ResidualVibrationLimit(
        "residual_vibration",
        Length,
        "m",
        "Largest deviation of the tool after arrival from its static equilibrium, on the elastic "
        "arm [m].",
    )
)
