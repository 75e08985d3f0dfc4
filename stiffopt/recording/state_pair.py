"""Two recording sets of one robot in two states: before and after a change."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace

from stiffopt.actuator.law import ActuatorLaw
from stiffopt.errors import InputFileError
from stiffopt.recording.recording_set import (
    RecordingSet,
    RunEntry,
    load_recordings,
    require_test_runs,
)
from stiffopt.recording.run import RecordedRun


@dataclass(frozen=True, kw_only=True, eq=False)
class StateRun(RunEntry):
    """Entry of a run with the state of the robot in it."""

    state: str  # "before" or "after"
    entry: RunEntry  # the entry in its own set

    @property
    def name(self) -> str:
        """Name in its own set, after the state."""
        return f"{self.state}_{self.entry.name}"


@dataclass(frozen=True, kw_only=True, eq=False)
class StatePair(RecordingSet):
    """Runs of one robot in two states, with one nominal model: that of the state before."""

    before: RecordingSet
    after: RecordingSet

    @property
    def runs_after(self) -> tuple[str, ...]:
        """Names of all runs of the state after."""
        own = (run for run in self.runs if isinstance(run, StateRun))
        return tuple(run.name for run in own if run.state == "after")

    def with_actuator(self, law: ActuatorLaw) -> StatePair:
        """Pair with a law that derives torques from commands in both states."""
        states = {name: getattr(self, name).with_actuator(law) for name in ("before", "after")}
        return replace(self, actuator=law, **states)

    def open(self, entry: RunEntry) -> RecordedRun:
        """Read and clean one run with the columns of its own set."""
        assert isinstance(entry, StateRun)
        own = self.before if entry.state == "before" else self.after
        return replace(own.open(entry.entry), name=entry.name, file=entry.file)


def load_state_pair(
    before: RecordingSet | str | os.PathLike[str], after: RecordingSet | str | os.PathLike[str]
) -> StatePair:
    """Load two recording sets of one robot as its states before and after a change.

    Raises `InputFileError`: a set that cannot be read, without training or test runs, given twice,
    or of another robot, other joints, signals or nominal values.
    """
    first, second = (
        each if isinstance(each, RecordingSet) else load_recordings(each)
        for each in (before, after)
    )
    for each in (first, second):
        require_test_runs(each)
    _require_comparable(first, second)
    runs = tuple(
        StateRun(
            file=f"{state}/{entry.file}",
            role=entry.role,
            session_time=entry.session_time,
            number=entry.number,
            temperature=entry.temperature,
            state=state,
            entry=entry,
        )
        for state, own in (("before", first), ("after", second))
        for entry in own.runs
    )
    shared = {each.name: getattr(first, each.name) for each in fields(RecordingSet)}
    names = {
        "name": f"{first.name}_to_{second.name}",
        "title": f"{first.title} to {second.title}",
        "runs": runs,
    }
    return StatePair(**(shared | names), before=first, after=second)


def split_states(
    recordings: RecordingSet, runs: Sequence[RecordedRun]
) -> Iterator[tuple[RecordingSet, Sequence[RecordedRun]]]:
    """Yield recordings and runs of one state each; all of them where there is one state."""
    if not isinstance(recordings, StatePair):
        yield recordings, runs
        return
    after = recordings.runs_after
    for own, changed in ((recordings.before, False), (recordings.after, True)):
        yield (
            replace(recordings, path=own.path, signals=own.signals),
            [run for run in runs if (run.name in after) == changed],
        )


def _require_comparable(first: RecordingSet, second: RecordingSet) -> None:
    """Raise `InputFileError` unless both sets describe one robot and the same channels."""
    if first.path.resolve() == second.path.resolve():
        raise InputFileError(
            second.path,
            "",
            "is given as the state before and as the state after. Give two sets of one robot, "
            "recorded before and after the change.",
        )
    if first.joints != second.joints:
        raise InputFileError(
            second.path,
            "joints",
            f"are {', '.join(second.joints)}, before the change {', '.join(first.joints)} "
            f"({first.path}). Give sets of one robot with the same joints in the same order.",
        )
    difference = _describe_arm_difference(first, second)
    if difference:
        raise InputFileError(
            second.path,
            "robot",
            f"is another one than in {first.path}: {difference}. Both states need one robot file, "
            "without the change: the comparison finds it.",
        )
    _require_same_channels(first, second)
    if first.stated != second.stated:
        keys = ", ".join(
            key
            for key in type(first.stated).model_fields
            if getattr(first.stated, key) != getattr(second.stated, key)
        )
        raise InputFileError(
            second.path,
            "nominal",
            f"differs from {first.path} in {keys}. Both states are compared with one nominal "
            "model: state the same values in both sets.",
        )


def _describe_arm_difference(first: RecordingSet, second: RecordingSet) -> str:
    """Return the first difference of the arms' bodies, "" where they agree."""
    for j, name in enumerate(first.joints):
        bodies = [each.described.tree.bodies[int(each.order[j])] for each in (first, second)]
        lengths = [float((body.translation**2).sum() ** 0.5) for body in bodies]
        # Same arm where joints lie within 0.1 mm and bodies weigh within 0.1 % of the other file's.
        if abs(lengths[0] - lengths[1]) > 1e-4:
            return (
                f"joint {name!r} lies {lengths[1]:.4g} m from the joint before, there "
                f"{lengths[0]:.4g} m"
            )
        masses = [float(body.mass) for body in bodies]
        if abs(masses[0] - masses[1]) > 1e-3 * max(masses):
            return (
                f"the body behind joint {name!r} has {masses[1]:.4g} kg, there {masses[0]:.4g} kg"
            )
    return ""


def _require_same_channels(first: RecordingSet, second: RecordingSet) -> None:
    for key in ("torque", "link_position"):
        recorded = [
            tuple(bool(name) for name in getattr(each.signals, key) or ("",) * each.n)
            for each in (first, second)
        ]
        for name, one, other in zip(first.joints, *recorded, strict=True):
            if one != other:
                state, missing = ("after", "before") if other else ("before", "after")
                raise InputFileError(
                    second.path,
                    f"signals.{key}",
                    f"{key} of {name!r} is recorded {state} the change only. Leave it out of that "
                    f'set with "" in signals.{key}, or record it {missing} the change as well.',
                )
    if first.torque_side != second.torque_side:
        raise InputFileError(
            second.path,
            "signals.torque_side",
            f'is "{second.torque_side}", before the change "{first.torque_side}": friction is in '
            "one of them only. Compare recordings of the same sensor.",
        )
