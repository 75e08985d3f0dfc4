"""Sections of an answer: the sentences and tables that page and terminal both show."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from stiffopt.discovery.answer import (
    MIN_LISTED_PROBABILITY,
    Statement,
    changed_values,
    is_prismatic,
    statements,
)
from stiffopt.report.common.terminal import Section
from stiffopt.report.common.text import DASH, MAX_LISTED, capital, joint_unit, pm, significant
from stiffopt.report.diagnosis.mismatch import (
    counterbalance_sentences,
    episode_sentences,
    format_probability_range,
    format_share_range,
    mismatches,
    noise_ceiling_sentence,
    transfer_sentences,
)
from stiffopt.report.diagnosis.values_to_enter import mass_sentences, value_sentences
from stiffopt.report.diagnosis.words import (
    channel_words,
    joints_in_words,
    new_and_unstated,
    saturation_sentences,
    unassessed_joint_sentences,
    unstated_groups,
    value_name,
)

if TYPE_CHECKING:
    from stiffopt.discovery.diagnosis import Diagnosis, Finding

_FINDING_COLUMNS = ("finding", "probability", "value ± standard deviation", "explains", "or else")
_CHANGE_COLUMNS = ("changed value", "from", "to", "cause")


def answer_sections(diagnosis: Diagnosis) -> list[Section]:
    """Return the sections of an answer that have content, the most important first."""
    every = [
        Section(title="Findings", head=_FINDING_COLUMNS, rows=tuple(finding_rows(diagnosis))),
        _changes_section(diagnosis),
        Section(title="Composition of the mismatch", lines=tuple(mismatch_lines(diagnosis))),
        Section(
            title="Next experiment",
            lines=(diagnosis.next_experiment,) if diagnosis.next_experiment else (),
        ),
    ]
    return [each for each in every if each.lines or each.rows]


def _changes_section(diagnosis: Diagnosis) -> Section:
    rows = change_rows(diagnosis)
    rest = len(rows) - MAX_LISTED
    return Section(
        title="Changed values",
        head=_CHANGE_COLUMNS,
        rows=tuple(rows[:MAX_LISTED]),
        lines=(f"{rest} smaller changes are in diagnosis.json.",) if rest > 0 else (),
    )


def finding_rows(diagnosis: Diagnosis) -> list[tuple[str, ...]]:
    """Return a row of every finding, those without nominal value by kind and last."""
    _, unstated = new_and_unstated(diagnosis)
    rows = [_state_row(each) for each in statements(diagnosis) if each.finding not in unstated]
    shown = [each for each in unstated if each.probability >= MIN_LISTED_PROBABILITY]
    return rows + [_unstated_row(diagnosis, own) for own in unstated_groups(shown)]


def change_rows(diagnosis: Diagnosis) -> list[tuple[str, ...]]:
    """Return a row of every value of the model that changed."""
    return [
        (
            f"{change.quantity}, joint {change.joint} ({change.name})",
            f"{significant(change.old)} {change.unit}",
            f"{significant(change.new)} {change.unit}",
            each.cause,
        )
        for each in changed_values(diagnosis)
        for change in (each.change,)
    ]


def mismatch_lines(diagnosis: Diagnosis) -> list[str]:
    """Return sentences on what explains the mismatch, and on what was left out or differs."""
    lines = [
        *(each.sentence for each in mismatches(diagnosis)),
        *value_sentences(diagnosis),
        *mass_sentences(diagnosis),
        *counterbalance_sentences(diagnosis),
        *unassessed_joint_sentences(diagnosis),
        *saturation_sentences(diagnosis),
        *episode_sentences(diagnosis),
        noise_ceiling_sentence(diagnosis),
        *transfer_sentences(diagnosis),
    ]
    return [line for line in lines if line]


def _state_row(each: Statement) -> tuple[str, ...]:
    finding = each.finding
    return (
        f"{each.place}: {finding.effect.title}",
        f"{each.probability}, {each.certainty}",
        "\n".join(each.values),
        f"{100 * finding.variance_explained:.0f} % of {channel_words(finding.channel)}",
        "\n".join(each.rivals) or DASH,
    )


def _unstated_row(diagnosis: Diagnosis, own: Sequence[Finding]) -> tuple[str, ...]:
    """Return the row of one kind of value that the nominal model does not state."""
    first = own[0].parameters[0]
    unit = joint_unit(first.unit, is_prismatic(diagnosis, own[0].located))
    shares = [each.variance_explained for each in own]
    where = joints_in_words([each.joint for each in own if each.joint is not None])
    return (
        capital(f"{value_name(own[0].effect)} of {where} (no nominal value)"),
        format_probability_range([each.probability for each in own]),
        "\n".join(
            f"joint {each.joint}: {pm(each.parameters[0].value, each.parameters[0].sd, unit)}"
            for each in own
        ),
        format_share_range(min(shares), max(shares)),
        DASH,
    )
