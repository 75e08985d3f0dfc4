"""Laws as a Python file of effects, which `stiffopt diagnose --effects` reads."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

from stiffopt.discovery.effect import Amplitude, Shape
from stiffopt.discovery.laws.law import Law, law_effect
from stiffopt.discovery.laws.operators import OPERATOR_NAMES

_AMPLITUDE_FIELDS = ("name", "unit", "scale", "lower", "upper")
_SHAPE_FIELDS = ("name", "unit", "starts", "lower", "upper")
# (name of the effect, law, amplitudes, reported value and standard deviation by name)
WrittenLaw = tuple[str, Law, Sequence[float], Mapping[str, tuple[float, float]]]

_HEAD_TEMPLATE = '''"""Laws that a diagnosis of {name} found beyond the catalogue.

Ask whether another robot has them too: stiffopt diagnose SET --effects law.py
"""

import numpy as np

from stiffopt.discovery.effect import Amplitude, Effect, Shape, Term
from stiffopt.discovery.laws.law import at_joint
{operators}'''
_LAW_TEMPLATE = '''

def term_{number}(signals, amplitudes, shapes):
    """{equation}

    {values}
    """
{unpack}    value = {value}
    return Term({place}={added})


LAW_{number} = Effect(
{fields}
    term=term_{number},
    applies={applies},
    amplitudes=(
{amplitudes}
    ),
    shapes=({shapes}),
)
'''
# Fields of an effect that are texts or truth values, and that files state.
_PLAIN_FIELDS = (
    *("name", "family", "scope", "equation", "signature", "title", "phrase", "remedy", "separate"),
    *("needs", "couples_joints", "yields", "lags", "is_play"),
)


def law_file_text(name: str, laws: Sequence[WrittenLaw]) -> str:
    """Return the content of a file of effects.

    `name`: recording set. `laws` (name, Law, amplitudes, reported values).
    """
    formulas = " ".join(each for _, law, _, _ in laws for each in law.formulas(code=True))
    used = sorted(set(re.findall(rf"\b({'|'.join(OPERATOR_NAMES)})\(", formulas)))
    operators = f"from stiffopt.discovery.laws.operators import {', '.join(used)}\n" if used else ""
    parts = [_HEAD_TEMPLATE.format(name=name, operators=operators)]
    parts += [_format_law(number, *each) for number, each in enumerate(laws, start=1)]
    return "".join(parts)


def _format_law(
    number: int,
    name: str,
    law: Law,
    amplitudes: Sequence[float],
    reported: Mapping[str, tuple[float, float]],
) -> str:
    units = dict(zip(law.amplitude_names, law.amplitude_units, strict=True))
    units |= dict(zip(law.shape_names, law.shape_units, strict=True))
    values = [
        f"{key} = {value!r} +- {sd:.2g} {units.get(key, '')}".rstrip()
        for key, (value, sd) in reported.items()
    ]
    unpack = f"    ({', '.join(law.amplitude_names)},) = amplitudes\n"
    if law.shapes:
        unpack += f"    ({', '.join(law.shape_names)},) = shapes\n"
    formulas = zip(law.amplitude_names, law.formulas(code=True), strict=True)
    effect = replace(law_effect(law, amplitudes), name=name)
    return _LAW_TEMPLATE.format(
        number=number,
        equation=law.equation,
        values="\n    ".join(values),
        unpack=unpack,
        value=" + ".join(f"{key} * {formula}" for key, formula in formulas),
        place=law.place,
        added="at_joint(signals, value)" if law.of_robot else "value",
        fields="\n".join(f"    {key}={getattr(effect, key)!r}," for key in _PLAIN_FIELDS),
        applies=f"lambda constants: constants.joint == {law.joint + 1}" if law.of_robot else None,
        amplitudes="\n".join(
            f"        {_call(each, _AMPLITUDE_FIELDS)}," for each in effect.amplitudes
        ),
        shapes="".join(f"\n        {_call(each, _SHAPE_FIELDS)}," for each in effect.shapes)
        + "\n    " * bool(effect.shapes),
    )


def _call(entry: Amplitude | Shape, fields: Sequence[str]) -> str:
    """Return the code that makes an entry with some of its fields."""
    given = ", ".join(f"{key}={getattr(entry, key)!r}" for key in fields)
    return f"{type(entry).__name__}({given})"
