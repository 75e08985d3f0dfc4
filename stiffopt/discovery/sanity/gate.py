"""The sanity gate: what is doubted of recordings before anything is diagnosed from them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.sanity.doubt import (
    Doubt,
    format_joints,
    limit_to_runs,
    scale_line,
)
from stiffopt.discovery.sanity.explanation_doubts import describe_explanation, doubt_degrees
from stiffopt.discovery.sanity.explanations import Explanation, Explanations
from stiffopt.discovery.sanity.interpretations import Samples, sample_runs
from stiffopt.discovery.sanity.joint_gains import JointGain, find_joint_gains
from stiffopt.discovery.sanity.sensor_doubts import doubt_position_limits, doubt_second_sensors
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun
from stiffopt.recording.set_points import is_set_point, may_be_set_point

# Share of a torque's variance that is open where single runs are looked at, and how many.
_MIN_OPEN_SHARE, _MAX_SINGLE_RUNS = 0.04, 12


class SanityGate:
    """What is doubted of a set by some of its runs, and what is remarked beside.

    Parameters
    ----------
    recordings : RecordingSet
    runs : sequence of RecordedRun
        Training runs: no other run is looked at before findings are fixed.

    Notes
    -----
    The nominal model, wrong as it may be, tells a unit or an order: other readings of the same
    files (degrees, swapped joints and columns, turned signs, any gain, another gravity, a delay)
    are doubted for only where they explain the torques many times better than the file's own
    reading with any friction, rotor inertia, spring and payload that a robot may have besides.
    """

    def __init__(self, recordings: RecordingSet, runs: Sequence[RecordedRun]) -> None:
        self._recordings, self._runs = recordings, runs

    @cached_property
    def doubts(self) -> tuple[Doubt, ...]:
        """What stops a diagnosis; nothing where the set can be what it says."""
        recordings, runs = self._recordings, self._runs
        if not any(body.mass > 0.0 for body in recordings.robot.tree.bodies):
            return (_doubt_masses(recordings),)
        found = [
            *_doubt_currents(recordings),
            *_doubt_set_points(recordings),
            *doubt_second_sensors(recordings, runs),
        ]
        explanation, search = None, self._explanation_search
        if search is not None:
            odd = [each for each in self._odd_runs if each not in self._extended_range_runs]
            explanation = None if odd else search.best()
            if odd:
                found = [*_doubt_odd_runs(recordings, odd), *found]
            elif explanation is not None:
                found = [*describe_explanation(recordings, search, explanation), *found]
            elif (standing := search.stationary_in_degrees()) is not None:
                found = [doubt_degrees(recordings, search, standing), *found]
            elif len(runs) > 1 and not found:
                found = [*_doubt_single_runs(recordings, runs, search)]
        if not any(doubt.kind == "position unit" for doubt in found):
            found += doubt_position_limits(recordings, runs)
        return tuple(found)

    @property
    def remarks(self) -> tuple[Doubt, ...]:
        """What stops nothing and yet is to be looked at; read where nothing is doubted.

        A drive's constant may be off by that much, which is an effect of the catalogue; and so may
        be the description.
        """
        told = tuple(_doubt_references(self._recordings))
        if self._explanation_search is None or self._recordings.signals.currents:
            return told
        gains = find_joint_gains(self._nominal_robot, self._explanation_search.samples)
        return (
            *told,
            *map(_doubt_extended_range, self._extended_range_runs),
            *(_doubt_joint_gain(self._recordings, each) for each in gains),
        )

    @cached_property
    def _nominal_robot(self) -> RobotModel:
        return RobotModel(self._recordings)

    @cached_property
    def _explanation_search(self) -> Explanations | None:
        samples = sample_runs(self._runs)
        return None if samples is None else Explanations(self._nominal_robot, samples)

    @cached_property
    def _odd_runs(self) -> list[OddRun]:
        if self._explanation_search is None or len(self._runs) < 2:
            return []
        return find_odd_runs(self._explanation_search, self._runs)

    @cached_property
    def _extended_range_runs(self) -> list[OddRun]:
        """Odd runs that the robot may explain: a stop, an inertia that others do not ask."""
        return [
            each for each in self._odd_runs if each.outside_range and each.search.best() is None
        ]


def _doubt_masses(recordings: RecordingSet) -> Doubt:
    """Weight and inertia would be what the model lacks, and nothing else could be told."""
    return Doubt(
        kind="masses",
        joints=(),
        evidence="No link of the robot has a mass: its URDF gives no <inertial>. Give them there,"
        " if only roughly: all else is judged beside the weight.",
        line="",
    )


def _doubt_currents(recordings: RecordingSet) -> Iterator[Doubt]:
    """Torques that nobody has made of currents yet."""
    if recordings.signals.currents:
        yield Doubt(
            kind="torque unit",
            joints=(),
            evidence="The torques are stated as currents in A. Give N m per A at each joint (the"
            " motor's torque constant times the gear ratio) as torque in [signals.scale]; what the"
            " weight of the nominal model suggests, if anything, is told here as well.",
            line="",
        )


def _doubt_set_points(recordings: RecordingSet) -> Iterator[Doubt]:
    """Positions that the arm was told to take."""
    told = [name for name in recordings.signals.position if name and is_set_point(name)]
    if told:
        yield Doubt(
            kind="set points",
            joints=(),
            evidence=f"The positions are set points by their names ({', '.join(told[:3])}"
            f"{', ...' if len(told) > 3 else ''}): what the arm was told to do is not what it did,"
            " and its controller's errors would be taken for physics. Record measured positions.",
            line="position = [...] in [signals] with the columns that were measured",
        )


def _doubt_references(recordings: RecordingSet) -> Iterator[Doubt]:
    """Positions whose names may be those of set points."""
    names = [name for name in recordings.signals.position if name]
    told = [name for name in names if may_be_set_point(name) and not is_set_point(name)]
    if told:
        yield Doubt(
            kind="set points",
            joints=(),
            evidence=f"The positions speak of a reference ({', '.join(told[:3])}"
            f"{', ...' if len(told) > 3 else ''}): are they measured, and not what the arm was told"
            " to do?",
            line="",
        )


def _doubt_joint_gain(recordings: RecordingSet, found: JointGain) -> Doubt:
    factors = np.ones(recordings.n)
    factors[found.joint] = float(f"{1.0 / found.gain:.3g}")
    j = found.joint + 1
    return Doubt(
        kind="torque gain",
        joints=(j,),
        evidence=f"The torque of joint {j} fits {found.gain:.3g} times what the model expects: of"
        f" its variance {100.0 * found.after:.2g} % then stays in place of"
        f" {100.0 * found.before:.2g} %, whatever masses and friction all joints are given. Is its"
        " torque constant, gear ratio or column that of another joint? A diagnosis may call it"
        " torque_gain.",
        line=scale_line(recordings, "torque", factors),
    )


def _doubt_extended_range(odd: OddRun) -> Doubt:
    which = format_joints(odd.joints)
    return Doubt(
        kind="another arm",
        joints=tuple(j + 1 for j in odd.joints),
        evidence=f"{odd.run.name} moves faster or further than the other runs and does not fit them"
        f" there, in the torque of {which}. If that is the same arm with the same load, the model"
        " lacks something that shows there alone.",
        line="",
    )


def _doubt_odd_runs(recordings: RecordingSet, odd: Sequence[OddRun]) -> Iterator[Doubt]:
    """Another reading of a run where one explains it; else the run is of something else."""
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
            evidence=f"{each.run.name} does not fit the other runs, as of another arm, or of this"
            f" one with a load or a contact: of the torque's variance the nominal model leaves"
            f" {shares}, with friction of its own. Take its [[runs]] section out, or give that load"
            " a set of its own.",
            line="",
        )


def _doubt_one_run(
    recordings: RecordingSet, name: str, search: Explanations, explanation: Explanation
) -> Iterator[Doubt]:
    for doubt in describe_explanation(recordings, search, explanation):
        yield replace(doubt, evidence=limit_to_runs([name], doubt.evidence), line="")


def _doubt_single_runs(
    recordings: RecordingSet, runs: Sequence[RecordedRun], together: Explanations
) -> Iterator[Doubt]:
    """What single runs contradict, where the others are as the file says."""
    with np.errstate(invalid="ignore"):
        fails = together.strict > _MIN_OPEN_SHARE
    if not fails.any():
        return
    for run in runs[:_MAX_SINGLE_RUNS]:
        samples = sample_runs([run])
        if samples is None:
            continue
        search = Explanations(together.robot, samples)
        explanation = search.best()
        if explanation is None:
            continue
        yield from _doubt_one_run(recordings, run.name, search, explanation)


# The nominal model leaves at least this share of a torque's variance in an odd run, and so many
# times more than in any other run; shares below the last are as good as nothing.
_MIN_ODD_SHARE, _MIN_ODD_RATIO, _OTHERS_FLOOR = 0.05, 8.0, 0.005
# Where it leaves more of others too, they are no measure: what is wrong is wrong in all runs.
_MAX_OTHERS_SHARE = 0.3
# Runs that are compared.
_MAX_COMPARED_RUNS = 60
# Of the ranges that others moved in, what is near them still; fewer instants decide nothing.
_RANGE_MARGIN, _MIN_SHARED_INSTANTS = 0.05, 30


@dataclass(frozen=True, eq=False)
class OddRun:
    """A run, the joints (from 0) that tell it, and the shares that it and the others leave.

    Parameters
    ----------
    run : RecordedRun
    search : Explanations
        Of this run alone.
    joints : tuple of int
    left, others : array (n,)
        In this run, and the most in any other.
    outside_range : bool
        Whether it fits where the others were as well, or was hardly there: it moves faster or
        further than these, where a robot may lack what only shows there.
    """

    run: RecordedRun
    search: Explanations
    joints: tuple[int, ...]
    left: np.ndarray
    others: np.ndarray
    outside_range: bool


def find_odd_runs(together: Explanations, runs: Sequence[RecordedRun]) -> list[OddRun]:
    """Runs in which the nominal model fails where it holds in all the others.

    Each run is given friction of its own, so that a cold arm is no other one. Of two runs the one
    that the nominal model fits is believed.
    """
    searches: list[tuple[RecordedRun, Explanations]] = []
    for run in runs[:_MAX_COMPARED_RUNS]:
        samples = sample_runs([run])
        if samples is not None:
            searches.append((run, Explanations(together.robot, samples)))
    if len(searches) < 2:
        return []
    shares = np.array([search.strict for _, search in searches])
    found = []
    for k, (run, search) in enumerate(searches):
        rest = np.delete(shares, k, axis=0)
        known = np.isfinite(rest).any(axis=0)
        others = np.where(known, np.nanmax(np.where(np.isfinite(rest), rest, -1.0), axis=0), np.nan)
        odd = _is_odd(shares[k], others)
        if odd.any():
            joints = tuple(int(j) for j in np.flatnonzero(odd))
            beside = [other.samples for _, other in searches if other is not search]
            there = _select_shared_range(search.samples, beside)
            outside_range = (
                there is None
                or not _is_odd(Explanations(together.robot, there).strict, others).any()
            )
            found.append(OddRun(run, search, joints, shares[k], others, outside_range))
    return found


def _is_odd(shares: np.ndarray, others: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        far = (shares > _MIN_ODD_SHARE) & (
            shares > _MIN_ODD_RATIO * np.maximum(others, _OTHERS_FLOOR)
        )
        return np.asarray(far & (others < _MAX_OTHERS_SHARE))


def _select_shared_range(samples: Samples, others: Sequence[Samples]) -> Samples | None:
    """Instants at which all joints are where others were, no faster; None of too few."""
    inside = np.ones(len(samples.position), dtype=bool)
    for name in ("position", "velocity", "acceleration"):
        beside = np.vstack([getattr(each, name) for each in others])
        low, high = np.nanmin(beside, axis=0), np.nanmax(beside, axis=0)
        margin = _RANGE_MARGIN * (high - low)
        own = getattr(samples, name)
        inside &= ~((own < low - margin) | (own > high + margin)).any(axis=1)
    if inside.sum() < _MIN_SHARED_INSTANTS:
        return None
    names = ("position", "velocity", "acceleration", "torque")
    return replace(samples, **{name: getattr(samples, name)[inside] for name in names})
