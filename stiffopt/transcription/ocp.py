"""The general optimal-control problem that a transcription turns into an NLP.

Nothing here knows robots: chains of integrators with states x (positions and their derivatives) and
controls u (the highest derivative of each), static variables z (epigraph bounds and the like),
parameters p (that vary between solves without rebuilding), time scaled by free or fixed phase
durations. Equations of motion enter as path rows: they give the forces for a motion.

    minimise    objective(I, T, z, x0, xf, p)          I = integral of the stage's integrands
    subject to  path rows g(x, u, z, p), integral rows, waypoint rows, bounds

Keep `objective` linear in I, or IPOPT's Hessian becomes dense: a root of an integral goes through a
static variable and an integral row instead.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import casadi as ca
import numpy as np

from stiffopt.transcription.node_derivatives import NumberedStage, extract_numbers

# Smallest shares that a phase may take: of the upper duration, and of the mean of many phases.
_MIN_PHASE_SHARE, _MIN_SHARE_OF_MEAN_PHASE = 0.02, 0.2


def shortest_phase_share(phases: int) -> float:
    """Return the smallest share of the duration that one of several phases may take."""
    return min(_MIN_PHASE_SHARE, _MIN_SHARE_OF_MEAN_PHASE / phases)


def _broadcast_vector(value: object, size: int) -> np.ndarray:
    return np.broadcast_to(np.asarray(value, dtype=float), (size,)).copy()


@dataclass(frozen=True, kw_only=True)
class Rows:
    """A named block of constraint rows with bounds, one label a row."""

    name: str  # limited quantity, for example "torque"
    labels: tuple[str, ...]  # one a row, for example "joint 2"
    # (m,) bounds in the row's own unit; +-inf where there is none.
    lower: np.ndarray
    upper: np.ndarray
    # (m,) typical magnitude; the NLP row is divided by it, violations are reported relative to it.
    scale: np.ndarray
    unit: str = ""  # for messages

    @classmethod
    def make(
        cls,
        name: str,
        labels: Sequence[str],
        lower: object,
        upper: object,
        scale: object = 1.0,
        unit: str = "",
    ) -> Rows:
        """Make rows, with scalars broadcast to the number of labels."""
        m = len(labels)
        return cls(
            name=name,
            labels=tuple(labels),
            lower=_broadcast_vector(lower, m),
            upper=_broadcast_vector(upper, m),
            scale=_broadcast_vector(scale, m),
            unit=unit,
        )

    def __len__(self) -> int:
        return len(self.labels)

    @property
    def bounded(self) -> np.ndarray:
        """Mask (m,) of the rows with a finite bound."""
        return np.asarray(np.isfinite(self.lower) | np.isfinite(self.upper))

    def select(self, index: np.ndarray) -> Rows:
        """Return some of the rows, by their indices."""
        return replace(
            self,
            labels=tuple(self.labels[i] for i in index),
            lower=self.lower[index],
            upper=self.upper[index],
            scale=self.scale[index],
        )


@dataclass(frozen=True, kw_only=True)
class Waypoint:
    """Rows that hold at one point: the start, the end, or the border between two phases."""

    function: ca.Function  # (x) or (x, p) -> (m,)
    rows: tuple[Rows, ...]  # blocks of the m rows in order


@dataclass(frozen=True, kw_only=True)
class OptimalControlProblem:
    """Statement of an optimal-control problem; see the module's text for the form."""

    name: str
    states: tuple[str, ...]
    controls: tuple[str, ...]
    # Chains of integrators, as indices (position, velocity, .., control): each state's derivative
    # is the next one, the last one's is that control; all of one length, and each state and control
    # in one of them. Integrated exactly. Of length 3 (the control is an acceleration) in every
    # transcription: piecewise-linear control then gives positions that are C2 cubic splines. Longer
    # ones, for smoother motions, with piecewise-linear control only.
    chains: tuple[tuple[int, ...], ...]
    # (x, u, z, p) -> (integrands (k,), path rows (m,)); either may be empty (0, 1).
    stage: ca.Function
    # (I (k,), T, z, x0, xf, p) -> scalar. T is the total duration.
    objective: ca.Function
    duration: tuple[float, float]  # (lower, upper) of the whole; equal values fix it [s]
    statics: tuple[str, ...] = ()
    path_rows: tuple[Rows, ...] = ()  # blocks of the path rows in order
    # (x, u, z, p) -> (y,), of the stage's own symbols: quantities through which most of the stage
    # is computed (joint torques). It makes second derivatives cheaper and changes no value.
    intermediate: ca.Function | None = None
    integral_function: ca.Function | None = None  # (I, T, z, p) -> rows, bounded by `integral_rows`
    integral_rows: tuple[Rows, ...] = ()
    # Nonlinear rows on the first and last state.
    start: Waypoint | None = None
    end: Waypoint | None = None
    vias: tuple[Waypoint, ...] = ()  # rows at the borders between phases; len(vias) + 1 phases
    state_lower: np.ndarray
    state_upper: np.ndarray
    control_lower: np.ndarray
    control_upper: np.ndarray
    # (nu,) bounds of du/dt (jerk where u is an acceleration).
    control_rate_lower: np.ndarray | None = None
    control_rate_upper: np.ndarray | None = None
    static_lower: np.ndarray = field(default_factory=lambda: np.zeros(0))
    static_upper: np.ndarray = field(default_factory=lambda: np.zeros(0))
    initial_lower: np.ndarray
    initial_upper: np.ndarray
    final_lower: np.ndarray
    final_upper: np.ndarray
    initial_control_lower: np.ndarray | None = None
    initial_control_upper: np.ndarray | None = None
    final_control_lower: np.ndarray | None = None
    final_control_upper: np.ndarray | None = None
    parameters: np.ndarray = field(default_factory=lambda: np.zeros(0))  # (np,) default value of p
    # Typical magnitudes of states, controls and static variables.
    state_scale: np.ndarray
    control_scale: np.ndarray
    static_scale: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @cached_property
    def numbered_stage(self) -> NumberedStage:
        """The stage with its numbers as inputs: the same on every mesh."""
        return extract_numbers(self.stage, self.intermediate)

    @property
    def phases(self) -> int:
        """Number of phases: one more than the vias."""
        return len(self.vias) + 1

    @property
    def fixed_duration(self) -> bool:
        """True where the duration is given."""
        return self.duration[0] == self.duration[1]


@dataclass(frozen=True, kw_only=True)
class Guess:
    """Initial guess: callables of the scaled time s in [0, 1] over the whole motion."""

    # s (k,) -> (k, nx), (k, nu).
    states: Callable[[np.ndarray], np.ndarray]
    controls: Callable[[np.ndarray], np.ndarray]
    duration: float
    statics: np.ndarray = field(default_factory=lambda: np.zeros(0))  # (nz,)
    # (phases,) share of the duration that each phase takes; sums to one. Equal shares are taken
    # when the number of entries is not that of the phases.
    phase_fractions: np.ndarray = field(default_factory=lambda: np.ones(1))
