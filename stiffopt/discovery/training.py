"""The training runs of a set, prepared: all that a search may see."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from stiffopt.discovery.comparison.bands import choose_bands
from stiffopt.discovery.comparison.channel_rows import KnownNoise, known_noise
from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.design_matrix import MIN_RUNS_AS_BLOCKS
from stiffopt.discovery.comparison.filtering import fill_missing
from stiffopt.discovery.comparison.initial_states import estimate_initial_states
from stiffopt.discovery.comparison.located_effect import Extension
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.nuisance import merge_tolerances
from stiffopt.discovery.comparison.prepared_run import PreparedRun, prepare_run
from stiffopt.discovery.extended.left_open import assumed, least_factors, with_bands
from stiffopt.discovery.extended.model import ExtendedModel, check_extended
from stiffopt.discovery.settings import FIXED, PREDICTED_CUTOFF, Settings
from stiffopt.discovery.signals import RobotConstants
from stiffopt.discovery.thresholds import MOST_EFFECTS, MOST_EFFECTS_FREE
from stiffopt.errors import InputFileError
from stiffopt.recording.nominal import Tolerance
from stiffopt.recording.nominal_files import NO_RATIO
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun
from stiffopt.units import joint_unit

Say = Callable[[str], object]

# Wind-up of a joint beyond which it is no drivetrain's, [rad] or [m].
_SOFTEST = 1.0
# No spring of a joint takes longer to follow its torque [s].
_CREEPS = 10.0
# Least noise of a torque over its largest value: 24 bits tell no less.
_QUIETEST = 2.0**-24


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


def training_runs(recordings: RecordingSet, say: Say = lambda _: None) -> list[RecordedRun]:
    """Open the training runs, and no other run."""
    opened = []
    for entry in recordings.with_role("train"):
        say(f"read {entry.file}")
        opened.append(recordings.open(entry))
    return opened


def train(
    recordings: RecordingSet,
    settings: Settings,
    model: ExtendedModel | None = None,
    say: Say = lambda _: None,
    runs: Sequence[RecordedRun] | None = None,
    *,
    vibrating: bool = True,
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
    vibrating : bool
        See `prepare`.
    """
    robot = RobotModel(recordings)
    left_open = None if model is None else model.left_open
    asked, settings = settings, with_bands(settings, left_open)
    opened: list[RecordedRun] = []
    prepared: list[PreparedRun] = []
    notes: list[str] = []
    for run in training_runs(recordings, say) if runs is None else runs:
        if not run.usable:
            notes.append(_unusable(run))
            continue
        probe = prepare_run(robot, run, len(opened), None, settings, vibrating=vibrating)
        _check_nominal(robot, run, probe)
        if not (probe.torque_used.any() or probe.deflection_used.any()):
            notes.append(_nothing_to_fit(run, probe))
            continue
        prepared.append(probe)
        opened.append(run)
    if not opened:
        raise InputFileError(
            recordings.path,
            "runs",
            f"no training run can be used. {' '.join(notes)} `stiffopt recording check` says more.",
        )
    if settings.cutoff is None and not robot.vibrates:
        say("choose how fast a motion to follow")
        settings, note = _with_bands(robot, opened, settings)
        notes.append(note)
        # A long run is not held twice.
        prepared.clear()
        del probe
        prepared = [
            prepare_run(robot, run, k, None, settings, vibrating=vibrating)
            for k, run in enumerate(opened)
        ]
    stated = recordings.tolerance
    free = stated.mass is None and stated.com is None
    # Where the model is vouched for, the torque may be what a drive was asked for in vain.
    measured = _largest_torques(prepared) if free else None
    ranged = robot.constants_over([run.signals for run in prepared], measured)
    if model is not None:
        ranged = model.scaled(ranged)
        check_extended(model, ranged)
    ready = [replace(run, signals=replace(run.signals, constants=ranged)) for run in prepared]
    noise = known_noise(recordings.noise, ready)
    _check_noise(recordings, noise, ready)
    # Where the model is vouched for, all that it leaves is to be explained.
    least = least_factors(left_open, noise.channels) if free else None
    if len(ready) < MIN_RUNS_AS_BLOCKS:
        notes.append(
            f"With {len(ready)} training run{'s' * (len(ready) > 1)}, candidates are"
            " cross-validated over stretches of runs instead of whole runs."
        )
    # A model that was fitted to this robot is nearer to it than one that nobody has compared.
    if model is not None:
        ratio = [NO_RATIO] if model.nominal.gear_ratio is None else []
        known = assumed(left_open, least, noise.channels, asked, stated, recordings.prismatic)
        notes = [*ratio, *known, *notes]
    default = settings.tolerance if model is None else settings.after_model
    tolerance = merge_tolerances(stated, default if least is None else FIXED)
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
        most=_most(settings.effects, free),
        settings=settings,
        assumptions=(*recordings.assumptions, *noise.assumptions(), *notes),
        least=least,
        suspects={} if left_open is None or least is None else left_open.suspects,
        leanings={} if left_open is None or least is None else left_open.leanings,
    )
    if free or any(run.vibration is None for run in ready):
        return training
    return replace(training, runs=estimate_initial_states(training.comparison()))


def _most(stated: int | None, free: bool) -> int:
    if stated is not None:
        return stated
    return MOST_EFFECTS_FREE if free else MOST_EFFECTS


def _with_bands(
    robot: RobotModel, runs: Sequence[RecordedRun], settings: Settings
) -> tuple[Settings, str]:
    bands = choose_bands(
        robot, runs, slow=settings.slow, fit=settings.fit_band, predict=PREDICTED_CUTOFF
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
    if widest[joint] > _SOFTEST:
        name = recordings.joints[joint]
        raise InputFileError(
            recordings.path,
            "nominal",
            f"the drivetrain of {name!r} winds up by {widest[joint]:.3g} rad along {run.file}, "
            f"and no joint does so by more than {_SOFTEST:g}. Check its stiffness, and masses and "
            "times.",
        )


def _check_damping(robot: RobotModel, probe: PreparedRun) -> None:
    """Raise `InputFileError` where a joint would creep back instead of vibrating."""
    recordings, swing = robot.recordings, probe.vibration
    if swing is None:
        if robot.vibrates:
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
            f"{critical[j]:.3g} of the joint vibrating alone. Joints have 1 to 5 % of that; give "
            "the damping of the spring, not the friction of the drive.",
        )


def _check_creep(robot: RobotModel) -> None:
    """Raise `InputFileError` where a spring would not have followed its torque within a run."""
    recordings = robot.recordings
    slope = robot.compliance(np.zeros((1, robot.n)))[0]
    for j, joint in enumerate(robot.constants.joints):
        if joint.joint_damping * slope[j] > _CREEPS:
            unit = joint_unit("N m s/rad", bool(recordings.prismatic[j]))
            raise InputFileError(
                recordings.path,
                "nominal.joint_damping",
                f"{joint.joint_damping:g} {unit} at {recordings.joints[j]!r} lets its spring follow"
                f" a torque within {joint.joint_damping * slope[j]:.3g} s; allowed are {_CREEPS:g}"
                " s. Give the damping of the spring, 1 to 5 % of the critical one.",
            )


def _check_noise(recordings: RecordingSet, noise: KnownNoise, runs: Sequence[PreparedRun]) -> None:
    """Raise `InputFileError` where the stated noise of a torque is none of any sensor."""
    largest = _largest_torques(runs)
    for j, stated in enumerate(noise.torque_stated):
        if stated and noise.channels.torque[j] < _QUIETEST * largest[j]:
            raise InputFileError(
                recordings.path,
                "noise.torque",
                f"{noise.channels.torque[j]:g} N m at {recordings.joints[j]!r}, whose torque goes "
                f"to {largest[j]:.3g}: no sensor is so quiet. State one standard deviation, or "
                "leave it out.",
            )


def _unusable(run: RecordedRun) -> str:
    why = "; ".join(
        f"joint {fault.joint} {fault.detail.removesuffix('.').removesuffix('. Left out')}"
        for fault in run.faults
        if fault.signal == "position" and fault.left_out
    )
    return (
        f"{run.file} is left out: a joint of it has no usable position{f' ({why})' if why else ''}."
    )


def _nothing_to_fit(run: RecordedRun, ready: PreparedRun) -> str:
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
                torque = fill_missing(run.torque[:, j : j + 1])[:, 0]
                largest[j] = max(largest[j], np.abs(run.low_pass(torque)[used]).max())
    return largest
