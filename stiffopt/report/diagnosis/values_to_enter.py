"""Sentences on values that a finding gives: those to enter in the nominal model, and masses."""

from __future__ import annotations

import numpy as np

from stiffopt.discovery.answer import missing_physics
from stiffopt.discovery.comparison.inertial_parameters import nominal_bodies
from stiffopt.discovery.comparison.nuisance import OutsideValue
from stiffopt.discovery.diagnosis import Diagnosis, Finding
from stiffopt.discovery.loop_fit import DRIVE_PARAMETERS
from stiffopt.discovery.names import ValueName
from stiffopt.discovery.sanity.doubt import format_numbers
from stiffopt.discovery.search.nominal_values import values_outside_tolerance
from stiffopt.discovery.settings import MAX_NOMINAL_DEVIATIONS
from stiffopt.discovery.signals import PARAMETERS_PER_BODY
from stiffopt.report.common.text import capital, pm, significant
from stiffopt.report.diagnosis.overview import MovedBody, moved_bodies
from stiffopt.units import joint_unit

# Kinds of nominal values in words.
_KIND_WORDS = {
    "mass": "mass behind",
    "com": "centre of mass behind",
    "torque_constant": "torque constant of",
    "coulomb": "dry friction of",
    "viscous": "viscous friction of",
    "rotor_inertia": "rotor inertia of",
    "stiffness": "compliance of",
    "joint_damping": "damping of",
    "encoder_zero": "encoder zero of",
}
_KIND_UNITS = {"com": "m", "encoder_zero": "rad"}


def value_sentences(diagnosis: Diagnosis) -> list[str]:
    """Return a sentence on every value to enter, and on nominal values pinned at tolerances."""
    stated = [f for f in diagnosis.findings if not f.located.calibrated]
    found = [_nominal_sentence(diagnosis, f) for f in stated if f.effect.nominal and f.joint]
    found += [_signals_sentence(diagnosis, f) for f in stated if f.effect.signals_key]
    return [*found, *map(_pinned_sentence, _values_outside(diagnosis))]


def farthest_value(diagnosis: Diagnosis) -> str:
    """Return the change of the nominal value that is farthest outside its tolerance, or ""."""
    return next(map(_pinned_change, _values_outside(diagnosis)), "")


def _values_outside(diagnosis: Diagnosis) -> tuple[OutsideValue, ...]:
    """Return nominal values outside their tolerances that no finding accounts for.

    Friction and rotors of a simulation from commands are told as it fits them: filtered position
    errors take what friction does at reversals for another value.
    """
    simulated = () if diagnosis.closed_loop is None else DRIVE_PARAMETERS
    outside = values_outside_tolerance(diagnosis.search.comparison, diagnosis.search.effects)
    return tuple(each for each in outside if each.name.kind not in simulated)


def _nominal_sentence(diagnosis: Diagnosis, finding: Finding) -> str:
    """Return the corrected nominal value of a joint, with the line to enter."""
    key, joint = finding.effect.nominal, finding.joint
    assert joint is not None
    nominal = np.asarray(getattr(diagnosis.training.robot, key), dtype=float)
    change = finding.parameters[0]
    corrected = nominal.copy()
    corrected[joint - 1] = float(f"{nominal[joint - 1] + change.value:.4g}")
    unit = joint_unit(change.unit, diagnosis.training.constants.joints[joint - 1].prismatic)
    tolerance = getattr(diagnosis.training.tolerance, key) or 0.0
    far = abs(change.value) / (tolerance * nominal[joint - 1]) if tolerance else np.inf
    beyond = f", {significant(far, 2)} tolerances off" if np.isfinite(far) else ""
    return (
        f"{_KIND_WORDS[key].capitalize()} joint {joint} is"
        f" {pm(corrected[joint - 1], change.sd, unit)}; nominal is"
        f" {significant(nominal[joint - 1], 3)} {unit}{beyond}. Enter"
        f" {key} = {format_numbers(corrected)} in [nominal]."
    )


def _signals_sentence(diagnosis: Diagnosis, finding: Finding) -> str:
    """Return the value of [signals] that undoes a finding."""
    key, change = finding.effect.signals_key, finding.parameters[0]
    stated = float(getattr(diagnosis.recordings.signals, key))
    return (
        f"{capital(missing_physics(diagnosis, finding))}. To diagnose the rest, enter"
        f" {key} = {stated + change.value:.4g} in [signals]."
    )


def _pinned_sentence(value: OutsideValue) -> str:
    """Return that a value is far outside its tolerance and no finding accounts for it."""
    most = MAX_NOMINAL_DEVIATIONS
    return (
        f"Nominal value pinned at its tolerance: {_pinned_change(value)},"
        f" {significant(abs(value.change) / value.tolerance, 2)} times its tolerance (a fit allows"
        f" {most:g}). Measure it, or look for another cause: a value so far off seldom is the only"
        " one."
    )


def _pinned_change(value: OutsideValue) -> str:
    words, unit = f"the {_value_words(value.name)} would have to", _KIND_UNITS.get(value.name.kind)
    if unit is None and value.change < -1.0:
        return f"{words} be below zero"
    factor, unit = (100.0, "%") if unit is None else (1.0, unit)
    size = f"{significant(factor * value.change, 2)} ± {significant(factor * value.sd, 1)} {unit}"
    return f"{words} change by {'+' * (unit == '%' and value.change > 0.0)}{size}"


def _value_words(name: ValueName) -> str:
    axis = f" along {name.part}" if name.kind == "com" else ""
    return f"{_KIND_WORDS.get(name.kind, f'{name.kind} of')} joint {name.place + 1}{axis}"


def change_words(name: ValueName, change: float) -> str:
    """Return a nominal value in words with its change, exactly enough to be entered."""
    unit = _KIND_UNITS.get(name.kind)
    size = f"{100.0 * change:+.4g} %" if unit is None else f"{change:+.4g} {unit}"
    return f"{_value_words(name)}, {size}"


# Standard deviations from which a change of a mass or first moment is told.
_MIN_DEVIATIONS = 3.0


def mass_sentences(diagnosis: Diagnosis) -> list[str]:
    """Return sentences on re-identified masses; none where nominal ones hold."""
    rigid = diagnosis.search.rigid
    if rigid is None or not rigid.freed:
        return []
    parts = [part for part in map(_link_phrase, moved_bodies(diagnosis)) if part]
    found = [f"Re-identified against nominal: {'; '.join(parts)}."] if parts else []
    return [*found, *_single_body_sentence(diagnosis), *_impossible_mass_sentences(diagnosis)]


def largest_moment_change(diagnosis: Diagnosis) -> str:
    """Return the link whose re-identified first moment changed most, with the change; or "".

    A first moment is the weight that a joint feels, of which masses alone say little.
    """
    moments = [
        (abs(value[1]), body.link, value)
        for body in moved_bodies(diagnosis)
        for value in _determined_changes(body)
        if value[0] != "m"
    ]
    if not moments:
        return ""
    _, link, value = max(moments)
    return f"{link}, {_change_phrase(value)}"


# Name, change, standard deviation and unit of an inertial parameter.
_Change = tuple[str, float, float, str]
_MASS_NAMES = {"m": "mass", **{f"m{axis}": f"first moment {axis}" for axis in "xyz"}}


def _determined_changes(body: MovedBody) -> list[_Change]:
    """Return the determined changes of mass and first moment of a link."""
    return [
        each
        for each in body.shown
        if each[0] in _MASS_NAMES and abs(each[1]) > _MIN_DEVIATIONS * each[2]
    ]


def _change_phrase(value: _Change) -> str:
    name, change, sd, unit = value
    return f"{_MASS_NAMES[name]} {'+' if change > 0.0 else ''}{pm(change, sd, unit)}"


def _link_phrase(body: MovedBody) -> str:
    """Return the determined changes of mass and first moment of a link, or ""."""
    shown = [_change_phrase(each) for each in _determined_changes(body)]
    return f"{body.link}: {', '.join(shown)}" if shown else ""


def _single_body_sentence(diagnosis: Diagnosis) -> list[str]:
    """Return the best single body with its share of what all free bodies gain."""
    rigid = diagnosis.search.rigid
    assert rigid is not None
    best = rigid.nearest
    # Share of the gain of all bodies below which the best single body is no hint.
    if best is None or rigid.single is not None or rigid.nearest_share < 0.25:
        return []
    constants = diagnosis.training.constants
    located = best.located
    body = located.changed_body(constants)
    if body is None:
        return []
    values = best.amplitudes * located.sizes(constants)
    own = located.effect.parameters(values.tolist(), located.shapes, constants)
    link = constants.links[body]
    moment = float(np.linalg.norm(values[1:4]))
    return [
        f"A single body of {own['dm']:+.2g} kg at {link}, first moment {significant(moment, 2)}"
        f" kg m, explains {100.0 * rigid.nearest_share:.0f} % of it."
    ]


def _impossible_mass_sentences(diagnosis: Diagnosis) -> list[str]:
    """Return a refusal of every mass below zero that the recordings ask for."""
    comparison = diagnosis.search.comparison
    if comparison.bodies is None:
        return []
    posterior = comparison.fit(diagnosis.search.effects, boxed=False).posterior
    place = np.arange(comparison.robot.n) * PARAMETERS_PER_BODY
    nominal = nominal_bodies(comparison.robot)[:, 0]
    change, sd = posterior.mean[place], np.sqrt(np.diag(posterior.covariance)[place])
    return [
        f"Refused: the recordings ask for {nominal[body] + change[body]:.2g} kg of"
        f" {diagnosis.training.constants.links[body]}, nominal {nominal[body]:.3g} kg. No body"
        " weighs less than nothing: check zero, sign and unit of the joints that carry it."
        for body in np.flatnonzero(nominal + change < -_MIN_DEVIATIONS * sd)
    ]
