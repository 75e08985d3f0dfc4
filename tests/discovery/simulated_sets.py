"""Simulated sets and what the diagnosis says about them, each made once a session."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.simulator import CaseSpec, simulate, write_case
from benchmarks.simulator.spec import Case
from stiffopt.discovery.diagnose import diagnose
from stiffopt.discovery.diagnosis import Diagnosis, Finding

# A parameter agrees within so many of its standard deviations, or within that share.
DEVIATIONS, SHARE = 3.0, 0.1
# Two joints with link encoders; the second has more dry friction than its nominal model.
COULOMB = CaseSpec(
    effects=(("coulomb", 2, 1.5),),
    seed=3,
    train=3,
    test=1,
    extrapolate=1,
    seconds=5.0,
    rate=250.0,
    substeps=8,
)


def short_case(*effects: tuple[str, int | None, float], seed: int, **fields: object) -> CaseSpec:
    """Four runs of five seconds to fit, and one left out."""
    short = CaseSpec(
        effects=effects,
        seed=seed,
        seconds=5.0,
        train=4,
        test=1,
        extrapolate=0,
        rate=250.0,
        substeps=8,
    )
    return replace(short, **fields)


@cache
def simulated(spec: CaseSpec) -> Case:
    """The recordings of a case."""
    return simulate(spec)


@cache
def diagnosed(spec: CaseSpec) -> Diagnosis:
    """What is said about a case, from its folder alone."""
    return diagnosis_of(simulated(spec), lambda folder: None)


def diagnosis_of(case: Case, changed: Callable[[Path], None]) -> Diagnosis:
    """Diagnosis of a written case after its folder was changed."""
    with tempfile.TemporaryDirectory(prefix="stiffopt-") as folder:
        path = write_case(case, Path(folder) / "set")
        changed(path)
        return diagnose(path)


def said(diagnosis: Diagnosis) -> str:
    """The answer in one line, for messages of failing tests."""
    findings = "; ".join(_line(finding) for finding in diagnosis.findings)
    outside = diagnosis.unexplained
    beyond = "" if outside is None else f" [outside: {outside.channels} {outside.regressors}]"
    return f"{diagnosis.verdict}: {findings}{beyond}"


def _line(finding: Finding) -> str:
    values = ", ".join(f"{p.name} = {p.value:.4g} ({p.sd:.2g})" for p in finding.parameters)
    rivals = ", ".join(f"{r.located.label} {r.probability:.2f}" for r in finding.rivals)
    return f"{finding.located.label} {finding.probability:.2f}: {values} <{rivals}>"


def agrees(name: str, value: float, sd: float, truth: float) -> bool:
    """Whether a reported parameter is within its standard deviations, or near enough."""
    near = SHARE * abs(truth)
    if name == "q0":  # an angle has no relative error: a twentieth of a radian
        near = 0.05
    return math.isfinite(value) and abs(value - truth) <= max(near, DEVIATIONS * sd)


def placed_where(finding: Finding) -> tuple[int | None, str | None, str | None]:
    """Joint, link and run of a finding as a truth states them."""
    return finding.joint, finding.link, finding.located.run


def truth_place(line: dict[str, object]) -> tuple[object, object, object]:
    """Joint, link and run of a line of the truth."""
    return line["joint"], line["link"], line["run"]


def shared(line: dict[str, object]) -> dict[str, float]:
    """Parameters of a line of the truth that mean the same in any model."""
    values = line["params"]
    assert isinstance(values, dict)
    return {name: float(np.asarray(value)) for name, value in values.items()}
