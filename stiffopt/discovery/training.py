"""The training runs of a set, prepared: all that a search may see."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from stiffopt.discovery.comparison.bands import choose_bands
from stiffopt.discovery.comparison.begun import begun
from stiffopt.discovery.comparison.channel_noise import KnownNoise, known_noise
from stiffopt.discovery.comparison.columns import FEW_RUNS, bridged
from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.extension import Extension
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.nuisance import merged
from stiffopt.discovery.comparison.prepare import PreparedRun, prepare
from stiffopt.discovery.comparison.signals import RobotConstants
from stiffopt.discovery.extended.left_open import adopt_bands, describe_assumptions, noise_factors
from stiffopt.discovery.extended.model import ExtendedModel, check_extended
from stiffopt.discovery.settings import PREDICTION_CUTOFF, ZERO_TOLERANCE, Settings
from stiffopt.discovery.thresholds import MAX_EFFECTS, MAX_EFFECTS_FREE
from stiffopt.errors import InputFileError
from stiffopt.recording.assumptions import NO_RATIO
from stiffopt.recording.nominal import Tolerance
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun
from stiffopt.units import joint_unit

Say = Callable[[str], object]

# Wind-up of a joint beyond which it is no drivetrain's, [rad] or [m].
_MAX_WINDUP = 1.0
# No spring of a joint takes longer to follow its torque [s].
_MAX_RELAXATION_TIME = 10.0
# Least noise of a torque over its largest value: 24 bits tell no less.
_MIN_RELATIVE_NOISE = 2.0**-24


@dataclass(frozen=True, kw_only=True, eq=False)
class Training:
    """Prepared training runs with what they are judged by.

    Parameters
    ----------
    robot : RobotModel
    runs : tuple of PreparedRun
        With the nominal model.
    start : Extension
        Of the model that the diagnosis started from, as its fit found it.
    recorded : tuple of RecordedRun
        The same runs as they were read.
    constants : RobotConstants
        With the ranges that the runs meet.
    noise : KnownNoise
    tolerance : Tolerance
    box : float
        Standard deviations that nominal values stay within.
    free_bodies : bool
        Whether nobody vouches for the nominal masses.
    reidentified : bool
        Whether they are all fitted anew, then: unless an extended model is started from, against
        which differences are sought.
    most : int
        Effects that are named at most beside what the set does not give.
    settings : Settings
        With the bands that were chosen.
    assumptions : tuple of str
    least : array (2 n,), optional
        Factors on the noise that make it what the model that is started from left open.
    suspects : mapping of str to float
        What that hints at by itself, with log evidence for a row.
    leanings : mapping of str to tuple of float
        Amplitudes that effects alone would take of it.
    """

    robot: RobotModel
    runs: tuple[PreparedRun, ...]
    start: Extension
    recorded: tuple[RecordedRun, ...]
    constants: RobotConstants
    noise: KnownNoise
    tolerance: Tolerance
    box: float
    free_bodies: bool
    reidentified: bool
    most: int
    settings: Settings
    assumptions: tuple[str, ...]
    least: np.ndarray | None = None
    suspects: Mapping[str, float] = field(default_factory=dict)
    leanings: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    def comparison(self) -> Comparison:
        """The comparison that a search starts from."""
        return Comparison(
            self.robot,
            self.runs,
            self.noise.channels,
            self.tolerance,
            start=self.start,
            box=self.box,
            least=self.least,
            suspects=self.suspects,
        )


def open_training_runs(recordings: RecordingSet, say: Say = lambda _: None) -> list[RecordedRun]:
    """Open the training runs, and no other run."""
    opened = []
    for entry in recordings.with_role("train"):
        say(f"read {entry.file}")
        opened.append(recordings.open(entry))
    return opened


def prepare_training(
    recordings: RecordingSet,
    settings: Settings,
    model: ExtendedModel | None = None,
    say: Say = lambda _: None,
    runs: Sequence[RecordedRun] | None = None,
    *,
    swinging: bool = True,
) -> Training:
    """Open and prepare the training runs, and no other run.

    Parameters
    ----------
    recordings : RecordingSet
    settings : Settings
    model : ExtendedModel, optional
        To start from in place of the nominal model.
    say : callable
        Called with a sentence at every step.
    runs : sequence of RecordedRun, optional
        The training runs where they are open already.
    swinging : bool
        See `prepare`.
    """
    robot = RobotModel(recordings)
    left_open = None if model is None else model.left_open
    asked, settings = settings, adopt_bands(settings, left_open)
    opened: list[RecordedRun] = []
    prepared: list[PreparedRun] = []
    notes: list[str] = []
    for run in open_training_runs(recordings, say) if runs is None else runs:
        if not run.usable:
            notes.append(_describe_unusable(run))
            continue
        probe = prepare(robot, run, len(opened), None, settings, swinging=swinging)
        _check_nominal(robot, run, probe)
        if not (probe.torque_used.any() or probe.deflection_used.any()):
            notes.append(_describe_unfittable(run, probe))
            continue
        prepared.append(probe)
        opened.append(run)
    if not opened:
        raise InputFileError(
            recordings.path,
            "runs",
            f"no training run can be used. {' '.join(notes)} `stiffopt recording check` says more.",
        )
    if settings.cutoff is None and not robot.swings:
        say("choose how fast a motion to follow")
        settings, note = _choose_bands(robot, opened, settings)
        notes.append(note)
        # A long run is not held twice.
        prepared.clear()
        del probe
        prepared = [
            prepare(robot, run, k, None, settings, swinging=swinging)
            for k, run in enumerate(opened)
        ]
    stated = recordings.tolerance
    free = stated.mass is None and stated.com is None
    # Where the model is vouched for, the torque may be what a drive was asked for in vain.
    measured = _largest_torques(prepared) if free else None
    ranged = robot.ranged([run.signals for run in prepared], measured)
    if model is not None:
        ranged = model.scaled(ranged)
        check_extended(model, ranged)
    ready = [replace(run, signals=replace(run.signals, constants=ranged)) for run in prepared]
    noise = known_noise(recordings.noise, ready)
    _check_noise(recordings, noise, ready)
    # Where the model is vouched for, all that it leaves is to be explained.
    least = noise_factors(left_open, noise.channels) if free else None
    if len(ready) < FEW_RUNS:
        notes.append(
            f"With {len(ready)} training run{'s' * (len(ready) > 1)}, candidates are"
            " cross-validated over stretches of runs instead of whole runs."
        )
    # A model that was fitted to this robot is nearer to it than one that nobody has compared.
    if model is not None:
        ratio = [NO_RATIO] if model.nominal.gear_ratio is None else []
        known = describe_assumptions(
            left_open, least, noise.channels, asked, stated, recordings.prismatic
        )
        notes = [*ratio, *known, *notes]
    default = settings.tolerance if model is None else settings.after_model
    tolerance = merged(stated, default if least is None else ZERO_TOLERANCE)
    if free and stated.encoder_zero is None:
        # Encoders' offsets are fitted and said, not hidden by a tolerance.
        tolerance = replace(tolerance, encoder_zero=0.0)
    training = Training(
        robot=robot,
        runs=tuple(ready),
        start=Extension() if model is None else model.extension.fitted,
        recorded=tuple(opened),
        constants=ranged,
        noise=noise,
        tolerance=tolerance,
        free_bodies=free,
        reidentified=free and model is None,
        box=settings.box,
        most=_max_effects(settings.effects, free),
        settings=settings,
        assumptions=(*recordings.assumptions, *noise.assumptions(), *notes),
        least=least,
        suspects={} if left_open is None or least is None else left_open.suspects,
        leanings={} if left_open is None or least is None else left_open.leanings,
    )
    if free or any(run.swing is None for run in ready):
        return training
    return replace(training, runs=begun(training.comparison()))


def _max_effects(stated: int | None, free: bool) -> int:
    if stated is not None:
        return stated
    return MAX_EFFECTS_FREE if free else MAX_EFFECTS


def _choose_bands(
    robot: RobotModel, runs: Sequence[RecordedRun], settings: Settings
) -> tuple[Settings, str]:
    bands = choose_bands(
        robot, runs, slow=settings.slow, fit=settings.fit_band, predict=PREDICTION_CUTOFF
    )
    each = ", ".join(f"{j}: {band:g}" for j, band in enumerate(bands.predict, start=1))
    note = (
        f"Fits follow the recordings up to {bands.fit:g} Hz, predicted torques up to"
        f" (joint {each}) Hz: as stretches of the training runs left out bear it out best."
    )
    return replace(settings, cutoff=bands.fit, predict=bands.predict), note


def _check_nominal(robot: RobotModel, run: RecordedRun, ready: PreparedRun) -> None:
    """Raise `InputFileError` where the nominal model says nothing of a run that can be compared."""
    recordings, signals = robot.recordings, ready.signals
    if not np.isfinite(signals.drive_torque).all():
        raise InputFileError(
            recordings.path,
            "",
            f"the nominal model gives no finite torque along {run.file}. Check its positions and "
            "times, and masses and stiffnesses of the robot.",
        )
    _check_damping(robot, ready)
    widest = np.abs(signals.windup).max(axis=0)
    joint = int(widest.argmax())
    if widest[joint] > _MAX_WINDUP:
        name = recordings.joints[joint]
        raise InputFileError(
            recordings.path,
            "nominal",
            f"the drivetrain of {name!r} winds up by {widest[joint]:.3g} rad along {run.file}, "
            f"the largest allowed is {_MAX_WINDUP:g}. Check its stiffness, the masses and "
            "the times.",
        )


def _check_damping(robot: RobotModel, probe: PreparedRun) -> None:
    """Raise `InputFileError` where a joint would creep back instead of swinging."""
    recordings, swing = robot.recordings, probe.swing
    if swing is None:
        if robot.swings:
            _check_creep(robot)
        return
    inertia = np.diagonal(swing.bodies[2], axis1=1, axis2=2)
    critical = 2.0 * np.sqrt(np.max(swing.stiffness * inertia, axis=0))
    for j in np.flatnonzero(swing.damping > critical):
        unit = joint_unit("N m s/rad", bool(recordings.prismatic[j]))
        raise InputFileError(
            recordings.path,
            "nominal.joint_damping",
            f"{swing.damping[j]:g} {unit} at {recordings.joints[j]!r} is above the critical "
            f"{critical[j]:.3g} of the joint swinging alone. Joints have 1 to 5 % of that; give "
            "the damping of the spring, not the friction of the drive.",
        )


def _check_creep(robot: RobotModel) -> None:
    """Raise `InputFileError` where a spring would not have followed its torque within a run."""
    recordings = robot.recordings
    slope = robot.compliance(np.zeros((1, robot.n)))[0]
    for j, joint in enumerate(robot.constants.joints):
        if joint.joint_damping * slope[j] > _MAX_RELAXATION_TIME:
            unit = joint_unit("N m s/rad", bool(recordings.prismatic[j]))
            raise InputFileError(
                recordings.path,
                "nominal.joint_damping",
                f"{joint.joint_damping:g} {unit} at {recordings.joints[j]!r} gives its spring a"
                f" relaxation time of {joint.joint_damping * slope[j]:.3g} s; allowed are at most"
                f" {_MAX_RELAXATION_TIME:g} s. Give the damping of the spring, 1 to 5 % of the"
                " critical one.",
            )


def _check_noise(recordings: RecordingSet, noise: KnownNoise, runs: Sequence[PreparedRun]) -> None:
    """Raise `InputFileError` where the stated noise of a torque is none of any sensor."""
    largest = _largest_torques(runs)
    for j, stated in enumerate(noise.torque_stated):
        if stated and noise.channels.torque[j] < _MIN_RELATIVE_NOISE * largest[j]:
            raise InputFileError(
                recordings.path,
                "noise.torque",
                f"{noise.channels.torque[j]:g} N m at {recordings.joints[j]!r}, whose torque goes "
                f"to {largest[j]:.3g}: no sensor is so quiet. State one standard deviation, or "
                "leave it out.",
            )


def _describe_unusable(run: RecordedRun) -> str:
    why = "; ".join(
        f"joint {fault.joint} {fault.detail.removesuffix('.').removesuffix('. Left out')}"
        for fault in run.faults
        if fault.signal == "position" and fault.left_out
    )
    return (
        f"{run.file} is left out: a joint of it has no usable position{f' ({why})' if why else ''}."
    )


def _describe_unfittable(run: RecordedRun, ready: PreparedRun) -> str:
    """Why no sample of a run can be fitted."""
    lost = 2.0 * ready.low_pass.settling * run.step
    if run.duration <= 2.0 * lost:
        return (
            f"{run.file} is left out: it lasts {run.duration:.3g} s, of which the filter takes "
            f"{lost:.3g} s. Record some seconds or more."
        )
    return f"{run.file} is left out: no joint of it moves with a torque that can be used."


def _largest_torques(runs: Sequence[PreparedRun]) -> np.ndarray:
    """Largest filtered torque measured of every joint (n,); 0 where none is [N m]."""
    largest = np.zeros(runs[0].torque.shape[1])
    for run in runs:
        for j, used in enumerate(run.torque_used.T):
            if used.any():
                torque = bridged(run.torque[:, j : j + 1])[:, 0]
                largest[j] = max(largest[j], np.abs(run.low_pass(torque)[used]).max())
    return largest
