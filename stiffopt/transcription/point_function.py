"""Functions of a point at all points of a mesh, and NLP derivatives composed from a stage's own.

Evaluated by the interpreter of batched instructions; without the compiled core by CasADi, one point
a call. With the stage's variables w(x) and values v = V(w), the programme is f(x, v), g(x, v), in
which all but V is cheap. By the chain rule, S = V' w' and the Lagrangian L(x, v) = sigma f +
lambda^T g,

    g' = g_x + g_v S,    L'' = L_xx + L_xv S + (L_xv S)^T + S^T L_vv S + sum (V'^T L_v)_k w_k''
                               + w'^T (sum (L_v)_i V_i'') w'.

CasADi's own colouring of the same graph takes several times as long.
"""

from __future__ import annotations

import hashlib
import inspect
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np

from stiffopt import native
from stiffopt.interpreter.batched import Batch, read_batch
from stiffopt.symbolic import BufferedFunction
from stiffopt.transcription.node_derivatives import NumberedStage, extract_numbers

# Inputs of a numbered stage that are common to all points: parameters and numbers.
_SHARED_INPUTS = (1, 2)
# Functions kept for another mesh or the next problem of the same formula.
MAX_KEPT = 16

kept_functions: OrderedDict[tuple[str, Path | None], tuple[ca.Function, ...]] = OrderedDict()
# By formula, what the compiled core reads of them.
kept_batches: OrderedDict[str, tuple[Batch, ...]] = OrderedDict()


def stage_functions(stage: NumberedStage) -> tuple[ca.Function, ...]:
    """Return a stage's values, Jacobian and Hessian, of one point or several side by side."""
    return _prepare_once(stage.formula, lambda: stage.derivatives)


def _prepare_once(
    formula: str, functions: Callable[[], tuple[ca.Function, ...]]
) -> tuple[ca.Function, ...]:
    path = native.library()
    key = (formula, path)
    if key not in kept_functions:
        loaded = None if path is None else _load_batches(path, formula, functions)
        kept_functions[key] = functions() if loaded is None else loaded
    kept_functions.move_to_end(key)
    if formula in kept_batches:
        kept_batches.move_to_end(formula)
    for kept in (kept_functions, kept_batches):
        while len(kept) > MAX_KEPT:
            kept.popitem(last=False)
    return kept_functions[key]


def _load_batches(
    path: Path, formula: str, functions: Callable[[], tuple[ca.Function, ...]]
) -> tuple[ca.Function, ...] | None:
    """Return the functions in the compiled core at `path`; None where too many are in use."""
    if formula not in kept_batches:
        found = functions()
        # Values and Jacobian are evaluated repeatedly at one iterate.
        kept_batches[formula] = tuple(
            read_batch(each, _SHARED_INPUTS, recalled=len(found) > 1 and k < 2)
            for k, each in enumerate(found)
        )
    several = [each.load(path) for each in kept_batches[formula]]
    # All functions of one stage must have the same number of points.
    loaded = tuple(each for each in several if each is not None)
    return loaded if len(loaded) == len(several) else None


def _name_with_source(extended: Callable[[ca.SX, ca.SX], tuple[ca.SX, ca.SX]]) -> str:
    """Return the name of a function and a hash of the file that it is in."""
    source = Path(inspect.getfile(extended)).read_bytes()
    return f"{extended.__qualname__} {hashlib.sha256(source).hexdigest()}"


class PointFunction:
    """Values, without derivatives, of a function at any number of points.

    `function`: (x, u, z, p) -> (m,), of SX. `extended`: (variables, values) -> (variables, values)
    to be evaluated in their place, as derivatives: numbers are extracted from the short function,
    before it is extended. It depends on nothing but that function and code of its file.
    """

    def __init__(
        self,
        function: ca.Function,
        extended: Callable[[ca.SX, ca.SX], tuple[ca.SX, ca.SX]] | None = None,
    ) -> None:
        own = extract_numbers(function)

        def evaluated() -> tuple[ca.Function]:
            variables, *same = own.function.sx_in()
            values = own.function.call([variables, *same])[1]
            if extended is not None:
                variables, values = extended(variables, values)
            return (ca.Function("values", [variables, *same], [ca.densify(values)]),)

        name = "values" if extended is None else _name_with_source(extended)
        self._function = _prepare_once(f"{name} of {own.formula}", evaluated)[0]
        self._numbers = own.numbers

    def __call__(self, variables: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """Values (m, k).

        `variables` (n, k): x above u above z at every point. `parameters` (np,): the same at all
        points.
        """
        function, count = self._function, variables.shape[1]
        lanes = int(function.size2_in(0))
        calls = -(-count // lanes)
        # Columns of matrices are rows of arrays.
        filled = np.pad(variables.T, ((0, calls * lanes - count), (0, 0)), mode="edge")
        same = (np.tile(each, calls) for each in (parameters, self._numbers))
        (values,) = BufferedFunction(function.map(calls))(filled.ravel(), *same)
        return np.asarray(values.reshape(len(filled), -1)[:count].T)


class StageFunction:
    """Stage of a problem at `count` points, with exact derivatives.

    `parameters`: number of the programme's parameters that the stage has; its numbers are the last.
    `basis` (k, count): basis of the splines at every point, where their coefficients are the
    variables. The variables of all points are one matrix (n, count), so are the values (m, count);
    as vectors their columns follow one another. `parameters` of the methods are all of the
    programme's.
    """

    def __init__(
        self, stage: NumberedStage, count: int, parameters: int, basis: ca.MX | None = None
    ) -> None:
        functions = stage_functions(stage)
        # Batched functions evaluate several points in a call.
        self._lanes = int(functions[0].size2_in(0))
        self._calls = -(-count // self._lanes)
        self._values, self._jacobian, self._hessian = (each.map(self._calls) for each in functions)
        self._own, self._numbers = parameters, len(stage.numbers)
        self._count = count
        self._basis = () if basis is None else (self._pad_columns(basis),)
        self.size = int(functions[0].size1_out(0))
        self._jacobian_pattern = self._block_diagonal(functions[1])
        self._hessian_pattern = self._block_diagonal(functions[2])

    def values(self, variables: ca.MX, parameters: ca.MX) -> ca.MX:
        """Integrands and path rows (m, count)."""
        return self._values(*self._stage_arguments(variables, parameters))[:, : self._count]

    def jacobian(self, variables: ca.MX, parameters: ca.MX) -> ca.MX:
        """Jacobian of all values by all variables (m count, n count), block-diagonal."""
        found = self._jacobian(*self._stage_arguments(variables, parameters))
        return self._along_diagonal(found, variables.size1(), self._jacobian_pattern)

    def hessian(self, variables: ca.MX, parameters: ca.MX, weights: ca.MX) -> ca.MX:
        """Second derivatives of the values' weighted sum (n count, n count), block-diagonal.

        Only the upper half where spline coefficients are the variables. `variables` and
        `parameters` (n, count), (np,). `weights` (m, count).
        """
        found = self._hessian(
            *self._stage_arguments(variables, parameters), self._pad_columns(weights)
        )
        return self._along_diagonal(found, variables.size1(), self._hessian_pattern)

    def _stage_arguments(self, variables: ca.MX, parameters: ca.MX) -> tuple[ca.MX, ...]:
        own, numbers = parameters[: self._own], parameters[parameters.numel() - self._numbers :]
        same = (ca.repmat(each, 1, self._calls) for each in (own, numbers))
        return self._pad_columns(variables), *same, *self._basis

    def _pad_columns(self, columns: ca.MX) -> ca.MX:
        """Repeat the last column up to a whole number of batches."""
        missing = self._calls * self._lanes - self._count
        return ca.horzcat(columns, ca.repmat(columns[:, -1], 1, missing)) if missing else columns

    def _along_diagonal(self, found: ca.MX, width: int, pattern: ca.Sparsity) -> ca.MX:
        """Arrange blocks that lie side by side as one block-diagonal matrix."""
        return ca.sparsity_cast(found[:, : width * self._count], pattern)

    def _block_diagonal(self, function: ca.Function) -> ca.Sparsity:
        # Its nonzeros are in the order of the blocks side by side.
        block = ca.horzsplit(function.sparsity_out(0), function.size2_out(0) // self._lanes)[0]
        return ca.diagcat(*[block] * self._count)


def compose_derivatives(
    stage: StageFunction,
    symbols: tuple[ca.MX, ca.MX, ca.MX],
    variables: ca.MX,
    objective: ca.MX,
    rows: ca.MX,
    lifted: tuple[ca.MX, ca.DM | None],
    slope: ca.MX | None = None,
) -> tuple[ca.MX, ca.MX, dict[str, ca.Function]]:
    """Compose objective and rows as expressions of x, and derivatives for `casadi.nlpsol`.

    `symbols`: z, parameters p, and v (m, count), the placeholder of the stage's values. `variables`
    (n, count): w(z). `objective` and `rows`: f(z, v), g(z, v). `lifted` (MX, DM or None): x and a
    constant matrix z'(x): z are the variables and copies of some of them, by which second
    derivatives are sparse. None where z is x. `slope`: w'(x), where its sparsity is known better
    than by CasADi.
    """
    z, p, v = symbols
    x, lift = lifted
    at_x = x if lift is None else ca.mtimes(lift, x)

    def by_x(by_z: ca.MX) -> ca.MX:
        return by_z if lift is None else ca.mtimes(by_z, lift)

    def pulled_back(each: ca.MX) -> ca.MX:
        return each if lift is None else ca.mtimes(lift.T, each)

    slope = by_x(ca.jacobian(ca.vec(variables), z)) if slope is None else slope
    w, inner = ca.Function("variables", [z, p], [variables, slope]).call([at_x, p], True, False)
    true = stage.values(w, p)
    f, g = ca.Function("outer", [z, p, v], [objective, rows]).call([at_x, p, true], True, False)

    sigma, multipliers = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", rows.numel())
    pull = ca.MX.sym("pull", variables.numel())
    lagrangian = sigma * objective + ca.dot(multipliers, rows)
    flat = ca.vec(v)
    weights = ca.gradient(lagrangian, flat)
    seen = lagrangian + ca.dot(pull, ca.vec(variables))
    # CasADi differentiates only these small graphs.
    parts = ca.Function(
        "parts",
        [z, p, v, sigma, multipliers, pull],
        [
            ca.jacobian(objective, z),
            ca.jacobian(objective, flat),
            ca.jacobian(rows, z),
            ca.jacobian(rows, flat),
            ca.hessian(seen, z)[0],
            ca.jacobian(ca.gradient(lagrangian, z), flat),
            ca.hessian(lagrangian, flat)[0],
            weights,
        ],
    )
    jacobian = stage.jacobian(w, p)
    along = ca.mtimes(jacobian, inner)

    def at(pulled: ca.MX) -> list[ca.MX]:
        return parts.call([at_x, p, true, sigma, multipliers, pulled], True, False)

    f_z, f_v, g_z, g_v, *_, weights = at(ca.MX.zeros(pull.shape))
    pulled = ca.mtimes(jacobian.T, weights)
    *_, l_zz, l_zv, l_vv, _ = at(pulled)
    cross = ca.mtimes(pulled_back(l_zv), along)
    bent = stage.hessian(w, p, ca.reshape(weights, *v.shape))
    hessian = by_x(pulled_back(l_zz)) + cross + cross.T
    hessian += ca.mtimes([along.T, l_vv, along]) + ca.mtimes([inner.T, bent, inner])
    # Two products with a vector, not one of two matrices.
    gradient = by_x(f_z) + ca.mtimes(ca.mtimes(f_v, jacobian), inner)
    return (
        f,
        g,
        {
            # CasADi reads a sparse gradient as if it were dense.
            "grad_f": ca.Function("nlp_grad_f", [x, p], [f, ca.densify(gradient.T)]),
            "jac_g": ca.Function("nlp_jac_g", [x, p], [g, by_x(g_z) + ca.mtimes(g_v, along)]),
            "hess_lag": ca.Function("nlp_hess_l", [x, p, sigma, multipliers], [ca.triu(hessian)]),
        },
    )
