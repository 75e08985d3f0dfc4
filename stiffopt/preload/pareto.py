"""Pareto front between total preload and stiffness, with its knee.

Epsilon-constraint method: the least total preload for a stiffness level, over levels from that of
the least preloads to the largest within the limits. Each point is an optimum with its residual.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from stiffopt.errors import NoSolutionFound
from stiffopt.preload.infeasibility import find_stoppers
from stiffopt.preload.load_case import LoadCase
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.nlp import Levels, PreloadNlp
from stiffopt.preload.optimise import Optimum, ProgressReport, objective_levels, optimum
from stiffopt.preload.problem import PreloadProblem
from stiffopt.preload.utilisation import utilisation_rows

# Relative difference of equal levels.
_LEVEL_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class ParetoPoint:
    """Least preloads for a level of stiffness."""

    total_preload: float  # sum of the preloads of all bolts and pins [N]
    level: float  # least k_j / weight_j over joints and load cases [-]
    # Least over the load cases of each joint, by the exact law [N m/rad].
    stiffness: tuple[float, ...]
    # By element key: largest assembly preload, mean of individual ones [N].
    preloads: Mapping[str, float]
    active: tuple[str, ...]  # names of the active requirements
    kkt_residual: float  # see `stiffopt.solver.ipopt.kkt_residual`


@dataclass(frozen=True, eq=False)
class ParetoFront:
    """Designs of which none has both less preload and more stiffness than another."""

    points: tuple[ParetoPoint, ...]  # by ascending total preload
    knee: int  # position of the knee in `points`
    knee_reason: str  # definition and location of the knee
    note: str  # gain along the front
    # By joint number: stiffness of level 1 [N m/rad]: given, or that at the largest preloads.
    weights: Mapping[int, float]
    interrupted: bool = False  # stopped by Ctrl-C; the points are those found so far


def pareto_front(
    problem: PreloadProblem,
    cases: Sequence[LoadCase],
    points: int = 15,
    *,
    progress: ProgressReport | None = None,
) -> ParetoFront:
    """Compute the front of least total preload over required stiffness.

    Other requirements hold along the front; loads stay `cases`. `points` levels are evenly spaced,
    some more are added beside the knee; a single point if the limits fix the stiffness. Raises
    `NoSolutionFound` where no preload satisfies the other requirements.
    """
    trace = _FrontTrace(problem, tuple(cases), progress)
    least, most = trace.least_level, trace.most_level
    if most - least <= _LEVEL_TOLERANCE * most:
        found = [trace.least]
    else:
        levels = np.linspace(least, most, max(points, 2))[1:-1]
        found = [trace.least, *trace.points(levels), *trace.end()]
        # Number of bisections of the intervals beside the knee.
        for _ in range(2):
            at = _knee_position(found)
            beside = [(a.level + b.level) / 2 for a, b in pairwise(found[max(at - 1, 0) : at + 2])]
            found = sorted([*found, *trace.points(beside)], key=lambda p: p.level)
    knee = _knee_position(found)
    return ParetoFront(
        points=tuple(found),
        knee=knee,
        knee_reason=_knee_reason(found, knee),
        note=" ".join(filter(None, (_describe_front(found), trace.left_out))),
        weights=trace.levels.stiffness,
        interrupted=trace.interrupted,
    )


class _FrontTrace:
    """Solver of the points of one front."""

    def __init__(
        self, problem: PreloadProblem, cases: tuple[LoadCase, ...], progress: ProgressReport | None
    ) -> None:
        self.progress, self.cases = progress, cases
        needs = replace(problem.requirements, joint_stiffness={})
        self.problem = replace(problem, requirements=needs)
        model = PreloadModel(self.problem, cases)
        self.levels: Levels = objective_levels(model)
        self.model = model
        self.unproved, self.interrupted = 0, False
        nlp = PreloadNlp(model, "total_preload", self.levels)
        stoppers = find_stoppers(nlp)
        if stoppers:
            raise NoSolutionFound(
                "No preload satisfies the limits, so there is no front. "
                + " ".join(str(stop) for stop in stoppers)
            )
        end = self._solve_proved(model, "total_preload")
        if end is None:
            raise NoSolutionFound(
                "The least preload of the front was not found. Where nobody stopped it, the "
                "requirements conflict: solve the study alone to see which."
            )
        self.least = self._pareto_point(model, end.preloads, end.kkt_residual)
        self.least_level = self.least.level
        self.most_level = float(np.min(self._stiffness_levels(nlp.bounds()[1])))

    def points(self, levels: Sequence[float] | np.ndarray) -> list[ParetoPoint]:
        """Return proved optima at these levels; others are omitted and counted."""
        found = []
        for level in levels:
            if self.interrupted:
                break
            model = self._at_level(float(level), self.problem.joints)
            best = self._solve_proved(model, "total_preload")
            if best is not None:
                found.append(self._pareto_point(model, best.preloads, best.kkt_residual))
        return found

    def end(self) -> list[ParetoPoint]:
        """Return the point of largest stiffness within the limits, at least preload.

        Limits and level leave no interior there for an interior-point method: the joints that limit
        the level get their stiffest preloads, the others the least for the same level.
        """
        most = None if self.interrupted else self._solve_proved(self.model, "joint_stiffness")
        if most is None:
            return []
        levels, preloads = self._stiffness_levels(most.preloads), most.preloads.copy()
        level, residual = float(levels.min()), most.kkt_residual
        ends = levels <= level * (1.0 + _LEVEL_TOLERANCE)
        others = tuple(j for j, end in zip(self.problem.joints, ends, strict=True) if not end)
        if others:
            rest = self._solve_proved(self._at_level(level, others), "total_preload")
            if rest is None:
                return []
            for element, part in zip(self.model.elements, self.model.slices, strict=True):
                if element.joint in others:
                    preloads[part] = rest.preloads[part]
            residual = max(residual, rest.kkt_residual)
        return [self._pareto_point(self._at_level(level, self.problem.joints), preloads, residual)]

    def _at_level(self, level: float, joints: tuple[int, ...]) -> PreloadModel:
        needed = {joint: level * self.levels.stiffness[joint] for joint in joints}
        needs = replace(self.problem.requirements, joint_stiffness=needed)
        return PreloadModel(replace(self.problem, requirements=needs), self.cases)

    def _solve_proved(self, model: PreloadModel, objective: str) -> Optimum | None:
        """Return a proved optimum; None and counted without proof."""
        found = optimum(model, objective, levels=self.levels, progress=self.progress)
        if found.proved:
            return found
        self.interrupted = found.raw.status == "interrupted"
        self.unproved += 1
        return None

    @property
    def left_out(self) -> str:
        """Message about omitted points; "" without any."""
        if self.interrupted:
            return "Stopped by the user; the front holds the points found so far."
        if self.unproved:
            return f"Points that did not converge and are left out: {self.unproved}."
        return ""

    def _stiffness_levels(self, preloads: np.ndarray) -> np.ndarray:
        """Return the least stiffness of each joint over its weight (joints,)."""
        weights = [self.levels.stiffness[joint] for joint in self.problem.joints]
        return np.asarray(self.model.exact_stiffness(preloads).min(axis=1) / weights)

    def _pareto_point(
        self, model: PreloadModel, preloads: np.ndarray, residual: float
    ) -> ParetoPoint:
        means = {
            e.key: float(np.mean(preloads[part]))
            for e, part in zip(model.elements, model.slices, strict=True)
        }
        stiffness = model.exact_stiffness(preloads).min(axis=1)
        return ParetoPoint(
            total_preload=sum(e.count * means[e.key] for e in model.elements),
            level=float(self._stiffness_levels(preloads).min()),
            stiffness=tuple(float(k) for k in stiffness),
            preloads=means,
            active=tuple(r.name for r in utilisation_rows(model, preloads) if r.active),
            kkt_residual=residual,
        )


def _chord_distances(points: Sequence[ParetoPoint]) -> np.ndarray:
    """Return the distance of each point from the chord, both axes scaled to 0 to 1."""
    total = np.array([p.total_preload for p in points])
    level = np.array([p.level for p in points])
    x = (total - total[0]) / (total[-1] - total[0])
    y = (level - level[0]) / (level[-1] - level[0])
    return np.asarray((y - x) / np.sqrt(2.0))


def _knee_position(points: Sequence[ParetoPoint]) -> int:
    return int(np.argmax(_chord_distances(points))) if len(points) > 2 else 0


def _knee_reason(points: Sequence[ParetoPoint], knee: int) -> str:
    at = points[knee]
    share = 100 * at.level / points[-1].level
    place = f"{at.total_preload / 1e3:.1f} kN in all, {share:.2f} % of the largest stiffness"
    if len(points) < 3:
        return f"Too few points for a knee; the least preload is used: {place}."
    distance = float(_chord_distances(points)[knee])
    return (
        "The knee is the point farthest from the chord between the ends, with both axes scaled to "
        f"run from 0 to 1 (distance {distance:.2f}; 0 is a straight front, 0.71 a corner): {place}."
    )


def _describe_front(points: Sequence[ParetoPoint]) -> str:
    first, last = points[0], points[-1]
    if len(points) == 1:
        return (
            "The front is a single point: at the least preload the stiffness is already the "
            "largest within the limits."
        )
    if not first.level > 0.0:
        # A joint without load may have no preload left after scatter and losses.
        return (
            "At the least preload a connection without load has no clamp force, so the relative"
            " gain in stiffness is undefined."
        )
    quantity = "stiffness" if len(first.stiffness) == 1 else "the least relative stiffness"
    gain, more = last.level / first.level - 1.0, last.total_preload / first.total_preload - 1.0
    text = (
        f"From the least to the most preload, {100 * more:.0f} % more in all, {quantity} rises by "
        f"{100 * gain:.3g} %"
    )
    # Relative stiffness gain along the front below which it is called flat.
    if gain < 0.05:
        return f"{text}: the front is nearly flat, so tightening buys hardly any stiffness."
    return f"{text}."
