"""Forms that a law may take in one signal, with fitted shapes.

A form is one NumPy formula in the signal `x` and its shapes: the equation of a report, the code of
a file of effects and the numbers of a fit all come from it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import numpy as np

from stiffopt.discovery.laws import operators
from stiffopt.discovery.laws.shapes import (
    FREQUENCY_SHAPE,
    HINGE_POWER_SHAPE,
    LAG_SHAPE,
    MODE_SHAPES,
    ORDER_SHAPE,
    PLACE_SHAPE,
    PLAY_SHAPE,
    SCALE_SHAPE,
    FormShape,
    centre,
    fixed,
    scale,
    width,
)
from stiffopt.symbolic import Quantity

# Imaginary step of complex-step derivatives: their error is its square.
_IMAGINARY_STEP = 1e-30
# Relative step of central differences, for formulas with comparisons.
_DIFFERENCE_STEP = 1e-6


@dataclass(frozen=True)
class Form:
    """Form of a law in one signal."""

    name: str
    # NumPy expressions in x, dt, before and the shapes, each of one amplitude.
    formulas: tuple[str, ...]
    words: str  # "{x}" is the signal
    shapes: tuple[FormShape, ...] = ()
    # Power of the signal's unit in the value of each formula: a number, or the shape that it is.
    unit_powers: tuple[int | str, ...] = (0,)
    analytic: bool = True  # False for formulas with comparisons, which have no complex derivative
    # True where no smooth function of the signal resembles it: with memory, or periodic.
    unscreened: bool = False
    has_memory: bool = False  # True where the value depends on earlier values of the signal
    # Name of a form of which this one is a special case; fitted where this one holds.
    general: str = ""
    resembles: str = ""  # known physics of such a form, for sentences; "" where there is none

    @cached_property
    def _functions(self) -> tuple[Callable[..., Any], ...]:
        names = ", ".join(["x", "dt", "before", *(s.name for s in self.shapes)])
        space = {"np": np, **{name: getattr(operators, name) for name in operators.OPERATOR_NAMES}}
        # The formulas are the constants below: one text is equation, code and function.
        return tuple(eval(f"lambda {names}: {each}", space) for each in self.formulas)

    def values(
        self, x: Quantity, dt: float, before: np.ndarray | None, shapes: Sequence[Quantity]
    ) -> list[Quantity]:
        """Return the values (K,) of every formula."""
        return [function(x, dt, before, *shapes) for function in self._functions]

    def derivatives(
        self, x: np.ndarray, dt: float, before: np.ndarray | None, shapes: Sequence[float]
    ) -> list[list[Any]]:
        """Return the derivative (K,) of every formula by every shape; exact where analytic."""
        found = []
        for i, value in enumerate(shapes):
            if self.analytic:
                moved: list[Any] = [*shapes]
                moved[i] = value + 1j * _IMAGINARY_STEP
                found.append(
                    [np.imag(v) / _IMAGINARY_STEP for v in self.values(x, dt, before, moved)]
                )
                continue
            step = _DIFFERENCE_STEP * max(abs(value), 1e-6)
            ends = []
            for side in (-step, step):
                moved = [*shapes]
                moved[i] = value + side
                ends.append(self.values(x, dt, before, moved))
            found.append([(b - a) / (2.0 * step) for a, b in zip(*ends, strict=True)])
        return [list(each) for each in zip(*found, strict=True)]


def _form_with_memory(name: str, formula: str, words: str, **entries: Any) -> Form:
    """Return a form that depends on the past of its signal."""
    return Form(
        name,
        (formula,),
        words,
        unit_powers=(1,),
        unscreened=True,
        has_memory=True,
        **entries,
    )


FORMS = {
    each.name: each
    for each in (
        Form("constant", ("(1.0 + 0.0 * x)",), "by a constant"),
        Form("linear", ("x",), "in proportion to the {x}", unit_powers=(1,)),
        Form(
            "offset",
            ("(x - c)",),
            "in proportion to the {x} from one value on, both ways",
            shapes=(centre("c", 0.25, 0.5, 0.75, beyond=1.0),),
            unit_powers=(1,),
            resembles="a spring or cable at rest at one place",
        ),
        Form(
            "stiffening",
            ("(x - c) * (1.0 + ((x - c) / s) ** 2)",),
            "with the {x} from one value on, both ways, ever more",
            shapes=(
                centre("c", 0.25, 0.5, 0.75, beyond=1.0),
                width("s", 0.7, least=0.1, most=10.0),
            ),
            unit_powers=(1,),
            resembles="a spring or cable that stiffens to both sides of one place",
        ),
        Form(
            "magnitude",
            ("np.abs(x)",),
            "with the magnitude of the {x}",
            unit_powers=(1,),
            general="rounded_magnitude",
        ),
        Form(
            "rounded_magnitude",
            ("(np.sqrt(x**2 + s**2) - s)",),
            "with the magnitude of the {x}, hardly at first",
            shapes=(scale("s", 0.1, least=1e-3),),
            unit_powers=(1,),
        ),
        Form(
            "square",
            ("x**2",),
            "with the square of the {x}",
            unit_powers=(2,),
            general="power",
        ),
        Form(
            "signed_square",
            ("x * np.abs(x)",),
            "with the square of the {x}, odd",
            unit_powers=(2,),
            general="signed_power",
            resembles="the drag of a fluid",
        ),
        Form(
            "power",
            ("(np.abs(x) + 1e-12) ** n",),
            "with a power of the magnitude of the {x}",
            unit_powers=("n",),
            shapes=(fixed("n", "", (0.5,), 0.2, 5.0),),
        ),
        Form(
            "signed_power",
            ("np.sign(x) * (np.abs(x) + 1e-12) ** n",),
            "with a power of the {x}, odd",
            unit_powers=("n",),
            shapes=(fixed("n", "", (0.5,), 0.05, 5.0),),
        ),
        Form(
            "saturating",
            ("np.tanh(x / s)",),
            "with the {x}, up to a limit",
            # Down to a switch, as of a backlash that the load crosses.
            shapes=(scale("s", 0.02, 0.1, 0.3, 1.0, least=1e-3),),
            resembles="a clutch, a seal or a controller at its limit",
        ),
        Form(
            "saturating_even",
            ("x**2 / (x**2 + s**2)",),
            "with the magnitude of the {x}, up to a limit",
            shapes=(SCALE_SHAPE,),
        ),
        Form(
            "fading",
            ("s**2 / (x**2 + s**2)",),
            "with the {x}: most at rest, and fading with its magnitude",
            shapes=(SCALE_SHAPE,),
            resembles="a film of lubricant that forms with speed",
        ),
        Form(
            "peaked",
            ("x / s / (1.0 + (np.abs(x) / s + 1e-12) ** n)",),
            "with the {x} up to a peak, and falls beyond it",
            shapes=(SCALE_SHAPE, fixed("n", "", (2.0, 4.0), 1.1, 8.0)),
            resembles="an eddy-current brake or a lubricant that thins",
        ),
        Form(
            "step",
            ("0.5 * (1.0 + np.tanh((x - c) / s))",),
            "by a step at one value of the {x}",
            shapes=(PLACE_SHAPE, width("s", 0.03, 0.15, 0.4)),
            resembles="a part that is touched or left at one place",
        ),
        Form(
            "step_down",
            ("0.5 * (1.0 - np.tanh((x - c) / s))",),
            "by a step down at one value of the {x}",
            shapes=(PLACE_SHAPE, width("s", 0.03, 0.15, 0.4)),
            resembles="a part that is touched or left at one place",
        ),
        Form(
            "bend",
            ("np.tanh((x - c) / s)",),
            "with the {x} from one value on, both ways, up to a limit",
            shapes=(PLACE_SHAPE, width("s", 0.15, 0.4, 1.0)),
            resembles="a hose or cable at rest at one place, which gives way",
        ),
        Form(
            "bump",
            ("np.exp(-0.5 * ((x - c) / s) ** 2)",),
            "near one value of the {x}",
            shapes=(PLACE_SHAPE, width("s", 0.05, 0.2)),
            resembles="a dent, a magnet or a tight place",
        ),
        Form(
            "hinge_above",
            ("0.5 * (x - c + np.sqrt((x - c) ** 2 + 1e-8))",),
            "in proportion to the {x} above one value",
            shapes=(PLACE_SHAPE,),
            unit_powers=(1,),
            general="power_above",
            resembles="a cable or spring that tightens from one place on",
        ),
        Form(
            "hinge_below",
            ("0.5 * (c - x + np.sqrt((x - c) ** 2 + 1e-8))",),
            "in proportion to the {x} below one value",
            shapes=(PLACE_SHAPE,),
            unit_powers=(1,),
            general="power_below",
            resembles="a cable or spring that tightens up to one place",
        ),
        Form(
            "power_above",
            ("(0.5 * (x - c + np.sqrt((x - c) ** 2 + 1e-8))) ** n",),
            "with a power of the {x} above one value",
            unit_powers=("n",),
            shapes=(PLACE_SHAPE, HINGE_POWER_SHAPE),
            resembles="a cable or spring that tightens from one place on",
        ),
        Form(
            "power_below",
            ("(0.5 * (c - x + np.sqrt((x - c) ** 2 + 1e-8))) ** n",),
            "with a power of the {x} below one value",
            unit_powers=("n",),
            shapes=(PLACE_SHAPE, HINGE_POWER_SHAPE),
            resembles="a cable or spring that tightens up to one place",
        ),
        Form(
            "lever",
            ("np.cos(x)", "np.sin(x)"),
            "as the projection of a lever that turns by the {x}",
            unit_powers=(0, 0),
            resembles="a weight, a spring or a drag at the end of a lever",
        ),
        Form(
            "harmonic",
            ("np.cos(k * x)", "np.sin(k * x)"),
            "periodically in the {x}",
            unit_powers=(0, 0),
            shapes=(ORDER_SHAPE,),
            unscreened=True,
            general="harmonic_overtone",
            resembles="teeth, rollers or magnets passing at that order",
        ),
        Form(
            "harmonic_overtone",
            ("np.cos(k * x)", "np.sin(k * x)", "np.cos(2.0 * k * x)", "np.sin(2.0 * k * x)"),
            "periodically in the {x}, with an overtone",
            unit_powers=(0, 0, 0, 0),
            shapes=(ORDER_SHAPE,),
            unscreened=True,
            general="harmonic_series",
            resembles="teeth, rollers or magnets passing at that order",
        ),
        Form(
            "harmonic_series",
            (
                *("np.cos(k * x)", "np.sin(k * x)", "np.cos(2.0 * k * x)", "np.sin(2.0 * k * x)"),
                *("np.cos(0.5 * k * x)", "np.sin(0.5 * k * x)"),
            ),
            "periodically in the {x}, with half and twice the order",
            unit_powers=(0, 0, 0, 0, 0, 0),
            shapes=(ORDER_SHAPE,),
            unscreened=True,
            resembles="a wave generator or cam with two lobes, which are not quite alike",
        ),
        Form(
            "wave",
            ("np.cos(2.0 * np.pi * f * x)", "np.sin(2.0 * np.pi * f * x)"),
            "periodically in the {x}",
            unit_powers=(0, 0),
            shapes=(FREQUENCY_SHAPE,),
            unscreened=True,
            general="wave_overtone",
            resembles="a pump or fan that runs by itself",
        ),
        Form(
            "wave_overtone",
            (
                "np.cos(2.0 * np.pi * f * x)",
                "np.sin(2.0 * np.pi * f * x)",
                "np.cos(4.0 * np.pi * f * x)",
                "np.sin(4.0 * np.pi * f * x)",
            ),
            "periodically in the {x}, with an overtone",
            unit_powers=(0, 0, 0, 0),
            shapes=(FREQUENCY_SHAPE,),
            unscreened=True,
            resembles="a pump or fan that runs by itself",
        ),
        Form(
            "decay",
            ("np.exp(-x / s)",),
            "exponentially less with the {x}",
            shapes=(scale("s", 0.1, 0.3, 1.0, least=0.01),),
            resembles="warming up",
        ),
        Form(
            "approach",
            ("(1.0 - np.exp(-x / s))",),
            "with the {x}, ever more slowly",
            shapes=(scale("s", 0.3, 1.0, least=0.01),),
            resembles="warming up",
        ),
        _form_with_memory(
            "lag",
            "lag(x, T, dt, before)",
            "with the {x}, late by a time constant",
            shapes=(LAG_SHAPE,),
            resembles="a viscous coupling or a creeping material",
        ),
        _form_with_memory(
            "slip",
            "(x - lag(x, T, dt, before))",
            "with the {x} relative to something that follows late by a time constant",
            shapes=(LAG_SHAPE,),
            resembles="a liquid or a loose ring that is taken along",
        ),
        _form_with_memory(
            "sprung",
            "sprung(x, f, zeta, dt, before)",
            "with the {x} of a hidden mass on a spring",
            shapes=MODE_SHAPES,
            resembles="something loose: a pendulum, a hose or a liquid",
        ),
        _form_with_memory(
            "mode",
            "mode(x, f, zeta, dt, before)",
            "with the {x}, as it deflects a hidden mass on a spring",
            shapes=MODE_SHAPES,
            resembles="a part that bends and rings: a bracket, a cover or a liquid",
        ),
        _form_with_memory(
            "loose",
            "(x - sprung(x, f, zeta, dt, before))",
            "with the {x} relative to that of a hidden mass on a spring",
            shapes=MODE_SHAPES,
            resembles="a part of the link that is not fixed to it: a pendulum, a hose or a liquid",
        ),
        _form_with_memory(
            "stop",
            "stop(x, r)",
            "with the {x} since the last reversal, up to a limit",
            shapes=(PLAY_SHAPE,),
            analytic=False,
            resembles="a seal or cable that sticks before it slides",
        ),
        _form_with_memory(
            "stops",
            # Limits spread evenly up to r (Iwan 1966): contacts slide one after the other.
            f"0.2 * ({' + '.join(f'stop(x, {share} * r)' for share in (0.1, 0.3, 0.5, 0.7, 0.9))})",
            "with the {x} since the last reversal, ever less up to a limit",
            shapes=(PLAY_SHAPE,),
            analytic=False,
            resembles="bolts, keys or splines that slide one after the other",
        ),
        _form_with_memory(
            "play",
            "(x - stop(x, r))",
            "with the {x}, which has to go beyond a play after every reversal",
            shapes=(PLAY_SHAPE,),
            analytic=False,
            resembles="a part that is taken along with play",
        ),
    )
}


@cache
def form_named(name: str) -> Form:
    """Return a form of `FORMS`, or the sum "one+other" of two, each with its own amplitudes.

    Raises `KeyError`: no form has such a name.
    """
    if "+" not in name:
        return FORMS[name]
    one, other = (FORMS[part] for part in name.split("+", 1))
    taken = {shape.name for shape in one.shapes}
    names = {s.name: f"{s.name}_2" if s.name in taken else s.name for s in other.shapes}
    return Form(
        name,
        (*one.formulas, *(substitute_names(each, names) for each in other.formulas)),
        f"{one.words}, plus {other.words}",
        shapes=(*one.shapes, *(replace(s, name=names[s.name]) for s in other.shapes)),
        unit_powers=(*one.unit_powers, *(names.get(str(n), n) for n in other.unit_powers)),
        analytic=one.analytic and other.analytic,
        unscreened=one.unscreened or other.unscreened,
        has_memory=one.has_memory or other.has_memory,
        resembles="; or ".join(dict.fromkeys(e.resembles for e in (one, other) if e.resembles)),
    )


def substitute_names(formula: str, names: dict[str, str]) -> str:
    """Replace whole names of a formula, those of functions excepted."""
    return re.sub(r"\b[A-Za-z_]\w*\b(?!\()", lambda m: names.get(m.group(), m.group()), formula)
