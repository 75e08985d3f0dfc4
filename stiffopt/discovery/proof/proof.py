"""How well a run is predicted before and after: residuals over noise on runs never fitted to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.comparison.channel_noise import KnownNoise
from stiffopt.discovery.proof.predict import Prediction
from stiffopt.discovery.settings import MOVING
from stiffopt.recording.run import RecordedRun


@dataclass(frozen=True, kw_only=True)
class ChannelError:
    """Squares of the residuals of one channel of one run.

    Parameters
    ----------
    kind : str
        "torque" or "link_position".
    joint : int
        From 0.
    samples : int
    before, after : float
        Sum of squares [(N m)^2] or [rad^2].
    noise : float
        One standard deviation [N m] or [rad].
    """

    kind: str
    joint: int
    samples: int
    before: float
    after: float
    noise: float

    @property
    def name(self) -> str:
        """Such as "torque_3"."""
        return f"{self.kind}_{self.joint + 1}"


@dataclass(frozen=True, kw_only=True, eq=False)
class RunProof:
    """One held-out run with its predictions.

    Parameters
    ----------
    run : RecordedRun
    before, after : Prediction
        Of the model that the diagnosis started from, and of the extended one.
    channels : tuple of ChannelError
    """

    run: RecordedRun
    before: Prediction
    after: Prediction
    channels: tuple[ChannelError, ...]

    @property
    def nrmse_before(self) -> float:
        """Root mean square of residual over noise, all channels together."""
        return nrmse([self], "before")

    @property
    def nrmse_after(self) -> float:
        """As before, of the extended model."""
        return nrmse([self], "after")


def nrmse(proofs: list[RunProof] | tuple[RunProof, ...], when: str) -> float:
    """Root mean square of residual over noise, all channels of all runs; nan without samples.

    Parameters
    ----------
    proofs : sequence of RunProof
    when : {"before", "after"}
    """
    channels = [c for proof in proofs for c in proof.channels]
    count = sum(c.samples for c in channels)
    total = sum(getattr(c, when) / c.noise**2 for c in channels)
    return float(np.sqrt(total / count)) if count else float("nan")


def prove(
    run: RecordedRun, velocity: np.ndarray, before: Prediction, after: Prediction, noise: KnownNoise
) -> RunProof:
    """Compare a run with its predictions.

    Parameters
    ----------
    run : RecordedRun
    velocity : array (K, n)
        Of the joints, on the run's own samples [rad/s].
    before, after : Prediction
        On the run's stamps.
    noise : KnownNoise

    Notes
    -----
    Samples count as they were measured: torque where the joint is faster than 0.03 rad/s, the
    link position everywhere. Channels that the run lacks are left out.
    """
    moving = np.abs(velocity) >= MOVING
    # Stamps that were kept, among all.
    places = np.searchsorted(run.stamps, run.time)
    channels = []
    for kind, measured, scale, chosen in (
        ("torque", run.torque, noise.channels.torque, moving),
        ("link_position", run.link_position, noise.channels.deflection, None),
    ):
        if measured is None:
            continue
        for j in range(run.n):
            used = np.isfinite(measured[:, j])
            if chosen is not None:
                used &= chosen[:, j]
            if not used.any() or not np.isfinite(scale[j]):
                continue
            left = [
                float(np.sum((measured[:, j] - getattr(p, kind)[places, j])[used] ** 2))
                for p in (before, after)
            ]
            channels.append(
                ChannelError(
                    kind=kind,
                    joint=j,
                    samples=int(used.sum()),
                    before=left[0],
                    after=left[1],
                    noise=float(scale[j]),
                )
            )
    return RunProof(run=run, before=before, after=after, channels=tuple(channels))
