"""Catalogue designs of a study in numbers: what each adds to compliance and tool deflection.

Compliances of connections in series add up. So do wind-ups, of which the tool's deflection is a
linear map; its size is bounded from below by its part along a fixed direction, which adds up too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from stiffopt.drivetrain import catalogue
from stiffopt.drivetrain.chain import Chain
from stiffopt.drivetrain.stage import Stage
from stiffopt.errors import ProblemError
from stiffopt.exact.chain import exact_compliance, exact_windup
from stiffopt.preload.candidates import CatalogueDesign
from stiffopt.preload.load_case import LoadCase
from stiffopt.preload.menus import Menu, Rows
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.nlp import Levels

# Ties: fewer bolts, then smaller sizes, then lower grades, one digit group each.
_BOLTS, _SIZES = 1e6, 1e3


@dataclass(frozen=True, eq=False)
class ChoiceTable:
    """Menus and rows of a study, and the exact amounts of a combination.

    Parameters
    ----------
    menus : tuple of Menu
        In the order of the study's elements; costs are total preloads.
    rows : Rows
        Joint stiffness as compliance [rad/(N m)], tool deflection [m], bolt utilisation.
    joints : tuple of int or None
        Joint of each row; None for rows of no single joint.
    amounts : callable
        Of a combination, by positions in the menus.
    """

    menus: tuple[Menu, ...]
    rows: Rows
    joints: tuple[int | None, ...]
    amounts: Callable[[tuple[int, ...]], np.ndarray]


@dataclass(frozen=True, eq=False)
class _Block:
    """Rows of one kind: what the elements add, and the columns that compare designs."""

    names: list[str]
    joints: list[int | None]
    base: np.ndarray
    cap: np.ndarray
    weight: np.ndarray
    uses: list[np.ndarray]
    orders: list[np.ndarray]


def choice_table(
    model: PreloadModel, designs: Sequence[Sequence[CatalogueDesign]], levels: Levels
) -> ChoiceTable:
    """Work out what every design adds.

    Parameters
    ----------
    model : PreloadModel
    designs : one sequence of CatalogueDesign an element
        That each keep the limits of their own connection.
    levels : Levels
        Weights of the stiffnesses.
    """
    sites = [_site(model, index) for index in range(len(model.elements))]
    blocks = [_compliance_rows(model, designs, sites, levels), _utilisation_rows(model, designs)]
    needs = model.problem.requirements
    deflects = needs.tool_deflection is not None or model.problem.objective == "tool_deflection"
    deflection = _Deflection(model, designs, sites) if deflects else None
    if deflection:
        blocks.append(deflection.rows())
    rows = Rows(
        tuple(name for block in blocks for name in block.names),
        np.concatenate([block.base for block in blocks]),
        np.concatenate([block.cap for block in blocks]),
        np.concatenate([block.weight for block in blocks]),
    )
    menus = tuple(
        Menu(
            block=model.elements[i].joint,
            cost=np.array([d.total_preload for d in own]),
            tie=_ties(own),
            use=np.hstack([block.uses[i] for block in blocks]),
            order=np.hstack([block.orders[i] for block in blocks]),
        )
        for i, own in enumerate(designs)
    )

    def amounts(picks: tuple[int, ...]) -> np.ndarray:
        used = rows.base.copy()
        for menu, pick in zip(menus, picks, strict=True):
            used = used + menu.use[pick]
        if deflection:
            used[-len(deflection.cases) :] = deflection.sizes(picks)
        return used

    joints = tuple(joint for block in blocks for joint in block.joints)
    return ChoiceTable(menus, rows, joints, amounts)


def _ties(designs: Sequence[CatalogueDesign]) -> np.ndarray:
    """Count, then rank of size and grade among these designs."""
    bolts = [d for d in designs if d.grade]  # set screws keep their size and have no grade
    sizes = sorted({d.size for d in bolts}, key=lambda s: catalogue.bolt(s).diameter)
    grades = sorted({d.grade for d in bolts}, key=catalogue.proof_stress)
    ranks = [(sizes.index(d.size), grades.index(d.grade)) for d in bolts] or [(0, 0)] * len(designs)
    return np.array(
        [
            _BOLTS * d.count + _SIZES * size + grade
            for d, (size, grade) in zip(designs, ranks, strict=True)
        ]
    )


def _site(model: PreloadModel, index: int) -> tuple[Stage, ...]:
    """Stages that are parallel to an element, itself among them."""
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


def _chain(design: CatalogueDesign, site: tuple[Stage, ...]) -> Chain:
    """What a design makes of its site, at its least preload."""
    least = design.stage.element.with_preload(design.least_preload)
    name = least.name
    stages = [
        Stage(least if s.element.name == name else s.element, s.ratio, s.efficiency, s.group)
        for s in site
    ]
    return Chain(tuple(stages), reflect=site[0].reflect)


def _distinct(
    designs: Sequence[CatalogueDesign], value: Callable[[CatalogueDesign], np.ndarray]
) -> np.ndarray:
    """Values of all designs; those of the same number and preload are worked out once."""
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
) -> _Block:
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
            use[:, start : start + len(cases)] = _distinct(
                own,
                lambda d, site=site, at=at: exact_compliance(_chain(d, site), at),  # type: ignore[misc]
            )
        uses.append(use)
    rest = [model.rest_compliance(j, torques[j]) for j in joints]
    return _Block(
        names=[f"joint stiffness, joint {j}, {case.name}" for j in joints for case in cases],
        joints=[j for j in joints for _ in cases],
        base=np.concatenate([np.zeros(0), *rest]),
        cap=np.repeat([1.0 / needed[j] if j in needed else np.inf for j in joints], len(cases)),
        weight=np.repeat([levels.stiffness[j] if wanted else 0.0 for j in joints], len(cases)),
        uses=uses,
        orders=uses,
    )


def _utilisation_rows(model: PreloadModel, designs: Sequence[Sequence[CatalogueDesign]]) -> _Block:
    """One row an element where the largest utilisation is the objective."""
    wanted = model.problem.objective == "bolt_utilisation"
    count = len(model.elements) if wanted else 0
    uses = []
    for index, own in enumerate(designs):
        use = np.zeros((len(own), count))
        if wanted:
            use[:, index] = [d.load for d in own]
        uses.append(use)
    return _Block(
        names=[f"bolt utilisation, {e.key}" for e in model.elements[:count]],
        joints=[e.joint for e in model.elements[:count]],
        base=np.zeros(count),
        cap=np.full(count, np.inf),
        weight=np.ones(count),
        uses=uses,
        orders=uses,
    )


class _Deflection:
    """Tool deflections of all combinations: vectors that add up, and their exact sizes."""

    def __init__(
        self,
        model: PreloadModel,
        designs: Sequence[Sequence[CatalogueDesign]],
        sites: Sequence[tuple[Stage, ...]],
    ) -> None:
        self.cases = [case for case in model.cases if case.jacobian is not None]
        self._model = model
        self._joints = [e.joint for e in model.elements]
        self._windups = [
            np.column_stack(
                [
                    _net(
                        case,
                        joint,
                        lambda at, own=own, site=site: _distinct(  # type: ignore[misc]
                            own, lambda d: exact_windup(_chain(d, site), at)
                        ),
                    )
                    for case in self.cases
                ]
            )
            for joint, own, site in zip(self._joints, designs, sites, strict=True)
        ]
        self._rest = np.array([self._fixed(case) for case in self.cases])

    def _fixed(self, case: LoadCase) -> np.ndarray:
        """Deflection by all that no design changes (3,) [m]."""
        model = self._model
        angles = [
            _net(case, j, lambda at, j=j: model.rest_windup(j, at)[None, :])[0]  # type: ignore[misc]
            for j in range(1, model.problem.robot.n + 1)
        ]
        return np.asarray(-self._jacobian(case) @ np.array(angles))

    @staticmethod
    def _jacobian(case: LoadCase) -> np.ndarray:
        assert case.jacobian is not None
        return case.jacobian

    def sizes(self, picks: tuple[int, ...]) -> np.ndarray:
        """Deflection of a combination (cases,) [m]."""
        found = []
        for k, case in enumerate(self.cases):
            vector = self._rest[k].copy()
            for joint, windups, pick in zip(self._joints, self._windups, picks, strict=True):
                vector -= self._jacobian(case)[:, joint - 1] * windups[pick, k]
            found.append(float(np.linalg.norm(vector)))
        return np.array(found)

    def rows(self) -> _Block:
        """Deflection along the direction that it has with middling designs."""
        problem = self._model.problem
        allowed = problem.requirements.tool_deflection
        wanted = problem.objective == "tool_deflection"
        count = len(self.cases)
        uses = [np.zeros_like(windups) for windups in self._windups]
        orders = [np.zeros((len(windups), 2 * count)) for windups in self._windups]
        base = np.zeros(count)
        for k, case in enumerate(self.cases):
            jacobian = self._jacobian(case)
            middle = self._rest[k].copy()
            for joint, windups in zip(self._joints, self._windups, strict=True):
                middle -= jacobian[:, joint - 1] * (windups[:, k].min() + windups[:, k].max()) / 2
            size = float(np.linalg.norm(middle))
            along = middle / size if size > 0.0 else np.zeros(3)
            base[k] = along @ self._rest[k]
            for i, (joint, windups) in enumerate(zip(self._joints, self._windups, strict=True)):
                uses[i][:, k] = -(along @ jacobian[:, joint - 1]) * windups[:, k]
                smaller, larger = self._directions(k, jacobian, joint)
                orders[i][:, 2 * k] = smaller * windups[:, k]
                orders[i][:, 2 * k + 1] = larger * windups[:, k]
        return _Block(
            names=[f"tool deflection, {case.name}" for case in self.cases],
            joints=[None] * count,
            base=base,
            cap=np.full(count, np.inf if allowed is None else allowed),
            weight=np.full(count, float(wanted)),
            uses=uses,
            orders=orders,
        )

    def _directions(self, k: int, jacobian: np.ndarray, joint: int) -> tuple[float, float]:
        """Signs with which a smaller wind-up of a joint never deflects the tool more.

        The square of the deflection grows with the wind-up while the deflection has a part along
        the motion that the joint gives the tool. Where that part has one sign for all combinations,
        one direction of the wind-up is never worse; where not, only equal wind-ups compare.
        """
        motion = -jacobian[:, joint - 1]
        low = high = float(motion @ self._rest[k])
        for other, windups in zip(self._joints, self._windups, strict=True):
            parts = float(motion @ -jacobian[:, other - 1]) * windups[:, k]
            low, high = low + float(parts.min()), high + float(parts.max())
        if low >= 0.0:
            return 1.0, 0.0
        return (-1.0, 0.0) if high <= 0.0 else (1.0, -1.0)


def _net(case: LoadCase, joint: int, windup: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Wind-ups (m,) beyond those of the reference torque [rad]; `windup` gives (m, torques)."""
    torques = [case.torque[joint - 1]]
    if case.reference_torque is not None:
        torques.append(case.reference_torque[joint - 1])
    angles = windup(np.array(torques))
    return np.asarray(angles[:, 0] - angles[:, 1] if len(torques) == 2 else angles[:, 0])
