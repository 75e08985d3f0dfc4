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
    """Time from the motors' stop until the tool stays within a band, as simulated."""

    def __init__(self) -> None:
        super().__init__(
            "settling_time",
            Annotated[Time, Bounds(above=0.0, most=1.0)],
            "s",
            "Longest time from the motors' stop until the tool stays within settling_band of where "
            "it hangs at rest, on the elastic arm [s].",
        )
        band = LimitKey(
            key="settling_band",
            form=Annotated[Length, POSITIVE] | None,
            description="Within which the tool counts as settled; default 0.05 mm [m].",
            value=lambda robot: SETTLING_BAND,
        )
        self.keys = (*self.keys, band)

    def arrival_rows(self, limits: Limits, arrival: ArrivalModes) -> list[PathRows]:
        """The modes have decayed to the band by then."""
        return [arrival.row(self.name, limits.settling_band, limits.settling_time)]

    def violations(self, limits: Limits, motion: Assessment) -> list[Violation]:
        """Of the simulated motion; one that has not settled in a second exceeds any."""
        swing = motion.swing
        if swing is None:
            return []
        if swing.peak_after is None:
            return [self.rest_missing(swing)]
        took = swing.settling_time
        excess = 1.0
        if took is None:
            took = float(swing.time[-1]) - swing.duration
        else:
            excess = took / limits.settling_time - 1.0
        return [Violation(excess, self.name, None, swing.duration + took)]

    def overshoot(self, limits: Limits, swing: SimulatedMotion) -> float:
        """Of the size after that time over the band."""
        late = swing.time >= min(swing.duration + limits.settling_time, float(swing.time[-1]))
        return float(swing.distance[late].max() / limits.settling_band) - 1.0


LIMITS.add(SettlingTimeLimit())
