"""Re-identified masses in sentences: by link, the best single body, and impossible masses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stiffopt.discovery.comparison.inertial_parameters import nominal_bodies
from stiffopt.discovery.signals import PARAMETERS_PER_BODY
from stiffopt.report.common.text import pm, significant
from stiffopt.report.diagnosis.overview import moved_bodies

if TYPE_CHECKING:
    from stiffopt.discovery.diagnosis import Diagnosis
    from stiffopt.report.diagnosis.overview import MovedBody

# Standard deviations from which a change of a mass or first moment is told.
_MIN_DEVIATIONS = 3.0
# Share of the gain of all bodies below which the best single body is no hint.
_MIN_SINGLE_SHARE = 0.25


def mass_sentences(diagnosis: Diagnosis) -> list[str]:
    """Return sentences on re-identified masses; none where nominal ones hold."""
    rigid = diagnosis.search.rigid
    if rigid is None or not rigid.freed:
        return []
    parts = [part for part in map(_link_phrase, moved_bodies(diagnosis)) if part]
    found = [f"Re-identified against nominal: {'; '.join(parts)}."] if parts else []
    return [*found, *_single_body_sentence(diagnosis), *_impossible_mass_sentences(diagnosis)]


def _link_phrase(body: MovedBody) -> str:
    """Return the determined changes of mass and first moment of a link, or ""."""
    names = {"m": "mass", "mx": "first moment x", "my": "first moment y", "mz": "first moment z"}
    shown = [
        f"{names[name]} {'+' if change > 0.0 else ''}{pm(change, sd, unit)}"
        for name, change, sd, unit in body.shown
        if name in names and abs(change) > _MIN_DEVIATIONS * sd
    ]
    return f"{body.link}: {', '.join(shown)}" if shown else ""


def _single_body_sentence(diagnosis: Diagnosis) -> list[str]:
    """Return the best single body with its share of what all free bodies gain."""
    rigid = diagnosis.search.rigid
    assert rigid is not None
    best = rigid.nearest
    if best is None or rigid.single is not None or rigid.nearest_share < _MIN_SINGLE_SHARE:
        return []
    constants = diagnosis.training.constants
    located = best.located
    if located.effect.tolerances != ("mass", "com"):
        return []
    values = best.amplitudes * located.sizes(constants)
    own = located.effect.parameters(values.tolist(), located.shapes, constants)
    link = constants.links[-1 if located.link is None else located.link]
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
