"""Settings of a diagnosis; they have defaults, which the report states."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from stiffopt.recording.nominal import Tolerance

# Speed within which dry friction has no definite value, and the smooth sign's own [rad/s].
SIGN_SPEED = 0.01
# Slower than this a joint counts as standing, and its torque as undetermined [rad/s].
MIN_MOVING_SPEED = 3.0 * SIGN_SPEED

# Of a fit's filter, where recordings do not choose [Hz].
FIT_CUTOFF = 12.0
# Of the motion that predictions follow [Hz]: wider, since what is predicted is not filtered.
PREDICTION_CUTOFF = 20.0

# Of nominal values whose tolerance nobody states.
DEFAULT_TOLERANCE = Tolerance(
    mass=0.05,
    rotor_inertia=0.2,
    coulomb=0.3,
    viscous=0.3,
    stiffness=0.1,
    joint_damping=0.3,
    torque_constant=0.02,
    com=5e-3,
    encoder_zero=2e-3,
)
# Of those of an extended model that was fitted to recordings of the same robot.
EXTENDED_MODEL_TOLERANCE = Tolerance(
    mass=0.01,
    rotor_inertia=0.05,
    coulomb=0.1,
    viscous=0.1,
    stiffness=0.05,
    joint_damping=0.1,
    torque_constant=0.005,
    com=1e-3,
    encoder_zero=2e-4,
)
# Of those whose own misfit is known and counts as noise: what has changed is an effect, however
# little, and no value that is moved without being said.
ZERO_TOLERANCE = Tolerance(
    mass=0.0,
    rotor_inertia=0.0,
    coulomb=0.0,
    viscous=0.0,
    stiffness=0.0,
    joint_damping=0.0,
    torque_constant=0.0,
    com=0.0,
    encoder_zero=0.0,
)


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How recordings are compared with the nominal model.

    Parameters
    ----------
    cutoff : float, optional
        Of the zero-phase filter of a fit [Hz]; lowered for slowly sampled recordings. Default: as
        the training runs bear it out, 12 Hz where links swing on known springs.
    predict : tuple of float, optional
        Of the motion that the torque of each joint is predicted from [Hz]. Default: likewise.
    slow : float
        A joint slower than this counts as standing [rad/s]; its friction has no definite value.
    tolerance : Tolerance
        Stands in where the set states none: wide, since unknown.
    after_model : Tolerance
        Likewise, where an extended model of the robot is started from.
    box : float
        Nominal values stay within so many standard deviations.
    effects : int, optional
        Most effects that are named beside values that the nominal model does not give. Default: 3,
        12 where nobody vouches for its masses.
    """

    cutoff: float | None = None
    predict: tuple[float, ...] | None = None
    slow: float = MIN_MOVING_SPEED
    tolerance: Tolerance = field(default_factory=lambda: DEFAULT_TOLERANCE)
    after_model: Tolerance = field(default_factory=lambda: EXTENDED_MODEL_TOLERANCE)
    box: float = 4.0
    effects: int | None = None

    @property
    def fit_band(self) -> float:
        """Cutoff of a fit [Hz]."""
        return FIT_CUTOFF if self.cutoff is None else self.cutoff


def fill_missing(own: np.ndarray | None, default: np.ndarray) -> np.ndarray:
    """Values of the set, the default where it states none (n,)."""
    if own is None:
        return default
    return np.where(np.isfinite(own), own, default)
