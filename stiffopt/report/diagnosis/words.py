"""Sentences of a diagnosis: what is missing, where, how sure, and the proof in one line."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.discovery.thresholds import OPEN_RATIO
from stiffopt.report.common.text import capital, listed, significant, words

if TYPE_CHECKING:
    from stiffopt.discovery.comparison.located_effect import LocatedEffect
    from stiffopt.discovery.diagnosis import Diagnosis, Finding
    from stiffopt.discovery.judging.unexplained import Unexplained

VERDICTS = {
    "named": "missing effect named",
    "nothing_missing": "nothing missing",
    "outside_catalogue": "outside the catalogue",
}
# From here on more or fewer decimals say nothing to a reader.
_SURE = 0.995
# Residual over noise of held-out runs from which a reader is told that much is left.
_MUCH_LEFT = 2.0

# Share of a run from which on a torque at its limit is told first.
_CLIPPED = 0.05


def place(diagnosis: Diagnosis, located: LocatedEffect) -> str:
    """Where an effect is: a joint, a link, the robot; and the run, if it has only one."""
    if located.link is not None:
        return f"link {diagnosis.training.constants.links[located.link]}"
    if located.joint is None:
        return "robot"
    return f"joint {located.joint + 1}" + (f", {located.run}" if located.run else "")


def prismatic(diagnosis: Diagnosis, located: LocatedEffect) -> bool:
    """Whether an effect's joint slides."""
    joints = diagnosis.training.constants.joints
    return located.joint is not None and joints[located.joint].prismatic


def is_unstated(diagnosis: Diagnosis, finding: Finding) -> bool:
    """Whether a finding stands for a value that the nominal model does not give at all."""
    return finding.effect.nominal in diagnosis.recordings.unstated


def new_and_unstated(diagnosis: Diagnosis) -> tuple[list[Finding], list[Finding]]:
    """Findings that say something new, and values that the nominal model did not give."""
    unstated = [f for f in diagnosis.findings if is_unstated(diagnosis, f)]
    return [f for f in diagnosis.findings if f not in unstated], unstated


def phrase(finding: Finding, unstated: bool = False) -> str:
    """What is missing, in plain words."""
    if unstated:
        return f"{finding.effect.nominal_words}, for which there is no nominal value"
    return finding.effect.phrase_of(finding.estimated.amplitudes)


def unchanged(diagnosis: Diagnosis) -> str:
    """That nothing has changed since the model that was started from, and what that left open.

    Empty without such a model, and where all that it leaves is to be explained.
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
    return f"{text}; it left {significant(float(least[worst]), 2)} times the noise open in {where}."


def headline(diagnosis: Diagnosis) -> str:
    """What is missing and where, or that nothing is."""
    if nothing := unchanged(diagnosis):
        return nothing.removesuffix(".")
    if diagnosis.verdict == "nothing_missing":
        silent = " ".join(joints_without_torque(diagnosis)).removesuffix(".")
        return f"Nothing is missing within the tolerances{silent and '. '}{silent}"
    if not diagnosis.findings:
        where = (
            channels_in_words(diagnosis.unexplained.channels[:1]) if diagnosis.unexplained else ""
        )
        return f"Something outside the catalogue acts on {where}"
    new, unstated = new_and_unstated(diagnosis)
    if not new:
        text = f"Found what the nominal model does not give: {_unstated_words(unstated)}"
        return text + _open_words(diagnosis)
    by_place: dict[str, list[str]] = {}
    for finding in new:
        by_place.setdefault(place(diagnosis, finding.located), []).append(phrase(finding))
    text = "; ".join(f"{where}: {listed(what)}" for where, what in by_place.items())
    return capital(text) + _open_words(diagnosis)


def stays_open(diagnosis: Diagnosis) -> bool:
    """Whether findings leave so much that they may stand for something else."""
    left = diagnosis.unexplained
    if not diagnosis.findings or left is None:
        return False
    return diagnosis.verdict == "outside_catalogue" or left.ratio >= OPEN_RATIO


def _open_words(diagnosis: Diagnosis) -> str:
    """That much is open, where findings leave many times the noise."""
    left = diagnosis.unexplained
    if left is None or not stays_open(diagnosis):
        return ""
    where = channels_in_words(left.channels[:1])
    return f"; {significant(left.ratio, 2)} times the noise stays open in {where}"


def joints_without_torque(diagnosis: Diagnosis) -> list[str]:
    """Torques that are stated but show in no training run: a sentence for each joint."""
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
        why = "its torque can be used in no training run"
        if still and not broken.issuperset(run.name for run in training.runs):
            why = "it never moves, or its position does not follow it"
        found.append(f"Joint {j + 1} was not judged: {why}.")
    return found


def clipped_words(diagnosis: Diagnosis) -> list[str]:
    """Torques that rest on their largest value: a sentence for each joint."""
    worst: dict[int, tuple[float, str]] = {}
    for run, fault in diagnosis.faults:
        if fault.kind == "saturated" and fault.joint is not None and fault.share > _CLIPPED:
            worst[fault.joint] = max(worst.get(fault.joint, (0.0, "")), (fault.share, run))
    return [
        f"The torque of joint {joint} rests on its largest value in {100.0 * share:.0f} % of {run}:"
        " what is cut off there is no physics of the joint. Record it below its limit."
        for joint, (share, run) in sorted(worst.items())
    ]


def verdict_words(diagnosis: Diagnosis) -> str:
    """The verdict, and beside findings that it is not all."""
    if diagnosis.findings and diagnosis.verdict == "outside_catalogue":
        return "named in part, much stays open"
    if stays_open(diagnosis):
        return "the most is named, much stays open"
    return VERDICTS[diagnosis.verdict]


def lead(diagnosis: Diagnosis) -> str:
    """How sure, and what it rests on."""
    if diagnosis.verdict == "nothing_missing":
        most = worst_ratio(diagnosis.search.after)
        within = (
            "" if unchanged(diagnosis) else "With nominal values moved within their tolerances, "
        )
        text = "No effect of the catalogue is needed. " + capital(
            f"{within}the worst channel of the training runs is at {most:.2g} times its noise."
        )
    elif not diagnosis.findings:
        text = unexplained_sentence(diagnosis)
    else:
        new, unstated = new_and_unstated(diagnosis)
        parts = [how_sure(finding) for finding in new]
        parts += [fall_sentence(diagnosis, c) for c in dict.fromkeys(f.channel for f in new)]
        if new and unstated:
            parts.append(
                f"Also found, not given by the nominal model: {_unstated_words(unstated)}."
            )
        elif unstated:
            parts.append("Beyond these, no effect of the catalogue is needed.")
        text = " ".join(parts)
        if diagnosis.unexplained is not None:
            text += f" {unexplained_sentence(diagnosis)}"
    return " ".join([text, *(str(mode) for mode in diagnosis.modes if mode.is_shifted)])


def how_sure(finding: Finding) -> str:
    """Probability against rivals and deviations from nothing, in a sentence."""
    if finding.rivals:
        rival = finding.rivals[0]
        other = rival.located.effect.title
        sure = f"{percent_sure(finding.probability)} sure; the nearest rival is {other}"
        if rival.located.joint not in (None, finding.located.joint):
            sure += f" of joint {rival.located.joint + 1}"
    elif finding.misfit:
        sure = f"{percent_sure(finding.probability)} sure; no rival comes near"
    else:
        sure = "no rival comes near"
    if round(100 * finding.misfit):
        sure += f" (an unknown cause takes {100 * finding.misfit:.0f} % of the odds)"
    name = capital(finding.effect.title)
    return f"{name}: {sure}; {finding.significance:.0f} standard deviations from nothing."


def fall_sentence(diagnosis: Diagnosis, channel: str) -> str:
    """How far the residual of a channel falls in the training runs."""
    within, after = fall(diagnosis, channel)
    return (
        f"{capital(channels_in_words([channel]))} is left at {significant(within, 2)} times its "
        f"noise by nominal values within tolerance, at {significant(after, 2)} with what was found."
    )


def fall(diagnosis: Diagnosis, channel: str) -> tuple[float, float]:
    """Residual over noise in training: nominal values within tolerance, then with findings."""
    number = channel_number(diagnosis, channel)
    return float(diagnosis.search.calibrated[number]), float(diagnosis.search.after[number])


def unexplained_sentence(diagnosis: Diagnosis) -> str:
    """What remains beyond the catalogue, what it follows, and the run that is alone with it."""
    unexplained = diagnosis.unexplained
    if unexplained is None:
        return ""
    text = _followed(unexplained)
    if unexplained.alone is not None:
        run, ratio = unexplained.alone
        text += (
            f" In {run} the nominal model leaves {significant(ratio, 2)} times as much there as in"
            " any other training run: was the load, or the arm, another one?"
        )
    return text


def _followed(unexplained: Unexplained) -> str:
    channels = channels_in_words(unexplained.channels)
    if unexplained.brief:
        return (
            f"In bursts, {channels} leaves {unexplained.ratio:.2g} times the noise:"
            f" {100 * unexplained.gain:.0f} % of what remains lies where"
            f" {regressor_words(unexplained.regressors[0])} is largest, as with a drive that"
            f" {_DRIVES[unexplained.regressors[0].partition('_')[0]]}."
        )
    text = f"In {channels} up to {unexplained.ratio:.2g} times the noise remains unexplained"
    if unexplained.period is not None:
        text += f"; it repeats every {significant(unexplained.period, 3)} s, whatever the motion"
        return f"{text}: a wave of that period explains {100 * unexplained.gain:.0f} % of it."
    elif unexplained.regressors:
        text += f"; it follows {listed(regressor_words(r) for r in unexplained.regressors)}"
    else:
        return f"{text}; it follows nothing that was recorded."
    return (
        f"{text}, which predicts {100 * unexplained.gain:.0f} % of it in stretches of the training"
        " runs left out."
    )


def proof_sentence(diagnosis: Diagnosis) -> str:
    """Residual over noise on runs that were never fitted to."""
    parts = []
    for role, runs in (("test", "test runs"), ("extrapolate", "extrapolation runs")):
        if diagnosis.proofs(role):
            before, after = diagnosis.nrmse(role)
            parts.append(f"from {significant(before, 3)} to {significant(after, 3)} on {runs}")
    if not parts:
        return ""
    text = (
        f"On recordings that no fit has seen, the residual goes {' and '.join(parts)}, in units "
        "of the sensor noise."
    )
    left = [diagnosis.nrmse(role)[1] for role in ("test", "extrapolate") if diagnosis.proofs(role)]
    if max(left) > _MUCH_LEFT and diagnosis.findings:
        worst = worst_channel(diagnosis, diagnosis.search.after)
        text += (
            f" So not all is explained: most is left in {channels_in_words([worst])}, at "
            f"{significant(fall(diagnosis, worst)[1], 2)} times its noise in the training runs."
        )
    return text


def percent_sure(probability: float) -> str:
    """Probability in percent that never claims certainty."""
    return "above 99 %" if probability > _SURE else f"{100 * probability:.0f} %"


def worst_ratio(ratios: np.ndarray) -> float:
    """Largest residual over noise of any channel; nan without one."""
    known = ratios[np.isfinite(ratios)]
    return float(known.max()) if known.size else math.nan


# What bursts look like, by what they follow.
_DRIVES = {"torque": "gives no more than a limit", "dtorque": "changes its torque too slowly"}


def channel_words(name: str) -> str:
    """Channel such as "torque_3" in words."""
    kind, _, joint = name.rpartition("_")
    return f"{'torque' if kind == 'torque' else 'link encoder'} of joint {joint}"


def channels_in_words(channels: Iterable[str]) -> str:
    """Channels in a sentence.

    >>> channels_in_words(["torque_3", "link_position_1"])
    'the torque of joint 3 and the link encoder of joint 1'
    """
    return listed(f"the {channel_words(name)}" for name in channels)


def channel_number(diagnosis: Diagnosis, name: str) -> int:
    """Number of a channel among the torques and then the deflections of all joints."""
    kind, _, joint = name.rpartition("_")
    return int(joint) - 1 + (0 if kind == "torque" else diagnosis.recordings.n)


def worst_channel(diagnosis: Diagnosis, ratios: np.ndarray) -> str:
    """Name of the channel with the largest residual over noise."""
    number, n = int(np.nanargmax(ratios)), diagnosis.recordings.n
    return f"{'torque' if number < n else 'link_position'}_{number % n + 1}"


def regressor_words(name: str) -> str:
    """Name of a signal that a remainder depends on, in words."""
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
    """Values that the nominal model does not give, of one kind together by joint."""
    groups: dict[str, list[Finding]] = {}
    for finding in unstated:
        groups.setdefault(finding.effect.nominal, []).append(finding)
    return [sorted(own, key=lambda f: f.joint or 0) for own in groups.values()]


def _unstated_words(unstated: Sequence[Finding]) -> str:
    return listed(
        f"{own[0].effect.nominal_words} of {joints_in_words([f.joint for f in own if f.joint])}"
        for own in unstated_groups(unstated)
    )


def joints_in_words(numbers: list[int]) -> str:
    """Joints in a sentence.

    >>> joints_in_words([2]), joints_in_words([1, 2, 3]), joints_in_words([1, 3])
    ('joint 2', 'joints 1 to 3', 'joints 1 and 3')
    """
    if len(numbers) == 1:
        return f"joint {numbers[0]}"
    if len(numbers) > 2 and numbers == list(range(numbers[0], numbers[-1] + 1)):
        return f"joints {numbers[0]} to {numbers[-1]}"
    return f"joints {listed(map(str, numbers))}"
