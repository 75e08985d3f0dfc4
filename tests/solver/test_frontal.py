"""Linear systems of the interior-point method: against dense ones, and IPOPT against itself."""

import ctypes

import numpy as np
import pytest
from scipy.sparse import csc_matrix, tril

from stiffopt import native
from stiffopt.solver.ipopt import IpoptOptions
from tests.solver.test_ipopt import GRAVITY, pendulum, solver

pytestmark = pytest.mark.skipif(native.library() is None, reason="needs the compiled core")


@pytest.fixture(scope="module")
def made():
    return native.library()


def solved(path, matrix, right):
    """Flag, solution and number of negative eigenvalues, by the interface that IPOPT calls."""
    return solved_with_front(path, matrix, right)[:3]


def solved_with_front(path, matrix, right):
    """As `solved`, with the size of the largest front."""
    library = ctypes.CDLL(str(path))
    lower = csc_matrix(tril(matrix))
    lower.sort_indices()
    columns, rows = (each.astype(np.int32) + 1 for each in (lower.indptr, lower.indices))
    given = [each.ctypes.data_as(ctypes.c_void_p) for each in (columns, rows, lower.data)]
    analysis, factors, control = ctypes.c_void_p(), ctypes.c_void_p(), (ctypes.c_int * 128)()
    info, x = (ctypes.c_int * 128)(), np.array(right)
    both = (ctypes.byref(analysis), ctypes.byref(factors))
    library.ma97_default_control_d(control)
    library.ma97_analyse_d(0, len(x), *given[:2], None, both[0], control, info, None)
    assert info[0] == 0
    library.ma97_factor_d(4, *given, *both, control, info, None)
    flag, front, negative = info[0], info[8], info[14]
    if flag == 0:
        at = x.ctypes.data_as(ctypes.c_void_p)
        library.ma97_solve_d(0, 1, at, len(x), *both, control, info)
        # IPOPT reads the inertia after solving: without it, negative curvature passes for a
        # singular matrix, and it corrects both for the rest of a solve.
        assert (info[0], info[14]) == (0, negative)
    library.ma97_finalise_d(*both)
    assert not analysis
    assert not factors
    return flag, x, negative, front


def system(random, unknowns, equations, rows, width, dense=0):
    """Linear system of an interior-point method, in random order."""

    def windows(count):
        found = np.zeros((count, unknowns))
        for row in found:
            begin = random.integers(0, max(1, unknowns - width))
            row[begin : begin + width] = random.normal(size=len(row[begin : begin + width]))
            # A peak or a duration, which meets all.
            row[-1] = random.normal()
        return found

    hessian = sum(np.outer(row, row) * random.normal() for row in windows(unknowns))
    hessian += np.diag(random.normal(size=unknowns))
    equal, limits = windows(equations), windows(rows)
    limits[:dense] = random.normal(size=(dense, unknowns))
    slacks = np.diag(10.0 ** random.uniform(-7, 5, rows))
    nothing = np.zeros((rows, equations))
    whole = np.block(
        [
            [hessian, np.zeros((unknowns, rows)), equal.T, limits.T],
            [np.zeros((rows, unknowns)), slacks, nothing, -np.eye(rows)],
            [equal, nothing.T, np.zeros((equations, equations)), nothing.T],
            [limits, -np.eye(rows), nothing, np.zeros((rows, rows))],
        ]
    )
    order = random.permutation(len(whole))
    return whole[np.ix_(order, order)]


@pytest.mark.parametrize("seed", range(30))
def test_systems_are_solved_and_their_negative_eigenvalues_counted(made, seed):
    random = np.random.default_rng(seed)
    unknowns = int(random.integers(3, 90))
    sizes = (unknowns, int(random.integers(0, unknowns // 3 + 1)), int(random.integers(0, 200)))
    matrix = system(random, *sizes, width=int(random.integers(2, 9)), dense=seed % 2)
    right = random.normal(size=len(matrix))
    flag, x, negative = solved(made, matrix, right)
    assert flag == 0
    assert negative == np.sum(np.linalg.eigvalsh(matrix) < 0.0)
    # Backward error: the matrix spans twelve decades.
    assert np.abs(matrix @ x - right).max() < 1e-12 * np.abs(matrix).max() * np.abs(x).max()


def test_variables_of_one_row_only_are_no_slacks(made):
    # Their coefficients may be small, and their own entries large.
    random = np.random.default_rng(5)
    hessian, rows = random.normal(size=(20, 20)), random.normal(size=(8, 20))
    own, coefficients = np.diag(np.full(8, 10.0)), np.diag(10.0 ** np.linspace(-7, 0, 8))
    nothing = np.zeros((8, 20))
    matrix = np.block(
        [
            [hessian @ hessian.T, nothing.T, rows.T],
            [nothing, own, coefficients],
            [rows, coefficients, np.zeros((8, 8))],
        ]
    )
    right = random.normal(size=len(matrix))
    flag, x, negative = solved(made, matrix, right)
    assert (flag, negative) == (0, 8)
    assert np.abs(matrix @ x - right).max() < 1e-12 * np.abs(matrix).max() * np.abs(x).max()


def test_singular_system_is_reported(made):
    random = np.random.default_rng(1)
    matrix = system(random, 20, 4, 30, 5)
    # One equation twice.
    twice = np.block([[matrix, matrix[:, :1] * 0], [matrix[:1] * 0, np.zeros((1, 1))]])
    assert solved(made, twice, np.ones(len(twice)))[0] == -7


def test_entries_between_rows_of_two_pairs_are_allowed(made):
    # Two leaves whose rows meet: only one of them may be eliminated alone.
    matrix = np.diag([1.0, 0.0, 0.0, 2.0])
    for i, j in ((0, 1), (1, 2), (2, 3)):
        matrix[i, j] = matrix[j, i] = -1.0
    flag, x, negative = solved(made, matrix, np.arange(4.0))
    assert (flag, negative) == (0, np.sum(np.linalg.eigvalsh(matrix) < 0.0))
    np.testing.assert_allclose(matrix @ x, np.arange(4.0), atol=1e-14)


def rows_on_a_pendulum(states, controls):
    return 0.1 * states[1] + 0.01 * controls


@pytest.mark.parametrize("stage_row", [None, rows_on_a_pendulum])
def test_ipopt_iterates_equal_those_with_mumps(stage_row):
    nlp, x0 = pendulum(stage_row)
    slow = solver(nlp, extra={"linear_solver": "mumps"}).solve(x0, GRAVITY)
    assert IpoptOptions().for_ipopt()["linear_solver"] == "ma97"
    quick = solver(nlp).solve(x0, GRAVITY)
    assert quick.status == slow.status == "optimal"
    assert quick.iterations == slow.iterations
    assert quick.objective == pytest.approx(slow.objective, rel=1e-9)
    np.testing.assert_allclose(quick.x, slow.x, atol=1e-7)


def test_infeasible_rows_are_named_as_with_mumps():
    nlp, x0 = pendulum(lambda states, controls: states[0] + 3.0, torque=8.0)
    found = solver(nlp).solve(x0, GRAVITY)
    assert found.status == "infeasible"
    assert {each.name for each in found.conflicts} & {"row", "angle", "end"}


def test_without_the_compiled_core_it_is_mumps(monkeypatch):
    monkeypatch.setattr(native, "library", lambda: None)
    assert IpoptOptions().for_ipopt()["linear_solver"] == "mumps"


def phases_with_durations(random, phases, nodes=60, pivot=4.0, near=1):
    """Nodes that meet the next ones and their phase's duration; durations have a given sum."""
    count = phases * nodes
    whole = np.zeros((count + phases + 1, count + phases + 1))
    for k in range(count):
        whole[k, k] = pivot * (1.0 + random.uniform())
        whole[k, count + k // nodes] = random.normal()
        for other in range(k + 1, min(k + near + 1, count)):
            whole[k, other] = 0.25 * pivot * random.normal() / near
    for phase in range(phases):
        whole[count + phase, count + phase] = 100.0
        whole[count + phase, -1] = 1.0
    return np.triu(whole) + np.triu(whole, 1).T


@pytest.mark.parametrize(
    ("nodes", "near"),
    [(60, 1), (70, 15)],
    ids=["long phases", "phases that meet twice as many as a node does"],
)
def test_fronts_do_not_grow_with_the_number_of_phases(made, nodes, near):
    fronts = []
    for phases in (5, 30):
        random = np.random.default_rng(phases)
        matrix = phases_with_durations(random, phases, nodes=nodes, near=near)
        right = random.normal(size=len(matrix))
        flag, x, negative, front = solved_with_front(made, matrix, right)
        assert flag == 0
        assert negative == np.sum(np.linalg.eigvalsh(matrix) < 0.0)
        assert np.abs(matrix @ x - right).max() < 1e-10
        fronts.append(front)
    assert fronts[1] <= fronts[0] + 2


def test_large_entries_with_the_border_delay_no_pivot(made):
    """Pivots are small against a duration's entries alone, which has a scale of its own."""
    random = np.random.default_rng(3)
    matrix = phases_with_durations(random, 8, pivot=1e-9)
    right = random.normal(size=len(matrix))
    flag, x, negative, front = solved_with_front(made, matrix, right)
    assert flag == 0
    assert negative == np.sum(np.linalg.eigvalsh(matrix) < 0.0)
    assert np.abs(matrix @ x - right).max() < 1e-13 * np.abs(x).max()
    assert front < 12
