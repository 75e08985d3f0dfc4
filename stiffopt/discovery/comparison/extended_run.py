"""A run with extensions in what is predicted of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stiffopt.discovery.comparison.extension import Extension
from stiffopt.discovery.comparison.extension_change import (
    change_of,
    damping_with,
    heavier_by,
    softer_by,
    spring_laws,
)
from stiffopt.discovery.comparison.filtering import derivative
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.prepare import PreparedRun, with_link_torque
from stiffopt.discovery.comparison.swung_run import swung


def extended(run: PreparedRun, robot: RobotModel, *extensions: Extension) -> PreparedRun:
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
    Where links swing, they do so with all that was found: on springs as soft, and as heavy. Else
    terms are evaluated with the link torque that was found in the springs, as they were when they
    were fitted; the joints wind up by the exact law under it.
    """
    if run.swing is None:
        for extension in extensions:
            run = _wound_up(run, robot, extension)
        return run
    whole = Extension()
    for extension in extensions:
        whole = whole.followed_by(extension)
    if whole.empty:
        return run
    moved = swung(run, robot, whole)
    change = change_of(moved, robot, whole)
    drive = moved.signals.drive_torque + run.followed(change.torque)
    rate = derivative(run.low_pass(drive), moved.signals.dt)
    return replace(
        moved,
        signals=replace(moved.signals, drive_torque=drive, drive_torque_rate=rate),
        beside=moved.beside + change.reading,
    )


def around(
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
    if run.swing is None:
        base = extended(run, robot, start)
        change = change_of(base, robot, replace(found, calibration={}))
        if not change.link_torque.any():
            return base, 0.0, 0.0
        bent = with_link_torque(base, robot, change.link_torque)
        wound = robot.compliance(bent.signals.spring_torque) * change.link_torque
        return bent, change.link_torque, wound
    whole = start.followed_by(found)
    moved = swung(run, robot, whole)
    laws, rest = spring_laws(moved, whole)
    softer = softer_by(moved, robot, rest)
    heavier = heavier_by(moved, robot, whole)
    springs = moved.springs(robot, damping_with(robot, whole), laws)
    own = springs.swing(moved.links, softer, heavier, moved.swing)
    moved = replace(moved, swing=own, play=springs.play(moved.links))
    change = change_of(moved, robot, found)
    torque, deflection = moved.answer(robot, change.link_torque, change.deflection)
    assert torque is not None
    assert deflection is not None
    if not start.empty:
        stated = change_of(moved, robot, start)
        drive = moved.signals.drive_torque + run.followed(stated.torque)
        moved = replace(
            moved,
            signals=replace(moved.signals, drive_torque=drive),
            beside=moved.beside + stated.reading,
        )
    return moved, torque, deflection


def _wound_up(run: PreparedRun, robot: RobotModel, extension: Extension) -> PreparedRun:
    """The run with an extension, its links in balance."""
    bent = with_link_torque(run, robot, change_of(run, robot, extension).link_torque)
    change = change_of(bent, robot, extension)
    wound = with_link_torque(run, robot, change.link_torque).signals
    drive = wound.drive_torque + change.torque
    return replace(
        run,
        signals=replace(
            wound, drive_torque=drive, drive_torque_rate=derivative(run.low_pass(drive), wound.dt)
        ),
        beside=run.beside + change.deflection + change.reading,
    )
