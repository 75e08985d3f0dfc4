"""Sections of an answer, whose sentences and tables page and terminal show, and their printing."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from stiffopt.discovery.answer import (
    MIN_LISTED_PROBABILITY,
    Statement,
    action,
    changed_values,
    is_prismatic,
    statements,
)
from stiffopt.discovery.diagnosis import Diagnosis, Finding
from stiffopt.report.common.terminal import ReportSection, print_lines, print_section
from stiffopt.report.common.text import (
    DASH,
    MAX_LISTED,
    capital,
    joint_unit,
    listed,
    pm,
    significant,
)
from stiffopt.report.diagnosis import mismatch, words
from stiffopt.report.diagnosis.changes import terminal_lines
from stiffopt.report.diagnosis.positions import position_section, value_section
from stiffopt.report.diagnosis.values_to_enter import mass_sentences, value_sentences

_FINDING_COLUMNS = ("finding", "probability", "value ± standard deviation", "explains", "or else")
_CHANGE_COLUMNS = ("changed value", "from", "to", "cause")


def answer_sections(diagnosis: Diagnosis) -> list[ReportSection]:
    """Return the sections of an answer that have content, the most important first."""
    every = [
        ReportSection(title="Findings", head=_FINDING_COLUMNS, rows=tuple(finding_rows(diagnosis))),
        _changes_section(diagnosis),
        ReportSection(title="Composition of the mismatch", lines=tuple(mismatch_lines(diagnosis))),
        ReportSection(
            title="Next experiment",
            lines=(diagnosis.next_experiment,) if diagnosis.next_experiment else (),
        ),
    ]
    return [each for each in every if each.lines or each.rows]


def _changes_section(diagnosis: Diagnosis) -> ReportSection:
    rows = change_rows(diagnosis)
    rest = len(rows) - MAX_LISTED
    return ReportSection(
        title="Changed values",
        head=_CHANGE_COLUMNS,
        rows=tuple(rows[:MAX_LISTED]),
        lines=(f"{rest} smaller changes are in diagnosis.json.",) if rest > 0 else (),
    )


def finding_rows(diagnosis: Diagnosis) -> list[tuple[str, ...]]:
    """Return a row of every finding, those without nominal value by kind and last."""
    _, unstated = words.new_and_unstated(diagnosis)
    rows = [
        _state_row(diagnosis, each)
        for each in statements(diagnosis)
        if each.finding not in unstated
    ]
    shown = [each for each in unstated if each.probability >= MIN_LISTED_PROBABILITY]
    return rows + [_unstated_row(diagnosis, own) for own in words.unstated_groups(shown)]


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
        *(each.sentence for each in mismatch.mismatches(diagnosis)),
        *value_sentences(diagnosis),
        *mass_sentences(diagnosis),
        *mismatch.counterbalance_sentences(diagnosis),
        *words.unassessed_joint_sentences(diagnosis),
        *words.saturation_sentences(diagnosis),
        *mismatch.carried_part_sentences(diagnosis),
        *mismatch.episode_sentences(diagnosis),
        mismatch.noise_ceiling_sentence(diagnosis),
        *mismatch.transfer_sentences(diagnosis),
        *mismatch.refutation_sentences(diagnosis),
    ]
    return [line for line in lines if line]


def _state_row(diagnosis: Diagnosis, each: Statement) -> tuple[str, ...]:
    finding = each.finding
    return (
        f"{each.place}: {finding.effect.title}",
        f"{each.probability}, {each.certainty}",
        "\n".join(each.values),
        _describe_explained(diagnosis, finding),
        "\n".join(each.rivals) or DASH,
    )


def _describe_explained(diagnosis: Diagnosis, finding: Finding) -> str:
    """Return the share that a finding explains, its size, and its change of held-out residuals."""
    channel = words.channel_words(finding.channel)
    text = f"{100 * finding.variance_explained:.0f} % of {channel}"
    if finding.size is not None:
        slides = is_prismatic(diagnosis, finding.located)
        size = finding.size
        text += f"\nadds {pm(size.value, size.sd, joint_unit(size.unit, slides))} rms"
    if finding.held_out_ratio is None:
        return text
    change = 100.0 * (finding.held_out_ratio - 1.0)
    return f"{text}\nheld-out residual {change:+.0f} %"


def _unstated_row(diagnosis: Diagnosis, own: Sequence[Finding]) -> tuple[str, ...]:
    """Return the row of one kind of value that the nominal model does not state."""

    def value(each: Finding) -> str:
        first = each.parameters[0]
        unit = joint_unit(first.unit, is_prismatic(diagnosis, each.located))
        return f"joint {each.joint}: {pm(first.value, first.sd, unit)}"

    shares = [each.variance_explained for each in own]
    where = words.joints_in_words([each.joint for each in own if each.joint is not None])
    return (
        capital(f"{words.value_name(own[0].effect)} of {where} (no nominal value)"),
        mismatch.format_probability_range([each.probability for each in own]),
        "\n".join(map(value, own)),
        mismatch.format_share_range(min(shares), max(shares)),
        DASH,
    )


# Excluded channels that are listed individually.
_MAX_FAULT_LINES = 5


def print_diagnosis(diagnosis: Diagnosis, folder: Path) -> None:
    """Print the answer's sections, validation on held-out runs, assumptions and paths of files."""
    print_lines(
        [
            *(
                terminal_lines(diagnosis)
                if diagnosis.compares_states
                else [f"{diagnosis.verdict}: {words.headline(diagnosis)}."]
            ),
            f"To do: {action(diagnosis)}" if action(diagnosis) else None,
            *(
                line
                for line in (words.proof_sentence(diagnosis), words.unexplained_sentence(diagnosis))
                if line
            ),
        ]
    )
    slides = diagnosis.recordings.prismatic
    simulated = position_section(diagnosis.positions, slides)
    values = value_section(diagnosis.closed_loop, slides)
    for section in (*answer_sections(diagnosis), simulated, values):
        print_section(section)
    lines = [*outside_lines(diagnosis), *(f"Assumed: {note}" for note in diagnosis.assumptions)]
    lines += fault_lines(diagnosis)
    page = folder / "report.html"
    lines.append(f"Answer: {folder / 'diagnosis.json'}")
    print_lines([*lines, *([f"Report: {page}"] if page.is_file() else [])])


def outside_lines(diagnosis: Diagnosis) -> list[str]:
    """Return a line on channels that the findings leave open, where other channels are named."""
    left = [each.channel for each in diagnosis.channel_verdicts if each.verdict == "outside"]
    if not left or not diagnosis.findings:
        return []
    named = [each.channel for each in diagnosis.channel_verdicts if each.verdict == "named"]
    text = f"By channel: outside the catalogue in {words.channels_in_words(left)}"
    return [text + (f"; explained in {words.channels_in_words(named)}." if named else ".")]


def fault_lines(diagnosis: Diagnosis) -> list[str]:
    """Return lines on excluded channels, and the number of further faults."""
    left_out: dict[tuple[str, str], list[str]] = {}
    for run, fault in diagnosis.faults:
        if fault.left_out:
            left_out.setdefault((fault.channel, fault.detail), []).append(run)
    lines = [
        f"Fault of the recordings: {channel} of {listed(runs)} {detail}"
        for (channel, detail), runs in list(left_out.items())[:_MAX_FAULT_LINES]
    ]
    told = sum(map(len, list(left_out.values())[:_MAX_FAULT_LINES]))
    if rest := len(diagnosis.faults) - told:
        faults = "Further faults" if told else "Faults"
        lines.append(f"{faults} of the recordings: {rest}, in diagnosis.json.")
    return lines
