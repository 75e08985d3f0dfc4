"""Checks of controllers of arms with six turning joints."""

from __future__ import annotations

import numpy as np

from stiffopt.errors import InputError
from stiffopt.export.motion import StoredMotion


def require_six_axes(stored: StoredMotion, owner: str) -> None:
    """Raise `InputError` unless the arm has six joints, all of which turn."""
    slides = int(np.sum(stored.prismatic))
    if len(stored.joint_names) != 6 or slides:
        those = f", {slides} of them sliding" if slides else ""
        raise InputError(
            f"{owner} moves arms of 6 turning joints; this motion has "
            f"{len(stored.joint_names)} joints{those}. Export it with --to ros2 or csv."
        )


def require_cycle(rate: float, fastest: float, owner: str) -> None:
    """Raise `InputError` unless the step 1/rate is a whole number of the controller's cycles."""
    cycles = fastest / rate
    if abs(cycles - round(cycles)) > 1e-6 * cycles:
        allowed = ", ".join(f"{fastest / k:g}" for k in (1, 2, 4, 5))
        raise InputError(
            f"--rate {rate:g} Hz: {owner} has a cycle of {1e3 / fastest:g} ms, so the rate must be "
            f"{fastest:g} Hz over a whole number, such as {allowed}."
        )
