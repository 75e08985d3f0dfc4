"""Diagnose a recording set: search on training runs, then predict held-out runs."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from stiffopt.discovery.catalogue import CATALOGUE, changes_in, effects_of_runs
from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.located_effect import Extension
from stiffopt.discovery.conclusions import (
    build_findings,
    decide_verdict,
    describe_next_experiment,
    findings_with_loop_values,
)
from stiffopt.discovery.diagnosis import (
    Diagnosis,
)
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.experiment.design import leading_pair, plan_experiment
from stiffopt.discovery.extended.left_open import rescale_to_rate
from stiffopt.discovery.extended.model import ExtendedModel, load_extended
from stiffopt.discovery.extended.schema import LeftOpenSection
from stiffopt.discovery.identifiable import (
    effect_checks,
    restrict_to_identifiable,
)
from stiffopt.discovery.judging.added_uncertainty import (
    add_band_deviation,
    add_scale_deviation,
    drop_insignificant,
    half_band_comparison,
)
from stiffopt.discovery.judging.bursts import find_bursts
from stiffopt.discovery.judging.detection_limits import DetectionLimit, detection_limits
from stiffopt.discovery.judging.ensemble import recurrence
from stiffopt.discovery.judging.episodes import (
    training_tracks,
)
from stiffopt.discovery.judging.explained_shares import split_extension
from stiffopt.discovery.judging.friction_refit import refit_friction
from stiffopt.discovery.judging.held_out import HeldOutRuns
from stiffopt.discovery.judging.left_open import add_left_open_deviation, build_left_open
from stiffopt.discovery.judging.modes import mode_shifts
from stiffopt.discovery.judging.positions import fit_simulation, simulate_held_out
from stiffopt.discovery.judging.run_deviations import find_friction_drift, find_run_deviations
from stiffopt.discovery.judging.tool_force import explain_by_tool_force
from stiffopt.discovery.judging.unexplained import Unexplained, assess_findings, judge_channels
from stiffopt.discovery.law_search.find import LawSearch, find_laws, located_tables
from stiffopt.discovery.position_fit import model_section
from stiffopt.discovery.prediction_bands import choose_prediction_bands
from stiffopt.discovery.progress import repeat_progress
from stiffopt.discovery.sanity.actuator_estimate import resolve_actuator
from stiffopt.discovery.sanity.gate import judge_plausibility, leave_out_currents
from stiffopt.discovery.sanity.position_errors import take_errors_as_commands
from stiffopt.discovery.search.candidates import Scorer
from stiffopt.discovery.search.rivals import Selected
from stiffopt.discovery.search.search import SearchResult
from stiffopt.discovery.search.tournament import describe_tournament
from stiffopt.discovery.search.uncertainty import (
    Estimate,
    estimate_parameters,
)
from stiffopt.discovery.search_training import search_training_runs
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.steps import (
    BAND_NOT_VARIED,
    BANDS_NOT_CHOSEN,
    FRICTION_NOT_REFITTED,
    NO_BURSTS,
    NO_EXPERIMENT,
    NO_LAWS,
    NO_LIMITS,
    NO_NOISE_CEILING,
    NO_SIMULATION,
    NO_SUSPECTS,
    NOT_PERTURBED,
    describe_stop,
    finish_step,
    skip_if_stopped,
)
from stiffopt.discovery.training import Training, open_training_runs, prepare_training
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
from stiffopt.recording.state_pair import StatePair, load_state_pair

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
                _load_user_effects(effects),
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
    base = load_extended(model, extra) if isinstance(model, str | os.PathLike) else model
    if base is not None:
        recordings = base.applied_to(recordings)
    recordings, taken = take_errors_as_commands(recordings)
    resolved = resolve_actuator(recordings, open_training_runs(recordings, say), say)
    recordings, runs, derived = resolved.recordings, resolved.runs, (*taken, *resolved.notes)
    after = recordings.runs_after if isinstance(recordings, StatePair) else ()
    catalogue = effects_of_runs((*CATALOGUE, *extra), [run.name for run in runs], after)
    if after:
        catalogue = (*catalogue, *changes_in(catalogue, after))
    recorded, every = runs, decimation_factor(runs)
    thin = () if every == 1 else (describe_decimation(runs, every),)
    clock = sampling_rate(runs)
    base = _rescale_left_open(_rescale_left_open(base, clock), clock / every)
    recordings, runs = decimate_noise(recordings, every), [decimate_run(run, every) for run in runs]
    say("check units, signs and orders")
    doubted, remarked = judge_plausibility(
        recordings, runs, despite_doubts=despite_doubts, remarks=base is None
    )
    recordings, runs = leave_out_currents(recordings, runs)
    training = prepare_training(recordings, settings, base, say, runs)
    facts = joint_facts(recordings, training.recorded)
    checks = effect_checks(recordings, facts, len(training.recorded), catalogue)
    asked = restrict_to_identifiable(catalogue, checks)
    sought = asked
    if training.least is None:
        sought = tuple(each for each in asked if not each.only_changed)
    say("compare with the nominal model" if base is None else f"compare with {base.source}")
    training, result, touched = search_training_runs(
        recordings, training, sought, settings, base, say
    )
    stopped = describe_stop(result)
    start = () if base is None else (base.extension,)
    if settings.cutoff is None:  # bands that were asked for hold
        training = (
            skip_if_stopped(
                stopped,
                BANDS_NOT_CHOSEN,
                lambda: _with_prediction_bands(training, start, result, say),
            )
            or training
        )
    settings = training.settings
    laws = skip_if_stopped(stopped, NO_LAWS, lambda: find_laws(result, say)) or LawSearch(
        result=result
    )
    result = laws.result

    def assessed() -> tuple[tuple[Selected, ...], Unexplained | None]:
        say("estimate parameters")
        kept, left = assess_findings(result)
        return kept, explain_by_tool_force(result, left)

    selected, unexplained = finish_step(stopped, assessed)
    half_band = cache(partial(half_band_comparison, training, result.comparison))
    selected, parameters = _estimate_parameters(
        training, settings, start, result, selected, half_band, stopped, say
    )
    parameters = add_scale_deviation(parameters, selected)
    located = tuple(s.located for s in selected)
    again, selected = skip_if_stopped(
        stopped,
        NOT_PERTURBED,
        lambda: _perturb_findings(training, result, selected, half_band, say),
    ) or (np.ones(len(selected)), selected)
    findings = finish_step(
        stopped,
        lambda: build_findings(result.comparison, selected, parameters, training, again),
    )
    limits: tuple[DetectionLimit, ...] = (
        skip_if_stopped(
            stopped,
            NO_LIMITS,
            lambda: detection_limits(Scorer(result.comparison, located), sought, result.effects),
        )
        or ()
    )
    found = Extension(calibration=parameters.calibration(), effects=parameters.effects)
    if unexplained is None and not findings and not runs[0].at_rest:

        def burst() -> Unexplained | None:
            say("look for bursts above the filter's band")
            return find_bursts(training, (*start, found))

        unexplained = skip_if_stopped(stopped, NO_BURSTS, burst)
    new = [s for s in selected if not s.located.calibrated]
    pair = leading_pair(new or selected) if experiment and not runs[0].at_rest else None
    whole = found if base is None else base.extension.plus(found)
    plan = None
    if pair is not None:
        plan = skip_if_stopped(
            stopped,
            NO_EXPERIMENT,
            lambda: plan_experiment(training, result, settings, pair, say=say),
        )
    loop = None
    if recordings.signals.commanded:
        fitted = partial(
            fit_simulation, recordings, training, whole, recorded, resolved.parameters, say
        )
        loop = skip_if_stopped(stopped, NO_SIMULATION, fitted)
    findings = findings_with_loop_values(recordings, loop, findings)
    # The findings are fixed: held-out runs are read only from here on.
    tracks = finish_step(stopped, lambda: training_tracks(result.comparison, result.fit))
    parts = split_extension(found, recordings.unstated)
    opened = HeldOutRuns(training, settings, start, found, parts, every, tracks)
    _predict_held_out(opened, recordings, stopped, say)
    simulated = finish_step(stopped, lambda: simulate_held_out(recordings, loop))
    lasting = [each for each in asked if not each.only_in]
    tables = Extension(effects=tuple(t for each in laws.refused for t in located_tables(each)))
    left_open = _assess_left_open(training, whole.plus(tables), lasting, base, stopped, say)

    def concluded() -> Diagnosis:
        proofs, taken = tuple(opened.proofs), opened.shares.found()
        channels = judge_channels(result, tuple(f.located for f in findings), unexplained)
        drift = find_friction_drift(whole, training.constants, opened.velocities)
        unusable = [run for run in runs if not run.usable]
        seen = (*training.recorded, *unusable, *(proof.run for proof in proofs))
        return Diagnosis(
            recordings=recordings,
            settings=settings,
            model=None if base is None else base.source,
            verdict=decide_verdict(findings, unexplained, channels),
            channel_verdicts=channels,
            findings=findings,
            extension=whole,
            left_open=rescale_to_rate(left_open, clock),
            training=training,
            search=result,
            held_out=proofs,
            shares=taken,
            noise_ceiling=opened.noise_ceiling(),
            not_carried_over=find_run_deviations(proofs, opened.velocities, drift),
            drift=drift,
            closed_loop=model_section(recordings, loop),
            positions=simulated,
            episodes=(*touched, *opened.episodes),
            modes=mode_shifts(result.comparison, result.fit),
            catalogue=catalogue,
            detection_limits=limits,
            unexplained=unexplained,
            laws=laws.laws,
            lawless=laws.refused,
            next_experiment=describe_next_experiment(findings, plan, unexplained, taken),
            assumptions=(
                *stopped,
                *opened.describe_unusable(),
                *(f"Diagnosed despite a doubt: {doubt.evidence}" for doubt in doubted),
                *(f"to be checked: {each}" for each in remarked),
                *thin,
                *derived,
                *describe_tournament(result.contenders),
                *training.assumptions,
            ),
            faults=tuple((run.name, fault) for run in seen for fault in run.faults),
            experiment=plan,
            doubts=doubted,
            stopped=bool(stopped),
        )

    # Ctrl-C has no effect any more: all results exist.
    return complete_step(concluded)[0]


def _rescale_left_open(base: ExtendedModel | None, rate: float) -> ExtendedModel | None:
    """Rescale the residual that a model left open to the sampling rate [Hz]."""
    if base is None or base.left_open is None:
        return base
    return replace(base, left_open=rescale_to_rate(base.left_open, rate))


def _estimate_parameters(
    training: Training,
    settings: Settings,
    start: tuple[Extension, ...],
    result: SearchResult,
    selected: tuple[Selected, ...],
    half_band: Callable[[], Comparison | None],
    stopped: list[str],
    say: Say,
) -> tuple[tuple[Selected, ...], Estimate]:
    """Estimate parameters; drop insignificant findings. Ctrl-C leaves out refinements."""
    comparison = result.comparison
    comparison.columns.release_memory()

    def fitted(found: Sequence[Selected]) -> tuple[tuple[Selected, ...], Estimate]:
        located = tuple(s.located for s in found)
        return tuple(found), finish_step(stopped, lambda: estimate_parameters(comparison, located))

    if not training.free_bodies or training.robot.vibrates:
        return drop_insignificant(selected, fitted)

    def sampled(found: Sequence[Selected]) -> tuple[tuple[Selected, ...], Estimate]:
        say("refit friction to all moving samples where that predicts better")
        return refit_friction(training, settings, start, comparison, found)

    def asked(estimated: Estimate) -> Estimate:
        say("fit the parameters again in half the band")
        return add_band_deviation(comparison, half_band(), estimated)

    def doubted(found: Sequence[Selected]) -> tuple[tuple[Selected, ...], Estimate]:
        kept, first = skip_if_stopped(
            stopped, FRICTION_NOT_REFITTED, lambda: sampled(found)
        ) or fitted(found)
        estimated = skip_if_stopped(stopped, BAND_NOT_VARIED, lambda: asked(first)) or first
        return kept, add_left_open_deviation(training, estimated)

    return drop_insignificant(selected, doubted)


def _with_prediction_bands(
    training: Training,
    start: tuple[Extension, ...],
    result: SearchResult,
    say: Say,
) -> Training:
    """Return the training runs with the bands of predictions, unless these are fixed.

    Those of a model hold, poses at rest have none, and vibration follows the band of the fit.
    """
    fixed = training.settings.predict is not None or training.robot.vibrates
    if fixed or training.recorded[0].at_rest:
        return training
    say("choose how fast a motion predictions follow")
    found = result.comparison.extension_of(result.fit)
    bands = choose_prediction_bands(training, (*start, found))
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


def _perturb_findings(
    training: Training,
    result: SearchResult,
    selected: Sequence[Selected],
    half_band: Callable[[], Comparison | None],
    say: Say,
) -> tuple[np.ndarray, tuple[Selected, ...]]:
    """Return how often each finding is named again in the ensemble, and their odds there."""
    if not selected:
        return np.ones(0), ()
    say("fit the findings again to perturbed runs and models")
    vibrates = training.runs[0].vibration is not None
    other = None if vibrates else half_band()
    return recurrence(result.comparison, selected, other, free_bodies=training.free_bodies)


def _predict_held_out(
    opened: HeldOutRuns, recordings: RecordingSet, stopped: list[str], say: Say
) -> None:
    """Predict the held-out runs; Ctrl-C ends it."""
    if opened.needs_noise_ceiling:
        skip_if_stopped(stopped, NO_NOISE_CEILING, lambda: opened.fit_noise_ceiling(say))
    try:
        opened.predict_all(recordings, say, hurried=bool(stopped))
    except KeyboardInterrupt:
        stopped.append(opened.describe_interruption())


def _assess_left_open(
    training: Training,
    whole: Extension,
    asked: Sequence[Effect],
    base: ExtendedModel | None,
    stopped: list[str],
    say: Say,
) -> LeftOpenSection:
    """Describe the open residual; without suspects, which take long, after Ctrl-C."""
    before = None if base is None else base.left_open

    def suspected() -> LeftOpenSection:
        say("search the open residual for suspects")
        return build_left_open(training, whole, asked, before)

    found = None
    if training.free_bodies:
        found = skip_if_stopped(stopped, NO_SUSPECTS, suspected)
    return found or finish_step(stopped, lambda: build_left_open(training, whole, (), before))


def _load_user_effects(effects: Sequence[Effect] | str | os.PathLike[str]) -> tuple[Effect, ...]:
    if isinstance(effects, str | os.PathLike):
        return load_effects(Path(effects))
    return tuple(effects)
