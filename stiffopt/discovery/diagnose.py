"""From recordings to an answer: search on training runs, then proof on runs never fitted to."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from stiffopt.discovery.catalogue import CATALOGUE, effects_of_runs
from stiffopt.discovery.comparison.located_effect import Extension
from stiffopt.discovery.conclusions import findings_of, next_experiment, verdict_of
from stiffopt.discovery.diagnosis import (
    Diagnosis,
)
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.experiment.design import leading_pair, plan_experiment
from stiffopt.discovery.extended.left_open import at_rate
from stiffopt.discovery.extended.model import ExtendedModel, load_extended
from stiffopt.discovery.extended.schema import LeftOpenSection
from stiffopt.discovery.heartbeat import never_quiet
from stiffopt.discovery.identifiable import effect_checks
from stiffopt.discovery.judging.all_samples import from_all_samples
from stiffopt.discovery.judging.beyond_deviation import beyond_deviation
from stiffopt.discovery.judging.bursts import bursts
from stiffopt.discovery.judging.carried_over import drifts, not_carried_over
from stiffopt.discovery.judging.detection import DetectionLimit, detection_limits
from stiffopt.discovery.judging.episodes import (
    training_tracks,
)
from stiffopt.discovery.judging.held_out import HeldOut
from stiffopt.discovery.judging.left_open import doubted_by_left_open, open_section
from stiffopt.discovery.judging.modes import mode_shifts
from stiffopt.discovery.judging.other_band import doubted_by_band
from stiffopt.discovery.judging.shares import parts_of
from stiffopt.discovery.judging.torque_scale import doubted_by_scale
from stiffopt.discovery.judging.unexplained import Unexplained, assess_findings
from stiffopt.discovery.judging.variance_explained import variance_explained
from stiffopt.discovery.sanity.doubt import Doubt, DoubtfulRecordings
from stiffopt.discovery.sanity.gate import SanityGate
from stiffopt.discovery.search.candidates import Scorer
from stiffopt.discovery.search.identifiable_effects import (
    identifiable_effects,
)
from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.search.search import SearchResult
from stiffopt.discovery.search.uncertainty import (
    Estimate,
    estimate,
)
from stiffopt.discovery.searched import answered
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.stopping import (
    FITTED,
    NO_BURSTS,
    NO_EXPERIMENT,
    NO_LIMITS,
    NO_ROD,
    NO_SUSPECTS,
    ONE_BAND,
    even_if_stopped,
    stopped_in,
    unless_stopped,
)
from stiffopt.discovery.training import Training, train, training_runs
from stiffopt.discovery.user_effects import load_effects
from stiffopt.errors import InputFileError
from stiffopt.interrupts import complete_step
from stiffopt.recording.decimation import (
    decimate_noise,
    decimate_run,
    decimation_factor,
    describe_decimation,
    sampling_rate,
)
from stiffopt.recording.joint_facts import joint_facts
from stiffopt.recording.recording_set import RecordingSet, load_recordings, require_test_runs

Say = Callable[[str], object]


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
        Called with a sentence at every step, and every few seconds of a longer one, from a thread
        beside.
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
    with never_quiet(progress) as say:
        try:
            return _diagnosed(
                recordings,
                _given(effects),
                settings or Settings(),
                say,
                model,
                experiment=experiment,
                despite_doubts=despite_doubts,
            )
        except np.linalg.LinAlgError as error:  # numbers of 1e15 and more beside one another
            raise InputFileError(
                recordings.path, "", "its numbers differ by more than a fit can hold (16 digits)."
                " Check the orders of [nominal], [tolerance], [noise] and of a model given."
            ) from error  # fmt: skip


def _diagnosed(
    recordings: RecordingSet,
    extra: tuple[Effect, ...],
    settings: Settings,
    say: Say,
    model: ExtendedModel | str | os.PathLike[str] | None,
    *,
    experiment: bool,
    despite_doubts: bool,
) -> Diagnosis:
    """See `diagnose`."""
    base = load_extended(model, extra) if isinstance(model, str | os.PathLike) else model
    if base is not None:
        recordings = base.applied_to(recordings)
    runs = training_runs(recordings, say)
    catalogue = effects_of_runs((*CATALOGUE, *extra), [run.name for run in runs])
    every = decimation_factor(runs)
    thin = () if every == 1 else (describe_decimation(runs, every),)
    clock = sampling_rate(runs)
    base = _at_rate(_at_rate(base, clock), clock / every)
    recordings, runs = decimate_noise(recordings, every), [decimate_run(run, every) for run in runs]
    say("check units, signs and orders")
    gate = SanityGate(recordings, runs)
    doubted = gate.doubts
    if doubted and not despite_doubts:
        raise DoubtfulRecordings(recordings.path, doubted)
    remarked = () if doubted or base is not None else gate.remarks
    training = train(recordings, settings, base, say, runs)
    facts = joint_facts(recordings, training.recorded)
    checks = effect_checks(recordings, facts, len(training.recorded), catalogue)
    asked = identifiable_effects(catalogue, checks)
    sought = asked
    if training.least is None:
        sought = tuple(each for each in asked if not each.only_changed)
    say("compare with the nominal model" if base is None else f"compare with {base.source}")
    training, result, touched = answered(recordings, training, sought, settings, base, say)
    settings = training.settings
    stopped = stopped_in(result)

    def assessed() -> tuple[tuple[Selected, ...], Unexplained | None]:
        say("estimate parameters")
        return assess_findings(result)

    selected, unexplained = even_if_stopped(stopped, assessed)
    start = () if base is None else (base.extension,)
    selected, parameters = _parameters(training, settings, start, result, selected, stopped, say)
    parameters = doubted_by_scale(parameters, selected)
    located = tuple(s.located for s in selected)
    findings = even_if_stopped(
        stopped,
        lambda: findings_of(result.comparison, selected, parameters, training, result.after),
    )
    limits: tuple[DetectionLimit, ...] = (
        unless_stopped(
            stopped,
            NO_LIMITS,
            lambda: detection_limits(Scorer(result.comparison, located), sought, result.effects),
        )
        or ()
    )
    found = Extension(calibration=parameters.calibration(), effects=parameters.effects)
    if unexplained is None and not findings:

        def burst() -> Unexplained | None:
            say("look for bursts above the filter's band")
            return bursts(training, (*start, found))

        unexplained = unless_stopped(stopped, NO_BURSTS, burst)
    new = [s for s in selected if s.located.effect.nominal not in recordings.unstated]
    pair = leading_pair(new or selected) if experiment else None
    whole = found if base is None else base.extension.plus(found)
    plan = None
    if pair is not None:
        plan = unless_stopped(
            stopped,
            NO_EXPERIMENT,
            lambda: plan_experiment(training, result, settings, pair, say=say),
        )
    # The findings are fixed: from here on other runs may be opened, and change nothing above.
    tracks = even_if_stopped(stopped, lambda: training_tracks(result.comparison, result.fit))
    parts = parts_of(found, recordings.unstated)
    opened = HeldOut(training, settings, start, found, parts, every, tracks)
    _predicted(opened, recordings, stopped, say)
    left_open = _left_open(training, whole, asked, base, stopped, say)

    def concluded() -> Diagnosis:
        proofs, taken = tuple(opened.proofs), opened.shares.found()
        drift = drifts(whole, training.constants, opened.velocities)
        unusable = [run for run in runs if not run.usable]
        seen = (*training.recorded, *unusable, *(proof.run for proof in proofs))
        return Diagnosis(
            recordings=recordings,
            settings=settings,
            model=None if base is None else base.source,
            verdict=verdict_of(findings, unexplained),
            findings=findings,
            extension=whole,
            left_open=at_rate(left_open, clock),
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
            next_experiment=next_experiment(
                findings, plan, unexplained, taken, recordings.unstated
            ),
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

    # All is known by now: Ctrl-C comes too late to leave anything out.
    return complete_step(concluded)[0]


def _at_rate(base: ExtendedModel | None, rate: float) -> ExtendedModel | None:
    """The model with what it left open as samples at a clock [Hz] show it."""
    if base is None or base.left_open is None:
        return base
    return replace(base, left_open=at_rate(base.left_open, rate))


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
    comparison.columns.release_memory()

    def fitted(found: Sequence[Selected]) -> tuple[tuple[Selected, ...], Estimate]:
        located = tuple(s.located for s in found)
        return tuple(found), even_if_stopped(stopped, lambda: estimate(comparison, located))

    if not training.free_bodies or training.robot.vibrates:
        return beyond_deviation(selected, fitted)

    def sampled(found: Sequence[Selected]) -> tuple[tuple[Selected, ...], Estimate]:
        say("take friction from all moving samples where that predicts better")
        return from_all_samples(training, settings, start, comparison, found)

    def asked(estimated: Estimate) -> Estimate:
        say("ask half the band for the parameters")
        return doubted_by_band(training, comparison, estimated)

    def doubted(found: Sequence[Selected]) -> tuple[tuple[Selected, ...], Estimate]:
        kept, first = unless_stopped(stopped, FITTED, lambda: sampled(found)) or fitted(found)
        estimated = unless_stopped(stopped, ONE_BAND, lambda: asked(first)) or first
        return kept, doubted_by_left_open(training, estimated)

    def explained(found: Sequence[Selected]) -> Sequence[float]:
        located, channels = zip(*((s.located, s.channel) for s in found), strict=True)
        return variance_explained(comparison, located, channels)

    # A change since a model was made is judged by what that left open, not by the noise.
    asked_for = None if comparison.after_model else explained
    return beyond_deviation(selected, doubted, asked_for)


def _predicted(opened: HeldOut, recordings: RecordingSet, stopped: list[str], say: Say) -> None:
    """Predict runs left out, as far as the user waits for them."""
    if opened.measurable:
        unless_stopped(stopped, NO_ROD, lambda: opened.fit_rod(say))
    try:
        opened.predict_all(recordings, say, hurried=bool(stopped))
    except KeyboardInterrupt:
        stopped.append(opened.cut_short())


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
        found = unless_stopped(stopped, NO_SUSPECTS, suspected)
    return found or even_if_stopped(stopped, lambda: open_section(training, whole, (), before))


def _despite(doubted: Sequence[Doubt]) -> list[str]:
    return [f"Diagnosed despite a doubt: {doubt.evidence}" for doubt in doubted]


def _given(effects: Sequence[Effect] | str | os.PathLike[str]) -> tuple[Effect, ...]:
    if isinstance(effects, str | os.PathLike):
        return load_effects(Path(effects))
    return tuple(effects)
