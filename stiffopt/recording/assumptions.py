"""What is assumed where a recording set is silent."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from stiffopt.recording.nominal_files import unstated
from stiffopt.recording.schema import RecordingsFile
from stiffopt.robot.robot import Robot


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
    found += _of_nominal(document, described)
    # Nobody knows a damping well: that it may differ widely needs no word.
    tolerances = [
        key
        for key, value in vars(document.tolerance).items()
        if value is None and key != "joint_damping"
    ]
    if tolerances:
        found.append(f"Tolerances not given, wide defaults hold: {', '.join(tolerances)}.")
    if document.noise.torque is None:
        found.append("Torque noise is not given and is estimated from the recordings.")
    if document.signals.link_position and document.noise.link_position is None:
        found.append("Link encoder noise is not given and is estimated from the recordings.")
    if all(run.session_time is None for run in document.runs):
        found.append("Session times are not given: all runs are taken as equally warm.")
    return tuple(found)


def _of_nominal(document: RecordingsFile, described: Robot) -> Iterator[str]:
    nominal = document.nominal
    if nominal.gear_ratio is None:
        yield "nominal.gear_ratio is not given: nothing periodic in the rotor angle can be named."
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
        elif document.signals.link_position:
            yield "nominal.reducer is not given: the joints' stiffness is estimated."
