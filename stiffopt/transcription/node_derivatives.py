"""Stage function with exact first and second derivatives, by values or spline coefficients.

Two measures make it fast:

- numbers become inputs: two stages that differ by a payload, a limit or a drivetrain's numbers are
  one function, so it is differentiated once;
- derivatives use the chain rule through an intermediate quantity (joint torques): with y = Y(w),
  the Hessian of L(w, y) is L_ww + L_wy Y' + (L_wy Y')^T + Y'^T L_yy Y' + sum mu_k Y_k'', mu = L_y.
  On a six-joint arm it halves the number of operations.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np


@dataclass(frozen=True)
class SplineCoordinates:
    """Map from local variables (spline coefficients, statics, duration) to a stage's variables w.

    States and controls at a point are sums of few nonzero splines. The chain rule through them is
    part of the stage's derivatives: sparse matrix products of the whole programme took longer than
    the stages. Local variables are the coefficients (chains run fastest), the static variables, the
    duration. The basis (degree + 1, derivatives) holds the values of a point's splines, column by
    column, as derivatives by the share of the phase's duration, or by time where it is fixed.
    """

    # (position, velocity, .., control) of each chain, as indices in w.
    chains: tuple[tuple[int, ...], ...]
    degree: int  # degree of the positions: degree + 1 splines are nonzero at a point
    statics: int  # number of static variables, the last of w
    free: bool  # True where the duration of a point's phase is a variable, the last of all

    @property
    def orders(self) -> int:
        """Number of derivatives, from the position to the control."""
        return len(self.chains[0])

    @property
    def size(self) -> int:
        """Number of local variables."""
        return len(self.chains) * (self.degree + 1) + self.statics + self.free

    def variables(self, local: ca.SX, basis: ca.SX) -> ca.SX:
        """Express the stage's variables w (n,) by the local ones and the basis."""
        n, splines = len(self.chains), self.degree + 1
        moved = ca.mtimes(
            ca.reshape(local[: n * splines], n, splines),
            ca.reshape(basis, splines, self.orders),
        )
        lasting = local[self.size - 1] if self.free else ca.SX(1)
        found = [ca.SX(0)] * (n * self.orders)
        for j, chain in enumerate(self.chains):
            for order, place in enumerate(chain):
                found[place] = moved[j, order] / lasting**order
        return ca.vertcat(*found, local[n * splines : n * splines + self.statics])

    def stage_derivatives(self, functions: Sequence[ca.Function]) -> tuple[ca.Function, ...]:
        """Return a stage and its derivatives by local variables.

        `functions` are (w, p, numbers) -> values; -> Jacobian by w; (.., weights) -> Hessian by w.
        Those returned are (local, p, numbers, basis) -> values; -> Jacobian; (.., weights) -> upper
        half of the Hessian.
        """
        values, jacobian, hessian = functions
        local, basis = (
            ca.SX.sym("local", self.size),
            ca.SX.sym("basis", self.orders * (self.degree + 1)),
        )
        _, *same, weights = hessian.sx_in()
        w = self.variables(local, basis)
        slope, by_w = ca.jacobian(w, local), jacobian(w, *same)
        pull = ca.SX.sym("pull", w.numel())
        curved = ca.hessian(ca.dot(pull, w), local)[0]
        (bent,) = ca.substitute([curved], [pull], [ca.densify(ca.mtimes(by_w.T, weights))])
        bent += ca.mtimes([slope.T, hessian(w, *same, weights), slope])
        given = [local, *same, basis]
        return (
            ca.Function(values.name(), given, [values(w, *same)]),
            ca.Function(jacobian.name(), given, [ca.mtimes(by_w, slope)]),
            ca.Function(hessian.name(), [*given, weights], [ca.triu(bent)]),
        )


# Numbers that belong to the structure of a formula, not inputs.
_STRUCTURAL_NUMBERS = (-2.0, -1.0, 0.0, 0.5, 1.0, 2.0)


@dataclass(frozen=True)
class NumberedStage:
    """A stage function whose numbers are inputs."""

    # (w, p, numbers) -> (y, values): w holds state, control and static variables, values the
    # integrands and the path rows; y is the intermediate.
    function: ca.Function
    numbers: np.ndarray  # values of the last input
    formula: str  # hash of the function
    # Where spline coefficients are the variables: derivatives are by these.
    along: SplineCoordinates | None = None

    @property
    def derivatives(self) -> tuple[ca.Function, ...]:
        """Stage, Jacobian and Hessian, by w or by the local variables."""
        found = with_derivatives(self.function)
        return found if self.along is None else self.along.stage_derivatives(found)


def extract_numbers(stage: ca.Function, intermediate: ca.Function | None = None) -> NumberedStage:
    """Turn the numbers of a stage function into inputs.

    `stage`: (x, u, z, p) -> (integrands, path rows), of SX. `intermediate`: (x, u, z, p) -> (y,),
    of the same symbols: quantities through which most of it is computed.
    """
    *variables, parameters = symbols = stage.sx_in()
    through = [ca.SX(0, 1)] if intermediate is None else intermediate.call(symbols)
    # The intermediate comes first: the other outputs are computed from it.
    outputs = [ca.densify(each) for each in (*through, ca.vertcat(*stage.call(symbols)))]
    inputs = [ca.vertcat(*variables), parameters]
    plain = ca.Function("stage", inputs, outputs)
    read = _read_formula(plain)
    key = hashlib.sha256(repr(read.formula).encode()).hexdigest()
    if key not in kept_formulas:
        function, uses = _without_numbers(plain, inputs)
        formula = hashlib.sha256(function.serialize().encode()).hexdigest()
        kept_formulas[key] = function, uses, formula
    kept_formulas.move_to_end(key)
    while len(kept_formulas) > _MAX_KEPT_FORMULAS:
        kept_formulas.popitem(last=False)
    function, uses, formula = kept_formulas[key]
    return NumberedStage(function, np.array([read.constants[k] for k in uses]), formula)


@dataclass(frozen=True)
class _Formula:
    """Operations of a function without constants, and constants by their instruction."""

    formula: tuple[object, ...]
    constants: dict[int, float]


# Most recently used formulas without numbers, with the instructions of these and the hash of the
# formula, by a hash of the operations; most problems of a sweep share one.
kept_formulas: OrderedDict[str, tuple[ca.Function, list[int], str]] = OrderedDict()
_MAX_KEPT_FORMULAS = 8


def _read_formula(function: ca.Function) -> _Formula:
    formula: list[object] = [function.size_in(k) for k in range(function.n_in())]
    formula += [function.size_out(k) for k in range(function.n_out())]
    constants: dict[int, float] = {}
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        formula.append((operation, *function.instruction_output(k)))
        if operation == ca.OP_CONST:
            constants[k] = value = function.instruction_constant(k)
            formula.append(value if value in _STRUCTURAL_NUMBERS else None)
        else:
            formula.append(tuple(function.instruction_input(k)))
    return _Formula(tuple(formula), constants)


def _without_numbers(function: ca.Function, inputs: list[ca.SX]) -> tuple[ca.Function, list[int]]:
    """Return the function with a further input for its numbers, and their instructions."""
    uses: list[int] = []
    names: list[ca.SX] = []

    def number(value: float, instruction: int) -> ca.SX:
        if value in _STRUCTURAL_NUMBERS:
            return ca.SX(value)
        uses.append(instruction)
        names.append(ca.SX.sym(f"n{len(names)}"))
        return names[-1]

    replayed = _replay_operations(function, inputs, number=number)
    given = ca.vertcat(ca.SX(0, 1), *names)
    return ca.Function("stage", [*inputs, given], replayed), uses


def with_derivatives(function: ca.Function) -> tuple[ca.Function, ca.Function, ca.Function]:
    """Return the stage function, its Jacobian and its Hessian.

    `function` is that of a `NumberedStage`. Those returned are (w, p, numbers) -> values (m,);
    (w, p, numbers) -> Jacobian by w (m, n); (w, p, numbers, weights (m,)) -> Hessian of the
    weighted values by w (n, n). Sparse.
    """
    inputs = function.sx_in()
    w = inputs[0]
    n = w.numel()
    y = ca.SX.sym("y", function.numel_out(0))
    _, outer = _replay_operations(function, inputs, intermediate=y)
    inner, values = function.call(inputs)
    weights, pull = ca.SX.sym("weights", values.numel()), ca.SX.sym("pull", y.numel())

    both = ca.vertcat(w, y)
    curvature, gradient = ca.hessian(ca.dot(weights, outer), both)
    curvature, gradient, slope = ca.substitute(
        [curvature, gradient, ca.jacobian(outer, both)], [y], [inner]
    )
    slope_y = ca.jacobian(inner, w)
    jacobian = slope[:, :n] + ca.mtimes(slope[:, n:], slope_y)
    (bent,) = ca.substitute([ca.hessian(ca.dot(pull, inner), w)[0]], [pull], [gradient[n:]])
    cross = ca.mtimes(curvature[:n, n:], slope_y)
    hessian = curvature[:n, :n] + cross + cross.T + bent
    hessian += ca.mtimes([slope_y.T, curvature[n:, n:], slope_y])
    return (
        ca.Function("stage", inputs, [values]),
        ca.Function("stage_jacobian", inputs, [jacobian]),
        ca.Function("stage_hessian", [*inputs, weights], [hessian]),
    )


def _replay_operations(
    function: ca.Function,
    inputs: list[ca.SX],
    number: Callable[[float, int], ca.SX] = lambda value, _: ca.SX(value),
    intermediate: ca.SX | None = None,
) -> list[ca.SX]:
    """Compute the outputs of a function again, operation by operation.

    `number` gives a symbol for (value, instruction) at each use of a number: equal numbers stay
    separate inputs, since their equality is no part of the formula. `intermediate` replaces the
    first output in everything computed from it.
    """
    work: dict[int, ca.SX | tuple[float, int]] = {}

    def used(place: int) -> ca.SX:
        held = work[place]
        return number(*held) if isinstance(held, tuple) else held

    given = [ca.vertsplit(each) for each in inputs]
    outputs = [[ca.SX(0)] * function.nnz_out(k) for k in range(function.n_out())]
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        read, written = function.instruction_input(k), function.instruction_output(k)
        if operation == ca.OP_CONST:
            work[written[0]] = function.instruction_constant(k), k
        elif operation == ca.OP_INPUT:
            work[written[0]] = given[read[0]][read[1]]
        elif operation == ca.OP_OUTPUT:
            outputs[written[0]][written[1]] = used(read[0])
            if intermediate is not None and written[0] == 0:
                work[read[0]] = intermediate[written[1]]
        elif len(read) == 2:
            work[written[0]] = ca.SX.binary(operation, used(read[0]), used(read[1]))
        else:
            work[written[0]] = ca.SX.unary(operation, used(read[0]))
    return [ca.vertcat(ca.SX(0, 1), *each) for each in outputs]
