"""Table and notes of an elastic simulation, as text."""

from __future__ import annotations

from collections.abc import Sequence

from stiffopt.report.common.text import listed, si
from stiffopt.result.simulation import ElasticMotion, Simulation


def simulation_table(simulation: Simulation) -> tuple[list[str], list[list[str]]]:
    """Return header and rows as text, the optimised motion first."""
    band = si(simulation.optimised.simulated.band, "m")
    head = [
        *("motion", "duration", "planned peak", "simulated peak"),
        *("simulated rms", "peak after arrival", "rms after arrival"),
        *(f"within {band} after", "verdict"),
    ]
    return head, [_motion_row(motion) for motion in simulation.motions]


def _motion_row(motion: ElasticMotion) -> list[str]:
    found = motion.simulated
    settled = "–"
    if found.settling_time is not None:
        settled = si(found.settling_time, "s", 3)
    elif found.peak_after is not None:
        settled = "not in 1 s"
    after = [
        "–" if size is None else si(size, "m", 3) for size in (found.peak_after, found.rms_after)
    ]
    return [
        motion.name,
        si(found.duration, "s"),
        si(motion.planned.peak, "m", 3),
        si(found.peak, "m", 3),
        si(found.rms, "m", 3),
        *after,
        settled,
        "counted" if motion.counted else "not counted",
    ]


def simulation_notes(simulation: Simulation) -> list[str]:
    """Return notes on damping, slip and hysteresis; those of all motions appear once."""
    notes = assumed_damping_note(simulation.assumed_damping) + _hysteresis_note(simulation)
    told = [motion.simulated.notes for motion in simulation.motions]
    shared = [note for note in told[0] if all(note in each for each in told)] if told else []
    notes += shared
    for motion in simulation.motions:
        notes += [f"{motion.name}: {n}" for n in motion.simulated.notes if n not in shared]
    return notes


def assumed_damping_note(joints: Sequence[int]) -> list[str]:
    """Return a sentence on the joints (from 1) whose damping is assumed, if any."""
    if not joints:
        return []
    named = f"joint{'s' if len(joints) > 1 else ''} {listed(str(j) for j in joints)}"
    return [
        f"The damping of {named} is assumed: 2 % of critical for each"
        " joint on its own, so that the "
        "damping ratios of modes differ; state damping in the robot file where it was measured."
    ]


def _hysteresis_note(simulation: Simulation) -> list[str]:
    """Return a note on the effect of hysteresis of typical size, where none is stated."""
    reach, peak = simulation.typical_hysteresis, simulation.optimised.simulated.peak
    if reach is None or peak <= 0.0:
        return []
    return [
        "No joint states its hysteresis: loops of 0.05 mrad half"
        " width in all joints, as measured on "
        f"reducers, could hold the tool {si(reach, 'm', 2)} from its static equilibrium, "
        f"{100.0 * reach / peak:.0f} % of the optimised peak; state hysteresis in the robot file "
        "where it was measured."
    ]
