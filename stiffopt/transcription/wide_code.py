"""C code of stage functions that computes several points at once, each in a lane of the registers.

A stage's second derivatives are a hundred thousand operations in a row: the processor waits for
them to be fetched rather than done. Of several points at once each is fetched for all. Every lane
does what the function of one point does, operation by operation, so the numbers are the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import casadi as ca

# Points at once: two or four registers where a processor has smaller ones.
LANES = 8
# Lines of a generated function that are compiled as one.
_LONGEST = 1000

_INFIX = {
    ca.OP_ADD: "+",
    ca.OP_SUB: "-",
    ca.OP_MUL: "*",
    ca.OP_DIV: "/",
}
_COMPARED = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!="}
_SIMPLE = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0}*{0}",
    ca.OP_TWICE: "2.0*{0}",
    ca.OP_INV: "1.0/{0}",
    ca.OP_NOT: "TRUE({0} == 0.0)",
    ca.OP_AND: "TRUE(({0} != 0.0) & ({1} != 0.0))",
    ca.OP_OR: "TRUE(({0} != 0.0) | ({1} != 0.0))",
    ca.OP_SIGN: "TRUE({0} > 0.0) - TRUE({0} < 0.0)",
    ca.OP_FABS: "(wide)((mask){0} & 0x7fffffffffffffffLL)",
    ca.OP_IF_ELSE_ZERO: "(wide)(({0} != 0.0) & (mask){1})",
}
# Lane by lane, by the functions of math.h.
_UNARY = {
    ca.OP_EXP: "exp",
    ca.OP_LOG: "log",
    ca.OP_SQRT: "sqrt",
    ca.OP_SIN: "sin",
    ca.OP_COS: "cos",
    ca.OP_TAN: "tan",
    ca.OP_ASIN: "asin",
    ca.OP_ACOS: "acos",
    ca.OP_ATAN: "atan",
    ca.OP_SINH: "sinh",
    ca.OP_COSH: "cosh",
    ca.OP_TANH: "tanh",
    ca.OP_ASINH: "asinh",
    ca.OP_ACOSH: "acosh",
    ca.OP_ATANH: "atanh",
    ca.OP_FLOOR: "floor",
    ca.OP_CEIL: "ceil",
    ca.OP_ERF: "erf",
    ca.OP_LOG1P: "log1p",
    ca.OP_EXPM1: "expm1",
}
_BINARY = {
    ca.OP_POW: "pow",
    ca.OP_CONSTPOW: "pow",
    ca.OP_FMIN: "fmin",
    ca.OP_FMAX: "fmax",
    ca.OP_FMOD: "fmod",
    ca.OP_REMAINDER: "remainder",
    ca.OP_ATAN2: "atan2",
    ca.OP_HYPOT: "hypot",
    ca.OP_COPYSIGN: "copysign",
}

_HEAD = """#include <math.h>
/* Neither aligned as a whole nor of a type of its own: they lie in arrays of double. */
typedef double wide __attribute__((vector_size({bytes}), aligned(8), may_alias));
typedef long long mask __attribute__((vector_size({bytes}), aligned(8), may_alias));
/* What is left in wide registers slows all code that knows narrow ones only, such as MUMPS. */
#ifdef __AVX__
#define LEAVE __builtin_ia32_vzeroupper()
#else
#define LEAVE
#endif
#define TRUE(a) ((wide)((mask)(a) & (mask)((wide){{0}} + 1.0)))
"""
_EACH = """static __attribute__((noinline)) wide each_{name}({arguments}) {{
  wide r;
  for (int k = 0; k < {lanes}; k++) r[k] = {name}({lane});
  return r;
}}
"""


def wide_code(functions: Sequence[ca.Function], shared: Sequence[int]) -> str:
    """C code of the functions at `LANES` points at once, for `casadi.external`.

    Parameters
    ----------
    functions : sequence of casadi.Function
        Of SX. Inputs and outputs of the points stand side by side: (m, n) becomes (m, LANES n).
    shared : sequence of int
        Inputs that are the same at all points.
    """
    code = [line for function in functions for line in _definition(function, shared)]
    used = {function.instruction_id(k) for function in functions for k in _instructions(function)}
    head = [_HEAD.format(bytes=8 * LANES)]
    for names, arguments, lane in (
        (_UNARY, "wide a", "a[k]"),
        (_BINARY, "wide a, wide b", "a[k], b[k]"),
    ):
        head += [
            _EACH.format(name=name, arguments=arguments, lane=lane, lanes=LANES)
            for name in sorted({name for operation, name in names.items() if operation in used})
        ]
    return "\n".join([*head, *code])


def _instructions(function: ca.Function) -> range:
    return range(function.n_instructions())


def _definition(function: ca.Function, shared: Sequence[int]) -> Iterator[str]:
    name, work = function.name(), LANES * function.sz_w()
    inputs, outputs = function.n_in(), function.n_out()
    sparsity = {
        "in": [_wide(function.sparsity_in(i), i in shared) for i in range(inputs)],
        "out": [_wide(function.sparsity_out(i), False) for i in range(outputs)],
    }
    body = [_line(function, k, shared) for k in _instructions(function)]
    arguments = "const double** arg, double** res, wide* w"
    parts = range(0, len(body), _LONGEST)
    for k in parts:
        yield f"static __attribute__((noinline)) void {name}_{k}({arguments}) {{"
        yield from body[k : k + _LONGEST]
        yield "}"
    yield f"int {name}(const double** arg, double** res, long long* iw, double* w, int mem) {{"
    most = max(1, *(each.nnz() for each in sparsity["in"]))
    yield f"  static const double none[{most}];"
    yield f"  for (int k = 0; k < {outputs}; k++) if (!res[k]) return 0;"
    yield f"  const double* given[{inputs}];"
    yield f"  for (int k = 0; k < {inputs}; k++) given[k] = arg[k] ? arg[k] : none;"
    yield from (f"  {name}_{k}(given, res, (wide*)w);" for k in parts)
    yield "  LEAVE;\n  return 0;\n}"
    for side, patterns in sparsity.items():
        yield f"long long {name}_n_{side}(void) {{ return {len(patterns)}; }}"
        yield f"const long long* {name}_sparsity_{side}(long long i) {{"
        for i, pattern in enumerate(patterns):
            numbers = ", ".join(map(str, pattern.compress()))
            yield f"  static const long long s{i}[] = {{{numbers}}};"
        chosen = "".join(f"i == {i} ? s{i} : " for i in range(len(patterns)))
        yield f"  return {chosen}0;\n}}"
    yield f"int {name}_work(long long* a, long long* r, long long* iw, long long* w) {{"
    yield f"  *a = {inputs}; *r = {outputs}; *iw = 0; *w = {work};\n  return 0;\n}}"


def _wide(sparsity: ca.Sparsity, same: bool) -> ca.Sparsity:
    return sparsity if same else ca.repmat(sparsity, 1, LANES)


def _line(function: ca.Function, k: int, shared: Sequence[int]) -> str:
    """C code of one operation on all lanes."""
    operation = function.instruction_id(k)
    read, written = function.instruction_input(k), function.instruction_output(k)
    if operation == ca.OP_OUTPUT:
        out, place = written
        size = function.nnz_out(out)
        lanes = (
            f"res[{out}][{place + lane * size}] = w[{read[0]}][{lane}];" for lane in range(LANES)
        )
        return "  " + " ".join(lanes)
    if operation == ca.OP_INPUT:
        given, place = read
        size = 0 if given in shared else function.nnz_in(given)
        lanes = (f"arg[{given}][{place + lane * size}]" for lane in range(LANES))
        return f"  w[{written[0]}] = (wide){{{', '.join(lanes)}}};"
    if operation == ca.OP_CONST:
        number = float(function.instruction_constant(k)).hex()
        return f"  w[{written[0]}] = (wide){{0}} + {number};"
    values = [f"w[{place}]" for place in read]
    return f"  w[{written[0]}] = {_computed(operation, values)};"


def _computed(operation: int, values: list[str]) -> str:
    if operation in _INFIX:
        return _INFIX[operation].join(values)
    if operation in _COMPARED:
        return f"TRUE({_COMPARED[operation].join(values)})"
    if operation in _SIMPLE:
        return _SIMPLE[operation].format(*values)
    name = _UNARY.get(operation) or _BINARY[operation]
    return f"each_{name}({', '.join(values)})"
