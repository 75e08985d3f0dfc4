"""Read laws and residual tables of an extended.toml."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stiffopt.discovery.comparison.located_effect import EstimatedEffect, LocatedEffect
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.extended.schema import EffectSection, LawFactorSection, ResidualSection
from stiffopt.discovery.laws.forms import FORMS, form_named
from stiffopt.discovery.laws.law import Factor, Law, law_effect
from stiffopt.discovery.laws.sources import SOURCE_KINDS, LawSource
from stiffopt.discovery.laws.table import ResidualTable
from stiffopt.errors import InputFileError, nearest


def read_law(section: EffectSection, joints: int, path: object, where: str) -> Effect:
    """Return the effect of a law that the file itself defines."""
    assert section.law is not None
    factors = tuple(
        _read_factor(each, joints, path, f"{where}.law.factors[{number}]")
        for number, each in enumerate(section.law.factors, start=1)
    )
    law = Law((section.joint or 1) - 1, section.law.place, factors)
    names = [*law.amplitude_names, *law.shape_names]
    if sorted(names) != sorted(section.term):
        raise InputFileError(path, f"{where}.term", f"the law needs exactly {', '.join(names)}.")
    law = law.with_shapes([section.term[name] for name in law.shape_names])
    effect = law_effect(law, [section.term[name] for name in law.amplitude_names])
    return replace(effect, name=section.name)


def read_table(section: ResidualSection, joints: int, path: object, where: str) -> EstimatedEffect:
    """Return a residual table as an effect of weight 1."""
    if not 1 <= section.joint <= joints:
        raise InputFileError(path, f"{where}.joint", f"is {section.joint}, there are {joints}.")
    if len(section.values) != len(section.at) or np.any(np.diff(section.at) <= 0.0):
        raise InputFileError(path, f"{where}.at", "needs rising values, one for each of `values`.")
    table = ResidualTable(
        joint=section.joint - 1,
        place=section.place,
        carrier=tuple(
            _read_factor(each, joints, path, f"{where}.times[{number}]")
            for number, each in enumerate(section.times, start=1)
        ),
        source=_read_factor(section.signal, joints, path, f"{where}.signal").source,
        at=section.at,
        values=section.values,
    )
    located = LocatedEffect(effect=table.effect, joint=table.joint)
    return EstimatedEffect(located=located, amplitudes=(1.0,))


def _read_factor(section: LawFactorSection, joints: int, path: object, where: str) -> Factor:
    forms = [("form", part, [*FORMS]) for part in section.form.split("+", 1)]
    for key, value, known in (("signal", section.signal, [*SOURCE_KINDS]), *forms):
        if value not in known:
            raise InputFileError(
                path, f"{where}.{key}", f"no {key} {value!r}. {nearest(value, known)}"
            )
    needed, given = SOURCE_KINDS[section.signal].per_joint, section.joint
    if needed != (given is not None) or (given is not None and not 1 <= given <= joints):
        allowed = f"needs a joint, 1 to {joints}" if needed else "has no joint"
        raise InputFileError(path, f"{where}.joint", f"{section.signal} {allowed}.")
    shapes = [shape.name for shape in form_named(section.form).shapes]
    if len(section.bounds) != len(shapes):
        raise InputFileError(
            path, f"{where}.bounds", f"needs one pair for each of: {', '.join(shapes) or 'none'}."
        )
    middle = tuple(0.5 * (low + high) for low, high in section.bounds)
    source = LawSource(section.signal, None if given is None else given - 1)
    return Factor(source, section.form, middle, section.bounds)
