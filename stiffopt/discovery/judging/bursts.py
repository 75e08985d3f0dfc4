"""What is left of torques above the filter's band: bursts that no slow law explains.

A fit follows recordings up to its filter's cutoff. An amplifier that cannot follow, or that gives
less than it is asked for, leaves the slow motion alone and shows for milliseconds. Where the links'
swing is predicted, so is the torque up to the cutoff of the motion that is followed, but for short
errors at reversals and what the links swing already when a run begins. Readings pass that filter as
the motion has: beyond it a torque is that of accelerations which nobody knows. Links that swing
otherwise than predicted show in their encoders as much as in the torque; a drive shows in the
torque alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.discovery.comparison.extended_run import extend_run
from stiffopt.discovery.comparison.filtering import bridge_gaps, derivative, near_gaps
from stiffopt.discovery.comparison.located_effect import Extension
from stiffopt.discovery.comparison.prepared_run import PreparedRun
from stiffopt.discovery.judging.unexplained import Unexplained
from stiffopt.discovery.thresholds import BURST_RATIO, BURSTING_RATIO
from stiffopt.discovery.training import Training
from stiffopt.recording.channel import DEVIATION_PER_MAD
from stiffopt.recording.run import RecordedRun

# Share of the samples that bursts are sought in.
_SHARE = 0.1
# Share of bursts that link encoders show as well, from which on no drive made them.
_SWUNG = 0.5
# Residual over its usual size beyond which a sample counts less, and rounds of weighing.
_FAR, _WEIGHINGS = 3.0, 4


@dataclass(frozen=True)
class _Channel:
    """Samples of one joint in motion: residual over noise, and what bursts may follow.

    `swung` is the residual that the link's own encoder lets expect, over the same noise.
    """

    residual: np.ndarray
    extension_cache: np.ndarray
    motion_filter: dict[str, np.ndarray]

    @property
    def usual(self) -> float:
        """Standard deviation, whatever bursts there are."""
        return DEVIATION_PER_MAD * float(np.median(np.abs(self.residual)))

    @property
    def bursting(self) -> float:
        """Root mean square over the usual size."""
        return float(np.sqrt(np.mean(self.residual**2))) / max(self.usual, 1e-12)


def bursts(training: Training, extensions: Sequence[Extension]) -> Unexplained | None:
    """Joint whose torque has bursts that the model does not predict.

    Parameters
    ----------
    training : Training
    extensions : sequence of Extension
        What the nominal model is extended with.

    Returns
    -------
    Unexplained or None
        None without bursts, and where the links' swing cannot be predicted. `ratio` is that of the
        samples with bursts, `gain` the share of all that remains that lies in them.
    """
    parts: list[list[_Channel]] = [[] for _ in range(training.robot.n)]
    noise = training.noise.channels.torque
    if training.least is not None:
        # What the model that is started from left of its own recordings is nothing new.
        noise = noise * np.nan_to_num(training.least[: training.robot.n], nan=1.0)
    for recorded, run in zip(training.recorded, training.runs, strict=True):
        if run.vibration is None:
            return None
        predicted = extend_run(run, training.robot, *extensions)
        drive = predicted.signals.drive_torque
        kept_noise = noise * run.motion_filter.noise_gain
        left = (run.motion_filter(bridge_gaps(run.torque)) - drive) / kept_noise
        swung = _swung(predicted) / kept_noise
        rate = derivative(drive, run.signals.dt)
        used = run.moving & _known(recorded, run)
        left -= _begun_with(run, left, used, kept_noise)
        for j, own in enumerate(parts):
            kept = used[:, j]
            followed = {
                f"torque_{j + 1}": np.abs(drive[kept, j]),
                f"dtorque_{j + 1}": np.abs(rate[kept, j]),
            }
            own.append(_Channel(left[kept, j], swung[kept, j], followed))
    channels = [_joined(own) for own in parts]
    ratios = [c.bursting if c.residual.size else 0.0 for c in channels]
    worst = int(np.argmax(ratios))
    if ratios[worst] < BURSTING_RATIO:
        return None
    held = {
        name: _held(channels[worst], size) for name, size in channels[worst].motion_filter.items()
    }
    name = max(held, key=lambda each: held[each][0])
    if held[name][1] < BURST_RATIO or _of_links(channels[worst], name) > _SWUNG:
        return None
    return Unexplained(
        channels=(f"torque_{worst + 1}",),
        regressors=(name,),
        period=None,
        gain=held[name][0],
        ratio=held[name][1],
        brief=True,
    )


def _known(recorded: RecordedRun, run: PreparedRun) -> np.ndarray:
    """Samples (K, n) that were read, away from gaps and ends, which the filter makes up in part."""
    reach, count = run.motion_filter.settling, len(run.time)
    inside = np.zeros(count, dtype=bool)
    inside[reach : max(count - reach, 0)] = True
    inside &= ~near_gaps(recorded.time, recorded.step, run.time, reach)
    return np.asarray(inside[:, None] & np.isfinite(run.torque))


def _swung(predicted: PreparedRun) -> np.ndarray:
    """Torque of the springs (K, n) by which links are elsewhere than predicted [N m].

    Zero where no encoder tells where they are.
    """
    assert predicted.vibration is not None
    measured = predicted.motion_filter(bridge_gaps(predicted.deflection))
    apart = measured - predicted.signals.windup - predicted.added_deflection
    return np.asarray(np.nan_to_num(predicted.vibration.stiffness * apart))


def _of_links(channel: _Channel, name: str) -> float:
    """Share of the square of bursts that links which swing otherwise account for."""
    there = _largest(channel.motion_filter[name])
    left = channel.residual[there]
    # The noise of both sensors is independent: of a drive's bursts the product is none.
    return float(left @ channel.extension_cache[there] / max(left @ left, 1e-12))


def _begun_with(
    run: PreparedRun, left: np.ndarray, used: np.ndarray, noise: np.ndarray
) -> np.ndarray:
    """Part of a residual (K, n) over noise (n,) that the swing may be which the run begins with."""
    assert run.vibration is not None
    torque, _ = run.vibration.free_vibration(run.initial_states(run.motion_filter.cutoff))
    swings = [each / noise for each in np.moveaxis(torque, 2, 0)]
    if not swings or not used.any():
        return np.zeros_like(left)
    columns, target = np.stack([each[used] for each in swings], axis=1), left[used]
    # Reversals and bursts lie far off and are no part of it.
    weight = np.ones(target.size)
    for _ in range(_WEIGHINGS):
        sizes = np.linalg.lstsq(weight[:, None] * columns, weight * target)[0]
        off = np.abs(target - columns @ sizes)
        far = _FAR * DEVIATION_PER_MAD * max(float(np.median(off)), 1e-12)
        weight = np.minimum(1.0, far / np.maximum(off, far))
    return np.tensordot(sizes, np.stack(swings), axes=1)


def _joined(parts: Sequence[_Channel]) -> _Channel:
    names = parts[0].motion_filter
    return _Channel(
        np.concatenate([p.residual for p in parts]),
        np.concatenate([p.extension_cache for p in parts]),
        {name: np.concatenate([p.motion_filter[name] for p in parts]) for name in names},
    )


def _held(channel: _Channel, size: np.ndarray) -> tuple[float, float]:
    """Share of the excess that lies in the largest of some sizes, and the residual there."""
    square = channel.residual**2
    usual = channel.usual**2
    there = _largest(size)
    share = float(np.sum(square[there] - usual)) / max(float(np.sum(square - usual)), 1e-12)
    return float(np.clip(share, 0.0, 1.0)), float(np.sqrt(np.mean(square[there])))


def _largest(size: np.ndarray) -> np.ndarray:
    """Samples that bursts are sought in."""
    return np.asarray(size >= np.quantile(size, 1.0 - _SHARE))
