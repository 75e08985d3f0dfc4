"""How well a run is predicted before and after: residuals over noise on runs never fitted to."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.comparison.channel_rows import KnownNoise
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
    # Stamps that were kept, among all.
    places = np.searchsorted(run.stamps, run.time)
    scales = {"torque": noise.channels.torque, "link_position": noise.channels.deflection}
    channels = []
    for kind, joint, used in used_samples(run, velocity):
        if used is None or not np.isfinite(scales[kind][joint]):
            continue
        measured = getattr(run, kind)[used, joint]
        left = [measured - getattr(p, kind)[places[used], joint] for p in (before, after)]
        channels.append(
            ChannelError(
                kind=kind,
                joint=joint,
                samples=int(used.sum()),
                before=float(left[0] @ left[0]),
                after=float(left[1] @ left[1]),
                noise=float(scales[kind][joint]),
            )
        )
    return RunProof(run=run, before=before, after=after, channels=tuple(channels))


def used_samples(
    run: RecordedRun, velocity: np.ndarray
) -> Iterator[tuple[str, int, np.ndarray | None]]:
    """Samples (K,) of bool that count of every channel: torques, then link positions.

    Parameters
    ----------
    run : RecordedRun
    velocity : array (K, n)
        Of the joints [rad/s].
    """
    moving = np.abs(velocity) >= MOVING
    for kind in ("torque", "link_position"):
        measured = getattr(run, kind)
        for joint in range(run.n):
            if measured is None:
                yield kind, joint, None
                continue
            used = np.isfinite(measured[:, joint])
            if kind == "torque":
                used &= moving[:, joint]
            yield kind, joint, used if used.any() else None
