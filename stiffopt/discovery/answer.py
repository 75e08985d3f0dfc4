"""Answer of a diagnosis in words: what is missing, how sure it is, what to do.

Page, terminal and diagnosis.json take headline, findings and changed values from here.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from stiffopt.discovery.extended.planning import planner_model
from stiffopt.discovery.extended.value_changes import ValueChange, extended_model, value_changes
from stiffopt.discovery.names import Channel, ValueName
from stiffopt.formatting import pm, scale, significant
from stiffopt.units import joint_unit

if TYPE_CHECKING:
    from stiffopt.discovery.comparison.located_effect import EstimatedEffect, LocatedEffect
    from stiffopt.discovery.diagnosis import Certainty, Diagnosis, Finding, Parameter

# Findings that a headline states; the others are in the table.
MAX_HEADLINE_FINDINGS = 2
# Probability below which a cause is not listed: it would read 0 %.
MIN_LISTED_PROBABILITY = 0.005
# Probability above which "above 99 %" is written.
_MAX_SHOWN_PROBABILITY = 0.995
_UNDETERMINED_AMOUNT = "an undetermined amount"
_VALUE_PLACEHOLDER = re.compile(r"\{([^{}:]+)(:%)?\}")
_CLAUSE_START = re.compile(r"(?=[,;] )")


@dataclass(frozen=True, eq=False)
class Statement:
    """A finding in words."""

    finding: Finding
    place: str
    sentence: str  # place and missing physics with values and standard deviations
    certainty: Certainty  # "found", "likely", "one of these" or "possible"
    probability: str  # in percent
    action: str  # what to do about it
    values: tuple[str, ...]  # reported parameters with standard deviations
    rivals: tuple[str, ...]  # other causes that the data do not tell apart, with probabilities


@dataclass(frozen=True)
class ChangedValue:
    """A value of the nominal robot that the extended model changes, and the cause."""

    change: ValueChange
    cause: str


def statements(diagnosis: Diagnosis) -> list[Statement]:
    """Return the findings in words, in the order of what they explain, the named ones first.

    On held-out runs; alike there, of the excess that nominal values within tolerance leave.
    """
    listed_findings = [f for f in diagnosis.findings if f.probability >= MIN_LISTED_PROBABILITY]

    def order(f: Finding) -> tuple[bool, float, float]:
        explained = (held_out_share(diagnosis, f), explained_squares(diagnosis, f))
        return f.certainty == "possible", -explained[0], -explained[1]

    return [_state_finding(diagnosis, f) for f in sorted(listed_findings, key=order)]


def explained_squares(diagnosis: Diagnosis, finding: Finding) -> float:
    """Return the mean squared residual over noise that a finding removes in its channel."""
    number = Channel.read(finding.channel).number(diagnosis.recordings.n)
    excess = float(diagnosis.search.calibrated[number]) ** 2 - 1.0
    return max(excess, 0.0) * finding.variance_explained


def held_out_share(diagnosis: Diagnosis, finding: Finding) -> float:
    """Return the share of the mismatch on held-out runs that a finding and its like explain.

    The largest of torques and link encoders; infinite where no held-out run tells.
    """
    own = [
        each.share
        for each in diagnosis.shares
        if each.part is not None
        and any(located.key == finding.located.key for located in each.part.effects)
    ]
    return max(own, default=float("inf"))


def open_share(diagnosis: Diagnosis) -> float:
    """Return the share of the mismatch on held-out runs that nothing explains.

    A small finding is news where it explains most of what values leave that every arm has.
    """
    return max((each.share for each in diagnosis.shares if each.part is None), default=0.0)


def changed_values(diagnosis: Diagnosis) -> list[ChangedValue]:
    """Return values that the extended model changes, in the order of what they explain.

    Those of findings come first, then nominal values that were fitted within their tolerances.
    Changes that read alike are left out.
    """
    extension, recordings = diagnosis.extension, diagnosis.recordings
    nominal = recordings.robot
    if not extension.effects or not diagnosis.findings:
        return []

    def changes(
        calibration: Mapping[ValueName, float], effects: tuple[EstimatedEffect, ...]
    ) -> list[ValueChange]:
        own = replace(extension, calibration=calibration, effects=effects)
        model = extended_model(recordings, diagnosis.training.constants, own)
        return value_changes(nominal, planner_model(nominal, model).robot, recordings.order)

    causes: dict[tuple[int, str], str] = {}
    for each in statements(diagnosis):
        for change in changes({}, (each.finding.estimated,)):
            title = f"{each.finding.effect.title}, {each.certainty}"
            causes.setdefault((change.joint, change.quantity), title)
    rank = {key: number for number, key in enumerate(causes)}
    every = [
        ChangedValue(c, causes.get((c.joint, c.quantity), "fitted within its tolerance"))
        for c in changes(extension.calibration, extension.effects)
        if significant(c.old) != significant(c.new)
    ]

    def order(each: ChangedValue) -> tuple[int, float]:
        c = each.change
        relative = abs(c.new - c.old) / max(abs(c.old), abs(c.new))
        return rank.get((c.joint, c.quantity), len(rank)), -relative

    return sorted(every, key=order)


def place(diagnosis: Diagnosis, located: LocatedEffect) -> str:
    """Return the place of an effect: link, joint or robot, with the run of an effect of one run."""
    if located.link is not None:
        link = diagnosis.training.constants.links[located.link]
        return link if link.startswith("link") else f"link {link}"
    if located.joint is None:
        return located.run or "robot"
    where = f"joint {located.joint + 1}"
    return where + (f", {located.run}" if located.run else "")


def is_prismatic(diagnosis: Diagnosis, located: LocatedEffect) -> bool:
    """Return True where an effect's joint is prismatic."""
    joints = diagnosis.training.constants.joints
    return located.joint is not None and joints[located.joint].prismatic


def format_probability(probability: float) -> str:
    """Format a probability in percent, never as certainty."""
    return "above 99 %" if probability > _MAX_SHOWN_PROBABILITY else f"{100 * probability:.0f} %"


def statement_headline(diagnosis: Diagnosis, findings: list[Finding]) -> str:
    """Return the findings for a headline: the first ones with values and places."""
    own = _named_or_all([each for each in statements(diagnosis) if each.finding in findings])
    text = "; ".join(_with_rivals(each) for each in own[:MAX_HEADLINE_FINDINGS])
    if more := len(own) - MAX_HEADLINE_FINDINGS:
        text += f"; and {more} more" if more > 0 else ""
    return text


def _named_or_all(every: list[Statement]) -> list[Statement]:
    """Return the statements of findings that are more than possible, or all if none is."""
    return [each for each in every if each.certainty != "possible"] or every


def action(diagnosis: Diagnosis) -> str:
    """Return what to do: the remedies of the first findings, or the next recording.

    Between two states what changed comes before what both lack.
    """
    own = _named_or_all(statements(diagnosis))
    new = [each for each in own if not each.finding.located.calibrated]
    new.sort(key=lambda each: each.finding not in diagnosis.changes)
    first = next(iter(new or own), None)
    only_rest = not new and diagnosis.unexplained is not None
    if diagnosis.verdict == "nothing_missing":
        return "Nothing has to be changed."
    if first is None or only_rest or first.certainty in ("one of these", "possible"):
        # One line: its first sentence; the whole stands under "Next experiment".
        sentence, dot, _ = diagnosis.next_experiment.partition(". ")
        return sentence + dot.strip()
    sure = [each for each in (new or own) if each.certainty in ("found", "likely")]
    actions = list(dict.fromkeys(each.action for each in sure))
    more = len(actions) - MAX_HEADLINE_FINDINGS
    rest = [f"{more} more in the table of findings."] if more > 0 else []
    return " ".join([*actions[:MAX_HEADLINE_FINDINGS], *rest])


def _with_rivals(each: Statement) -> str:
    if each.certainty == "found":
        return each.sentence
    if each.certainty == "one of these":
        return f"one of these: {each.sentence}, or {' or '.join(each.rivals)}"
    return f"{each.certainty} ({each.probability}): {each.sentence}"


def _name_parameters(diagnosis: Diagnosis, finding: Finding) -> dict[str, Parameter]:
    """Return the reported values by name, with units of a prismatic joint where it is one."""
    slides = is_prismatic(diagnosis, finding.located)
    named = {p.name: replace(p, unit=joint_unit(p.unit, slides)) for p in finding.parameters}
    first, size = finding.parameters[0], finding.size
    if size is not None and not first.determined and first.unit == size.unit:
        # Of values that only together are told the size of what they add is stated.
        named[first.name] = replace(size, name=first.name, unit=joint_unit(size.unit, slides))
    return named


def missing_physics(diagnosis: Diagnosis, finding: Finding) -> str:
    """Return the missing physics of a finding in words, with values, without its place."""
    effect = finding.effect
    named = _name_parameters(diagnosis, finding)
    phrase = effect.phrase_of(finding.estimated.amplitudes)
    if finding.located.calibrated and effect.nominal:
        first = next(iter(named.values()))
        value = pm(first.value, first.sd, first.unit)
        phrase = f"{effect.nominal_words} {value}, for which there is no nominal value"
    return fill(phrase, named, signed=isinstance(effect.phrase, str))


def _state_finding(diagnosis: Diagnosis, finding: Finding) -> Statement:
    located = finding.located
    where = place(diagnosis, located)
    named = _name_parameters(diagnosis, finding)
    sentence = missing_physics(diagnosis, finding)
    if where == located.run:  # its name keeps its case where a sentence begins
        sentence = f"in {where}: {sentence}"
    elif where != "robot":
        sentence = f"{where}: {sentence}"
    return Statement(
        finding=finding,
        place=where,
        sentence=sentence,
        certainty=finding.certainty,
        probability=format_probability(finding.probability),
        action=_describe_remedy(diagnosis, finding, named, where),
        values=tuple(f"{p.name} = {p.text}" for p in named.values()),
        rivals=tuple(
            f"{r.located.effect.title} of {place(diagnosis, r.located)}"
            f" ({format_probability(r.probability)})"
            for r in finding.rivals
            if r.probability >= MIN_LISTED_PROBABILITY
        ),
    )


def _describe_remedy(
    diagnosis: Diagnosis, finding: Finding, named: Mapping[str, Parameter], where: str
) -> str:
    effect, located = finding.effect, finding.located
    constants = located.constants(diagnosis.training.constants)
    remedy = effect.remedy
    if callable(remedy):
        remedy = remedy(finding.estimated.amplitudes, located.shapes, constants)
    words = {"where": "the robot" if where == "robot" else where}
    if effect.nominal and located.joint is not None:
        first = next(iter(named.values()))
        old = float(getattr(constants, effect.nominal, 0.0) or 0.0)
        if located.calibrated:
            value = pm(first.value, first.sd, first.unit)
            return f"Enter {effect.nominal_words} {value} for {where}."
        # A change between two states adds to what both have.
        old += sum(
            each.parameters[0].value
            for each in diagnosis.findings
            if each.effect.nominal == effect.nominal
            and each.located.joint == located.joint
            and each.located.calibrated
        )
        words["new"] = f"{significant(old + first.value, 3)} {first.unit}"
    return fill(remedy, named, words)


def fill(
    text: str,
    named: Mapping[str, Parameter],
    words: Mapping[str, str] | None = None,
    *,
    signed: bool = True,
) -> str:
    """Fill the placeholders of a phrase or remedy with values.

    `words`: further placeholders. `signed`: where False, single values have no sign: the phrase
    states it. Clauses on undetermined values are left out after the first.
    """

    def value(match: re.Match[str]) -> str:
        key, share = match[1], match[2]
        if key in (words or {}):
            return (words or {})[key]
        names = key.split("/")
        if len(names) > 1:
            return _format_together([named[name] for name in names])
        own = named[key]
        if not own.determined:
            return _UNDETERMINED_AMOUNT
        size = own.value if signed else abs(own.value)
        if share:
            return f"{pm(100.0 * size, 100.0 * own.sd, '')} %"
        return pm(size, own.sd, own.unit)

    filled = _VALUE_PLACEHOLDER.sub(value, text)
    first, *more = _CLAUSE_START.split(filled)
    told = "".join([first, *(each for each in more if _UNDETERMINED_AMOUNT not in each)])
    return told if filled[-1] == told[-1] else f"{told}."


def _format_together(parameters: list[Parameter]) -> str:
    """Format values in the unit of the largest, such as "0/2/82 mm"."""
    factor, unit = scale(max(abs(p.value) for p in parameters), parameters[0].unit)
    # Plus zero: no minus before a value that rounds to zero.
    return f"{'/'.join(f'{round(factor * p.value) + 0:d}' for p in parameters)} {unit}"
