"""Names and sentences of a preload study: tightening, active limits, stiffness, warnings."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

import numpy as np

from stiffopt.connection import BoltedFlange, ClampingPins
from stiffopt.drivetrain import catalogue
from stiffopt.errors import is_factor
from stiffopt.fastening.utilisation import UtilisationRow
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.pareto import ParetoFront
from stiffopt.preload.problem import FreeElement, PreloadProblem
from stiffopt.preload.sensitivity import WindupShare
from stiffopt.preload.solution import PreloadSolution
from stiffopt.preload.study import PreloadStudy
from stiffopt.report.common.text import UNCHANGED, change, listed, percent, si, words

# Relative change of stiffness below which stiffness does not determine the preload.
_SMALL_STIFFNESS_GAIN = 0.02
MARK = " *"  # of an estimated number
OBJECTIVE_WORDS = {
    "total_preload": "least total preload",
    "bolt_utilisation": "least utilisation of bolts and pins",
    "joint_stiffness": "largest joint stiffness",
    "tool_deflection": "least tool deflection",
}
METHOD_WORDS = {
    "torque_wrench": "torque wrench",
    "torque_wrench_tested": "torque wrench, tested",
    "hydraulic": "hydraulic",
    "elongation": "measured elongation",
    "impact": "impact wrench",
    "angle": "angle of rotation",
    "yield": "yield-controlled",
}
# Connections named in one sentence.
_MAX_NAMED_CONNECTIONS = 3


def readable(text: str) -> str:
    """Replace keys of elements in a text by words; keys of files stay.

    >>> readable("joint_2.flexspline_flange"), readable("4.5 kN in motor_key.")
    ('joint 2 flexspline flange', '4.5 kN in motor key.')
    >>> readable("a smaller require.least_preload")
    'a smaller require.least_preload'
    """
    return re.sub(r"[A-Za-z][\w.]*\w", _key_in_words, text)


def _key_in_words(word: re.Match[str]) -> str:
    """Replace dots and underscores of a key by spaces, unless it is a key of a study file."""
    key = word[0]
    return key if key.startswith("require.") else words(key.replace(".", " "))


def prose(text: str) -> str:
    """Replace keys of elements by words and insert a space before each per cent sign.

    >>> prose("15% more in joint_2.motor_key")
    '15 % more in joint 2 motor key'
    """
    return re.sub(r"(?<=\d)%", " %", readable(text))


def owner_name(row: UtilisationRow) -> str:
    """Return the element, joint or tool to which a requirement belongs."""
    if row.element:
        return readable(row.element)
    return f"joint {row.joint}" if row.joint else "tool"


def fasteners(element: FreeElement) -> str:
    """Return count, size and grade, such as "9 × M5 12.9"."""
    connection = element.stage.element
    if isinstance(connection, BoltedFlange) and connection.bolt is not None:
        bolt = connection.bolt
        return " ".join(filter(None, (f"{element.count} × {bolt.size} {bolt.grade}", bolt.added)))
    if isinstance(connection, ClampingPins) and connection.screw is not None:
        return f"{element.count} × {connection.screw.size} set screw"
    return f"{element.count} pins"


def fastener_words(elements: Iterable[FreeElement]) -> str:
    """Return the number of bolts and pins: "12 bolts", "1 pin", "109 bolts and pins"."""
    counts = {"bolt": 0, "pin": 0}
    for element in elements:
        name = "bolt" if element.stage.element.kind == "bolted_flange" else "pin"
        counts[name] += element.count
    if all(counts.values()):
        return f"{sum(counts.values())} bolts and pins"
    name = "bolt" if counts["bolt"] else "pin"
    return f"{counts[name]} {name}{'s' if counts[name] > 1 else ''}"


def present_preload(element: FreeElement) -> float | None:
    """Return the preload that the robot file states for one bolt or pin [N], None if assumed."""
    if not element.preload_known:
        return None
    preload = element.stage.element.preload
    assert preload is not None  # bolted flanges and pins are not built without
    return preload


def amount(value: float, unit: str, digits: int = 4) -> str:
    """Format a value with its unit; forces in kN, pressures in MPa."""
    return si(value, {"N": "kN", "Pa": "MPa"}.get(unit, unit), digits)


def active_limits_text(solution: PreloadSolution, key: str, joint: int) -> str:
    """Return the active limits of an element, else those of its joint, else a dash."""
    own = [row.kind for row in solution.rows if row.active and row.element == key]
    if not own:
        shared = (None, joint)
        own = [r.kind for r in solution.rows if r.active and not r.element and r.joint in shared]
    return listed(dict.fromkeys(own)) or "–"


def headline(study: PreloadStudy) -> str:
    """Return the headline: tightening torque or total preload, else the design that there is."""
    problem, solution = study.problem, study.solution
    if not solution.status.usable:
        if study.choice is not None and study.choice.status.usable:
            designs = study.choice.designs
            chosen = listed([f"{designs[key].label} for the {readable(key)}" for key in designs])
            return f"The present bolts cannot meet all requirements; the catalogue has {chosen}"
        if solution.stoppers:
            return "No preload meets all requirements"
        return f"No usable design: {words(solution.status)}"
    if len(problem.elements) == 1:
        element = problem.elements[0]
        torque = solution.tightening[element.key]
        parts = f"the {fastener_words([element])} of the {readable(element.key)}"
        force = f"{si(solution.preloads[element.key], 'kN', 3)}"
        if torque is None:
            return f"Preload {parts} with at most {force} each"
        return f"Tighten {parts} to {si(torque.nominal, 'N m', 3)} (at most {force} each)"
    total = si(solution.total_preload, "kN", 3)
    return f"Tighten {len(problem.elements)} connections as listed, total preload {total}"


def active_limits_sentence(problem: PreloadProblem, solution: PreloadSolution) -> str:
    """Return sentences on the active limits of the design."""
    if not solution.status.usable:
        return ""
    text = _active_limits(problem, solution)
    slip = [row.utilisation for row in solution.rows if row.kind == "slip safety"]
    # Utilisation of slip below which the loads are negligible or in a wrong unit.
    if slip and max(slip) < 0.05:
        text += (
            f" Slip safety is {1.0 / max(slip):.3g} times the required one: the loads are "
            "negligible. Check their unit."
            if max(slip) > 0.0
            else " No load case has a torque about a joint."
        )
    return text


def _active_limits(problem: PreloadProblem, solution: PreloadSolution) -> str:
    counts: dict[str, int] = {}
    for element in problem.elements:
        why = active_limits_text(solution, element.key, element.joint)
        counts[why] = counts.get(why, 0) + 1
    free = counts.pop("–", 0)
    if not counts:
        return "No limit is active; the objective alone determines the preloads."
    if len(problem.elements) == 1:
        return f"Active limit: {next(iter(counts))}{_active_case(problem, solution)}."
    if len(counts) == 1 and not free:
        limit = f"{next(iter(counts))}{_active_case(problem, solution)}"
        return f"Active limit of all connections: {limit}."
    parts = [f"{why} in {count}" for why, count in sorted(counts.items(), key=lambda e: -e[1])]
    rest = f"; none in {free}" if free else ""
    return f"Active limits by number of connections: {listed(parts)}{rest}."


def _active_case(problem: PreloadProblem, solution: PreloadSolution) -> str:
    """Return the load case of a single active limit, if there are several load cases."""
    cases = {row.case for row in solution.rows if row.active and row.case}
    return f" at {cases.pop()}" if len(cases) == 1 and len(solution.cases) > 1 else ""


def stiffness_gains(problem: PreloadProblem, solution: PreloadSolution) -> dict[int, float]:
    """Return the ratio of least stiffness, recommended over present preload, by joint.

    The ratio is nan for a joint that slips with the present preload.
    """
    before, after = solution.stiffness_before.min(axis=1), solution.stiffness.min(axis=1)
    return {
        joint: float(new / old) if old > 0.0 else float("nan")
        for joint, old, new in zip(problem.joints, before, after, strict=True)
    }


def stiffness_sentence(
    problem: PreloadProblem, solution: PreloadSolution, front: ParetoFront | None = None
) -> str:
    """Return sentences on the change of stiffness from the present to the recommended preload.

    `front`: front from which the gain of more preload is taken. Empty without a usable design.
    """
    if not solution.status.usable:
        return ""
    compared = all(element.preload_known for element in problem.elements)
    gains = stiffness_gains(problem, solution)
    slipping = [f"joint {joint}" for joint, gain in gains.items() if np.isnan(gain)]
    known = {joint: gain for joint, gain in gains.items() if not np.isnan(gain)}
    parts = []
    if slipping and compared:
        parts.append(
            "The present preload is insufficient: at the lower end of the tightening scatter "
            f"{_slip_phrase(slipping)}."
        )
    if known and compared:
        parts.append(_stiffness_change_sentence(known))
    room = front_gain(front)
    small = [abs(gain - 1.0) < _SMALL_STIFFNESS_GAIN for gain in known.values()] if compared else []
    if room is not None:
        small.append(room < _SMALL_STIFFNESS_GAIN)
    if small and all(small) and _is_slip_limited(solution):
        more = (
            ""
            if room is None
            else f"The largest preload within the limits would add {_format_gain(room)}: "
        )
        parts.append(f"{more}{'slip' if more else 'Slip'}, not stiffness, determines the preload.")
    return " ".join(parts)


def front_gain(front: ParetoFront | None) -> float | None:
    """Return the relative gain in stiffness over the front, or None without one."""
    if front is None or not front.points[0].level > 0.0:
        return None
    return front.points[-1].level / front.points[0].level - 1.0


def weakest_sentence(shares: Mapping[int, Sequence[WindupShare]], free: Collection[str]) -> str:
    """Return a sentence on the most compliant element, overall and among those with free preload.

    `shares`: shares in one load case each. `free`: names of the elements with free preload.
    """
    worst = {joint: max(own, key=lambda each: each.share) for joint, own in shares.items()}
    names = {each.element for each in worst.values()}
    sizes = [each.share for each in worst.values()]
    if len(names) == 1:
        where = "" if len(worst) == 1 else " in every joint"
        low, high = (percent(size) for size in (min(sizes), max(sizes)))
        size = high if low == high else f"{low.removesuffix(' %')} to {high}"
        text = f"Most compliant element: {readable(names.pop())}{where}, {size} of the wind-up"
    else:
        each = (f"{readable(w.element)} in joint {joint}" for joint, w in worst.items())
        text = f"Most compliant elements: {listed(each)}"
    own = [each for each in itertools.chain(*shares.values()) if each.element in free]
    if not own or all(each.element in free for each in worst.values()):
        return f"{text}."
    most = max(own, key=lambda each: each.share)
    joint = f" of joint {most.joint}" if len(worst) > 1 else ""
    return (
        f"{text}; among the tightened connections: {readable(most.element)}{joint}, "
        f"{percent(most.share)}."
    )


def _format_gain(gain: float) -> str:
    return "no stiffness" if gain < UNCHANGED else f"{percent(gain)} of stiffness"


def _stiffness_change_sentence(gains: dict[int, float]) -> str:
    if len(gains) == 1:
        joint, gain = next(iter(gains.items()))
        return (
            "From the present to the recommended preload the stiffness of "
            f"joint {joint} changes by {change(gain)}."
        )
    low, high = min(gains, key=lambda j: gains[j]), max(gains, key=lambda j: gains[j])
    if all(abs(gain - 1.0) < UNCHANGED for gain in gains.values()):
        return "From the present to the recommended preload no joint's stiffness changes."
    if change(gains[low]) == change(gains[high]):
        each = f"{change(gains[low])} in each of {len(gains)} joints"
    else:
        each = f"{change(gains[low])} (joint {low}) to {change(gains[high])} (joint {high})"
    return f"From the present to the recommended preload the stiffness changes by {each}."


def _is_slip_limited(solution: PreloadSolution) -> bool:
    active = {row.kind for row in solution.rows if row.active}
    return "slip safety" in active and not active & {"joint stiffness", "tool deflection"}


def cautions(problem: PreloadProblem, solution: PreloadSolution) -> list[str]:
    """Return a sentence for each kind of warning that a usable design exceeds, the worst first.

    Warnings on joints that slip outside the study and on the friction of stainless bolts are added.
    """
    if not solution.status.usable:
        return []
    over: dict[str, list[UtilisationRow]] = {}
    for row in sorted(solution.rows, key=lambda row: -row.utilisation):
        if not row.binding and row.utilisation > 1.0:
            over.setdefault(row.kind, []).append(row)
    return [
        *_slip_outside(problem, solution),
        *(_warning_sentence(own) for own in over.values()),
        *_stainless_friction(problem),
    ]


def _slip_outside(problem: PreloadProblem, solution: PreloadSolution) -> Iterator[str]:
    """Yield a warning for joints that slip in a load case with a pose, at preloads as they are."""
    slips = [
        case.name
        for case, d in zip(solution.cases, solution.deflection, strict=True)
        if np.isinf(d)
    ]
    if slips:
        model = PreloadModel(problem, solution.cases)
        turned = {j: model.net_windups(solution.vector, j) for j in range(1, problem.robot.n + 1)}
        joints = [f"joint {j}" for j, angles in turned.items() if not np.isfinite(angles).all()]
        yield (
            f"{_slip_phrase(joints)} under {listed(slips)} with the preloads of the robot file, so "
            "the tool is not held there. The study tightens other connections only: add these to "
            "joints or free."
        )


def _slip_phrase(joints: Sequence[str]) -> str:
    return f"{listed(joints)} {'slips' if len(joints) == 1 else 'slip'}"


def _stainless_friction(problem: PreloadProblem) -> Iterator[str]:
    """Yield a warning for stainless bolts: unlubricated threads gall, with undefined friction."""
    grades = {
        flange.bolt.grade
        for flange in (element.stage.element for element in problem.elements)
        if isinstance(flange, BoltedFlange) and flange.bolt is not None
    }
    stainless = sorted(grade for grade in grades if not catalogue.bolt_grade(grade).heat_treated)
    if stainless:
        friction = problem.tightening.thread_friction
        yield (
            f"bolts {listed(stainless)} gall in dry threads: thread_friction = {friction:g} must "
            "be that of the lubricant in use. State it in [tightening], with friction_highest "
            "where it scatters."
        )


def _warning_sentence(rows: Sequence[UtilisationRow]) -> str:
    owners = list(dict.fromkeys(owner_name(row) for row in rows))
    more = len(owners) - _MAX_NAMED_CONNECTIONS
    where = (
        listed(owners)
        if more < 1
        else f"{', '.join(owners[:_MAX_NAMED_CONNECTIONS])} and {more} more"
    )
    worst = rows[0]
    used = percent(worst.utilisation, 3) if math.isfinite(worst.utilisation) else "any multiple"
    of = "" if is_factor(worst.utilisation) else " of"
    return (
        f"{worst.kind} is at {used}{of} its limit in {where}. It does not exclude the design:"
        f" {worst.warns}. Remedy: {worst.remedy}."
    )
