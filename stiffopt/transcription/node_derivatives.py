"""A stage function with exact first and second derivatives.

Two devices make it fast:

- numbers become inputs: two stages that differ by a payload, a limit or a drivetrain's numbers are
  one function, so it is differentiated once;
- derivatives go by the chain rule through an intermediate quantity (joint torques): with y = Y(w),
  the Hessian of L(w, y) is L_ww + L_wy Y' + (L_wy Y')^T + Y'^T L_yy Y' + sum mu_k Y_k'', mu = L_y.
  On a six-joint arm it halves the number of operations.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from stiffopt.transcription.along_splines import AlongSplines

# Numbers that shape a formula rather than fill it.
_STRUCTURAL = (-2.0, -1.0, 0.0, 0.5, 1.0, 2.0)


@dataclass(frozen=True)
class NumberedStage:
    """A stage function whose numbers are inputs.

    Parameters
    ----------
    function : casadi.Function
        (w, p, numbers) -> (y, values): w holds state, control and static variables, values the
        integrands and the path rows; y is the intermediate.
    numbers : array
        Values of the last input.
    formula : str
        Hash of the function.
    along : AlongSplines, optional
        Where w follows from coefficients of splines, by which derivatives are then.
    """

    function: ca.Function
    numbers: np.ndarray
    formula: str
    along: AlongSplines | None = None

    @property
    def derivatives(self) -> tuple[ca.Function, ...]:
        """The stage, its Jacobian and its Hessian, of w or of the local variables."""
        found = with_derivatives(self.function)
        return found if self.along is None else self.along.of_stage(found)


def numbered(stage: ca.Function, intermediate: ca.Function | None = None) -> NumberedStage:
    """Take the numbers out of a stage function.

    Parameters
    ----------
    stage : casadi.Function
        (x, u, z, p) -> (integrands, path rows), of SX.
    intermediate : casadi.Function, optional
        (x, u, z, p) -> (y,), of the same symbols: what most of the stage is computed through.
    """
    *variables, parameters = symbols = stage.sx_in()
    through = [ca.SX(0, 1)] if intermediate is None else intermediate.call(symbols)
    # The intermediate comes first, so that what follows is computed from it.
    outputs = [ca.densify(each) for each in (*through, ca.vertcat(*stage.call(symbols)))]
    inputs = [ca.vertcat(*variables), parameters]
    plain = ca.Function("stage", inputs, outputs)
    read = _read(plain)
    if read.formula not in _taken:
        function, uses = _without_numbers(plain, inputs)
        formula = hashlib.sha256(function.serialize().encode()).hexdigest()
        _taken[read.formula] = function, uses, formula
    _taken.move_to_end(read.formula)
    while len(_taken) > _KEPT:
        _taken.popitem(last=False)
    function, uses, formula = _taken[read.formula]
    return NumberedStage(function, np.array([read.constants[k] for k in uses]), formula)


@dataclass(frozen=True)
class _Read:
    """A function operation by operation: the formula, and constants by their instruction."""

    formula: tuple[object, ...]
    constants: dict[int, float]


# Formulas without their numbers, and which instructions hold these: those used last. Most problems
# of a sweep have one.
_taken: OrderedDict[tuple[object, ...], tuple[ca.Function, list[int], str]] = OrderedDict()
_KEPT = 8


def _read(function: ca.Function) -> _Read:
    formula: list[object] = [function.size_in(k) for k in range(function.n_in())]
    formula += [function.size_out(k) for k in range(function.n_out())]
    constants: dict[int, float] = {}
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        formula.append((operation, *function.instruction_output(k)))
        if operation == ca.OP_CONST:
            constants[k] = value = function.instruction_constant(k)
            formula.append(value if value in _STRUCTURAL else None)
        else:
            formula.append(tuple(function.instruction_input(k)))
    return _Read(tuple(formula), constants)


def _without_numbers(function: ca.Function, inputs: list[ca.SX]) -> tuple[ca.Function, list[int]]:
    """The function with one more input for the numbers; which instruction holds each of them."""
    uses: list[int] = []
    names: list[ca.SX] = []

    def number(value: float, instruction: int) -> ca.SX:
        if value in _STRUCTURAL:
            return ca.SX(value)
        uses.append(instruction)
        names.append(ca.SX.sym(f"n{len(names)}"))
        return names[-1]

    replayed = _replayed(function, inputs, number=number)
    given = ca.vertcat(ca.SX(0, 1), *names)
    return ca.Function("stage", [*inputs, given], replayed), uses


def with_derivatives(function: ca.Function) -> tuple[ca.Function, ca.Function, ca.Function]:
    """The stage function, its Jacobian and its Hessian.

    Parameters
    ----------
    function : casadi.Function
        Of a `NumberedStage`.

    Returns
    -------
    tuple of casadi.Function
        (w, p, numbers) -> values (m,); (w, p, numbers) -> Jacobian by w (m, n);
        (w, p, numbers, weights (m,)) -> Hessian of the weighted values by w (n, n). Sparse.
    """
    inputs = function.sx_in()
    w = inputs[0]
    n = w.numel()
    y = ca.SX.sym("y", function.numel_out(0))
    _, outer = _replayed(function, inputs, intermediate=y)
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


def _replayed(
    function: ca.Function,
    inputs: list[ca.SX],
    number: Callable[[float, int], ca.SX] = lambda value, _: ca.SX(value),
    intermediate: ca.SX | None = None,
) -> list[ca.SX]:
    """Outputs of a function, computed again operation by operation.

    Parameters
    ----------
    function : casadi.Function
        Of SX, with dense outputs.
    inputs : list of SX
    number : callable
        What stands for a number, by its value and instruction, asked for at each of its uses:
        whether two numbers happen to be equal is no part of a formula.
    intermediate : SX, optional
        Stands for the first output in all that is computed from it.
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
