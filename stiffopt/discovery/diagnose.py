"""Diagnose a recording set: search on training runs, then predict held-out runs."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.discovery.catalogue import CATALOGUE
from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.located_effect import Extension
from stiffopt.discovery.conclusions import (
    build_findings,
    decide_verdict,
    describe_next_experiment,
    describe_taken,
    judge_by_held_out,
    refutable_channels,
)
from stiffopt.discovery.diagnosis import Diagnosis, Finding
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.experiment.design import leading_pair, plan_experiment
from stiffopt.discovery.extended.left_open import rescale_to_rate
from stiffopt.discovery.extended.model import ExtendedModel
from stiffopt.discovery.extended.schema import LeftOpenSection
from stiffopt.discovery.identifiable import effect_checks, restrict_to_identifiable
from stiffopt.discovery.judging.added_uncertainty import (
    add_band_deviation,
    add_scale_deviation,
    drop_insignificant,
    half_band_comparison,
)
from stiffopt.discovery.judging.beyond_training import describe_excess
from stiffopt.discovery.judging.bursts import find_bursts
from stiffopt.discovery.judging.detection_limits import detection_limits
from stiffopt.discovery.judging.ensemble import recurrence
from stiffopt.discovery.judging.episodes import training_tracks
from stiffopt.discovery.judging.explained_shares import split_extension
from stiffopt.discovery.judging.held_out import HeldOutRuns
from stiffopt.discovery.judging.left_open import add_left_open_deviation, build_left_open
from stiffopt.discovery.judging.modes import mode_shifts
from stiffopt.discovery.judging.refutation import Refutation
from stiffopt.discovery.judging.run_deviations import find_friction_drift, find_run_deviations
from stiffopt.discovery.judging.unexplained import (
    Unexplained,
    assess_findings,
    explain_by_tool_force,
    judge_channels,
)
from stiffopt.discovery.law_search.find import LawSearch, find_laws, located_tables
from stiffopt.discovery.laws.law import LAW_FAMILY
from stiffopt.discovery.loop_search import (
    FittedLoop,
    LoopSearch,
    beyond_simulation,
    explained_joints,
    with_findings,
)
from stiffopt.discovery.opening import open_set
from stiffopt.discovery.position_fit import model_section, simulate_held_out
from stiffopt.discovery.prediction import choose_prediction_bands
from stiffopt.discovery.progress import Say, repeat_progress
from stiffopt.discovery.search.candidates import Scorer
from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.search.search import SearchResult
from stiffopt.discovery.search.tournament import describe_tournament
from stiffopt.discovery.search.uncertainty import Estimate, estimate_parameters
from stiffopt.discovery.search_training import TrainingSearch
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.steps import (
    BANDS,
    BURSTS,
    ENSEMBLE,
    EXPERIMENT,
    HALF_BAND,
    LAWS,
    LIMITS,
    NOISE_CEILING,
    SIMULATION,
    SUSPECTS,
    OptionalSteps,
)
from stiffopt.discovery.training import Training, prepare_training
from stiffopt.discovery.user_effects import load_effects
from stiffopt.errors import InputFileError
from stiffopt.interrupts import complete_step
from stiffopt.recording.joint_facts import joint_facts
from stiffopt.recording.recording_set import RecordingSet, load_recordings, require_test_runs
from stiffopt.recording.state_pair import load_state_pair


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
    """Find effects that a recording set's nominal model lacks; prove them on held-out runs.

    Parameters
    ----------
    recordings : RecordingSet or path
        The set, its folder or its recordings.toml.
    effects : sequence of Effect, or path
        Additional to the catalogue: from Python, or a file of them.
    settings : Settings, optional
    progress : callable, optional
        Called with a sentence at every step, and every few seconds of a longer one, from another
        thread.
    model : ExtendedModel or path, optional
        extended.toml of an earlier diagnosis, to start from in place of the nominal model.
    experiment : bool
        Design the motion that separates the leading explanations best; takes some seconds.
    despite_doubts : bool
        Continue where the recordings contradict their description; the doubts are reported.

    Returns
    -------
    Diagnosis

    Raises
    ------
    InputFileError
        A set or run that cannot be used, no training run or no test run.
    DoubtfulRecordings
        The recordings contradict their description: units, signs, column order, gravity.

    Notes
    -----
    Only training runs are read until the findings are fixed. No file is written.
    """
    if not isinstance(recordings, RecordingSet):
        recordings = load_recordings(recordings)
    require_test_runs(recordings)
    with repeat_progress(progress) as say:
        try:
            return _run_diagnosis(
                recordings,
                load_effects(Path(effects))
                if isinstance(effects, str | os.PathLike)
                else tuple(effects),
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


def diagnose_change(
    before: RecordingSet | str | os.PathLike[str],
    after: RecordingSet | str | os.PathLike[str],
    **options: Any,
) -> Diagnosis:
    """Find what changed between two states of one robot; prove it on runs held out of both.

    Both states share one nominal model: its calibration and the effects that it lacks. Changes act
    in the state after alone, so that whatever is common to both cancels as far as the motions
    allow.

    Parameters
    ----------
    before, after : RecordingSet or path
        Sets of one robot with the same joints, signals and nominal values.
    **options
        As of `diagnose`.

    Returns
    -------
    Diagnosis
        Changes are the findings whose effect has `only_in`.

    Raises
    ------
    InputFileError
        Sets that cannot be compared, besides those of `diagnose`.
    """
    return diagnose(load_state_pair(before, after), **options)


def _run_diagnosis(
    recordings: RecordingSet,
    extra: tuple[Effect, ...],
    settings: Settings,
    say: Say,
    model: ExtendedModel | str | os.PathLike[str] | None,
    *,
    experiment: bool,
    despite_doubts: bool,
) -> Diagnosis:
    """Run the stages of `diagnose`."""
    opened = open_set(recordings, CATALOGUE, extra, model, say, despite_doubts=despite_doubts)
    recordings, base = opened.recordings, opened.base
    training = prepare_training(recordings, settings, base, say, opened.runs)
    facts = joint_facts(recordings, training.recorded)
    checks = effect_checks(recordings, facts, len(training.recorded), opened.catalogue)
    asked = restrict_to_identifiable(opened.catalogue, checks)
    # Forms of changes are sought only beside a model.
    sought = tuple(each for each in asked if training.least is not None or not each.only_changed)
    say("compare with the nominal model" if base is None else f"compare with {base.source}")
    searches = TrainingSearch(
        recordings=recordings, asked=sought, settings=settings, base=base, say=say
    )
    training, result, touched = searches.run(training)
    steps = OptionalSteps(result, say)
    simulation = LoopSearch(
        recordings=recordings,
        training=training,
        asked=sought,
        runs=opened.recorded,
        estimated=opened.actuator,
        say=say,
    )
    fitted = _fit_simulation(simulation, result, base, steps)
    explained = explained_joints(recordings, None if fitted is None else fitted.model, result)
    laws = steps.run(LAWS, lambda: find_laws(result, say, explained)) or LawSearch(result=result)
    result = laws.result

    def assessed() -> tuple[tuple[Selected, ...], Unexplained | None]:
        say("estimate parameters")
        kept, left = assess_findings(result)
        return kept, explain_by_tool_force(result, left)

    selected, unexplained = steps.finish(assessed)
    fitted_model = result.comparison.extension_of(result.fit)
    half_band = cache(partial(half_band_comparison, training, result.comparison, fitted_model))
    selected, parameters = _estimate_parameters(
        training, result.comparison, selected, half_band, steps
    )
    parameters = add_scale_deviation(parameters, selected)
    located = tuple(s.located for s in selected)
    again = np.ones(len(selected))

    def perturbed() -> tuple[np.ndarray, tuple[Selected, ...]]:
        other = None if training.runs[0].vibration is not None else half_band()
        return recurrence(result.comparison, selected, other, free_bodies=training.free_bodies)

    if selected:
        again, selected = steps.run(ENSEMBLE, perturbed) or (again, selected)
    findings = steps.finish(
        lambda: build_findings(result.comparison, selected, parameters, training, again)
    )
    limits = steps.run(
        LIMITS, lambda: detection_limits(Scorer(result.comparison, located), sought, result.effects)
    )
    found = steps.finish(lambda: extension_of_estimate(parameters, findings))
    whole = _with_found(found, base)
    fitted_effects = {each.located.key: each for each in found.effects}
    findings = tuple(replace(f, estimated=fitted_effects[f.located.key]) for f in findings)
    if settings.cutoff is None:  # bands that were asked for hold
        training = _with_prediction_bands(training, found, steps)
    if unexplained is None and not findings and not opened.at_rest:
        unexplained = steps.run(BURSTS, lambda: find_bursts(training, found))
    new = [s for s in selected if not s.located.calibrated]
    pair = leading_pair(new or selected) if experiment and not opened.at_rest else None
    plan = loop = None
    if pair is not None:
        plan = steps.run(EXPERIMENT, lambda: plan_experiment(training, result, pair, say=say))
    if recordings.signals.commanded:
        before = findings
        loop, findings = steps.run(SIMULATION, lambda: simulation.run(whole, before, fitted)) or (
            None,
            before,
        )
        found, whole = (with_findings(each, before, findings) for each in (found, whole))
        unexplained = beyond_simulation(unexplained, explained_joints(recordings, loop, result))
    # The findings are fixed: held-out runs are read only from here on.
    tracks = steps.finish(lambda: training_tracks(result.comparison, result.fit))
    parts = split_extension(found, recordings.unstated)
    # Of commands positions are the proof, not torques that a law derives from these.
    tested = {} if recordings.signals.commanded else refutable_channels(findings)
    refutation = steps.finish(lambda: Refutation(result.comparison, located, tested))
    held_out = HeldOutRuns(training, found, parts, refutation, opened.every, tracks)
    if training.free_bodies and not training.robot.vibrates:
        steps.run(NOISE_CEILING, lambda: held_out.fit_noise_ceiling(say))
    try:
        held_out.predict_all(recordings, say, hurried=bool(steps.stopped))
    except KeyboardInterrupt:
        steps.stopped.append(held_out.describe_interruption())
    if not recordings.signals.commanded:
        unexplained = unexplained or describe_excess(held_out.excess, recordings.n)
    simulated = steps.finish(lambda: simulate_held_out(recordings, loop))
    lasting = [each for each in asked if not each.only_in]
    tables = Extension(effects=tuple(t for each in laws.refused for t in located_tables(each)))
    left_open = _assess_left_open(training, whole.plus(tables), lasting, base, steps)

    def concluded() -> Diagnosis:
        proofs, taken = tuple(held_out.proofs), held_out.shares.found()
        judged = judge_by_held_out(findings, refutation.evidence())
        channels = judge_channels(result, tuple(f.located for f in findings), unexplained)
        drift = find_friction_drift(whole, training.constants, proofs)
        unusable = [run for run in opened.runs if not run.usable]
        seen = (*training.recorded, *unusable, *(proof.run for proof in proofs))
        return Diagnosis(
            recordings=recordings,
            settings=training.settings,
            model=None if base is None else base.source,
            verdict=decide_verdict(judged, unexplained, channels),
            channel_verdicts=channels,
            findings=judged,
            extension=whole,
            left_open=rescale_to_rate(left_open, opened.clock),
            training=training,
            search=result,
            held_out=proofs,
            shares=taken,
            noise_ceiling=held_out.noise_ceiling(),
            not_carried_over=find_run_deviations(proofs, drift),
            drift=drift,
            closed_loop=model_section(recordings, loop),
            positions=simulated,
            episodes=(*touched, *held_out.episodes),
            modes=mode_shifts(result.comparison, result.fit),
            catalogue=opened.catalogue,
            detection_limits=limits or (),
            unexplained=unexplained,
            laws=laws.laws,
            lawless=laws.refused,
            next_experiment=describe_next_experiment(judged, plan, unexplained, taken),
            assumptions=(
                *steps.stopped,
                *held_out.describe_unusable(),
                *describe_taken(findings),
                *opened.assumptions(),
                *describe_tournament(result.contenders),
                *training.assumptions,
            ),
            faults=tuple((run.name, fault) for run in seen for fault in run.faults),
            experiment=plan,
            doubts=opened.doubts,
            stopped=bool(steps.stopped),
        )

    # Ctrl-C has no effect any more: all results exist.
    return complete_step(concluded)[0]


def extension_of_estimate(estimate: Estimate, findings: Sequence[Finding] = ()) -> Extension:
    """Return the extension by an estimate, with less of the effects that may be absent.

    By the `findings` all of the values up to an absence of one half, and from there on less, down
    to none of an effect that is surely absent; the others are fitted beside that. A value within a
    standard deviation of zero predicts worse than zero.
    """
    absence = {each.located.key: each.absence for each in findings}
    shares = [2.0 - 2.0 * absence.get(each.located.key, 0.0) for each in estimate.effects]
    estimate = estimate.shrunk(np.minimum(shares, 1.0))
    return Extension(calibration=estimate.calibration(), effects=estimate.effects)


def _with_found(found: Extension, base: ExtendedModel | None) -> Extension:
    """Return the starting model with the effects found."""
    return found if base is None else base.extension.plus(found)


def _fit_simulation(
    simulation: LoopSearch, result: SearchResult, base: ExtendedModel | None, steps: OptionalSteps
) -> FittedLoop | None:
    """Return the simulation of a set of commands with what a search found."""
    if not simulation.recordings.signals.commanded:
        return None
    estimate = steps.finish(lambda: estimate_parameters(result.comparison, result.effects))
    return steps.run(
        SIMULATION, lambda: simulation.fit(_with_found(extension_of_estimate(estimate), base))
    )


def _estimate_parameters(
    training: Training,
    comparison: Comparison,
    selected: tuple[Selected, ...],
    half_band: Callable[[], Comparison | None],
    steps: OptionalSteps,
) -> tuple[tuple[Selected, ...], Estimate]:
    """Estimate parameters; drop insignificant findings. Ctrl-C leaves out refinements."""
    comparison.columns.release_memory()

    def fitted(found: Sequence[Selected]) -> tuple[tuple[Selected, ...], Estimate]:
        located = tuple(s.located for s in found)
        return tuple(found), steps.finish(lambda: estimate_parameters(comparison, located))

    def refined(found: Sequence[Selected]) -> tuple[tuple[Selected, ...], Estimate]:
        kept, first = fitted(found)
        other = steps.run(HALF_BAND, lambda: add_band_deviation(comparison, half_band(), first))
        return kept, add_left_open_deviation(training, other or first)

    plain = not training.free_bodies or training.robot.vibrates
    return drop_insignificant(selected, fitted if plain else refined)


def _with_prediction_bands(training: Training, found: Extension, steps: OptionalSteps) -> Training:
    """Return the training runs with the bands of predictions, unless these are fixed.

    Those of a model hold, poses at rest have none, and vibration follows the band of the fit.
    """
    fixed = training.settings.predict is not None or training.robot.vibrates
    if fixed or training.recorded[0].at_rest:
        return training
    # Laws of the residual in the band of the fit say nothing of wider ones.
    known = [each for each in found.effects if each.effect.family != LAW_FAMILY]
    plain = replace(found, effects=tuple(known))
    bands = steps.run(BANDS, lambda: choose_prediction_bands(training, plain))
    if bands is None:
        return training
    each = ", ".join(f"{j}: {band:g}" for j, band in enumerate(bands, start=1))
    note = (
        f"Predicted torques follow the motion up to (joint {each}) Hz, as the fitted model predicts"
        " the training runs best."
    )
    return replace(
        training,
        settings=replace(training.settings, predict=bands),
        assumptions=(*training.assumptions, note),
    )


def _assess_left_open(
    training: Training,
    whole: Extension,
    asked: Sequence[Effect],
    base: ExtendedModel | None,
    steps: OptionalSteps,
) -> LeftOpenSection:
    """Describe the open residual; without suspects, which take long, after Ctrl-C."""
    before, found = None if base is None else base.left_open, None
    if training.free_bodies:
        found = steps.run(SUSPECTS, lambda: build_left_open(training, whole, asked, before))
    return found or steps.finish(lambda: build_left_open(training, whole, (), before))
