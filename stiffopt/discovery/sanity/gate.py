"""The sanity gate: what is doubted of recordings before anything is diagnosed from them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from stiffopt.discovery.comparison.nominal_robot import RobotModel
from stiffopt.discovery.sanity.doubt import Doubt
from stiffopt.discovery.sanity.explanations import Explanation, Explanations
from stiffopt.discovery.sanity.joint_gains import JointGain, joint_gains
from stiffopt.discovery.sanity.lines import (
    joints_in_words,
    of_some,
    scale_line,
)
from stiffopt.discovery.sanity.odd_runs import OddRun, odd_runs
from stiffopt.discovery.sanity.position_limits import beyond_limits
from stiffopt.discovery.sanity.readings import explained, in_rad
from stiffopt.discovery.sanity.samples import sampled
from stiffopt.discovery.sanity.second_sensors import second_sensors
from stiffopt.recording.recording_set import RecordingSet
from stiffopt.recording.run import RecordedRun
from stiffopt.recording.signals import is_set_point, may_be_set_point

# Share of a torque's variance that is open where single runs are looked at, and how many.
_OPEN, _MOST_RUNS = 0.04, 12


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
            return (_without_masses(recordings),)
        found = [
            *_currents(recordings),
            *_set_points(recordings),
            *second_sensors(recordings, runs),
        ]
        explanation, search = None, self._search
        if search is not None:
            odd = [each for each in self._odd if each not in self._elsewhere]
            explanation = None if odd else search.best()
            if odd:
                found = [*_of_odd_runs(recordings, odd), *found]
            elif explanation is not None:
                found = [*explained(recordings, search, explanation), *found]
            elif (standing := search.standing_in_degrees()) is not None:
                found = [in_rad(recordings, search, standing), *found]
            elif len(runs) > 1 and not found:
                found = [*_of_single_runs(recordings, runs, search)]
        if not any(doubt.kind == "position unit" for doubt in found):
            found += beyond_limits(recordings, runs)
        return tuple(found)

    @property
    def remarks(self) -> tuple[Doubt, ...]:
        """What stops nothing and yet is to be looked at; read where nothing is doubted.

        A drive's constant may be off by that much, which is an effect of the catalogue; and so may
        be the description.
        """
        told = tuple(_references(self._recordings))
        if self._search is None or self._recordings.signals.currents:
            return told
        gains = joint_gains(self._robot, self._search.samples)
        return (
            *told,
            *map(_of_elsewhere, self._elsewhere),
            *(_of_joint_gain(self._recordings, each) for each in gains),
        )

    @cached_property
    def _robot(self) -> RobotModel:
        return RobotModel(self._recordings)

    @cached_property
    def _search(self) -> Explanations | None:
        samples = sampled(self._runs)
        return None if samples is None else Explanations(self._robot, samples)

    @cached_property
    def _odd(self) -> list[OddRun]:
        if self._search is None or len(self._runs) < 2:
            return []
        return odd_runs(self._search, self._runs)

    @cached_property
    def _elsewhere(self) -> list[OddRun]:
        """Odd runs that the robot may explain: a stop, an inertia that others do not ask."""
        return [each for each in self._odd if each.elsewhere and each.search.best() is None]


def _without_masses(recordings: RecordingSet) -> Doubt:
    """Weight and inertia would be what the model lacks, and nothing else could be told."""
    return Doubt(
        kind="masses",
        joints=(),
        evidence="No link of the robot has a mass: its URDF gives no <inertial>. Give them there,"
        " if only roughly: all else is judged beside the weight.",
        line="",
    )


def _currents(recordings: RecordingSet) -> Iterator[Doubt]:
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


def _set_points(recordings: RecordingSet) -> Iterator[Doubt]:
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


def _references(recordings: RecordingSet) -> Iterator[Doubt]:
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


def _of_joint_gain(recordings: RecordingSet, found: JointGain) -> Doubt:
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


def _of_elsewhere(odd: OddRun) -> Doubt:
    which = joints_in_words(odd.joints)
    return Doubt(
        kind="another arm",
        joints=tuple(j + 1 for j in odd.joints),
        evidence=f"{odd.run.name} moves faster or further than the other runs and does not fit them"
        f" there, in the torque of {which}. If that is the same arm with the same load, the model"
        " lacks something that shows there alone.",
        line="",
    )


def _of_odd_runs(recordings: RecordingSet, odd: Sequence[OddRun]) -> Iterator[Doubt]:
    """Another reading of a run where one explains it; else the run is of something else."""
    for each in odd:
        explanation = each.search.best()
        if explanation is not None:
            yield from _of_one_run(recordings, each.run.name, each.search, explanation)
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


def _of_one_run(
    recordings: RecordingSet, name: str, search: Explanations, explanation: Explanation
) -> Iterator[Doubt]:
    for doubt in explained(recordings, search, explanation):
        yield replace(doubt, evidence=of_some([name], doubt.evidence), line="")


def _of_single_runs(
    recordings: RecordingSet, runs: Sequence[RecordedRun], together: Explanations
) -> Iterator[Doubt]:
    """What single runs contradict, where the others are as the file says."""
    with np.errstate(invalid="ignore"):
        fails = together.strict > _OPEN
    if not fails.any():
        return
    for run in runs[:_MOST_RUNS]:
        samples = sampled([run])
        if samples is None:
            continue
        search = Explanations(together.robot, samples)
        explanation = search.best()
        if explanation is None:
            continue
        yield from _of_one_run(recordings, run.name, search, explanation)
