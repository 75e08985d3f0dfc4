"""Sentences of a diagnosis: missing effects, confidence, unexplained residual, validation."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from stiffopt.discovery.answer import (
    MAX_HEADLINE_FINDINGS,
    Statement,
    action,
    held_out_share,
    open_share,
    statement_headline,
    statements,
)
from stiffopt.discovery.diagnosis import Diagnosis, Finding
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.judging.unexplained import ToolForce, Unexplained
from stiffopt.discovery.names import Channel, channel_name
from stiffopt.discovery.thresholds import OPEN_RATIO
from stiffopt.report.common.text import capital, listed, significant, words
from stiffopt.report.diagnosis.values_to_enter import farthest_value, largest_moment_change

CONTACT_PHRASE = "Contact, load or offset"

CHANNEL_OUTCOMES = {
    "named": "explained by findings",
    "nothing": "nothing missing",
    "outside": "outside the catalogue",
}

# Causes of bursts by the signal that they follow.
_BURST_CAUSES = {"torque": "saturates", "dtorque": "limits the rate of its torque"}


def new_and_unstated(diagnosis: Diagnosis) -> tuple[list[Finding], list[Finding]]:
    """Return new effects, and values that every arm has and the nominal model does not state."""
    every = [each.finding for each in statements(diagnosis)]
    unstated = [f for f in every if f.located.calibrated]
    return [f for f in every if f not in unstated], unstated


def unchanged_sentence(diagnosis: Diagnosis) -> str:
    """Return a sentence that nothing changed since the starting model, with its unexplained rest.

    Empty without a starting model, and where something is missing.
    """
    comparison = diagnosis.search.comparison
    if diagnosis.verdict != "nothing_missing" or not comparison.after_model:
        return ""
    least = np.where(np.isfinite(diagnosis.search.after), comparison.least, 1.0)
    worst = int(np.argmax(least))
    text = "Nothing has changed since the model"
    if least[worst] <= 1.0:
        return f"{text}."
    where = channels_in_words([worst_channel(diagnosis, least)])
    return (
        f"{text}; it leaves {significant(float(least[worst]), 2)} times the noise unexplained in"
        f" {where}."
    )


def headline(diagnosis: Diagnosis) -> str:
    """Return the headline: missing effects with their places, or none, and contact intervals."""
    return f"{_findings_headline(diagnosis)}{_contact_clause(diagnosis)}"


def _contact_clause(diagnosis: Diagnosis) -> str:
    """Return a clause on contact intervals, which no finding describes, or ""."""
    times = [
        f"{each.run} ({each.begin:.2f} to {each.end:.2f} s)"
        for each in diagnosis.episodes
        if not each.stays
    ]
    shown, more = times[:MAX_HEADLINE_FINDINGS], len(times) - MAX_HEADLINE_FINDINGS
    told = listed([*shown, *([f"{more} more"] if more > 0 else [])])
    return f"; {CONTACT_PHRASE.lower()} in {told}" if times else ""


def _findings_headline(diagnosis: Diagnosis) -> str:
    if nothing := unchanged_sentence(diagnosis):
        return nothing.removesuffix(".")
    if diagnosis.verdict == "nothing_missing":
        silent = " ".join(unassessed_joint_sentences(diagnosis)).removesuffix(".")
        return f"Nothing is missing within the tolerances{silent and '. '}{silent}"
    if not diagnosis.findings:
        if diagnosis.unexplained is not None and diagnosis.unexplained.tool_force is not None:
            force = diagnosis.unexplained.tool_force
            return f"A force of up to {significant(force.size, 2)} N acts on the tool"
        where = (
            channels_in_words(diagnosis.unexplained.channels[:1]) if diagnosis.unexplained else ""
        )
        if diagnosis.unexplained is not None and diagnosis.unexplained.held_out is not None:
            return f"{diagnosis.unexplained.held_out.run} differs from all training runs in {where}"
        return f"An effect outside the catalogue acts on {where}"
    new, unstated = new_and_unstated(diagnosis)
    text = statement_headline(diagnosis, new)
    # Share of the mismatch on held-out runs from which findings lead a headline in any case.
    least = min(0.01, open_share(diagnosis))
    leading = [each for each in new if each.certainty != "possible"]
    if unstated and all(held_out_share(diagnosis, each) < least for each in leading):
        values = f"identified values without nominal value: {_unstated_phrase(unstated)}"
        text = f"{values}; small beside them: {text}" if leading else values
    if rigid := _rigid_clause(diagnosis, least):
        text = f"{text}; {rigid}"
    if pinned := farthest_value(diagnosis):
        parts = [text, f"{pinned}, beyond its tolerance"]
        shown = max((held_out_share(diagnosis, each) for each in leading), default=0.0)
        text = "; ".join(reversed(parts) if _nominal_share(diagnosis) > shown else parts)
    left = diagnosis.unexplained
    if left is None:
        return capital(text)
    if not leading:
        # Nothing else is known for sure: the residual is the news.
        return capital(f"{_describe_open_residual(left)}; {text}")
    more = is_partly_unexplained(diagnosis)
    return capital(f"{text}; {_describe_open_residual(left)}" if more else text)


def _rigid_clause(diagnosis: Diagnosis, least: float) -> str:
    """Return what re-identified masses changed most, where they explain the share `least`."""
    rigid = diagnosis.search.rigid
    if rigid is None or not rigid.freed or _nominal_share(diagnosis) < least:
        return ""
    change = largest_moment_change(diagnosis)
    return f"masses re-identified (most: {change})" if change else ""


def _nominal_share(diagnosis: Diagnosis) -> float:
    """Return the share of the mismatch on held-out runs that nominal values explain."""
    own = (each.share for each in diagnosis.shares if each.part and each.part.kind == "nominal")
    return max(own, default=0.0)


def is_partly_unexplained(diagnosis: Diagnosis) -> bool:
    """Return True where findings leave so large a residual that they may be misattributed."""
    left = diagnosis.unexplained
    if not diagnosis.findings or left is None:
        return False
    return diagnosis.verdict == "outside_catalogue" or left.ratio >= OPEN_RATIO


def _describe_open_residual(left: Unexplained) -> str:
    """Return a clause on the unexplained residual."""
    where = channels_in_words(left.channels[:1])
    return f"{significant(left.ratio, 2)} times the noise remains unexplained in {where}"


def unassessed_joint_sentences(diagnosis: Diagnosis) -> list[str]:
    """Return a sentence for each joint whose stated torque is usable in no training run."""
    training, n = diagnosis.training, diagnosis.training.robot.n
    stated = diagnosis.recordings.signals.torque or ("",) * n
    silent = [
        j for j in range(n) if stated[j] and j not in diagnosis.search.comparison.rows.channels
    ]
    found = []
    for j in silent:
        broken = {
            run
            for run, fault in diagnosis.faults
            if fault.joint == j + 1 and fault.signal == "torque" and fault.left_out
        }
        still = not any(
            (abs(run.signals.motor_velocity[:, j]) >= training.settings.slow).any()
            for run in training.runs
        )
        why = "its torque is usable in no training run"
        if still and not broken.issuperset(run.name for run in training.runs):
            why = "it never moves, or its position does not follow it"
        found.append(f"Joint {j + 1} was not assessed: {why}.")
    return found


def saturation_sentences(diagnosis: Diagnosis) -> list[str]:
    """Return a sentence for each joint whose torque saturates."""
    worst: dict[int, tuple[float, str]] = {}
    for run, fault in diagnosis.faults:
        # Share of a run above which a saturated torque is reported.
        if fault.kind == "saturated" and fault.joint is not None and fault.share > 0.05:
            worst[fault.joint] = max(worst.get(fault.joint, (0.0, "")), (fault.share, run))
    return [
        f"The torque of joint {joint} is saturated in {100.0 * share:.0f} % of {run}, which hides "
        "the true torque. Record it below its limit."
        for joint, (share, run) in sorted(worst.items())
    ]


def verdict_words(diagnosis: Diagnosis) -> str:
    """Return the verdict in words that fit the probability of the leading finding."""
    if diagnosis.verdict == "nothing_missing":
        return "nothing missing"
    leading = _leading_statements(diagnosis)
    if not leading:
        return "outside the catalogue"
    first = leading[0]
    if diagnosis.verdict == "law_found" and first.certainty == "found":
        return "law found that no catalogue has"
    name = {
        "found": "cause found",
        "likely": "likely cause",
        "one of these": "one of several causes",
    }[first.certainty]
    return f"{name}, large unexplained residual" if is_partly_unexplained(diagnosis) else name


def _leading_statements(diagnosis: Diagnosis) -> list[Statement]:
    """Return the named effects, or, as in the headline after them, values that every arm has."""
    named = [each for each in statements(diagnosis) if each.certainty != "possible"]
    return [each for each in named if not each.finding.located.calibrated] or named


def paragraph(diagnosis: Diagnosis) -> str:
    """Return the paragraph to forward: set, missing physics, surety, validation, what to do."""
    parts = [f"{diagnosis.recordings.title}: {headline(diagnosis)}."]
    leading = _leading_statements(diagnosis)
    if diagnosis.verdict == "nothing_missing":
        most = significant(worst_ratio(diagnosis.search.after), 2)
        parts.append(
            f"No effect of the catalogue is needed: the worst channel of the training runs is at"
            f" {most} times its noise."
        )
    elif leading:
        parts.append(_surety_sentence(leading))
    parts += [
        proof_sentence(diagnosis),
        unexplained_sentence(diagnosis),
        *(str(mode) for mode in diagnosis.modes if mode.is_shifted),
    ]
    if is_partly_unexplained(diagnosis):
        parts.append(
            "Findings beside so large a residual may be misattributed: check unit, torque constant"
            " and masses first."
        )
    if leading:
        parts.append(f"To do: {action(diagnosis)}")
    return " ".join(part for part in parts if part)


def _surety_sentence(named: Sequence[Statement]) -> str:
    """Return a sentence on the probabilities of the findings of the headline."""
    shown = [
        f"{each.finding.effect.title} ({each.place}) {each.probability}"
        for each in named[:MAX_HEADLINE_FINDINGS]
    ]
    return f"Probability that it is the cause: {listed(shown)}."


def residual_reduction(diagnosis: Diagnosis, channel: str) -> tuple[float, float]:
    """Return residual over noise in training: nominal values within tolerance, with findings."""
    number = Channel.read(channel).number(diagnosis.recordings.n)
    return float(diagnosis.search.calibrated[number]), float(diagnosis.search.after[number])


def unexplained_sentence(diagnosis: Diagnosis) -> str:
    """Return sentences on the unexplained residual, its dependence, and a single deviating run."""
    unexplained = diagnosis.unexplained
    if unexplained is None:
        return ""
    text = _dependence_sentence(unexplained)
    if unexplained.alone is not None:
        run, ratio = unexplained.alone
        text += (
            f" In {run} the residual of the nominal model there is {significant(ratio, 2)} times"
            " that of any other training run: check whether its payload or arm differs."
        )
    return text + lawless_sentence(diagnosis, unexplained.channels[0])


def lawless_sentence(diagnosis: Diagnosis, channel: str) -> str:
    """Return a sentence on what any law could explain in a channel where none holds, or ""."""
    each = next((each for each in diagnosis.lawless if each.channel == channel), None)
    if each is None:
        return ""
    text = f" No law of the recorded signals holds there ({each.reason}); any law could explain at"
    text += f" most about {100 * each.attainable:.0f} % of it"
    text += f", of the {listed(each.signals)}." if each.signals else "."
    if each.tables:
        text += " That is kept in [[residual]] of extended.toml, for predictions and not for plans."
    return text


def _dependence_sentence(unexplained: Unexplained) -> str:
    channels = channels_in_words(unexplained.channels)
    if unexplained.held_out is not None:
        own = unexplained.held_out
        return (
            f"In {own.run}, which was held out, the residual of {channels} reaches"
            f" {significant(own.ratio, 2)} times the noise between {own.begin:.2f} and"
            f" {own.end:.2f} s, far more than in any training run."
        )
    if unexplained.brief:
        return (
            f"The residual of {channels} is {unexplained.ratio:.2g} times the noise, in bursts:"
            f" {100 * unexplained.gain:.0f} % of it occurs where"
            f" {regressor_words(unexplained.regressors[0])} is largest, as with a drive that"
            f" {_BURST_CAUSES[unexplained.regressors[0].partition('_')[0]]}."
        )
    text = f"Up to {unexplained.ratio:.2g} times the noise remains unexplained in {channels}"
    if unexplained.tool_force is not None:
        return f"{text}; {_tool_force_clause(unexplained.tool_force)}"
    if unexplained.period is not None:
        text += f"; it has a period of {significant(unexplained.period, 3)} s in any motion"
        return f"{text}: a sinusoid of that period explains {100 * unexplained.gain:.0f} % of it."
    elif unexplained.regressors:
        text += f"; it depends on {listed(regressor_words(r) for r in unexplained.regressors)}"
    else:
        return f"{text}; it depends on no recorded signal."
    return (
        f"{text}, which predicts {100 * unexplained.gain:.0f} % of it in left-out intervals of the"
        " training runs."
    )


def _tool_force_clause(force: ToolForce) -> str:
    # Length of the mean over the root mean square of forces, above which they are called constant.
    kind = "nearly constant" if force.steadiness > 0.9 else "changing"
    return (
        f"a {kind} force at the tool, up to {significant(force.size, 2)} N, explains"
        f" {100.0 * force.explained:.0f} % of it: the arm was guided by hand, touched something or"
        " was pulled, as by a hose. Record it moving freely, or leave such runs out."
    )


def proof_sentence(diagnosis: Diagnosis) -> str:
    """Return the validation sentence: residual over noise in held-out runs, before and after."""
    parts = []
    for role, runs in (("test", "test runs"), ("extrapolate", "extrapolation runs")):
        if diagnosis.proofs(role):
            before, after = diagnosis.nrmse(role)
            parts.append(f"from {significant(before, 3)} to {significant(after, 3)} in {runs}")
    if not parts:
        return ""
    change = " and ".join(parts)
    text = f"Validation on held-out runs: residual {change}, in units of the sensor noise."
    left = [diagnosis.nrmse(role)[1] for role in ("test", "extrapolate") if diagnosis.proofs(role)]
    # Residual over noise of held-out runs above which the worst channel is named.
    if max(left) > 2.0 and diagnosis.findings:
        worst = worst_channel(diagnosis, diagnosis.search.after)
        text += (
            f" The largest residual remains in {channels_in_words([worst])}, "
            f"{significant(residual_reduction(diagnosis, worst)[1], 2)} times its noise in the "
            "training runs."
        )
    return text


def worst_ratio(ratios: np.ndarray) -> float:
    """Return the largest residual over noise of any channel; nan without one."""
    known = ratios[np.isfinite(ratios)]
    return float(known.max()) if known.size else math.nan


def channel_words(name: str) -> str:
    """Return a channel such as "torque_3" in words."""
    channel = Channel.read(name)
    return f"{channel.sensor} of joint {channel.joint}"


def channels_in_words(channels: Iterable[str]) -> str:
    """Return channels as part of a sentence.

    >>> channels_in_words(["torque_3", "link_position_1"])
    'the torque of joint 3 and the link encoder of joint 1'
    """
    return listed(f"the {channel_words(name)}" for name in channels)


def worst_channel(diagnosis: Diagnosis, ratios: np.ndarray) -> str:
    """Return the name of the channel with the largest residual over noise."""
    return channel_name(int(np.nanargmax(ratios)), diagnosis.recordings.n)


def regressor_words(name: str) -> str:
    """Return the name of a signal on which a residual depends, in words."""
    names = {
        "q": "position of joint",
        "qd": "speed of joint",
        "qdd": "acceleration of joint",
        "torque": "load of joint",
        "dtorque": "rate of the load of joint",
    }
    first, _, by = name.partition(" x ")
    kind, _, joint = first.rpartition("_")
    text = f"the {names[kind]} {joint}" if kind in names else f"the {words(first)}"
    return f"{text} and the direction of motion" if by else text


def unstated_groups(unstated: Sequence[Finding]) -> list[list[Finding]]:
    """Return findings that supply missing nominal values, grouped by kind, sorted by joint."""
    groups: dict[str, list[Finding]] = {}
    for finding in unstated:
        groups.setdefault(finding.effect.name, []).append(finding)
    return [sorted(own, key=lambda f: f.joint or 0) for own in groups.values()]


def value_name(effect: Effect) -> str:
    """Return the name in prose of the value that an effect supplies."""
    return effect.nominal_words or effect.title


def _unstated_phrase(unstated: Sequence[Finding]) -> str:
    return listed(
        f"{value_name(own[0].effect)} of {joints_in_words([f.joint for f in own if f.joint])}"
        for own in unstated_groups(unstated)
    )


def joints_in_words(numbers: list[int]) -> str:
    """Return joints as part of a sentence.

    >>> joints_in_words([2]), joints_in_words([1, 2, 3]), joints_in_words([1, 3])
    ('joint 2', 'joints 1 to 3', 'joints 1 and 3')
    """
    if len(numbers) == 1:
        return f"joint {numbers[0]}"
    if len(numbers) > 2 and numbers == list(range(numbers[0], numbers[-1] + 1)):
        return f"joints {numbers[0]} to {numbers[-1]}"
    return f"joints {listed(map(str, numbers))}"
