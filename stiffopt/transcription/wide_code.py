"""C code of stage functions that computes several points at once, each in a lane of the registers.

A stage's second derivatives are a hundred thousand operations in a row: the processor waits for
them to be fetched rather than done. Of several points at once each is fetched for all. Every lane
does what the function of one point does, operation by operation, so the numbers are the same.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from stiffopt.c_code import HEAD

# Values that are compiled as one: of more the compiler takes longer, of fewer more are kept.
_LONGEST = 250
# Points of a call: the lanes of the widest registers, and a multiple of those of any other.
POINTS = 8

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
    # What is no number loses, as in math.h.
    ca.OP_FMAX: "CHOSEN(({0} > {1}) | ({1} != {1}), {0}, {1})",
    ca.OP_FMIN: "CHOSEN(({0} < {1}) | ({1} != {1}), {0}, {1})",
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
    ca.OP_FMOD: "fmod",
    ca.OP_REMAINDER: "remainder",
    ca.OP_ATAN2: "atan2",
    ca.OP_HYPOT: "hypot",
    ca.OP_COPYSIGN: "copysign",
}

_HEAD = """#if LANES == 8
#define GET(a, s) (wide){a[0], a[s], a[2*s], a[3*s], a[4*s], a[5*s], a[6*s], a[7*s]}
#elif LANES == 4
#define GET(a, s) (wide){a[0], a[s], a[2*s], a[3*s]}
#else
#define GET(a, s) (wide){a[0], a[s]}
#endif
typedef long long mask __attribute__((vector_size(8 * LANES), aligned(8), may_alias));
#define TRUE(a) ((wide)((mask)(a) & (mask)((wide){0} + 1.0)))
#define CHOSEN(m, a, b) ((wide)(((m) & (mask)a) | (~(m) & (mask)b)))
static __attribute__((noinline)) void put(double* to, long step, wide v) {
  for (int k = 0; k < LANES; k++) to[k * step] = v[k];
}
"""
_STORED_A = "memcpy(x, &a, sizeof a);"
# Before functions that know narrow registers only: with what is left in the wide ones a logarithm
# takes ten times as long.
_EACH = """static __attribute__((noinline)) wide each_{name}({arguments}) {{
  double x[LANES]{second};
  {stored}
  LEAVE;
  for (int k = 0; k < LANES; k++) x[k] = {name}({lane});
  wide r;
  memcpy(&r, x, sizeof r);
  return r;
}}
"""


def wide_code(functions: Sequence[ca.Function], shared: Sequence[int]) -> str:
    """C code of the functions at `POINTS` points at once, for `casadi.external`.

    Parameters
    ----------
    functions : sequence of casadi.Function
        Of SX. Inputs and outputs of the points stand side by side: (m, n) becomes (m, POINTS n).
    shared : sequence of int
        Inputs that are the same at all points.
    """
    read = [_operations(function) for function in functions]
    code = [line for each in read for line in _definition(each, shared)]
    used = {operation for each in read for operation, _ in each.operations}
    head = [HEAD, _HEAD]
    one = {"arguments": "wide a", "second": "", "stored": _STORED_A, "lane": "x[k]"}
    two = {
        "arguments": "wide a, wide b",
        "second": ", y[LANES]",
        "stored": f"{_STORED_A} memcpy(y, &b, sizeof b);",
        "lane": "x[k], y[k]",
    }
    for names, taken in ((_UNARY, one), (_BINARY, two)):
        chosen = sorted({name for operation, name in names.items() if operation in used})
        head += [_EACH.format(name=name, **taken) for name in chosen]
    return "\n".join([*head, *code])


@dataclass(frozen=True)
class _Operations:
    """A function as values that are computed one after another, none of them twice.

    `operations` holds what each value is: (operation, numbers of the values that it reads), or
    (input, place), or (constant,). `results` are (output, place, value).
    """

    function: ca.Function
    operations: list[tuple[int, tuple[Any, ...]]]
    results: list[tuple[int, int, int]]

    def read_by(self, value: int) -> tuple[int, ...]:
        operation, read = self.operations[value]
        return () if operation in (ca.OP_INPUT, ca.OP_CONST) else read


def _operations(function: ca.Function) -> _Operations:
    numbers: dict[tuple[int, tuple[Any, ...]], int] = {}
    results: list[tuple[int, int, int]] = []
    held: dict[int, int] = {}  # value in each place of the work vector
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        read, written = function.instruction_input(k), function.instruction_output(k)
        if operation == ca.OP_OUTPUT:
            out, place = written
            results.append((out, place, held[read[0]]))
            continue
        what: tuple[Any, ...]
        if operation == ca.OP_INPUT:
            what = tuple(read)
        elif operation == ca.OP_CONST:
            what = (_in_c(float(function.instruction_constant(k))),)
        else:
            what = tuple(held[place] for place in read)
            if operation in (ca.OP_ADD, ca.OP_MUL):
                what = tuple(sorted(what))
        held[written[0]] = numbers.setdefault((operation, what), len(numbers))
    return _Operations(function, list(numbers), results)


def _in_c(number: float) -> str:
    """All its digits; what has none by the names of math.h."""
    if math.isnan(number):
        return "NAN"
    return number.hex().replace("inf", "INFINITY")


def _definition(read: _Operations, shared: Sequence[int]) -> Iterator[str]:
    function = read.function
    name, inputs, outputs = function.name(), function.n_in(), function.n_out()
    sparsity = {
        "in": [_wide(function.sparsity_in(i), i in shared) for i in range(inputs)],
        "out": [_wide(function.sparsity_out(i), False) for i in range(outputs)],
    }
    parts, kept = _parts(read, shared)
    arguments = "const double** arg, double** res, wide* w"
    widths = ", ".join("0" if i in shared else str(function.nnz_in(i)) for i in range(inputs))
    sizes = ", ".join(str(function.nnz_out(i)) for i in range(outputs))
    for k, part in enumerate(parts):
        yield f"static __attribute__((noinline)) void {name}_{k}({arguments}) {{"
        yield from part
        yield "}"
    yield f"int {name}(const double** arg, double** res, long long* iw, double* w, int mem) {{"
    most = max(1, *(each.nnz() for each in sparsity["in"]))
    yield f"  static const double none[{most}];"
    yield f"  for (int k = 0; k < {outputs}; k++) if (!res[k]) return 0;"
    yield f"  static const long widths[] = {{{widths}}}, sizes[] = {{{sizes}}};"
    yield f"  const double* given[{inputs}];"
    yield f"  double* found[{outputs}];"
    yield f"  for (int g = 0; g < {POINTS}; g += LANES) {{"
    yield f"    for (int k = 0; k < {inputs}; k++)"
    yield "      given[k] = arg[k] ? arg[k] + g * widths[k] : none;"
    yield f"    for (int k = 0; k < {outputs}; k++) found[k] = res[k] + g * sizes[k];"
    yield from (f"    {name}_{k}(given, found, (wide*)w);" for k in range(len(parts)))
    yield "  }\n  LEAVE;\n  return 0;\n}"
    for side, patterns in sparsity.items():
        yield f"long long {name}_n_{side}(void) {{ return {len(patterns)}; }}"
        yield f"const long long* {name}_sparsity_{side}(long long i) {{"
        for i, pattern in enumerate(patterns):
            entries = ", ".join(map(str, pattern.compress()))
            yield f"  static const long long s{i}[] = {{{entries}}};"
        chosen = "".join(f"i == {i} ? s{i} : " for i in range(len(patterns)))
        yield f"  return {chosen}0;\n}}"
    yield f"int {name}_work(long long* a, long long* r, long long* iw, long long* w) {{"
    yield f"  *a = {inputs}; *r = {outputs}; *iw = 0; *w = {POINTS * kept};\n  return 0;\n}}"


def _wide(sparsity: ca.Sparsity, same: bool) -> ca.Sparsity:
    return sparsity if same else ca.repmat(sparsity, 1, POINTS)


def _parts(read: _Operations, shared: Sequence[int]) -> tuple[list[list[str]], int]:
    """Lines of the values part by part, and how many values are kept from part to part.

    Within a part values are variables: of an array the compiler would have to follow every place.
    """
    count = len(read.operations)
    last = [value // _LONGEST for value in range(count)]  # part that needs a value last
    results: dict[int, list[tuple[int, int, int]]] = {}
    for value in range(count):
        for each in read.read_by(value):
            last[each] = value // _LONGEST
    for result in read.results:
        results.setdefault(result[2] // _LONGEST, []).append(result)
    parts: list[list[str]] = []
    places: dict[int, int] = {}
    free: list[int] = []
    kept = 0
    for part, start in enumerate(range(0, count, _LONGEST)):
        names = {value: f"w[{place}]" for value, place in places.items()}
        lines = []
        for value in range(start, min(start + _LONGEST, count)):
            lines.append(f"  const wide v{value} = {_value(read, value, names, shared)};")
            names[value] = f"v{value}"
        for out, place, value in results.get(part, []):
            size = read.function.nnz_out(out)
            lines.append(f"  put(res[{out}] + {place}, {size}, v{value});")
        free += [places.pop(value) for value in list(places) if last[value] <= part]
        for value in range(start, min(start + _LONGEST, count)):
            if last[value] > part:
                places[value] = free.pop() if free else kept
                kept = max(kept, places[value] + 1)
                lines.append(f"  w[{places[value]}] = v{value};")
        parts.append(lines)
    return parts, kept


def _value(read: _Operations, value: int, names: dict[int, str], shared: Sequence[int]) -> str:
    """C expression of a value on all lanes."""
    operation, what = read.operations[value]
    if operation == ca.OP_INPUT:
        given, place = what
        size = 0 if given in shared else read.function.nnz_in(given)
        return f"GET((arg[{given}] + {place}), {size})"
    if operation == ca.OP_CONST:
        return f"(wide){{0}} + {what[0]}"
    return _computed(operation, [names[each] for each in what])


def _computed(operation: int, values: list[str]) -> str:
    if operation in _INFIX:
        return _INFIX[operation].join(values)
    if operation in _COMPARED:
        return f"TRUE({_COMPARED[operation].join(values)})"
    if operation in _SIMPLE:
        return _SIMPLE[operation].format(*values)
    name = _UNARY.get(operation) or _BINARY[operation]
    return f"each_{name}({', '.join(values)})"
