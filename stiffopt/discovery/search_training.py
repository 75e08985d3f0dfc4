"""Searches of the training runs: links in balance where these swing otherwise, hands left out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.extension import Extension
from stiffopt.discovery.effect import Effect
from stiffopt.discovery.extended.model import ExtendedModel
from stiffopt.discovery.identifiable import (
    locate_unstated,
    remove_bounds,
    select_unseen,
    widen_for_changes,
)
from stiffopt.discovery.judging.episodes import (
    Episode,
    find_episodes,
    mask_episodes,
    training_tracks,
)
from stiffopt.discovery.search.search import SearchResult, search
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.thresholds import MAX_CONTACT_ROUNDS, MAX_VIBRATION_MISFIT
from stiffopt.discovery.training import Training, prepare_training
from stiffopt.interrupts import finished
from stiffopt.recording.recording_set import RecordingSet

Say = Callable[[str], object]


def search_training_runs(
    recordings: RecordingSet,
    training: Training,
    asked: Sequence[Effect],
    settings: Settings,
    base: ExtendedModel | None,
    say: Say,
) -> tuple[Training, SearchResult, tuple[Episode, ...]]:
    """What was found in training runs.

    Parameters
    ----------
    recordings : RecordingSet
    training : Training
    asked : sequence of Effect
        What the recordings can tell of the catalogue.
    settings : Settings
        As they were before the training runs chose bands.
    base : ExtendedModel or None
        That is started from.
    say : callable
        Called with a sentence at every step.

    Returns
    -------
    training : Training
        That the answer is about.
    result : SearchResult
    touched : tuple of Episode
        Times in the runs that are left out of it.
    """
    comparison = training.comparison()
    # What shows beside the nominal model already is no part of the first search.
    touched = find_episodes(training_tracks(comparison, comparison.fit()))
    if touched:
        say(_describe_exclusion(touched))
        training = _prepare_without(recordings, training, settings, base, say, touched)
        comparison = training.comparison()
    result = _search_once(recordings, training, asked, base, say, comparison=comparison)
    if training.runs[0].swing is not None and not (result.stopped or result.hurried):
        training, result = _retry_quasi_static(recordings, training, asked, base, say, result)
    training, result, later = _exclude_contacts(
        recordings, training, asked, settings, base, say, result
    )
    return training, result, (*touched, *later)


def _retry_quasi_static(
    recordings: RecordingSet,
    training: Training,
    asked: Sequence[Effect],
    base: ExtendedModel | None,
    say: Say,
    result: SearchResult,
) -> tuple[Training, SearchResult]:
    """The answer, or a better one where links swing otherwise than the model's by far.

    Slopes about the nominal swing do not reach a mode that lies far off; a comparison of slow
    motion, links in balance, does, and what it finds is a motion to go on from.
    """
    if _rms_residual(result) <= MAX_VIBRATION_MISFIT:
        return training, result
    say("the swing of the links is not that of the model: compare them in balance")
    answers = [(training, result)]
    try:
        balanced = prepare_training(
            recordings, training.settings, base, say, training.recorded, swinging=False
        )
        still = _search_once(recordings, balanced, asked, base, say)
        answers.append((balanced, still))
        if still.effects and not (still.stopped or still.hurried):
            say("let the links swing with what was found in balance")
            about = still.comparison.found(still.fit)
            answers.append((training, _search_once(recordings, training, asked, base, say, about)))
        stopped = any(found.stopped for _, found in answers)
    except KeyboardInterrupt:
        stopped = True
    # Whichever is the best: what was stopped might have been better.
    own, best = min(answers, key=lambda answer: _rms_residual(answer[1]))
    hurried = any(found.hurried for _, found in answers)
    return own, replace(best, stopped=stopped, hurried=hurried)


def _exclude_contacts(
    recordings: RecordingSet,
    training: Training,
    asked: Sequence[Effect],
    settings: Settings,
    base: ExtendedModel | None,
    say: Say,
    result: SearchResult,
) -> tuple[Training, SearchResult, tuple[Episode, ...]]:
    """The answer without times in which something touched the arm, and these times."""
    found: tuple[Episode, ...] = ()
    for _ in range(MAX_CONTACT_ROUNDS):
        if result.stopped or result.hurried:
            break
        new, hurried = finished(partial(_find_contacts, result))
        if hurried:
            result = replace(result, hurried=True)
        if hurried or not new:
            break
        say(f"{_describe_exclusion(new)}, and search again")
        try:
            apart = _prepare_without(recordings, training, settings, base, say, new)
            again = _search_once(recordings, apart, asked, base, say)
            stopped = again.stopped
        except KeyboardInterrupt:
            stopped = True
        if stopped:
            # The answer before is whole, that of a search that was stopped is not.
            result = replace(result, stopped=True)
            break
        training, result, found = apart, again, (*found, *new)
    return training, result, found


def _prepare_without(
    recordings: RecordingSet,
    training: Training,
    settings: Settings,
    base: ExtendedModel | None,
    say: Say,
    episodes: Sequence[Episode],
) -> Training:
    """The training runs prepared anew without some times, which say nothing of bands and noise."""
    runs = [mask_episodes(run, episodes) for run in training.recorded]
    swinging = training.runs[0].swing is not None
    return prepare_training(recordings, settings, base, say, runs, swinging=swinging)


def _find_contacts(result: SearchResult) -> tuple[Episode, ...]:
    return find_episodes(training_tracks(result.comparison, result.fit))


def _describe_exclusion(episodes: Sequence[Episode]) -> str:
    runs = ", ".join(dict.fromkeys(each.run for each in episodes))
    return f"leave out times in which something touched the arm ({runs})"


def _search_once(
    recordings: RecordingSet,
    training: Training,
    asked: Sequence[Effect],
    base: ExtendedModel | None,
    say: Say,
    about: Extension | None = None,
    comparison: Comparison | None = None,
) -> SearchResult:
    """What was found in training runs, from another answer on where one is given."""
    comparison = comparison or training.comparison()
    unstated = locate_unstated(
        asked, recordings, training.constants.joints, usual=training.free_bodies
    )
    if base is not None:
        # What the model has seen it was asked for when it was made.
        unstated = select_unseen(unstated, comparison.unseen, base.extension)
    return search(
        comparison,
        remove_bounds(widen_for_changes(asked) if comparison.after_model else asked, recordings),
        start=unstated,
        most=training.most,
        strict=training.free_bodies,
        reidentify=training.reidentified,
        about=about,
        report=say,
    )


def _rms_residual(result: SearchResult) -> float:
    """What is left over the noise, rms over the channels."""
    used = result.after[np.isfinite(result.after)]
    return float(np.sqrt(np.mean(used**2)))
