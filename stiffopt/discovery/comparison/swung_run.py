"""A run whose links swing with an extension."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stiffopt.discovery.comparison.extension import Extension
from stiffopt.discovery.comparison.extension_change import (
    change_of,
    damping_with,
    damps,
    heavier_by,
    moves_links,
    softer_by,
    spring_laws,
    values_of,
)
from stiffopt.discovery.comparison.filtering import derivative
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.nuisance import (
    MOVES_LINKS,
    OF_BODIES,
    OF_SPRINGS,
)
from stiffopt.discovery.comparison.prepare import PreparedRun
from stiffopt.discovery.comparison.swing import LinkMotion, Swing, slow_filter

# Times that the links' motion is found with all that was found, nominal values about it.
_PASSES = 2

# Such motions that are kept with a run, since the next extension often differs in drives alone.
_KEPT = 2


def swung(run: PreparedRun, robot: RobotModel, extension: Extension) -> PreparedRun:
    """Run whose links swing with an extension: what it does to drives and readings is left out.

    Parameters
    ----------
    run : PreparedRun
        With the nominal model and its swing.
    robot : RobotModel
    extension : Extension

    Notes
    -----
    Where no such motion is found, nominal values stand in for what is missing yet, further than
    springs can follow: they count to first order then, and effects too where that is not enough.
    """
    moving = _that_moves_links(run, extension)
    if moving.empty:
        return run
    key = _key(moving)
    if key not in run.swung:
        while len(run.swung) >= _KEPT:
            run.swung.pop(next(iter(run.swung)))
        run.swung[key] = _swung(run, robot, moving)
    return run.swung[key]


def _that_moves_links(run: PreparedRun, extension: Extension) -> Extension:
    values = extension.calibration.items()
    return Extension(
        calibration={n: v for n, v in values if v and n.split()[0] in MOVES_LINKS},
        effects=tuple(e for e in extension.effects if moves_links(run, e)),
    )


def _key(extension: Extension) -> tuple[object, ...]:
    effects = ((e.located.key, e.amplitudes) for e in extension.effects)
    return (*extension.calibration.items(), *effects)


def _swung(run: PreparedRun, robot: RobotModel, extension: Extension) -> PreparedRun:
    found = _followed(run, robot, extension)
    if found is not None:
        return found
    values = replace(extension, effects=())
    if extension.effects and not values.empty:
        found = _followed(run, robot, replace(extension, calibration={}))
        if found is not None:
            return _nearly(found, robot, values)
    return _nearly(run, robot, extension)


def _followed(run: PreparedRun, robot: RobotModel, extension: Extension) -> PreparedRun | None:
    """Run whose links swing with an extension; None where no motion of such an arm is found.

    Springs and damping are those of the motion that is looked for; regressors are taken about the
    one before, what else the bodies need goes with their inertia. The swing of the result is one
    near by.
    """
    assert run.swing is not None
    laws, rest = spring_laws(run, extension)
    springs = run.springs(robot, damping_with(robot, extension), laws)
    bodies = values_of(extension, OF_BODIES)
    sprung = replace(
        extension,
        calibration=values_of(extension, OF_SPRINGS).calibration,
        effects=tuple(e for e in rest.effects if not damps(e)),
    )
    effects = replace(sprung, calibration={})
    heavier = heavier_by(run, robot, effects)
    nominal = softer_by(run, robot, replace(sprung, effects=()))
    swing = springs.swing(run.links, nominal * softer_by(run, robot, effects), heavier, run.swing)
    begin = _slowly(run, robot, extension, swing)
    moved = run
    for again in range(_PASSES if effects.effects else 1):
        weight = change_of(moved, robot, bodies).link_torque

        def softer(links: LinkMotion, moved: PreparedRun = moved) -> np.ndarray:
            now = softer_by(with_links(moved, robot, links), robot, effects)
            return np.asarray(nominal[: len(now)] * now)

        def added(
            links: LinkMotion, moved: PreparedRun = moved, weight: np.ndarray = weight
        ) -> tuple[np.ndarray, np.ndarray]:
            here = replace(with_links(moved, robot, links), play=springs.play(links))
            change = change_of(here, robot, sprung)
            known = len(links.position)
            if isinstance(heavier, np.ndarray):
                away = links.acceleration - moved.signals.link_acceleration[:known]
                change.link_torque[:] += (heavier[:known] @ away[..., None])[..., 0]
            return change.link_torque + weight[:known], change.deflection

        links = (
            springs.follow(moved.links, swing, begin, added, softer)
            if again
            else springs.started(begin, swing, added, softer, run.begun)
        )
        if links is None:
            return None
        moved = with_links(moved, robot, links)
        if isinstance(heavier, np.ndarray):
            moved = _with_regressor(moved, robot)
    return replace(
        moved,
        swing=swing,
        beside=springs.motor - moved.signals.link_position - moved.signals.windup,
    )


def _slowly(run: PreparedRun, robot: RobotModel, extension: Extension, swing: Swing) -> LinkMotion:
    """Slow motion of the links with an extension."""
    assert run.swing is not None
    slow = run.swing.begin
    here = with_links(run, robot, slow)
    if any(e.located.effect.family == "inertial" for e in extension.effects):
        here = _with_regressor(here, robot)
    change = change_of(here, robot, extension)
    low_pass = slow_filter(run.signals.dt)
    wound = low_pass(change.link_torque / swing.carrying + change.deflection)
    rate = derivative(wound, run.signals.dt)
    return slow.moved(-wound, -rate, -derivative(rate, run.signals.dt))


def _nearly(run: PreparedRun, robot: RobotModel, extension: Extension) -> PreparedRun:
    """The run with an extension to first order."""
    assert run.swing is not None
    change = change_of(run, robot, extension)
    torque, deflection = run.swing.answer(change.link_torque, change.deflection)
    signals = replace(run.signals, drive_torque=run.signals.drive_torque + torque)
    return replace(run, signals=signals, beside=run.beside + deflection)


def _with_regressor(run: PreparedRun, robot: RobotModel) -> PreparedRun:
    """The run with the regressor of its links' motion."""
    s = run.signals
    arm = s.arm.with_bodies(s.link_position, s.link_velocity, s.link_acceleration)
    return replace(run, signals=replace(s, arm=arm))


def with_links(run: PreparedRun, robot: RobotModel, links: LinkMotion) -> PreparedRun:
    """The run, or its first samples, with another motion of its links."""
    if len(links.position) < len(run.time):
        run = run.until(len(links.position))
    signals = run.signals
    return replace(
        run,
        signals=replace(
            signals,
            link_position=links.position,
            link_velocity=links.velocity,
            link_acceleration=links.acceleration,
            transmitted_torque=links.torque,
            spring_torque=links.spring,
            windup=robot.windup(links.spring),
            drive_torque=signals.drive_torque - signals.transmitted_torque + links.torque,
        ),
    )
