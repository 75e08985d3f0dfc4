"""Tool error: actual pose of the tool less the pose of the planned path at the same instant.

The one yardstick of simulations and comparisons, in flight and after arrival. Its position is split
along the path (lateness, overshoot) and across it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

# Parts of the tool error beside its magnitude.
ERROR_PARTS = ("along", "across", "orientation")


@dataclass(frozen=True, kw_only=True, eq=False)
class ToolError:
    """Tool error of one arm, or of B arms on the same path."""

    time: np.ndarray  # (K,) of the planned path, from its start [s]
    duration: float  # arrival of the planned path [s]
    position: np.ndarray  # (K, 3) or (B, K, 3) actual less planned tool position, base axes [m]
    # (K, 3) or (B, K, 3) rotation vector from the planned to the actual orientation, base axes
    # [rad].
    orientation: np.ndarray
    direction: np.ndarray  # (K, 3) unit vectors along the planned path

    @cached_property
    def distance(self) -> np.ndarray:
        """Magnitude of the position error (.., K) [m]."""
        return _lengths(self.position)

    @cached_property
    def along(self) -> np.ndarray:
        """Position error along the path (.., K), negative where the tool is late [m]."""
        return np.asarray(np.einsum("...kx,kx->...k", self.position, self.direction))

    @cached_property
    def across(self) -> np.ndarray:
        """Magnitude of the position error across the path (.., K) [m]."""
        side = self.position - self.along[..., None] * self.direction
        return _lengths(side)

    @cached_property
    def angle(self) -> np.ndarray:
        """Magnitude of the orientation error (.., K) [rad]."""
        return _lengths(self.orientation)

    @property
    def flight(self) -> np.ndarray:
        """Mask (K,) of the instants until arrival."""
        return np.asarray(self.time <= self.duration)

    @property
    def after(self) -> np.ndarray:
        """Mask (K,) of the instants from arrival on; none where only the flight is known."""
        return np.asarray((self.time >= self.duration) & (self.time[-1] > self.duration))

    def peaks(self, phase: np.ndarray | slice) -> dict[str, np.ndarray]:
        """Largest magnitudes (..,) over the instants of a mask (K,) or slice, by component.

        The keys are "position", "along", "across" [m] and "orientation" [rad].
        """
        parts = {
            "along": np.abs(self.along),
            "across": self.across,
            "orientation": self.angle,
        }
        others = {name: part[..., phase].max(axis=-1) for name, part in parts.items()}
        return {"position": self.peak(phase), **others}

    def peak(self, phase: np.ndarray | slice) -> np.ndarray:
        """Largest position error (..,) over the instants of a mask (K,) or slice [m]."""
        return np.asarray(self.distance[..., phase].max(axis=-1))


def _lengths(vectors: np.ndarray) -> np.ndarray:
    """Lengths (..,) of vectors (.., 3), in a third of the time of `np.linalg.norm`."""
    return np.asarray(np.sqrt(np.einsum("...x,...x->...", vectors, vectors)))


@dataclass(frozen=True, kw_only=True)
class LedError:
    """Worst tool error that an exact lead leaves on uncertain arms."""

    # Errors that rivals are compared in.
    KINDS: ClassVar[tuple[str, ...]] = ("in_flight", "after_arrival", "across")

    # Peaks of the position error, each on the worst arm for it [m].
    in_flight: float
    after_arrival: float
    across: float  # in flight, across the path
    # By kind of source, in the sum of the squares of what each parameter does alone, where the
    # error is largest in flight.
    shares: dict[str, float]

    @property
    def whole(self) -> float:
        """Sum of the peaks in flight and after arrival [m]."""
        return self.in_flight + self.after_arrival

    def ratios_to(self, other: LedError) -> tuple[float, ...]:
        """Errors over another motion's, in flight, after arrival and across the path; or zero."""
        both = ((getattr(self, kind), getattr(other, kind)) for kind in self.KINDS)
        return tuple(own / beside if beside > 0.0 else 0.0 for own, beside in both)


def join_tool_errors(errors: Sequence[ToolError]) -> ToolError:
    """Join the errors of one arm over consecutive instants of the same planned path."""
    position, orientation, direction, time = (
        np.concatenate([getattr(each, name) for each in errors])
        for name in ("position", "orientation", "direction", "time")
    )
    return ToolError(
        time=time,
        duration=errors[0].duration,
        position=position,
        orientation=orientation,
        direction=direction,
    )


def path_directions(places: np.ndarray) -> np.ndarray:
    """Unit vectors (K, 3) along a path of evenly timed places (K, 3) [m].

    Where the path rests it keeps its last direction, before the first movement that one's; zero for
    a path that does not move.
    """
    moved = np.gradient(places, axis=0) if len(places) > 1 else np.zeros_like(places)
    speed = np.linalg.norm(moved, axis=1)
    # Share of the largest tool speed below which the path keeps the direction of its last movement.
    moving = np.flatnonzero(speed > 1e-4 * speed.max(initial=0.0))
    if not moving.size:
        return np.zeros_like(places)
    last = np.maximum(np.searchsorted(moving, np.arange(len(places)), side="right") - 1, 0)
    return np.asarray((moved / np.where(speed > 0.0, speed, 1.0)[:, None])[moving[last]])
