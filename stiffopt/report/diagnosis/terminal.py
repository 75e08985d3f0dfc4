"""Terminal output of `stiffopt diagnose`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from stiffopt.discovery.answer import action
from stiffopt.report.common.terminal import print_lines, print_section
from stiffopt.report.common.text import listed
from stiffopt.report.diagnosis.changes import terminal_lines
from stiffopt.report.diagnosis.positions import position_section, value_section
from stiffopt.report.diagnosis.sections import answer_sections
from stiffopt.report.diagnosis.words import (
    channels_in_words,
    headline,
    proof_sentence,
    unexplained_sentence,
)

if TYPE_CHECKING:
    from stiffopt.discovery.diagnosis import Diagnosis

# Excluded channels that are listed individually.
_MAX_FAULT_LINES = 5


def print_diagnosis(diagnosis: Diagnosis, folder: Path) -> None:
    """Print the answer's sections, validation on held-out runs, assumptions and paths of files."""
    print_lines(
        [
            *(
                terminal_lines(diagnosis)
                if diagnosis.compares_states
                else [f"{diagnosis.verdict}: {headline(diagnosis)}."]
            ),
            f"To do: {action(diagnosis)}" if action(diagnosis) else None,
            *(
                line
                for line in (proof_sentence(diagnosis), unexplained_sentence(diagnosis))
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
    text = f"By channel: outside the catalogue in {channels_in_words(left)}"
    return [text + (f"; explained in {channels_in_words(named)}." if named else ".")]


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
