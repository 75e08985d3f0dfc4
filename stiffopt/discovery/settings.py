"""Settings of a diagnosis with their defaults."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiffopt.recording.nominal import Tolerance

# Smoothing width of the sign of the velocity in dry friction [rad/s].
SIGN_SPEED = 0.01
# A slower joint counts as stationary, its dry friction as undetermined [rad/s].
MIN_MOVING_SPEED = 3.0 * SIGN_SPEED

# Bound on nominal values in a fit, in standard deviations.
MAX_NOMINAL_DEVIATIONS = 4.0

# Cutoff of the filter of a fit where recordings do not choose it [Hz].
FIT_CUTOFF = 12.0
# Cutoff of the motion that predictions use [Hz]: wider, since predictions are not filtered.
PREDICTION_CUTOFF = 20.0

# Tolerances of nominal values where the set states none.
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
# Tolerances of an extended model that was fitted to recordings of the same robot.
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
# No tolerance where the model's own residual is known and counts as noise: any change of a value
# is then an effect to report, not a nuisance.
ZERO_TOLERANCE = Tolerance(**dict.fromkeys(vars(DEFAULT_TOLERANCE), 0.0))


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of the comparison of recordings with the nominal model."""

    # Cutoff of the zero-phase filter of a fit [Hz]; lowered for slowly sampled recordings. Default:
    # chosen by cross-validation of the training runs; 12 Hz with elastic joints.
    cutoff: float | None = None
    # Cutoff of the motion that the torque of each joint is predicted from [Hz]. Default: likewise.
    predict: tuple[float, ...] | None = None
    # A joint slower than this counts as stationary [rad/s]; its friction is undetermined.
    slow: float = MIN_MOVING_SPEED

    @property
    def fit_band(self) -> float:
        """Cutoff of a fit [Hz]."""
        return FIT_CUTOFF if self.cutoff is None else self.cutoff


def fill_missing(own: np.ndarray | None, default: np.ndarray) -> np.ndarray:
    """Return the stated values (n,), the default where none is stated."""
    if own is None:
        return default
    return np.where(np.isfinite(own), own, default)
