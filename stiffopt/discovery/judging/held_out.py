"""Runs left out, opened once the findings are fixed: predicted, shared out, measured by a box."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.discovery.comparison.located_effect import Extension
from stiffopt.discovery.judging.black_box import BlackBox, MeasuringRod
from stiffopt.discovery.judging.episodes import (
    Episode,
    Track,
    episodes_in,
    held_out_track,
    without,
)
from stiffopt.discovery.judging.shares import Part, Shares
from stiffopt.discovery.judging.staying import stays
from stiffopt.discovery.proof.predict import Predictor
from stiffopt.discovery.proof.proof import RunProof, nrmse, prove
from stiffopt.discovery.settings import Settings
from stiffopt.discovery.training import Training
from stiffopt.recording.decimation import decimate_run
from stiffopt.recording.recording_set import RecordingSet

Say = Callable[[str], object]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Opened:
    """All that is known of one run, taken in at once."""

    file: str
    proof: RunProof
    velocity: np.ndarray
    episodes: tuple[Episode, ...]


class HeldOut:
    """What runs left out say of an extended model; as far as they were opened.

    Parameters
    ----------
    training : Training
    settings : Settings
    start : tuple of Extension
        Of the model that the diagnosis started from.
    found : Extension
    parts : sequence of Part
        Of what was found, to be shared out.
    every : int
        Samples that means are taken over, as of the training runs.
    known : sequence of Track
        What is left of the training runs.

    Attributes
    ----------
    proofs : list of RunProof
        Without the episodes.
    episodes : list of Episode
        In which something touched the arm.
    velocities : list of array (K, n)
        Of the joints in these runs.
    shares : Shares
    left, unusable : list of str
        Files of runs that were not predicted: not opened yet, and without a joint's position.
    """

    def __init__(
        self,
        training: Training,
        settings: Settings,
        start: tuple[Extension, ...],
        found: Extension,
        parts: Sequence[Part],
        every: int = 1,
        known: Sequence[Track] = (),
    ) -> None:
        self._training, self._settings = training, settings
        self._start, self._found, self._every = start, found, every
        self._box: BlackBox | None = None
        self._known = tuple(known)
        self._files: list[str] = []
        self._opened: list[_Opened] = []
        self.shares = Shares(parts)
        self.unusable: list[str] = []

    @property
    def proofs(self) -> list[RunProof]:
        """One for every run."""
        return [each.proof for each in self._opened]

    @property
    def velocities(self) -> list[np.ndarray]:
        """One for every run."""
        return [each.velocity for each in self._opened]

    @property
    def episodes(self) -> list[Episode]:
        """Of all runs."""
        return [episode for each in self._opened for episode in each.episodes]

    @property
    def left(self) -> list[str]:
        """Files that were not opened yet."""
        done = {*(each.file for each in self._opened), *self.unusable}
        return [file for file in self._files if file not in done]

    @property
    def measurable(self) -> bool:
        """Whether a black box is asked what could be explained: where anything may be missing."""
        return self._training.free_bodies and not self._training.robot.vibrates

    def fit_rod(self, say: Say) -> None:
        """Fit that black box to the training runs."""
        say("fit a black box to what is left, as a measuring rod")
        extensions = (*self._start, self._found)
        self._box = BlackBox(self._training, self._settings, extensions, say)

    def predict_all(self, recordings: RecordingSet, say: Say, *, hurried: bool = False) -> None:
        """Open one run after another; what an interruption leaves is whole.

        Where the user is in a hurry it is said that Ctrl-C leaves out this too: it is short beside
        a search, and without it nothing is proved.
        """
        training, settings = self._training, self._settings
        extensions = (*self._start, self._found)
        entries = recordings.with_role("test", "extrapolate")
        self._files = [entry.file for entry in entries]
        if hurried:
            say("stopped: runs left out are predicted still; Ctrl-C again leaves that out")
        vibrating = _predicted_swinging(training, settings, extensions)
        for entry in entries:
            say(f"predict {entry.file}")
            run = decimate_run(recordings.open(entry), self._every)
            if not run.usable:
                self.unusable.append(entry.file)
                continue
            predictor = Predictor(
                training.robot, run, training.constants, settings, vibrating=vibrating
            )
            before, after = predictor.predict_each([self._start, extensions])
            track = held_out_track(run, predictor, after, training.noise.channels)
            touched = episodes_in([track], self._known)
            proof = prove(run, predictor.velocity, before, after, training.noise)
            if touched:
                touched = stays(touched, track, training.robot, predictor.nominal)
                whole = proof.nrmse_after
                # What a hand did tells nothing of the model; a load that stays does.
                apart = without(run, touched)
                less = prove(apart, predictor.velocity, before, after, training.noise).nrmse_after
                predictor.run = run = without(run, [e for e in touched if not e.stays])
                proof = prove(run, predictor.velocity, before, after, training.noise)
                touched = tuple(replace(e, nrmse_with=whole, nrmse_without=less) for e in touched)
            self._opened.append(
                _Opened(file=entry.file, proof=proof, velocity=predictor.velocity, episodes=touched)
            )
            say(f"share out what changes in {entry.file}")
            self.shares.add(predictor, self._start, self._found, proof)
            if self._box is not None:
                self._box.add(predictor, before, after)

    def cut_short(self) -> str:
        """What an interruption left without a prediction."""
        if not self.left:
            return "Stopped by the user: the last held-out run was not shared out."
        return (
            "Stopped by the user: not all held-out runs were predicted; without a prediction:"
            f" {', '.join(self.left)}."
        )

    def not_predictable(self) -> list[str]:
        """A sentence about runs that could not be predicted, if there are any."""
        if not self.unusable:
            return []
        return [f"Not predicted, since a joint has no position: {', '.join(self.unusable)}."]

    def rod(self) -> MeasuringRod | None:
        """What is explained of what can be; None where nobody asked a box."""
        return None if self._box is None else self._box.found()


def _predicted_swinging(
    training: Training, settings: Settings, extensions: tuple[Extension, ...]
) -> bool:
    """Whether links swing in predictions: as the training runs are predicted better.

    Where nothing was found they do: nominal values alone move no joint beyond its law.
    """
    if not training.robot.vibrates:
        return False
    if not any(extension.effects for extension in extensions):
        return training.runs[0].vibration is not None
    left = {}
    for vibrating in (True, False):
        proofs = []
        for run, prepared in zip(training.recorded, training.runs, strict=True):
            # Where links swing it is the motion that was fitted.
            predictor = Predictor(
                training.robot,
                run,
                training.constants,
                settings,
                prepared if vibrating else None,
                vibrating=vibrating,
            )
            after = predictor.predict(*extensions)
            proofs.append(prove(run, predictor.velocity, after, after, training.noise))
        left[vibrating] = nrmse(proofs, "after")
    return left[True] <= left[False]
