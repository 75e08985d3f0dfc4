"""What is assumed where a recording set is silent."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from stiffopt.recording.nominal import Tolerance
from stiffopt.recording.nominal_files import unstated
from stiffopt.recording.schema import NominalSection, RecordingsFile
from stiffopt.robot.robot import Robot

NO_RATIO = "nominal.gear_ratio is not given: nothing periodic in the rotor angle can be named."


def assumptions(
    document: RecordingsFile, described: Robot, locked: Sequence[str]
) -> tuple[str, ...]:
    """Sentences, one a thing assumed, in the order of the file.

    Parameters
    ----------
    document : RecordingsFile
    described : Robot
        As its own file describes it.
    locked : sequence of str
        Joints that are not recorded.
    """
    found = []
    if locked:
        found.append(f"Joints not recorded are held at zero: {', '.join(locked)}.")
    if document.gravity is None:
        found.append("Gravity is 9.81 m/s^2 along -z of the base.")
    if document.signals.torque_side is None:
        found.append("Torque is the motor's, from current, before friction.")
    found += of_nominal(
        document.nominal,
        document.tolerance,
        described,
        links=bool(document.signals.link_position),
    )
    if document.noise.torque is None:
        found.append("Torque noise is not given and is estimated from the recordings.")
    if document.signals.link_position and document.noise.link_position is None:
        found.append("Link encoder noise is not given and is estimated from the recordings.")
    if all(run.session_time is None for run in document.runs):
        found.append("Session times are not given: all runs are taken as equally warm.")
    return tuple(found)


def of_nominal(
    nominal: NominalSection, tolerance: Tolerance, described: Robot, *, links: bool
) -> tuple[str, ...]:
    """Sentences on the nominal robot and how far it may be off, which an extended model replaces.

    Parameters
    ----------
    nominal : NominalSection
        What the set states.
    tolerance : Tolerance
        Likewise.
    described : Robot
        As its own file describes it.
    links : bool
        Whether link positions are recorded.
    """
    found = [*_of_nominal(nominal, described, links)]
    if silent := not_given(tolerance):
        found.append(f"Tolerances not given, wide defaults hold: {', '.join(silent)}.")
    return tuple(found)


def not_given(tolerance: Tolerance) -> list[str]:
    """Names of tolerances that a set does not give.

    Nobody knows a damping well: that it may differ widely needs no word.
    """
    return [k for k, value in vars(tolerance).items() if value is None and k != "joint_damping"]


def _of_nominal(nominal: NominalSection, described: Robot, links: bool) -> Iterator[str]:
    if nominal.gear_ratio is None:
        yield NO_RATIO
    for key, what in (
        ("rotor_inertia", "the rotor inertia"),
        ("coulomb", "the Coulomb friction"),
        ("viscous", "the viscous friction"),
    ):
        if key in unstated(nominal, described):
            yield f"nominal.{key} is not given: {what} is not known and is estimated."
        elif getattr(nominal, key) is None:
            yield f"nominal.{key} is not given: {what} is that of the robot's file."
    if nominal.reducer is None:
        if any(described.chains) and nominal.contact_stiffness is None:
            yield "nominal.reducer is not given: drivetrains are those of the robot's file."
        elif links:
            yield "nominal.reducer is not given: the joints' stiffness is estimated."
