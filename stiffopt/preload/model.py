"""Stiffness, wind-up, deflection and slip of a study's joints as functions of the preloads.

What a preload changes is a smooth law in the preload; all other elements come in as numbers of
their exact law at the torque of the load case, since neither changes during a study.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import casadi as ca
import numpy as np

from stiffopt.connection import BoltedFlange, ClampingPins, Connection
from stiffopt.drivetrain.chain import Chain, Stage
from stiffopt.errors import ProblemError
from stiffopt.exact.chain import exact_compliance, exact_windup, stage_windup
from stiffopt.fastening.tilting import closed_compliance, tilting_flange
from stiffopt.fastening.utilisation_row import UtilisationRow
from stiffopt.fastening.vdi_rows import vdi_rows
from stiffopt.fastening.verification import Verification
from stiffopt.preload.flange_loads import slip_safety, verification
from stiffopt.preload.load_case import LoadCase, LoadHistory
from stiffopt.preload.problem import FreeElement, PreloadProblem
from stiffopt.preload.tilted_tool import tilt_vector, tilted_tool, tilts
from stiffopt.symbolic import Quantity, is_symbolic


@dataclass(frozen=True)
class _Joint:
    """Drivetrain of a joint, parted by whether the study changes it."""

    varying: Chain
    rest: Chain


class PreloadModel:
    """The joints of a study under given load cases.

    Parameters
    ----------
    problem : PreloadProblem
    cases : sequence of LoadCase, optional
        Default: those of the problem.
    elements : sequence of FreeElement, optional
        With other scatter and losses than those of the study; default: as the study tightens.

    Attributes
    ----------
    size : int
        Number of preloads: one a free element, or one a bolt or pin of it.

    Notes
    -----
    Preloads are the largest that tightening leaves, (size,) [N]; stiffness, wind-up and slip are
    taken at the least, F/alpha_A minus the embedding loss.
    """

    def __init__(
        self,
        problem: PreloadProblem,
        cases: Sequence[LoadCase] | None = None,
        elements: Sequence[FreeElement] | None = None,
    ) -> None:
        self.problem = problem
        self.cases = tuple(problem.load_cases if cases is None else cases)
        self.elements = tuple(problem.elements if elements is None else elements)
        widths = [e.count if problem.individual else 1 for e in self.elements]
        edges = np.concatenate([[0], np.cumsum(widths)])
        self.slices = tuple(slice(int(a), int(b)) for a, b in pairwise(edges))
        self.size = int(edges[-1])
        self._joints = {joint: self._parted(joint) for joint in problem.joints}
        self._rest: dict[tuple[str, int, bytes], np.ndarray] = {}

    # ---- design vector

    @property
    def design(self) -> np.ndarray:
        """Preloads that the robot has now (size,) [N]."""
        return self.spread([preload_of(e) for e in self.elements])

    def spread(self, preloads: Sequence[float]) -> np.ndarray:
        """Design vector with one preload for all bolts or pins of each element."""
        return np.concatenate(
            [np.full(s.stop - s.start, f) for s, f in zip(self.slices, preloads, strict=True)]
        )

    def of_element(self, preloads: Quantity, index: int) -> list[Quantity]:
        """Preloads of an element's bolts or pins; one entry where they are equal."""
        part = self.slices[index]
        return [preloads[i] for i in range(part.start, part.stop)]

    @cached_property
    def present(self) -> PreloadModel:
        """The joints as they are in the robot: `design` there is what the robot file means."""
        tightening = self.problem.tightening
        elements = [element.as_present(tightening) for element in self.elements]
        if all(a is b for a, b in zip(elements, self.elements, strict=True)):
            return self
        return PreloadModel(self.problem, self.cases, elements)

    # ---- bolts

    def slip_safety(self, joint: int) -> float:
        """Safety against slip that the study asks for in a joint [-] (R12)."""
        return slip_safety(self.problem.requirements.slip_safety, self.cases, joint)

    @cached_property
    def verifications(self) -> tuple[Verification | None, ...]:
        """VDI 2230 of every element under all load cases; None for pins."""
        return tuple(
            verification(
                element.stage,
                element.joint,
                self.cases,
                self.problem.tightening,
                self.slip_safety(element.joint),
            )
            for element in self.elements
        )

    def vdi_rows(self, preloads: np.ndarray, index: int) -> tuple[UtilisationRow, ...]:
        """Steps of VDI 2230 of an element at a design; none for pins."""
        steps, element = self.verifications[index], self.elements[index]
        if steps is None:
            return ()
        flange = element.stage.element
        assert isinstance(flange, BoltedFlange)
        own = np.asarray(self.of_element(preloads, index))
        largest, least = float(own.max()), float(element.least(float(own.min())))
        shift = math.inf
        if least > 0.0:
            stage = element.stage
            torque = np.array([float(steps.loads.torque.max()) * stage.reduction])
            windup = (
                float(stage_windup(stage, torque, {element.name: least})[0]) / stage.windup_factor
            )
            shift = windup * flange.circle_diameter / 2
        rows = vdi_rows(steps, largest, shift, least)
        return tuple(replace(row, joint=element.joint, element=element.key) for row in rows)

    def torques(self, joint: int) -> tuple[np.ndarray, np.ndarray]:
        """Torques of a joint in the load cases and their references (cases,) each [N m]."""
        loads, references = zip(
            *(
                (case.torque[joint - 1], 0.0)
                if case.reference_torque is None
                else (case.torque[joint - 1], case.reference_torque[joint - 1])
                for case in self.cases
            ),
            strict=True,
        )
        return np.array(loads), np.array(references)

    # ---- smooth law: arrays or, for symbolic preloads, SX

    def compliances(self, preloads: Quantity, joint: int) -> Quantity:
        """Tangent compliances of what the study changes, of all load cases [rad/(N m)]."""
        least = self._least(preloads, joint)
        torques = _like(preloads, self.torques(joint)[0])
        return self._joints[joint].varying.tangent_compliance(torques, preloads=least)

    def windups(self, preloads: Quantity, joint: int) -> Quantity:
        """Wind-ups of what the study changes beyond those of the reference torques [rad]."""
        least = self._least(preloads, joint)
        loaded, unloaded = (
            self._joints[joint].varying.windup(_like(preloads, torques), preloads=least)
            for torques in self.torques(joint)
        )
        return loaded - unloaded

    def slip_torque(self, preloads: Quantity, index: int) -> Quantity:
        """Joint torque at which an element slips [N m]; linear in its preloads."""
        element = self.elements[index]
        least = self._mean_least(preloads, index)
        return element.stage.element.slip_torque(least) * element.stage.reduction

    # ---- exact law

    def rest_compliance(self, joint: int, torques: np.ndarray) -> np.ndarray:
        """Exact tangent compliance of all other elements (k,) [rad/(N m)]."""
        return self._kept("compliance", joint, np.asarray(torques, dtype=float))

    def rest_windup(self, joint: int, torques: np.ndarray) -> np.ndarray:
        """Exact wind-up of all other elements (k,) [rad]; also of joints outside the study."""
        return self._kept("windup", joint, np.asarray(torques, dtype=float))

    def _kept(self, what: str, joint: int, torques: np.ndarray) -> np.ndarray:
        """Exact law of what no preload changes; the same torques are asked for at every design."""
        key = (what, joint, torques.tobytes())
        if key not in self._rest:
            if joint in self._joints:
                rest: Chain | None = self._joints[joint].rest
            else:
                rest = self.problem.robot.chains[joint - 1]
            if rest is None:
                self._rest[key] = np.zeros_like(torques)
            elif what == "windup":
                self._rest[key] = exact_windup(rest, torques)
            else:
                self._rest[key] = exact_compliance(rest, torques)
        return self._rest[key]

    def exact_compliance(self, preloads: np.ndarray, joint: int, torques: np.ndarray) -> np.ndarray:
        """Exact tangent compliance of a whole joint (k,) [rad/(N m)]; infinite where it slips."""
        parts = self._joints[joint]
        varying = exact_compliance(
            parts.varying, np.asarray(torques), preloads=self._least(preloads, joint)
        )
        return np.asarray(varying + self.rest_compliance(joint, torques))

    def exact_windup(self, preloads: np.ndarray, joint: int, torques: np.ndarray) -> np.ndarray:
        """Exact wind-up of a whole joint (k,) [rad]."""
        rest = self.rest_windup(joint, torques)
        if joint not in self._joints:
            return rest
        varying = exact_windup(
            self._joints[joint].varying, np.asarray(torques), preloads=self._least(preloads, joint)
        )
        return np.asarray(varying + rest)

    def exact_stiffness(self, preloads: np.ndarray) -> np.ndarray:
        """Tangent stiffness, (joints, cases) [N m/rad]; zero where a connection slips."""
        rows = []
        for joint in self.problem.joints:
            rows.append(1.0 / self.exact_compliance(preloads, joint, self.torques(joint)[0]))
        return np.array(rows)

    def exact_deflection(self, preloads: np.ndarray) -> np.ndarray:
        """Deflection of the tool, (cases, 3) [m].

        nan for cases without a pose, infinite where a connection slips.
        """
        found = np.full((len(self.cases), 3), np.nan)
        if any(case.jacobian is not None for case in self.cases):
            joints = range(1, self.problem.robot.n + 1)
            angles = np.array([self.net_windups(preloads, joint) for joint in joints])
            for k, case in enumerate(self.cases):
                if case.jacobian is not None:
                    turned = self.tilted_tool(case, preloads)
                    held = bool(np.isfinite(angles[:, k]).all() and np.isfinite(turned).all())
                    found[k] = -(case.jacobian @ angles[:, k] + turned) if held else np.inf
        return found

    # ---- flanges that tilt

    @cached_property
    def fixed_flanges(self) -> tuple[tuple[int, Stage], ...]:
        """Flanges that tilt and are not of the study, with their joints."""
        free = {(element.joint, element.name) for element in self.elements}
        return tuple(
            (joint, stage)
            for joint, chain in enumerate(self.problem.robot.chains, start=1)
            if chain is not None
            for stage in chain.stages
            if tilts(stage) and (joint, stage.element.name) not in free
        )

    def fixed_tilt(self, load: LoadCase | LoadHistory) -> np.ndarray:
        """What the flanges outside the study add to the tool's deflection (..., 3) [m]."""
        total = np.zeros((*load.torque.shape[:-1], 3))
        for joint, stage in self.fixed_flanges:
            preload = stage.element.preload
            assert preload is not None
            total = total + tilted_tool(stage, joint, load, preload)
        return total

    def tilted_tool(self, load: LoadCase | LoadHistory, preloads: np.ndarray) -> np.ndarray:
        """What all flanges add to the tool's deflection by the exact law (..., 3) [m]."""
        total = self.fixed_tilt(load)
        for index, element in enumerate(self.elements):
            left = float(self._mean_least(preloads, index))
            total = total + tilted_tool(element.stage, element.joint, load, left)
        return total

    def tilt_compliance(self, preloads: Quantity, index: int) -> Quantity:
        """Smooth tilting compliance of an element's closed face [rad/(N m)]."""
        flange = self.elements[index].stage.element
        assert isinstance(flange, BoltedFlange)
        return closed_compliance(flange, self._mean_least(preloads, index))

    def exact_tilt_compliance(self, preloads: np.ndarray, index: int) -> float:
        """The same by the exact law."""
        flange = self.elements[index].stage.element
        assert isinstance(flange, BoltedFlange)
        return (
            1.0 / tilting_flange(flange, float(self._mean_least(preloads, index))).closed_stiffness
        )

    @cached_property
    def tilt_vectors(self) -> np.ndarray:
        """Movement of the tool per tilting compliance of each element (elements, cases, 3)."""
        return np.array(
            [[tilt_vector(e.stage, e.joint, case) for case in self.cases] for e in self.elements]
        ).reshape(len(self.elements), len(self.cases), 3)

    def _mean_least(self, preloads: Quantity, index: int) -> Quantity:
        """Mean of what an element's fasteners are left with [N]."""
        own = self.of_element(preloads, index)
        return self.elements[index].least(sum(own[1:], own[0]) / len(own))

    def net_windups(self, preloads: np.ndarray, joint: int) -> np.ndarray:
        """Exact wind-up of a joint beyond that of the reference torque (cases,) [rad]."""
        angles = self.exact_windup(preloads, joint, np.concatenate(self.torques(joint)))
        loaded, unloaded = np.split(angles, 2)
        slips = np.isinf(loaded) | np.isinf(unloaded)
        return np.asarray(np.where(slips, np.inf, loaded - np.where(slips, 0.0, unloaded)))

    # ---- parts

    def drivetrain(self, preloads: np.ndarray, joint: int) -> Chain:
        """Whole drivetrain of a joint with the least preloads that tightening leaves.

        From motor to link; with individual preloads each bolt or pin is an element.
        """
        parts, chain = self._joints[joint], self.problem.robot.chains[joint - 1]
        assert chain is not None
        owners, places = self.owners(joint), list(chain.elements)
        varying = parts.varying.with_preloads(self._least(preloads, joint))
        stages = sorted(
            (*varying.stages, *parts.rest.stages),
            key=lambda stage: places.index(owners[stage.element.name]),
        )
        return replace(chain, stages=tuple(stages))

    def owners(self, joint: int) -> dict[str, str]:
        """Element that each stage of `drivetrain` belongs to, by the names of both."""
        found = {
            stage.element.name: stage.element.name for stage in self._joints[joint].rest.stages
        }
        for stage in self._joints[joint].varying.stages:
            found[stage.element.name] = stage.element.name
        for index in self.indices[joint]:
            element = self.elements[index]
            found |= dict.fromkeys(self._names(element), element.name)
        return found

    @cached_property
    def indices(self) -> dict[int, tuple[int, ...]]:
        """Positions in `elements` of each joint's elements."""
        return {
            joint: tuple(i for i, e in enumerate(self.elements) if e.joint == joint)
            for joint in self.problem.joints
        }

    def _parted(self, joint: int) -> _Joint:
        chain = self.problem.robot.chains[joint - 1]
        assert chain is not None
        own = [e for e in self.elements if e.joint == joint]
        varying, rest = chain.split(e.name for e in own)
        if self.problem.individual:
            stages = [s for stage in varying.stages for s in _individually(stage, own)]
            varying = replace(varying, stages=tuple(stages))
        return _Joint(varying, rest)

    def _least(self, preloads: Quantity, joint: int) -> dict[str, Quantity]:
        """Least preloads of a joint's elements, by the names in its varying chain."""
        least: dict[str, Quantity] = {}
        for index in self.indices[joint]:
            element = self.elements[index]
            for name, own in zip(
                self._names(element), self.of_element(preloads, index), strict=True
            ):
                least[name] = element.least(own)
        return least

    def _names(self, element: FreeElement) -> Iterator[str]:
        if not self.problem.individual:
            return iter((element.name,))
        return (f"{element.name} {i}" for i in range(1, element.count + 1))


def preload_of(element: FreeElement) -> float:
    """Preload that the robot has now in one bolt or pin [N], as the largest that assembly leaves.

    Of a net one, so much that the net one remains of it.
    """
    fastened = element.stage.element
    assert fastened.preload is not None
    net = isinstance(fastened, BoltedFlange) and fastened.preload_is == "net"
    return float(element.largest(fastened.preload) if net else fastened.preload)


def _like(preloads: Quantity, torques: np.ndarray) -> Quantity:
    """Torques as what the preloads are: arrays, or constants of SX."""
    return ca.SX(torques) if is_symbolic(preloads) else torques


def _one_fastener(element: Connection) -> Connection:
    """What one bolt or pin holds: its sector of the ring, or its own tip."""
    if isinstance(element, BoltedFlange):
        return replace(element, bolt_count=1, sectors=element.bolt_count)
    assert isinstance(element, ClampingPins)
    return replace(element, count=1, sharing=element.count)


def _individually(stage: Stage, own: Sequence[FreeElement]) -> list[Stage]:
    """One stage a bolt or pin, in parallel: they turn together and their torques add."""
    names = [e.name for e in own]
    if stage.element.name not in names:
        return [stage]
    if stage.group is not None:
        raise ProblemError(
            f"{stage.element.name} is in parallel with other elements; individual preloads are "
            "for elements in series. Set individual = false."
        )
    count = own[names.index(stage.element.name)].count
    one = _one_fastener(stage.element)
    return [
        replace(
            stage,
            element=replace(one, name=f"{one.name} {i}", torque_max=one.torque_max / count),
            group=stage.element.name,
        )
        for i in range(1, count + 1)
    ]
