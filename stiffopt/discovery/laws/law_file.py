"""Laws as a Python file of effects, which `stiffopt diagnose --effects` reads."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence

from stiffopt.discovery.laws.law import Law, describe_test, resembled
from stiffopt.discovery.laws.operators import OPERATOR_NAMES

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
    name={name},
    family="law",
    scope="joint",
    equation={equation_text},
    signature={words},
    term=term_{number},
    amplitudes=({amplitudes}),
    shapes=({shapes}),
    needs=({needs}, "moves"),
    couples_joints={couples},
    yields={yields},
    lags={lags},
    is_play={is_play},
    applies={applies},
    separate={separate},
)
'''


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
    bounds = [b for factor in law.factors for b in factor.bounds]
    return _LAW_TEMPLATE.format(
        number=number,
        equation=law.equation,
        values="\n    ".join(values),
        unpack=unpack,
        value=" + ".join(f"{key} * {formula}" for key, formula in formulas),
        place=law.place,
        added="at_joint(signals, value)" if law.of_robot else "value",
        name=json.dumps(name),
        equation_text=json.dumps(law.equation),
        words=json.dumps(law.words + resembled(law)),
        amplitudes="".join(
            f"Amplitude(name={json.dumps(key)}, unit={json.dumps(unit)},"
            f" scale={size!r}, lower=-50.0, upper=50.0), "
            for key, unit, size in law.amplitude_sizes(amplitudes)
        ).strip(),
        shapes="".join(
            f"Shape(name={json.dumps(key)}, unit={json.dumps(unit)}, starts=({value!r},),"
            f" lower={low!r}, upper={high!r}), "
            for key, unit, value, (low, high) in zip(
                law.shape_names, law.shape_units, law.shapes, bounds, strict=True
            )
        ).strip(),
        needs='"link"' if law.place == "deflection" else '"torque"',
        couples=law.of_robot,
        yields=law.yields,
        lags=law.lags,
        is_play=law.is_play,
        applies=f"lambda constants: constants.joint == {law.joint + 1}" if law.of_robot else None,
        separate=json.dumps(describe_test(law)),
    )
