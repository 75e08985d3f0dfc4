"""Conclusions of a diagnosis: findings with probabilities, the verdict, the next recording."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.diagnosis import (
    Finding,
    Parameter,
    Verdict,
    build_rivals,
)
from stiffopt.discovery.experiment.design import ExperimentPlan
from stiffopt.discovery.judging.explained_shares import MismatchShare, variance_explained
from stiffopt.discovery.judging.unexplained import ChannelVerdict, Unexplained, channel_name
from stiffopt.discovery.search.cross_validation import held_out_shares, repeats_in_halves
from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.search.uncertainty import (
    Estimate,
    null_probability,
    p_value_deviations,
)
from stiffopt.discovery.thresholds import (
    MISFIT_ODDS,
    MISFIT_RATIO,
    OPEN_RATIO,
    OPEN_SHARE,
    UNREPEATED_ODDS,
)
from stiffopt.discovery.training import Training


def build_findings(
    comparison: Comparison,
    kept: Sequence[Selected],
    parameters: Estimate,
    training: Training,
    after: np.ndarray,
) -> tuple[Finding, ...]:
    """Return the findings with probabilities and parameters.

    Parameters
    ----------
    comparison : Comparison
        With the noise estimated beside the effects.
    kept : sequence of Selected
    parameters : Estimate
        Joint estimate of the same effects.
    training : Training
    after : array (2 n,)
        Normalised residual of every channel, with the effects.
    """
    constants, n = training.constants, training.robot.n
    shares = variance_explained(
        comparison, tuple(s.located for s in kept), tuple(s.channel for s in kept)
    )
    refitted = held_out_shares(comparison, tuple(s.located for s in kept))
    again = (True,) * len(kept)
    if training.free_bodies:
        again = repeats_in_halves(comparison, tuple(s.located for s in kept))
    findings = []
    for index, (selected, share) in enumerate(zip(kept, shares, strict=True)):
        located, effect = selected.located, selected.located.effect
        open_ = after[selected.channel] > MISFIT_RATIO
        misfit = MISFIT_ODDS * (1.0 - refitted[index]) if open_ else 0.0
        if not again[index]:
            misfit = max(misfit, UNREPEATED_ODDS)
        chance = parameters.p_value(index)
        misfit = max(misfit, null_probability(chance))
        values = parameters.parameters(index, located.constants(constants))
        findings.append(
            Finding(
                estimated=parameters.effects[index],
                link=None if located.link is None else constants.links[located.link],
                probability=(1.0 - misfit) * selected.probability,
                misfit=misfit,
                rivals=build_rivals(selected, 1.0 - misfit),
                parameters=tuple(
                    Parameter(name=name, value=value, sd=sd, unit=located.unit_of(name, constants))
                    for name, (value, sd) in values.items()
                ),
                where=effect.signature,
                channel=channel_name(selected.channel, n),
                variance_explained=share,
                log_evidence=selected.loss,
                significance=min(selected.deviations, p_value_deviations(chance)),
            )
        )
    return tuple(findings)


def decide_verdict(
    findings: tuple[Finding, ...],
    unexplained: Unexplained | None,
    channels: Sequence[ChannelVerdict] = (),
) -> Verdict:
    """Return the verdict on the findings and on the residual that they leave.

    A finding in one channel does not answer for another in which none acts.
    """
    hidden = any(each.verdict == "outside" and not each.acted_on for each in channels)
    if findings and (
        unexplained is None
        or (not hidden and (unexplained.ratio < OPEN_RATIO or unexplained.left < OPEN_SHARE))
    ):
        return "named"
    return "nothing_missing" if unexplained is None else "outside_catalogue"


def describe_next_experiment(
    findings: tuple[Finding, ...],
    plan: ExperimentPlan | None,
    unexplained: Unexplained | None,
    shares: tuple[MismatchShare, ...],
    unstated: Sequence[str],
) -> str:
    """Describe the next recording: for the open residual where it dominates, else against rivals.

    Values that the nominal model does not state come last: they exist without doubt.
    """
    if unexplained is not None and shares and not unexplained.brief:
        kind, _, _ = unexplained.channels[0].rpartition("_")
        own = [each for each in shares if each.measured == kind]
        found = [each.share for each in own if each.part and each.part.kind == "finding"]
        if own and own[-1].share > max(found, default=0.0):
            return " ".join(
                [describe_next_recording(unexplained), *([plan.sentence] if plan else [])]
            )
    if plan is not None:
        return plan.sentence
    doubted = [each for each in findings if each.effect.nominal not in unstated]
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
    """Describe the recording that would show most about the unexplained residual.

    Parameters
    ----------
    unexplained : Unexplained
    """
    kind, _, joint = unexplained.channels[0].rpartition("_")
    words = "torque" if kind == "torque" else "link encoder"
    repeats = []
    for regressor in unexplained.regressors:
        signal, _, of = regressor.partition(" x ")[0].rpartition("_")
        how = _REPEAT_INSTRUCTIONS.get(regressor, _REPEAT_INSTRUCTIONS.get(signal, ""))
        if how and not (signal == "q" and of == joint):
            repeats.append(how.format(of))
    text = (
        f"Most of the unexplained residual is in the {words} of joint {joint}: move that joint"
        " alone through its stroke, slowly and in both directions, the others at rest"
    )
    if repeats:
        text += f"; then {', '.join(dict.fromkeys(repeats))}"
    return f"{text}."
