"""Plausibility check of recordings before a diagnosis: contradictions to their description."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.sanity.command_doubts import doubt_commands
from stiffopt.discovery.sanity.doubt import Doubt, DoubtfulRecordings, format_joints, limit_to_runs
from stiffopt.discovery.sanity.explanation_doubts import describe_explanation, doubt_degrees
from stiffopt.discovery.sanity.explanations import Explanation, Explanations
from stiffopt.discovery.sanity.interpretations import SAMPLED, Samples, sample_runs
from stiffopt.discovery.sanity.sensor_doubts import (
    doubt_contacts_at_rest,
    doubt_dead_channels,
    doubt_magnitudes,
    doubt_position_limits,
    doubt_repeated_torques,
    doubt_second_sensors,
)
from stiffopt.discovery.settings import MIN_MOVING_SPEED
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun
from stiffopt.recording.signals import is_set_point, may_be_set_point
from stiffopt.recording.state_pair import split_states

# Residual share of a torque from which single runs are checked, and how many.
_MIN_OPEN_SHARE, _MAX_SINGLE_RUNS = 0.04, 12
# Shortest run, or runs together, that a refusal may rest on [s]: friction, weight and inertia of a
# shorter one, filtered at both ends, look alike.
_MIN_JUDGED_DURATION = 2.0


# A run with the search for explanations of it alone.
SingleRun = tuple[RecordedRun, Explanations]


def judge_plausibility(
    recordings: RecordingSet,
    runs: Sequence[RecordedRun],
    *,
    despite_doubts: bool,
    remarks: bool = True,
) -> tuple[tuple[Doubt, ...], tuple[Doubt, ...]]:
    """Return doubts and, if there are none and they are asked for, remarks.

    Two states of a robot are judged one by one, since they need not fit each other: their
    difference is the question.

    Raises `DoubtfulRecordings`: a state with doubts, unless the diagnosis goes on despite them.
    """
    gates = [SanityGate(*state) for state in split_states(recordings, runs)]
    doubts: list[Doubt] = []
    for gate in gates:
        if gate.doubts and not despite_doubts:
            raise DoubtfulRecordings(gate.recordings.path, gate.doubts)
        doubts += gate.doubts
    if doubts or not remarks:
        return tuple(dict.fromkeys(doubts)), ()
    return (), tuple(dict.fromkeys(each for gate in gates for each in gate.remarks))


class SanityGate:
    """Doubts and remarks about a recording set, from its training runs.

    `runs`: training runs: no other run is read before the findings are fixed.

    Even an inaccurate nominal model identifies a unit or a column order. Another reading of the
    files (degrees, swapped joints and columns, signs, any gain, another gravity, a delay) raises a
    doubt only if it explains the torques many times better than the stated one with any possible
    friction, rotor inertia, spring and payload.
    """

    def __init__(self, recordings: RecordingSet, runs: Sequence[RecordedRun]) -> None:
        self.recordings, self._runs = recordings, runs

    @cached_property
    def doubts(self) -> tuple[Doubt, ...]:
        """Doubts that stop a diagnosis; empty for plausible recordings."""
        recordings, runs = self.recordings, self._runs
        if not any(body.mass > 0.0 for body in recordings.robot.tree.bodies):
            # Weight and inertia would hide all other effects.
            evidence = (
                "No link of the robot has a mass: its URDF has no <inertial>. Add masses, if only"
                " rough ones: all other effects are judged beside the weight."
            )
            return (Doubt(kind="masses", evidence=evidence),)
        if recordings.signals.commanded and (told := tuple(doubt_commands(recordings, self._runs))):
            return told
        if self._without_unscaled is not None:
            return self._without_unscaled.doubts
        found = [
            *_doubt_unscaled(recordings),
            *_doubt_set_points(recordings),
            *doubt_second_sensors(recordings, runs),
            *doubt_magnitudes(runs),
            *doubt_repeated_torques(runs),
        ]
        explanation, search = None, self._explanation_search
        if search is not None:
            expected = self._extended_range_runs
            odd = [each for each in self._odd_runs if each not in expected]
            odd = [
                each
                for each in odd
                if not (_is_effect_of_all_runs(search, each) or _is_effect_of_one_run(each))
            ]
            explanation = search.best()
            if odd and (explanation is None or not _explains_odd_runs(explanation, odd)):
                explanation = None
            else:
                odd = []
            if odd:
                found = [*_doubt_odd_runs(recordings, odd), *found]
            elif explanation is not None:
                found = [*describe_explanation(recordings, search, explanation), *found]
            elif (standing := search.stationary_in_degrees()) is not None:
                found = [doubt_degrees(recordings, search, standing), *found]
            elif dead := tuple(
                doubt_dead_channels(recordings, self._nominal_robot, search.samples)
            ):
                found = [*dead, *found]
            elif len(runs) > 1 and not found:
                found = [*_doubt_single_runs(recordings, self._single_runs, search)]
        if not any(doubt.kind == "position unit" for doubt in found):
            found += doubt_position_limits(recordings, runs)
        return tuple(found)

    @property
    def remarks(self) -> tuple[Doubt, ...]:
        """Remarks that do not stop a diagnosis, if there are no doubts."""
        if self._without_unscaled is not None:
            left = _remark_unscaled(self.recordings)
            return (left, *self._without_unscaled.remarks)
        told = tuple(_doubt_references(self.recordings))
        if self._explanation_search is None or self.recordings.signals.unscaled:
            return told
        contacts: Iterator[Doubt] = iter(())
        if np.nanmax(self._explanation_search.strict, initial=0.0) <= _MIN_OPEN_SHARE:
            # The nominal model holds in motion.
            contacts = doubt_contacts_at_rest(self._nominal_robot, self._runs)
        return (*told, *map(_doubt_extended_range, self._extended_range_runs), *contacts)

    @cached_property
    def _without_unscaled(self) -> SanityGate | None:
        """Gate of the other joints, where the weight tells no factor of those without one."""
        signals = self.recordings.signals
        if not signals.partly_unscaled:
            return None
        explanation = None if self._explanation_search is None else self._explanation_search.best()
        gains = None if explanation is None else explanation.gains
        if gains is not None and np.any(gains[list(signals.unscaled_joints)] != 1.0):
            return None
        return SanityGate(*leave_out_unscaled(self.recordings, self._runs))

    @cached_property
    def _nominal_robot(self) -> RobotModel:
        return RobotModel(self.recordings)

    @cached_property
    def _explanation_search(self) -> Explanations | None:
        if any(run.at_rest for run in self._runs):
            return None  # every alternative reading is judged by motion
        law = self.recordings.actuator
        if law is not None and law.estimated is not None:
            return None  # torques by gains that the nominal weight told show no other reading
        # One short run grounds no refusal; several short ones that agree do.
        if len(self._runs) == 1 and self._runs[0].duration < _MIN_JUDGED_DURATION:
            return None
        samples = sample_runs(self._runs)
        return None if samples is None else Explanations(self._nominal_robot, samples)

    @cached_property
    def _single_runs(self) -> list[SingleRun]:
        """Searches of each run alone that is long enough to be judged."""
        if self._explanation_search is None or len(self._runs) < 2:
            return []
        return search_single_runs(self._nominal_robot, self._runs)

    @cached_property
    def _odd_runs(self) -> list[OddRun]:
        return find_odd_runs(self._single_runs)

    @cached_property
    def _extended_range_runs(self) -> list[OddRun]:
        """Odd runs outside the range of the others: a stop or inertia may show only there."""
        return [
            each for each in self._odd_runs if each.outside_range and each.search.best() is None
        ]


def _doubt_unscaled(recordings: RecordingSet) -> Iterator[Doubt]:
    """Doubt torques that are all without a factor to N m."""
    if recordings.signals.unscaled and not recordings.signals.partly_unscaled:
        stated, one = _format_units(recordings)
        yield Doubt(
            kind="torque unit",
            evidence=f"The torques are stated in {stated}. Give N m per {one} at"
            " each joint (of a current: the motor's torque constant times the gear ratio) as torque"
            " in [signals.scale]; an estimate from the weight of the nominal model, if possible, is"
            " listed as well.",
        )


def _remark_unscaled(recordings: RecordingSet) -> Doubt:
    """Remark that torques whose factor neither the user nor the weight tells are left out."""
    joints = recordings.signals.unscaled_joints
    stated, one = _format_units(recordings)
    return Doubt(
        kind="torque unit",
        joints=tuple(j + 1 for j in joints),
        evidence=f"The torque of {format_joints(joints)} is stated in {stated}, and the"
        f" weight does not tell its N m per {one}: it is left out of a diagnosis. Give that"
        " factor (of a current: the motor's torque constant times the gear ratio) as torque in"
        " [signals.scale] to include it.",
    )


def _format_units(recordings: RecordingSet) -> tuple[str, str]:
    """Return the units of torques without a factor: "A and counts", "A or count"."""
    units = sorted(set(recordings.signals.torque_units) - {""})
    return " and ".join(units), " or ".join(unit.removesuffix("s") for unit in units)


def leave_out_unscaled(
    recordings: RecordingSet, runs: Sequence[RecordedRun]
) -> tuple[RecordingSet, list[RecordedRun]]:
    """Return a set and its runs without torques that have no factor, unless none has one."""
    if not recordings.signals.partly_unscaled:
        return recordings, list(runs)
    joints = list(recordings.signals.unscaled_joints)
    torque = tuple("" if j in joints else c for j, c in enumerate(recordings.signals.torque))
    signals = replace(recordings.signals, torque=torque, torque_units=())
    left = []
    for run in runs:
        values = run.torque.copy()
        values[:, joints] = np.nan
        left.append(replace(run, torque=values))
    return replace(recordings, signals=signals), left


def _doubt_set_points(recordings: RecordingSet) -> Iterator[Doubt]:
    """Doubt positions that are set points by their names."""
    told = [name for name in recordings.signals.position if name and is_set_point(name)]
    if told:
        yield Doubt(
            kind="set points",
            evidence=f"The positions are set points by their names ({', '.join(told[:3])}"
            f"{', ...' if len(told) > 3 else ''}): they differ from the motion by the controller's"
            " errors, which would be taken for physics. Record measured positions.",
            line="position = [...] in [signals] with the columns that were measured",
        )


def _doubt_references(recordings: RecordingSet) -> Iterator[Doubt]:
    """Remark positions whose names may be those of set points."""
    names = [name for name in recordings.signals.position if name]
    told = [name for name in names if may_be_set_point(name) and not is_set_point(name)]
    if told:
        yield Doubt(
            kind="set points",
            evidence=f"The names of the positions mention a reference ({', '.join(told[:3])}"
            f"{', ...' if len(told) > 3 else ''}): are they measured, or set points?",
        )


def _doubt_extended_range(odd: OddRun) -> Doubt:
    which = format_joints(odd.joints)
    return Doubt(
        kind="another arm",
        joints=tuple(j + 1 for j in odd.joints),
        evidence=f"{odd.run.name} moves faster or further than the other runs, or with larger"
        f" torques, and does not fit the model there, in the torque of {which}. If it is the same"
        f" arm with the same load, the"
        " model lacks an effect that shows only there.",
    )


def _doubt_odd_runs(recordings: RecordingSet, odd: Sequence[OddRun]) -> Iterator[Doubt]:
    """Doubt odd runs: another reading if one explains the run, else another arm or load."""
    for each in odd:
        explanation = each.search.best()
        if explanation is not None:
            yield from _doubt_one_run(recordings, each.run.name, each.search, explanation)
            continue
        shares = ", ".join(
            f"{100.0 * each.left[j]:.3g} % at joint {j + 1} (at most {100.0 * each.others[j]:.2g} %"
            " in the others)"
            for j in each.joints
        )
        yield Doubt(
            kind="another arm",
            joints=tuple(j + 1 for j in each.joints),
            evidence=f"{each.run.name} does not fit the other runs: it may be of another arm, or of"
            f" this one with a load or a contact. The residual of the nominal model, with separate"
            f" friction, is {shares} of the torque's variance. Remove its [[runs]] section, or make"
            " a separate set for that load.",
        )


def _doubt_one_run(
    recordings: RecordingSet, name: str, search: Explanations, explanation: Explanation
) -> Iterator[Doubt]:
    for doubt in describe_explanation(recordings, search, explanation):
        yield replace(doubt, evidence=limit_to_runs([name], doubt.evidence), line="")


def _doubt_single_runs(
    recordings: RecordingSet, searches: Sequence[SingleRun], together: Explanations
) -> Iterator[Doubt]:
    """Doubt single runs that contradict the description, if the others fit it."""
    with np.errstate(invalid="ignore"):
        fails = together.strict > _MIN_OPEN_SHARE
    if not fails.any():
        return
    for run, search in searches[:_MAX_SINGLE_RUNS]:
        explanation = search.best()
        if explanation is not None:
            others = (each.strict for _, each in searches if each is not search)
            # A model that fails in other runs too says nothing of this one.
            if not any((own[list(explanation.joints)] > _MIN_OPEN_SHARE).any() for own in others):
                yield from _doubt_one_run(recordings, run.name, search, explanation)


# Least residual share of a torque in an odd run, and least ratio to that in any other run, whose
# residual share is raised to the last value.
_MIN_ODD_SHARE, _MIN_ODD_RATIO, _OTHERS_FLOOR = 0.05, 8.0, 0.005
# Largest residual share of other runs to compare with: beyond it the model is wrong in all runs.
_MAX_OTHERS_SHARE = 0.3
# Runs that are compared.
_MAX_COMPARED_RUNS = 60
# Margin of the range of the other runs, as share; and least instants within it.
_RANGE_MARGIN, _MIN_SHARED_INSTANTS = 0.05, 30


@dataclass(frozen=True, eq=False)
class OddRun:
    """A run that does not fit the others, with residual shares."""

    run: RecordedRun
    search: Explanations  # of this run alone
    joints: tuple[int, ...]
    # left, others (n,): residual shares in this run, and the largest in any other.
    left: np.ndarray
    others: np.ndarray
    # True if it fits within the range of the others, or was hardly there: an effect may show only
    # at its larger speeds or strokes.
    outside_range: bool


def search_single_runs(robot: RobotModel, runs: Sequence[RecordedRun]) -> list[SingleRun]:
    """Return the searches for explanations of single runs, of those long enough to be judged."""
    return [
        (run, Explanations(robot, samples))
        for run in runs[:_MAX_COMPARED_RUNS]
        if run.duration >= _MIN_JUDGED_DURATION and (samples := sample_runs([run])) is not None
    ]


def find_odd_runs(searches: Sequence[SingleRun]) -> list[OddRun]:
    """Find runs in which the nominal model fails while it holds in all others.

    Each run has separate friction, so that a cold arm is not odd. Of two runs the one that fits the
    nominal model is trusted. A run whose residual is no larger than that of another fits as well,
    however little its torque varies: a joint that moves in one direction alone leaves noise.
    """
    if len(searches) < 2:
        return []
    shares = np.array([search.with_free_guesses for _, search in searches])
    squares = shares * np.array([_moving_variances(search) for _, search in searches])
    found = []
    for k, (run, search) in enumerate(searches):
        rest = np.delete(shares, k, axis=0)
        known = np.isfinite(rest).any(axis=0)
        others = np.where(known, np.nanmax(np.where(np.isfinite(rest), rest, -1.0), axis=0), np.nan)
        larger = squares[k] > np.nan_to_num(np.delete(squares, k, axis=0)).max(axis=0)
        odd = _is_odd(shares[k], others) & larger
        if odd.any():
            joints = tuple(int(j) for j in np.flatnonzero(odd))
            beside = [other.samples for _, other in searches if other is not search]
            shared = [_select_shared_range(search.samples, beside, joint=j) for j in joints]
            outside_range = not any(
                there is not None
                and _is_odd(Explanations(search.robot, there).with_free_guesses, others)[j]
                for j, there in zip(joints, shared, strict=True)
            )
            found.append(OddRun(run, search, joints, shares[k], others, outside_range))
    return found


def _moving_variances(search: Explanations) -> np.ndarray:
    """Return the variance (n,) of each torque while its joint moves, 0 where it does not."""
    moving = np.abs(search.motion.velocity) >= MIN_MOVING_SPEED
    known = moving & np.isfinite(search.samples.torque)
    pairs = zip(search.samples.torque.T, known.T, strict=True)
    return np.array([own[rows].var() if rows.any() else 0.0 for own, rows in pairs])


def _is_effect_of_all_runs(together: Explanations, odd: OddRun) -> bool:
    """True if one spring or payload for all runs explains the joints that are odd in one.

    It leaves a larger share of the torque where a run is slow, or far from the spring's rest.
    """
    return all(
        together.share_with_additions(together.motion, j) * _MIN_ODD_RATIO < together.strict[j]
        for j in odd.joints
    )


def _is_effect_of_one_run(odd: OddRun) -> bool:
    """True if a diagnosis names it: another payload, a delay, or what acts in a third of the run.

    Another arm, or another load, does not fit in the rest either.
    """
    return any(
        not _is_odd(left, odd.others).any()
        for left in (*odd.search.left_beside_effects, *_shares_without_thirds(odd.search))
    )


def _shares_without_thirds(search: Explanations) -> Iterator[np.ndarray]:
    """Yield the residual shares (n,) without each third; of the run where the rest tells none."""
    count = len(search.samples.position)
    sixth = 6 * np.arange(count) // count
    for first in range(5):  # thirds begin at sixths
        rest = search.samples.select((sixth < first) | (sixth > first + 1))
        own = Explanations(search.robot, rest).with_free_guesses
        yield np.where(np.isnan(own), search.with_free_guesses, own)


def _explains_odd_runs(explanation: Explanation, odd: Sequence[OddRun]) -> bool:
    """True if an explanation of all runs together explains the joints that are odd in some."""
    joints = sorted({joint for each in odd for joint in each.joints})
    return bool(np.all(explanation.left[joints] < _MIN_ODD_SHARE))


def _is_odd(shares: np.ndarray, others: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        far = (shares > _MIN_ODD_SHARE) & (
            shares > _MIN_ODD_RATIO * np.maximum(others, _OTHERS_FLOOR)
        )
        return np.asarray(far & (others < _MAX_OTHERS_SHARE))


def _select_shared_range(
    samples: Samples, others: Sequence[Samples], *, joint: int
) -> Samples | None:
    """Select instants within the range of other runs: motion, torque of a joint; None if too few.

    The torque counts since a limit of the drive shows at the largest demand.
    """
    inside = np.ones(len(samples.position), dtype=bool)
    for name in SAMPLED:
        columns = [joint] if name == "torque" else slice(None)
        beside = np.vstack([getattr(each, name)[:, columns] for each in others])
        low = np.where(np.isnan(beside), np.inf, beside).min(axis=0)
        high = np.where(np.isnan(beside), -np.inf, beside).max(axis=0)
        margin = _RANGE_MARGIN * (high - low)
        own = getattr(samples, name)[:, columns]
        outside = (own < low - margin) | (own > high + margin)
        inside &= ~(outside & np.isfinite(beside).any(axis=0)).any(axis=1)
    return None if inside.sum() < _MIN_SHARED_INSTANTS else samples.select(inside)
