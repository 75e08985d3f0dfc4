"""Search the training runs for effects: quasi-static retry, exclusion of contact intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from stiffopt.discovery.comparison.comparison import Comparison
from stiffopt.discovery.comparison.located_effect import Extension
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
    episodes_of_force,
    find_episodes,
    mask_episodes,
    mask_load_changes,
    training_tracks,
)
from stiffopt.discovery.judging.temporary_loads import find_temporary_load
from stiffopt.discovery.progress import Say
from stiffopt.discovery.search.search import SearchResult, search
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.thresholds import (
    MAX_CONTACT_ROUNDS,
    MAX_EFFECTS_PER_ROUND,
    MAX_VIBRATION_MISFIT,
)
from stiffopt.discovery.training import Training, prepare_training
from stiffopt.interrupts import complete_step
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun
from stiffopt.recording.state_pair import StatePair


@dataclass(frozen=True, kw_only=True, eq=False)
class TrainingSearch:
    """Search of training runs for missing effects, with retries."""

    recordings: RecordingSet
    asked: Sequence[Effect]  # effects that the recordings can identify
    settings: Settings  # before bands were chosen by the training runs
    base: ExtendedModel | None  # model that the diagnosis starts from
    say: Say

    def run(self, training: Training) -> tuple[Training, SearchResult, tuple[Episode, ...]]:
        """Search, and return the runs searched, the result, and contact intervals left out."""
        training, pushed = self._with_temporary_loads(training)
        comparison = training.comparison()
        # Contacts that show already beside the nominal model are excluded from the first search.
        # Torque that a drive at its limit is asked for in vain looks like one.
        touched: tuple[Episode, ...] = ()
        if not self.recordings.signals.commanded:
            touched = find_episodes(training_tracks(comparison, comparison.fit()))
        if touched:
            self.say(_describe_exclusion(touched))
            training = self._prepare_without(training, touched)
            comparison = training.comparison()
        result = self._search_once(training, comparison=comparison)
        if training.runs[0].vibration is not None and not (result.stopped or result.hurried):
            training, result = self._retry_quasi_static(training, result)
        training, result, later = self._exclude_contacts(training, result)
        return training, result, (*pushed, *touched, *later)

    def _with_temporary_loads(self, training: Training) -> tuple[Training, tuple[Episode, ...]]:
        """Return the training runs without intervals in which something pushes, and these.

        Runs know when the arm carries a part, which stays a part of the comparison.
        """
        pushed: tuple[Episode, ...] = ()
        commanded = self.recordings.signals.commanded
        if commanded or training.runs[0].at_rest or isinstance(self.recordings, StatePair):
            return training, pushed
        for _ in range(1 + MAX_CONTACT_ROUNDS):
            load = find_temporary_load(training.robot, training.runs)
            if load is None:
                break
            if load.is_part:
                pairs = list(zip(training.recorded, load.intervals, strict=True))
                runs = ", ".join(run.name for run, own in pairs if own)
                self.say(f"a part is carried for a while ({runs})")
                carrying = [mask_load_changes(replace(run, carried=own)) for run, own in pairs]
                return self._prepare(training, carrying), pushed
            new = episodes_of_force(load, training.recorded)
            if not new:
                break
            self.say(_describe_exclusion(new))
            training, pushed = self._prepare_without(training, new), (*pushed, *new)
        return training, pushed

    def _retry_quasi_static(
        self, training: Training, result: SearchResult
    ) -> tuple[Training, SearchResult]:
        """Search quasi-statically where the predicted vibration is far off; return the better.

        The linearisation about the nominal vibration does not reach a distant mode. A quasi-static
        comparison does; its findings give the motion to linearise about next.
        """
        if _rms_residual(result) <= MAX_VIBRATION_MISFIT:
            return training, result
        self.say("the vibration differs from the model's: compare without vibration")
        answers = [(training, result)]
        result.comparison.columns.release_effects()
        try:
            balanced = prepare_training(
                self.recordings,
                training.settings,
                self.base,
                self.say,
                training.recorded,
                vibrating=False,
            )
            still = self._search_once(balanced)
            answers.append((balanced, still))
            still.comparison.columns.release_effects()
            if still.effects and not (still.stopped or still.hurried):
                self.say("search with vibration from the findings without it")
                about = still.comparison.extension_of(still.fit)
                answers.append((training, self._search_once(training, about)))
            stopped = any(found.stopped for _, found in answers)
        except KeyboardInterrupt:
            stopped = True
        # A stopped search competes as well: it may be the best.
        own, best = min(answers, key=lambda answer: _rms_residual(answer[1]))
        hurried = any(found.hurried for _, found in answers)
        return own, replace(best, stopped=stopped, hurried=hurried)

    def _exclude_contacts(
        self, training: Training, result: SearchResult
    ) -> tuple[Training, SearchResult, tuple[Episode, ...]]:
        """Search again without contact intervals; return the result and these intervals."""
        found: tuple[Episode, ...] = ()
        for _ in range(MAX_CONTACT_ROUNDS):
            if result.stopped or result.hurried:
                break
            new, hurried = complete_step(partial(_find_contacts, result))
            if hurried:
                result = replace(result, hurried=True)
            if hurried or not new:
                break
            self.say(f"{_describe_exclusion(new)}, and search again")
            try:
                apart = self._prepare_without(training, new)
                again = self._search_once(apart)
                stopped = again.stopped
            except KeyboardInterrupt:
                stopped = True
            if stopped:
                # The earlier result is complete, that of the stopped search is not.
                result = replace(result, stopped=True)
                break
            training, result, found = apart, again, (*found, *new)
        return training, result, found

    def _prepare_without(self, training: Training, episodes: Sequence[Episode]) -> Training:
        """Prepare the training runs without contact intervals, which distort bands and noise."""
        return self._prepare(training, [mask_episodes(run, episodes) for run in training.recorded])

    def _prepare(self, training: Training, runs: Sequence[RecordedRun]) -> Training:
        """Prepare changed training runs as those before."""
        vibrating = training.runs[0].vibration is not None
        return prepare_training(
            self.recordings, self.settings, self.base, self.say, runs, vibrating=vibrating
        )

    def _search_once(
        self,
        training: Training,
        about: Extension | None = None,
        comparison: Comparison | None = None,
    ) -> SearchResult:
        """Search once; from the extension `about` on where one is given."""
        comparison = comparison or training.comparison()
        asked, recordings = self.asked, self.recordings
        unstated = locate_unstated(
            asked, recordings, training.constants.joints, usual=training.free_bodies
        )
        if self.base is not None:
            # Values in channels known to the model were fitted when it was made.
            unstated = select_unseen(unstated, comparison.unseen, self.base.extension)
        return search(
            comparison,
            remove_bounds(
                widen_for_changes(asked) if comparison.after_model else asked, recordings
            ),
            start=unstated,
            most=training.most,
            together=MAX_EFFECTS_PER_ROUND if training.free_bodies else 1,
            reidentify=training.reidentified,
            about=about,
            report=self.say,
        )


def _find_contacts(result: SearchResult) -> tuple[Episode, ...]:
    return find_episodes(training_tracks(result.comparison, result.fit))


def _describe_exclusion(episodes: Sequence[Episode]) -> str:
    runs = ", ".join(dict.fromkeys(each.run for each in episodes))
    return f"exclude contact intervals ({runs})"


def _rms_residual(result: SearchResult) -> float:
    """Return the normalised residual, root mean square over the channels."""
    used = result.after[np.isfinite(result.after)]
    return float(np.sqrt(np.mean(used**2)))
