"""What is assumed where a recording set is silent."""

from __future__ import annotations

from collections.abc import Sequence

from stiffopt.recording.schema import RecordingsFile


def assumptions(document: RecordingsFile, locked: Sequence[str]) -> tuple[str, ...]:
    """Sentences, one a thing assumed, in the order of the file."""
    found = []
    if locked:
        found.append(f"Joints not recorded are held at zero: {', '.join(locked)}.")
    if document.gravity is None:
        found.append("Gravity is 9.81 m/s^2 along -z of the base.")
    if document.signals.torque_side is None:
        found.append("Torque is the motor's, from current, before friction.")
    nominal = document.nominal
    for key, meaning in (
        ("gear_ratio", "nothing periodic in the rotor angle can be named"),
        ("rotor_inertia", "the rotor inertia is not known and is estimated"),
        ("coulomb", "the Coulomb friction is not known and is estimated"),
        ("viscous", "the viscous friction is not known and is estimated"),
    ):
        if getattr(nominal, key) is None:
            found.append(f"nominal.{key} is not given: {meaning}.")
    if document.signals.link_position and nominal.reducer is None:
        found.append("nominal.reducer is not given: the joints' stiffness is estimated.")
    tolerances = [key for key, value in document.tolerance.model_dump().items() if value is None]
    if tolerances:
        found.append(f"Tolerances not given, wide defaults hold: {', '.join(tolerances)}.")
    if document.noise.torque is None:
        found.append("Torque noise is not given and is estimated from the recordings.")
    if document.signals.link_position and document.noise.link_position is None:
        found.append("Link encoder noise is not given and is estimated from the recordings.")
    if all(run.session_time is None for run in document.runs):
        found.append("Session times are not given: all runs are taken as equally warm.")
    return tuple(found)
