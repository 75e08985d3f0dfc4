"""The public names, and the Python form of a problem as the README shows it."""

import inspect
import subprocess
import sys

import numpy as np
import pytest
from small_arms import ROOT, load, write_robot

import stiffopt

NAMES = [
    "__version__",
    "Choice",
    "Diagnosis",
    "InputError",
    "Limits",
    "LoadCase",
    "Method",
    "NoSolutionFound",
    "Objective",
    "PreloadProblem",
    "ProblemError",
    "Requirements",
    "Robot",
    "Solution",
    "SolveStatus",
    "StiffoptError",
    "Target",
    "Tightening",
    "Trajectory",
    "TrajectoryProblem",
    "assess",
    "diagnose",
    "diagnose_change",
    "identify_stiffness",
    "load_problem",
    "load_recordings",
    "load_robot",
    "load_static_set",
    "load_study",
    "optimise_preloads",
    "preload_study",
    "shipped_robots",
    "solve",
    "stiffness_study",
    "write_diagnosis",
    "write_diagnosis_report",
    "write_preload_report",
    "write_solve_report",
]


def test_public_names():
    assert stiffopt.__all__ == NAMES
    assert dir(stiffopt) == sorted(NAMES)
    for name in NAMES:
        thing = getattr(stiffopt, name)
        assert not inspect.ismodule(thing), name
        assert thing.__doc__, name
    with pytest.raises(AttributeError, match="attribute slove"):
        _ = stiffopt.slove


def test_the_citation_is_of_this_version():
    lines = (ROOT / "CITATION.cff").read_text(encoding="utf-8").splitlines()
    assert f"version: {stiffopt.__version__}" in lines


def test_no_public_name_is_hidden_by_a_package():
    folders = {path.name for path in (ROOT / "stiffopt").iterdir() if path.is_dir()}
    modules = {path.stem for path in (ROOT / "stiffopt").glob("*.py")}
    assert not set(NAMES) & (folders | modules)


def test_names_survive_the_import_of_everything():
    code = (
        "import stiffopt.solver.solve, stiffopt.cli\n"
        "from stiffopt import solve, assess, Robot\n"
        "assert callable(solve) and callable(assess) and isinstance(Robot, type)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_a_dozen_lines_of_python(tmp_path):
    from stiffopt import Objective, Target, TrajectoryProblem, load_robot, solve

    robot = load_robot(write_robot(tmp_path))
    problem = TrajectoryProblem(
        robot=robot.with_payload(0.5, com=[0.0, 0.0, 0.05]),
        start=Target(joints=np.array([-0.6, 0.4])),
        end=Target(joints=np.array([0.5, 0.2])),
        duration=(0.6, 0.6),
        objectives=(Objective(name="dynamic_deflection"),),
    )
    seen = []
    solution = solve(problem, progress=seen.append)
    assert solution.status.usable
    assert solution.trajectory(0.6) == pytest.approx([0.5, 0.2], abs=1e-6)
    assert solution.trajectory([0.0, 0.3], 1).shape == (2, 2)
    assert solution.ratio_to_better_baseline < 1
    assert len(seen) > 3
    assert seen[-1].elapsed >= seen[0].elapsed >= 0
    assert seen[-1].objective == pytest.approx(solution.objective.value, rel=0.05)


DOCS = ROOT / ".github" / "docs"


def python_example(page):
    """Return the Python block of a documentation page."""
    (example,) = page.read_text(encoding="utf-8").split("```python\n")[1:]
    return example.split("```")[0]


def test_preload_tutorial_example_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    seen = {}
    exec(compile(python_example(DOCS / "tutorials" / "preload.md"), "preload.md", "exec"), seen)
    assert seen["study"].status.usable
    assert "N m" in capsys.readouterr().out
    assert (tmp_path / "out/preload/report.html").stat().st_size > 10_000


def test_diagnosis_tutorial_example_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "problems").symlink_to(ROOT / "problems")
    seen = {}
    exec(compile(python_example(DOCS / "tutorials" / "diagnose.md"), "diagnose.md", "exec"), seen)
    assert seen["diagnosis"].verdict == "named"
    assert "coulomb 2 dFc" in capsys.readouterr().out
    out = tmp_path / "out" / "two_link"
    assert {"diagnosis.json", "extended.toml", "report.html"} <= {p.name for p in out.iterdir()}


def test_own_effect_example_is_read(tmp_path):
    from stiffopt.discovery.user_effects import load_effects

    file = tmp_path / "my_effects.py"
    file.write_text(python_example(DOCS / "howto" / "own_effects.md"))
    (effect,) = load_effects(file)
    assert effect.name == "seal_drag"


def test_file_and_python_give_the_same_problem(tmp_path):
    from dataclasses import replace

    from stiffopt import Objective, Target, TrajectoryProblem, load_robot
    from stiffopt.result.provenance import inputs_hash

    read = load(tmp_path, method="intervals = 20")
    written = TrajectoryProblem(
        robot=load_robot(tmp_path / "planar.toml"),
        start=Target(joints=np.array([-0.6, 0.4])),
        end=Target(joints=np.array([0.5, 0.2])),
        duration=(0.5, 0.5),
        objectives=(Objective(name="torque_squared"),),
        limits=read.limits,
        method=read.method,
        title="planar",
    )
    assert inputs_hash(read) == inputs_hash(written)
    assert inputs_hash(replace(written, duration=(0.6, 0.6))) != inputs_hash(read)


@pytest.mark.parametrize(
    "wrong",
    [
        {"duration": (0.0, 1.0)},
        {"duration": (1.0, 0.5)},
        {"duration": (float("nan"), 1.0)},
        {"duration": (1e-9, 1e-9)},
    ],
)
def test_wrong_values_are_refused(wrong, tmp_path):
    from dataclasses import replace

    with pytest.raises(stiffopt.InputError):
        replace(load(tmp_path), **wrong)


@pytest.mark.parametrize(
    "wrong",
    [
        {},
        {"joints": np.zeros(2), "position": np.zeros(3)},
        {"joints": np.zeros(2), "rpy": np.zeros(3)},
        {"position": np.zeros(2)},
        {"position": np.array([np.nan, 0, 0])},
        {"position": np.zeros(3), "rpy": np.array([np.inf, 0, 0])},
        {"position": np.zeros(3), "tolerance": 0.0},
        {"position": np.zeros(3), "angle_tolerance": np.nan},
    ],
)
def test_wrong_targets_are_refused(wrong):
    with pytest.raises(stiffopt.InputError):
        stiffopt.Target(**wrong)


@pytest.mark.parametrize(
    "wrong",
    [{"name": "speed"}, {"measure": "mean"}, {"weight": 0.0}, {"weight": float("nan")}],
)
def test_wrong_objectives_are_refused(wrong):
    with pytest.raises(stiffopt.InputError):
        stiffopt.Objective(**wrong)
