"""Terminal output of `stiffopt diagnose`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from stiffopt.report.common.terminal import print_lines, print_table
from stiffopt.report.common.text import DASH, listed, pm, significant
from stiffopt.report.diagnosis.changes import terminal_lines
from stiffopt.report.diagnosis.mismatch import (
    counterbalance_sentences,
    episode_sentences,
    mismatches,
    noise_ceiling_sentence,
    transfer_sentences,
    unstated_rows,
)
from stiffopt.report.diagnosis.words import (
    channels_in_words,
    is_partly_unexplained,
    is_prismatic,
    new_and_unstated,
    place,
    saturation_sentences,
    unassessed_joint_sentences,
    unchanged_sentence,
    unexplained_sentence,
)
from stiffopt.units import joint_unit

if TYPE_CHECKING:
    from stiffopt.discovery.diagnosis import Diagnosis, Finding

_VERDICT_SENTENCES = {
    "named": "The nominal model lacks effects, which were identified.",
    "nothing_missing": "Nothing is missing: the nominal model within its tolerances explains the"
    " recordings.",
    "outside_catalogue": "The nominal model lacks an effect that is not in the catalogue.",
}
NOT_GIVEN = "no nominal value"
# Excluded channels that are listed individually.
_MAX_FAULT_LINES = 5
_FINDING_COLUMNS = ("effect", "where", "parameters", "explains", "probability", "confused with")


def print_diagnosis(diagnosis: Diagnosis, folder: Path) -> None:
    """Print verdict, findings, validation on held-out runs, assumptions and paths of the files."""
    label = diagnosis.verdict
    part = label == "named" and is_partly_unexplained(diagnosis)
    if diagnosis.compares_states:
        print_lines(terminal_lines(diagnosis))
    else:
        print_lines([f"{'named in part' if part else label}: {_verdict_sentence(diagnosis)}"])
    more = [each.sentence for each in mismatches(diagnosis)]
    more += counterbalance_sentences(diagnosis)
    more += [
        *unassessed_joint_sentences(diagnosis),
        *saturation_sentences(diagnosis),
        *episode_sentences(diagnosis),
        noise_ceiling_sentence(diagnosis),
    ]
    more += transfer_sentences(diagnosis)
    print_lines([line for line in more if line])
    new, unstated = new_and_unstated(diagnosis)
    if diagnosis.findings:
        rows = [_finding_row(diagnosis, finding) for finding in new]
        rows += [
            (
                each.effect,
                each.where,
                each.values.replace(", ", "\n"),
                each.explains,
                each.probability,
                NOT_GIVEN,
            )
            for each in unstated_rows(diagnosis, unstated)
        ]
        print_table(_FINDING_COLUMNS, rows)
    lines = []
    if diagnosis.unexplained is not None:
        lines.append(f"Outside the catalogue. {unexplained_sentence(diagnosis)}")
    lines += outside_lines(diagnosis)
    for role, meaning in (("test", "test"), ("extrapolate", "extrapolation")):
        if diagnosis.proofs(role):
            before, after = (significant(v, 3) for v in diagnosis.nrmse(role))
            lines.append(f"Residual over noise in {meaning} runs: {before} before, {after} after.")
    if diagnosis.next_experiment:
        lines.append(f"Next experiment: {diagnosis.next_experiment}")
    lines += [f"Assumed: {note}" for note in diagnosis.assumptions]
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


def _verdict_sentence(diagnosis: Diagnosis) -> str:
    left = diagnosis.unexplained
    if left is not None and is_partly_unexplained(diagnosis):
        much = (
            f"{significant(left.ratio, 2)} times the noise remains unexplained in"
            f" {channels_in_words(left.channels[:1])}"
        )
        if diagnosis.verdict == "outside_catalogue":
            return (
                f"The nominal model lacks effects, which were identified in part, but {much}: all"
                " findings are tentative."
            )
        return (
            f"The nominal model lacks effects, most of which were identified, but {much}: findings"
            " there may be misattributed. Check unit, torque constant and masses first."
        )
    return unchanged_sentence(diagnosis) or _VERDICT_SENTENCES[diagnosis.verdict]


def _finding_row(diagnosis: Diagnosis, finding: Finding) -> tuple[str, ...]:
    slides = is_prismatic(diagnosis, finding.located)
    parameters = (
        f"{p.name} = {pm(p.value, p.sd, joint_unit(p.unit, slides))}" for p in finding.parameters
    )
    rivals = (
        f"{rival.located.effect.name} {place(diagnosis, rival.located)}"
        f" ({100 * rival.probability:.0f} %)"
        for rival in finding.rivals
    )
    return (
        finding.effect.name,
        place(diagnosis, finding.located) + (" (change)" if finding.is_change else ""),
        "\n".join(parameters),
        f"{100 * finding.variance_explained:.0f} % of {finding.channel}",
        f"{100 * finding.probability:.0f} %",
        "\n".join(rivals) or DASH,
    )
