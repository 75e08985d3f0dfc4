"""A law: product of forms of signals, times fitted amplitudes, in one channel of one joint."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from string import ascii_uppercase
from typing import Literal

import numpy as np

from stiffopt.discovery.effect import Amplitude, Effect, Shape, Term
from stiffopt.discovery.laws.forms import Form, form_named, substitute_names
from stiffopt.discovery.laws.shapes import FREQUENCY_SHAPE, SignalRange
from stiffopt.discovery.laws.sources import SOURCE_KINDS, LawSource
from stiffopt.discovery.signals import JointSignals, RobotSignals
from stiffopt.symbolic import Quantity

# Family of the effects that are laws.
LAW_FAMILY = "law"

Place = Literal["drive_torque", "link_torque", "deflection"]
# Symbols and units of what a law adds to.
_PLACE_SYMBOLS = {"drive_torque": "tau_{}", "link_torque": "T_{}", "deflection": "phi_{}"}
_PLACE_UNITS = {"drive_torque": "N m", "link_torque": "N m", "deflection": "rad"}
_PLACE_WORDS = {
    "drive_torque": "the drive torque of joint {}",
    "link_torque": "the torque on the link of joint {}",
    "deflection": "the deflection of joint {}",
}


@dataclass(frozen=True)
class Factor:
    """One factor of a law."""

    source: LawSource
    form: str  # as of `form_named`
    shapes: tuple[float, ...] = ()
    bounds: tuple[tuple[float, float], ...] = ()  # of the shapes

    @property
    def own(self) -> Form:
        """The form itself."""
        return form_named(self.form)

    @property
    def parts(self) -> Iterator[Factor]:
        """Factors that it is the sum of, each of one form of `FORMS`."""
        left = list(self.shapes)
        for form in self.form.split("+"):
            yield Factor(self.source, form, tuple(left.pop(0) for _ in form_named(form).shapes))

    @property
    def frequencies(self) -> tuple[float, ...]:
        """Frequencies over a clock [Hz]; none where it is not periodic over one."""
        return tuple(p.shapes[0] for p in self.parts if FREQUENCY_SHAPE in p.own.shapes)

    @property
    def periodic_bounds(self) -> list[tuple[float, float]]:
        """Bounds of its orders and frequencies."""
        return [b for s, b in zip(self.own.shapes, self.bounds, strict=True) if s.periodic]

    def values(
        self, signals: RobotSignals | JointSignals, shapes: Sequence[Quantity] | None = None
    ) -> list[Quantity]:
        """Return the values (K,) of every formula."""
        at = self.shapes if shapes is None else shapes
        return self.own.values(self.source.value(signals), signals.dt, self._before(signals), at)

    def derivatives(self, signals: RobotSignals | JointSignals) -> list[list[np.ndarray]]:
        """Return the derivative (K,) of every formula by every shape."""
        x, before = self.source.value(signals), self._before(signals)
        return self.own.derivatives(x, signals.dt, before, self.shapes)

    def _before(self, signals: RobotSignals | JointSignals) -> np.ndarray | None:
        return self.source.value_before(signals) if self.own.has_memory else None

    def generalised(self, extent: SignalRange) -> Factor:
        """Return the factor in its more general form, from its own shapes and their bounds."""
        own = zip(self.own.shapes, self.shapes, self.bounds, strict=True)
        known = {shape.name: (value, bounds) for shape, value, bounds in own}
        first = next(Factor(self.source, self.own.general).starts(extent))
        begun = zip(first.own.shapes, first.shapes, first.bounds, strict=True)
        kept = [known.get(shape.name, (value, bounds)) for shape, value, bounds in begun]
        shapes, bounds = zip(*kept, strict=True)
        return replace(first, shapes=shapes, bounds=bounds)

    def plus(self, form: str, extent: SignalRange) -> Iterator[Factor]:
        """Yield sums of the factor and another form of its signal, with all its initial shapes."""
        for other in Factor(self.source, form).starts(extent):
            shapes, bounds = (*self.shapes, *other.shapes), (*self.bounds, *other.bounds)
            yield Factor(self.source, f"{self.form}+{form}", shapes, bounds)

    def starts(self, extent: SignalRange) -> Iterator[Factor]:
        """Yield the factor with every combination of initial shapes, and with their bounds."""
        bounds = tuple(shape.bounds(extent) for shape in self.own.shapes)
        for shapes in product(*(shape.starts(extent) for shape in self.own.shapes)):
            inside = (min(max(v, low), high) for v, (low, high) in zip(shapes, bounds, strict=True))
            yield replace(self, shapes=tuple(float(v) for v in inside), bounds=bounds)


@dataclass(frozen=True)
class Law:
    """A law without its amplitudes."""

    joint: int  # from 0
    place: Place
    # At most three, at most one of them with several formulas; none for a constant.
    factors: tuple[Factor, ...]

    @property
    def shapes(self) -> tuple[float, ...]:
        """Shapes of all factors."""
        return tuple(value for factor in self.factors for value in factor.shapes)

    @property
    def bounds(self) -> tuple[tuple[float, float], ...]:
        """Bounds of all shapes."""
        return tuple(own for factor in self.factors for own in factor.bounds)

    @property
    def of_robot(self) -> bool:
        """True where the signals of its joint are not enough."""
        return not all(factor.source.is_of_joint(self.joint) for factor in self.factors)

    @property
    def _load_factors(self) -> list[Factor]:
        """Factors of the load of its joint, or of the nominal wind-up under it."""
        return [f for f in self.factors if f.source.origin == LawSource("load", self.joint)]

    @property
    def yields(self) -> bool:
        """True where its deflection depends on the load of its joint."""
        return self.place == "deflection" and bool(self._load_factors)

    @property
    def lags(self) -> bool:
        """True where that deflection lags the load."""
        return self.yields and any(f.own.has_memory for f in self._load_factors)

    @property
    def is_play(self) -> bool:
        """True where that deflection bends with the load alone, as a spring with play does."""
        alone = self.yields and len(self._load_factors) == len(self.factors) and not self.lags
        return alone and any(f.form != "linear" for f in self.factors)

    @property
    def frequencies(self) -> tuple[float, ...]:
        """Frequencies over clocks [Hz], in ascending order."""
        return tuple(sorted(own for factor in self.factors for own in factor.frequencies))

    @property
    def structure(self) -> tuple[object, ...]:
        """Joint, signals and forms, whatever the shapes."""
        return (self.joint, frozenset((factor.source, factor.form) for factor in self.factors))

    def log_prior(self, joints: int) -> float:
        """Return the log prior probability over that of a constant.

        Every kind of signal is as likely as any other, and as likely to be the joint's own as to be
        of all others together: that is what brevity is worth. An order or frequency is one of as
        many as the recordings tell apart.

        `joints`: number of joints of the robot.
        """
        signals = {factor.source for factor in self.factors}
        foreign = [each for each in signals if each.joint not in (None, self.joint)]
        kinds, places = len(SOURCE_KINDS), max(joints - 1, 1)
        waves = [high / low for f in self.factors for low, high in f.periodic_bounds]
        price = len(signals) * np.log(kinds) + len(foreign) * np.log(places) + np.log(waves).sum()
        return -float(price)

    @property
    def parameter_count(self) -> int:
        """Number of amplitudes and shapes."""
        return self.amplitude_count + len(self.shapes)

    @property
    def amplitude_count(self) -> int:
        """Number of amplitudes."""
        return max((len(factor.own.formulas) for factor in self.factors), default=1)

    def with_shapes(self, shapes: Sequence[float]) -> Law:
        """Return the law with other shapes, within their bounds."""
        left, factors = list(shapes), []
        for factor in self.factors:
            own = [left.pop(0) for _ in factor.shapes]
            inside = (
                min(max(v, low), high) for v, (low, high) in zip(own, factor.bounds, strict=True)
            )
            factors.append(replace(factor, shapes=tuple(float(v) for v in inside)))
        return replace(self, factors=tuple(factors))

    def columns(
        self, signals: RobotSignals | JointSignals, shapes: Sequence[Quantity] | None = None
    ) -> list[Quantity]:
        """Return the value (K,) per unit of every amplitude."""
        left = list(self.shapes if shapes is None else shapes)
        found: list[Quantity] = [1.0] if self.factors else [1.0 + 0.0 * signals.time]
        for factor in self.factors:
            own = [left.pop(0) for _ in factor.own.shapes]
            values = factor.values(signals, own)
            found = [a * b for a in found for b in values]
        return found

    def slopes(self, signals: RobotSignals) -> list[list[np.ndarray]]:
        """Return the derivative (K,) of every column by every shape: [amplitude][shape]."""
        every = [factor.values(signals) for factor in self.factors]
        found: list[list[np.ndarray]] = [[] for _ in range(self.amplitude_count)]
        for number, factor in enumerate(self.factors):
            if not factor.shapes:
                continue
            others = [1.0]
            for k, values in enumerate(every):
                if k != number:
                    others = [a * b for a in others for b in values]
            slopes = factor.derivatives(signals)
            for i in range(len(factor.shapes)):
                own = [a * each[i] for a in others for each in slopes]
                for k, column in enumerate(own):
                    found[k].append(column)
        return found

    # ---- names

    @property
    def name(self) -> str:
        """Name as an effect: place, joint and signals."""
        parts = [] if self.factors else ["constant"]
        for factor in self.factors:
            signal = re.sub(r"\W+", "", factor.source.symbol.replace("sg(", "sign_"))
            parts.append(signal if factor.form == "linear" else f"{factor.form}_{signal}")
        return f"law_{self.place}_{self.joint + 1}_" + "_".join(parts)

    @property
    def amplitude_names(self) -> tuple[str, ...]:
        """Names of the amplitudes."""
        return tuple(ascii_uppercase[: self.amplitude_count])

    @property
    def shape_names(self) -> tuple[str, ...]:
        """Names of the shapes, numbered by factor where two factors share one."""
        names = [(k, s.name) for k, f in enumerate(self.factors) for s in f.own.shapes]
        plain = [name for _, name in names]
        return tuple(name if plain.count(name) == 1 else f"{name}{k + 1}" for k, name in names)

    @property
    def amplitude_units(self) -> tuple[str, ...]:
        """Units of the amplitudes."""
        found, names = [_PLACE_UNITS[self.place]], list(self.shape_names)
        for factor in self.factors:
            shapes = {shape.name: names.pop(0) for shape in factor.own.shapes}
            unit = factor.source.own.unit
            name = f"({unit})" if "/" in unit or " " in unit else unit
            powers = [shapes.get(str(n), n) if unit else 0 for n in factor.own.unit_powers]
            over = [f"/{name}" + f"^{n}" * (n != 1) if n else "" for n in powers]
            found = [a + b for a in found for b in over]
        return tuple(found)

    def amplitude_sizes(self, amplitudes: Sequence[float]) -> list[tuple[str, str, float]]:
        """Return name, unit and typical size of every amplitude: the largest one of its unit."""
        units = self.amplitude_units
        largest = dict.fromkeys(units, 1e-12)
        for unit, value in zip(units, amplitudes, strict=True):
            largest[unit] = max(largest[unit], abs(float(value)))
        return [(n, u, largest[u]) for n, u in zip(self.amplitude_names, units, strict=True)]

    @property
    def shape_units(self) -> tuple[str, ...]:
        """Units of the shapes."""
        return tuple(
            shape.unit_of(f.source.own.unit) for f in self.factors for shape in f.own.shapes
        )

    def formulas(self, *, code: bool) -> list[str]:
        """Return the formula of every amplitude: Python code, or symbols for an equation."""
        if not self.factors:
            return ["(1.0 + 0.0 * signals.time)" if code else "1"]
        names = list(self.shape_names)
        found = [""]
        for factor in self.factors:
            words = {"x": factor.source.symbol, "dt": "dt"}
            if code:
                before = factor.source.expression_before(self.joint, of_robot=self.of_robot)
                words = {
                    "x": factor.source.expression(self.joint, of_robot=self.of_robot),
                    "dt": "signals.dt",
                    "before": before,
                }
            for shape in factor.own.shapes:
                words[shape.name] = names.pop(0)
            parts = [_in_brackets(substitute_names(each, words)) for each in factor.own.formulas]
            found = [f"{a} * {b}" if a else b for a in found for b in parts]
        return (
            found
            if code
            else [each.replace("np.", "").replace(", dt, before)", ")") for each in found]
        )

    @property
    def equation(self) -> str:
        """Equation for reports."""
        target = _PLACE_SYMBOLS[self.place].format(self.joint + 1)
        terms = zip(self.amplitude_names, self.formulas(code=False), strict=True)
        return f"{target} += " + " + ".join(f"{name} * {each}" for name, each in terms)

    @property
    def words(self) -> str:
        """Channel and dependence in words."""
        parts = [f.own.words.format(x=f.source.words) for f in self.factors]
        where = _PLACE_WORDS[self.place].format(self.joint + 1)
        if not self.factors:
            return f"{where} is shifted by a constant"
        return f"{where} changes {', and '.join(parts)}"


def _in_brackets(text: str) -> str:
    """Return a formula, in brackets where it is a sum."""
    depth = 0
    for k, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if depth == 0 and letter in "+-" and text[k - 1] == " " and k:
            return f"({text})"
    return text


# Physical bounds are unknown: an amplitude counts as impossible only far beyond the fitted one.
_AMPLITUDE_BOUND = 50.0


def law_term(
    law: Law,
    signals: RobotSignals | JointSignals,
    amplitudes: Sequence[Quantity],
    shapes: Sequence[Quantity],
) -> Term:
    """Return the term of a law."""
    columns = law.columns(signals, shapes)
    value: Quantity = sum(a * c for a, c in zip(amplitudes, columns, strict=True))
    if isinstance(signals, RobotSignals):
        value = at_joint(signals, value)
    return Term(**{law.place: value})


def at_joint(signals: RobotSignals, value: Quantity) -> Quantity:
    """Return values (K,) of the joint that an effect is located at for all joints (K, n)."""
    return np.outer(value, np.eye(len(signals.constants.joints))[signals.link])


def resembled(law: Law) -> str:
    """Return a clause on known physics of the same form; "" where there is none."""
    known = [factor.own.resembles for factor in law.factors if factor.own.resembles]
    return f": like {'; or '.join(known)}" if known else ""


def law_effect(law: Law, amplitudes: Sequence[float]) -> Effect:
    """Return a law as an effect of its joint.

    `amplitudes`: fitted ones: the largest of each unit is the typical size.
    """
    like = resembled(law)
    return Effect(
        name=law.name,
        family=LAW_FAMILY,
        scope="joint",
        equation=law.equation,
        signature=f"{law.words}{like}",
        title=f"law {law.equation}"
        + "".join(f" with f = {frequency:.7g} Hz" for frequency in law.frequencies),
        phrase=f"{law.words}, which no catalogue has{like}",
        remedy=f"Look for its cause at {{where}}{like}. {describe_test(law)}",
        needs=("torque" if law.place != "deflection" else "link", "moves"),
        couples_joints=law.of_robot,
        yields=law.yields,
        lags=law.lags,
        is_play=law.is_play,
        applies=partial(_is_joint, law.joint + 1) if law.of_robot else None,
        term=partial(law_term, law),
        amplitudes=tuple(
            Amplitude(
                name=name,
                unit=unit,
                scale=size,
                lower=-_AMPLITUDE_BOUND,
                upper=_AMPLITUDE_BOUND,
            )
            for name, unit, size in law.amplitude_sizes(amplitudes)
        ),
        shapes=tuple(
            Shape(name=name, unit=unit, starts=(value,), lower=low, upper=high)
            for name, unit, value, (low, high) in zip(
                law.shape_names, law.shape_units, law.shapes, law.bounds, strict=True
            )
        ),
        separate=describe_test(law),
    )


def law_of(effect: Effect) -> Law | None:
    """Return the law that an effect was made from; None of other effects."""
    term = effect.term
    if isinstance(term, partial) and term.func is law_term:
        law: Law = term.args[0]
        return law
    return None


def _is_joint(number: int, constants: object) -> bool:
    return getattr(constants, "joint", 0) == number


def describe_test(law: Law) -> str:
    """Describe the motion that would tell the law from others."""
    if law.frequencies:
        return (
            f"Move joint {law.joint + 1} for several times as long without a pause: recordings"
            " apart tell a frequency only up to multiples of one over the time between them."
        )
    moved = [f.source for f in law.factors if f.source.kind != "direction"]
    # The motion of the joint stays the same where another signal can differ.
    moved.sort(key=lambda source: source.joint != law.joint)
    last = moved[-1].words if moved else f"position of joint {law.joint + 1}"
    return (
        f"Move joint {law.joint + 1} the same way several times while only the {last} differs,"
        " over its whole range and back: the residual follows the law, or it does not."
    )
