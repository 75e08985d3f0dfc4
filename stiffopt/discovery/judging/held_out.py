"""Prediction of held-out runs once the findings are fixed: proof, explained shares, contacts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stiffopt.discovery.comparison.located_effect import Extension
from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.comparison.prepared_run import PreparedRun
from stiffopt.discovery.judging.beyond_training import ChannelExcess, find_excess
from stiffopt.discovery.judging.episodes import (
    Episode,
    ResidualTrack,
    find_episodes,
    held_out_track,
    mask_episodes,
    mask_load_changes,
)
from stiffopt.discovery.judging.explained_shares import ExtensionPart, MismatchShares
from stiffopt.discovery.judging.noise_ceiling import BlackBox, NoiseCeiling
from stiffopt.discovery.judging.refutation import Refutation
from stiffopt.discovery.judging.temporary_loads import find_known_part
from stiffopt.discovery.prediction import (
    Predictor,
    RunProof,
    compare_predictions,
    nrmse,
    residuals,
)
from stiffopt.discovery.progress import Say
from stiffopt.discovery.training import Training
from stiffopt.recording.decimation import decimate_run
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun


@dataclass(frozen=True, kw_only=True, eq=False)
class _PredictedRun:
    """Results of one run, added together."""

    file: str
    proof: RunProof
    episodes: tuple[Episode, ...]


class HeldOutRuns:
    """Proof of an extended model on held-out runs, as far as these were read.

    `parts`: parts of the findings whose explained shares are calculated. `refutation`: of the
    findings one by one. `every`: number of averaged samples, as of the training runs. `known`:
    residual tracks of the training runs.

    `proofs`: without the contact intervals. `episodes`: contact intervals. `left`, `unusable`:
    files of runs that were not predicted: not yet read, and without a joint's position. `excess`:
    residuals beyond those of all training runs.
    """

    def __init__(
        self,
        training: Training,
        found: Extension,
        parts: Sequence[ExtensionPart],
        refutation: Refutation,
        every: int = 1,
        known: Sequence[ResidualTrack] = (),
    ) -> None:
        self._training, self._found, self._every = training, found, every
        self._box: BlackBox | None = None
        self._known = tuple(known)
        self._files: list[str] = []
        self._opened: list[_PredictedRun] = []
        self.shares = MismatchShares(parts)
        self.refutation = refutation
        self.excess: list[ChannelExcess] = []
        self.unusable: list[str] = []

    @property
    def proofs(self) -> list[RunProof]:
        """Proofs, one per run."""
        return [each.proof for each in self._opened]

    @property
    def episodes(self) -> list[Episode]:
        """Contact intervals of all runs."""
        return [episode for each in self._opened for episode in each.episodes]

    @property
    def left(self) -> list[str]:
        """Files that were not yet read."""
        done = {*(each.file for each in self._opened), *self.unusable}
        return [file for file in self._files if file not in done]

    def fit_noise_ceiling(self, say: Say) -> None:
        """Fit the black box of the noise ceiling to the training runs."""
        say("fit the noise ceiling to the residual")
        self._box = BlackBox(self._training, self._found, say)

    def predict_all(self, recordings: RecordingSet, say: Say, *, hurried: bool = False) -> None:
        """Read and predict one run after another; results stay consistent after Ctrl-C.

        After an earlier Ctrl-C this step is still done, as the proof: it is short beside a search.
        """
        training = self._training
        entries = recordings.with_role("test", "extrapolate")
        self._files = [entry.file for entry in entries]
        if hurried:
            say("stopped: held-out runs are still predicted; Ctrl-C again skips that")
        vibrating = _choose_vibrating_links(training, self._found)
        for entry in entries:
            say(f"predict {entry.file}")
            run = decimate_run(recordings.open(entry), self._every)
            if not run.usable:
                self.unusable.append(entry.file)
                continue
            run = _with_carried_part(training, self._found, run, vibrating=vibrating)
            predictor = Predictor(training, run, vibrating=vibrating)
            before, after = predictor.predict_each(
                [training.before, (*training.before, self._found)]
            )
            compared = (predictor.velocity, before, after, training.noise)
            track = held_out_track(run, predictor, after, training.noise.channels)
            touched = () if run.at_rest else find_episodes([track], self._known)
            proof = compare_predictions(run, *compared)
            if touched:
                touched = tuple(
                    replace(each, stays=_is_load(each, track, training.robot, predictor.nominal))
                    for each in touched
                )
                whole = proof.nrmse_after
                # Passing contacts are excluded from the proof; a lasting load is not.
                less = compare_predictions(mask_episodes(run, touched), *compared).nrmse_after
                predictor.run = run = mask_episodes(run, [e for e in touched if not e.stays])
                proof = compare_predictions(run, *compared)
                touched = tuple(replace(e, nrmse_with=whole, nrmse_without=less) for e in touched)
            passing = [each for each in touched if not each.stays]
            if found := find_excess(track, self._known, passing):
                self.excess.append(found)
            self._opened.append(_PredictedRun(file=entry.file, proof=proof, episodes=touched))
            say(f"calculate explained shares of {entry.file}")
            self.shares.add(predictor, training.before, self._found, proof)
            self.refutation.add(predictor, training.before)
            if self._box is not None:
                self._box.add(predictor, before, after)

    def describe_interruption(self) -> str:
        """Return a sentence about runs without prediction after Ctrl-C."""
        if not self.left:
            return "Stopped by the user: explained shares lack the last held-out run."
        return (
            "Stopped by the user: not all held-out runs were predicted; without a prediction:"
            f" {', '.join(self.left)}."
        )

    def describe_unusable(self) -> list[str]:
        """Return a sentence about runs that cannot be predicted, if any."""
        if not self.unusable:
            return []
        return [f"Not predicted, since a joint has no position: {', '.join(self.unusable)}."]

    def noise_ceiling(self) -> NoiseCeiling | None:
        """Return the noise ceiling; None if none was fitted."""
        return None if self._box is None else self._box.found()


def _with_carried_part(
    training: Training, found: Extension, run: RecordedRun, *, vibrating: bool
) -> RecordedRun:
    """Return a run with the intervals in which it carries the part that training runs carry.

    The motion does not tell when a gripper closes: the recorded torque does, by the found part.
    """
    if not any(own.carried for own in training.recorded):
        return run
    always = replace(run, carried=((float(run.time[0]), float(run.time[-1])),))
    predictors = [Predictor(training, own, vibrating=vibrating) for own in (run, always)]
    without, beside = (own.predict(*training.before, found) for own in predictors)
    used = np.zeros((len(run.time), run.n), dtype=bool)
    left = np.zeros((2, len(run.time), run.n))
    for kind, joint, compared, both in residuals(run, predictors[0].velocity, without, beside):
        if kind == "torque":
            used[:, joint] = compared
            left[:, compared, joint] = both
    return mask_load_changes(replace(run, carried=find_known_part(run.time, used, *left)))


def _choose_vibrating_links(training: Training, found: Extension) -> bool:
    """Choose predictions with or without vibration by the better prediction of training runs.

    Without findings the choice of the fit is kept.
    """
    if not training.robot.vibrates:
        return False
    extensions = (*training.before, found)
    if not any(extension.effects for extension in extensions):
        return training.runs[0].vibration is not None
    left = {}
    for vibrating in (True, False):
        proofs = []
        for run, prepared in zip(training.recorded, training.runs, strict=True):
            # With vibration the motion is that of the fit.
            own = prepared if vibrating else None
            predictor = Predictor(training, run, own, vibrating=vibrating)
            after = predictor.predict(*extensions)
            proofs.append(
                compare_predictions(run, predictor.velocity, after, after, training.noise)
            )
        left[vibrating] = nrmse(proofs, "after")
    return left[True] <= left[False]


# Tolerance of the end of a run [s], and least duration of a load change [s].
_RUN_END_MARGIN, _MIN_LOAD_DURATION = 0.5, 0.8
# Least share of the torque residual that a load at the last body explains, and largest ratio of its
# squares to those beside constant offsets.
_MIN_LOAD_SHARE, _MAX_OFFSET_RATIO = 0.7, 0.5
# Mass and first moments among the inertial parameters of a body.
_LOAD_PARAMETERS = 4


def _is_load(
    episode: Episode, track: ResidualTrack, robot: RobotModel, prepared: PreparedRun
) -> bool:
    """Return True for an interval that lasts until the end of a run and acts like a load.

    `track`: residuals of the run. `prepared`: the run with its motion.
    """
    if (
        track.time[-1] - episode.end > _RUN_END_MARGIN
        or episode.end - episode.begin < _MIN_LOAD_DURATION
    ):
        return False
    time = track.time[(track.time >= episode.begin) & (track.time <= episode.end)]
    # About 200 samples resolve the motion of a load.
    time = time[:: max(1, len(time) // 200)]
    rows = np.searchsorted(track.time, time)
    places = np.clip(np.searchsorted(prepared.time, time), 0, len(prepared.time) - 1)
    signals = prepared.signals
    load = robot.body_torques(
        int(np.argmax(robot.order)),
        signals.motor_position[places],
        signals.motor_velocity[places],
        signals.motor_acceleration[places],
    )[:, :, :_LOAD_PARAMETERS]
    left = track.left[rows, : robot.n]
    known = np.isfinite(left)
    if known.sum() < 10 * _LOAD_PARAMETERS:
        return False
    # In N m, so that a joint with little noise does not dominate.
    torque = (left * track.unit[: robot.n])[known]
    offsets = np.broadcast_to(np.eye(robot.n), (len(rows), robot.n, robot.n))[known]
    share = []
    for columns in (load[known], offsets):
        rest = torque - columns @ np.linalg.lstsq(columns, torque)[0]
        share.append(float(rest @ rest) / float(torque @ torque))
    return share[0] < 1.0 - _MIN_LOAD_SHARE and share[0] < _MAX_OFFSET_RATIO * share[1]
