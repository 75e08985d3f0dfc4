"""What a mismatch is made of, in words: the first thing that an answer says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from stiffopt.discovery.judging.noise_ceiling import SHOWN_SHARE
from stiffopt.report.common.text import listed, pm, significant
from stiffopt.report.diagnosis.overview import moved_values
from stiffopt.report.diagnosis.words import (
    channel_words,
    fall,
    joints_in_words,
    percent_sure,
    place,
    prismatic,
    regressor_words,
    unstated_groups,
)
from stiffopt.units import joint_unit

if TYPE_CHECKING:
    from stiffopt.discovery.comparison.located_effect import LocatedEffect
    from stiffopt.discovery.diagnosis import Diagnosis, Finding
    from stiffopt.discovery.judging.explained_shares import MismatchShare
    from stiffopt.discovery.judging.run_deviations import Drift

# Shares below are not told apart from nothing, nor above from all.
_LEAST, _ALL = 0.005, 0.995
# Share of nominal values from which it is said which of them moved.
_TELLING = 0.2
# Names of nominal values of joints, where they are not those of the files.
_NOMINAL = {"coulomb": "Coulomb friction", "viscous": "viscous friction", "com": "centre of mass"}
_SOMETHING = "Something that touches, loads or offsets"
_MEASURED = {"torque": "the torques", "link_position": "the link encoders"}


@dataclass(frozen=True, kw_only=True)
class Mismatch:
    """What one kind of channel's mismatch on runs left out is made of.

    Parameters
    ----------
    sentence : str
    pieces : list of NamedShare
        The largest first and what is open last.
    """

    sentence: str
    pieces: list[NamedShare]


@dataclass(frozen=True, kw_only=True)
class NamedShare:
    """A piece of the bar.

    Parameters
    ----------
    words : str
    share : float
        Of the mismatch on runs left out.
    open : bool
        Whether nothing explains it.
    """

    words: str
    share: float
    open: bool


@dataclass(frozen=True, kw_only=True)
class UnstatedRow:
    """One kind of value that the nominal model does not give, of all its joints.

    Parameters
    ----------
    effect, where, values, from_nothing, shows_in, falls, explains, probability : str
        From the least of the joints to the most.
    """

    effect: str
    where: str
    values: str
    min_deviations: str
    shows_in: str
    falls: str
    explains: str
    probability: str


def mismatches(diagnosis: Diagnosis) -> list[Mismatch]:
    """Of torques and link encoders, in words; none without runs left out or findings."""
    if not diagnosis.findings:
        return []
    kinds = list(dict.fromkeys(each.measured for each in diagnosis.shares))
    # Shares of what is within twice its noise are not asked.
    measured = {channel.kind for proof in diagnosis.held_out for channel in proof.channels}
    found = []
    for kind in kinds:
        pieces = [
            NamedShare(
                words="open" if each.part is None else _part_words(diagnosis, each),
                share=each.share,
                open=each.part is None,
            )
            for each in diagnosis.shares
            if each.measured == kind and (each.part is None or abs(each.share) >= _LEAST)
        ]
        of = f" of {_MEASURED[kind]}" if len(measured) > 1 else ""
        found.append(Mismatch(sentence=_sentence(of, pieces), pieces=pieces))
    return found


def _sentence(of: str, pieces: Sequence[NamedShare]) -> str:
    # What is open may come out below nothing where less is left than noise; only parts do harm.
    helps = ", ".join(
        f"{_percent(max(p.share, 0.0))} {p.words}" for p in pieces if p.open or p.share >= 0.0
    )
    harms = listed(
        f"{p.words} by {_percent(-p.share)}" for p in pieces if not p.open and p.share < 0.0
    )
    text = f"Of the mismatch{of} on runs left out: {helps or 'nothing is explained'}."
    return f"{text} There it is made worse: {harms}." if harms else text


def _percent(share: float) -> str:
    size = 100.0 * share
    if 0.0 < size < 0.1:
        return "below 0.1 %"
    return f"{size:.0f} %" if size >= 1.0 or size == 0.0 else f"{size:.1g} %"


def rod_sentence(diagnosis: Diagnosis) -> str:
    """What is explained of what a black box could explain; "" where none was asked.

    On runs left out, and of torques alone: what is predicted within the training runs, or of link
    encoders, is no contradiction of it.
    """
    rod = diagnosis.noise_ceiling
    if rod is None:
        return ""
    channels = {c.kind for proof in diagnosis.held_out for c in proof.channels}
    of = " of the torques" if "link_position" in channels else ""
    box = "a black box that was fitted to what is left in the training runs"
    if not rod.depends and rod.explained > _ALL:
        text = f"Explained{of} on runs left out: as much as {box} could; it finds next to nothing"
        text = f"{text} more there."
    else:
        share = f"{100 * rod.explained:.0f} %" if rod.explained > 0.0 else "nothing"
        text = f"Explained{of}: {share} of what is explainable, measured by {box}"
        if rod.depends:
            what = listed(regressor_words(each.signal) for each in rod.depends)
            where = channel_words(rod.depends[0].channel)
            text = f"{text}; the rest depends on {what} (most in {where})."
        else:
            text = f"{text}; it finds next to nothing more."
    return f"{text}{_beside_rod(diagnosis)}"


def _beside_rod(diagnosis: Diagnosis) -> str:
    """How what is outside the catalogue goes with a box that finds nothing more."""
    left, rod = diagnosis.unexplained, diagnosis.noise_ceiling
    if left is None or left.brief or rod is None:
        return ""
    if left.channels[0].startswith("link_position"):
        return " Link encoders were not asked, of which more stays open."
    if rod.depends or not left.regressors or left.gain < SHOWN_SHARE:
        return ""
    what = listed(regressor_words(each) for each in left.regressors)
    return (
        f" How what is left follows {what} within the training runs does not carry over to runs"
        " left out."
    )


def counterbalance_sentences(diagnosis: Diagnosis) -> list[str]:
    """One for every body that was re-identified as a counterbalance pulls."""
    rigid = diagnosis.search.rigid
    found = []
    for each in () if rigid is None else rigid.counterweights:
        joint, link = each.joint + 1, diagnosis.training.constants.links[each.joint]
        unit = joint_unit("N m", diagnosis.training.constants.joints[each.joint].prismatic)
        is_it = (
            "it is likelier a counterbalance, which predicts recordings left out better"
            if each.balanced
            else "recordings left out do not tell the two apart"
        )
        found.append(
            f"Counterbalance of joint {joint}, or the weight of {link}: as re-identified, the"
            f" link's first moment changes by {significant(each.change, 2)} kg m, of"
            f" {significant(each.nominal, 2)}, as nothing is made; a counterbalance of up to"
            f" {significant(each.torque, 2)} {unit} pulls alike, and {is_it}. The extended model"
            f" holds it as mass. Accelerate joint {joint} hard at one place: mass resists, a"
            " counterbalance does not."
        )
    return found


def carried_over_sentences(diagnosis: Diagnosis) -> list[str]:
    """One for every value that does not carry over to a held-out run."""
    found = [_drift_words(diagnosis, each) for each in diagnosis.drift]
    for each in diagnosis.not_carried_over:
        if each.kind == "friction drift":
            found.append(
                f"Friction of {each.run} in {channel_words(each.channel)} lies"
                f" {significant(abs(each.value), 2)} spreads"
                f" {'above' if each.value > 0.0 else 'below'} the mean of the training runs"
                f" ({100 * each.share:.0f} % of what is left there)."
            )
            continue
        kind, _, joint = each.channel.rpartition("_")
        slides = diagnosis.training.constants.joints[int(joint) - 1].prismatic
        unit = "rad" if kind == "link_position" else "N m"
        unit = f"{unit} s/rad" if each.kind == "viscous friction" else unit
        value = f"{significant(each.value, 2)} {joint_unit(unit, slides)}"
        what = "A constant" if each.kind == "constant" else each.kind.capitalize()
        found.append(
            f"{what} does not carry over: {each.run} has {value} more than the training runs in"
            f" {channel_words(each.channel)} ({100 * each.share:.0f} % of what is left there)."
        )
    return found


def _drift_words(diagnosis: Diagnosis, each: Drift) -> str:
    slides = diagnosis.training.constants.joints[each.joint].prismatic
    return (
        f"Friction of joint {each.joint + 1} differs from run to run: a further run is predicted"
        f" with the mean, give or take {significant(each.rms, 2)} {joint_unit('N m', slides)} (one"
        " standard deviation between runs)."
    )


def episode_sentences(diagnosis: Diagnosis) -> list[str]:
    """One for every time in which something was at work."""
    joints = diagnosis.training.constants.joints
    found = []
    for each in diagnosis.episodes:
        sizes = listed(
            f"joint {j} up to {significant(size, 2)} {joint_unit('N m', joints[j - 1].prismatic)}"
            for j, size in zip(each.joints, each.sizes, strict=True)
        )
        if each.role == "train":
            head, tail = f"{_SOMETHING} was at work in", "left out of the fit"
        elif each.stays:
            head, tail = "A change that stays, as of a load, is in", "part of what judges the model"
        else:
            head, tail = f"{_SOMETHING} does not carry over to", "left out of what judges the model"
        if each.nrmse_with is not None and each.nrmse_without is not None:
            tail += (
                f"; residual of {each.run} {significant(each.nrmse_with, 2)} times the noise with"
                f" it, {significant(each.nrmse_without, 2)} without"
            )
        found.append(f"{head} {each.run}: {each.begin:.2f} to {each.end:.2f} s, {sizes}; {tail}.")
    return found


def unstated_rows(diagnosis: Diagnosis, findings: Sequence[Finding]) -> list[UnstatedRow]:
    """Values that the nominal model does not give, one row a kind."""
    rows = []
    for own in unstated_groups(findings):
        slides = prismatic(diagnosis, own[0].located)
        first = own[0].parameters[0]
        unit = joint_unit(first.unit, slides)
        values = ", ".join(
            f"{f.joint}: {pm(f.parameters[0].value, f.parameters[0].sd, unit)}" for f in own
        )
        shares = [f.variance_explained for f in own]
        left = [fall(diagnosis, f.channel) for f in own]
        rows.append(
            UnstatedRow(
                effect=own[0].effect.title,
                where=joints_in_words([f.joint for f in own if f.joint is not None]),
                values=f"{first.name} of joint {values}",
                min_deviations=f"{_span([f.significance for f in own], 1)} sd",
                shows_in=_channels(list(dict.fromkeys(f.channel for f in own))),
                falls=" → ".join(_span([falls[k] for falls in left], 2) for k in (0, 1)),
                explains=_range(min(shares), max(shares)),
                probability=_probabilities([f.probability for f in own]),
            )
        )
    return rows


def _part_words(diagnosis: Diagnosis, share: MismatchShare) -> str:
    part = share.part
    assert part is not None
    joints = sorted({e.joint + 1 for e in part.effects if e.joint is not None})
    where = f" ({joints_in_words(joints)})" if joints else ""
    if part.kind == "unstated":
        names = dict.fromkeys(e.effect.nominal_words for e in part.effects)
        return f"{listed(names)} that nobody had given{where}"
    if part.kind == "usual":
        return f"offsets{where}"
    if part.kind == "nominal":
        text = _masses(diagnosis, part.effects)
        return f"{text}{_foremost(diagnosis) if share.share > _TELLING else ''}"
    return f"{part.effects[0].effect.title}{where}"


def _foremost(diagnosis: Diagnosis) -> str:
    """The nominal value that moved furthest within its tolerance, where that says something."""
    moved = [each for each in moved_values(diagnosis) if abs(each.change) >= each.tolerance]
    if not moved:
        return ""
    first = moved[0]
    kind, *rest = first.name.split()
    joint = next(each for each in rest if each.isdecimal())
    words = [_NOMINAL.get(kind, kind.replace("_", " ")), *(each for each in rest if each != joint)]
    where = "behind" if kind in ("mass", "com") else "of"
    size = f"{100.0 * first.change:+.2g} %"
    if first.unit:
        size = f"{significant(first.change, 2)} {first.unit}"
    return f" (most of all {' '.join(words)} {where} joint {joint}: {size})"


def _masses(diagnosis: Diagnosis, effects: Sequence[LocatedEffect]) -> str:
    found = [f"{e.effect.title} ({place(diagnosis, e)})" for e in effects]
    rigid = diagnosis.search.rigid
    if rigid is not None and rigid.freed:
        joints = [each.joint + 1 for each in rigid.counterweights if each.balanced]
        likely = f", likely a counterbalance of {joints_in_words(joints)}" if joints else ""
        found.append(f"rigid model re-identified{likely}")
    elif not found:
        return "nominal values within their tolerances"
    return listed(found)


def _channels(names: Sequence[str]) -> str:
    """Channels of one kind together: "torques of joints 1 to 6"."""
    kinds: dict[str, list[int]] = {}
    for name in names:
        kind, _, joint = name.rpartition("_")
        kinds.setdefault(kind, []).append(int(joint))
    words = {"torque": "torque", "link_position": "link encoder"}
    return listed(
        f"{words[kind]}{'s' * (len(own) > 1)} of {joints_in_words(sorted(own))}"
        for kind, own in kinds.items()
    )


def _span(values: Sequence[float], digits: int) -> str:
    """The least and the most, one where both read alike; what is large to its whole number."""
    ends = [
        f"{v:.0f}" if v >= 10.0**digits else significant(v, digits)
        for v in (min(values), max(values))
    ]
    return " to ".join(dict.fromkeys(ends))


def _probabilities(values: Sequence[float]) -> str:
    """From the least to the most likely, never certain."""
    ends = [percent_sure(min(values)), percent_sure(max(values))]
    return " to ".join(dict.fromkeys(ends)).replace(" % to", " to")


def _range(low: float, high: float) -> str:
    """Shares as percentages, one where both read alike."""
    least, most = round(100 * low), round(100 * high)
    return f"{most} %" if least == most else f"{least} to {most} %"
