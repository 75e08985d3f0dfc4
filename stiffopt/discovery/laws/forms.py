"""Forms that a law may take in one signal, with fitted shapes.

A form is one NumPy formula in the signal `x` and its shapes: the equation of a report, the code of
a file of effects and the numbers of a fit all come from it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

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

Symmetry = Literal["odd", "even", "none"]
# Imaginary step of complex-step derivatives: their error is its square.
_IMAGINARY_STEP = 1e-30
# Relative step of central differences, for formulas with comparisons.
_DIFFERENCE_STEP = 1e-6


@dataclass(frozen=True, kw_only=True)
class Form:
    """Form of a law in one signal."""

    name: str
    formulas: tuple[str, ...]  # NumPy expressions in x, dt and the shapes, one for each amplitude
    words: str  # "{x}" is the signal
    symmetry: Symmetry = "none"  # in the signal
    shapes: tuple[FormShape, ...] = ()
    in_signal: bool = False  # True where the value has the unit of the signal
    analytic: bool = True  # False for formulas with comparisons, which have no complex derivative
    # True where no smooth function of the signal resembles it: with memory, or periodic.
    unscreened: bool = False
    has_memory: bool = False  # True where the value depends on earlier values of the signal
    # Name of a form of which this one is a special case; fitted where this one holds.
    general: str = ""
    resembles: str = ""  # known physics of such a form, for sentences; "" where there is none

    @cached_property
    def _functions(self) -> tuple[Callable[..., Any], ...]:
        names = ", ".join(["x", "dt", *(s.name for s in self.shapes)])
        space = {"np": np, **{name: getattr(operators, name) for name in operators.OPERATOR_NAMES}}
        # The formulas are the constants below: one text is equation, code and function.
        return tuple(eval(f"lambda {names}: {each}", space) for each in self.formulas)

    def values(self, x: Quantity, dt: float, shapes: Sequence[Quantity]) -> list[Quantity]:
        """Return the values (K,) of every formula."""
        return [function(x, dt, *shapes) for function in self._functions]

    def derivatives(self, x: np.ndarray, dt: float, shapes: Sequence[float]) -> list[list[Any]]:
        """Return the derivative (K,) of every formula by every shape; exact where analytic."""
        found = []
        for i, value in enumerate(shapes):
            if self.analytic:
                moved: list[Any] = [*shapes]
                moved[i] = value + 1j * _IMAGINARY_STEP
                found.append([np.imag(v) / _IMAGINARY_STEP for v in self.values(x, dt, moved)])
                continue
            step = _DIFFERENCE_STEP * max(abs(value), 1e-6)
            ends = []
            for side in (-step, step):
                moved = [*shapes]
                moved[i] = value + side
                ends.append(self.values(x, dt, moved))
            found.append([(b - a) / (2.0 * step) for a, b in zip(*ends, strict=True)])
        return [list(each) for each in zip(*found, strict=True)]


def _form_with_memory(*, formula: str, **entries: Any) -> Form:
    """Return a form that depends on the past of its signal, and on its sign as the signal does."""
    return Form(
        formulas=(formula,),
        symmetry="odd",
        in_signal=True,
        unscreened=True,
        has_memory=True,
        **entries,
    )


FORMS = {
    each.name: each
    for each in (
        Form(
            name="linear",
            formulas=("x",),
            words="in proportion to the {x}",
            symmetry="odd",
            in_signal=True,
        ),
        Form(
            name="offset",
            formulas=("(x - c)",),
            words="in proportion to the {x} from one value on, both ways",
            shapes=(FormShape(name="c", unit="signal", **centre(0.25, 0.5, 0.75, beyond=1.0)),),
            in_signal=True,
            general="stiffening",
            resembles="a spring or cable at rest at one place",
        ),
        Form(
            name="stiffening",
            formulas=("(x - c) * (1.0 + ((x - c) / s) ** 2)",),
            words="with the {x} from one value on, both ways, ever more",
            shapes=(
                FormShape(name="c", unit="signal", **centre(0.5, beyond=1.0)),
                FormShape(name="s", unit="signal", **width(0.7, least=0.1, most=10.0)),
            ),
            in_signal=True,
            resembles="a spring or cable that stiffens to both sides of one place",
        ),
        Form(
            name="magnitude",
            formulas=("np.abs(x)",),
            words="with the magnitude of the {x}",
            symmetry="even",
            in_signal=True,
            general="rounded_magnitude",
        ),
        Form(
            name="rounded_magnitude",
            formulas=("(np.sqrt(x**2 + s**2) - s)",),
            words="with the magnitude of the {x}, hardly at first",
            symmetry="even",
            shapes=(FormShape(name="s", unit="signal", **scale(0.1, least=1e-3)),),
            in_signal=True,
        ),
        Form(
            name="power",
            formulas=("np.exp(n * np.log(np.abs(x) + 1e-12))",),
            words="with a power of the magnitude of the {x}",
            symmetry="even",
            shapes=(FormShape(name="n", unit="", **fixed((0.5, 2.0), 0.2, 5.0)),),
        ),
        Form(
            name="signed_power",
            formulas=("np.sign(x) * np.exp(n * np.log(np.abs(x) + 1e-12))",),
            words="with a power of the {x}, odd",
            symmetry="odd",
            shapes=(FormShape(name="n", unit="", **fixed((0.5, 2.0), 0.05, 5.0)),),
        ),
        Form(
            name="saturating",
            formulas=("np.tanh(x / s)",),
            words="with the {x}, up to a limit",
            symmetry="odd",
            shapes=(SCALE_SHAPE,),
            resembles="a clutch, a seal or a controller at its limit",
        ),
        Form(
            name="saturating_even",
            formulas=("x**2 / (x**2 + s**2)",),
            words="with the magnitude of the {x}, up to a limit",
            symmetry="even",
            shapes=(SCALE_SHAPE,),
        ),
        Form(
            name="fading",
            formulas=("s**2 / (x**2 + s**2)",),
            words="with the {x}: most at rest, and fading with its magnitude",
            symmetry="even",
            shapes=(SCALE_SHAPE,),
            resembles="a film of lubricant that forms with speed",
        ),
        Form(
            name="peaked",
            formulas=("x / s / (1.0 + np.exp(n * np.log(np.abs(x) / s + 1e-12)))",),
            words="with the {x} up to a peak, and falls beyond it",
            symmetry="odd",
            shapes=(
                SCALE_SHAPE,
                FormShape(name="n", unit="", **fixed((2.0, 4.0), 1.1, 8.0)),
            ),
            resembles="an eddy-current brake or a lubricant that thins",
        ),
        Form(
            name="step",
            formulas=("0.5 * (1.0 + np.tanh((x - c) / s))",),
            words="by a step at one value of the {x}",
            shapes=(PLACE_SHAPE, FormShape(name="s", unit="signal", **width(0.03, 0.15, 0.4))),
            resembles="a part that is touched or left at one place",
        ),
        Form(
            name="step_down",
            formulas=("0.5 * (1.0 - np.tanh((x - c) / s))",),
            words="by a step down at one value of the {x}",
            shapes=(PLACE_SHAPE, FormShape(name="s", unit="signal", **width(0.03, 0.15, 0.4))),
            resembles="a part that is touched or left at one place",
        ),
        Form(
            name="bend",
            formulas=("np.tanh((x - c) / s)",),
            words="with the {x} from one value on, both ways, up to a limit",
            shapes=(PLACE_SHAPE, FormShape(name="s", unit="signal", **width(0.15, 0.4, 1.0))),
            resembles="a hose or cable at rest at one place, which gives way",
        ),
        Form(
            name="bump",
            formulas=("np.exp(-0.5 * ((x - c) / s) ** 2)",),
            words="near one value of the {x}",
            shapes=(PLACE_SHAPE, FormShape(name="s", unit="signal", **width(0.05, 0.2))),
            resembles="a dent, a magnet or a tight place",
        ),
        Form(
            name="hinge_above",
            formulas=("0.5 * (x - c + np.sqrt((x - c) ** 2 + 1e-8))",),
            words="in proportion to the {x} above one value",
            shapes=(PLACE_SHAPE,),
            in_signal=True,
            general="power_above",
            resembles="a cable or spring that tightens from one place on",
        ),
        Form(
            name="hinge_below",
            formulas=("0.5 * (c - x + np.sqrt((x - c) ** 2 + 1e-8))",),
            words="in proportion to the {x} below one value",
            shapes=(PLACE_SHAPE,),
            in_signal=True,
            general="power_below",
            resembles="a cable or spring that tightens up to one place",
        ),
        Form(
            name="power_above",
            formulas=("np.exp(n * np.log(0.5 * (x - c + np.sqrt((x - c) ** 2 + 1e-8))))",),
            words="with a power of the {x} above one value",
            shapes=(PLACE_SHAPE, HINGE_POWER_SHAPE),
            resembles="a cable or spring that tightens from one place on",
        ),
        Form(
            name="power_below",
            formulas=("np.exp(n * np.log(0.5 * (c - x + np.sqrt((x - c) ** 2 + 1e-8))))",),
            words="with a power of the {x} below one value",
            shapes=(PLACE_SHAPE, HINGE_POWER_SHAPE),
            resembles="a cable or spring that tightens up to one place",
        ),
        Form(
            name="harmonic",
            formulas=("np.cos(k * x)", "np.sin(k * x)"),
            words="periodically in the {x}",
            shapes=(ORDER_SHAPE,),
            unscreened=True,
            general="harmonic_overtone",
            resembles="teeth, rollers or magnets passing at that order",
        ),
        Form(
            name="harmonic_overtone",
            formulas=(
                "np.cos(k * x)",
                "np.sin(k * x)",
                "np.cos(2.0 * k * x)",
                "np.sin(2.0 * k * x)",
            ),
            words="periodically in the {x}, with an overtone",
            shapes=(ORDER_SHAPE,),
            unscreened=True,
            resembles="teeth, rollers or magnets passing at that order",
        ),
        Form(
            name="wave",
            formulas=("np.cos(2.0 * np.pi * f * x)", "np.sin(2.0 * np.pi * f * x)"),
            words="periodically in the {x}",
            shapes=(FREQUENCY_SHAPE,),
            unscreened=True,
            general="wave_overtone",
            resembles="a pump or fan that runs by itself",
        ),
        Form(
            name="wave_overtone",
            formulas=(
                "np.cos(2.0 * np.pi * f * x)",
                "np.sin(2.0 * np.pi * f * x)",
                "np.cos(4.0 * np.pi * f * x)",
                "np.sin(4.0 * np.pi * f * x)",
            ),
            words="periodically in the {x}, with an overtone",
            shapes=(FREQUENCY_SHAPE,),
            unscreened=True,
            resembles="a pump or fan that runs by itself",
        ),
        Form(
            name="decay",
            formulas=("np.exp(-x / s)",),
            words="exponentially less with the {x}",
            shapes=(FormShape(name="s", unit="signal", **scale(0.1, 0.3, 1.0, least=0.01)),),
            resembles="warming up",
        ),
        Form(
            name="approach",
            formulas=("(1.0 - np.exp(-x / s))",),
            words="with the {x}, ever more slowly",
            shapes=(FormShape(name="s", unit="signal", **scale(0.3, 1.0, least=0.01)),),
            resembles="warming up",
        ),
        _form_with_memory(
            name="lag",
            formula="lag(x, T, dt)",
            words="with the {x}, late by a time constant",
            shapes=(LAG_SHAPE,),
            resembles="a viscous coupling or a creeping material",
        ),
        _form_with_memory(
            name="slip",
            formula="(x - lag(x, T, dt))",
            words="with the {x} relative to something that follows late by a time constant",
            shapes=(LAG_SHAPE,),
            resembles="a liquid or a loose ring that is taken along",
        ),
        _form_with_memory(
            name="sprung",
            formula="sprung(x, f, z, dt)",
            words="with the {x} of a hidden mass on a spring",
            shapes=MODE_SHAPES,
            resembles="something loose: a pendulum, a hose or a liquid",
        ),
        _form_with_memory(
            name="mode",
            formula="mode(x, f, z, dt)",
            words="with the {x}, as it deflects a hidden mass on a spring",
            shapes=MODE_SHAPES,
            resembles="a part that bends and rings: a bracket, a cover or a liquid",
        ),
        _form_with_memory(
            name="loose",
            formula="(x - sprung(x, f, z, dt))",
            words="with the {x} relative to that of a hidden mass on a spring",
            shapes=MODE_SHAPES,
            resembles="a part of the link that is not fixed to it: a pendulum, a hose or a liquid",
        ),
        _form_with_memory(
            name="stop",
            formula="stop(x, r)",
            words="with the {x} since the last reversal, up to a limit",
            shapes=(PLAY_SHAPE,),
            analytic=False,
            resembles="a seal or cable that sticks before it slides",
        ),
        _form_with_memory(
            name="play",
            formula="(x - stop(x, r))",
            words="with the {x}, which has to go beyond a play after every reversal",
            shapes=(PLAY_SHAPE,),
            analytic=False,
            resembles="a part that is taken along with play",
        ),
    )
}
