"""Limits with one upper bound: speed and deflection of the tool, vibration after arrival."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from stiffopt.declaration import POSITIVE, Bounds, Length, Speed, Time
from stiffopt.errors import ProblemError
from stiffopt.problem.limit import LIMITS, LimitKey, LimitKind, Limits
from stiffopt.problem.rest_poses import rest_deflection, rest_poses
from stiffopt.problem.stage_terms import WINDUP_SMOOTHING, PathRows, squared_length
from stiffopt.result.assessment import Assessment, Violation
from stiffopt.result.simulation import SETTLING_BAND, SimulatedMotion

if TYPE_CHECKING:
    from stiffopt.problem.arrival_modes import ArrivalModes
    from stiffopt.problem.stage_model import StageModel
    from stiffopt.problem.trajectory import ResolvedMotion, TrajectoryProblem
    from stiffopt.robot.robot import Robot
    from stiffopt.symbolic import Quantity


class UpperBound(LimitKind):
    """Upper bound of one number; infinite by default.

    `name`: name of key and attribute. `form`: type of the key in a file. `unit`: SI unit.
    """

    def __init__(self, name: str, form: Any, unit: str, description: str) -> None:
        self.name, self.unit = name, unit
        self.keys = (
            LimitKey(
                key=name,
                form=Annotated[form, POSITIVE] | None,
                description=description,
                value=lambda robot: np.inf,
            ),
        )

    def active(self, limits: Limits) -> bool:
        """Return True if the bound is finite."""
        return bool(np.isfinite(getattr(limits, self.name)))

    def statements(self, limits: Limits, robot: Robot) -> list[tuple[str, float, str]]:
        """Statement of the bound."""
        phrase = f"{self.name.replace('_', ' ')} at most"
        return [(phrase, getattr(limits, self.name), self.unit)]


class ToolMagnitudeBound(UpperBound):
    """Bound of a vector's length at the tool, at every instant."""

    @abstractmethod
    def vector(self, model: StageModel) -> Quantity:
        """Limited vector (3,), symbolic."""

    @abstractmethod
    def magnitude(self, motion: Assessment) -> np.ndarray:
        """Length of the vector on the fine grid (K,)."""

    def rows(self, problem: TrajectoryProblem, model: StageModel, margin: float) -> list[PathRows]:
        """Row on the squared length, which is smooth at zero."""
        relative = self.vector(model) / getattr(problem.active_limits, self.name)
        return [
            PathRows(
                name=self.name,
                labels=("tool",),
                expressions=(squared_length(relative),),
                upper=(1.0 - margin) ** 2,
            )
        ]

    def violations(self, limits: Limits, motion: Assessment) -> list[Violation]:
        """Violation at the largest length."""
        series = self.magnitude(motion)
        k = int(np.argmax(series))
        excess = float(series[k] / getattr(limits, self.name) - 1.0)
        return [Violation(excess, self.name, None, float(motion.time[k]))]


class ArrivalBound(UpperBound):
    """Bound of a quantity of the simulated second after arrival."""

    of_arrival = True
    smoothing = WINDUP_SMOOTHING

    @abstractmethod
    def excess(self, limits: Limits, simulated: SimulatedMotion) -> tuple[float, float]:
        """Relative excess of a motion that ends at rest, and its instant [s]."""

    def violations(self, limits: Limits, motion: Assessment) -> list[Violation]:
        """Violation of the simulated motion; 1 if it does not end at rest."""
        simulated = motion.simulated
        if simulated is None:
            return []
        excess, when = 1.0, simulated.duration
        if simulated.peak_after is not None:
            excess, when = self.excess(limits, simulated)
        return [Violation(excess, self.name, None, when)]


class ToolSpeed(ToolMagnitudeBound):
    """Limit on the speed of the tool's point."""

    def vector(self, model: StageModel) -> Quantity:
        """Velocity of the tool [m/s]."""
        return model.tool_velocity

    def magnitude(self, motion: Assessment) -> np.ndarray:
        """Speed of the tool [m/s]."""
        return motion.tool_speed


LIMITS.add(ToolSpeed("tool_speed", Speed, "m/s", "Largest speed of the tool's point [m/s]."))


class DeflectionCap(ToolMagnitudeBound):
    """Limit on the peak of one part of the tool's deflection."""

    smoothing = WINDUP_SMOOTHING

    def __init__(self, part: str, description: str) -> None:
        super().__init__(f"{part}_deflection", Length, "m", description)
        self.part = part

    def vector(self, model: StageModel) -> Quantity:
        """Part of the deflection (3,) [m]."""
        return getattr(model.deflection, self.part)

    def magnitude(self, motion: Assessment) -> np.ndarray:
        """Length of that part [m]."""
        return np.asarray(np.linalg.norm(motion.deflection[self.part], axis=1))

    def check(self, problem: TrajectoryProblem, motion: ResolvedMotion) -> None:
        """Raise `ProblemError` where the static sag of a rest pose exceeds the limit."""
        cap = getattr(problem.active_limits, self.name)
        for pose in rest_poses(problem, motion) if self.part == "total" else ():
            sag = rest_deflection(problem, pose.angles, self.part) if pose.fixed else 0.0
            if sag > cap:
                raise ProblemError(
                    f"limits.total_deflection: the static sag of the {pose.name} pose is "
                    f"{1e3 * sag:.4g} mm, above the limit {1e3 * cap:.4g} mm, whatever the motion. "
                    "Raise the limit, or use limits.dynamic_deflection."
                )


LIMITS.add(
    DeflectionCap(
        "dynamic", "Largest deviation of the tool from the static sag of the same pose [m]."
    )
)
LIMITS.add(
    DeflectionCap("total", "Largest deflection of the tool, sag and process force included [m].")
)


class ResidualVibrationLimit(ArrivalBound):
    """Limit on the simulated peak of the tool's deviation after arrival."""

    def arrival_rows(self, limits: Limits, arrival: ArrivalModes) -> list[PathRows]:
        """Row on the sum of the modal amplitudes at the tool, an upper bound of the peak."""
        return [arrival.row(self.name, limits.residual_vibration, 0.0)]

    def excess(self, limits: Limits, simulated: SimulatedMotion) -> tuple[float, float]:
        """Relative excess of the peak, and its instant [s]."""
        after = np.where(simulated.time >= simulated.duration, simulated.distance, 0.0)
        return self.overshoot(limits, simulated), float(simulated.time[int(np.argmax(after))])

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

    def excess(self, limits: Limits, simulated: SimulatedMotion) -> tuple[float, float]:
        """Relative excess and the instant of settling [s]; 1 if not settled within one second."""
        took = simulated.settling_time
        if took is None:
            return 1.0, float(simulated.time[-1])
        return took / limits.settling_time - 1.0, simulated.duration + took

    def overshoot(self, limits: Limits, simulated: SimulatedMotion) -> float:
        """Relative excess of the deviation after that time over the band."""
        late = simulated.time >= min(
            simulated.duration + limits.settling_time, float(simulated.time[-1])
        )
        return float(simulated.distance[late].max() / limits.settling_band) - 1.0


LIMITS.add(SettlingTimeLimit())
