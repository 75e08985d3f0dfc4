"""Longest time from the arrival until the tool stays within a band."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from stiffopt.declaration import POSITIVE, Bounds, Length, Time
from stiffopt.problem.limit import LIMITS, LimitKey, Limits
from stiffopt.problem.limits.upper_bound import ArrivalBound
from stiffopt.result.assessment import Assessment, Violation
from stiffopt.result.simulation import SETTLING_BAND, SimulatedMotion

if TYPE_CHECKING:
    from stiffopt.problem.arrival_modes import ArrivalModes
    from stiffopt.problem.stage_terms import PathRows


class SettlingTimeLimit(ArrivalBound):
    """Limit on the simulated time from the motors' stop until the tool stays within a band."""

    def __init__(self) -> None:
        super().__init__(
            "settling_time",
            Annotated[Time, Bounds(above=0.0, most=1.0)],
            "s",
            "Longest time from the motors' stop until the tool stays within settling_band of its "
            "static equilibrium, on the elastic arm [s].",
        )
        band = LimitKey(
            key="settling_band",
            form=Annotated[Length, POSITIVE] | None,
            description="Band within which the tool counts as settled; default 0.05 mm [m].",
            value=lambda robot: SETTLING_BAND,
        )
        self.keys = (*self.keys, band)

    def arrival_rows(self, limits: Limits, arrival: ArrivalModes) -> list[PathRows]:
        """Row on the modal amplitudes after that time."""
        return [arrival.row(self.name, limits.settling_band, limits.settling_time)]

    def violations(self, limits: Limits, motion: Assessment) -> list[Violation]:
        """Violation of the simulated motion; 1 if it has not settled within one second."""
        simulated = motion.simulated
        if simulated is None:
            return []
        if simulated.peak_after is None:
            return [self.rest_missing(simulated)]
        took = simulated.settling_time
        excess = 1.0
        if took is None:
            took = float(simulated.time[-1]) - simulated.duration
        else:
            excess = took / limits.settling_time - 1.0
        return [Violation(excess, self.name, None, simulated.duration + took)]

    def overshoot(self, limits: Limits, simulated: SimulatedMotion) -> float:
        """Relative excess of the deviation after that time over the band."""
        late = simulated.time >= min(
            simulated.duration + limits.settling_time, float(simulated.time[-1])
        )
        return float(simulated.distance[late].max() / limits.settling_band) - 1.0


LIMITS.add(SettlingTimeLimit())
