"""Sentences on the composition of a mismatch, the noise ceiling, contact and held-out runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from stiffopt.discovery.answer import format_probability, place
from stiffopt.discovery.comparison.located_effect import LocatedEffect
from stiffopt.discovery.diagnosis import Diagnosis
from stiffopt.discovery.judging.explained_shares import MismatchShare
from stiffopt.discovery.judging.run_deviations import Drift
from stiffopt.discovery.names import Channel
from stiffopt.discovery.settings import MAX_NOMINAL_DEVIATIONS
from stiffopt.report.common.text import listed, significant
from stiffopt.report.diagnosis.overview import moved_values
from stiffopt.report.diagnosis.words import (
    CONTACT_PHRASE,
    channel_words,
    joints_in_words,
    regressor_words,
)
from stiffopt.units import joint_unit

# Share of the mismatch that is written as none; all but that is written as all.
_MIN_SHARE = 0.005
# Names of nominal values of joints, where they differ from the keys of files.
_NOMINAL_NAMES = {
    "coulomb": "Coulomb friction",
    "viscous": "viscous friction",
    "com": "centre of mass",
}
_CHANNEL_KINDS = {"torque": "the torques", "link_position": "the link encoders"}


@dataclass(frozen=True, kw_only=True)
class Mismatch:
    """Composition of the mismatch of one kind of channel on held-out runs."""

    sentence: str
    pieces: list[NamedShare]  # explained parts, the largest first, and the unexplained part last


@dataclass(frozen=True, kw_only=True)
class NamedShare:
    """A part of the mismatch, shown as a piece of the bar."""

    words: str
    share: float  # share of the mismatch on held-out runs
    open: bool  # True for the unexplained part


def mismatches(diagnosis: Diagnosis) -> list[Mismatch]:
    """Return the mismatches of torques and of link encoders; none without findings."""
    if not diagnosis.findings:
        return []
    kinds = list(dict.fromkeys(each.measured for each in diagnosis.shares))
    # Channels within twice their noise have no shares.
    measured = {channel.kind for proof in diagnosis.held_out for channel in proof.channels}
    found = []
    for kind in kinds:
        pieces = [
            NamedShare(
                words="unexplained" if each.part is None else _part_phrase(diagnosis, each),
                share=each.share,
                open=each.part is None,
            )
            for each in diagnosis.shares
            if each.measured == kind and (each.part is None or abs(each.share) >= _MIN_SHARE)
        ]
        of = f" of {_CHANNEL_KINDS[kind]}" if len(measured) > 1 else ""
        found.append(Mismatch(sentence=_share_sentence(of, pieces), pieces=pieces))
    return found


def _share_sentence(of: str, pieces: Sequence[NamedShare]) -> str:
    # The unexplained share may be negative where less than the noise remains.
    helps = ", ".join(
        f"{_format_share(max(p.share, 0.0))} {p.words}" for p in pieces if p.open or p.share >= 0.0
    )
    harms = listed(
        f"{p.words} ({_format_share(-p.share)})" for p in pieces if not p.open and p.share < 0.0
    )
    text = f"Mismatch{of} on held-out runs: {helps or 'not explained'}."
    return f"{text} Increased by {harms}." if harms else text


def _format_share(share: float) -> str:
    size = 100.0 * share
    if 0.0 < size < 0.1:
        return "below 0.1 %"
    return f"{size:.0f} %" if size >= 1.0 or size == 0.0 else f"{size:.1g} %"


def noise_ceiling_sentence(diagnosis: Diagnosis) -> str:
    """Return a sentence on the explained share of the noise ceiling; "" where it is not known.

    The noise ceiling is the fit of a black box, of torques on held-out runs. Dependences within
    the training runs, or of link encoders, do not contradict it.
    """
    rod = diagnosis.noise_ceiling
    if rod is None:
        return ""
    channels = {c.kind for proof in diagnosis.held_out for c in proof.channels}
    of = " of the torques" if "link_position" in channels else ""
    box = "a black-box fit of the residual that remains in the training runs"
    if not rod.depends and rod.explained > 1.0 - _MIN_SHARE:
        text = f"Noise ceiling{of}: reached on held-out runs; {box} explains hardly more there."
    else:
        share = f"{100 * rod.explained:.0f} %" if rod.explained > 0.0 else "0 %"
        text = (
            f"Noise ceiling{of}: {share} of the explainable mismatch is explained, judged by {box}"
        )
        if rod.depends:
            signals = listed(regressor_words(each.signal) for each in rod.depends)
            where = channel_words(rod.depends[0].channel)
            text = f"{text}; the remainder depends on {signals} (most in {where})."
        else:
            text = f"{text}, which explains hardly more."
    return f"{text}{_noise_ceiling_remark(diagnosis)}"


def _noise_ceiling_remark(diagnosis: Diagnosis) -> str:
    """Return a remark where a residual outside the catalogue seems to contradict the ceiling."""
    left, rod = diagnosis.unexplained, diagnosis.noise_ceiling
    if left is None or left.brief or rod is None:
        return ""
    if left.channels[0].startswith("link_position"):
        return " Link encoders are not included; more of them is unexplained."
    if rod.depends or not left.regressors:
        return ""
    signals = listed(regressor_words(each) for each in left.regressors)
    return (
        f" The dependence of the residual on {signals} within the training runs does not carry over"
        " to held-out runs."
    )


def counterbalance_sentences(diagnosis: Diagnosis) -> list[str]:
    """Return a sentence on every re-identified body that may be a counterbalance."""
    rigid = diagnosis.search.rigid
    found = []
    for each in () if rigid is None else rigid.counterweights:
        joint, link = each.joint + 1, diagnosis.training.constants.links[each.joint]
        unit = joint_unit("N m", diagnosis.training.constants.joints[each.joint].prismatic)
        is_it = (
            "the counterbalance is more likely, since it predicts held-out recordings better"
            if each.balanced
            else "held-out recordings do not separate the two"
        )
        found.append(
            f"Counterbalance of joint {joint} or weight of {link}: the re-identified first moment "
            f"of the link changes by {significant(each.change, 2)} kg m, from "
            f"{significant(each.nominal, 2)} kg m, more than is plausible; a counterbalance of up "
            f"to {significant(each.torque, 2)} {unit} has the same effect, and {is_it}. The "
            f"extended model includes it as mass. To separate them, accelerate joint {joint} "
            "strongly near one position: only a mass has inertia."
        )
    return found


def transfer_sentences(diagnosis: Diagnosis) -> list[str]:
    """Return a sentence on every value that differs between training and held-out runs."""
    found = [_drift_sentence(diagnosis, each) for each in diagnosis.drift]
    for each in diagnosis.not_carried_over:
        if each.kind == "friction drift":
            found.append(
                f"Friction of {each.run} in {channel_words(each.channel)} is"
                f" {significant(abs(each.value), 2)} standard deviations"
                f" {'above' if each.value > 0.0 else 'below'} the mean of the training runs"
                f" ({100 * each.share:.0f} % of the residual there)."
            )
            continue
        channel = Channel.read(each.channel)
        slides = diagnosis.training.constants.joints[channel.joint - 1].prismatic
        unit = "rad" if channel.kind == "link_position" else "N m"
        unit = f"{unit} s/rad" if each.kind == "viscous friction" else unit
        value = f"{significant(abs(each.value), 2)} {joint_unit(unit, slides)}"
        than = "more" if each.value > 0.0 else "less"
        kind = "A constant" if each.kind == "constant" else each.kind.capitalize()
        found.append(
            f"{kind} does not carry over: {each.run} has {value} {than} than the training runs in"
            f" {channel_words(each.channel)} ({100 * each.share:.0f} % of the residual there)."
        )
    return found


def refutation_sentences(diagnosis: Diagnosis) -> list[str]:
    """Return a sentence on every finding that held-out runs refute."""
    found = []
    for each in diagnosis.findings:
        ratio = each.held_out_ratio or 0.0
        if each.certainty == "possible" and ratio > 1.0:
            found.append(
                f"Held-out runs refute {each.effect.title} ({place(diagnosis, each.located)}): a"
                f" model fitted without it leaves {100 * (1.0 - 1.0 / ratio):.0f} % less of their"
                f" {channel_words(each.channel)}."
            )
    return found


def _drift_sentence(diagnosis: Diagnosis, each: Drift) -> str:
    unit = joint_unit("N m", diagnosis.training.constants.joints[each.joint].prismatic)
    by_run = listed(
        f"{run} {'+' if off > 0.0 else ''}{significant(off, 2)}" for run, off in each.by_run
    )
    return (
        f"Friction of joint {each.joint + 1} differs from run to run: predictions use the mean, "
        f"with a standard deviation between runs of {significant(each.rms, 2)} {unit}"
        f" (from the mean: {by_run} {unit})."
    )


def episode_sentences(diagnosis: Diagnosis) -> list[str]:
    """Return a sentence on every contact interval."""
    joints = diagnosis.training.constants.joints
    found = []
    for each in diagnosis.episodes:
        sizes = listed(
            f"joint {j} up to {significant(size, 2)} {joint_unit('N m', joints[j - 1].prismatic)}"
            for j, size in zip(each.joints, each.sizes, strict=True)
        )
        if each.role == "train":
            head, tail = f"{CONTACT_PHRASE} in", "excluded from the fit"
        elif each.stays:
            head, tail = "Permanent change, as of a load, in", "included in the validation"
        else:
            head, tail = f"{CONTACT_PHRASE} in", "excluded from the validation"
        if each.nrmse_with is not None and each.nrmse_without is not None:
            tail += (
                f"; residual of {each.run} {significant(each.nrmse_with, 2)} times the noise with"
                f" this interval, {significant(each.nrmse_without, 2)} without"
            )
        found.append(f"{head} {each.run}: {each.begin:.2f} to {each.end:.2f} s, {sizes}; {tail}.")
    return found


def carried_part_sentences(diagnosis: Diagnosis) -> list[str]:
    """Return a sentence on when each run carries the part of the findings."""
    if not any(each.effect.acts_for_a_while for each in diagnosis.findings):
        return []
    runs = (*diagnosis.training.recorded, *(proof.run for proof in diagnosis.held_out))
    told = [
        f"{run.name} {listed(f'{begin:.2f} to {end:.2f} s' for begin, end in run.carried)}"
        for run in runs
        if run.carried
    ]
    if not told:
        return []
    return [
        f"A part is carried, as the torques show: {'; '.join(told)}. Grasp and release themselves"
        " are excluded from fit and validation."
    ]


def _part_phrase(diagnosis: Diagnosis, share: MismatchShare) -> str:
    part = share.part
    assert part is not None
    joints = sorted({e.joint + 1 for e in part.effects if e.joint is not None})
    where = f" ({joints_in_words(joints)})" if joints else ""
    if part.kind == "unstated":
        names = dict.fromkeys(e.effect.nominal_words for e in part.effects)
        return f"{listed(names)} without nominal value{where}"
    if part.kind == "usual":
        return f"offsets{where}"
    if part.kind == "nominal":
        text = _nominal_part_phrase(diagnosis, part.effects)
        # Share of nominal values above which the value that moved most is named.
        return f"{text}{_largest_moved_value(diagnosis) if share.share > 0.2 else ''}"
    return f"{part.effects[0].effect.title}{where}"


def _largest_moved_value(diagnosis: Diagnosis) -> str:
    """Return the nominal value that moved most, where it exceeds its tolerance; else ""."""
    # A value at its bound is no result of a fit.
    bound = 0.999 * MAX_NOMINAL_DEVIATIONS
    moved = [
        each
        for each in moved_values(diagnosis)
        if each.tolerance <= abs(each.change) < bound * each.tolerance
    ]
    if not moved:
        return ""
    first = moved[0]
    kind, place_, part = first.name
    words = f"{_NOMINAL_NAMES.get(kind, kind.replace('_', ' '))} {part}".rstrip()
    where = "behind" if kind in ("mass", "com") else "of"
    size = f"{100.0 * first.change:+.2g} %"
    if first.unit:
        size = f"{significant(first.change, 2)} {first.unit}"
    return f" (mainly {words} {where} joint {place_ + 1}: {size})"


def _nominal_part_phrase(diagnosis: Diagnosis, effects: Sequence[LocatedEffect]) -> str:
    found = [f"{e.effect.title} ({place(diagnosis, e)})" for e in effects]
    rigid = diagnosis.search.rigid
    if rigid is not None and rigid.freed:
        joints = [each.joint + 1 for each in rigid.counterweights if each.balanced]
        likely = f", likely a counterbalance of {joints_in_words(joints)}" if joints else ""
        found.append(f"rigid model re-identified{likely}")
    elif not found:
        return "nominal values within their tolerances"
    return listed(found)


def format_probability_range(values: Sequence[float]) -> str:
    """Format a range of probabilities, never as certainty."""
    ends = [format_probability(min(values)), format_probability(max(values))]
    return " to ".join(dict.fromkeys(ends)).replace(" % to", " to")


def format_share_range(low: float, high: float) -> str:
    """Format a range of shares in percent; one number where both ends read alike."""
    least, most = round(100 * low), round(100 * high)
    return f"{most} %" if least == most else f"{least} to {most} %"
