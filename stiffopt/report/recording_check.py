"""Output of `stiffopt recording check`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from rich.text import Text

from stiffopt.discovery.identifiable import EffectCheck
from stiffopt.identification.static_rows import (
    MIN_LEVERAGE,
    Identifiable,
    identifiable,
    static_rows,
)
from stiffopt.recording.check import ChannelCheck, RecordingReport, RunCheck
from stiffopt.recording.static_set import StaticSet
from stiffopt.report.common.terminal import print_lines


def print_check(report: RecordingReport, effects: Sequence[EffectCheck]) -> None:
    """Print the check of a recording set."""
    _print_styled(report_lines(report, effects))


def report_lines(report: RecordingReport, effects: Sequence[EffectCheck]) -> Iterator[str]:
    """Yield lines on runs, channels, faults, missing signals and identifiable effects."""
    yield f"{report.title}: {len(report.joints)} joints, {len(report.runs)} runs"
    for run in report.runs:
        yield ""
        yield from _run_lines(run)
    yield ""
    yield "Residuals that can be computed"
    for joint, (name, found) in enumerate(zip(report.joints, report.balances, strict=True), 1):
        yield f"  joint {joint} ({name}): {', '.join(found) or 'none'}"
    yield ""
    yield "Identifiable effects"
    yield from _effect_lines(effects)
    for heading, sentences in (
        ("Missing", report.missing),
        ("Assumed", report.assumptions),
    ):
        if sentences:
            yield ""
            yield heading
            yield from (f"  {sentence}" for sentence in sentences)


def _run_lines(run: RunCheck) -> Iterator[str]:
    if run.at_rest:
        yield f"{run.file} ({run.role}): {run.samples} poses at rest"
        yield from (f"  {_channel_line(channel)}" for channel in run.channels)
        return
    gap = f", longest gap {1e3 * run.longest_gap:.3g} ms" if run.jitter > 0.0 else ""
    yield (
        f"{run.file} ({run.role}): {run.samples} samples, {run.duration:.4g} s, "
        f"{run.rate:.4g} Hz, jitter {1e3 * run.jitter:.2g} ms{gap}"
    )
    if not run.usable:
        yield "  cannot be used"
    yield from (f"  {_channel_line(channel)}" for channel in run.channels)
    yield from (f"  ! {fault}" for fault in run.faults)


def _channel_line(channel: ChannelCheck) -> str:
    text = f"{channel.column} ({channel.signal} of joint {channel.joint}): "
    if not channel.there:
        return f"{text}left out"
    text += f"{channel.lowest:.4g} to {channel.highest:.4g} {channel.unit}"
    if channel.used is not None:
        share = f"{100.0 * channel.used:.0f}" if channel.used >= 0.01 else "under 1"
        text += f" ({share} % of its limits)"
    text += f", noise {channel.noise:.2g}"
    if channel.stated_noise is not None:
        text += f" (stated {channel.stated_noise:.2g})"
    if channel.step is not None:
        text += f", counts of {channel.step:.3g}"
    return text


def _effect_lines(every: Sequence[EffectCheck]) -> Iterator[str]:
    """Yield each effect with the joints at which it is identifiable, and reasons for the others."""
    for effect in dict.fromkeys(check.effect.name for check in every):
        checks = [check for check in every if check.effect.name == effect]
        if checks[0].joint is None:
            yield f"  {effect}: " + (
                "yes" if checks[0].possible else f"no, {_format_reasons(checks[0].lacks)}"
            )
            continue
        good = [str(check.joint) for check in checks if check.possible]
        reasons: dict[str, list[str]] = {}
        for check in checks:
            if not check.possible:
                reasons.setdefault(_format_reasons(check.lacks), []).append(str(check.joint))
        text = _format_joints(good) if good else "no joint"
        for reason, joints in reasons.items():
            text += f"; not {', '.join(joints)} ({reason})"
        yield f"  {effect}: {text}"


def _format_joints(numbers: list[str]) -> str:
    return f"joint{'s' if len(numbers) > 1 else ''} {', '.join(numbers)}"


def _format_reasons(lacks: tuple[str, ...]) -> str:
    return ", ".join(lacks)


def print_static_check(facts: dict[str, Any]) -> None:
    """Print the check of a static set, from `static_facts`."""
    _print_styled(_static_lines(facts))


def static_facts(recorded: StaticSet) -> dict[str, Any]:
    """Return content and identifiability of a static set as plain data for JSON.

    Raises `InputFileError`: too few poses, or displacements under weight without known masses.
    """
    can = identifiable(static_rows(recorded).compliance_columns())
    force = np.linalg.norm(recorded.force, axis=1)
    moved = np.linalg.norm(recorded.displacement, axis=1)
    return {
        "name": recorded.name,
        "title": recorded.title,
        "poses": len(recorded.position),
        "force": [float(force.min()), float(force.max())],
        "displacement": [float(moved.min()), float(moved.max())],
        "difference": recorded.difference,
        "nominal_stiffness": recorded.stiffness is not None,
        "joints": [
            {
                "joint": j + 1,
                "name": name,
                "lowest": float(recorded.position[:, j].min()),
                "highest": float(recorded.position[:, j].max()),
                "unit": "m" if recorded.prismatic[j] else "rad",
                "leverage": float(can.leverage[j]),
                "confounded_with": _confounded_joints(can, j),
                "identifiable": bool(can.loaded[j] and not can.group[j]),
            }
            for j, name in enumerate(recorded.joints)
        ],
    }


def _confounded_joints(can: Identifiable, j: int) -> list[int]:
    if not can.group[j]:
        return []
    return [int(k) + 1 for k in np.flatnonzero(can.group == can.group[j]) if k != j]


def _static_lines(facts: dict[str, Any]) -> Iterator[str]:
    low, high = facts["force"]
    least, most = facts["displacement"]
    yield f"{facts['title']}: static set, {len(facts['joints'])} joints, {facts['poses']} poses"
    yield f"  force {low:.4g} to {high:.4g} N, displacement {least:.3g} to {most:.3g} m"
    yield (
        "  displacements are differences of two load states: weight cancels"
        if facts["difference"]
        else "  displacements include the deflection under the links' weight"
    )
    yield ""
    yield "Identifiable joint stiffness"
    for joint in facts["joints"]:
        yield (
            f"  joint {joint['joint']} ({joint['name']}, {joint['lowest']:.3g} to"
            f" {joint['highest']:.3g} {joint['unit']}): {_identifiability_phrase(joint)}"
        )
    if not facts["nominal_stiffness"]:
        yield ""
        yield "Missing"
        yield "  No nominal stiffness: identified values cannot be compared with it."


def _identifiability_phrase(joint: dict[str, Any]) -> str:
    if joint["confounded_with"]:
        others = ", ".join(map(str, joint["confounded_with"]))
        return f"no, moves the tool as joint {others} does in these poses"
    if not joint["identifiable"]:
        return "no, no pose loads it"
    if joint["leverage"] < MIN_LEVERAGE:
        return "poorly, the poses load it little"
    return f"yes, load {joint['leverage']:.2g} of that of the most loaded joint"


def _print_styled(lines: Iterable[str]) -> None:
    """Print headings bold and faults yellow."""
    print_lines(Text(line, style=_line_style(line)) for line in lines)


def _line_style(line: str) -> str:
    if line.startswith("  ! ") or line == "  cannot be used":
        return "yellow"
    return "bold" if line and not line.startswith(" ") else ""
