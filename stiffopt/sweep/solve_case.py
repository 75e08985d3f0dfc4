"""Solve of one case of a sweep, in a worker."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stiffopt.errors import InputError
from stiffopt.files import SCHEMA, pick, to_json_types
from stiffopt.result.status import SolveStatus
from stiffopt.sweep.cases import Case
from stiffopt.units import joint_unit

if TYPE_CHECKING:
    from stiffopt.robot.robot import Robot


@dataclass(frozen=True)
class CaseResult:
    """Result of one case."""

    # Status of the solve or verdict of the diagnosis; "invalid" for invalid input, "failed" if the
    # worker died or raised another error.
    status: str
    message: str
    # By name (value in SI or text, unit): values of the table.
    values: dict[str, tuple[float | int | str | None, str]]
    result: dict[str, Any]  # complete result document
    maximised: bool = False  # True if a larger objective is better


_CaseEnd = tuple[CaseResult, bytes | None]

# Cache of a worker, per thread: workers of Dask have several.
_worker_cache = threading.local()


def solve_case(case: Case, warm: bytes | None = None) -> tuple[dict[str, Any], bytes | None]:
    """Solve a case and return the content of its file; errors of the case become its status.

    `warm` is the final state of another case; this one's is returned as well.
    """
    begin = time.perf_counter()
    end = None
    try:
        found, end = _CASE_SOLVERS[case.kind](case, warm)
    except InputError as error:
        found = CaseResult("invalid", str(error), {}, {})
    except Exception as error:
        # An error in one case must not end the sweep.
        found = CaseResult("failed", f"{type(error).__name__}: {error}", {}, {})
    return case_document(case, found, time.perf_counter() - begin), end


def case_document(case: Case, found: CaseResult, seconds: float) -> dict[str, Any]:
    """Content of a case's file."""
    content: dict[str, Any] = to_json_types(
        {
            "schema": SCHEMA,
            **pick(case, "key", "base"),
            "changes": dict(case.changes),
            "start": case.start,
            **pick(found, "status", "message"),
            "values": {
                name: {"value": value, "unit": unit} for name, (value, unit) in found.values.items()
            },
            "maximised": found.maximised,
            "seconds": seconds,
            "result": found.result,
        }
    )
    return content


def _solve_trajectory(case: Case, warm: bytes | None) -> _CaseEnd:
    from stiffopt.certificate.objective_value import is_maximised
    from stiffopt.path.load import load_problem
    from stiffopt.problem.cycle_files import is_cycle
    from stiffopt.result.store import result_document
    from stiffopt.solver.family import ProblemFamily, WarmStart

    if is_cycle(case.base):
        return _solve_cycle(case), None
    problem = load_problem(case.base, case.settings, robots=_cached_robots(case)).problem
    family: ProblemFamily = _worker_cache.__dict__.setdefault("family", ProblemFamily())
    solution, end = family.solve(
        problem,
        None if warm is None else WarmStart.from_bytes(warm),
        compare=case.baselines,
        start=case.start,
    )
    if solution.status is SolveStatus.INTERRUPTED:
        raise KeyboardInterrupt
    values: dict[str, tuple[float | int | str | None, str]] = {}
    if solution.objective is not None:
        values["objective"] = (solution.objective.value, solution.objective.unit)
    motion = solution.assessment
    if motion is not None:
        deflection = motion.deflection_summary()
        values["duration"] = (motion.duration, "s")
        for part in ("dynamic", "total"):
            values[f"{part}_deflection_peak"] = (deflection[part].peak, "m")
        softest = motion.min_stiffness
        slides = bool(problem.robot.prismatic[softest.joint - 1])
        values["least_stiffness"] = (softest.value, joint_unit("N m/rad", slides))
        values["worst_violation"] = (motion.worst_violation.value, "")
    if case.baselines:
        values["ratio_to_better_baseline"] = (solution.ratio_to_better_baseline, "")
    values["iterations"] = (solution.solver.iterations, "")
    found = CaseResult(
        str(solution.status),
        solution.message,
        values,
        result_document(solution),
        is_maximised(problem),
    )
    return found, None if end is None else end.to_bytes()


def _solve_cycle(case: Case) -> CaseResult:
    from stiffopt.cycle.solve_cycle import solve_cycle
    from stiffopt.problem.cycle_files import load_cycle
    from stiffopt.result.cycle import cycle_document

    if case.start:
        raise InputError("starts: a cycle has one initial guess. Leave starts out.")
    cycle = load_cycle(case.base, case.settings, robots=_cached_robots(case)).cycle
    # Rests until the tool has settled and rivals come with the simulation.
    simulated = case.baselines or any(leg.stop.until_settled for leg in cycle.legs)
    found = solve_cycle(cycle, simulate=simulated)
    if found.status is SolveStatus.INTERRUPTED:
        raise KeyboardInterrupt
    values: dict[str, tuple[float | int | str | None, str]] = {}
    if found.objective is not None:
        values["objective"] = (found.objective.value, found.objective.unit)
        values["duration"] = (found.duration, "s")
    values |= {
        f"leg_{k}": (leg.arrival - leg.start, "s") for k, leg in enumerate(found.legs, start=1)
    }
    if found.duty is not None:
        values["energy"] = (found.duty.energy, "J")
        values |= {
            f"rms_torque_{each.name}": (each.rms_torque, "N m") for each in found.duty.joints
        }
    if found.simulation is not None:
        values["tool_error"] = (found.simulation.peak, "m")
    if found.rivals and found.objective is not None:
        best = min(each.objective for each in found.rivals)
        values["ratio_to_better_baseline"] = (found.objective.value / best, "")
    return CaseResult(str(found.status), found.message, values, cycle_document(found))


def _cached_robots(case: Case) -> Callable[[str | Path], Robot]:
    """Return a loader with a cache of robots, valid while the input files are unchanged."""
    from stiffopt.robot.files import load_robot

    robots: dict[str | Path, Robot]
    files, robots = _worker_cache.__dict__.setdefault("robots", ("", {}))
    if files != case.files:
        robots = {}
        _worker_cache.robots = case.files, robots

    def robot(source: str | Path) -> Robot:
        if source not in robots:
            robots[source] = load_robot(source)
        return robots[source]

    return robot


def _solve_study(case: Case, _: bytes | None) -> _CaseEnd:
    from stiffopt.preload.files import load_study
    from stiffopt.preload.store import study_document
    from stiffopt.preload.study import named_values, preload_study

    loaded = load_study(case.base, case.settings)
    study = preload_study(
        loaded.problem, motion=loaded.motion, rounds=loaded.rounds, front_points=0
    )
    if study.status is SolveStatus.INTERRUPTED:
        raise KeyboardInterrupt
    values: dict[str, tuple[float | int | str | None, str]] = {
        name: (value if np.isfinite(value) else None, unit)
        for name, (value, unit) in named_values(study).items()
        if name != "kkt_residual"
    }
    found = CaseResult(
        str(study.status),
        study.solution.message,
        values,
        study_document(study),
        loaded.problem.objective == "joint_stiffness",
    )
    return found, None


def _diagnose_recordings(case: Case, _: bytes | None) -> _CaseEnd:
    from stiffopt.discovery.diagnose import diagnose
    from stiffopt.discovery.store import answer_document
    from stiffopt.recording.recording_set import load_recordings

    found = diagnose(load_recordings(case.base, case.settings), experiment=False)
    if found.stopped:
        raise KeyboardInterrupt
    named = [f"{f.effect.name} of {f.link or f.joint or 'robot'}" for f in found.findings]
    values: dict[str, tuple[float | int | str | None, str]] = {
        "findings": ("; ".join(named), ""),
        "finding_count": (len(named), ""),
    }
    if found.proofs("test"):
        before, after = found.nrmse("test")
        values |= {"residual_before": (before, ""), "residual_after": (after, "")}
    text = "; ".join(found.assumptions)
    return CaseResult(str(found.verdict), text, values, answer_document(found)), None


_CASE_SOLVERS: dict[str, Callable[[Case, bytes | None], _CaseEnd]] = {
    "trajectory": _solve_trajectory,
    "preload": _solve_study,
    "recordings": _diagnose_recordings,
}
