"""Stiffness, wind-up, deflection and slip of a study's joints as functions of the preloads.

Elements whose preload is free follow a smooth law in the preload; all others are constants of the
exact law at the torque of the load case.
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
from stiffopt.fastening.utilisation import UtilisationRow
from stiffopt.fastening.vdi_rows import vdi_rows
from stiffopt.fastening.verification import Verification
from stiffopt.preload.flange_loads import (
    carries_tilting,
    slip_safety,
    tilt_deflection,
    tilt_vector,
    verification,
)
from stiffopt.preload.load_case import LoadCase, LoadHistory
from stiffopt.preload.problem import FreeElement, PreloadProblem
from stiffopt.symbolic import Quantity, is_symbolic

# Relative rounding of sums in another order [-].
RELATIVE_ROUNDING = 1e-12


@dataclass(frozen=True)
class _SplitDrivetrain:
    """Drivetrain of a joint, split into free and constant elements."""

    varying: Chain
    rest: Chain


class PreloadModel:
    """Joints of a study under given load cases.

    Parameters
    ----------
    cases : sequence of LoadCase, optional
        Default: those of the problem.
    elements : sequence of FreeElement, optional
        With other scatter and losses; default: those of the study.

    Attributes
    ----------
    size : int
        Number of preloads: one per free element, or one per bolt or pin of it.

    Notes
    -----
    Preloads are the largest assembly preloads (size,) [N]; stiffness, wind-up and slip use the
    least in service, F/alpha_A minus the embedding loss.
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
        self._joints = {joint: self._split_drivetrain(joint) for joint in problem.joints}
        self._rest: dict[tuple[str, int, bytes], np.ndarray] = {}

    # ---- design vector

    @property
    def design(self) -> np.ndarray:
        """Present preloads of the robot (size,) [N]."""
        return self.spread([preload_of(e) for e in self.elements])

    def spread(self, preloads: Sequence[float]) -> np.ndarray:
        """Return the design vector with one preload for all bolts or pins of each element."""
        return np.concatenate(
            [np.full(s.stop - s.start, f) for s, f in zip(self.slices, preloads, strict=True)]
        )

    def of_element(self, preloads: Quantity, index: int) -> list[Quantity]:
        """Return the preloads of an element's bolts or pins; one entry if equal."""
        part = self.slices[index]
        return [preloads[i] for i in range(part.start, part.stop)]

    def replaced(self, preloads: np.ndarray, index: int, own: float | np.ndarray) -> np.ndarray:
        """Return the design vector with other preloads of one element [N]."""
        changed = preloads.copy()
        changed[self.slices[index]] = own
        return changed

    def without_rounding(self, preloads: np.ndarray) -> np.ndarray:
        """Return a design with preloads of one connection made equal that differ by rounding.

        Fasteners of equal preload share their exact law.
        """
        found = preloads.copy()
        for part in self.slices:
            own = found[part]
            near = np.abs(own - own[0]) <= RELATIVE_ROUNDING * own[0]
            found[part] = np.where(near, own[0], own)
        return found

    @cached_property
    def present(self) -> PreloadModel:
        """Model of the present robot, whose preloads are interpreted as in the robot file."""
        tightening = self.problem.tightening
        elements = [element.as_present(tightening) for element in self.elements]
        if all(a is b for a, b in zip(elements, self.elements, strict=True)):
            return self
        return PreloadModel(self.problem, self.cases, elements)

    # ---- bolts

    def slip_safety(self, joint: int) -> float:
        """Return the required slip safety of a joint [-] (R12)."""
        return slip_safety(self.problem.requirements.slip_safety, self.cases, joint)

    @cached_property
    def verifications(self) -> tuple[Verification | None, ...]:
        """VDI 2230 verification of every element under all load cases; None for pins."""
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
        """Return the VDI 2230 rows of an element at a design; none for pins."""
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
        """Return torques and reference torques of a joint in the load cases (cases,) [N m]."""
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
        """Return the tangent compliances of the free elements in all load cases [rad/(N m)]."""
        least = self._least_preloads(preloads, joint)
        torques = _match_type(preloads, self.torques(joint)[0])
        return self._joints[joint].varying.tangent_compliance(torques, preloads=least)

    def windups(self, preloads: Quantity, joint: int) -> Quantity:
        """Return the wind-ups of the free elements less those at reference torques [rad]."""
        least = self._least_preloads(preloads, joint)
        loaded, unloaded = (
            self._joints[joint].varying.windup(_match_type(preloads, torques), preloads=least)
            for torques in self.torques(joint)
        )
        return loaded - unloaded

    def slip_torque(self, preloads: Quantity, index: int) -> Quantity:
        """Return the joint torque at which an element slips [N m]; linear in its preloads."""
        element = self.elements[index]
        least = self._mean_least_preload(preloads, index)
        return element.stage.element.slip_torque(least) * element.stage.reduction

    def slip_torque_per_preload(self, index: int) -> float:
        """Return the joint torque at slip for a least preload of 1 N, to which it is linear."""
        largest = self.elements[index].largest(1.0)
        return float(self.slip_torque(self.replaced(self.design, index, largest), index))

    # ---- exact law

    def rest_compliance(self, joint: int, torques: np.ndarray) -> np.ndarray:
        """Return the exact tangent compliance of the constant elements (k,) [rad/(N m)]."""
        return self._cached_rest("compliance", joint, np.asarray(torques, dtype=float))

    def rest_windup(self, joint: int, torques: np.ndarray) -> np.ndarray:
        """Return the exact wind-up of the constant elements (k,) [rad], for any joint."""
        return self._cached_rest("windup", joint, np.asarray(torques, dtype=float))

    def _cached_rest(self, quantity: str, joint: int, torques: np.ndarray) -> np.ndarray:
        """Return the exact law of the constant elements, cached by torques."""
        key = (quantity, joint, torques.tobytes())
        if key not in self._rest:
            if joint in self._joints:
                rest: Chain | None = self._joints[joint].rest
            else:
                rest = self.problem.robot.chains[joint - 1]
            if rest is None:
                self._rest[key] = np.zeros_like(torques)
            elif quantity == "windup":
                self._rest[key] = exact_windup(rest, torques)
            else:
                self._rest[key] = exact_compliance(rest, torques)
        return self._rest[key]

    def exact_compliance(self, preloads: np.ndarray, joint: int, torques: np.ndarray) -> np.ndarray:
        """Return the exact tangent compliance of a joint (k,) [rad/(N m)]; infinite in slip."""
        parts = self._joints[joint]
        varying = exact_compliance(
            parts.varying, np.asarray(torques), preloads=self._least_preloads(preloads, joint)
        )
        return np.asarray(varying + self.rest_compliance(joint, torques))

    def exact_windup(self, preloads: np.ndarray, joint: int, torques: np.ndarray) -> np.ndarray:
        """Return the exact wind-up of a joint (k,) [rad]."""
        rest = self.rest_windup(joint, torques)
        if joint not in self._joints:
            return rest
        varying = exact_windup(
            self._joints[joint].varying,
            np.asarray(torques),
            preloads=self._least_preloads(preloads, joint),
        )
        return np.asarray(varying + rest)

    def exact_stiffness(self, preloads: np.ndarray) -> np.ndarray:
        """Return the tangent stiffness (joints, cases) [N m/rad]; zero in slip."""
        rows = []
        for joint in self.problem.joints:
            rows.append(1.0 / self.exact_compliance(preloads, joint, self.torques(joint)[0]))
        return np.array(rows)

    def exact_deflection(self, preloads: np.ndarray) -> np.ndarray:
        """Return the deflection of the tool (cases, 3) [m].

        nan for cases without a pose, infinite in slip.
        """
        found = np.full((len(self.cases), 3), np.nan)
        if any(case.jacobian is not None for case in self.cases):
            joints = range(1, self.problem.robot.n + 1)
            angles = np.array([self.net_windups(preloads, joint) for joint in joints])
            for k, case in enumerate(self.cases):
                if case.jacobian is not None:
                    turned = self.tilt_deflection(case, preloads)
                    held = bool(np.isfinite(angles[:, k]).all() and np.isfinite(turned).all())
                    found[k] = -(case.jacobian @ angles[:, k] + turned) if held else np.inf
        return found

    def deflection_sizes(self, history: LoadHistory, preloads: np.ndarray) -> np.ndarray:
        """Return the magnitude of the tool deflection along a motion with poses (K,) [m]."""
        assert history.jacobian is not None
        angles, reference = np.zeros_like(history.torque), history.reference_torque
        for j in range(self.problem.robot.n):
            angles[:, j] = self.exact_windup(preloads, j + 1, history.torque[:, j])
            if reference is not None:
                still = self.exact_windup(preloads, j + 1, reference[:, j])
                angles[:, j] = _net_windup(angles[:, j], still)
        turned = self.tilt_deflection(history, preloads)
        held = np.isfinite(angles).all(axis=1) & np.isfinite(turned).all(axis=1)
        vectors = np.einsum("kin,kn->ki", history.jacobian, np.where(held[:, None], angles, 0.0))
        vectors = vectors + np.where(held[:, None], turned, 0.0)
        return np.where(held, np.linalg.norm(vectors, axis=1), np.inf)

    # ---- tilting flanges

    @cached_property
    def fixed_flanges(self) -> tuple[tuple[int, Stage], ...]:
        """Tilting flanges outside the study, with their joints."""
        free = {(element.joint, element.name) for element in self.elements}
        return tuple(
            (joint, stage)
            for joint, chain in enumerate(self.problem.robot.chains, start=1)
            if chain is not None
            for stage in chain.stages
            if carries_tilting(stage) and (joint, stage.element.name) not in free
        )

    def fixed_tilt(self, load: LoadCase | LoadHistory) -> np.ndarray:
        """Return the tool deflection by tilting flanges outside the study (..., 3) [m]."""
        total = np.zeros((*load.torque.shape[:-1], 3))
        for joint, stage in self.fixed_flanges:
            preload = stage.element.preload
            assert preload is not None
            total = total + tilt_deflection(stage, joint, load, preload)
        return total

    def tilt_deflection(self, load: LoadCase | LoadHistory, preloads: np.ndarray) -> np.ndarray:
        """Return the tool deflection by all tilting flanges, by the exact law (..., 3) [m]."""
        total = self.fixed_tilt(load)
        for index, element in enumerate(self.elements):
            left = float(self._mean_least_preload(preloads, index))
            total = total + tilt_deflection(element.stage, element.joint, load, left)
        return total

    def tilt_compliance(self, preloads: Quantity, index: int) -> Quantity:
        """Return the smooth tilting compliance of an element when closed [rad/(N m)]."""
        flange = self.elements[index].stage.element
        assert isinstance(flange, BoltedFlange)
        return closed_compliance(flange, self._mean_least_preload(preloads, index))

    def exact_tilt_compliance(self, preloads: np.ndarray, index: int) -> float:
        """Return the exact tilting compliance of an element when closed [rad/(N m)]."""
        flange = self.elements[index].stage.element
        assert isinstance(flange, BoltedFlange)
        return (
            1.0
            / tilting_flange(
                flange, float(self._mean_least_preload(preloads, index))
            ).closed_stiffness
        )

    @cached_property
    def tilt_vectors(self) -> np.ndarray:
        """Tool displacement per tilting compliance of each element (elements, cases, 3)."""
        return np.array(
            [[tilt_vector(e.stage, e.joint, case) for case in self.cases] for e in self.elements]
        ).reshape(len(self.elements), len(self.cases), 3)

    def _mean_least_preload(self, preloads: Quantity, index: int) -> Quantity:
        """Return the mean least preload of an element's fasteners [N]."""
        own = self.of_element(preloads, index)
        return self.elements[index].least(sum(own[1:], own[0]) / len(own))

    def net_windups(self, preloads: np.ndarray, joint: int) -> np.ndarray:
        """Return the exact wind-up of a joint less that at the reference torque (cases,) [rad]."""
        angles = self.exact_windup(preloads, joint, np.concatenate(self.torques(joint)))
        return _net_windup(*np.split(angles, 2))

    # ---- parts

    def drivetrain(self, preloads: np.ndarray, joint: int) -> Chain:
        """Return the drivetrain of a joint at the least preloads in service.

        From motor to link; individual preloads make each bolt or pin an element.
        """
        parts, chain = self._joints[joint], self.problem.robot.chains[joint - 1]
        assert chain is not None
        owners, places = self.owners(joint), list(chain.elements)
        varying = parts.varying.with_preloads(self._least_preloads(preloads, joint))
        stages = sorted(
            (*varying.stages, *parts.rest.stages),
            key=lambda stage: places.index(owners[stage.element.name]),
        )
        return replace(chain, stages=tuple(stages))

    def owners(self, joint: int) -> dict[str, str]:
        """Return the element of each stage of `drivetrain`, by name."""
        found = {
            stage.element.name: stage.element.name for stage in self._joints[joint].rest.stages
        }
        for stage in self._joints[joint].varying.stages:
            found[stage.element.name] = stage.element.name
        for index in self.indices[joint]:
            element = self.elements[index]
            found |= dict.fromkeys(self._fastener_names(element), element.name)
        return found

    @cached_property
    def indices(self) -> dict[int, tuple[int, ...]]:
        """Positions in `elements` of each joint's elements."""
        return {
            joint: tuple(i for i, e in enumerate(self.elements) if e.joint == joint)
            for joint in self.problem.joints
        }

    def _split_drivetrain(self, joint: int) -> _SplitDrivetrain:
        chain = self.problem.robot.chains[joint - 1]
        assert chain is not None
        own = [e for e in self.elements if e.joint == joint]
        varying, rest = chain.split(e.name for e in own)
        if self.problem.individual:
            stages = [s for stage in varying.stages for s in _split_fasteners(stage, own)]
            varying = replace(varying, stages=tuple(stages))
        return _SplitDrivetrain(varying, rest)

    def _least_preloads(self, preloads: Quantity, joint: int) -> dict[str, Quantity]:
        """Return the least preloads of a joint's elements, by stage name."""
        least: dict[str, Quantity] = {}
        for index in self.indices[joint]:
            element = self.elements[index]
            for name, own in zip(
                self._fastener_names(element), self.of_element(preloads, index), strict=True
            ):
                least[name] = element.least(own)
        return least

    def _fastener_names(self, element: FreeElement) -> Iterator[str]:
        if not self.problem.individual:
            return iter((element.name,))
        return (f"{element.name} {i}" for i in range(1, element.count + 1))


def preload_of(element: FreeElement) -> float:
    """Return the present largest assembly preload of one bolt or pin [N].

    For a net preload the one that leaves it in service.
    """
    fastened = element.stage.element
    assert fastened.preload is not None
    net = isinstance(fastened, BoltedFlange) and fastened.preload_is == "net"
    return float(element.largest(fastened.preload) if net else fastened.preload)


def _net_windup(loaded: np.ndarray, unloaded: np.ndarray) -> np.ndarray:
    """Return the difference of wind-ups; slip under either load is infinite."""
    slips = np.isinf(loaded) | np.isinf(unloaded)
    return np.asarray(np.where(slips, np.inf, loaded - np.where(slips, 0.0, unloaded)))


def _match_type(preloads: Quantity, torques: np.ndarray) -> Quantity:
    """Return torques in the type of the preloads: array or SX."""
    return ca.SX(torques) if is_symbolic(preloads) else torques


def _one_fastener(element: Connection) -> Connection:
    """Return the share of one bolt or pin: a sector of the ring, or one tip."""
    if isinstance(element, BoltedFlange):
        return replace(element, bolt_count=1, sectors=element.bolt_count)
    assert isinstance(element, ClampingPins)
    return replace(element, count=1, sharing=element.count)


def _split_fasteners(stage: Stage, own: Sequence[FreeElement]) -> list[Stage]:
    """Split a stage into parallel stages, one per bolt or pin."""
    names = [e.name for e in own]
    if stage.element.name not in names:
        return [stage]
    if stage.group is not None:
        raise ProblemError(
            f"{stage.element.name} is in parallel with other elements; individual preloads need "
            "elements in series. Set individual = false."
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
