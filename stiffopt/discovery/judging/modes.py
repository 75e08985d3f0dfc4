"""Elastic modes of the arm: nominal and identified frequencies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison, Fit
from stiffopt.discovery.names import ValueName

# Least difference of a shifted mode to the nominal one: standard deviations, and share.
_MIN_SHIFT_DEVIATIONS, _MIN_SHIFT_SHARE = 4.0, 0.02
# Modes above this ratio to the cutoff of a fit are not identified.
_MAX_CUTOFF_RATIO = 1.25


@dataclass(frozen=True, kw_only=True)
class ModeShift:
    """An elastic mode at the middle of the first training run."""

    joint: int  # from 1: the joint whose spring has most of its energy
    # nominal, found, sd: nominal and identified frequency, and its standard deviation [Hz].
    nominal: float
    found: float
    sd: float

    @property
    def is_shifted(self) -> bool:
        """True if it differs significantly from the nominal frequency."""
        away = abs(self.found - self.nominal)
        return away > max(_MIN_SHIFT_DEVIATIONS * self.sd, _MIN_SHIFT_SHARE * self.nominal)

    def __str__(self) -> str:
        return (
            f"The mode of joint {self.joint} has {self.found:.1f} Hz, in the model"
            f" {self.nominal:.1f} Hz."
        )


def mode_shifts(comparison: Comparison, fit: Fit) -> tuple[ModeShift, ...]:
    """Return the modes within the band of a fit, lowest first; none without elastic joints.

    `comparison`: linearised about the findings.

    The relative standard deviation is half that of the springs, weighted by their shares in the
    energy of the mode.
    """
    run, nominal = comparison.runs[0], comparison.nominal_runs[0]
    if run.vibration is None or nominal.vibration is None:
        return ()
    middle = len(run.time) // 2
    names, _ = comparison.priors
    places = [names.index(ValueName("stiffness", j)) for j in range(comparison.robot.n)]
    spread = fit.posterior.covariance[np.ix_(places, places)]
    before, _ = nominal.vibration.modes(middle)
    frequencies, shapes = run.vibration.modes(middle)
    found = []
    for frequency, was, shape in zip(frequencies, before, shapes.T, strict=True):
        if frequency > _MAX_CUTOFF_RATIO * run.low_pass.cutoff:
            break
        energy = run.vibration.stiffness[middle] * shape**2
        share = energy / energy.sum()
        sd = 0.5 * float(frequency * np.sqrt(share @ spread @ share))
        joint = int(np.argmax(share)) + 1
        found.append(ModeShift(joint=joint, nominal=float(was), found=float(frequency), sd=sd))
    return tuple(found)
