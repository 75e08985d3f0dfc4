"""The preload problem as an NLP: scaled preloads, named rows, the exact law as parameters.

Stiffness requirements are rows K_req C(F) <= 1 on compliances, which are convex in the preloads,
so an optimum for the least preload or the most stiffness is the global one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from stiffopt.preload.model import PreloadModel
from stiffopt.symbolic import Quantity
from stiffopt.transcription.nlp import Blocks, Nlp
from stiffopt.transcription.ocp import Rows

# Compliances enter as numbers of order one.
_CASE = "{}, {}"


@dataclass(frozen=True)
class Levels:
    """What the objectives are compared with, so that they come out of order one.

    Parameters
    ----------
    stiffness : mapping of joint number to float
        Weights of joint_stiffness [N m/rad].
    deflection : float
        [m]
    """

    stiffness: Mapping[int, float]
    deflection: float


class PreloadNlp:
    """NLP of a study under fixed load cases.

    Parameters
    ----------
    model : PreloadModel
    objective : str
        A name in `stiffopt.preload.problem.OBJECTIVES`.
    levels : Levels
    ceiling : float or None
        Keep the largest bolt utilisation at or below this as well.
    """

    def __init__(
        self, model: PreloadModel, objective: str, levels: Levels, ceiling: float | None = None
    ) -> None:
        self.model, self.objective, self.levels = model, objective, levels
        self.ceiling = ceiling
        problem = model.problem
        self.joints, self.n = problem.joints, problem.robot.n
        self.scale = model.spread([e.capacity for e in model.elements])
        self._x = ca.SX.sym("preload", model.size)
        self._z = ca.SX.sym("level", self._bounded)
        # Compliances and net wind-ups of what the smooth law leaves out, from the exact law.
        self._rest_compliance = ca.SX.sym("compliance", len(self.joints), len(model.cases))
        self._rest_windup = ca.SX.sym("windup", self.n, len(model.cases))
        self._preloads = self._x * ca.DM(self.scale)
        # A requirement and an objective share the compliances of their joint.
        self._built: dict[int, list[Quantity]] = {}

    @property
    def _bounded(self) -> int:
        """Number of epigraph variables."""
        return {"joint_stiffness": len(self.joints), "total_preload": 0}.get(self.objective, 1)

    # ---- rows

    @cached_property
    def nlp(self) -> Nlp:
        """The programme, with names."""
        rows, values = Blocks(), []
        for name, labels, expressions in (
            self._slip_rows(),
            self._limit_rows(),
            self._stiffness_rows(),
            self._deflection_rows(),
            self._level_rows(),
        ):
            if labels:
                rows.add(Rows.make(name, labels, -np.inf, 1.0), None)
                values += expressions
        variables = Blocks()
        lower, upper = self.bounds()
        variables.add(
            Rows.make("preload", self._labels(), lower, upper, scale=self.scale, unit="N"), None
        )
        variables.add(Rows.make("level", [str(i) for i in range(self._bounded)], 0.0, np.inf), None)
        lower_x, upper_x = variables.bounds()
        lower_g, upper_g = rows.bounds()
        return Nlp(
            x=ca.vertcat(self._x, self._z),
            p=ca.vertcat(ca.vec(self._rest_compliance), ca.vec(self._rest_windup)),
            f=self._objective(),
            g=ca.SX(ca.vertcat(*values)) if values else ca.SX.zeros(0, 1),
            variables=variables,
            rows=rows,
            lower_x=lower_x,
            upper_x=upper_x,
            lower_g=lower_g,
            upper_g=upper_g,
        )

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest preload of every bolt or pin (size,) [N].

        The least keeps the tightened minimum, and the connection from slipping altogether, where
        the laws end; the largest is where the first limit ends it.
        """
        problem, alpha = self.model.problem, self.model.problem.tightening.alpha
        needs = problem.requirements
        lower, upper = [], []
        for index, element in enumerate(self.model.elements):
            torque = max(abs(float(c.torque[element.joint - 1])) for c in self.model.cases)
            unit = float(self.model.slip_torque(self._at_least(index, 1.0), index))
            carried = element.largest(torque / unit, alpha)
            tightened = needs.least_preload * element.capacity
            lower.append(max(tightened, carried if not problem.individual else 0.0))
            upper.append(min(element.ends(needs.bolt_utilisation).values()))
        return self.model.spread(lower), self.model.spread(upper)

    def _at_least(self, index: int, least: float) -> np.ndarray:
        """Design vector in which an element has this least preload [N]."""
        preloads = self.model.design.copy()
        element = self.model.elements[index]
        alpha = self.model.problem.tightening.alpha
        preloads[self.model.slices[index]] = element.largest(least, alpha)
        return preloads

    def _labels(self) -> list[str]:
        labels = []
        for element, part in zip(self.model.elements, self.model.slices, strict=True):
            count = part.stop - part.start
            labels += (
                [f"{element.key} {i}" for i in range(1, count + 1)] if count > 1 else [element.key]
            )
        return labels

    def _slip_rows(self) -> tuple[str, list[str], list[Quantity]]:
        """Of what could slip at the least preloads; others cannot bind and only spoil the scale."""
        safety = self.model.problem.requirements.slip_safety
        lower, _ = self.bounds()
        labels, rows = [], []
        for index, element in enumerate(self.model.elements):
            case = max(self.model.cases, key=lambda c: abs(c.torque[element.joint - 1]))
            torque = abs(float(case.torque[element.joint - 1]))
            if float(self.model.slip_torque(lower, index)) < safety * torque:
                labels.append(_CASE.format(element.key, case.name))
                rows.append(2.0 - self.model.slip_torque(self._preloads, index) / (safety * torque))
        return "slip safety", labels, rows

    def _limit_rows(self) -> tuple[str, list[str], list[Quantity]]:
        """Bounds of the preloads do this alone, but for a ceiling on the utilisation."""
        if self.ceiling is None:
            return "utilisation", [], []
        used = self._utilisations()
        return "utilisation", [label for label, _ in used], [u / self.ceiling for _, u in used]

    def _utilisations(self) -> list[tuple[str, Quantity]]:
        found = []
        for index, element in enumerate(self.model.elements):
            for limit in element.limits:
                if np.isfinite(limit.capacity):
                    for own in self.model.of_element(self._preloads, index):
                        found.append((f"{limit.name}, {element.key}", limit.utilisation(own)))
        return found

    def _compliances(self, joint: int) -> list[Quantity]:
        """Tangent compliance of a joint in every load case."""
        if joint not in self._built:
            row = self.joints.index(joint)
            self._built[joint] = [
                self.model.compliance(self._preloads, joint, case) + self._rest_compliance[row, k]
                for k, case in enumerate(self.model.cases)
            ]
        return self._built[joint]

    def _stiffness_rows(self) -> tuple[str, list[str], list[Quantity]]:
        labels, rows = [], []
        for joint, needed in self.model.problem.requirements.joint_stiffness.items():
            for case, value in zip(self.model.cases, self._compliances(joint), strict=True):
                labels.append(_CASE.format(f"joint {joint}", case.name))
                rows.append(needed * value)
        return "joint stiffness", labels, rows

    @cached_property
    def _squared_deflections(self) -> list[tuple[str, Quantity]]:
        """Square of the tool's deflection in every load case with a pose [m^2]."""
        found = []
        for k, case in enumerate(self.model.cases):
            if case.jacobian is None:
                continue
            angles = []
            for j in range(self.n):
                angle = self._rest_windup[j, k]
                if j + 1 in self.joints:
                    angle = angle + self.varying_windup(self._preloads, j + 1, k)
                angles.append(angle)
            vector = ca.mtimes(ca.DM(case.jacobian), ca.vertcat(*angles))
            found.append((case.name, ca.sumsqr(vector)))
        return found

    def varying_windup(self, preloads: Quantity, joint: int, index: int) -> Quantity:
        """Smooth wind-up beyond the reference torque of what the study changes [rad]."""
        case = self.model.cases[index]
        angle = self.model.windup(preloads, joint, float(case.torque[joint - 1]))
        if case.reference_torque is not None:
            reference = float(case.reference_torque[joint - 1])
            angle = angle - self.model.windup(preloads, joint, reference)
        return angle

    def _deflection_rows(self) -> tuple[str, list[str], list[Quantity]]:
        allowed = self.model.problem.requirements.tool_deflection
        if allowed is None:
            return "tool deflection", [], []
        found = self._squared_deflections
        return "tool deflection", [name for name, _ in found], [s / allowed**2 for _, s in found]

    def _level_rows(self) -> tuple[str, list[str], list[Quantity]]:
        """Rows that keep the epigraph variables above what they stand for."""
        if self.objective == "bolt_utilisation":
            used = self._utilisations()
            return "level", [label for label, _ in used], [1.0 + u - self._z[0] for _, u in used]
        if self.objective == "tool_deflection":
            found = self._squared_deflections
            level = self.levels.deflection**2
            return "level", [n for n, _ in found], [1.0 + s / level - self._z[0] for _, s in found]
        if self.objective == "joint_stiffness":
            labels, rows = [], []
            for position, joint in enumerate(self.joints):
                for case, value in zip(self.model.cases, self._compliances(joint), strict=True):
                    labels.append(_CASE.format(f"joint {joint}", case.name))
                    rows.append(1.0 + self.levels.stiffness[joint] * value - self._z[position])
            return "level", labels, rows
        return "level", [], []

    def _objective(self) -> Quantity:
        """Joints do not share preloads, so the sum of their levels leads each to its best."""
        if self.objective == "total_preload":
            counts = self._weights()
            return ca.dot(ca.DM(counts * self.scale), self._x) / float(counts @ self.scale)
        return ca.sum1(self._z)

    def _weights(self) -> np.ndarray:
        """Bolts or pins that share each preload (size,)."""
        individual = self.model.problem.individual
        return self.model.spread([1.0 if individual else e.count for e in self.model.elements])

    def total_preload(self, preloads: np.ndarray) -> float:
        """Clamping forces of all bolts and pins together [N]."""
        return float(self._weights() @ preloads)

    # ---- the exact law

    def parameters(self, preloads: np.ndarray) -> np.ndarray:
        """What has to be added to the smooth law so that it is exact at these preloads."""
        model = self.model
        compliance = np.zeros((len(self.joints), len(model.cases)))
        windup = np.zeros((self.n, len(model.cases)))
        for row, joint in enumerate(self.joints):
            torques = np.array([case.torque[joint - 1] for case in model.cases])
            smooth = [float(model.compliance(preloads, joint, case)) for case in model.cases]
            compliance[row] = model.exact_compliance(preloads, joint, torques) - smooth
        posed = [k for k, case in enumerate(model.cases) if case.jacobian is not None]
        for j in range(1, self.n + 1) if posed else ():
            windup[j - 1] = model.net_windups(preloads, j)
            if j in self.joints:
                smooth = [float(self.varying_windup(preloads, j, k)) for k in posed]
                windup[j - 1, posed] -= smooth
        return np.concatenate([compliance.ravel(order="F"), windup.ravel(order="F")])
