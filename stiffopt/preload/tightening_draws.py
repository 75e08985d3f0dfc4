"""Tightening as it happens: friction and wrench at random, and how often a bolt is too loose."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stiffopt.fastening.tightening import preload_at_torque, tightening_torque
from stiffopt.fastening.verification import Verification

# What is stated as a range spans so many standard deviations to either side.
_DEVIATIONS_PER_SIDE = 2.0
# Of a torque wrench: +-5 %.
_WRENCH_ACCURACY = 0.05


@dataclass(frozen=True, kw_only=True)
class SlipProbability:
    """How often a bolt is left with less preload than its share of the load asks for.

    Parameters
    ----------
    stated : float
        In closed form.
    drawn : float
        Share of the draws.
    draws : int
    needed : float
        Preload in service below which the bolt's part of the face slips or opens, safety 1 [N].
    least, largest : float
        Of the draws, in service [N].
    """

    stated: float
    drawn: float
    draws: int
    needed: float
    least: float
    largest: float

    @property
    def agrees(self) -> bool:
        """Whether the draws are within four standard deviations of what is stated."""
        spread = math.sqrt(self.stated * (1.0 - self.stated) / self.draws)
        return abs(self.drawn - self.stated) <= 4.0 * spread + 1.0 / self.draws


def slip_probability(
    steps: Verification, preload: float, *, draws: int = 1000, seed: int = 0
) -> SlipProbability:
    """State how often a bolt is too loose, and draw the tightening to confirm it.

    The wrench is set so that the stated friction leaves `preload`. Friction in thread and under the
    head is independent and normal: two standard deviations below its mean lies the stated, lowest
    one, two above it so much that the preload is `preload`/alpha_A. The wrench is off by +-5 %,
    two standard deviations. Settling and warmth take their part.

    Parameters
    ----------
    steps : Verification
    preload : float
        Largest assembly preload [N].
    draws, seed : int

    Notes
    -----
    A preload is below F where the torque M is less than F times the lever, which is linear in both
    frictions: M - F lever is normal, so the closed form is exact. A flange holds by the sum of its
    bolts, so that it slips less often than one bolt is too loose.
    """
    tightening, bolt = steps.tightening, steps.data
    lowest = (tightening.thread_friction, tightening.head_friction)
    setting = float(tightening_torque(bolt, preload, *lowest))
    pitch = float(tightening_torque(bolt, 1.0, 0.0, 0.0))
    levers = [float(tightening_torque(bolt, 1.0, *unit)) - pitch for unit in ((1, 0), (0, 1))]
    # At the other end of the scatter all friction is so many times the lowest.
    factor = (steps.scatter * setting / preload - pitch) / (setting / preload - pitch)
    means = [mu * (1.0 + factor) / 2.0 for mu in lowest]
    deviations = [mu * (factor - 1.0) / (2.0 * _DEVIATIONS_PER_SIDE) for mu in lowest]
    wrench = setting * _WRENCH_ACCURACY / _DEVIATIONS_PER_SIDE
    needed = _needed_preload(steps)
    force = needed + steps.loss
    mean = setting - force * (pitch + sum(a * mu for a, mu in zip(levers, means, strict=True)))
    spread = math.hypot(wrench, *(force * a * sd for a, sd in zip(levers, deviations, strict=True)))
    rng = np.random.default_rng(seed)
    thread, head = (
        rng.normal(mu, sd, size=draws) for mu, sd in zip(means, deviations, strict=True)
    )
    torque = rng.normal(setting, wrench, size=draws)
    left = np.asarray(preload_at_torque(bolt, torque, thread, head)) - steps.loss
    return SlipProbability(
        stated=0.5 * math.erfc(mean / spread / math.sqrt(2.0)),
        drawn=float((left < needed).mean()),
        draws=draws,
        needed=needed,
        least=float(left.min()),
        largest=float(left.max()),
    )


def _needed_preload(steps: Verification) -> float:
    """Preload in service that the worst bolt needs, without any safety [N]."""
    unloaded = (1.0 - steps.factor.least) * np.maximum(steps.opening, 0.0)
    slip = float((steps.clamp_against_slip + unloaded).max())
    return max(slip, float(steps.clamp_against_opening.max()))
