"""Fit of a closed loop to training runs: its runs, expected parameters and their deviations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from stiffopt.closed_loop.arm import CommandedArm
from stiffopt.closed_loop.least_squares import Polished
from stiffopt.closed_loop.parameters import (
    BODY_PARAMETERS,
    Parameters,
    zero_parameters,
)
from stiffopt.closed_loop.physics import LoopPhysics
from stiffopt.closed_loop.polish import polish, polish_leading
from stiffopt.closed_loop.simulation import CommandedRun
from stiffopt.discovery.comparison.filtering import ZeroPhaseFilter, bridge_gaps, derivative
from stiffopt.discovery.settings import DEFAULT_TOLERANCE
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun
from stiffopt.robot.body_tree import BodyTree
from stiffopt.robot.robot import Robot

# Cutoff of the filter of velocities that stretches begin with [Hz].
_VELOCITY_CUTOFF = 12.0
# Expected deviations of what no nominal value states, over the largest torque T of a joint, its
# fastest velocity V, its stroke S and its inertia: dry friction T / 3, viscous T / V / 3, drag
# T / V^2 / 10, slope T / S / 3, offset T / 20, rotor once the inertia.
_DRY_SHARE, _VISCOUS_SHARE, _DRAG_SHARE, _SLOPE_SHARE, _OFFSET_SHARE = 0.3, 0.3, 0.1, 0.3, 0.05
# Rotor inertia at the output over that of the links: of geared joints often several times.
_ROTOR_SHARE = 3.0
# Friction over torque of a gear in good repair, and error of an encoder's zero [rad].
_LOAD_FRICTION_DEVIATION, _ZERO_DEVIATION = 0.15, 0.03
# Deviation of a delay [s].
_DELAY_DEVIATION = 5e-3
# Deviation of the delay of one joint's commands from that of all: a cycle of a slow bus [s].
_LATENESS_DEVIATION = 2e-3
# Velocity at which dry friction has grown to its level, of grease and of friction in simulators
# that yields (MuJoCo: its level over 1000 /s times the inertia); and that of a fit at first
# [rad/s].
_CREEP_DEVIATION, _LEAST_CREEP = 1e-2, 1e-3
# Integral part of a controller by a regression of filtered errors, relative.
_INTEGRAL_DEVIATION = 0.3
# Deadband of a servo: a few counts of its encoder [rad].
_DEADBAND_DEVIATION = 5e-3
# Inertia of bodies besides their mass's, relative: centres of mass and masses are better known.
_INERTIA_DEVIATION = 0.1
# Scale of masses that nobody vouches for, one standard deviation, and parameters that go with it:
# descriptions of real arms are off by up to a third, most of their bodies alike.
UNVOUCHED_MASS_SCALE = 0.2
_SCALED_PARAMETERS = ("armature", "viscous", "coulomb", "friction_slope", "drag", "offset")
# Values of a robot that a set states, and the parameters that they are; a finding changes them by
# more than so many of their tolerances.
DRIVE_PARAMETERS = {"rotor_inertia": "armature", "viscous": "viscous", "coulomb": "coulomb"}
_KEPT_DEVIATIONS = 1.5


def build_loop(
    recordings: RecordingSet,
    runs: Sequence[CommandedRun],
    tree: BodyTree,
    physics: LoopPhysics | None = None,
) -> CommandedArm:
    """Return the closed loop of some bodies with a set's actuators and further torques."""
    law, back = recordings.actuator, np.argsort(recordings.order)
    assert law is not None
    low = np.nanmin([np.nanmin(run.position, axis=0) for run in runs], axis=0)
    high = np.nanmax([np.nanmax(run.position, axis=0) for run in runs], axis=0)
    return CommandedArm(tree, law.reordered(back), 0.5 * (low + high), physics)


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


def nominal_parameters(
    recordings: RecordingSet, robot: Robot, physics: LoopPhysics | None = None
) -> Parameters:
    """Return friction, rotor inertia, delay and further physics as parameters of a closed loop."""
    amplitudes = (physics or LoopPhysics()).amplitudes
    found = zero_parameters(robot.joint_names, amplitudes.bounds)
    values = found.values
    values[found.amplitudes] = amplitudes.values
    for key, name in DRIVE_PARAMETERS.items():
        values[found.place(name)] = getattr(robot, key)
    law = recordings.actuator
    assert law is not None
    values[found.place("integral")] = law.integral[np.argsort(recordings.order)]
    values[-1] = law.delay if np.isfinite(law.delay) else 0.0
    return found


def expect_parameters(
    recordings: RecordingSet, runs: Sequence[CommandedRun], loop: CommandedArm, begun: Parameters
) -> tuple[Parameters, np.ndarray]:
    """Return the parameters before the fit, and one standard deviation of each, by the runs.

    Friction and rotors that are stated, and that `begun` leaves as they are, are expected there
    within their tolerance: what a regression made of them is of the same recordings. Bodies,
    friction and rotors that findings changed are at least as uncertain as the change.
    """
    prior = replace(begun, values=begun.values.copy())
    robot, law = recordings.robot, loop.law
    # No slope leads away from none.
    prior.values[prior.place("creep")] = np.maximum(prior.of("creep"), _LEAST_CREEP)
    error = np.vstack([run.command - run.position for run in runs])
    velocity = np.vstack([run.velocity for run in runs])
    stiffness = np.where(np.isfinite(law.stiffness), law.stiffness, 0.0)
    torque = np.maximum(np.nanmax(np.abs(stiffness * error), axis=0), 1e-9)
    speed = np.maximum(np.nanmax(np.abs(velocity), axis=0), 1e-6)
    position = np.vstack([run.position for run in runs])
    stroke = np.maximum(np.nanmax(position, axis=0) - np.nanmin(position, axis=0), 1e-6)
    inertia = _joint_inertias(robot, loop.middle)
    found = zero_parameters(robot.joint_names, prior.amplitude_bounds)
    size = found.values
    size[found.amplitudes] = loop.physics.amplitudes.deviations
    for name, value in {
        "gain": law.stated_tolerance,
        "damping": np.where(law.damping > 0.0, law.tolerance, 0.0),
        "armature": _ROTOR_SHARE * inertia,
        "viscous": _VISCOUS_SHARE * torque / speed,
        "coulomb": _DRY_SHARE * torque,
        "load_friction": _LOAD_FRICTION_DEVIATION,
        "creep": _CREEP_DEVIATION,
        "friction_slope": _SLOPE_SHARE * torque / stroke,
        "drag": _DRAG_SHARE * torque / speed**2,
        "offset": _OFFSET_SHARE * torque,
        "zero": _ZERO_DEVIATION,
        "lateness": _LATENESS_DEVIATION if robot.n > 1 else 0.0,
        "integral": _INTEGRAL_DEVIATION * law.integral,
        "deadband": _DEADBAND_DEVIATION,
    }.items():
        size[found.place(name)] = value
    for key, name in DRIVE_PARAMETERS.items():
        if key not in recordings.unstated:
            relative = stated_tolerance(recordings, key)
            nominal, place = getattr(robot, key), found.place(name)
            change = np.abs(prior.of(name) - nominal)
            kept = change <= _KEPT_DEVIATIONS * relative * nominal
            size[place] = np.where(kept, relative * nominal, np.maximum(size[place], change))
            prior.values[place] = np.where(kept, nominal, prior.of(name))
    of_mass, of_centre = (stated_tolerance(recordings, key) for key in ("mass", "com"))
    for i, (body, own) in enumerate(zip(robot.tree.bodies, loop.tree.bodies, strict=True)):
        about = _INERTIA_DEVIATION * float(np.trace(body.inertia)) / 3.0
        change = np.abs(own.inertial_parameters - body.inertial_parameters)
        each = np.hypot(
            [of_mass, *[body.mass * of_centre] * 3, *[about] * 3],
            [change[0] / own.mass, *[change[1:4].max()] * 3, *[change[4:].max()] * 3],
        )
        first = found.bodies.start + i * len(BODY_PARAMETERS)
        size[first : first + len(BODY_PARAMETERS)] = each
    # Without stated viscous friction nothing told the delay apart from it.
    told = "viscous" not in recordings.unstated
    size[-1] = law.delay_deviation if told and law.delay_deviation else _DELAY_DEVIATION
    return prior, size


def stated_tolerance(recordings: RecordingSet, key: str) -> float:
    """Return the standard deviation of a nominal value as stated, by default the usual one."""
    own = getattr(recordings.tolerance, key)
    return float(getattr(DEFAULT_TOLERANCE, key) if own is None else own)


def _joint_inertias(robot: Robot, position: np.ndarray) -> np.ndarray:
    """Return the inertia (n,) that each joint accelerates in one pose [kg m^2]."""
    still, unit = np.zeros((robot.n, robot.n)), np.eye(robot.n)
    pose = np.tile(position, (robot.n, 1))
    bodies = robot.bodies_in_motion()
    return np.diagonal(bodies.torque(pose, still, unit) - bodies.torque(pose, still, still))


def fit_loop(
    recordings: RecordingSet,
    runs: Sequence[RecordedRun],
    prior: Parameters,
    say: Callable[[str], object] = lambda _: None,
    *,
    leading: bool = False,
    tree: BodyTree | None = None,
    physics: LoopPhysics | None = None,
    start: Parameters | None = None,
) -> tuple[CommandedArm, Polished] | None:
    """Fit a closed loop to training runs, beginning with a prior; or the leading parameters alone.

    `start`: values to begin with in place of a fit of the leading parameters.

    None where a joint has no gain, which would not be held, or no command, and where the simulation
    diverges with the prior.
    """
    law = recordings.actuator
    if law is None or not np.isfinite(law.stiffness).all():
        return None
    commanded = [commanded_run(recordings, run) for run in runs if is_commanded(run)]
    if not commanded:
        return None
    loop = build_loop(recordings, commanded, tree or recordings.robot.tree, physics)
    prior, deviations = expect_parameters(recordings, commanded, loop, prior)
    # Masses that nobody vouches for do not tell the scale of torques better than an estimated gain.
    scaled = recordings.tolerance.mass is not None or loop.law.estimated is None
    fit = polish_leading if leading else partial(polish, start=start)
    try:
        found = fit(loop, commanded, prior, deviations, say, scaled=scaled)
    except FloatingPointError:
        return None
    if not (scaled or leading):
        assert loop.law.estimated is not None
        found = _add_mass_scale(found, loop.law.estimated)
    return loop, found


def _add_mass_scale(found: Polished, estimated: np.ndarray) -> Polished:
    """Add the deviation of a mass scale that nobody states, where it gives torque its own.

    Ratios to the gain, and how the arm follows, do not depend on it.
    """
    own, spread = found.parameters, found.deviations.copy()
    for name in ("gain", *_SCALED_PARAMETERS):
        scaled = own.of(name) + (1.0 if name == "gain" else 0.0)
        more = np.where(estimated, UNVOUCHED_MASS_SCALE * scaled, 0.0)
        spread[own.place(name)] = np.hypot(spread[own.place(name)], more)
    return replace(found, deviations=spread)
