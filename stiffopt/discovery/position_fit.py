"""Fit of a simulation from commands: runs, expected parameters, polished parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.actuator.law import ActuatorLaw
from stiffopt.closed_loop.arm import CommandedArm
from stiffopt.closed_loop.parameters import (
    BODY_PARAMETERS,
    DELAY,
    JOINT_PARAMETERS,
    Parameters,
    zero_parameters,
)
from stiffopt.closed_loop.polish import polish
from stiffopt.closed_loop.simulation import CommandedRun, simulate
from stiffopt.discovery.comparison.filtering import ZeroPhaseFilter, bridge_gaps, derivative
from stiffopt.discovery.extended.schema import ClosedLoopSection
from stiffopt.discovery.settings import DEFAULT_TOLERANCE
from stiffopt.errors import InputError
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun
from stiffopt.robot.batched_kinematics import frame_positions
from stiffopt.robot.robot import Robot

# Cutoff of the filter of velocities that stretches begin with [Hz].
_VELOCITY_CUTOFF = 12.0
# Expected deviations of what no nominal value states, over the largest torque T of a joint, its
# fastest velocity V, its stroke S and its inertia: dry friction T / 3, viscous T / V / 3, drag
# T / V^2 / 10, slope T / S / 3, offset T / 20, rotor once the inertia.
_DRY_SHARE, _VISCOUS_SHARE, _DRAG_SHARE, _SLOPE_SHARE, _OFFSET_SHARE = 0.3, 0.3, 0.1, 0.3, 0.05
# Friction over torque of a gear in good repair, and error of an encoder's zero [rad].
# Rotor inertia at the output over that of the links: of geared joints often several times.
_ROTOR_SHARE = 3.0
_LOAD_FRICTION_DEVIATION, _ZERO_DEVIATION = 0.15, 0.03
# Deviation of a delay [s].
_DELAY_DEVIATION = 5e-3
# Inertia of bodies, relative: centres of mass and masses are better known.
_INERTIA_DEVIATION = 0.1
# Motion of all training runs that a fit simulates at most, times joints [s]: more adds but time.
_MAX_FIT_SECONDS = 120.0


def _build_loop(recordings: RecordingSet, runs: Sequence[CommandedRun]) -> CommandedArm:
    """Return the closed loop of a set's nominal robot with its actuators."""
    law, back = recordings.actuator, np.argsort(recordings.order)
    assert law is not None
    low = np.nanmin([np.nanmin(run.position, axis=0) for run in runs], axis=0)
    high = np.nanmax([np.nanmax(run.position, axis=0) for run in runs], axis=0)
    return CommandedArm(recordings.robot.tree, law.reordered(back), 0.5 * (low + high))


def is_commanded(run: RecordedRun) -> bool:
    """Return whether a run holds commands and positions of all joints."""
    if run.command is None or not run.usable:
        return False
    return bool(np.isfinite(run.command).any(axis=0).all())


def commanded_run(recordings: RecordingSet, run: RecordedRun) -> CommandedRun:
    """Return the commands and positions of a run in the joint order of the robot."""
    assert run.command is not None
    back = np.argsort(recordings.order)
    low_pass = ZeroPhaseFilter(1.0 / run.step, min(_VELOCITY_CUTOFF, 0.2 / run.step))
    smooth = low_pass.filter_motion(bridge_gaps(run.position))
    return CommandedRun(
        name=run.name,
        time=run.time,
        command=bridge_gaps(run.command)[:, back],
        position=bridge_gaps(run.position)[:, back],
        velocity=derivative(smooth, run.step)[:, back],
    )


def nominal_parameters(recordings: RecordingSet, robot: Robot) -> Parameters:
    """Return friction, rotor inertia and delay of a robot as parameters of its closed loop."""
    found = zero_parameters(robot.joint_names)
    values = found.values
    for name, own in (
        ("armature", robot.rotor_inertia),
        ("viscous", robot.viscous),
        ("coulomb", robot.coulomb),
    ):
        values[found.place(name)] = own
    law = recordings.actuator
    assert law is not None
    values[-1] = law.delay if np.isfinite(law.delay) else 0.0
    return found


def expected_deviations(
    recordings: RecordingSet, runs: Sequence[CommandedRun], loop: CommandedArm
) -> np.ndarray:
    """Return one standard deviation of every parameter, by the torques and speeds of the runs."""
    robot, law, tolerance = recordings.robot, loop.law, recordings.tolerance
    error = np.vstack([run.command - run.position for run in runs])
    velocity = np.vstack([run.velocity for run in runs])
    stiffness = np.where(np.isfinite(law.stiffness), law.stiffness, 0.0)
    torque = np.maximum(np.nanmax(np.abs(stiffness * error), axis=0), 1e-9)
    speed = np.maximum(np.nanmax(np.abs(velocity), axis=0), 1e-6)
    position = np.vstack([run.position for run in runs])
    stroke = np.maximum(np.nanmax(position, axis=0) - np.nanmin(position, axis=0), 1e-6)
    inertia = _joint_inertias(robot, loop.middle)
    found = zero_parameters(robot.joint_names)
    size = found.values
    for name, value in {
        "gain": law.tolerance,
        "damping": np.where(law.damping > 0.0, law.tolerance, 0.0),
        "armature": _ROTOR_SHARE * inertia,
        "viscous": _VISCOUS_SHARE * torque / speed,
        "coulomb": _DRY_SHARE * torque,
        "load_friction": _LOAD_FRICTION_DEVIATION,
        "friction_slope": _SLOPE_SHARE * torque / stroke,
        "drag": _DRAG_SHARE * torque / speed**2,
        "offset": _OFFSET_SHARE * torque,
        "zero": _ZERO_DEVIATION,
    }.items():
        size[found.place(name)] = value
    of_mass = DEFAULT_TOLERANCE.mass if tolerance.mass is None else tolerance.mass
    of_centre = DEFAULT_TOLERANCE.com if tolerance.com is None else tolerance.com
    assert of_mass is not None
    assert of_centre is not None
    for i, body in enumerate(robot.tree.bodies):
        moment = body.mass * (of_centre + of_mass * float(np.linalg.norm(body.centre)))
        about = _INERTIA_DEVIATION * float(np.trace(body.inertia)) / 3.0
        each = [of_mass * body.mass, *[moment] * 3, *[about] * 3]
        first = found.bodies.start + i * len(BODY_PARAMETERS)
        size[first : first + len(BODY_PARAMETERS)] = each
    # Without stated viscous friction nothing told the delay apart from it.
    told = "viscous" not in recordings.unstated
    size[-1] = law.delay_deviation if told and law.delay_deviation else _DELAY_DEVIATION
    return size


def _joint_inertias(robot: Robot, position: np.ndarray) -> np.ndarray:
    """Return the inertia (n,) that each joint accelerates in one pose [kg m^2]."""
    still, unit = np.zeros((robot.n, robot.n)), np.eye(robot.n)
    pose = np.tile(position, (robot.n, 1))
    bodies = robot.bodies_in_motion()
    return np.diagonal(bodies.torque(pose, still, unit) - bodies.torque(pose, still, still))


@dataclass(frozen=True, kw_only=True, eq=False)
class ClosedLoopModel:
    """Nominal and fitted simulation of an arm from its commands.

    Parameters
    ----------
    loop : CommandedArm
    nominal, fitted : Parameters
    deviations : array (p,)
        One standard deviation of each fitted parameter.
    """

    loop: CommandedArm
    nominal: Parameters
    fitted: Parameters
    deviations: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class PositionRun:
    """One run with its simulations, which saw its commands and its first position alone.

    Parameters
    ----------
    name, role : str
    time : array (K,) [s]
    command, measured, before, after : array (K, n)
        Positions in the joint order of the set [rad]; before and after the diagnosis.
    tool_before, tool_after : array (K,)
        Distances of the simulated from the measured tool [m].
    """

    name: str
    role: str
    time: np.ndarray
    command: np.ndarray
    measured: np.ndarray
    before: np.ndarray
    after: np.ndarray
    tool_before: np.ndarray
    tool_after: np.ndarray


def fit_positions(
    recordings: RecordingSet,
    runs: Sequence[RecordedRun],
    start: Robot,
    say: Callable[[str], object] = lambda _: None,
) -> ClosedLoopModel | None:
    """Fit a simulation from commands to training runs, beginning with the findings in `start`.

    None where a joint has no known gain, which would not be held, or no command.
    """
    law = recordings.actuator
    if law is None or not np.isfinite(law.stiffness).all():
        return None
    commanded = [commanded_run(recordings, run) for run in runs if is_commanded(run)]
    if not commanded:
        return None
    loop = _build_loop(recordings, commanded)
    prior = nominal_parameters(recordings, start)
    deviations = expected_deviations(recordings, commanded, loop)
    fitted = polish(loop, _limit_motion(commanded), prior, deviations, say)
    return ClosedLoopModel(
        loop=loop,
        nominal=nominal_parameters(recordings, recordings.robot),
        fitted=fitted.parameters,
        deviations=fitted.deviations,
    )


def _limit_motion(runs: Sequence[CommandedRun]) -> list[CommandedRun]:
    """Return the beginnings of runs, together of the duration that a fit needs at most."""
    each = _MAX_FIT_SECONDS / (len(runs) * runs[0].position.shape[1])
    found = []
    for run in runs:
        rows = slice(0, int(np.searchsorted(run.time, run.time[0] + each, side="right")))
        arrays = ("time", "command", "position", "velocity")
        found.append(replace(run, **{name: getattr(run, name)[rows] for name in arrays}))
    return found


def simulate_run(recordings: RecordingSet, model: ClosedLoopModel, run: RecordedRun) -> PositionRun:
    """Simulate a run from its commands and its first position with both models."""
    own, order = commanded_run(recordings, run), recordings.order
    before, after = (
        simulate(model.loop, own, parameters).position
        for parameters in (model.nominal, model.fitted)
    )
    robot = recordings.robot
    places = [frame_positions(robot.tree, robot.tool, q) for q in (own.position, before, after)]
    return PositionRun(
        name=run.name,
        role=run.role,
        time=own.time,
        command=own.command[:, order],
        measured=own.position[:, order],
        before=before[:, order],
        after=after[:, order],
        tool_before=np.linalg.norm(places[1] - places[0], axis=1),
        tool_after=np.linalg.norm(places[2] - places[0], axis=1),
    )


def model_section(
    recordings: RecordingSet, model: ClosedLoopModel | None
) -> ClosedLoopSection | None:
    """Return a closed loop as a section of extended.toml, in the joint order of the set."""
    if model is None:
        return None
    law, order = model.loop.law.reordered(recordings.order), recordings.order
    spread = replace(model.fitted, values=model.deviations)
    values: dict[str, tuple[float, ...]] = {}
    deviations: dict[str, tuple[float, ...]] = {}
    for table, own in ((values, model.fitted), (deviations, spread)):
        table |= {name: tuple(own.of(name)[order]) for name in JOINT_PARAMETERS}
        table |= {name: tuple(own.of_bodies(name)[order]) for name in BODY_PARAMETERS}
        table[DELAY] = (own.delay,)
    return ClosedLoopSection(
        **{name: tuple(getattr(law, name)) for name in ("stiffness", "damping")},
        **{name: tuple(getattr(law, name)) for name in ("drive_max", "torque_max")},
        delay=model.nominal.delay,
        tolerance=law.tolerance,
        middle=tuple(model.loop.middle[order]),
        values=values,
        deviations=deviations,
    )


def read_model(recordings: RecordingSet, section: ClosedLoopSection) -> ClosedLoopModel:
    """Return the closed loop that a section of extended.toml describes.

    Raises
    ------
    InputFileError
        A list of another length than the joints, or an unknown or missing parameter.
    """
    n, back = recordings.n, np.argsort(recordings.order)
    names = {**dict.fromkeys((*JOINT_PARAMETERS, *BODY_PARAMETERS), n), DELAY: 1}
    for key in ("values", "deviations"):
        table = getattr(section, key)
        if {name: len(own) for name, own in table.items()} != names:
            raise InputError(
                f"closed_loop.{key} needs {', '.join(names)}, one number a joint ({n}) each and one"
                f" {DELAY}. Diagnose the recordings again."
            )
    names_of_lists = ("stiffness", "damping", "drive_max", "torque_max", "middle")
    if any(len(getattr(section, name)) != n for name in names_of_lists):
        raise InputError(f"closed_loop needs one number a joint ({n}) in every list.")
    stiffness, damping, drive_max, torque_max, middle = (
        np.array(getattr(section, name)) for name in names_of_lists
    )
    law = ActuatorLaw(
        stiffness=stiffness,
        damping=damping,
        drive_max=drive_max,
        torque_max=torque_max,
        delay=section.delay,
        tolerance=section.tolerance,
    )
    loop = CommandedArm(recordings.robot.tree, law.reordered(back), middle[back])
    known = recordings.with_actuator(law)
    fitted, spread = zero_parameters(recordings.robot.joint_names), None
    for table in (section.deviations, section.values):
        spread = fitted
        fitted = zero_parameters(recordings.robot.joint_names)
        for name in JOINT_PARAMETERS:
            fitted.values[fitted.place(name)] = np.array(table[name])[back]
        for name in BODY_PARAMETERS:
            fitted.values[fitted.body_places(name)] = np.array(table[name])[back]
        fitted.values[-1] = table[DELAY][0]
    assert spread is not None
    return ClosedLoopModel(
        loop=loop,
        nominal=nominal_parameters(known, recordings.robot),
        fitted=fitted,
        deviations=spread.values,
    )
