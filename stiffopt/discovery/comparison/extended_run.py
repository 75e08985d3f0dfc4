"""Runs predicted by an extended nominal model, with vibrating or quasi-static links."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stiffopt.discovery.comparison.extension_change import (
    added_inertia_along,
    extended_damping,
    extension_change,
    is_damping,
    link_moving_part,
    relative_compliance,
    select_calibration,
    spring_laws,
    with_changed_geometry,
)
from stiffopt.discovery.comparison.filtering import derivative
from stiffopt.discovery.comparison.located_effect import Extension
from stiffopt.discovery.comparison.nuisance import (
    BODY_VALUES,
    SPRING_VALUES,
    body_parameter_changes,
    spring_deflection,
)
from stiffopt.discovery.comparison.prepared_run import PreparedRun, with_link_torque
from stiffopt.discovery.comparison.vibration import LinkMotion, Vibration, slow_filter

# Passes of the link motion over effects, whose signals depend on it; nominal values need one.
_EFFECT_PASSES = 2

# Cached extensions per run: the next one often differs in drive values alone.
_MAX_CACHED_RUNS = 2


def simulate_links(run: PreparedRun, extension: Extension) -> PreparedRun:
    """Return a run whose links vibrate with an extension, without its drive torques.

    Contributions to readings are left out too.

    `run`: run with the nominal model and its vibration.

    Where no such motion is found, as in a fit far from the solution, nominal values are applied to
    first order, and effects too where that does not suffice.
    """
    moving = link_moving_part([run], extension)
    if moving.empty:
        return run
    effects = ((e.located.key, e.amplitudes) for e in moving.effects)
    key = (*moving.calibration.items(), *effects)
    if key not in run.extension_cache:
        while len(run.extension_cache) >= _MAX_CACHED_RUNS:
            run.extension_cache.pop(next(iter(run.extension_cache)))
        found = _simulate_with_fallback(with_changed_geometry(run, moving), moving)
        run.extension_cache[key] = found
        assert found.vibration is not None
        # What follows is linearised anew, about the motion found.
        found.vibration.response.release_steps()
    return run.extension_cache[key]


def _simulate_with_fallback(run: PreparedRun, extension: Extension) -> PreparedRun:
    found = _solve_links(run, extension)
    if found is not None:
        return found
    values = replace(extension, effects=())
    if extension.effects and not values.empty:
        found = _solve_links(run, replace(extension, calibration={}))
        if found is not None:
            return _extend_to_first_order(found, values)
    return _extend_to_first_order(run, extension)


def _solve_links(run: PreparedRun, extension: Extension) -> PreparedRun | None:
    """Return the run whose links vibrate with an extension; None where no motion is found.

    Springs and damping are those of the new motion; regressors are taken about the previous one,
    and the rest of the body torques by the added inertia. The vibration response of the result is a
    nearby one.
    """
    assert run.vibration is not None
    laws, rest = spring_laws(run, extension)
    springs = run.springs(extended_damping(run, extension), laws)
    bodies = select_calibration(extension, BODY_VALUES)
    sprung = replace(
        extension,
        calibration=select_calibration(extension, SPRING_VALUES).calibration,
        effects=tuple(e for e in rest.effects if not is_damping(e)),
    )
    effects = replace(sprung, calibration={})
    added_inertia = added_inertia_along(run, effects)
    nominal = relative_compliance(run, replace(sprung, effects=()))
    vibration = springs.linearise(
        run.links, nominal * relative_compliance(run, effects), added_inertia, run.vibration
    )
    begin = _slow_link_motion(run, extension, vibration)
    moved = run
    for again in range(_EFFECT_PASSES if effects.effects else 1):
        weight = extension_change(moved, bodies).link_torque

        def compliance_ratio(links: LinkMotion, moved: PreparedRun = moved) -> np.ndarray:
            now = relative_compliance(with_link_motion(moved, links), effects)
            return np.asarray(nominal[: len(now)] * now)

        def added(
            links: LinkMotion, moved: PreparedRun = moved, weight: np.ndarray = weight
        ) -> tuple[np.ndarray, np.ndarray]:
            known = len(links.position)
            elastic = springs.motor[:known] - links.position - springs.play(links)
            displaced = spring_deflection(
                run.signals.constants, sprung.calibration, elastic, links.spring
            )
            torque = weight[:known]
            if effects.effects:
                change = extension_change(with_link_motion(moved, links), effects)
                torque, displaced = torque + change.link_torque, displaced + change.deflection
            if isinstance(added_inertia, np.ndarray):
                away = links.acceleration - moved.signals.link_acceleration[:known]
                torque = torque + (added_inertia[:known] @ away[..., None])[..., 0]
            return torque, displaced

        links = (
            springs.solve(moved.links, vibration, begin, added, compliance_ratio)
            if again
            else springs.solve_from_slow(
                begin, vibration, added, compliance_ratio, run.initial_state
            )
        )
        if links is None:
            return None
        moved = with_link_motion(moved, links)
        if isinstance(added_inertia, np.ndarray):
            moved = _with_own_regressor(moved)
    return replace(
        moved,
        vibration=vibration,
        added_deflection=springs.motor - moved.signals.link_position - moved.signals.windup,
    )


def _slow_link_motion(run: PreparedRun, extension: Extension, vibration: Vibration) -> LinkMotion:
    """Return the slow motion of the links with an extension."""
    assert run.vibration is not None
    slow = run.vibration.reference
    here = with_link_motion(run, slow)
    if any(e.effect.family == "inertial" for e in extension.effects):
        here = _with_own_regressor(here)
    change = extension_change(here, extension)
    low_pass = slow_filter(run.signals.dt)
    wound = low_pass(change.link_torque / vibration.carrying_stiffness + change.deflection)
    rate = derivative(wound, run.signals.dt)
    return slow.shifted(-wound, -rate, -derivative(rate, run.signals.dt))


def _extend_to_first_order(run: PreparedRun, extension: Extension) -> PreparedRun:
    """Return the run with an extension to first order."""
    assert run.vibration is not None
    change = extension_change(run, extension)
    ((torque, deflection),) = run.vibration.respond([(change.link_torque, change.deflection)])
    assert torque is not None
    assert deflection is not None
    signals = replace(run.signals, drive_torque=run.signals.drive_torque + torque)
    return replace(run, signals=signals, added_deflection=run.added_deflection + deflection)


def _with_own_regressor(run: PreparedRun) -> PreparedRun:
    """Return the run with the body regressor of its own link motion."""
    s = run.signals
    arm = s.arm.with_bodies(s.link_position, s.link_velocity, s.link_acceleration)
    return replace(run, signals=replace(s, arm=arm))


def with_link_motion(run: PreparedRun, links: LinkMotion) -> PreparedRun:
    """Return the run, or its first samples, with another link motion."""
    if len(links.position) < len(run.time):
        run = run.head(len(links.position))
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
            windup=run.robot.windup(links.spring),
            drive_torque=signals.drive_torque - signals.transmitted_torque + links.torque,
        ),
    )


def extend_run(run: PreparedRun, *extensions: Extension) -> PreparedRun:
    """Return a run whose nominal torques and wind-up include extensions.

    `run`: run with the nominal model. `extensions`: each on top of those before it.

    Where links vibrate, they do so with all changes of stiffness and inertia. Otherwise terms are
    evaluated with the extended spring torque, as in the fit; the joints wind up by the exact law
    under it.
    """
    if run.vibration is None:
        for extension in extensions:
            run = _extend_static_run(run, extension)
        return run
    whole = Extension()
    for extension in extensions:
        whole = whole.plus(extension)
    if whole.empty:
        return run
    moved = simulate_links(run, whole)
    change = extension_change(moved, whole)
    drive = moved.signals.drive_torque + run.motion_filter(change.torque)
    rate = derivative(run.low_pass(drive), moved.signals.dt)
    return replace(
        moved,
        signals=replace(moved.signals, drive_torque=drive, drive_torque_rate=rate),
        added_deflection=moved.added_deflection + change.reading,
    )


def linearise_run(
    run: PreparedRun, start: Extension, found: Extension
) -> tuple[PreparedRun, np.ndarray | float, np.ndarray | float]:
    """Return a run about an extension, for nonlinear springs and changed modes.

    `run`: run with the nominal model. `start`: extension that is included in the prediction as a
    whole. `found`: extension of which only link motions are included. Returns `torque`,
    `deflection` (K, n): contribution of the found amplitudes by the columns about this run, which
    its prediction contains already [N m], [rad].
    """
    if start.empty and found.empty:
        return run, 0.0, 0.0
    if run.vibration is None:
        base = with_changed_geometry(extend_run(run, start), found)
        change = extension_change(base, found)
        if not change.link_torque.any():
            return base, 0.0, 0.0
        bent = with_link_torque(base, change.link_torque)
        compliance = run.robot.compliance(bent.signals.spring_torque)
        bent, more = _about_changed_bodies(bent, found)
        own = change.link_torque + more
        return bent, own, compliance * own
    whole = start.plus(found)
    moved = simulate_links(run, whole)
    laws, rest = spring_laws(moved, whole)
    softer = relative_compliance(moved, rest)
    heavier = added_inertia_along(moved, whole)
    springs = moved.springs(extended_damping(run, whole), laws)
    own = springs.linearise(moved.links, softer, heavier, moved.vibration)
    moved = replace(moved, vibration=own, play=springs.play(moved.links))
    change = extension_change(moved, found)
    ((torque, deflection),) = moved.respond([(change.link_torque, change.deflection)])
    assert torque is not None
    assert deflection is not None
    if not start.empty:
        stated = extension_change(moved, start)
        drive = moved.signals.drive_torque + run.motion_filter(stated.torque)
        moved = replace(
            moved,
            signals=replace(moved.signals, drive_torque=drive),
            added_deflection=moved.added_deflection + stated.reading,
        )
    return moved, torque, deflection


def _about_changed_bodies(
    run: PreparedRun, found: Extension
) -> tuple[PreparedRun, np.ndarray | float]:
    """Return a run whose effects are of the bodies found, and by how much these differ (K, n).

    Turned gravity and joint zeros act on the weight of these bodies, not of the nominal ones.
    """
    bodies = body_parameter_changes(run.robot, select_calibration(found, BODY_VALUES).calibration)
    if not bodies.any():
        return run, 0.0
    signals = run.signals
    about = replace(run, signals=replace(signals, arm=signals.arm.with_changed_bodies(bodies)))
    effects = replace(found, calibration={})
    own, nominal = (extension_change(each, effects).link_torque for each in (about, run))
    return about, own - nominal


def _extend_static_run(run: PreparedRun, extension: Extension) -> PreparedRun:
    """Return the run with an extension, links quasi-static."""
    run = with_changed_geometry(run, extension)
    bent = with_link_torque(run, extension_change(run, extension).link_torque)
    change = extension_change(bent, extension)
    wound = with_link_torque(run, change.link_torque).signals
    drive = wound.drive_torque + change.torque
    return replace(
        run,
        signals=replace(
            wound, drive_torque=drive, drive_torque_rate=derivative(run.low_pass(drive), wound.dt)
        ),
        added_deflection=run.added_deflection + change.deflection + change.reading,
    )
