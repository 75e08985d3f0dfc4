"""Modes of the arm: where the nominal model has them, and where the recordings put them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison, Fit
from stiffopt.discovery.comparison.prepare import PreparedRun

# Postures that modes are judged in, evenly over every training run.
_POSTURES_PER_RUN = 6
# Standard deviations, and share, by which a mode lies elsewhere than the nominal model has it.
_MIN_SHIFT_DEVIATIONS, _MIN_SHIFT_SHARE = 4.0, 0.02
# Share of a frequency within which a period in time is that of a mode, beside its uncertainty.
_PERIOD_TOLERANCE = 0.05
# Modes above this, over the cutoff of a fit, are not seen by it.
_MAX_CUTOFF_RATIO = 1.25


@dataclass(frozen=True, kw_only=True)
class ModeShift:
    """A mode of the arm in the middle of the first training run.

    Parameters
    ----------
    joint : int
        From 1: the one whose spring takes most of its energy.
    nominal, found, sd : float
        By the nominal model, by the recordings, and its standard deviation [Hz].
    """

    joint: int
    nominal: float
    found: float
    sd: float

    @property
    def is_shifted(self) -> bool:
        """Whether it surely lies elsewhere than the nominal model has it."""
        away = abs(self.found - self.nominal)
        return away > max(_MIN_SHIFT_DEVIATIONS * self.sd, _MIN_SHIFT_SHARE * self.nominal)

    def __str__(self) -> str:
        return (
            f"The mode of joint {self.joint} lies at {self.found:.1f} Hz, the model has"
            f" {self.nominal:.1f} Hz."
        )


def mode_shifts(comparison: Comparison, fit: Fit) -> tuple[ModeShift, ...]:
    """Modes that a fit sees, lowest first; none where links do not swing.

    Parameters
    ----------
    comparison : Comparison
        About what was found.
    fit : Fit

    Notes
    -----
    A standard deviation is that of the springs by the fit: half their relative one, each by its
    share in the energy of the mode.
    """
    run, nominal = comparison.runs[0], comparison.nominal_runs[0]
    if run.swing is None or nominal.swing is None:
        return ()
    middle = len(run.time) // 2
    names = comparison.nuisance[0]
    places = [names.index(f"stiffness {j + 1}") for j in range(comparison.robot.n)]
    spread = fit.posterior.covariance[np.ix_(places, places)]
    before, _ = nominal.swing.modes(middle)
    frequencies, shapes = run.swing.modes(middle)
    found = []
    for frequency, was, shape in zip(frequencies, before, shapes.T, strict=True):
        if frequency > _MAX_CUTOFF_RATIO * run.low_pass.cutoff:
            break
        energy = run.swing.stiffness[middle] * shape**2
        share = energy / energy.sum()
        sd = 0.5 * float(frequency * np.sqrt(share @ spread @ share))
        joint = int(np.argmax(share)) + 1
        found.append(ModeShift(joint=joint, nominal=float(was), found=float(frequency), sd=sd))
    return tuple(found)


def matches_mode(comparison: Comparison, fit: Fit, period: float) -> bool:
    """Whether a period [s] is that of a mode, nominal or found, in some posture of the runs."""
    widest = max((m.sd / m.found for m in mode_shifts(comparison, fit)), default=0.0)
    near = _PERIOD_TOLERANCE + _MIN_SHIFT_DEVIATIONS * widest
    return any(
        (1.0 - near) * low <= 1.0 / period <= (1.0 + near) * high
        for runs in (comparison.nominal_runs, comparison.runs)
        for low, high in _frequency_ranges(runs)
    )


def _frequency_ranges(runs: tuple[PreparedRun, ...]) -> Iterator[tuple[float, float]]:
    """Lowest and highest frequency of every mode over the postures of the runs [Hz]."""
    found = [
        run.swing.modes(int(k))[0]
        for run in runs
        if run.swing is not None
        for k in np.linspace(0, len(run.time) - 1, _POSTURES_PER_RUN)
    ]
    if not found:  # links in balance have no modes
        return
    for own in np.array(found).reshape(len(found), -1).T:
        yield float(own.min()), float(own.max())
