"""Laws beyond the catalogue: grammar, files, and the search in a channel of known content."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from typed_laws import typed_torque

from stiffopt.discovery import catalogue
from stiffopt.discovery.catalogue.drift import friction_drift
from stiffopt.discovery.comparison.located_effect import EstimatedEffect, LocatedEffect
from stiffopt.discovery.extended.model import load_extended
from stiffopt.discovery.extended.store import _describe_table, _format_effect, _format_table
from stiffopt.discovery.law_search import find
from stiffopt.discovery.law_search.find import MIN_KEPT_SHARE
from stiffopt.discovery.law_search.fit_law import fit_shapes
from stiffopt.discovery.law_search.free_function import best_sum, residual_tables, screen
from stiffopt.discovery.law_search.open_channel import OpenChannel
from stiffopt.discovery.law_search.search import _laws_of_origin, beats, search_channel
from stiffopt.discovery.laws import operators
from stiffopt.discovery.laws.forms import FORMS
from stiffopt.discovery.laws.law import Factor, Law, describe_test, law_effect, law_of
from stiffopt.discovery.laws.law_file import law_file_text
from stiffopt.discovery.laws.shapes import SignalRange
from stiffopt.discovery.laws.sources import SOURCE_KINDS, LawSource
from stiffopt.discovery.laws.table import table_of
from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.user_effects import (
    find_faults,
    load_effects,
    sample_signals,
    sample_signals_of,
    stack_term,
)
from stiffopt.errors import InputFileError
from stiffopt.report.diagnosis.law_section import law_definitions, law_numbers

EXTENT = SignalRange(low=-0.7, high=0.9, duration=6.0, rate=20.0, peaks=(0.7,))


def forms_of(kind: str) -> list[str]:
    """Forms of a signal, and those that they are special cases of."""
    found = list(SOURCE_KINDS[kind].forms)
    for form in found:  # grows meanwhile
        if FORMS[form].general and FORMS[form].general not in found:
            found.append(FORMS[form].general)
    return found


SUMS = [("load", "lag+linear"), ("load", "stop+stop"), ("speed", "magnitude+constant")]
EVERY = [(kind, form) for kind in SOURCE_KINDS for form in forms_of(kind)] + SUMS
SIGN = Factor(LawSource("direction", 4), "linear")


def law_with(kind: str, form: str, base: tuple[Factor, ...] = (SIGN,)) -> Law:
    source = LawSource(kind, 2 if SOURCE_KINDS[kind].per_joint else None)
    return Law(4, "drive_torque", (*base, next(Factor(source, form).starts(EXTENT))))


@pytest.mark.parametrize(("kind", "form"), EVERY)
def test_every_form_of_every_signal_is_a_valid_effect(kind: str, form: str) -> None:
    law = law_with(kind, form)
    assert list(find_faults(law_effect(law, [0.7] * law.amplitude_count))) == []


@pytest.mark.parametrize(
    "name",
    [*(name for name, form in FORMS.items() if form.shapes), *(form for _, form in SUMS[:2])],
)
def test_slopes_by_shapes_agree_with_differences(name: str) -> None:
    signals = sample_signals(count=200)
    kind = next(k for k, form in EVERY if form == name)
    law = law_with(kind, name)
    own = Factor(law.factors[-1].source, name)
    x = np.asarray(own.source.value(signals))
    extent = SignalRange(low=x.min(), high=x.max(), duration=2.0, rate=20.0, peaks=(0.7,))
    law = Law(4, "drive_torque", (SIGN, next(own.starts(extent))))
    slopes = law.slopes(signals)
    for i, value in enumerate(law.shapes):
        step = 1e-6 * max(abs(value), 0.1)
        ends = []
        for side in (-step, step):
            shapes = [v + side * (k == i) for k, v in enumerate(law.shapes)]
            ends.append(law.columns(signals, shapes))
        for number, (low, high) in enumerate(zip(*ends, strict=True)):
            expected = (high - low) / (2.0 * step)
            error = np.abs(slopes[number][i] - expected).max()
            assert error <= 1e-5 * np.abs(expected).max() + 1e-9


def products(count: int) -> list[Law]:
    """Laws of up to three factors, one of them a sum of two forms of a signal."""
    draw = np.random.default_rng(39)
    laws: list[Law] = []
    for _ in range(count):
        factors: list[Factor] = []
        for number in range(draw.integers(1, 4)):
            kind = str(draw.choice(list(SOURCE_KINDS)))
            own = SOURCE_KINDS[kind]
            joint = 4 if own.of_own_joint else int(draw.integers(6))
            source = LawSource(kind, joint if own.per_joint else None)
            one, other = draw.choice(forms_of(kind)), draw.choice(["constant", *own.forms])
            factor = next(Factor(source, str(one)).starts(EXTENT))
            if number == 0:
                factor = next(factor.plus(str(other), EXTENT))
            if number == 0 or len(factor.own.formulas) == 1:
                factors.append(factor)
        place = ("drive_torque", "link_torque", "deflection")[draw.integers(3)]
        laws.append(Law(4, place, tuple(factors)))
    return laws


@pytest.mark.parametrize("law", [*(law_with(*own) for own in EVERY), *products(100)])
def test_the_text_of_the_page_alone_gives_the_torque(law: Law) -> None:
    signals = sample_signals(count=200)
    amplitudes = np.linspace(1.37, -0.61, law.amplitude_count).tolist()
    numbers = law_numbers(law, (*amplitudes, *law.shapes))
    typed = typed_torque(law.equation, numbers, law_definitions(law), signals)
    columns = law.columns(signals)
    expected = sum(a * c for a, c in zip(amplitudes, columns, strict=True))
    assert typed == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(expected).max())


def test_a_law_file_is_read_as_the_same_effect(tmp_path) -> None:
    signals = sample_signals()
    laws = [law_with("position", "harmonic"), law_with("acceleration", "sprung", ())]
    path = tmp_path / "law.py"
    values = {"A": (1.5, 0.1)}
    path.write_text(
        law_file_text(
            "cell", [(law.name, law, [1.5] * law.amplitude_count, values) for law in laws]
        )
    )
    for law, effect in zip(laws, load_effects(path), strict=True):
        own = law_effect(law, [1.5] * law.amplitude_count)
        seen = replace(sample_signals_of(own, signals), link=law.joint)
        amplitudes = [0.4, -0.9][: law.amplitude_count]
        terms = [each.term(seen, amplitudes, law.shapes) for each in (own, effect)]
        assert stack_term(terms[1]) == pytest.approx(stack_term(terms[0]), rel=1e-12)
        for field in (
            "name",
            "equation",
            "title",
            "phrase",
            "remedy",
            "separate",
            "needs",
            "yields",
        ):
            assert getattr(effect, field) == getattr(own, field), field
        assert (effect.amplitudes, effect.shapes) == (own.amplitudes, own.shapes)
        assert law_of(effect) is None
        assert law_of(own) == law


def test_a_deflection_by_the_load_alone_is_play_and_one_that_lags_is_none() -> None:
    load = LawSource("load", 4)
    plain, late, warm = (
        Law(4, "deflection", factors)
        for factors in (
            (Factor(load, "saturating", (2.0,), ((0.1, 9.0),)),),
            (Factor(load, "lag", (0.2,), ((0.01, 9.0),)),),
            (Factor(load, "linear"), Factor(LawSource("temperature", 4), "linear")),
        )
    )
    found = [law_effect(law, [1.0]) for law in (plain, late, warm)]
    assert [effect.yields for effect in found] == [True, True, True]
    assert [effect.lags for effect in found] == [False, True, False]
    assert [effect.is_play for effect in found] == [True, False, False]


def test_a_stop_element_slides_at_its_limit() -> None:
    there = np.concatenate([np.linspace(0.0, 1.0, 101), np.linspace(1.0, 0.5, 51)])
    found = operators.stop(there, 0.1)
    assert found[100] == pytest.approx(0.1)
    assert found[111] == pytest.approx(0.0)
    assert found[-1] == pytest.approx(-0.1)


def test_a_sprung_mass_follows_slowly_and_not_at_once() -> None:
    steady = operators.sprung(np.concatenate([[0.0], np.ones(4000)]), 2.0, 0.3, 0.005)
    assert steady[-1] == pytest.approx(1.0, abs=1e-6)
    assert abs(steady[2]) < 0.1


@pytest.mark.parametrize("kind", ["acceleration", "speed", "load"])
def test_hidden_masses_follow_the_start_before_a_recording_that_begins_in_motion(kind) -> None:
    """A joint has started from rest by its first acceleration; a load may act for ever."""
    dt, count, begin = 0.002, 1000, 100  # samples; of the start that is not recorded
    time = np.arange(count) * dt
    speed = np.minimum(4.0 * time, 2.0)
    whole = {
        "motor_acceleration": np.where(time < 0.5, 4.0, 0.0),
        "motor_velocity": speed,
        "spring_torque": np.where(time < 0.1, 0.0, 3.0),
    }
    of_joint = SimpleNamespace(**{name: x[begin:] for name, x in whole.items()}, dt=dt)
    of_robot = SimpleNamespace(**{name: x[begin:, None] for name, x in whole.items()}, dt=dt)
    law = Law(0, "drive_torque", (Factor(LawSource(kind, 0), "sprung", (2.0, 0.1)),))
    (found,) = law.columns(of_robot)
    if kind == "load":
        np.testing.assert_allclose(found, 3.0, rtol=1e-12)
    else:
        x = whole["motor_velocity" if kind == "speed" else "motor_acceleration"]
        past = operators.sprung(x, 2.0, 0.1, dt, np.zeros(0))[begin:]
        np.testing.assert_allclose(found, past, atol=1e-9 * np.abs(past).max())
    (code,) = law.formulas(code=True)
    space = {name: getattr(operators, name) for name in operators.OPERATOR_NAMES}
    space |= {"signals": of_joint, "f": 2.0, "zeta": 0.1}
    np.testing.assert_array_equal(eval(code, space), found)


@pytest.mark.parametrize(
    ("kind", "stiffness", "places"),
    [
        ("position", 4000.0, {"deflection": 0.002, "link_torque": 8.0}),
        ("position", np.inf, {"deflection": 0.002}),
        ("load", 4000.0, {"deflection": 0.002}),
    ],
)
def test_a_law_that_the_deflection_shows_may_be_a_torque_on_the_link(
    monkeypatch, kind, stiffness, places
) -> None:
    """It winds up the joint where that is elastic; what a spring yields under load does not."""
    load = np.linspace(-20.0, 20.0, 50)[:, None]
    run = SimpleNamespace(
        signals=SimpleNamespace(spring_torque=load, windup=load / stiffness), time=load[:, 0]
    )
    comparison = SimpleNamespace(
        robot=SimpleNamespace(elastic=True, n=1),
        runs=[run],
        bodies=None,
        effect_columns=lambda located: 9.0 * np.eye(2)[:, [int(located.effect.equation[0] == "T")]],
    )
    scored = SimpleNamespace(evidence=50.0, amplitudes=np.ones(1))
    monkeypatch.setattr(find, "Scorer", lambda *_: SimpleNamespace(score=lambda located: scored))
    law = Law(0, "deflection", (Factor(LawSource(kind, 0), "linear"),))
    fitted = SimpleNamespace(law=law, fit=SimpleNamespace(amplitudes=np.array([0.002])))
    ranked = find._State(comparison, (), ())._rank_places(comparison, [fitted])
    sizes = {each.law.place: each.located.effect.amplitudes[0].scale for each in ranked}
    assert sizes == pytest.approx(places)


@pytest.mark.parametrize("better", ["step", "hinge_above"])
def test_of_formulas_that_are_one_function_the_one_of_more_evidence_is_told(
    monkeypatch: pytest.MonkeyPatch, better: str
) -> None:
    """Formulas are nearly true: odds call the briefer one likelier, and leave both near."""
    evidence = {"step": 9020.0, "hinge_above": 8990.0} if better == "step" else {}
    comparison = SimpleNamespace(
        robot=SimpleNamespace(elastic=False, n=1),
        bodies=None,
        effect_columns=lambda located: np.eye(2)[:, [0]],
    )

    def score(located):
        (form,) = (n for n in ("step", "hinge_above") if n in located.effect.name)
        return SimpleNamespace(evidence=evidence.get(form, 9000.0), amplitudes=np.ones(1))

    monkeypatch.setattr(find, "Scorer", lambda *_: SimpleNamespace(score=score))
    shapes = {"step": (0.3, 0.02), "hinge_above": (0.3,)}
    bounds = ((-1.0, 1.0), (0.01, 1.0))
    fitted = [
        SimpleNamespace(
            law=Law(
                0,
                "drive_torque",
                (Factor(LawSource("position", 0), form, own, bounds[: len(own)]),),
            ),
            fit=SimpleNamespace(amplitudes=np.array([5.0])),
        )
        for form, own in shapes.items()
    ]
    (ranked,) = find._State(comparison, (), ())._rank_places(comparison, fitted)
    assert [factor.form for factor in ranked.law.factors] == [better]


def test_findings_are_searched_before_channels_near_the_noise() -> None:
    """A law may stand behind them; two refusals near the noise end the search."""
    rows = SimpleNamespace(counts=np.full(6, 400))
    comparison = SimpleNamespace(
        robot=SimpleNamespace(n=3),
        bodies=None,
        least=np.ones(6),
        rows=rows,
        fit=lambda effects: SimpleNamespace(residual=None),
        channel_ratio=lambda residual: np.array([1.2, 1.1, 1.0, 1.3, 1.0, 1.0]),
    )
    located = LocatedEffect(effect=catalogue.effect("torque_offset"), joint=2)
    state = find._State(comparison, [Selected(located, 100.0, 14.0, 1.0, (), 2)], ())
    assert state.searched_channels(set()) == [2, 5, 0, 1, 3]
    assert state.searched_channels({3}) == [0, 3, 2, 5, 1]


class KnownChannel(OpenChannel):
    """Channel of unfiltered samples of a sample arm, whose content is given."""

    def __init__(self, content, noise: float = 1.0, seed: int = 3) -> None:
        draw = np.random.default_rng(seed)
        runs = []
        for k in range(4):
            whole = sample_signals(count=1500, dt=0.02 + 0.003 * k)
            runs.append(SimpleNamespace(signals=whole, time=whole.time))
        for run in runs:
            run.low_pass = SimpleNamespace(cutoff=12.0)
        self.comparison = SimpleNamespace(
            runs=runs,
            robot=SimpleNamespace(n=6),
            rows=SimpleNamespace(
                sample_signal=lambda value: np.concatenate([value(run)[::5] for run in runs])
            ),
        )
        self.channel, self.joint, self.kind = 4, 4, "torque"
        counts = [len(run.time[::5]) for run in runs]
        self.rows, self.block = np.arange(sum(counts)), np.repeat(np.arange(4), counts)
        values = [content(run.signals)[::5] for run in runs]
        self.target = np.concatenate(values) + noise * draw.standard_normal(sum(counts))

    def columns(self, values):
        return np.vstack([np.column_stack([v[::5] for v in of_run]) for of_run in values])


def test_friction_by_the_angle_of_another_joint_is_found() -> None:
    def content(signals):
        bent = signals.motor_position[:, 1]
        return 9.0 * signals.motor_direction[:, 4] / (1.0 + np.exp(-(bent - 0.1) / 0.05))

    found = search_channel(KnownChannel(content))
    assert found.refusal == ""
    assert found.best is not None
    sources = {factor.source for factor in found.best.law.factors}
    assert sources == {LawSource("direction", 4), LawSource("position", 1)}
    assert found.explained > 0.95


@pytest.mark.parametrize("share", [0.03, 0.12, 0.41, 0.93, 0.97])
def test_a_step_is_found_wherever_it_is_in_the_stroke(share: float) -> None:
    """Near an end a hinge resembles it, and continues otherwise."""
    every = [
        run.signals.motor_position[:, 1]
        for run in KnownChannel(lambda s: 0.0 * s.time).comparison.runs
    ]
    low, high = (end(np.concatenate(every)) for end in (np.min, np.max))
    place, width = low + share * (high - low), 0.02 * (high - low)

    def content(signals):
        return 20.0 * (1.0 + np.tanh((signals.motor_position[:, 1] - place) / width))

    found = search_channel(KnownChannel(content))
    assert found.best is not None
    (factor,) = found.best.law.factors
    assert (factor.source, factor.form) in {
        (LawSource("position", 1), n) for n in ("step", "step_down")
    }
    assert factor.shapes[0] == pytest.approx(place, abs=0.3 * width)


def test_the_briefest_law_is_found_and_not_a_product_that_contains_it() -> None:
    found = search_channel(KnownChannel(lambda s: 3.0 * s.motor_direction[:, 4]))
    assert found.best is not None
    assert found.best.law.factors == (SIGN,)


def test_a_law_takes_the_place_of_a_known_effect_only_where_it_fits_better() -> None:
    """Not for its fewer parameters: equal fits are told apart by the odds among rivals alone."""
    channel = KnownChannel(lambda s: 4.0 * s.motor_position[:, 4], noise=2.0)
    law = Law(4, "drive_torque", (Factor(LawSource("position", 4), "linear"),))
    best = fit_shapes(channel, law, 1)
    left = channel.square - best.fit.removed
    wins = partial(beats, channel, best, significant=True)
    cable = LocatedEffect(effect=catalogue.effect("cable_spring"), joint=4, shapes=(0.1,))
    sure, doubted = (Selected(cable, 100.0, 14.0, p, (), 4) for p in (1.0, 0.1))
    assert not wins(left, [sure])
    spring = LocatedEffect(effect=catalogue.effect("gravity_spring"), joint=4, shapes=(0.1,))
    assert not wins(left, [sure, replace(sure, located=spring)])
    # Eight values that make up for one another, none of which is told from zero, name nothing.
    lubricated = catalogue.effect("lubricated_friction")
    many = LocatedEffect(effect=lubricated, joint=4, shapes=(0.1,) * len(lubricated.shapes))
    assert not wins(left, [replace(sure, located=many)])
    assert wins(left, [replace(sure, located=many)], significant=False)
    assert not wins(left, [sure], significant=False)
    # Values of four runs are no function, and random: equal to them a law is likelier, not below.
    drift = LocatedEffect(effect=friction_drift(tuple("abcd")), joint=4, shapes=(0.5,))
    values = Selected(drift, 100.0, 14.0, 1.0, (), 4)
    assert wins(left, [values])
    assert not wins(0.9 * left, [values])
    # They sum to zero: of two runs a law of one parameter meets the difference, whatever it is.
    two = LocatedEffect(effect=friction_drift(("a", "b")), joint=4, shapes=(0.5,))
    assert not wins(left, [replace(values, located=two)])
    # By as much as it has to be ahead of a sure finding, it is not of several rivals.
    far = next(f for f in np.geomspace(1.0, 4.0, 200) if wins(f * left, [sure]))
    assert 1.0 < far < 2.0
    assert not wins(far * left, [doubted])


def test_a_more_general_form_keeps_the_bounds_of_its_shapes() -> None:
    """Orders of a motor are sought beyond those of the grid, where the residual has peaks."""
    ripple = Factor(LawSource("position", 4), "harmonic", (240.0,), ((2.5, 264.0),))
    more = ripple.generalised(SignalRange(low=-1.0, high=1.0, duration=5.0, rate=24.0))
    assert (more.form, more.shapes, more.bounds) == (
        "harmonic_overtone",
        (240.0,),
        ((2.5, 264.0),),
    )


def test_a_power_has_its_exponent_in_the_unit() -> None:
    load, speed = LawSource("load", 1), LawSource("speed", 1)
    power = Factor(load, "signed_power", (0.5,))
    assert Law(1, "deflection", (power,)).amplitude_units == ("rad/(N m)^n",)
    both = Law(1, "drive_torque", (Factor(speed, "power", (2.0,)), power))
    assert both.amplitude_units == ("N m/(rad/s)^n1/(N m)^n2",)
    summed = Law(1, "drive_torque", (Factor(speed, "power+signed_power", (2.0, 0.5)),))
    assert summed.amplitude_units == ("N m/(rad/s)^n", "N m/(rad/s)^n_2")


def test_a_constant_is_a_law() -> None:
    found = search_channel(KnownChannel(lambda s: 2.0 + 0.0 * s.time))
    assert found.best is not None
    assert found.best.law.equation == "tau_5 += A * 1"


def test_a_form_becomes_more_general_where_the_data_ask_for_it() -> None:
    def content(signals, power):
        return 100.0 * np.maximum(signals.motor_position[:, 1] + 0.2, 0.0) ** power

    for power, form in ((1.0, "hinge_above"), (2.5, "power_above")):
        found = search_channel(KnownChannel(lambda s, n=power: content(s, n)))
        assert found.best is not None
        (factor,) = found.best.law.factors
        assert factor.form == form
    assert factor.shapes == pytest.approx((-0.2, 2.5), abs=0.1)


def test_a_square_needs_no_exponent() -> None:
    found = search_channel(KnownChannel(lambda s: 3.0 * s.motor_velocity[:, 4] ** 2))
    assert found.best is not None
    assert found.best.law.equation == "tau_5 += A * w_5**2"
    assert found.best.law.amplitude_units == ("N m/(rad/s)^2",)


def test_the_test_of_a_law_lets_the_signal_of_another_joint_differ() -> None:
    own, other = (Factor(LawSource(*each), "linear") for each in (("speed", 4), ("position", 1)))
    for factors in ((own, other), (other, own)):
        told = describe_test(Law(4, "drive_torque", factors))
        assert told.startswith("Move joint 5 the same way several times while only the position of")
        assert "position of joint 2 differs" in told


def test_only_units_of_several_names_need_brackets() -> None:
    units = [
        Law(4, "drive_torque", (Factor(LawSource(kind, 4), "linear"),)).amplitude_units
        for kind in ("position", "speed", "load")
    ]
    assert units == [("N m/rad",), ("N m/(rad/s)",), ("N m/(N m)",)]
    both = Law(4, "drive_torque", (Factor(LawSource("speed", 4), "magnitude+constant"),))
    assert both.amplitude_units == ("N m/(rad/s)", "N m")
    assert [size for *_, size in both.amplitude_sizes([-3.0, 0.2])] == [3.0, 0.2]


def test_a_second_form_of_a_signal_is_found_beside_the_first() -> None:
    """A gear's ripple of two orders: neither is the law alone."""

    def content(signals):
        angle = signals.motor_position[:, 4]
        return 4.0 * np.sin(190.4 * angle) + 1.5 * np.cos(95.2 * angle)

    found = search_channel(KnownChannel(content))
    assert found.best is not None
    (factor,) = found.best.law.factors
    assert factor.form == "harmonic+harmonic"
    assert factor.shapes == pytest.approx((190.4, 95.2), rel=1e-3)
    assert found.best.fit.amplitudes == pytest.approx([0.0, 4.0, 1.5, 0.0], abs=0.2)


def test_a_form_of_a_signal_is_exchanged_where_the_first_found_was_a_carrier() -> None:
    """Drag by the square of speed times a lever: neither factor is a carrier."""

    def content(signals):
        w = signals.motor_velocity[:, 4]
        return 8.0 * w * np.abs(w) * np.cos(signals.motor_position[:, 1])

    found = search_channel(KnownChannel(content))
    assert found.best is not None
    forms = {(f.source, f.form) for f in found.best.law.factors}
    assert forms == {
        (LawSource("speed", 4), "signed_square"),
        (LawSource("position", 1), "lever"),
    }
    assert found.best.fit.amplitudes == pytest.approx([8.0, 0.0], abs=0.3)


def test_an_order_is_one_of_as_many_as_the_recordings_tell_apart() -> None:
    within = SimpleNamespace(low=0.0, high=2.0, span=2.0, peaks=())
    source = LawSource("position", 4)
    ripple, alone = (
        Law(4, "drive_torque", (next(Factor(source, form).starts(within)),))
        for form in ("harmonic", "lever")
    )
    ((low, high),) = ripple.factors[0].periodic_bounds
    waves = high * within.span / (2.0 * np.pi)
    price = alone.log_prior(6) - ripple.log_prior(6)
    # The lowest order has 0.6 waves within the range.
    assert price == pytest.approx(np.log(waves / 0.6))
    assert low < high


def test_noise_is_no_second_form() -> None:
    found = search_channel(KnownChannel(lambda s: 0.4 * s.spring_torque[:, 4], noise=1.03))
    assert found.best is not None
    assert found.best.law.equation == "tau_5 += A * T_5"


def test_functions_of_one_signal_are_one_law_whatever_it_is_called() -> None:
    speed = LawSource("speed", 4)
    odd = Law(4, "drive_torque", (Factor(speed, "signed_square"),))
    product = Law(4, "drive_torque", (SIGN, Factor(speed, "square")))
    foreign = Law(4, "drive_torque", (Factor(LawSource("speed", 3), "signed_square"),))
    first, same, other = (
        find._Ranked(9.0, law, None, np.ones(4)) for law in (odd, product, foreign)
    )
    assert first.is_same_as(same, width=1.0)
    assert not first.is_same_as(other, width=1.0)


def test_friction_near_standstill_is_found_whatever_function_of_speed_suggests_it() -> None:
    """Splines of speed have too few knots for it; the one of nominal friction shows it."""
    channel = KnownChannel(lambda s: 0.0 * s.time)
    origin = LawSource("speed", 4)
    base = (Factor(LawSource("speed", 4), "linear"),)
    laws = _laws_of_origin(channel, base, origin)
    forms = {tuple(sorted(f.form for f in law.factors)) for law in laws if SIGN in law.factors}
    assert ("fading", "linear") in forms
    assert {f.source.origin for law in laws for f in law.factors} == {origin}
    beside = (Factor(LawSource("position", 1), "linear"),)
    for law in _laws_of_origin(channel, beside, origin):
        assert law.factors[0] == beside[0]
        assert len(law.factors) == 2


def test_the_best_pairs_of_every_carrier_are_tried() -> None:
    """A law of the load alone beside one in proportion to it, which explains much."""
    found = search_channel(KnownChannel(lambda s: 9.0 * np.tanh(s.spring_torque[:, 4] / 6.0)))
    assert found.best is not None
    assert {f.source for f in found.best.law.factors} == {LawSource("load", 4)}


@pytest.mark.parametrize("frequency", [0.3, 0.55, 0.9])
def test_the_frequency_of_a_hidden_mode_is_searched(frequency: float) -> None:
    def content(signals):
        speed, pushed = signals.motor_velocity[:, 4], signals.motor_acceleration[:, 4]
        before = operators.acceleration_before(speed, pushed, signals.dt)
        return 2.0 * operators.sprung(pushed, frequency, 0.05, signals.dt, before)

    found = search_channel(KnownChannel(content, noise=0.3))
    assert found.best is not None
    (factor,) = found.best.law.factors
    assert factor.form == "sprung"
    assert factor.shapes[0] == pytest.approx(frequency, rel=0.02)


def test_contacts_that_slide_one_after_the_other_are_told_from_a_single_one() -> None:
    """As the inner friction of a gear: an even spread of limits (Iwan 1966)."""
    limits = 0.2 * (np.arange(20) + 0.5) / 20

    def content(signals):
        angle = np.asarray(signals.motor_position[:, 4])
        return 60.0 * np.mean([operators.stop(angle, r) for r in limits], axis=0)

    found = search_channel(KnownChannel(content))
    assert found.best is not None
    (factor,) = found.best.law.factors
    assert factor.form == "stops"
    assert factor.shapes == pytest.approx((0.2,), rel=0.05)


def test_a_switch_of_the_load_is_a_saturation() -> None:
    """As of a backlash that the load crosses: it turns over within a thousandth of the load."""
    found = search_channel(KnownChannel(lambda s: 6.0 * np.tanh(s.spring_torque[:, 4] / 0.05)))
    assert found.best is not None
    (factor,) = found.best.law.factors
    assert factor.form == "saturating"
    assert found.best.fit.amplitudes == pytest.approx([6.0], rel=0.02)


def test_the_order_of_a_motors_ripple_is_searched() -> None:
    def content(signals):
        return 4.0 * np.sin(190.4 * signals.motor_position[:, 4] + 0.3)

    found = search_channel(KnownChannel(content))
    assert found.best is not None
    (factor,) = found.best.law.factors
    assert factor.form == "harmonic"
    assert factor.shapes[0] == pytest.approx(190.4, rel=1e-3)


def test_an_overtone_is_found_beside_its_wave() -> None:
    def content(signals):
        turn = 2.0 * np.pi * 1.3 * signals.session_time
        return 9.0 * np.sin(turn) + 1.8 * np.cos(2.0 * turn)

    found = search_channel(KnownChannel(content))
    assert found.best is not None
    assert found.best.law.factors[0].form == "wave_overtone"
    assert found.best.fit.amplitudes == pytest.approx([0.0, 9.0, 1.8, 0.0], abs=0.2)
    # The wave alone is no rival of its own refinement.
    assert not any(factor.form == "wave" for law in found.near for factor in law.law.factors)


def test_half_the_order_is_found_beside_a_wave_that_leaves_no_more_than_the_noise() -> None:
    """As of a strain-wave gear: squares below the stated noise tell forms apart too."""

    def content(signals):
        angle = signals.motor_position[:, 4]
        return (
            1.2 * np.sin(102.0 * angle) + 0.35 * np.cos(51.0 * angle) + 0.3 * np.cos(204.0 * angle)
        )

    found = search_channel(KnownChannel(content, noise=0.9))
    assert found.best is not None
    (factor,) = found.best.law.factors
    assert factor.form == "harmonic_series"
    assert factor.shapes == pytest.approx((102.0,), rel=1e-3)


def test_equal_frequencies_of_recordings_apart_are_laws_of_their_own() -> None:
    """Recordings of 30 s every 500 s tell a frequency up to multiples of 2 mHz."""
    channel = KnownChannel(lambda s: np.zeros(len(s.time)))
    for number, run in enumerate(channel.comparison.runs):
        run.signals = replace(run.signals, session_time=run.time + 500.0 * number)
    clock = channel.comparison.rows.sample_signal(lambda run: run.signals.session_time)
    channel.target = channel.target + 1.5 * np.sin(2.0 * np.pi * 1.3 * clock)
    found = search_channel(channel)
    assert found.best is not None
    every = [found.best, *found.near]
    frequencies = [law.law.frequencies for law in every if law.law.frequencies]
    assert len(frequencies) >= 3
    for frequency in (1.298, 1.3, 1.302):
        assert min(abs(own - frequency) for (own,) in frequencies) < 1e-4
    first, second = (find._Ranked(0.0, law.law, None, np.ones(4)) for law in (every[0], every[1]))
    assert not first.is_same_as(second, width=1.0)
    assert first.is_same_as(first, width=1.0)
    titles = {law_effect(law.law, law.fit.amplitudes).title for law in every}
    assert len(titles) == len(every)


def test_both_frequencies_of_a_sum_of_waves_are_told_and_searched() -> None:
    channel = KnownChannel(lambda s: np.zeros(len(s.time)))
    for number, run in enumerate(channel.comparison.runs):
        run.signals = replace(run.signals, session_time=run.time + 500.0 * number)
    clock = channel.comparison.rows.sample_signal(lambda run: run.signals.session_time)
    channel.target = channel.target + 9.0 * np.sin(4.4 * np.pi * clock)
    channel.target = channel.target + 5.0 * np.cos(2.6 * np.pi * clock)
    found = search_channel(channel)
    assert found.best is not None
    (factor,) = found.best.law.factors
    assert factor.form == "wave+wave"
    assert found.best.law.frequencies == pytest.approx((1.3, 2.2), abs=1e-4)
    title = law_effect(found.best.law, found.best.fit.amplitudes).title
    assert title.count(" with f = ") == 2
    # The weaker one is as ambiguous between the recordings as the stronger.
    other = [law.law.frequencies[0] for law in found.near if len(law.law.frequencies) == 2]
    assert any(1e-3 < abs(own - 1.3) < 3e-3 for own in other)


def test_shapes_are_fitted_to_their_true_values() -> None:
    def content(signals):
        return 8.0 * np.tanh(signals.motor_velocity[:, 2] / 0.8)

    channel = KnownChannel(content, noise=0.1)
    start = Law(
        4, "drive_torque", (Factor(LawSource("speed", 2), "saturating", (2.0,), ((0.05, 9.0),)),)
    )
    found = fit_shapes(channel, start, 1)
    assert found.law.shapes[0] == pytest.approx(0.8, rel=0.01)
    assert found.fit.amplitudes[0] == pytest.approx(8.0, rel=0.01)


@pytest.mark.parametrize("seed", range(4))
def test_noise_holds_no_law(seed: int) -> None:
    found = search_channel(KnownChannel(lambda s: np.zeros(len(s.time)), seed=seed))
    assert found.best is None
    assert found.refusal


def test_a_residual_that_differs_from_run_to_run_is_no_law() -> None:
    signs = iter((1.0, -1.0, 1.0, -1.0))
    found = search_channel(KnownChannel(lambda s: 6.0 * next(signs) * s.motor_position[:, 1]))
    assert found.best is None


EXTENDED = """schema = 1
kind = "extended"
name = "cell"
joints = ["a", "b", "c"]
links = ["la", "lb", "lc"]
[scales]
torque_rated = [40.0, 40.0, 40.0]
torque_max = [120.0, 120.0, 120.0]
fastest = [2.0, 2.0, 2.0]
"""


def test_a_law_is_read_from_an_extended_model_without_code(tmp_path) -> None:
    law = Law(
        1,
        "drive_torque",
        (Factor(LawSource("direction", 1), "linear"), *law_with("position", "step", ()).factors),
    )
    text = _format_effect(
        EstimatedEffect(
            located=LocatedEffect(effect=law_effect(law, [3.0]), joint=1, shapes=law.shapes),
            amplitudes=(3.0,),
        ),
        sample_signals().constants,
        {},
        None,
    )
    path = tmp_path / "extended.toml"
    path.write_text(EXTENDED + text)
    (found,) = load_extended(path).extension.effects
    read = law_of(found.effect)
    assert read == law
    assert (found.effect.name, found.amplitudes, found.shapes) == (law.name, (3.0,), law.shapes)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ('signal = "sped"', "no signal 'sped'"),
        ('signal = "speed", joint = 9', "needs a joint, 1 to 3"),
        ('signal = "height", joint = 1', "has no joint"),
    ],
)
def test_a_wrong_signal_of_a_law_is_named(tmp_path, entry: str, message: str) -> None:
    path = tmp_path / "extended.toml"
    law = f'law = {{ place = "drive_torque", factors = [{{ {entry}, form = "linear" }}] }}'
    path.write_text(f'{EXTENDED}[[effect]]\nname = "l"\njoint = 1\n{law}\nterm = {{ A = 1.0 }}\n')
    with pytest.raises(InputFileError, match=message):
        load_extended(path)


def test_what_no_law_explains_is_kept_as_a_table_within_its_range(tmp_path) -> None:
    def content(signals):
        # Peaks that no form of the grammar has, times the direction of motion.
        q = signals.motor_position[:, 2]
        return 5.0 * signals.motor_direction[:, 4] * (np.abs(q) < 0.2) * (1.0 - np.abs(q) / 0.2)

    channel = KnownChannel(content)
    free, left = best_sum(channel, screen(channel))
    assert channel.share(left) > MIN_KEPT_SHARE
    tables = residual_tables(channel, free)
    signals = channel.comparison.runs[0].signals
    whole = sum(table.value(signals) for table in tables)
    truth = content(signals)
    assert np.sum((truth - whole) ** 2) < 0.5 * np.sum(truth**2)
    parts = [_format_table("[residual]", _describe_table(replace(t, joint=0))) for t in tables]
    path = tmp_path / "extended.toml"
    path.write_text("\n".join([EXTENDED, *parts]).replace("joint = 5", "joint = 3"))
    model = load_extended(path)
    read = [table_of(each.effect) for each in model.extension.effects]
    assert [t.values for t in read] == [t.values for t in tables]
    # Beyond the range that was seen the table is constant.
    beyond = replace(tables[0], source=LawSource("session_time"), carrier=())
    far = SimpleNamespace(session_time=np.array([-1e6, 1e6]))
    assert list(beyond.value(far)) == [beyond.values[0], beyond.values[-1]]


def test_stop_follows_and_slides() -> None:
    x = np.cumsum(np.random.default_rng(4).normal(size=300))
    play, slid = x[0], []
    for value in x:
        play = min(max(play, value - 0.8), value + 0.8)
        slid.append(value - play)
    np.testing.assert_array_equal(operators.stop(x, 0.8), slid)


@pytest.mark.parametrize("lag", [0.05, 0.05 + 1e-3j])
def test_linear_operators_equal_their_recurrences(lag: complex) -> None:
    x = np.cumsum(np.random.default_rng(5).normal(size=300))
    kept, y = np.exp(-0.002 / lag), [x[0]]
    for value in x[1:]:
        y.append(kept * y[-1] + (1.0 - kept) * value)
    np.testing.assert_allclose(operators.lag(x, lag, 0.002), y, rtol=1e-12, atol=1e-12)
    rest = operators.sprung(np.full(50, 3.0), 5.0, 0.1, 0.002)
    np.testing.assert_allclose(rest, 3.0, rtol=1e-12)
