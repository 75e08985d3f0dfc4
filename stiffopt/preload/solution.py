"""Result of a preload optimisation: a design evaluated by the exact law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from stiffopt.connection import ClampingPins
from stiffopt.fastening.limits import workshop_torque
from stiffopt.fastening.tightening import Tightening, WorkshopTorque
from stiffopt.fastening.utilisation import UtilisationRow
from stiffopt.preload.infeasibility import Stopper
from stiffopt.preload.load_case import LoadCase
from stiffopt.preload.model import PreloadModel
from stiffopt.preload.problem import FreeElement
from stiffopt.preload.utilisation import utilisation_rows
from stiffopt.result.status import SolveStatus

_MESSAGE_BY_STATUS = {
    SolveStatus.OPTIMAL: "Solved; every requirement holds by the exact law.",
    SolveStatus.ACCEPTABLE: "Solved to the looser tolerance; every requirement holds.",
    SolveStatus.ITERATION_LIMIT: "The solver ended before the optimum; do not use these preloads.",
    SolveStatus.TIME_LIMIT: "The time limit came before the optimum.",
    SolveStatus.INTERRUPTED: "Stopped by the user; the preloads are those of the last iteration.",
    SolveStatus.INFEASIBLE: "The requirements cannot be met together; relax one of them.",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class PreloadSolution:
    """Preloads of a study with stiffness, deflection and utilisation by the exact law."""

    status: SolveStatus
    message: str
    # By element key: largest assembly preload of one bolt or pin, mean of individual ones [N].
    preloads: Mapping[str, float]
    # By element key: one number per bolt or pin [N]; empty unless individual preloads are free.
    individual: Mapping[str, tuple[float, ...]]
    tightening: Mapping[str, WorkshopTorque | None]  # by element key: None without a given screw
    vector: np.ndarray  # (size,) the design vector [N]
    cases: tuple[LoadCase, ...]  # load cases, including the worst instants of motions
    # Of this design and of the robot's present preloads.
    rows: tuple[UtilisationRow, ...]
    rows_before: tuple[UtilisationRow, ...]
    # (joints, cases) tangent stiffness [N m/rad]; zero in slip.
    stiffness: np.ndarray
    stiffness_before: np.ndarray
    # (cases,) of the tool [m]; nan for cases without a pose.
    deflection: np.ndarray
    deflection_before: np.ndarray
    objective: float  # in its unit
    total_preload: float  # [N]
    kkt_residual: float  # see `stiffopt.solver.ipopt.kkt_residual`; nan without a solve
    iterations: int
    stoppers: tuple[Stopper, ...] = ()  # reasons of infeasibility; empty if feasible
    notes: tuple[str, ...] = field(default_factory=tuple)

    @property
    def largest_deflection(self) -> float:
        """Largest deflection of the tool [m]; infinite in slip, nan without a pose."""
        return _largest_posed(self.deflection)

    @property
    def active(self) -> tuple[str, ...]:
        """Names of the active rows."""
        return tuple(row.name for row in self.rows if row.active)


def evaluate_design(
    model: PreloadModel,
    preloads: np.ndarray,
    status: SolveStatus,
    *,
    kkt_residual: float = float("nan"),
    iterations: int = 0,
    stoppers: tuple[Stopper, ...] = (),
) -> PreloadSolution:
    """Evaluate a design by the exact law.

    `preloads` (size,) [N]. `status`: of the solver; a usable one becomes `certificate_failed` if a
    requirement is exceeded by the exact law.
    """
    rows = utilisation_rows(model, preloads)
    if status.usable and not all(row.satisfied for row in rows):
        status = SolveStatus.CERTIFICATE_FAILED
    own = {
        e.key: tuple(float(f) for f in preloads[part])
        for e, part in zip(model.elements, model.slices, strict=True)
    }
    means = {key: float(np.mean(each)) for key, each in own.items()}
    total = sum(e.count * means[e.key] for e in model.elements)
    stiffness = model.exact_stiffness(preloads)
    deflection = _deflection_sizes(model, preloads)
    return PreloadSolution(
        status=status,
        message=_compose_message(model, status, rows, stoppers),
        preloads=means,
        individual=own if model.problem.individual else {},
        tightening={
            e.key: _workshop_torque(e, means[e.key], model.problem.tightening)
            for e in model.elements
        },
        vector=preloads,
        cases=model.cases,
        rows=rows,
        rows_before=utilisation_rows(model.present, model.present.design),
        stiffness=stiffness,
        stiffness_before=model.exact_stiffness(model.design),
        deflection=deflection,
        deflection_before=_deflection_sizes(model, model.design),
        objective={
            "total_preload": total,
            "bolt_utilisation": largest_utilisation(model, preloads),
            "joint_stiffness": float(stiffness.min()),
            "tool_deflection": _largest_posed(deflection),
        }[model.problem.objective],
        total_preload=total,
        kkt_residual=kkt_residual,
        iterations=iterations,
        stoppers=stoppers,
    )


def largest_utilisation(model: PreloadModel, preloads: np.ndarray) -> float:
    """Return the largest utilisation of any limit that depends on the preload [-]."""
    return max(
        float(limit.utilisation(preload))
        for index, element in enumerate(model.elements)
        for limit in element.limits
        if np.isfinite(limit.capacity)
        for preload in model.of_element(preloads, index)
    )


def _workshop_torque(
    element: FreeElement, preload: float, tightening: Tightening
) -> WorkshopTorque | None:
    """Return the wrench setting; None without a given screw."""
    fastened = element.stage.element
    if isinstance(fastened, ClampingPins) and fastened.screw is None:
        return None
    return workshop_torque(fastened, preload, tightening)


def _deflection_sizes(model: PreloadModel, preloads: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.norm(model.exact_deflection(preloads), axis=1))


def _largest_posed(deflection: np.ndarray) -> float:
    posed = deflection[~np.isnan(deflection)]
    return float(posed.max()) if posed.size else float("nan")


def _compose_message(
    model: PreloadModel,
    status: SolveStatus,
    rows: tuple[UtilisationRow, ...],
    stoppers: tuple[Stopper, ...],
) -> str:
    if stoppers:
        return "No preload meets this study. " + " ".join(str(stop) for stop in stoppers)
    if status is SolveStatus.CERTIFICATE_FAILED:
        worst = max(rows, key=lambda row: row.utilisation)
        return (
            "The solver finished, but the exact law finds a requirement exceeded: "
            f"{worst.name}, utilisation {worst.utilisation:.4f}. Do not use these preloads."
        )
    text = _MESSAGE_BY_STATUS[status]
    if not status.usable:
        return text
    binding = list(dict.fromkeys(row.kind for row in rows if row.active))
    names = " and ".join(binding) if binding else "none"
    return f"{text} Active constraints: {names}."
