"""Prepare the training runs of a set: the only data that a search uses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from stiffopt.discovery.comparison.bands import choose_fit_band
from stiffopt.discovery.comparison.channel_rows import KnownNoise, known_noise
from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.design_matrix import MIN_RUNS_AS_BLOCKS, DesignMatrix
from stiffopt.discovery.comparison.filtering import PoseFilter
from stiffopt.discovery.comparison.initial_states import estimate_initial_states
from stiffopt.discovery.comparison.located_effect import Extension
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.nuisance import merge_tolerances
from stiffopt.discovery.comparison.prepared_run import PreparedRun, prepare_run
from stiffopt.discovery.comparison.recorded_scales import constants_over, largest_torque
from stiffopt.discovery.extended.left_open import adopt_bands, describe_assumptions, noise_factors
from stiffopt.discovery.extended.model import ExtendedModel, check_extended
from stiffopt.discovery.progress import Say
from stiffopt.discovery.settings import (
    DEFAULT_TOLERANCE,
    EXTENDED_MODEL_TOLERANCE,
    PREDICTION_CUTOFF,
    ZERO_TOLERANCE,
    Settings,
)
from stiffopt.discovery.signals import RobotConstants
from stiffopt.discovery.thresholds import MAX_EFFECTS, MAX_EFFECTS_FREE
from stiffopt.errors import InputFileError
from stiffopt.formatting import significant
from stiffopt.recording.nominal import Tolerance
from stiffopt.recording.nominal_files import NO_RATIO
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun
from stiffopt.recording.state_pair import StatePair
from stiffopt.units import joint_unit

# Largest wind-up of a drivetrain, [rad] or [m]; more is a wrong stiffness, mass or time.
_MAX_WINDUP = 1.0
# Longest relaxation time of a joint's spring and damper [s].
_MAX_RELAXATION_TIME = 10.0
# Least noise of a torque over its largest value: the resolution of 24 bits.
_MIN_RELATIVE_NOISE = 2.0**-24


@dataclass(frozen=True, kw_only=True, eq=False)
class Training:
    """Prepared training runs with noise, tolerances and settings."""

    robot: RobotModel
    runs: tuple[PreparedRun, ...]  # with signals of the nominal model
    # Extension of the model that the diagnosis started from, as fitted; and as predictions use it,
    # none without a model.
    start: Extension
    before: tuple[Extension, ...]
    recorded: tuple[RecordedRun, ...]  # the same runs as read
    constants: RobotConstants  # with the ranges of the runs
    noise: KnownNoise
    tolerance: Tolerance
    # True if no tolerance of nominal masses is stated: inertial parameters are free.
    free_bodies: bool
    # True if all inertial parameters are then re-identified: unless starting from an extended
    # model.
    reidentified: bool
    most: int  # maximum number of findings, values that the set does not state apart
    settings: Settings  # with the chosen bands
    assumptions: tuple[str, ...]
    # (2 n,) factors that raise the noise to the open residual of the starting model.
    least: np.ndarray | None = None
    # Effects that the open residual suggests, with log evidence per row.
    suspects: Mapping[str, float] = field(default_factory=dict)
    # Amplitudes that single effects would have in the open residual.
    leanings: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    @cached_property
    def _columns(self) -> DesignMatrix:
        """Design matrix that every search starts from."""
        noise = self.noise.channels
        return DesignMatrix(self.robot, self.runs, noise, self.tolerance, self.start)

    def comparison(self) -> Comparison:
        """Return the comparison that a search starts from."""
        columns = self._columns.with_bodies(None)
        return Comparison(columns, least=self.least, suspects=self.suspects)


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
    vibrating: bool = True,
) -> Training:
    """Open and prepare the training runs, and no other run.

    `model`: starting model in place of the nominal one. `say`: called with a sentence at every
    step. `runs`: the training runs, if already read. `vibrating`: see `prepare_run`.
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
        probe = prepare_run(robot, run, len(opened), None, settings, vibrating=vibrating)
        _check_nominal(robot, run, probe)
        if not (probe.torque_used.any() or probe.deflection_used.any()):
            notes.append(_describe_unfittable(run, probe))
            continue
        prepared.append(probe)
        opened.append(run)
    _require_one_kind(recordings, opened)
    if not opened:
        notes += _describe_scale(recordings)
        raise InputFileError(
            recordings.path,
            "runs",
            f"no training run can be used. {' '.join(notes)} `stiffopt recording check` says more.",
        )
    if opened[0].at_rest:
        settings = replace(settings, cutoff=PoseFilter().cutoff)
    elif settings.cutoff is None and not robot.vibrates:
        say("choose how fast a motion to follow")
        band = choose_fit_band(
            robot, opened, slow=settings.slow, fit=settings.fit_band, predict=PREDICTION_CUTOFF
        )
        settings = replace(settings, cutoff=band)
        notes.append(
            f"Fits follow the recordings up to {band:g} Hz: chosen by cross-validation over"
            " stretches of the training runs."
        )
        # Release memory before the runs are prepared again.
        prepared.clear()
        del probe
        prepared = [
            prepare_run(robot, run, k, None, settings, vibrating=vibrating)
            for k, run in enumerate(opened)
        ]
    stated = recordings.tolerance
    free = stated.mass is None and stated.com is None
    ranged = constants_over(robot, prepared)
    if model is not None:
        ranged = model.scaled(ranged)
        check_extended(model, ranged)
    ready = [replace(run, signals=replace(run.signals, constants=ranged)) for run in prepared]
    noise = known_noise(recordings.noise, ready)
    _check_noise(recordings, noise, ready)
    # With stated tolerances the whole residual is to be explained, none is noise.
    least = noise_factors(left_open, noise.channels) if free else None
    if len(ready) < MIN_RUNS_AS_BLOCKS:
        notes.append(
            f"With {len(ready)} training run{'s' * (len(ready) > 1)}, candidates are"
            " cross-validated over stretches of runs instead of whole runs."
        )

    if model is not None:
        ratio = [NO_RATIO] if model.nominal.gear_ratio is None else []
        known = describe_assumptions(
            left_open, least, noise.channels, asked, stated, recordings.prismatic
        )
        notes = [*ratio, *known, *notes]
    default = DEFAULT_TOLERANCE if model is None else EXTENDED_MODEL_TOLERANCE
    tolerance = merge_tolerances(stated, default if least is None else ZERO_TOLERANCE)
    if free and stated.encoder_zero is None:
        # Encoder offsets are reported as findings, not hidden by a tolerance.
        tolerance = replace(tolerance, encoder_zero=0.0)
    training = Training(
        robot=robot,
        runs=tuple(ready),
        start=Extension() if model is None else model.extension.fitted,
        before=() if model is None else (model.extension,),
        recorded=tuple(opened),
        constants=ranged,
        noise=noise,
        tolerance=tolerance,
        free_bodies=free,
        reidentified=free and model is None,
        # What both of two states lack does not take the place of what changed.
        most=(MAX_EFFECTS_FREE if free else MAX_EFFECTS) * (1 + isinstance(recordings, StatePair)),
        settings=settings,
        assumptions=(*recordings.assumptions, *noise.assumptions(recordings.prismatic), *notes),
        least=least,
        suspects={} if left_open is None or least is None else left_open.suspects,
        leanings={} if left_open is None or least is None else left_open.leanings,
    )
    if free or any(run.vibration is None for run in ready):
        return training
    started = estimate_initial_states(training.comparison())
    return training if started == training.runs else replace(training, runs=started)


def _require_one_kind(recordings: RecordingSet, opened: Sequence[RecordedRun]) -> None:
    """Raise `InputFileError` for runs in motion beside poses at rest."""
    if len({run.at_rest for run in opened}) > 1:
        still, moving = (
            ", ".join(run.file for run in opened if run.at_rest == kind) for kind in (True, False)
        )
        raise InputFileError(
            recordings.path,
            "runs",
            f"{still}: poses at rest; {moving}: motion. A set holds one kind: give each its own.",
        )


def _check_nominal(robot: RobotModel, run: RecordedRun, ready: PreparedRun) -> None:
    """Raise `InputFileError` if the nominal model gives no usable torque or wind-up of a run."""
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
    """Raise `InputFileError` for a damping above the critical one."""
    recordings, vibration = robot.recordings, probe.vibration
    if vibration is None:
        if robot.vibrates:
            _check_creep(robot)
        return
    inertia = np.diagonal(vibration.bodies[2], axis1=1, axis2=2)
    critical = 2.0 * np.sqrt(np.max(vibration.stiffness * inertia, axis=0))
    for j in np.flatnonzero(vibration.damping > critical):
        unit = joint_unit("N m s/rad", bool(recordings.prismatic[j]))
        raise InputFileError(
            recordings.path,
            "nominal.joint_damping",
            f"{vibration.damping[j]:g} {unit} at {recordings.joints[j]!r} is above the critical "
            f"{critical[j]:.3g} of the joint alone. Joints have 1 to 5 % of that; give "
            "the damping of the spring, not the friction of the drive.",
        )


def _check_creep(robot: RobotModel) -> None:
    """Raise `InputFileError` for a relaxation time longer than any run."""
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
    """Raise `InputFileError` if the stated noise of a torque is below any sensor's."""
    for j, stated in enumerate(noise.torque_stated):
        largest = largest_torque(runs, j)
        if stated and noise.channels.torque[j] < _MIN_RELATIVE_NOISE * largest:
            raise InputFileError(
                recordings.path,
                "noise.torque",
                f"{noise.channels.torque[j]:g} N m at {recordings.joints[j]!r}, whose torque goes "
                f"to {largest:.3g}: below the resolution of any sensor. State one standard "
                "deviation, or leave it out.",
            )


def _describe_scale(recordings: RecordingSet) -> list[str]:
    law = recordings.actuator
    if law is None or law.scaled.any():
        return []
    gains = ", ".join(significant(gain, 3) for gain in law.stiffness)
    return [
        "Weight and inertia do not tell the gain of any joint, so that torques derived from"
        " commands have no scale: give kp in [actuator]. A simulation follows the training runs"
        f" best with kp = [{gains}]: with these, torques are in the scale of the nominal masses."
    ]


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
    """Return the reason that no sample of a run can be fitted."""
    lost = 2.0 * ready.low_pass.settling * run.step
    if run.duration <= 2.0 * lost:
        return (
            f"{run.file} is left out: it lasts {run.duration:.3g} s, of which the filter needs "
            f"{lost:.3g} s. Record some seconds more."
        )
    return f"{run.file} is left out: no joint of it moves with a torque that can be used."
