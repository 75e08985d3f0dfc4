"""Importing the package costs next to nothing; heavy libraries come with what needs them."""

import subprocess
import sys

import pytest

HEAVY = {"casadi", "pinocchio", "toppra", "scipy", "matplotlib", "pint", "numpy", "pydantic"}


def loaded(code):
    """Top-level modules in memory after a piece of code, in a fresh process."""
    program = f"{code}\nimport sys\nprint(*sorted({{m.split('.')[0] for m in sys.modules}}))"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True
    )
    return set(done.stdout.split())


@pytest.mark.parametrize("code", ["import stiffopt", "import stiffopt\nstiffopt.__all__"])
def test_import_is_light(code):
    assert not loaded(code) & HEAVY


def test_command_line_is_light():
    assert not loaded("import stiffopt.cli") & HEAVY


def test_solve_loads_parts_of_scipy_when_it_needs_them():
    code = "from stiffopt import load_problem, solve\nimport sys\nassert 'scipy' in sys.modules"
    parts = "linalg", "sparse", "interpolate", "optimize", "integrate", "spatial"
    code += "".join(f"\nassert 'scipy.{part}' not in sys.modules" for part in parts)
    assert "casadi" in loaded(code)


def test_the_command_needs_nothing_heavy_for_a_wrong_command_line():
    code = "from stiffopt.cli import run\nassert run(['slove']) == 2"
    assert not loaded(code) & HEAVY


def test_the_report_of_a_solve_loads_no_studies_and_diagnoses():
    code = """
import stiffopt.report.solve.page
import sys
assert "scipy.optimize" not in sys.modules
assert not [m for m in sys.modules if m.startswith(("stiffopt.preload", "stiffopt.discovery"))]"""
    assert "matplotlib" in loaded(code)


def test_cases_of_a_sweep_are_read_while_workers_load_what_is_heavy():
    code = (
        "import stiffopt.report.pages.sweep_terminal\nfrom stiffopt.sweep.cases import load_sweep"
    )
    assert not loaded(code) & (HEAVY - {"numpy", "pydantic"})


def test_toppra_loads_no_plots_until_it_plots():
    code = """
import numpy as np
from stiffopt.baseline.toppra_motion import _plots_on_demand
with _plots_on_demand():
    import toppra.algorithm.algorithm as algorithm
import sys
assert "matplotlib" not in sys.modules"""
    assert "toppra" in loaded(code)
    assert "matplotlib" in loaded(f"{code}\nalgorithm.plt.figure")
