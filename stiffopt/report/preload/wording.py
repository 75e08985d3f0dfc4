"""Sentences of a preload report: headline, what sets each preload, what stiffness gains."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from stiffopt.report.common.quantities import significant
from stiffopt.report.preload.names import UNCHANGED, change, fastener_words, listed, spoken

if TYPE_CHECKING:
    from stiffopt.preload.pareto import ParetoFront
    from stiffopt.preload.problem import PreloadProblem
    from stiffopt.preload.sensitivity import WindupShare
    from stiffopt.preload.solution import PreloadSolution

# Below this relative change of stiffness the preload is set by something else.
_SMALL = 0.02


def sets(solution: PreloadSolution, key: str, joint: int) -> str:
    """What an element's preload is set by: its own active limits, else its joint's, else a dash."""
    own = [row.kind for row in solution.rows if row.active and row.element == key]
    if not own:
        shared = (None, joint)
        own = [r.kind for r in solution.rows if r.active and not r.element and r.joint in shared]
    return listed(dict.fromkeys(own)) or "–"


def headline(problem: PreloadProblem, solution: PreloadSolution) -> str:
    """What to tighten to, in one line."""
    if not solution.status.usable:
        if solution.stoppers:
            return "No preload meets this study"
        return f"No design to use: {str(solution.status).replace('_', ' ')}"
    if len(problem.elements) == 1:
        element = problem.elements[0]
        torque = solution.tightening[element.key]
        what = f"the {fastener_words([element])} of the {spoken(element.key)}"
        force = f"{significant(solution.preloads[element.key] / 1e3, 3)} kN"
        if torque is None:
            return f"Press {what} with {force} each at most"
        return f"Tighten {what} to {significant(torque.nominal, 3)} N m ({force} each at most)"
    total = significant(solution.total_preload / 1e3, 3)
    return f"Tighten {len(problem.elements)} connections as listed, {total} kN in all"


def what_binds(problem: PreloadProblem, solution: PreloadSolution) -> str:
    """Sentence on the limits at which the design lies."""
    if not solution.status.usable:
        return ""
    counts: dict[str, int] = {}
    for element in problem.elements:
        why = sets(solution, element.key, element.joint)
        counts[why] = counts.get(why, 0) + 1
    free = counts.pop("–", 0)
    if not counts:
        return "No limit binds; the objective alone sets the preloads."
    if len(problem.elements) == 1:
        return f"It is set by {next(iter(counts))}{_where(problem, solution)}."
    if len(counts) == 1 and not free:
        return f"All are set by {next(iter(counts))}{_where(problem, solution)}."
    parts = [f"{why} in {count}" for why, count in sorted(counts.items(), key=lambda e: -e[1])]
    rest = f"; {free} at no limit" if free else ""
    return f"They are set by {listed(parts)}{rest}."


def _where(problem: PreloadProblem, solution: PreloadSolution) -> str:
    """Load case of a single active row, where there is a choice of load cases."""
    cases = {row.case for row in solution.rows if row.active and row.case}
    return f" at {cases.pop()}" if len(cases) == 1 and len(solution.cases) > 1 else ""


def stiffness_gains(problem: PreloadProblem, solution: PreloadSolution) -> dict[int, float]:
    """Least stiffness over the load cases, recommended over present preload, by joint.

    A joint that slips with the present preload has nan: its stiffness there means nothing.
    """
    before, after = solution.stiffness_before.min(axis=1), solution.stiffness.min(axis=1)
    return {
        joint: float(new / old) if old > 0.0 else float("nan")
        for joint, old, new in zip(problem.joints, before, after, strict=True)
    }


def stiffness_sentence(
    problem: PreloadProblem, solution: PreloadSolution, front: ParetoFront | None = None
) -> str:
    """How stiffness changes from the present to the recommended preload; small is said as small.

    Parameters
    ----------
    problem : PreloadProblem
    solution : PreloadSolution
    front : ParetoFront, optional
        Tells what more preload would gain.

    Returns
    -------
    str
        Empty where there is no design to use.
    """
    if not solution.status.usable:
        return ""
    gains = stiffness_gains(problem, solution)
    slipping = [f"joint {joint}" for joint, gain in gains.items() if np.isnan(gain)]
    known = {joint: gain for joint, gain in gains.items() if not np.isnan(gain)}
    parts = []
    if slipping:
        verb = "slips" if len(slipping) == 1 else "slip"
        parts.append(
            "The present preload is not enough: where tightening scatters to its least, "
            f"{listed(slipping)} {verb}."
        )
    if known:
        parts.append(_changes(known))
    room = front_gain(front)
    small = [abs(gain - 1.0) < _SMALL for gain in known.values()]
    if room is not None:
        small.append(room < _SMALL)
    if small and all(small) and _slip_decides(solution):
        more = (
            ""
            if room is None
            else f"All the preload that the limits allow would add {_plus(room)}: "
        )
        parts.append(f"{more}{'slip' if more else 'Slip'}, not stiffness, sets the preload.")
    return " ".join(parts)


def front_gain(front: ParetoFront | None) -> float | None:
    """Relative gain in stiffness from the least to the most preload; None without a front."""
    if front is None or not front.points[0].level > 0.0:
        return None
    return front.points[-1].level / front.points[0].level - 1.0


def weakest_sentence(shares: Mapping[int, Sequence[WindupShare]], free: Collection[str]) -> str:
    """Name the weakest spring of the joints, and of the connections that the study tightens.

    Parameters
    ----------
    shares : mapping of joint number to shares
        Of one load case each.
    free : collection of str
        Names of the elements that the study tightens.
    """
    worst = {joint: max(own, key=lambda each: each.share) for joint, own in shares.items()}
    names = {each.element for each in worst.values()}
    sizes = [each.share for each in worst.values()]
    if len(names) == 1:
        where = "" if len(worst) == 1 else " in every joint"
        low, high = (significant(100 * size, 2) for size in (min(sizes), max(sizes)))
        size = low if low == high else f"{low} to {high}"
        text = f"The weakest spring is the {spoken(names.pop())}{where}, with {size} % of wind-up"
    else:
        each = (f"the {spoken(w.element)} in joint {joint}" for joint, w in worst.items())
        text = f"The weakest spring is {listed(each)}"
    own = [each for each in itertools.chain(*shares.values()) if each.element in free]
    if not own or all(each.element in free for each in worst.values()):
        return f"{text}."
    most = max(own, key=lambda each: each.share)
    joint = f" of joint {most.joint}" if len(worst) > 1 else ""
    return (
        f"{text}; of what this study tightens it is the {spoken(most.element)}{joint}, with "
        f"{significant(100 * most.share, 2)} %."
    )


def _plus(gain: float) -> str:
    return "no stiffness" if gain < UNCHANGED else f"{significant(100 * gain, 2)} % of stiffness"


def _changes(gains: dict[int, float]) -> str:
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


def _slip_decides(solution: PreloadSolution) -> bool:
    active = {row.kind for row in solution.rows if row.active}
    return "slip safety" in active and not active & {"joint stiffness", "tool deflection"}
