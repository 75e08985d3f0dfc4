"""From recordings to an answer: search on training runs, then proof on runs never fitted to."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from stiffopt.discovery.catalogue import CATALOGUE, of_runs
from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.extension import Extension
from stiffopt.discovery.diagnosis import (
    Diagnosis,
    Finding,
    Parameter,
    Verdict,
    rivals_of,
)
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.experiment.design import ExperimentPlan, leading_pair, plan_experiment
from stiffopt.discovery.extended.left_open import of_means, of_samples
from stiffopt.discovery.extended.model import ExtendedModel, load_extended
from stiffopt.discovery.extended.schema import LeftOpenSection
from stiffopt.discovery.identifiable import effect_checks
from stiffopt.discovery.judging.all_samples import from_all_samples
from stiffopt.discovery.judging.bursts import bursts
from stiffopt.discovery.judging.carried_over import drifts, not_carried_over
from stiffopt.discovery.judging.detection import DetectionLimit, detection_limits
from stiffopt.discovery.judging.episodes import (
    training_tracks,
)
from stiffopt.discovery.judging.held_out import HeldOut
from stiffopt.discovery.judging.left_open import open_section
from stiffopt.discovery.judging.modes import mode_shifts
from stiffopt.discovery.judging.next_recording import next_recording
from stiffopt.discovery.judging.other_band import doubted_by_band
from stiffopt.discovery.judging.shares import Share, parts_of
from stiffopt.discovery.judging.unexplained import Unexplained, assess_findings, channel_name
from stiffopt.discovery.judging.variance_explained import variance_explained
from stiffopt.discovery.sanity.doubt import Doubt, DoubtfulRecordings
from stiffopt.discovery.sanity.gate import doubts, remarks
from stiffopt.discovery.search.candidates import Scorer
from stiffopt.discovery.search.identifiable_effects import (
    identifiable_effects,
)
from stiffopt.discovery.search.left_out import repeated, shares_left_out
from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.search.search import SearchResult
from stiffopt.discovery.search.uncertainty import (
    Estimate,
    deviations,
    estimate,
    odds_of_nothing,
)
from stiffopt.discovery.searched import answered
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.thresholds import (
    MISFIT_ODDS,
    MISFIT_RATIO,
    OPEN_RATIO,
    OPEN_SHARE,
    UNREPEATED_ODDS,
)
from stiffopt.discovery.training import Training, train, training_runs
from stiffopt.discovery.user_effects import load_effects
from stiffopt.interrupts import finished
from stiffopt.recording.facts import joint_facts
from stiffopt.recording.recording_set import RecordingSet, load_recordings, require_test_runs
from stiffopt.recording.thinning import quieter, samples_a_mean, sentence, thinned

Say = Callable[[str], object]
Answer = TypeVar("Answer")

_STOPPED = (
    "Stopped by the user: what was found until then is told, and more may be missing than that."
)
_HURRIED = (
    "Stopped by the user when the search was over: the findings are all there, and what takes"
    " longer beside them was left out."
)
_NOT_WEIGHED = (
    "Stopped by the user: what stands at a half was not weighed against what could stand in its"
    " place."
)
_FITTED = "Stopped by the user: friction is that of the fit, without samples near standstill."
_NO_LIMITS = "Stopped by the user: what would have been seen of other effects was not calculated."
_NO_BURSTS = "Stopped by the user: nobody looked for bursts above the filter's band."
_ONE_BAND = "Stopped by the user: standard deviations count nothing of what half the band says."
_NO_EXPERIMENT = "Stopped by the user: no experiment was designed."
_NO_ROD = "Stopped by the user: no black box was fitted to measure by."
_NO_SUSPECTS = "Stopped by the user: what is left open was not asked for suspects."


def diagnose(
    recordings: RecordingSet | str | os.PathLike[str],
    *,
    effects: Sequence[Effect] | str | os.PathLike[str] = (),
    settings: Settings | None = None,
    progress: Say | None = None,
    model: ExtendedModel | str | os.PathLike[str] | None = None,
    experiment: bool = True,
    despite_doubts: bool = False,
) -> Diagnosis:
    """Find what the nominal model of a recording set lacks, and prove it on held-out runs.

    Parameters
    ----------
    recordings : RecordingSet or path
        Of its folder or its recordings.toml.
    effects : sequence of Effect, or path
        Beside those of the catalogue: from Python, or a file of them.
    settings : Settings, optional
    progress : callable, optional
        Called with a sentence at every step.
    model : ExtendedModel or path, optional
        extended.toml of an earlier diagnosis, in place of the nominal model.
    experiment : bool
        Design the motion that would separate the leading explanations best; some seconds.
    despite_doubts : bool
        Go on where the recordings contradict their own description; the doubts are kept.

    Returns
    -------
    Diagnosis

    Raises
    ------
    InputFileError
        A set or run that cannot be used, no training run or no test run.
    DoubtfulRecordings
        Recordings that contradict their own description: units, signs, orders, gravity.

    Notes
    -----
    Only training runs are open until the findings are fixed. Nothing is written.
    """
    if not isinstance(recordings, RecordingSet):
        recordings = load_recordings(recordings)
    require_test_runs(recordings)
    settings = settings or Settings()
    say = progress or (lambda _: None)
    extra = _given(effects)
    base = load_extended(model, extra) if isinstance(model, str | os.PathLike) else model
    if base is not None:
        recordings = base.applied_to(recordings)
    runs = training_runs(recordings, say)
    catalogue = of_runs((*CATALOGUE, *extra), [run.name for run in runs])
    every = samples_a_mean(runs)
    thin = () if every == 1 else (sentence(runs, every),)
    recordings, runs = quieter(recordings, every), [thinned(run, every) for run in runs]
    base = _of_means(base, every)
    say("check units, signs and orders")
    doubted = doubts(recordings, runs)
    if doubted and not despite_doubts:
        raise DoubtfulRecordings(recordings.path, doubted)
    remarked = () if doubted or base is not None else remarks(recordings, runs)
    training = train(recordings, settings, base, say, runs)
    facts = joint_facts(recordings, training.recorded)
    checks = effect_checks(recordings, facts, len(training.recorded), catalogue)
    asked = identifiable_effects(catalogue, checks)
    sought = asked
    if training.least is None:
        sought = tuple(each for each in asked if not each.only_changed)
    say("compare with the nominal model" if base is None else f"compare with {base.source}")
    training, result, touched = answered(recordings, training, sought, base, say)
    settings = training.settings
    stopped = _stopped_in(result)

    def assessed() -> tuple[tuple[Selected, ...], Unexplained | None]:
        say("estimate parameters")
        return assess_findings(result)

    selected, unexplained = _even_if_stopped(stopped, assessed)
    start = () if base is None else (base.extension,)
    selected, parameters = _parameters(training, settings, start, result, selected, stopped, say)
    located = tuple(s.located for s in selected)
    findings = _even_if_stopped(
        stopped,
        lambda: _findings(result.comparison, selected, parameters, training, result.after),
    )
    limits: tuple[DetectionLimit, ...] = (
        _unless_stopped(
            stopped,
            _NO_LIMITS,
            lambda: detection_limits(Scorer(result.comparison, located), sought, result.effects),
        )
        or ()
    )
    found = Extension(calibration=parameters.calibration(), effects=parameters.effects)
    if unexplained is None and not findings:

        def burst() -> Unexplained | None:
            say("look for bursts above the filter's band")
            return bursts(training, (*start, found), settings)

        unexplained = _unless_stopped(stopped, _NO_BURSTS, burst)
    new = [s for s in selected if s.located.effect.nominal not in recordings.unstated]
    pair = leading_pair(new or selected) if experiment else None
    whole = found if base is None else base.extension.followed_by(found)
    plan = None
    if pair is not None:
        plan = _unless_stopped(
            stopped,
            _NO_EXPERIMENT,
            lambda: plan_experiment(training, result, settings, pair, say=say),
        )
    # The findings are fixed: from here on other runs may be opened, and change nothing above.
    tracks = training_tracks(result.comparison, result.fit)
    parts = parts_of(found, recordings.unstated)
    opened = HeldOut(training, settings, start, found, parts, every, tracks)
    if opened.measurable:
        _unless_stopped(stopped, _NO_ROD, lambda: opened.fit_rod(say))
    try:
        opened.predict_all(recordings, say, hurried=bool(stopped))
    except KeyboardInterrupt:
        stopped.append(opened.cut_short())
    left_open = _left_open(training, whole, asked, base, stopped, say)
    proofs, taken = tuple(opened.proofs), opened.shares.found()
    drift = drifts(found, training.constants, opened.velocities)
    seen = (*training.recorded, *(proof.run for proof in proofs))
    return Diagnosis(
        recordings=recordings,
        settings=settings,
        model=None if base is None else base.source,
        verdict=_verdict(findings, unexplained),
        findings=findings,
        extension=whole,
        left_open=of_samples(left_open, every),
        training=training,
        search=result,
        held_out=proofs,
        shares=taken,
        rod=opened.rod(),
        not_carried_over=not_carried_over(proofs, opened.velocities, drift),
        drift=drift,
        episodes=(*touched, *opened.episodes),
        modes=mode_shifts(result.comparison, result.fit),
        catalogue=catalogue,
        detection_limits=limits,
        unexplained=unexplained,
        next_experiment=_next_experiment(findings, plan, unexplained, taken, recordings.unstated),
        assumptions=(
            *stopped,
            *opened.not_predictable(),
            *_despite(doubted),
            *(f"to be looked at: {each}" for each in remarked),
            *thin,
            *training.assumptions,
        ),
        faults=tuple((run.name, fault) for run in seen for fault in run.faults),
        experiment=plan,
        doubts=doubted,
        stopped=bool(stopped),
    )


def _of_means(base: ExtendedModel | None, every: int) -> ExtendedModel | None:
    """The model with what it left open as means of so many samples show it."""
    if base is None or base.left_open is None:
        return base
    return replace(base, left_open=of_means(base.left_open, every))


def _parameters(
    training: Training,
    settings: Settings,
    start: tuple[Extension, ...],
    result: SearchResult,
    selected: tuple[Selected, ...],
    stopped: list[str],
    say: Say,
) -> tuple[tuple[Selected, ...], Estimate]:
    """Findings and their parameters, as far as the user waits for them."""
    comparison = result.comparison

    def fitted() -> tuple[tuple[Selected, ...], Estimate]:
        located = tuple(s.located for s in selected)
        return selected, _even_if_stopped(stopped, lambda: estimate(comparison, located))

    if not training.free_bodies or training.robot.swings:
        return fitted()

    def sampled() -> tuple[tuple[Selected, ...], Estimate]:
        say("take friction from all moving samples where that predicts better")
        return from_all_samples(training, settings, start, comparison, selected)

    kept, estimated = _unless_stopped(stopped, _FITTED, sampled) or fitted()

    def asked() -> Estimate:
        say("ask half the band for the parameters")
        return doubted_by_band(training, comparison, estimated)

    return kept, _unless_stopped(stopped, _ONE_BAND, asked) or estimated


def _stopped_in(result: SearchResult) -> list[str]:
    """What is said of a search that Ctrl-C ended, or that it came behind."""
    stopped = [_STOPPED] if result.stopped else []
    if not result.weighed:
        stopped.append(_NOT_WEIGHED)
    return stopped or ([_HURRIED] if result.hurried else [])


def _even_if_stopped(stopped: list[str], step: Callable[[], Answer]) -> Answer:
    """What a short step behind the search answers: Ctrl-C ends what comes later."""
    answer, hurried = finished(step)
    if hurried and not stopped:
        stopped.append(_HURRIED)
    return answer


def _unless_stopped(stopped: list[str], what: str, step: Callable[[], Answer]) -> Answer | None:
    """What a step answers that can be left out: Ctrl-C does, in it or before, and `what` tells."""
    if not stopped:
        try:
            return step()
        except KeyboardInterrupt:
            pass
    stopped.append(what)
    return None


def _left_open(
    training: Training,
    whole: Extension,
    asked: Sequence[Effect],
    base: ExtendedModel | None,
    stopped: list[str],
    say: Say,
) -> LeftOpenSection:
    """What is left open; without suspects, which take long, where the user is in a hurry."""
    before = None if base is None else base.left_open

    def suspected() -> LeftOpenSection:
        say("what is left open")
        return open_section(training, whole, asked, before)

    found = None
    if training.free_bodies:
        found = _unless_stopped(stopped, _NO_SUSPECTS, suspected)
    return found or _even_if_stopped(stopped, lambda: open_section(training, whole, (), before))


def _despite(doubted: Sequence[Doubt]) -> list[str]:
    return [f"Diagnosed despite a doubt: {doubt.evidence}" for doubt in doubted]


def _given(effects: Sequence[Effect] | str | os.PathLike[str]) -> tuple[Effect, ...]:
    if isinstance(effects, str | os.PathLike):
        return load_effects(Path(effects))
    return tuple(effects)


def _verdict(findings: tuple[Finding, ...], unexplained: Unexplained | None) -> Verdict:
    if findings and (
        unexplained is None or unexplained.ratio < OPEN_RATIO or unexplained.left < OPEN_SHARE
    ):
        return "named"
    return "nothing_missing" if unexplained is None else "outside_catalogue"


def _findings(
    comparison: Comparison,
    kept: Sequence[Selected],
    parameters: Estimate,
    training: Training,
    after: np.ndarray,
) -> tuple[Finding, ...]:
    constants, n = training.constants, training.robot.n
    shares = variance_explained(
        comparison, tuple(s.located for s in kept), tuple(s.channel for s in kept)
    )
    refitted = shares_left_out(comparison, tuple(s.located for s in kept))
    again = (True,) * len(kept)
    if training.free_bodies:
        again = repeated(comparison, tuple(s.located for s in kept))
    findings = []
    for index, (selected, share) in enumerate(zip(kept, shares, strict=True)):
        located, effect = selected.located, selected.located.effect
        open_ = after[selected.channel] > MISFIT_RATIO
        misfit = MISFIT_ODDS * (1.0 - refitted[index]) if open_ else 0.0
        if not again[index]:
            misfit = max(misfit, UNREPEATED_ODDS)
        chance = parameters.chance_of_nothing(index)
        misfit = max(misfit, odds_of_nothing(chance))
        values = parameters.parameters(index, located.constants(constants))
        findings.append(
            Finding(
                estimated=parameters.effects[index],
                link=None if located.link is None else constants.links[located.link],
                probability=(1.0 - misfit) * selected.probability,
                misfit=misfit,
                rivals=rivals_of(selected, 1.0 - misfit),
                parameters=tuple(
                    Parameter(name=name, value=value, sd=sd, unit=located.unit_of(name, constants))
                    for name, (value, sd) in values.items()
                ),
                where=effect.signature,
                channel=channel_name(selected.channel, n),
                variance_explained=share,
                log_evidence=selected.loss,
                significance=min(selected.deviations, deviations(chance)),
            )
        )
    return tuple(findings)


def _next_experiment(
    findings: tuple[Finding, ...],
    plan: ExperimentPlan | None,
    unexplained: Unexplained | None,
    shares: tuple[Share, ...],
    unstated: Sequence[str],
) -> str:
    """What is open where that is the most, else what separates the first finding that has rivals.

    Of a value that the nominal model does not give nobody doubts that it is there.
    """
    if unexplained is not None and shares and not unexplained.brief:
        kind, _, _ = unexplained.channels[0].rpartition("_")
        own = [each for each in shares if each.measured == kind]
        found = [each.share for each in own if each.part and each.part.kind == "finding"]
        if own and own[-1].share > max(found, default=0.0):
            return " ".join([next_recording(unexplained), *([plan.sentence] if plan else [])])
    if plan is not None:
        return plan.sentence
    doubted = [each for each in findings if each.effect.nominal not in unstated]
    for finding in (*doubted, *findings):
        if finding.rivals:
            return finding.effect.separate
    return (doubted or findings)[0].located.effect.separate if findings else ""
