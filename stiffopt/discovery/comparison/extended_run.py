"""A run with extensions in what is predicted of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stiffopt.discovery.comparison.extension import Extension
from stiffopt.discovery.comparison.extension_change import (
    added_inertia_along,
    extended_damping,
    extension_change,
    relative_compliance,
    spring_laws,
)
from stiffopt.discovery.comparison.filtering import derivative
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.prepare import PreparedRun, with_link_torque
from stiffopt.discovery.comparison.swung_run import simulate_links


def extend_run(run: PreparedRun, robot: RobotModel, *extensions: Extension) -> PreparedRun:
    """Run whose nominal torques and wind-up have extensions in them.

    Parameters
    ----------
    run : PreparedRun
        With the nominal model.
    robot : RobotModel
    extensions : Extension
        Each on top of those before it.

    Notes
    -----
    Where links vibration, they do so with all that was found: on springs as soft, and as heavy. Else
    terms are evaluated with the link torque that was found in the springs, as they were when they
    were fitted; the joints wind up by the exact law under it.
    """
    if run.vibration is None:
        for extension in extensions:
            run = _extend_static_run(run, robot, extension)
        return run
    whole = Extension()
    for extension in extensions:
        whole = whole.plus(extension)
    if whole.empty:
        return run
    moved = simulate_links(run, robot, whole)
    change = extension_change(moved, robot, whole)
    drive = moved.signals.drive_torque + run.motion_filter(change.torque)
    rate = derivative(run.low_pass(drive), moved.signals.dt)
    return replace(
        moved,
        signals=replace(moved.signals, drive_torque=drive, drive_torque_rate=rate),
        added_deflection=moved.added_deflection + change.reading,
    )


def linearise_run(
    run: PreparedRun, robot: RobotModel, start: Extension, found: Extension
) -> tuple[PreparedRun, np.ndarray | float, np.ndarray | float]:
    """Run about what was found, for laws that bend and modes that move.

    Parameters
    ----------
    run : PreparedRun
        With the nominal model.
    robot : RobotModel
    start : Extension
        Whole in the prediction of the run.
    found : Extension
        In it by what moves the links.

    Returns
    -------
    run : PreparedRun
    torque, deflection : array (K, n) or float
        What the amplitudes of the found extension add by the columns about this run, which is in
        its prediction already [N m], [rad].
    """
    if start.empty and found.empty:
        return run, 0.0, 0.0
    if run.vibration is None:
        base = extend_run(run, robot, start)
        change = extension_change(base, robot, replace(found, calibration={}))
        if not change.link_torque.any():
            return base, 0.0, 0.0
        bent = with_link_torque(base, robot, change.link_torque)
        wound = robot.compliance(bent.signals.spring_torque) * change.link_torque
        return bent, change.link_torque, wound
    whole = start.plus(found)
    moved = simulate_links(run, robot, whole)
    laws, rest = spring_laws(moved, whole)
    softer = relative_compliance(moved, robot, rest)
    heavier = added_inertia_along(moved, robot, whole)
    springs = moved.springs(robot, extended_damping(robot, whole), laws)
    own = springs.linearise(moved.links, softer, heavier, moved.vibration)
    moved = replace(moved, vibration=own, play=springs.play(moved.links))
    change = extension_change(moved, robot, found)
    torque, deflection = moved.respond(robot, change.link_torque, change.deflection)
    assert torque is not None
    assert deflection is not None
    if not start.empty:
        stated = extension_change(moved, robot, start)
        drive = moved.signals.drive_torque + run.motion_filter(stated.torque)
        moved = replace(
            moved,
            signals=replace(moved.signals, drive_torque=drive),
            added_deflection=moved.added_deflection + stated.reading,
        )
    return moved, torque, deflection


def _extend_static_run(run: PreparedRun, robot: RobotModel, extension: Extension) -> PreparedRun:
    """The run with an extension, its links in balance."""
    bent = with_link_torque(run, robot, extension_change(run, robot, extension).link_torque)
    change = extension_change(bent, robot, extension)
    wound = with_link_torque(run, robot, change.link_torque).signals
    drive = wound.drive_torque + change.torque
    return replace(
        run,
        signals=replace(
            wound, drive_torque=drive, drive_torque_rate=derivative(run.low_pass(drive), wound.dt)
        ),
        added_deflection=run.added_deflection + change.deflection + change.reading,
    )
