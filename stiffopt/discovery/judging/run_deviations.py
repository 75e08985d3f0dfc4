"""Deviations of held-out runs from the training runs that a single value explains.

A colder joint, a newly referenced encoder or a drifted current sensor spoils the prediction of a
run for reasons that no robot model contains. If one value explains most of the residual of a
channel in a run, it is reported; predictions are not corrected. If friction was found to differ
from run to run, the deviation is reported in standard deviations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.discovery.catalogue.drift import deviations_of_runs
from stiffopt.discovery.comparison.located_effect import Extension
from stiffopt.discovery.prediction import RunProof, residuals
from stiffopt.discovery.settings import MIN_MOVING_SPEED
from stiffopt.discovery.signals import RobotConstants, smooth_sign

# Least share of the residual that one value explains, and least residual over noise.
_MIN_EXPLAINED_SHARE, _MIN_NOISE_RATIO = 0.5, 2.0
# Parts of a run that must all improve, and least number of samples.
_RUN_PARTS, _MIN_SAMPLES = 4, 40
# Squared correlation from which a shape is collinear with that of a known drift.
_COLLINEAR_SHARE = 0.9


@dataclass(frozen=True, kw_only=True)
class NotCarriedOver:
    """A value that differs between a run and the training runs."""

    run: str
    channel: str
    # "constant", "dry friction", "viscous friction", or "friction drift" if friction was found to
    # differ from run to run.
    kind: str
    value: float  # difference to training [SI]; of a drift in its standard deviations
    share: float  # explained share of the squared residual of the channel


@dataclass(frozen=True, kw_only=True)
class Drift:
    """Standard deviation of a joint's friction between runs."""

    joint: int  # from 0
    # dry, viscous [N m], [N m s/rad]
    dry: float
    viscous: float
    rms: float = 0.0  # root mean square error of predictions over the held-out runs from it [N m]
    # Training runs with their deviations from the mean of all, in that unit [N m].
    by_run: tuple[tuple[str, float], ...] = ()

    def torque(self, speed: np.ndarray) -> np.ndarray:
        """Return the torque of one standard deviation [N m]."""
        return np.asarray(self.dry * smooth_sign(speed) + self.viscous * speed)


def find_friction_drift(
    found: Extension, constants: RobotConstants, proofs: Sequence[RunProof]
) -> tuple[Drift, ...]:
    """Return friction that differs from run to run; the latest finding per joint.

    `found`: including the extension of the starting model. `proofs`: of held-out runs.
    """
    every: dict[int, Drift] = {}
    for each in found.effects:
        located = each.located
        if located.effect.of_runs is None or located.joint is None:
            continue
        values = located.effect.parameters(
            each.amplitudes, located.shapes, located.constants(constants)
        )
        if "dFc_spread" not in values:
            continue
        own = Drift(joint=located.joint, dry=values["dFc_spread"], viscous=values["dFv_spread"])
        if own.dry == 0.0 and own.viscous == 0.0:
            continue
        parts = [own.torque(proof.velocity[:, own.joint]) for proof in proofs]
        torque = np.concatenate(parts) if parts else np.zeros(1)
        rms = float(np.sqrt(np.nanmean(torque**2)))
        runs = deviations_of_runs(located.effect, each.amplitudes)
        by_run = tuple((run, off * rms) for run, off in runs)
        every[own.joint] = replace(own, rms=rms, by_run=by_run)
    return tuple(every.values())


def find_run_deviations(
    proofs: Sequence[RunProof], drift: Sequence[Drift] = ()
) -> tuple[NotCarriedOver, ...]:
    """Find single values that explain most of the residual of a channel in a run."""
    found = []
    of_joint = {each.joint: each for each in drift}
    for proof in proofs:
        run, velocity = proof.run, proof.velocity
        noise = {channel.name: channel.noise for channel in proof.channels}
        for kind, joint, used, (left,) in residuals(run, velocity, proof.after):
            name = f"{kind}_{joint + 1}"
            if name not in noise or len(left) < _MIN_SAMPLES:
                continue
            if np.sqrt(np.mean(left**2)) < _MIN_NOISE_RATIO * noise[name]:
                continue
            own = of_joint.get(joint) if kind == "torque" else None
            best = _best_single_value(left, velocity[used, joint], kind == "torque", own)
            if best is not None:
                share, value, cause = best
                found.append(
                    NotCarriedOver(run=run.name, channel=name, kind=cause, value=value, share=share)
                )
    return tuple(found)


def _best_single_value(
    left: np.ndarray, speed: np.ndarray, torque: bool, drift: Drift | None
) -> tuple[float, float, str] | None:
    """Return share, value and kind of the best single value that improves all parts of the run."""
    shapes = {"constant": np.ones_like(left)}
    if torque and speed.min() < -MIN_MOVING_SPEED and speed.max() > MIN_MOVING_SPEED:
        friction = {"dry friction": smooth_sign(speed), "viscous friction": speed}
        known = np.zeros_like(left) if drift is None else drift.torque(speed)
        if known.any():
            # Known drift is no deviation; another friction or a constant is.
            friction = {
                kind: shape
                for kind, shape in friction.items()
                if (shape @ known) ** 2 < _COLLINEAR_SHARE * (shape @ shape) * (known @ known)
            }
            friction["friction drift"] = known
        shapes |= friction
    found = []
    part = np.arange(len(left)) * _RUN_PARTS // len(left)
    for kind, shape in shapes.items():
        value = float(shape @ left / (shape @ shape))
        fall = left**2 - (left - value * shape) ** 2
        share = float(fall.sum() / (left @ left))
        if share >= _MIN_EXPLAINED_SHARE and np.bincount(part, fall).min() > 0.0:
            found.append((share, value, kind))
    return max(found, default=None)
