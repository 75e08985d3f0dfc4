"""Mixed-integer programme of catalogue designs: contributions to compliance and deflection.

Compliances of connections in series add up, and so do wind-ups, of which the tool deflection is a
linear map: the choice of designs is a mixed-integer programme, linear except for the convex norm of
the deflection.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.drivetrain import catalogue
from stiffopt.drivetrain.chain import Chain, Stage
from stiffopt.errors import ProblemError
from stiffopt.exact.chain import exact_compliance, exact_windup
from stiffopt.preload.catalogue_designs import CatalogueDesign
from stiffopt.preload.flange_loads import tilt_deflection
from stiffopt.preload.load_case import LoadCase
from stiffopt.preload.model import RELATIVE_ROUNDING, PreloadModel
from stiffopt.preload.nlp import Levels


@dataclass(frozen=True, eq=False)
class ChoiceProgramme:
    """Programme with one design per element: costs and contributions to each row."""

    # Of r linear rows (compliance of a joint [rad/(N m)], bolt utilisation [-]), then of k rows
    # that are norms of vectors (tool deflection [m]).
    names: tuple[str, ...]
    joints: tuple[int | None, ...]  # joint of each row; None if it concerns several
    # (m,) per element and design: total preload [N], cost in steps, and tie-breaking cost between
    # combinations of equal objective. All add up.
    cost: tuple[np.ndarray, ...]
    price: tuple[np.ndarray, ...]
    tie: tuple[np.ndarray, ...]
    use: tuple[np.ndarray, ...]  # (m, r) contributions of an element's designs to the linear rows
    vectors: tuple[np.ndarray, ...]  # (m, k, 3) contributions to the vectors of the norm rows
    base: np.ndarray  # (r,) constant part of the linear rows
    rest: np.ndarray  # (k, 3) constant part of the vectors
    cap: np.ndarray  # (r + k,) upper limits; infinite without a requirement
    weight: np.ndarray  # (r + k,) weights of the rows in a minimax objective; 0 if not part of it

    def deflections(self, picks: Sequence[int]) -> np.ndarray:
        """Return the vectors of a combination (k, 3), by positions of the designs."""
        return np.asarray(self.rest + sum(v[i] for v, i in zip(self.vectors, picks, strict=True)))

    def amounts(self, picks: Sequence[int]) -> np.ndarray:
        """Return the row values of a combination (r + k,)."""
        linear = self.base + sum(u[i] for u, i in zip(self.use, picks, strict=True))
        return np.concatenate([linear, np.linalg.norm(self.deflections(picks), axis=1)])

    @property
    def ends(self) -> np.ndarray:
        """Upper limits with rounding."""
        return np.asarray(self.cap * (1.0 + RELATIVE_ROUNDING))

    def least_amounts(self) -> np.ndarray:
        """Return lower bounds of the rows over all combinations (r + k,)."""
        base, parts = self._project_on_middle()
        return np.asarray(np.maximum(base + sum(own.min(axis=0) for own in parts), 0.0))

    def broken_alone(self) -> list[dict[int, str]]:
        """Return the designs that exceed a row even at the lower bounds of all others.

        One dict per element, from position to name of the row.
        """
        base, parts = self._project_on_middle()
        found: list[dict[int, str]] = []
        whole = base + sum(own.min(axis=0) for own in parts)
        for own in parts:
            over = whole - own.min(axis=0) + own > self.ends
            broken = np.flatnonzero(over.any(axis=1))
            found.append({int(i): self.names[int(np.argmax(over[i]))] for i in broken})
        return found

    def _project_on_middle(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return constants (r + k,) and contributions (m, r + k), vectors along one direction."""
        toward = self.middle_directions()
        base = np.concatenate([self.base, np.einsum("ki,ki->k", toward, self.rest)])
        parts = [
            np.hstack([use, np.einsum("ki,mki->mk", toward, vectors)])
            for use, vectors in zip(self.use, self.vectors, strict=True)
        ]
        return base, parts

    def middle_directions(self) -> np.ndarray:
        """Return unit vectors (k, 3) of the deflections at mid-range contributions."""
        middle = self.rest + sum((v.min(axis=0) + v.max(axis=0)) / 2 for v in self.vectors)
        size = np.linalg.norm(middle, axis=1, keepdims=True)
        return np.asarray(middle / np.where(size > 0.0, size, 1.0))


def choice_programme(
    model: PreloadModel, designs: Sequence[Sequence[CatalogueDesign]], levels: Levels
) -> ChoiceProgramme:
    """Compute the contributions of every design.

    `designs`: that satisfy the limits of their own connection. `levels`: weights of the joint
    stiffnesses.
    """
    sites = [_parallel_stages(model, index) for index in range(len(model.elements))]
    compliance = _compliance_rows(model, designs, sites, levels)
    utilisation = _utilisation_rows(model, designs)
    deflection = _deflection_rows(model, designs, sites)
    linear = (compliance, utilisation)
    return ChoiceProgramme(
        names=(*compliance.names, *utilisation.names, *deflection.names),
        joints=(*compliance.joints, *utilisation.joints, *deflection.joints),
        cost=tuple(np.array([d.total_preload for d in own]) for own in designs),
        price=tuple(np.array([d.cost for d in own]) for own in designs),
        tie=_tie_break_costs(designs),
        use=tuple(np.hstack([rows.added[i] for rows in linear]) for i in range(len(designs))),
        vectors=deflection.added,
        base=np.concatenate([rows.base for rows in linear]),
        rest=deflection.base,
        cap=np.concatenate([rows.cap for rows in (*linear, deflection)]),
        weight=np.concatenate([rows.weight for rows in (*linear, deflection)]),
    )


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows of one kind: names, joints, constants and contributions of each element's designs."""

    names: list[str]
    joints: list[int | None]
    base: np.ndarray
    cap: np.ndarray
    weight: np.ndarray
    added: tuple[np.ndarray, ...]


def _tie_break_costs(designs: Sequence[Sequence[CatalogueDesign]]) -> tuple[np.ndarray, ...]:
    """Return tie-breaking costs: bolt count, rank of size, rank of grade as digits."""
    digits = [_tie_break_digits(own) for own in designs]
    largest = sum(own.max(axis=0) for own in digits)
    grade = 1.0
    size = grade * (1.0 + largest[2])
    count = size * (1.0 + largest[1])
    return tuple(own @ np.array([count, size, grade]) for own in digits)


def _tie_break_digits(designs: Sequence[CatalogueDesign]) -> np.ndarray:
    """Return count, rank of size and rank of grade (m, 3); 0 ranks for set screws."""
    bolts = [d for d in designs if d.grade]
    sizes = sorted({d.size for d in bolts}, key=lambda s: catalogue.bolt(s).diameter)
    grades = sorted({d.grade for d in bolts}, key=catalogue.bolt_grades().index)
    return np.array(
        [
            (d.count, sizes.index(d.size), grades.index(d.grade)) if d.grade else (d.count, 0, 0)
            for d in designs
        ],
        dtype=float,
    )


def _parallel_stages(model: PreloadModel, index: int) -> tuple[Stage, ...]:
    """Return the stages in parallel with an element, itself included."""
    element = model.elements[index]
    if element.stage.group is None:
        return (element.stage,)
    chain = model.problem.robot.chains[element.joint - 1]
    assert chain is not None
    stages = tuple(s for s in chain.stages if s.group == element.stage.group)
    names = {s.element.name for s in stages}
    free = [e.name for e in model.elements if e.joint == element.joint and e.name in names]
    if len(free) > 1:
        raise ProblemError(
            f"Joint {element.joint}: {' and '.join(free)} are parallel to each other, and of "
            "parallel connections only one can be chosen from a catalogue. Name one of them in "
            "`free`, or leave [choose] out."
        )
    return stages


def _chain_with_design(design: CatalogueDesign, site: tuple[Stage, ...]) -> Chain:
    """Return the parallel stages with a design at its least preload."""
    least = design.stage.element.with_preload(design.least_preload)
    name = least.name
    stages = [
        Stage(least if s.element.name == name else s.element, s.ratio, s.efficiency, s.group)
        for s in site
    ]
    return Chain(tuple(stages), reflect=site[0].reflect)


def _evaluate_distinct(
    designs: Sequence[CatalogueDesign], value: Callable[[CatalogueDesign], np.ndarray]
) -> np.ndarray:
    """Return values of all designs, computed once per count and preload."""
    known: dict[tuple[int, float], np.ndarray] = {}
    for design in designs:
        key = (design.count, design.least_preload)
        if key not in known:
            known[key] = value(design)
    return np.array([known[d.count, d.least_preload] for d in designs])


def _compliance_rows(
    model: PreloadModel,
    designs: Sequence[Sequence[CatalogueDesign]],
    sites: Sequence[tuple[Stage, ...]],
    levels: Levels,
) -> _Rows:
    problem = model.problem
    needed = problem.requirements.joint_stiffness
    wanted = problem.objective == "joint_stiffness"
    joints = [j for j in problem.joints if wanted or j in needed]
    cases = model.cases
    torques = {j: np.array([case.torque[j - 1] for case in cases]) for j in joints}
    uses = []
    for element, own, site in zip(model.elements, designs, sites, strict=True):
        use = np.zeros((len(own), len(joints) * len(cases)))
        if element.joint in joints:
            start = joints.index(element.joint) * len(cases)
            at = torques[element.joint]
            use[:, start : start + len(cases)] = _evaluate_distinct(
                own,
                lambda d, site=site, at=at: exact_compliance(_chain_with_design(d, site), at),  # type: ignore[misc]
            )
        uses.append(use)
    rest = [model.rest_compliance(j, torques[j]) for j in joints]
    return _Rows(
        names=[f"joint stiffness, joint {j}, {case.name}" for j in joints for case in cases],
        joints=[j for j in joints for _ in cases],
        base=np.concatenate([np.zeros(0), *rest]),
        cap=np.repeat([1.0 / needed[j] if j in needed else np.inf for j in joints], len(cases)),
        weight=np.repeat([levels.stiffness[j] if wanted else 0.0 for j in joints], len(cases)),
        added=tuple(uses),
    )


def _utilisation_rows(model: PreloadModel, designs: Sequence[Sequence[CatalogueDesign]]) -> _Rows:
    """Return one row per element if the largest utilisation is the objective."""
    wanted = model.problem.objective == "bolt_utilisation"
    count = len(model.elements) if wanted else 0
    uses = []
    for index, own in enumerate(designs):
        use = np.zeros((len(own), count))
        if wanted:
            use[:, index] = [d.load for d in own]
        uses.append(use)
    return _Rows(
        names=[f"bolt utilisation, {e.key}" for e in model.elements[:count]],
        joints=[e.joint for e in model.elements[:count]],
        base=np.zeros(count),
        cap=np.full(count, np.inf),
        weight=np.ones(count),
        added=tuple(uses),
    )


def _deflection_rows(
    model: PreloadModel,
    designs: Sequence[Sequence[CatalogueDesign]],
    sites: Sequence[tuple[Stage, ...]],
) -> _Rows:
    """Return the deflection vectors of the tool, if required or minimised."""
    allowed = model.problem.requirements.tool_deflection
    wanted = model.problem.objective == "tool_deflection"
    matters = wanted or allowed is not None
    cases = [c for c in model.cases if c.jacobian is not None] if matters else []
    rest, added = (
        np.zeros((len(cases), 3)),
        [np.zeros((len(own), len(cases), 3)) for own in designs],
    )
    for k, case in enumerate(cases):
        assert case.jacobian is not None
        fixed = [
            _net_windups(case, j, lambda at, j=j: model.rest_windup(j, at)[None, :])[0]  # type: ignore[misc]
            for j in range(1, model.problem.robot.n + 1)
        ]
        rest[k] = -(case.jacobian @ np.array(fixed) + model.fixed_tilt(case))
        for element, own, site, vectors in zip(model.elements, designs, sites, added, strict=True):
            windups = _net_windups(
                case,
                element.joint,
                lambda at, own=own, site=site: _evaluate_distinct(  # type: ignore[misc]
                    own, lambda each: exact_windup(_chain_with_design(each, site), at)
                ),
            )
            vectors[:, k] = -np.outer(windups, case.jacobian[:, element.joint - 1])
            vectors[:, k] -= [
                tilt_deflection(d.stage, element.joint, case, d.least_preload) for d in own
            ]
    return _Rows(
        names=[f"tool deflection, {case.name}" for case in cases],
        joints=[None for _ in cases],
        base=rest,
        cap=np.full(len(cases), np.inf if allowed is None else allowed),
        weight=np.full(len(cases), float(wanted)),
        added=tuple(added),
    )


def _net_windups(
    case: LoadCase, joint: int, windup: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """Return wind-ups (m,) less those at reference torque [rad]; `windup` gives (m, torques)."""
    torques = [case.torque[joint - 1]]
    if case.reference_torque is not None:
        torques.append(case.reference_torque[joint - 1])
    angles = windup(np.array(torques))
    return np.asarray(angles[:, 0] - angles[:, 1] if len(torques) == 2 else angles[:, 0])
