"""Torque bursts above the filter's band, such as of a saturating amplifier.

A fit uses recordings up to its filter's cutoff. A drive that saturates for milliseconds does not
show there. With elastic joints the torque is predicted up to the cutoff of the measured motion,
except for short errors at reversals and the vibration in which a run begins. Torques are filtered
like the motion, since accelerations above the cutoff are unknown. Mispredicted vibration shows in
link encoders as well; a drive shows in the torque only.
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

# Share of the samples, the largest of a signal, that may hold bursts.
_BURST_SAMPLE_SHARE = 0.1
# Share of bursts that link encoders show as well, above which they are vibration.
_MAX_LINK_SHARE = 0.5
# Residual over its usual size from which a sample is down-weighted, and reweighting steps.
_OUTLIER_RATIO, _REWEIGHTING_STEPS = 3.0, 4


@dataclass(frozen=True)
class _JointChannel:
    """Samples of one joint in motion: residual over noise, and signals that bursts may depend on.

    `swung` is the residual expected from the link encoder, over the same noise.
    """

    residual: np.ndarray
    swung: np.ndarray
    followed: dict[str, np.ndarray]

    @property
    def usual(self) -> float:
        """Robust standard deviation, insensitive to bursts."""
        return DEVIATION_PER_MAD * float(np.median(np.abs(self.residual)))

    @property
    def bursting(self) -> float:
        """Root mean square over the robust standard deviation."""
        return float(np.sqrt(np.mean(self.residual**2))) / max(self.usual, 1e-12)


def find_bursts(training: Training, found: Extension) -> Unexplained | None:
    """Find the joint with the strongest torque bursts that the extended model does not predict.

    None without bursts, and without elastic joints. `ratio` is the normalised residual of the
    samples with bursts, `gain` their share of the residual's excess.
    """
    parts: list[list[_JointChannel]] = [[] for _ in range(training.robot.n)]
    noise = training.noise.channels.torque
    if training.least is not None:
        # The open residual of the starting model counts as noise.
        noise = noise * np.nan_to_num(training.least[: training.robot.n], nan=1.0)
    for recorded, run in zip(training.recorded, training.runs, strict=True):
        if run.vibration is None:
            return None
        predicted = extend_run(run, *training.before, found)
        drive = predicted.signals.drive_torque
        kept_noise = noise * run.motion_filter.noise_gain
        left = (run.motion_filter(bridge_gaps(run.torque)) - drive) / kept_noise
        swung = _link_residual_torque(predicted) / kept_noise
        rate = derivative(drive, run.signals.dt)
        used = run.moving & _usable_samples(recorded, run)
        left -= _fit_initial_vibration(run, left, used, kept_noise)
        for j, own in enumerate(parts):
            kept = used[:, j]
            followed = {
                f"torque_{j + 1}": np.abs(drive[kept, j]),
                f"dtorque_{j + 1}": np.abs(rate[kept, j]),
            }
            own.append(_JointChannel(left[kept, j], swung[kept, j], followed))
    channels = [_concatenate_channels(own) for own in parts]
    ratios = [c.bursting if c.residual.size else 0.0 for c in channels]
    worst = int(np.argmax(ratios))
    if ratios[worst] < BURSTING_RATIO:
        return None
    held = {
        name: _burst_share(channels[worst], size) for name, size in channels[worst].followed.items()
    }
    name = max(held, key=lambda each: held[each][0])
    if held[name][1] < BURST_RATIO or _link_share(channels[worst], name) > _MAX_LINK_SHARE:
        return None
    return Unexplained(
        channels=(f"torque_{worst + 1}",),
        regressors=(name,),
        period=None,
        gain=held[name][0],
        ratio=held[name][1],
        brief=True,
    )


def _usable_samples(recorded: RecordedRun, run: PreparedRun) -> np.ndarray:
    """Return a mask (K, n) of recorded samples outside the filter's length from gaps and ends."""
    reach, count = run.motion_filter.settling, len(run.time)
    inside = np.zeros(count, dtype=bool)
    inside[reach : max(count - reach, 0)] = True
    inside &= ~near_gaps(recorded.time, recorded.step, run.time, reach)
    return np.asarray(inside[:, None] & np.isfinite(run.torque))


def _link_residual_torque(predicted: PreparedRun) -> np.ndarray:
    """Return the spring torque (K, n) of the deflection residual [N m]; 0 without link encoder."""
    assert predicted.vibration is not None
    measured = predicted.motion_filter(bridge_gaps(predicted.deflection))
    apart = measured - predicted.signals.windup - predicted.added_deflection
    return np.asarray(np.nan_to_num(predicted.vibration.stiffness * apart))


def _link_share(channel: _JointChannel, name: str) -> float:
    """Return the share of the bursts' square that the deflection residual explains."""
    there = _select_largest(channel.followed[name])
    left = channel.residual[there]
    # The noise of both sensors is independent: bursts of a drive are not correlated.
    return float(left @ channel.swung[there] / max(left @ left, 1e-12))


def _fit_initial_vibration(
    run: PreparedRun, left: np.ndarray, used: np.ndarray, noise: np.ndarray
) -> np.ndarray:
    """Fit the initial vibration of a run to a residual (K, n) over noise (n,)."""
    assert run.vibration is not None
    torque, _ = run.vibration.free_vibration(run.initial_states(run.motion_filter.cutoff))
    swings = [each / noise for each in np.moveaxis(torque, 2, 0)]
    if not swings or not used.any():
        return np.zeros_like(left)
    columns, target = np.stack([each[used] for each in swings], axis=1), left[used]
    # Robust fit: reversals and bursts are outliers.
    weight = np.ones(target.size)
    for _ in range(_REWEIGHTING_STEPS):
        sizes = np.linalg.lstsq(weight[:, None] * columns, weight * target)[0]
        off = np.abs(target - columns @ sizes)
        far = _OUTLIER_RATIO * DEVIATION_PER_MAD * max(float(np.median(off)), 1e-12)
        weight = np.minimum(1.0, far / np.maximum(off, far))
    return np.tensordot(sizes, np.stack(swings), axes=1)


def _concatenate_channels(parts: Sequence[_JointChannel]) -> _JointChannel:
    names = parts[0].followed
    return _JointChannel(
        np.concatenate([p.residual for p in parts]),
        np.concatenate([p.swung for p in parts]),
        {name: np.concatenate([p.followed[name] for p in parts]) for name in names},
    )


def _burst_share(channel: _JointChannel, size: np.ndarray) -> tuple[float, float]:
    """Return the share of the excess at the largest samples of a signal, and the residual there."""
    square = channel.residual**2
    usual = channel.usual**2
    there = _select_largest(size)
    share = float(np.sum(square[there] - usual)) / max(float(np.sum(square - usual)), 1e-12)
    return float(np.clip(share, 0.0, 1.0)), float(np.sqrt(np.mean(square[there])))


def _select_largest(size: np.ndarray) -> np.ndarray:
    """Return a mask of the samples that may hold bursts."""
    return np.asarray(size >= np.quantile(size, 1.0 - _BURST_SAMPLE_SHARE))
