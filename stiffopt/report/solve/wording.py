"""Sentences of a solve's report on objective, elastic simulation and baselines."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stiffopt.baseline.baselines import better_baseline
from stiffopt.certificate.objective_value import is_maximised
from stiffopt.certificate.violations import CERTIFICATE_TOLERANCE
from stiffopt.problem.objective import OBJECTIVES, ObjectiveKind
from stiffopt.problem.trajectory import TrajectoryProblem
from stiffopt.report.common.terminal import ReportSection
from stiffopt.report.common.text import DASH, listed, percent, si, significant, words
from stiffopt.result.assessment import Violation
from stiffopt.result.compensation import (
    MIN_SLOWDOWN,
    RIVAL_COMMAND_FILE,
    RIVAL_TRAJECTORY_FILE,
    CompensatedMotion,
    Compensation,
)
from stiffopt.result.simulation import ElasticMotion, Simulation
from stiffopt.result.solution import ObjectiveValue, Solution
from stiffopt.result.status import SolveStatus

# Ratio below which a gain is written as "3.4 times less", above it as a percentage.
_MAX_FACTOR_RATIO = 0.6
_EQUAL_RATIO_TOLERANCE = 5e-4


def objective_phrase(name: str, measure: str) -> str:
    """Return the name of an objective in words.

    >>> objective_phrase("dynamic_deflection", "peak"), objective_phrase("duration", "")
    ('peak dynamic tool deflection', 'duration')
    """
    kind = OBJECTIVES.get(name)
    if kind is None:
        return words(name)
    return f"{measure} {kind.phrase}" if kind.measured and measure else kind.phrase


def objective_text(objective: ObjectiveValue) -> str:
    """Return phrase and value, such as "peak dynamic tool deflection 0.297 mm"."""
    phrase = objective_phrase(objective.name, objective.measure)
    return f"{phrase} {objective_amount(objective.name, objective.value, objective.unit, 3)}"


def objective_amount(name: str, value: float | None, unit: str, digits: int = 4) -> str:
    """Format an objective's value with its unit; integrals over time always in seconds.

    >>> objective_amount("torque_squared", 0.0111, "s"), objective_amount("duration", 0.0111, "s")
    ('0.0111 s', '11.1 ms')
    """
    kind = OBJECTIVES.get(name)
    if kind is not None and not kind.prefixed and value is not None:
        return f"{significant(value, digits)} {unit}"
    return si(value, unit, digits)


def headline_text(solution: Solution) -> str:
    """Return the tool error of the arm as commanded, and the objective; else that alone.

    The error of the worst uncertain arm with the command; without one, that of the simulated arm
    whose motors follow the plan.
    """
    assert solution.objective is not None
    objective = objective_text(solution.objective)
    led, simulation = solution.compensation, solution.simulation
    if led is not None and not led.optimised.excess:
        own = led.optimised.compensated
        errors = [own.flight.worst, own.after.worst]
        text = "tool error on the worst uncertain arm"
    elif simulation is not None and simulation.measure:
        found = simulation.optimised.simulated
        errors = [found.peak, *([] if found.peak_after is None else [found.peak_after])]
        text = "tool error without a command"
    else:
        return objective
    phases = zip(errors, ("in flight", "after arrival"), strict=False)
    said = ", ".join(f"{si(error, 'm', 3)} {phase}" for error, phase in phases)
    return f"{text} {said} ({objective})"


def difference_text(problem: TrajectoryProblem, solution: Solution) -> str:
    """Return a warning where simulated and planned deflection differ, else ""."""
    simulation = solution.simulation
    if simulation is None or not simulation.differs:
        return ""
    motion = simulation.optimised
    change = motion.difference
    assert change is not None
    part = motion.compared
    deviates = "deviates by" if part.name == "dynamic" else f"has a {part.name} deflection of"
    why = (
        "the command smooths the kinks of the joints' wind-up law more than the plan, as limits "
        "and mesh require; a higher limits.jerk or a longer duration reduces the difference"
        if problem.plans_links
        else "the quasi-static plan does not include the vibration of the links"
    )
    text = (
        f"With motors that follow exactly the elastic arm {deviates} up to "
        f"{si(part.simulated.peak, 'm', 3)} in flight where {si(part.planned.peak, 'm', 3)} was "
        f"planned ({percent(abs(change), 2)} {'more' if change > 0 else 'less'}): {why}."
    )
    if motion.simulated.settling_time is None and motion.simulated.peak_after is not None:
        return f"{text} It does not settle to {si(motion.simulated.band, 'm')} within 1 s."
    return text


def comparison(problem: TrajectoryProblem, solution: Solution) -> str:
    """Return sentences on the best rival: on uncertain arms where commands were made for them."""
    led = solution.compensation
    if led is not None and led.best_rival is not None:
        return rival_text(led)
    if led is not None and not solution.baselines and len(led.motions) == 1:
        return "It was compared with neither baselines nor rivals."
    certified = _certified_comparison(problem, solution)
    return certified if led is None else f"{certified} {rival_text(led)}"


def rival_text(compensation: Compensation) -> str:
    """Return sentences on the worst-case tool error beside that of the best rival."""
    beside, own = compensation.beside_best, compensation.optimised
    if len(compensation.motions) == 1:
        return "It was not compared with rivals."
    if beside is None:
        return "No rival's command keeps every limit."
    best = beside.rival
    name = f"{_motion_phrase(best.name)} of {si(best.duration, 's', 4)}"
    theirs = _format_phases(best)
    tail = "each with its best command within the limits, on the same uncertain arms"
    if compensation.ratios is None:
        text = f"The best rival, {name}, has a worst-case tool error of {theirs}"
    else:
        flight, after = compensation.ratios
        slowed = f"; slowed to {si(best.duration, 's', 4)} {_format_phases(beside.own)}"
        text = (
            f"Worst-case tool error {_format_phases(own)} in flight / after arrival"
            f"{slowed if beside.own is not own else ''}: in flight "
            f"{amount(flight).lower()} the best rival, {name}, which has {theirs}"
        )
        if not np.isclose(flight, after):
            text += f"; after arrival {amount(after).lower()} it"
    slower = best.duration / own.duration - 1.0
    if slower > MIN_SLOWDOWN:
        tail += f"; the rival was slowed by {percent(slower, 2)} to keep the limits"
    text += f"; {tail}."
    better = compensation.rival_better_in
    if compensation.rival_wins or better:
        where = "" if compensation.rival_wins else f" {listed(better)}"
        claim = f"The rival is the better motion{where}"
        if own.excess:
            # Whatever is minimised: the optimised motion has no command to compare.
            claim = "Of the two only the rival's motors can lead its links"
        run = f": run {RIVAL_TRAJECTORY_FILE} with {RIVAL_COMMAND_FILE}"
        text += f" {claim}{run if compensation.rival_command is not None else ''}."
    return text


def _format_phases(motion: CompensatedMotion) -> str:
    spreads = motion.compensated
    return " / ".join(si(each.worst, "m", 2) for each in (spreads.flight, spreads.after))


def _certified_comparison(problem: TrajectoryProblem, solution: Solution) -> str:
    """Return a sentence on the better feasible baseline by certified objective, or its absence."""
    maximised = is_maximised(problem)
    better = better_baseline(problem, solution.baselines)
    ratio = solution.ratio_to_better_baseline
    strict = solution.strict_baseline
    if better is None and strict is not None and strict.feasible:
        better, ratio = strict, solution.ratio_to_strict_baseline
    if solution.objective is None or solution.assessment is None:
        return "There is no motion to compare with the baselines."
    if not solution.baselines:
        return "It was not compared with baselines."
    if better is not None and ratio is None and solution.status.usable:
        return "Values of this objective have no ratio; the table of baselines shows them."
    if solution.status is SolveStatus.INTERRUPTED and ratio is None:
        return "It was stopped before its comparison with the baselines."
    if better is not None and ratio is None:
        return "This motion does not meet all limits, so it is not compared with the baselines."
    if better is None or ratio is None:
        return "No baseline meets all limits, so none is counted."
    other, name = better.assessment, better.name
    motion = _motion_phrase(name)
    if other is not None and abs(other.duration - solution.assessment.duration) < 1e-6:
        motion += " of the same duration"
    term = problem.objectives[0].name if len(problem.objectives) == 1 else ""
    return f"{amount(ratio, term, maximised)} {motion}."


def _motion_phrase(name: str) -> str:
    return "toppra's motion" if name == "toppra" else f"the {name} motion"


def amount(ratio: float, name: str = "", maximised: bool = False) -> str:
    """Return the beginning of a sentence that compares an objective with a baseline's.

    Parameters
    ----------
    ratio : float
        Below one is better, for maximised objectives too.
    name : str
        Name of the objective.

    Returns
    -------
    >>> amount(0.25), amount(0.9), amount(1.1), amount(0.5, "joint_stiffness", True)
    ('4 times less than', '10 % less than', '10 % more than', '2 times as much as')
    """
    value = 1.0 / ratio if maximised else ratio
    if abs(value - 1.0) < _EQUAL_RATIO_TOLERANCE:
        return "The same as"
    kind = OBJECTIVES.get(name, ObjectiveKind)
    if kind.compared_as_ratio and value < _MAX_FACTOR_RATIO:
        return f"{significant(1.0 / value, 2)} times less than"
    if kind.compared_as_ratio and value > 1.0 / _MAX_FACTOR_RATIO:
        return f"{significant(value, 2)} times as much as"
    less, more = kind.comparatives
    change = 100.0 * abs(value - 1.0)
    return f"{significant(change, 2)} % {less if value < 1 else more} than"


def limit_text(violation: Violation) -> str:
    """Return a limit with its place, such as "velocity, joint 1", "collision, fore and table"."""
    if violation.pair is not None:
        return f"{words(violation.limit)}, {' and '.join(violation.pair)}"
    name = words(violation.limit)
    return f"{name}, joint {violation.joint}" if violation.joint else name


def violation_text(violation: Violation) -> str:
    """Return excess or margin in words: "exceeded by 1.2 %", "margin 8.5 %", "2 mm deep".

    Within the certificate's tolerance a limit is kept: "at the limit (+0.04 %)".
    """
    if violation.distance is not None:
        return violation.describe_distance()
    # Relative excess or margin that is written as "at the limit".
    if abs(violation.value) < 1e-5:
        return "at the limit"
    size = percent(abs(violation.value))
    if 0.0 < violation.value <= CERTIFICATE_TOLERANCE:
        return f"at the limit (+{size})"
    return f"exceeded by {size}" if violation.value > 0 else f"margin {size}"


def simulation_section(simulation: Simulation) -> ReportSection:
    """Return the simulated motions, the optimised one first, and notes on the simulation."""
    band = si(simulation.optimised.simulated.band, "m")
    head = [
        *("motion", "duration", "planned peak", "simulated peak"),
        *("simulated rms", "peak after arrival", "rms after arrival"),
        *(f"within {band} after", "verdict"),
    ]
    return ReportSection(
        title="Elastic simulation",
        head=head,
        rows=[_motion_row(motion) for motion in simulation.motions],
        lines=_simulation_notes(simulation),
        numbers=head[2:-1],
    )


def _motion_row(motion: ElasticMotion) -> list[str]:
    found = motion.simulated
    settled = DASH
    if found.settling_time is not None:
        settled = si(found.settling_time, "s", 3)
    elif found.peak_after is not None:
        settled = "not in 1 s"
    return [
        motion.name,
        si(found.duration, "s"),
        si(motion.planned.peak, "m", 3),
        si(found.peak, "m", 3),
        *(si(size, "m", 3) for size in (found.rms, found.peak_after, found.rms_after)),
        settled,
        "counted" if motion.counted else "not counted",
    ]


def _simulation_notes(simulation: Simulation) -> list[str]:
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
        f"The damping of {named} is assumed: 2 % of critical for each joint on its own, so that "
        "the damping ratios of modes differ; state damping in the robot file where it was measured."
    ]


def _hysteresis_note(simulation: Simulation) -> list[str]:
    """Return a note on the effect of hysteresis of typical size, where none is stated."""
    reach, peak = simulation.typical_hysteresis, simulation.optimised.simulated.peak
    if reach is None or peak <= 0.0:
        return []
    return [
        "No joint states its hysteresis: loops of 0.05 mrad half width in all joints, as measured "
        f"on reducers, could hold the tool {si(reach, 'm', 2)} from its static equilibrium, "
        f"{100.0 * reach / peak:.0f} % of the optimised peak; state hysteresis in the robot file "
        "where it was measured."
    ]
