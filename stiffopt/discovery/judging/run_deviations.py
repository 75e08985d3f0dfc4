"""What held in the training runs and does not carry over to a run left out.

A joint that is colder on another day, an encoder that was referenced anew, a current sensor that
drifted: the run is then predicted badly for a reason that no model of the robot can know. Where one
value of a channel explains the most of what is left in a run, that is said, with the value. Nothing
is corrected by it: the run stays left out. Where friction was found to differ from run to run, a
further run differs as well: how far from the mean is said in spreads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.discovery.comparison.extension import Extension
from stiffopt.discovery.comparison.signals import RobotConstants, smooth_sign
from stiffopt.discovery.prediction import RunProof, used_samples
from stiffopt.discovery.settings import MIN_MOVING_SPEED

# Share of what is left that one value explains, and how far above the noise what is left must be.
_MIN_EXPLAINED_SHARE, _MIN_NOISE_RATIO = 0.5, 2.0
# Parts of a run in each of which it must help, and samples below which nothing is said.
_RUN_PARTS, _MIN_SAMPLES = 4, 40
# Share of a shape that a drift's own must hold to stand for it: a run tells them hardly apart.
_COLLINEAR_SHARE = 0.9


@dataclass(frozen=True, kw_only=True)
class NotCarriedOver:
    """A value that a run has and the training runs have not.

    Parameters
    ----------
    run, channel : str
    kind : str
        "constant", "dry friction", "viscous friction", or "friction drift" where friction was found
        to differ from run to run.
    value : float
        More than in training [SI]; of a drift in its spreads.
    share : float
        Of the squares that are left in the channel.
    """

    run: str
    channel: str
    kind: str
    value: float
    share: float


@dataclass(frozen=True, kw_only=True)
class Drift:
    """By how much the friction of a joint differs from run to run, one standard deviation.

    Parameters
    ----------
    joint : int
        From 0.
    dry, viscous : float
        [N m], [N m s/rad]
    rms : float
        Of its torque over the held-out runs: what their predictions are off by [N m].
    """

    joint: int
    dry: float
    viscous: float
    rms: float = 0.0

    def torque(self, speed: np.ndarray) -> np.ndarray:
        """Torque of one spread [N m]."""
        return np.asarray(self.dry * smooth_sign(speed) + self.viscous * speed)


def find_friction_drift(
    found: Extension, constants: RobotConstants, velocities: Sequence[np.ndarray]
) -> tuple[Drift, ...]:
    """Friction that was found to differ from run to run; of a joint's several the latest.

    Parameters
    ----------
    found : Extension
        With that of the model that was started from.
    constants : RobotConstants
    velocities : sequence of array (K, n)
        Of the joints in held-out runs [rad/s].
    """
    every: dict[int, Drift] = {}
    for each in found.effects:
        located = each.located
        if located.effect.of_runs is None or located.joint is None:
            continue
        values = located.effect.parameters(
            each.amplitudes, located.shapes, located.constants(constants)
        )
        own = Drift(joint=located.joint, dry=values["dFc_spread"], viscous=values["dFv_spread"])
        if own.dry == 0.0 and own.viscous == 0.0:
            continue
        parts = [own.torque(v[:, own.joint]) for v in velocities]
        torque = np.concatenate(parts) if parts else np.zeros(1)
        every[own.joint] = replace(own, rms=float(np.sqrt(np.nanmean(torque**2))))
    return tuple(every.values())


def find_run_deviations(
    proofs: Sequence[RunProof], velocities: Sequence[np.ndarray], drift: Sequence[Drift] = ()
) -> tuple[NotCarriedOver, ...]:
    """Single values that explain the most of what is left in a run.

    Parameters
    ----------
    proofs : sequence of RunProof
    velocities : sequence of array (K, n)
        Of the joints in each of these runs [rad/s].
    drift : sequence of Drift
    """
    found = []
    of_joint = {each.joint: each for each in drift}
    for proof, velocity in zip(proofs, velocities, strict=True):
        run = proof.run
        places = np.searchsorted(run.stamps, run.time)
        noise = {channel.name: channel.noise for channel in proof.channels}
        for kind, joint, used in used_samples(run, velocity):
            name = f"{kind}_{joint + 1}"
            if used is None or name not in noise:
                continue
            left = getattr(run, kind)[used, joint] - getattr(proof.after, kind)[places[used], joint]
            if (
                len(left) < _MIN_SAMPLES
                or np.sqrt(np.mean(left**2)) < _MIN_NOISE_RATIO * noise[name]
            ):
                continue
            own = of_joint.get(joint) if kind == "torque" else None
            best = _best_single_value(left, velocity[used, joint], kind == "torque", own)
            if best is not None:
                share, value, what = best
                found.append(
                    NotCarriedOver(run=run.name, channel=name, kind=what, value=value, share=share)
                )
    return tuple(found)


def _best_single_value(
    left: np.ndarray, speed: np.ndarray, torque: bool, drift: Drift | None
) -> tuple[float, float, str] | None:
    """Share, value and kind of what takes away most, if it does so all along the run."""
    shapes = {"constant": np.ones_like(left)}
    if torque and speed.min() < -MIN_MOVING_SPEED and speed.max() > MIN_MOVING_SPEED:
        friction = {"dry friction": smooth_sign(speed), "viscous friction": speed}
        known = np.zeros_like(left) if drift is None else drift.torque(speed)
        if known.any():
            # Known to differ, it is no news that it does; another friction or a constant is.
            friction = {
                k: v for k, v in friction.items() if _shared_squares(v, known) < _COLLINEAR_SHARE
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


def _shared_squares(shape: np.ndarray, known: np.ndarray) -> float:
    """Share of a shape's squares that a known one explains."""
    return float((shape @ known) ** 2 / ((shape @ shape) * (known @ known)))
