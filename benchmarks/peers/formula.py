"""A function of scalars as plain Python text, for tools with another CasADi or none."""

from __future__ import annotations

import casadi as ca

_BINARY = {ca.OP_ADD: "+", ca.OP_SUB: "-", ca.OP_MUL: "*", ca.OP_DIV: "/"}
_UNARY = {
    ca.OP_NEG: "-({})",
    ca.OP_TWICE: "2.0*({})",
    ca.OP_SQ: "({0})*({0})",
    ca.OP_SIN: "sin({})",
    ca.OP_COS: "cos({})",
    ca.OP_ASSIGN: "{}",
}


def python_source(function: ca.Function, name: str) -> str:
    """Source of `name(i0, i1, .., sin, cos)`, which returns a list of the first output's entries.

    Parameters
    ----------
    function : casadi.Function
        Of SX, dense, of the operations of arithmetic, sine and cosine.
    name : str
    """
    arguments = ", ".join(f"i{k}" for k in range(function.n_in()))
    lines = [f"def {name}({arguments}, sin, cos):", f"    out = [0.0] * {function.nnz_out(0)}"]
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        read, written = function.instruction_input(k), function.instruction_output(k)
        if operation == ca.OP_CONST:
            lines.append(f"    w{written[0]} = {function.instruction_constant(k)!r}")
        elif operation == ca.OP_INPUT:
            lines.append(f"    w{written[0]} = i{read[0]}[{read[1]}]")
        elif operation == ca.OP_OUTPUT:
            lines.append(f"    out[{written[1]}] = w{read[0]}")
        elif operation in _BINARY:
            lines.append(f"    w{written[0]} = w{read[0]} {_BINARY[operation]} w{read[1]}")
        elif operation in _UNARY:
            lines.append(f"    w{written[0]} = {_UNARY[operation].format(f'w{read[0]}')}")
        else:
            raise ValueError(f"operation {operation} of {function.name()} has no Python form")
    return "\n".join([*lines, "    return out", ""])
