"""Preload problem as an NLP: scaled preloads, named rows, exact law by parameters.

Stiffness requirements are rows K_req C(F) <= 1 on compliances, which are convex in the preloads,
so an optimum for the least preload or the most stiffness is the global one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property

import casadi as ca
import numpy as np

from stiffopt.preload.exact_shift import ExactShift, exact_shift, shift_shapes
from stiffopt.preload.model import RELATIVE_ROUNDING, PreloadModel
from stiffopt.symbolic import Quantity
from stiffopt.transcription.nlp import Blocks, Nlp
from stiffopt.transcription.ocp import Rows

_LABEL_FORMAT = "{}, {}"
# Exact penalty on a level above its ceiling, over the total preload [-]. No loss at a vertex of the
# limits, where multipliers are of order one; 1 / (4 penalty^2) = 2.8e-8 of a flat level. A larger
# one costs accuracy: the KKT residual is 2e-7 with 1e4, 1e-8 with 1e3.
_CEILING_PENALTY = 3e3
# Least preload in service over capacity [-], for a connection that requires less than the second
# share.
_MIN_SERVICE_PRELOAD_SHARE, _NEGLIGIBLE_PRELOAD_SHARE = 0.02, 1e-3


@dataclass(frozen=True)
class Levels:
    """Scales of the objectives, which make them of order one."""

    stiffness: Mapping[int, float]  # by joint number: weights of joint_stiffness [N m/rad]
    deflection: float  # [m]


class PreloadNlp:
    """NLP of a study under fixed load cases.

    `objective`: a name in `stiffopt.preload.problem.OBJECTIVES`. `ceiling` (objective, float):
    upper bound of another objective, "bolt_utilisation" or "tool_deflection", while the total
    preload is minimised. The ceiling is an elastic constraint. A hard one at an optimum leaves no
    interior: multipliers grow beyond 1e8, IPOPT scales its residuals by them and accepts points
    that are not optimal.
    """

    def __init__(
        self,
        model: PreloadModel,
        objective: str,
        levels: Levels,
        ceiling: tuple[str, float] | None = None,
    ) -> None:
        self.model, self.objective, self.levels = model, objective, levels
        self.ceiling = ceiling
        problem = model.problem
        self.joints, self.n = problem.joints, problem.robot.n
        self.scale = model.spread([e.capacity for e in model.elements])
        self._x = ca.SX.sym("preload", model.size)
        self._z = ca.SX.sym("level", self._level_count)
        # Corrections of compliances and net wind-ups to the exact law: see `ExactShift`.
        names = (field.name for field in fields(ExactShift))
        shapes = shift_shapes(model)
        self._shift = ExactShift(*(ca.SX.sym(n, *s) for n, s in zip(names, shapes, strict=True)))
        self._preloads = self._x * ca.DM(self.scale)
        # Compliances of a joint, shared by requirement and objective.
        self._built_compliances: dict[int, list[Quantity]] = {}

    @property
    def _level_count(self) -> int:
        """Number of epigraph variables."""
        if self.objective == "total_preload":
            return 0 if self.ceiling is None else 1
        return len(self.joints) if self.objective == "joint_stiffness" else 1

    # ---- rows

    @cached_property
    def nlp(self) -> Nlp:
        """Programme with named variables and rows."""
        rows, values = Blocks(), []
        for name, labels, expressions in (
            self._slip_rows(),
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
            Rows.make("preload", self._preload_labels(), lower, upper, scale=self.scale, unit="N"),
            None,
        )
        least = 0.0 if self.ceiling is None else self.ceiling[1]
        levels = [str(i) for i in range(self._level_count)]
        variables.add(Rows.make("level", levels, least, np.inf), None)
        lower_x, upper_x = variables.bounds()
        lower_g, upper_g = rows.bounds()
        return Nlp(
            x=ca.vertcat(self._x, self._z),
            p=ca.vertcat(*map(ca.vec, vars(self._shift).values())),
            f=self._objective_expression(),
            g=ca.SX(ca.vertcat(*values)) if values else ca.SX.zeros(0, 1),
            variables=variables,
            rows=rows,
            lower_x=lower_x,
            upper_x=upper_x,
            lower_g=lower_g,
            upper_g=upper_g,
        )

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the bounds of every preload (size,) [N].

        The lower bound satisfies the least preload, the required clamp load of VDI 2230 (R2, R5)
        and slip safety 1, where the laws end; the upper bound is the first limit of fastener, head
        or thread, at assembly or in service.
        """
        problem = self.model.problem
        needs = problem.requirements
        lower, upper = [], []
        for index, element in enumerate(self.model.elements):
            torque = max(abs(float(c.torque[element.joint - 1])) for c in self.model.cases)
            unit = self.model.slip_torque_per_preload(index)
            carried = element.largest(torque / unit)
            tightened = needs.least_preload * element.capacity
            most = [*element.ends(needs.bolt_utilisation).values()]
            steps = self.model.verifications[index]
            if steps is not None:
                most.append(steps.largest_preload)
            # A connection with negligible torque keeps a minimum, at most half of the largest in
            # service.
            kept = min(
                _MIN_SERVICE_PRELOAD_SHARE * element.capacity, 0.5 * element.least(min(most))
            )
            if torque / unit < min(_NEGLIGIBLE_PRELOAD_SHARE * element.capacity, kept):
                carried = element.largest(kept)
            least = [tightened, carried if not problem.individual else 0.0]
            if steps is not None:
                least.append(element.largest(float(steps.clamp_needed.max())))
            lower.append(max(least))
            upper.append(min(most))
        return self.model.spread(lower), self.model.spread(upper)

    def _preload_labels(self) -> list[str]:
        labels = []
        for element, part in zip(self.model.elements, self.model.slices, strict=True):
            count = part.stop - part.start
            labels += (
                [f"{element.key} {i}" for i in range(1, count + 1)] if count > 1 else [element.key]
            )
        return labels

    def _slip_rows(self) -> tuple[str, list[str], list[Quantity]]:
        """Return slip rows that the bounds do not imply; others are never active."""
        lower, _ = self.bounds()
        labels, rows = [], []
        for index, element in enumerate(self.model.elements):
            safety = self.model.slip_safety(element.joint)
            case = max(self.model.cases, key=lambda c: abs(c.torque[element.joint - 1]))
            torque = abs(float(case.torque[element.joint - 1]))
            if (
                float(self.model.slip_torque(lower, index))
                < (1.0 - RELATIVE_ROUNDING) * safety * torque
            ):
                labels.append(_LABEL_FORMAT.format(element.key, case.name))
                rows.append(2.0 - self.model.slip_torque(self._preloads, index) / (safety * torque))
        return "slip safety", labels, rows

    def _objective_measures(self, objective: str) -> list[tuple[str, Quantity]]:
        """Return the scaled quantities whose maximum is the objective."""
        if objective == "bolt_utilisation":
            return self._utilisation_measures()
        level = self.levels.deflection**2
        return [(name, square / level) for name, square in self._squared_deflections]

    def _utilisation_measures(self) -> list[tuple[str, Quantity]]:
        found = []
        for index, element in enumerate(self.model.elements):
            for limit in element.limits:
                if np.isfinite(limit.capacity):
                    for own in self.model.of_element(self._preloads, index):
                        found.append((f"{limit.name}, {element.key}", limit.utilisation(own)))
        return found

    def _joint_compliances(self, joint: int) -> list[Quantity]:
        """Return the tangent compliance of a joint in every load case."""
        if joint not in self._built_compliances:
            row = self.joints.index(joint)
            smooth = self.model.compliances(self._preloads, joint)
            self._built_compliances[joint] = [
                smooth[k]
                + self._shift.compliance[row, k]
                + self._linear_term(self._shift.compliance_slope, joint, k)
                for k in range(len(self.model.cases))
            ]
        return self._built_compliances[joint]

    def _stiffness_rows(self) -> tuple[str, list[str], list[Quantity]]:
        labels, rows = [], []
        for joint, needed in self.model.problem.requirements.joint_stiffness.items():
            for case, value in zip(self.model.cases, self._joint_compliances(joint), strict=True):
                labels.append(_LABEL_FORMAT.format(f"joint {joint}", case.name))
                rows.append(needed * value)
        return "joint stiffness", labels, rows

    @cached_property
    def _squared_deflections(self) -> list[tuple[str, Quantity]]:
        """Squared tool deflection in every load case with a pose [m^2]."""
        found = []
        smooth = {joint: self.model.windups(self._preloads, joint) for joint in self.joints}
        for k, case in enumerate(self.model.cases):
            if case.jacobian is None:
                continue
            angles = []
            for j in range(self.n):
                angle = self._shift.windup[j, k]
                if j + 1 in self.joints:
                    angle = angle + smooth[j + 1][k]
                    angle = angle + self._linear_term(self._shift.windup_slope, j + 1, k)
                angles.append(angle)
            vector = ca.mtimes(ca.DM(case.jacobian), ca.vertcat(*angles)) + self._tilt_deflection(k)
            found.append((case.name, ca.sumsqr(vector)))
        return found

    def _tilt_deflection(self, k: int) -> Quantity:
        """Return the tool deflection by tilting flanges in a load case [m]."""
        model = self.model
        total = ca.SX(ca.DM(model.fixed_tilt(model.cases[k])))
        for index, vectors in enumerate(model.tilt_vectors):
            if vectors[k].any():
                own = model.of_element(self._preloads, index)
                slope = self._shift.tilt_slope[index] * sum(own[1:], own[0]) / len(own)
                compliance = model.tilt_compliance(self._preloads, index)
                compliance = compliance + self._shift.tilt[index] + slope
                total = total + compliance * ca.DM(vectors[k])
        return total

    def _linear_term(self, slope: Quantity, joint: int, index: int) -> Quantity:
        """Return the linear correction of a joint in one load case, by its preloads."""
        parts = [self.model.slices[i] for i in self.model.indices[joint]]
        return sum((ca.dot(slope[part, index], self._preloads[part]) for part in parts), ca.SX(0.0))

    def _deflection_rows(self) -> tuple[str, list[str], list[Quantity]]:
        allowed = self.model.problem.requirements.tool_deflection
        if allowed is None:
            return "tool deflection", [], []
        found = self._squared_deflections
        return "tool deflection", [name for name, _ in found], [s / allowed**2 for _, s in found]

    def _level_rows(self) -> tuple[str, list[str], list[Quantity]]:
        """Return the epigraph rows of the objective or ceiling."""
        largest = self.ceiling[0] if self.ceiling else self.objective
        if largest in ("bolt_utilisation", "tool_deflection"):
            found = self._objective_measures(largest)
            return "level", [n for n, _ in found], [1.0 + m - self._z[0] for _, m in found]
        if self.objective == "joint_stiffness":
            labels, rows = [], []
            for position, joint in enumerate(self.joints):
                for case, value in zip(
                    self.model.cases, self._joint_compliances(joint), strict=True
                ):
                    labels.append(_LABEL_FORMAT.format(f"joint {joint}", case.name))
                    rows.append(1.0 + self.levels.stiffness[joint] * value - self._z[position])
            return "level", labels, rows
        return "level", [], []

    def _objective_expression(self) -> Quantity:
        """Return the objective; joints share no preloads, so a sum of levels optimises each."""
        if self.objective == "total_preload":
            counts = self._fastener_counts()
            total = ca.dot(ca.DM(counts * self.scale), self._x) / float(counts @ self.scale)
            return (
                total
                if self.ceiling is None
                else total + _CEILING_PENALTY * (self._z - self.ceiling[1])
            )
        return ca.sum1(self._z)

    def _fastener_counts(self) -> np.ndarray:
        """Return the number of bolts or pins per preload (size,)."""
        individual = self.model.problem.individual
        return self.model.spread([1.0 if individual else e.count for e in self.model.elements])

    def total_preload(self, preloads: np.ndarray) -> float:
        """Return the sum of the preloads of all bolts and pins [N]."""
        return float(self._fastener_counts() @ preloads)

    # ---- the exact law

    def parameters(self, preloads: np.ndarray) -> np.ndarray:
        """Return the parameters that make the smooth law exact at these preloads."""
        shift = exact_shift(
            self.model,
            preloads,
            compliances=self.depends_on_stiffness,
            windups=self.depends_on_deflection,
        )
        return np.concatenate([part.ravel(order="F") for part in vars(shift).values()])

    @property
    def depends_on_stiffness(self) -> bool:
        """True if objective or requirements depend on joint compliances."""
        needed = self.model.problem.requirements.joint_stiffness
        return bool(needed) or self.objective == "joint_stiffness"

    @property
    def depends_on_deflection(self) -> bool:
        """True if objective or requirements depend on wind-ups."""
        allowed = self.model.problem.requirements.tool_deflection
        seen = (self.objective, None if self.ceiling is None else self.ceiling[0])
        return allowed is not None or "tool_deflection" in seen
