"""Conclusions of a diagnosis: findings with probabilities, the verdict, the next recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import special

from stiffopt.closed_loop.parameters import BODY_PARAMETERS
from stiffopt.discovery.catalogue import CATALOGUE
from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.located_effect import (
    EstimatedEffect,
    Extension,
    LocatedEffect,
    effect_places,
)
from stiffopt.discovery.comparison.prepared_run import PreparedRun
from stiffopt.discovery.diagnosis import (
    Finding,
    Parameter,
    Verdict,
    build_rivals,
)
from stiffopt.discovery.experiment.design import ExperimentPlan
from stiffopt.discovery.judging.ensemble import START_CUTS
from stiffopt.discovery.judging.explained_shares import MismatchShare
from stiffopt.discovery.judging.refutation import HeldOutEvidence
from stiffopt.discovery.judging.unexplained import ChannelVerdict, Unexplained
from stiffopt.discovery.laws.law import LAW_FAMILY
from stiffopt.discovery.loop_effects import inseparable_parameters, loop_parameter, stated_value
from stiffopt.discovery.loop_fit import stated_tolerance
from stiffopt.discovery.names import Channel, channel_name
from stiffopt.discovery.position_fit import ClosedLoopModel
from stiffopt.discovery.search.left_out_gain import left_out_gains
from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.search.uncertainty import (
    Estimate,
    null_probability,
)
from stiffopt.discovery.thresholds import (
    EXPLAINED_SHARE,
    FINDING_DEVIATIONS,
    OPEN_RATIO,
    OPEN_SHARE,
    UNSTATED_DEVIATIONS,
)
from stiffopt.discovery.training import Training
from stiffopt.recording.recording_set import RecordingSet

if TYPE_CHECKING:
    from stiffopt.discovery.signals import RobotConstants

# Two-sided p-value of one standard deviation: a value beyond it is zero within its deviation.
_ONE_DEVIATION = float(2.0 * special.ndtr(-1.0))
# The same of the least deviations of a finding.
_INSIGNIFICANT_CHANCE = float(2.0 * special.ndtr(-FINDING_DEVIATIONS))
# Folds by which probabilities are judged: of six, gains near the noise change by a factor of two
# with the limits of the folds.
_PROBABILITY_FOLDS = 24


def build_findings(
    comparison: Comparison,
    kept: Sequence[Selected],
    parameters: Estimate,
    training: Training,
    again: np.ndarray,
) -> tuple[Finding, ...]:
    """Return the findings with probabilities and parameters.

    `comparison`: with the noise estimated beside the effects. `parameters`: joint estimate of the
    same effects. `again` (e,): share of the perturbation ensemble in which each is named again.

    The gain in stretches left out counts as the mean over runs whose start is cut: folds and
    stretches have other limits there, and a gain near the noise moves with them.
    """
    constants, n = training.constants, training.robot.n
    each = tuple(s.located for s in kept)
    begins = (0.0, *START_CUTS)
    gains = [left_out_gains(comparison, each, begin, _PROBABILITY_FOLDS) for begin in begins]
    findings = []
    for index, (selected, *own) in enumerate(zip(kept, *gains, strict=True)):
        if selected.located.calibrated and parameters.deviations(index) < UNSTATED_DEVIATIONS:
            continue
        located, effect = selected.located, selected.located.effect
        # Friction and rotors exist, whatever else acts there; an offset may be the mean of any law.
        exists = located.calibrated and bool(effect.nominal)
        values = parameters.parameters(index, located.constants(constants))
        before = parameters.prior_deviations(index, located.constants(constants))
        reported = tuple(
            Parameter(
                name=name,
                value=value,
                sd=sd,
                unit=located.unit_of(name, constants),
                prior_sd=before[name],
            )
            for name, (value, sd) in values.items()
        )
        chance = parameters.p_value(index)
        size, size_sd = parameters.added_size(comparison, index, selected.channel)
        # The mean of few runs differs between two states by chance, at any of the joints and in
        # any effect of its family.
        alike = sum(each.family == effect.family for each in CATALOGUE)
        places = n * alike if effect.only_in and located.joint is not None else 1
        zero = _null_share(chance, places)
        sure = [
            gain.support * (1.0 - max(0.0 if exists else gain.open_share, zero)) for gain in own
        ]
        misfit = 1.0 - float(np.mean(sure) * again[index])
        findings.append(
            Finding(
                estimated=parameters.effects[index],
                link=None if located.link is None else constants.links[located.link],
                probability=(1.0 - misfit) * selected.probability,
                misfit=misfit,
                absence=0.0
                if located.calibrated
                else 1.0 - (1.0 - zero) * float(np.mean([gain.support for gain in own])),
                rivals=build_rivals(selected, 1.0 - misfit),
                parameters=reported,
                where=effect.signature,
                channel=channel_name(selected.channel, n),
                variance_explained=own[0].explained,
                size=Parameter(
                    name="root mean square",
                    value=size,
                    sd=size_sd,
                    unit="N m" if selected.channel < n else "rad",
                ),
            )
        )
    return tuple(findings)


def refutable_channels(findings: Sequence[Finding]) -> dict[tuple[object, ...], Channel]:
    """Return by key the channel of every finding that held-out runs may refute.

    Those of single runs predict nothing of others, and unstated values of joints exist.
    """
    return {
        each.located.key: Channel.read(each.channel)
        for each in findings
        if not (each.located.calibrated or each.located.is_run_specific)
    }


def judge_by_held_out(
    findings: Sequence[Finding], evidence: Mapping[tuple[object, ...], HeldOutEvidence]
) -> tuple[Finding, ...]:
    """Return findings with the evidence of held-out runs, less likely where these refute them."""
    judged = []
    for finding in findings:
        own = evidence.get(finding.located.key)
        if own is not None:
            told = replace(finding, held_out_ratio=own.ratio)
            finding = refuted(told, 1.0 - own.likelihood * (1.0 - finding.misfit))
        judged.append(finding)
    return tuple(judged)


def describe_taken(findings: Sequence[Finding]) -> list[str]:
    """Return a sentence on findings whose predictions take part of the recorded torque."""
    taken = [each.located.label for each in findings if each.effect.takes_recorded]
    if not taken:
        return []
    return [
        f"Torque beyond the limit of a drive ({', '.join(taken)}) is taken from the recordings, in"
        " held-out runs too: the motion tells nothing of it. Validated is the torque that is given."
    ]


def _null_share(chance: float, places: int = 1) -> float:
    """Return the probability that an effect is zero, from the p-value of its values.

    `places` are those at which chance could have shown it as well.

    The bound of the null hypothesis is one half at most; where zero is within one standard
    deviation, zero is the better explanation.
    """
    beyond = max(chance - _ONE_DEVIATION, 0.0) / (1.0 - _ONE_DEVIATION)
    return max(null_probability(chance, places), 0.5 + 0.5 * beyond if beyond > 0.0 else 0.0)


def decide_verdict(
    findings: tuple[Finding, ...],
    unexplained: Unexplained | None,
    channels: Sequence[ChannelVerdict],
) -> Verdict:
    """Return the verdict on the findings and on the residual that they leave.

    Findings that are no more than possible leave what nominal values within tolerance do not
    explain. A finding in one channel does not answer for another in which none acts.
    """
    sure = any(finding.certainty != "possible" for finding in findings)
    hidden = any(each.verdict == "outside" and not each.acted_on for each in channels)
    if sure and (
        unexplained is None
        or (not hidden and (unexplained.ratio < OPEN_RATIO or unexplained.left < OPEN_SHARE))
    ):
        found = [each for each in findings if each.certainty != "possible"]
        return "law_found" if any(each.effect.family == LAW_FAMILY for each in found) else "named"
    missing = unexplained is not None or any(each.verdict != "nothing" for each in channels)
    return "outside_catalogue" if missing else "nothing_missing"


def describe_next_experiment(
    findings: tuple[Finding, ...],
    plan: ExperimentPlan | None,
    unexplained: Unexplained | None,
    shares: tuple[MismatchShare, ...],
) -> str:
    """Describe the next recording: for the open residual where it dominates, else against rivals.

    Values that the nominal model does not state come last: they exist without doubt.
    """
    if unexplained is not None and unexplained.held_out is not None:
        return describe_next_recording(unexplained)
    if unexplained is not None and shares and not unexplained.brief:
        kind = Channel.read(unexplained.channels[0]).kind
        own = [each for each in shares if each.measured == kind]
        found = [each.share for each in own if each.part and each.part.kind == "finding"]
        if own and own[-1].share > max(found, default=0.0):
            return " ".join(
                [describe_next_recording(unexplained), *([plan.sentence] if plan else [])]
            )
    if plan is not None:
        return plan.sentence
    doubted = [each for each in findings if not each.located.calibrated]
    for finding in (*doubted, *findings):
        if finding.rivals:
            return finding.effect.separate
    return (doubted or findings)[0].located.effect.separate if findings else ""


# How to repeat a motion so that the cause of a residual shows, by the signal that it depends on.
_REPEAT_INSTRUCTIONS = {
    "session_time": "cold and after half an hour of work",
    "time": "once more without a change, to see if it repeats",
    "q": "with joint {} in three other places",
    "qd": "at three speeds up to the fastest",
    "qdd": "once in short, hard accelerations and once in long, soft ones",
    "torque": "with two payloads",
}


def describe_next_recording(unexplained: Unexplained) -> str:
    """Describe the recording that would show most about the unexplained residual."""
    if unexplained.held_out is not None:
        return (
            f'Give {unexplained.held_out.run} the role "train" in recordings.toml and diagnose'
            " again: no training run reaches that state. Keep a repeat of that motion held out."
        )
    channel = Channel.read(unexplained.channels[0])
    repeats = []
    for regressor in unexplained.regressors:
        signal, _, of = regressor.partition(" x ")[0].rpartition("_")
        how = _REPEAT_INSTRUCTIONS.get(regressor, _REPEAT_INSTRUCTIONS.get(signal, ""))
        if how and not (signal == "q" and of == str(channel.joint)):
            repeats.append(how.format(of))
    text = (
        f"Most of the unexplained residual is in the {channel.sensor} of joint {channel.joint}:"
        " move that joint alone through its stroke, slowly and in both directions, the others at"
        " rest"
    )
    if repeats:
        text += f"; then {', '.join(dict.fromkeys(repeats))}"
    return f"{text}."


def findings_with_loop_values(
    recordings: RecordingSet,
    constants: RobotConstants,
    model: ClosedLoopModel,
    findings: Sequence[Finding],
    before: Sequence[Extension],
    runs: Sequence[PreparedRun] = (),
) -> tuple[Finding, ...]:
    """Return findings with the values of the simulation, where it has them as parameters.

    `before`: extensions of the model that the diagnosis started from: their part of a value is no
    finding's. `runs`: training runs, in which findings that it has not give their torques.

    Torques derived from commands are filtered, and so are friction and its reversals: simulated,
    they are where the arm has them. What a value adds to its nominal one is as uncertain as both.
    """
    known = [each for extension in before for each in extension.effects]
    return tuple(
        _with_loop_value(recordings, constants, model, each, known, runs) for each in findings
    )


def _with_loop_value(
    recordings: RecordingSet,
    constants: RobotConstants,
    model: ClosedLoopModel,
    finding: Finding,
    known: Sequence[EstimatedEffect],
    runs: Sequence[PreparedRun],
) -> Finding:
    located, entry = finding.located, finding.effect
    scaled = model.loop.law.scaled
    places = slice(None) if located.joint is None else int(recordings.order[located.joint])
    alike = [each.amplitudes for each in known if each.located.same_place(located)]
    found = _loop_amplitudes(recordings, model, finding, alike)
    if entry.only_in or not np.all(scaled[places]):
        return finding
    if found is None:
        # One with memory, without which the simulation leaves nothing like it in its joint.
        if located.run is not None or not located.is_of_one_joint or located.calibrated:
            return finding
        missed = _is_missed(recordings, constants, model, finding, runs)
        return finding if missed else refuted(finding, 1.0)
    numbers, values, covariance = found
    count = len(finding.estimated.amplitudes)
    whole = np.array([*finding.estimated.amplitudes, *located.shapes])
    sized = [k for k, number in enumerate(numbers) if number < count]
    if entry.limits_drive:
        limit, sd = float(values[0]), float(np.sqrt(covariance[0, 0]))
        own = tuple(
            replace(each, value=limit, sd=sd) if each.name == "limit" else each
            for each in finding.parameters
        )
        return replace(finding, parameters=own)
    reversed_sign = len(sized) == 1 and values[sized[0]] * whole[numbers[sized[0]]] <= 0.0
    deviations = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(deviations, deviations)
    if not located.calibrated:
        # What reverses or vanishes where reversals are simulated was an error of filtered torques.
        # Parameters of a body move together: fewer are free than it has.
        sizes = (values / deviations)[sized]
        solved, _, free, _ = np.linalg.lstsq(correlation[np.ix_(sized, sized)], sizes)
        chance = float(special.chdtrc(free, sizes @ solved))
        zero = reversed_sign or chance > _INSIGNIFICANT_CHANCE
        share = max(_null_share(chance), _zero_by_evidence(recordings, model, finding, sizes))
        finding = refuted(finding, 1.0 if zero else share)
    if reversed_sign:
        return finding
    whole[numbers] = values
    steps = np.zeros((len(numbers), len(whole)))
    steps[range(len(numbers)), numbers] = deviations

    def report(at: np.ndarray) -> np.ndarray:
        own = tuple(at[:count]), tuple(at[count:])
        told = entry.parameters(*own, located.constants(constants))
        return np.array([told[each.name] for each in finding.parameters])

    slopes = np.array([report(whole + step) - report(whole - step) for step in steps]) / 2
    spread = np.sqrt(np.einsum("ik,ij,jk->k", slopes, correlation, slopes))
    each = zip(finding.parameters, report(whole), spread, strict=True)
    parameters = (
        replace(own, value=float(value), sd=float(sd)) if sd > 0.0 else own
        for own, value, sd in each
    )
    return replace(finding, parameters=tuple(parameters))


def _is_missed(
    recordings: RecordingSet,
    constants: RobotConstants,
    model: ClosedLoopModel,
    finding: Finding,
    runs: Sequence[PreparedRun],
) -> bool:
    """Return whether a simulation without a finding leaves what its torque would move the joint.

    Of filtered torques that a law derives from commands, much may be an error of these. What values
    that every simulation fits take of its torque would be left by none: friction that changes
    within a run is mostly dry friction.
    """
    located = finding.located
    assert located.joint is not None
    place = int(recordings.order[located.joint])
    if not model.lacks[place]:
        return False
    own = _torque_in_runs(located, finding.estimated.amplitudes, runs)
    fitted = [
        _torque_in_runs(each, (1.0,), runs)
        for entry in CATALOGUE
        if loop_parameter(entry) is not None and entry.scope == "joint" and not entry.only_in
        for each in effect_places(entry, constants, ())
        if each.joint == located.joint
    ]
    columns = np.column_stack([np.ones(len(own)), *fitted])
    own = own - columns @ np.linalg.lstsq(columns, own)[0]
    least = (1.0 - EXPLAINED_SHARE) * float(np.mean(own**2)) if len(own) else 0.0
    return not least or float(model.left_torque[place]) ** 2 > least


def _torque_in_runs(
    located: LocatedEffect, amplitudes: Sequence[float], runs: Sequence[PreparedRun]
) -> np.ndarray:
    """Return the torque (K,) that an effect adds in its joint in all runs together [N m]."""
    found = []
    for run in runs:
        each = located.contribution(run, amplitudes)
        whole = np.zeros_like(run.signals.motor_position)
        for part in (each.torque, each.link_torque):
            whole = whole if part is None else whole + part
        found.append(np.nan_to_num(whole[:, located.joint]))
    return np.concatenate(found) if found else np.zeros(0)


def refuted(finding: Finding, zero: float) -> Finding:
    """Return a finding as likely as a probability that its simulated values are zero leaves it."""
    misfit = max(finding.misfit, zero)
    share = (1.0 - misfit) / max(1.0 - finding.misfit, 1e-12)
    rivals = tuple(replace(r, probability=share * r.probability) for r in finding.rivals)
    return replace(finding, misfit=misfit, probability=share * finding.probability, rivals=rivals)


def _zero_by_evidence(
    recordings: RecordingSet, model: ClosedLoopModel, finding: Finding, sizes: np.ndarray
) -> float:
    """Return the probability that a value is zero that every simulation fits and none states.

    `sizes` (1,): the value over its standard deviation. 0 of other values.
    """
    entry, joint = finding.effect, finding.located.joint
    parameter = loop_parameter(entry)
    if parameter is None or joint is None:
        return 0.0
    place = int(recordings.order[joint])
    if stated_value(recordings, entry, place) is not None:
        return 0.0
    own = model.fitted.place(parameter.name).start + place
    return float(special.expit(-model.log_evidence(own, float(sizes[0]))))


def _loop_amplitudes(
    recordings: RecordingSet,
    model: ClosedLoopModel,
    finding: Finding,
    alike: Sequence[Sequence[float]],
) -> tuple[list[int], np.ndarray, np.ndarray] | None:
    """Return numbers, values and covariance of a finding's amplitudes that the simulation has.

    Numbers of shapes follow those of amplitudes. None without any. A nominal value is as uncertain
    as its tolerance. `alike`: amplitudes of the same effect in the starting model.
    """
    located, entry, fitted = finding.located, finding.effect, model.fitted
    assert model.polished is not None
    values = fitted.values
    if located.joint is None and "mass" in entry.tolerances:
        body = _loop_body(recordings, model, -1 if located.link is None else located.link)
        return body[0], body[1] - np.sum(alike, axis=0)[body[0]] if alike else body[1], body[2]
    parameter = loop_parameter(entry)
    numbers, tolerance = [0], 0.0
    if parameter is not None and located.joint is not None:
        joint = int(recordings.order[located.joint])
        rows, factors = inseparable_parameters(model.loop.law, fitted, parameter.name, joint)
        known = getattr(recordings.robot, entry.nominal)[joint] if entry.nominal else 0.0
        _, tolerance = stated_value(recordings, entry, joint) or (known, 0.0)
        value = factors @ values[rows]
        slopes = float(parameter.slope(value)) * factors[None]
        found = parameter.convert(value[None]) - known - sum(own[0] for own in alike)
    else:
        keys = model.loop.physics.amplitudes.names
        # Those of the starting model come before those found.
        own = {number: k for k, (key, number) in enumerate(keys) if key == located.key}
        numbers = list(own)
        rows = np.array([fitted.amplitudes.start + k for k in own.values()], dtype=int)
        found, slopes = values[rows], np.eye(len(rows))
    covariance = slopes @ model.polished.whole_covariance()[np.ix_(rows, rows)] @ slopes.T
    covariance += tolerance**2 * np.eye(len(found))
    if not len(found) or not (np.diag(covariance) > 0.0).all():
        return None
    return numbers, found, covariance


def _loop_body(
    recordings: RecordingSet, model: ClosedLoopModel, link: int
) -> tuple[list[int], np.ndarray, np.ndarray]:
    """Return the change of a link's inertial parameters that the simulation has, as amplitudes."""
    place, fitted = int(recordings.order[link]), model.fitted
    nominal, own = (tree.bodies[place] for tree in (recordings.robot.tree, model.loop.tree))
    count = len(BODY_PARAMETERS)
    first = fitted.bodies.start + place * count
    rows = slice(first, first + count)
    assert model.polished is not None
    # A mass keeps its moments in proportion; first moments and the diagonal of inertia besides.
    slopes = np.zeros((len(own.inertial_parameters), count))
    slopes[:, 0] = own.inertial_parameters
    slopes[[1, 2, 3, 4, 6, 9], range(1, count)] = 1.0
    change = own.inertial_parameters - nominal.inertial_parameters + slopes @ fitted.values[rows]
    covariance = slopes @ model.polished.whole_covariance()[rows, rows] @ slopes.T
    stated = stated_tolerance(recordings, "mass") * nominal.inertial_parameters
    covariance += np.outer(stated, stated)
    numbers = np.flatnonzero(np.diag(covariance) > 0.0)
    return numbers.tolist(), change[numbers], covariance[np.ix_(numbers, numbers)]
