"""Changes between two states of a robot: sentences, table rows and figure."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from stiffopt.discovery.answer import (
    format_probability,
    is_prismatic,
    missing_physics,
    place,
)
from stiffopt.discovery.diagnosis import Diagnosis, Finding
from stiffopt.recording.state_pair import StatePair
from stiffopt.report.common.text import capital, listed, percent, si, significant
from stiffopt.report.diagnosis.words import channels_in_words, new_and_unstated
from stiffopt.units import joint_unit

CHANGE_COLUMNS = (
    "changed",
    "place",
    "change, ± one standard deviation",
    "of nominal",
    "probability",
)


def change_headline(diagnosis: Diagnosis) -> str:
    """Return the changes with their places and sizes, or that there is none."""
    left = diagnosis.unexplained
    clause = ""
    if left is not None:
        clause = (
            f"; {significant(left.ratio, 2)} times the noise in"
            f" {channels_in_words(left.channels[:1])} has no cause in the catalogue"
        )
    found = [each for each in diagnosis.changes if each.certainty in ("found", "likely")]
    if found:
        by_place: dict[str, list[str]] = {}
        for each in found:
            text = _change_phrase(diagnosis, each)
            # Least probability of a change that is stated as found.
            if each.probability < 0.8:
                text = f"probably {text}"
            by_place.setdefault(place(diagnosis, each.located), []).append(text)
        text = "; ".join(f"{at} changed: {listed(changes)}" for at, changes in by_place.items())
        return capital(text) + clause
    if diagnosis.changes:
        likely = listed([_change_phrase(diagnosis, each) for each in diagnosis.changes])
        return f"Something changed, but not what is certain; among others {likely}{clause}"
    return f"No change of the robot shows between the two states{clause}"


def change_lead(diagnosis: Diagnosis) -> str:
    """Return the sentences under the headline: what was compared, and how."""
    pair = diagnosis.recordings
    assert isinstance(pair, StatePair)
    shared = [each for each in new_and_unstated(diagnosis)[0] if not each.is_change]
    text = (
        f"Before: {pair.before.path.parent.name} ({len(pair.before.runs)} runs). After:"
        f" {pair.after.path.parent.name} ({len(pair.after.runs)} runs). One model serves both"
        " states; a change is what the runs after need beyond it."
    )
    if shared:
        both = listed(
            [
                f"{missing_physics(diagnosis, each)} ({place(diagnosis, each.located)})"
                for each in shared
            ]
        )
        text += f" In both states the nominal model lacks {both}: no change."
    if not diagnosis.changes:
        text += " Smaller changes than the detection limits below are not excluded."
    return text


def change_rows(diagnosis: Diagnosis) -> list[tuple[str, ...]]:
    """Return one row per change: what, place, values, share of nominal, probability."""
    return [
        (
            capital(_change_phrase(diagnosis, each)),
            place(diagnosis, each.located),
            _format_values(diagnosis, each),
            _format_relative_change(diagnosis, each),
            format_probability(each.probability),
        )
        for each in diagnosis.changes
    ]


def unchanged_rows(diagnosis: Diagnosis) -> list[tuple[str, str, str]]:
    """Return effect, place and detection limit of changes that did not show."""
    found: dict[tuple[str, str], list[tuple[int | None, str]]] = {}
    for limit in diagnosis.detection_limits:
        if not limit.effect.only_in:
            continue
        joints = diagnosis.training.constants.joints
        slides = limit.joint is not None and joints[limit.joint - 1].prismatic
        text = si(limit.value, joint_unit(limit.unit, slides), 2)
        if limit.relative is not None:
            text += f" ({percent(limit.relative)})"
        found.setdefault((limit.effect.title, limit.parameter), []).append((limit.joint, text))
    return [
        (
            capital(title),
            parameter,
            "; ".join(f"joint {joint}: {text}" if joint else text for joint, text in places),
        )
        for (title, parameter), places in found.items()
    ]


def terminal_lines(diagnosis: Diagnosis) -> Iterator[str]:
    """Yield the lines that precede the findings in the terminal."""
    yield f"{change_verdict(diagnosis)}: {change_headline(diagnosis)}."
    yield change_lead(diagnosis)


def change_verdict(diagnosis: Diagnosis) -> str:
    """Return "changed", "unchanged" or "outside the catalogue"."""
    if diagnosis.changes:
        return "changed"
    return "unchanged" if diagnosis.unexplained is None else "outside the catalogue"


def _change_phrase(diagnosis: Diagnosis, finding: Finding) -> str:
    """Return the change in words: relative to the state before, not to the nominal model."""
    return missing_physics(diagnosis, finding).replace("than the model", "than before")


def _format_values(diagnosis: Diagnosis, finding: Finding) -> str:
    slides = is_prismatic(diagnosis, finding.located)
    return ", ".join(
        f"{p.name} = {replace(p, unit=joint_unit(p.unit, slides)).text}" for p in finding.parameters
    )


def _format_relative_change(diagnosis: Diagnosis, finding: Finding) -> str:
    """Return the first value over the nominal one, "" where there is none."""
    effect, joint = finding.effect, finding.located.joint
    if not effect.nominal or joint is None:
        return ""
    base = getattr(diagnosis.training.constants.joints[joint], effect.nominal, None)
    return f"{100.0 * finding.parameters[0].value / base:+.0f} %" if base else ""
