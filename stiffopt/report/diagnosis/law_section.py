"""Laws beyond the catalogue on the page: numbers to type in, figure over their signals, proof."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from stiffopt.discovery.comparison.prepared_run import PreparedRun
from stiffopt.discovery.diagnosis import Diagnosis, Finding
from stiffopt.discovery.laws.law import Factor, Law, describe_test, law_of, resembled
from stiffopt.discovery.laws.sources import LawSource
from stiffopt.report.common.svg import PALE, WIDTH, figure_style, panels
from stiffopt.report.common.text import listed, scale
from stiffopt.report.diagnosis import regimes
from stiffopt.report.diagnosis.values_to_enter import change_words
from stiffopt.report.diagnosis.words import channel_words

# Definitions of what an equation of a law may contain, for samples x_0, x_1, ... every dt seconds.
_OPERATOR_DEFINITIONS = {
    "sg": "sg(w) is tanh(w / 0.01) of a speed w in rad/s, in a sample where it reverses its mean"
    " over the sample period",
    "lag": "lag(x, T) is y with y_k = p * y_(k-1) + (1 - p) * x_k, p = exp(-dt / T):"
    " T dy/dt = x - y",
    "sprung": "sprung(x, f, zeta) is the acceleration y of a mass on a spring and damper of"
    " frequency f and damping ratio zeta whose base accelerates by x: with o = tan(pi * f * dt),"
    " (1 + 2 * zeta * o + o**2) * y_k + 2 * (o**2 - 1) * y_(k-1) +"
    " (1 - 2 * zeta * o + o**2) * y_(k-2) = (o**2 + 2 * zeta * o) * x_k + 2 * o**2 * x_(k-1) +"
    " (o**2 - 2 * zeta * o) * x_(k-2)",
    "mode": "mode(x, f, zeta) is the deflection y of a mass on a spring and damper of"
    " frequency f and damping ratio zeta, over that under a constant x: with o = tan(pi * f * dt),"
    " (1 + 2 * zeta * o + o**2) * y_k + 2 * (o**2 - 1) * y_(k-1) +"
    " (1 - 2 * zeta * o + o**2) * y_(k-2) = o**2 * (x_k + 2 * x_(k-1) + x_(k-2))",
    "stop": "stop(x, r) follows x and slides where it would leave -r to r: it is x_k - y_k with"
    " y_0 = x_0 and y_k = min(max(y_(k-1), x_k - r), x_k + r)",
}
# What a law adds to, with its sign, for whoever types it into a simulator.
_TARGET_SENTENCES = {
    "drive_torque": "The law adds to the torque that the drive of joint {} has to give for a"
    " motion: in a forward simulation it acts on the motor with the opposite sign.",
    "link_torque": "The law adds to the torque that joint {} has to pass on to its link for a"
    " motion, and winds up the joint: in a forward simulation it acts on the link with the opposite"
    " sign.",
    "deflection": "The law adds to the angle of the motor of joint {} less that of its link.",
}
# What linear operators take their signal for before the recording.
_HISTORY_DEFINITIONS = {
    "speed": "before its first sample a joint has started from rest: with its speed w_0 and"
    " acceleration a_0 there, n = w_0 / (a_0 * dt) rounded, at most the number of samples, none"
    " where w_0 * a_0 is not positive, its acceleration was a_0 in n samples, its speed"
    " w_0 * k / n, k = 0 to n - 1, and before them x = y = 0",
    "load": "before its first sample a load was x = y = x_0",
}
_HISTORY_DEFINITIONS["acceleration"] = _HISTORY_DEFINITIONS["speed"]
# Share of a law's variance from which a nominal value is told beside it: others change little.
_MIN_SHARED_VARIANCE = 0.1


@dataclass(frozen=True, kw_only=True)
class LawOnPage:
    """A law with its numbers."""

    equation: str
    numbers: tuple[str, ...]  # every value in full, for another simulator
    signals: tuple[str, ...]  # meaning of every symbol
    lines: tuple[str, ...]  # what it explains, what it resembles, the test that would tell


def laws_on_page(diagnosis: Diagnosis) -> dict[Finding, LawOnPage]:
    """Return the laws among the findings."""
    found = {}
    for finding in diagnosis.findings:
        law = law_of(finding.effect)
        if law is not None:
            found[finding] = _describe_law(diagnosis, finding, law)
    return found


def _describe_law(diagnosis: Diagnosis, finding: Finding, law: Law) -> LawOnPage:
    values = (*finding.estimated.amplitudes, *finding.located.shapes)
    lines = [
        _TARGET_SENTENCES[law.place].format(law.joint + 1),
        _describe_range(diagnosis, law),
        _describe_share(diagnosis, finding),
        _describe_values(diagnosis, finding),
        f"In words: {law.words}{resembled(law)}.",
        f"The test that would tell: {describe_test(law)}",
    ]
    return LawOnPage(
        equation=law.equation,
        numbers=law_numbers(law, values),
        signals=law_definitions(law),
        lines=tuple(line for line in lines if line),
    )


def law_numbers(law: Law, values: Sequence[float]) -> tuple[str, ...]:
    """Return every amplitude and shape in full with its unit."""
    names = (*law.amplitude_names, *law.shape_names)
    units = (*law.amplitude_units, *law.shape_units)
    every = zip(names, values, units, strict=True)
    return tuple(f"{name} = {float(value)!r} {unit}".rstrip() for name, value, unit in every)


def law_definitions(law: Law) -> tuple[str, ...]:
    """Return the meaning of every symbol and function of the equation."""
    signals = dict.fromkeys(f"{f.source.symbol} is the {f.source.words}" for f in law.factors)
    used = [
        words
        for name, words in _OPERATOR_DEFINITIONS.items()
        if re.search(rf"\b{name}\(", law.equation)
    ]
    past = (f.source.kind for f in law.factors if f.own.has_memory)
    begins = (_HISTORY_DEFINITIONS[kind] for kind in past if kind in _HISTORY_DEFINITIONS)
    return (*signals, *used, *dict.fromkeys(begins))


def _describe_range(diagnosis: Diagnosis, law: Law) -> str:
    """Return the range of each signal of the training runs, in which the law was seen."""
    runs = diagnosis.search.comparison.runs
    ranges = []
    for source in dict.fromkeys(factor.source.origin for factor in law.factors):
        own = np.concatenate([_signal_of(source, run) for run in runs])
        ranges.append(
            f"{source.symbol} from {own.min():.3g} to {own.max():.3g} {source.own.unit}".rstrip()
        )
    if not ranges:
        return ""
    return (
        f"The training runs show it for {listed(ranges)}; beyond that range the equation"
        " extrapolates."
    )


def _describe_share(diagnosis: Diagnosis, finding: Finding) -> str:
    """Return what the law explains where it was not fitted, beside what any law could."""
    for each in diagnosis.laws:
        if each.located.same_place(finding.located):
            held = next((c for c in diagnosis.channels if c.channel == each.channel), None)
            text = (
                f"Of the residual of the {channel_words(each.channel)} beyond the noise it explains"
                f" {100 * each.explained:.0f} % in parts of the training runs left out; the best"
                " smooth function of the signals, which any law of them is, explains"
                f" {100 * each.attainable:.0f} %. It is the best of {each.tried} laws that were"
                " tried, which its probability accounts for."
            )
            if held is not None:
                text += (
                    f" In held-out runs the residual falls from {held.rms_before / held.noise:.3g}"
                    f" to {held.rms_after / held.noise:.3g} times the noise."
                )
            return text
    return ""


def _describe_values(diagnosis: Diagnosis, finding: Finding) -> str:
    """Return the nominal values fitted beside a law that its size is told together with.

    A part of a law may be in nominal values within their tolerances: both together are the model.
    """
    fit = diagnosis.search.fit
    keys = [each.key for each in fit.effects]
    if not fit.nuisance or finding.located.key not in keys:
        return ""
    place = keys.index(finding.located.key)
    begin = fit.nuisance + sum(len(e.effect.amplitudes) for e in fit.effects[:place])
    own = slice(begin, begin + len(finding.effect.amplitudes))
    columns = diagnosis.search.comparison.stack_columns(fit.effects)[:, own]
    squares, covariance = columns.T @ columns, fit.posterior.covariance
    # Share of the law's variance, over all rows, that is gone where a nominal value is known.
    shared = covariance[own, : fit.nuisance]
    gone = np.sum(shared * (squares @ shared), axis=0) / np.diag(covariance)[: fit.nuisance]
    shares = gone / np.sum(squares * covariance[own, own])
    names = diagnosis.search.comparison.priors[0]
    told = [
        f"{change_words(names[k], diagnosis.extension.calibration[names[k]])} here, by"
        f" {100 * shares[k]:.0f} %"
        for k in np.argsort(-shares)
        if shares[k] >= _MIN_SHARED_VARIANCE and names[k] in diagnosis.extension.calibration
    ]
    text = (
        "Nominal values within their tolerances were fitted beside it and may hold a part of what"
        " acts there: enter those of extended.toml together with the equation."
    )
    if told:
        text += f" A measurement of one of them would lower the law's variance: {'; '.join(told)}."
    return text


def _drawn_signals(law: Law) -> dict[str, Callable[[PreparedRun], np.ndarray]]:
    """Return the signals of a law by label; past ones as the law takes them.

    A residual that follows the past of a signal has no curve over its present value.
    """
    found: dict[str, Callable[[PreparedRun], np.ndarray]] = {}
    for factor in law.factors:
        source, words = factor.source, factor.source.words
        value = partial(_signal_of, source)
        if source.kind == "direction":
            continue
        if factor.own.has_memory and len(factor.own.formulas) == 1:
            value = partial(_value_of, factor)
            words = f"{replace(law, factors=(factor,)).formulas(code=False)[0]} of the {words}"
        found[f"{words} [{source.own.unit}]" if source.own.unit else words] = value
    if not found:
        own = LawSource("position", law.joint)
        found[f"{own.words} [{own.own.unit}]"] = partial(_signal_of, own)
    return found


def _signal_of(source: LawSource, run: PreparedRun) -> np.ndarray:
    return np.asarray(source.value(run.signals))


def _value_of(factor: Factor, run: PreparedRun) -> np.ndarray:
    return np.asarray(factor.values(run.signals)[0])


@figure_style()
def law_figure(
    diagnosis: Diagnosis, rows: regimes.ChannelResiduals, finding: Finding
) -> Figure | None:
    """Plot the residual without a law over each of its signals, with the law through it."""
    law = law_of(finding.effect)
    if law is None:
        return None
    drawn = _drawn_signals(law.with_shapes(finding.located.shapes))
    added = regimes.finding_contribution(diagnosis, finding, rows)
    residual = rows.after + added
    factor, unit = scale(float(np.quantile(np.abs(residual), 0.95)), rows.unit)
    sides = regimes.motion_direction(diagnosis, rows)
    sampled = diagnosis.search.comparison.rows.sample_signal
    figure, grid = panels(len(drawn), len(drawn), (WIDTH, 3.2), sharey=True)
    for axes, (label, value) in zip(grid, drawn.items(), strict=True):
        regime = regimes.Regime(label, label, sampled(value)[rows.chosen])
        noise = factor * float(np.median(rows.noise))
        axes.axhspan(-noise, noise, color=PALE, alpha=0.55, zorder=0, linewidth=0)
        for side, colour, words in regimes.DIRECTION_STYLES:
            own = sides == side
            if own.sum() > 1:
                parts = factor * residual, factor * added
                regimes.draw_direction(axes, regime, own, *parts, rows.run, colour)
                axes.plot([], [], "o", color=colour, label=words)
        axes.set_xlabel(label)
    grid[0].set_ylabel(f"residual without the law [{unit}]")
    grid[0].legend(loc="best")
    figure.subplots_adjust(left=0.065, right=0.99, bottom=0.17, wspace=0.08)
    return figure
