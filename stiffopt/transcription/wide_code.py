"""C code of stage functions that computes several points at once, each in a lane of the registers.

A stage's second derivatives are a hundred thousand operations. Written out in C they take the
compiler half a minute, and the processor waits for them to be fetched rather than done. Here they
are numbers that a few dozen loops read: each loop is one computation, of other places of a work
vector every time, for all points. Every lane does what the function of one point does, operation
by operation, so its digits are the same.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence

import casadi as ca

from stiffopt.c_code import HEAD
from stiffopt.transcription.operations import operations_of
from stiffopt.transcription.runs import in_runs, places
from stiffopt.transcription.sums import instructions

# Points of a call. Of more an instruction is fetched less often, but values leave the cache.
POINTS = 16
# Calls that are recalled: those of 2048 points, as of 1000 intervals.
CALLS = 128

# What operations compute, of x0 and x1.
_WIDE = {
    ca.OP_ASSIGN: "x0",
    ca.OP_MUL: "x0*x1",
    ca.OP_DIV: "x0/x1",
    ca.OP_NEG: "-x0",
    ca.OP_SQ: "x0*x0",
    ca.OP_TWICE: "2.0*x0",
    ca.OP_INV: "1.0/x0",
    ca.OP_LT: "TRUE(x0 < x1)",
    ca.OP_LE: "TRUE(x0 <= x1)",
    ca.OP_EQ: "TRUE(x0 == x1)",
    ca.OP_NE: "TRUE(x0 != x1)",
    ca.OP_NOT: "TRUE(x0 == 0.0)",
    ca.OP_AND: "TRUE((x0 != 0.0) & (x1 != 0.0))",
    ca.OP_OR: "TRUE((x0 != 0.0) | (x1 != 0.0))",
    # Of zero itself, and of what is no number.
    ca.OP_SIGN: "CHOSEN((x0 < 0.0) | (x0 > 0.0), TRUE(x0 > 0.0) - TRUE(x0 < 0.0), x0)",
    ca.OP_FABS: "(wide)((mask)x0 & 0x7fffffffffffffffLL)",
    ca.OP_IF_ELSE_ZERO: "(wide)((x0 != 0.0) & (mask)x1)",
    # What is no number loses, as in math.h.
    ca.OP_FMAX: "CHOSEN((x0 > x1) | (x1 != x1), x0, x1)",
    ca.OP_FMIN: "CHOSEN((x0 < x1) | (x1 != x1), x0, x1)",
}
# Point by point, by the functions of math.h.
_SINGLE = {
    ca.OP_EXP: "exp(x0)",
    ca.OP_LOG: "log(x0)",
    ca.OP_SQRT: "sqrt(x0)",
    ca.OP_SIN: "sin(x0)",
    ca.OP_COS: "cos(x0)",
    ca.OP_TAN: "tan(x0)",
    ca.OP_ASIN: "asin(x0)",
    ca.OP_ACOS: "acos(x0)",
    ca.OP_ATAN: "atan(x0)",
    ca.OP_SINH: "sinh(x0)",
    ca.OP_COSH: "cosh(x0)",
    ca.OP_TANH: "tanh(x0)",
    ca.OP_ASINH: "asinh(x0)",
    ca.OP_ACOSH: "acosh(x0)",
    ca.OP_ATANH: "atanh(x0)",
    ca.OP_FLOOR: "floor(x0)",
    ca.OP_CEIL: "ceil(x0)",
    ca.OP_ERF: "erf(x0)",
    ca.OP_LOG1P: "log1p(x0)",
    ca.OP_EXPM1: "expm1(x0)",
    ca.OP_POW: "pow(x0, x1)",
    ca.OP_CONSTPOW: "pow(x0, x1)",
    ca.OP_FMOD: "fmod(x0, x1)",
    ca.OP_REMAINDER: "remainder(x0, x1)",
    ca.OP_ATAN2: "atan2(x0, x1)",
    ca.OP_HYPOT: "hypot(x0, x1)",
    ca.OP_COPYSIGN: "copysign(x0, x1)",
}
# How every operation is an instruction, but sums.
KINDS = _WIDE | _SINGLE

_HEAD = f"""#define POINTS {POINTS}
typedef long long mask __attribute__((vector_size(8 * LANES), aligned(8), may_alias));
#define TRUE(a) ((wide)((mask)(a) & (mask)((wide){{0}} + 1.0)))
#define CHOSEN(m, a, b) ((wide)(((m) & (mask)(a)) | (~(m) & (mask)(b))))
#define EACH_POINT for (int k = 0; k < POINTS; k++)
#define EACH_WIDE _Pragma("GCC unroll 8") for (int k = 0; k < POINTS / LANES; k++)

/* What a function is made of: lists that end with -1. Of every input and output the numbers of a
   point, 0 where all points share them, and of all points. */
typedef struct {{
  const int *given, *constants, *runs, *read, *found;
  const double* numbers;
  const long *widths, *lengths, *sizes;
}} formula;

static void run(const int* r, const int* e, double* w);

static void evaluate(const formula* f, const double** arg, double** res, double* w) {{
  w += (64 - (size_t)w % 64) % 64 / sizeof *w;
  for (const int* g = f->given; g[0] >= 0; g += 3) {{
    const double* from = arg[g[0]];
    EACH_POINT w[g[2] + k] = from ? from[g[1] + k * f->widths[g[0]]] : 0.0;
  }}
  for (int i = 0; f->constants[i] >= 0; i++)
    EACH_POINT w[f->constants[i] + k] = f->numbers[i];
  run(f->runs, f->read, w);
  LEAVE;
  for (const int* g = f->found; g[0] >= 0; g += 3)
    EACH_POINT res[g[0]][g[1] + k * f->sizes[g[0]]] = w[g[2] + k];
}}
"""
# An optimiser asks for gradient, rows, slopes and curvatures at the same variables, and each of
# them needs the stage's values or slopes again.
_MEMORY = f"""#define CALLS {CALLS}
typedef struct {{ double *given[CALLS], *found[CALLS]; int next; }} memory;

/* As `evaluate`, of one output; with the inputs of one of the last calls what that has found. */
static void recall(memory** own, const formula* f, const double** arg, double** res, double* w) {{
  memory* m = *own ? *own : (*own = calloc(1, sizeof(memory)));
  const size_t size = f->sizes[0] * POINTS * sizeof(double);
  size_t given = 0;
  int i, known = m != 0;
  for (i = 0; f->lengths[i] >= 0; i++) {{
    given += f->lengths[i] * sizeof(double);
    known &= arg[i] != 0;
  }}
  for (int k = 0; known && k < CALLS && m->given[k]; k++) {{
    const double* from = m->given[k];
    for (i = 0; f->lengths[i] >= 0; from += f->lengths[i++])
      if (memcmp(from, arg[i], f->lengths[i] * sizeof(double))) break;
    if (f->lengths[i] < 0) {{
      memcpy(res[0], m->found[k], size);
      return;
    }}
  }}
  evaluate(f, arg, res, w);
  if (!known) return;
  const int k = m->next;
  if (!m->found[k] && !(m->found[k] = malloc(size))) return;
  if (!m->given[k] && !(m->given[k] = malloc(given))) return;
  double* to = m->given[k];
  for (i = 0; f->lengths[i] >= 0; to += f->lengths[i++])
    memcpy(to, arg[i], f->lengths[i] * sizeof(double));
  memcpy(m->found[k], res[0], size);
  m->next = (k + 1) % CALLS;
}}

static void forget(memory** own) {{
  for (int k = 0; *own && k < CALLS; k++) {{
    free((*own)->given[k]);
    free((*own)->found[k]);
  }}
  free(*own);
  *own = 0;
}}
"""


def wide_code(
    functions: Sequence[ca.Function], shared: Sequence[int], recalled: Sequence[str] = ()
) -> str:
    """C code of the functions at `POINTS` points at once, for `casadi.external`.

    Parameters
    ----------
    functions : sequence of casadi.Function
        Of SX. Inputs and outputs of the points stand side by side: (m, n) becomes (m, POINTS n).
    shared : sequence of int
        Inputs that are the same at all points.
    recalled : sequence of str
        Functions of one output that are called with the same inputs again and again.
    """
    kinds: dict[str, int] = {}
    code = [line for each in functions for line in _definition(each, shared, recalled, kinds)]
    return "\n".join([HEAD, _HEAD, *([_MEMORY] if recalled else []), *code, *_loops(kinds)])


def _definition(
    function: ca.Function, shared: Sequence[int], recalled: Sequence[str], kinds: dict[str, int]
) -> Iterator[str]:
    """Lines of a function; kinds of instructions that are new are numbered."""
    name, operations = function.name(), operations_of(function)
    runs = in_runs(instructions(operations, KINDS))
    given = [v for v in range(len(operations.values)) if not operations.is_computed(v)]
    place, count = places(given, runs, [value for _, _, value in operations.results])
    at = {value: POINTS * number for value, number in place.items()}
    for each in runs:
        kinds.setdefault(each[0].kind, len(kinds))
    inputs = [v for v in given if operations.values[v][0] == ca.OP_INPUT]
    constants = [v for v in given if operations.values[v][0] == ca.OP_CONST]
    widths = [function.nnz_in(i) * (i not in shared) for i in range(function.n_in())]
    lengths = [function.nnz_in(i) * (POINTS if w else 1) for i, w in enumerate(widths)]
    sizes = [function.nnz_out(i) for i in range(function.n_out())]
    lists: dict[str, Iterable[object]] = {
        "int given": [k for v in inputs for k in (*operations.values[v][1], at[v])],
        "int constants": [at[v] for v in constants],
        "int runs": [k for run in runs for k in (kinds[run[0].kind], len(run))],
        "int read": [at[v] for run in runs for each in run for v in (each.value, *each.read)],
        "int found": [k for out, row, v in operations.results for k in (out, row, at[v])],
        "double numbers": [_in_c(operations.values[v][1][0]) for v in constants],
        "long widths": widths,
        "long lengths": lengths,
        "long sizes": sizes,
    }
    parts = []
    for title, entries in lists.items():
        kind, _, part = title.partition(" ")
        yield f"static const {kind} {name}_{part}[] = {{{', '.join(map(str, [*entries, -1]))}}};"
        parts.append(f".{part} = {name}_{part}")
    yield f"static const formula {name}_formula = {{{', '.join(parts)}}};"
    if name in recalled:
        # A thread has its own. CasADi tells of every use that begins and ends.
        yield f"static __thread memory* {name}_own;\nstatic long {name}_users;"
        yield f"void {name}_incref(void) {{ {name}_users++; }}"
        yield f"void {name}_decref(void) {{ if (!--{name}_users) forget(&{name}_own); }}"
    yield f"int {name}(const double** arg, double** res, long long* iw, double* w, int mem) {{"
    yield f"  for (int k = 0; k < {len(sizes)}; k++) if (!res[k]) return 0;"
    if name in recalled:
        yield f"  recall(&{name}_own, &{name}_formula, arg, res, w);"
    else:
        yield f"  evaluate(&{name}_formula, arg, res, w);"
    yield "  return 0;\n}"
    yield from _shapes(function, shared, POINTS * count + 8)


def _in_c(number: str) -> str:
    """A number as C writes it; one that has no digits by its name in math.h."""
    return number.replace("inf", "INFINITY").replace("nan", "NAN")


def _shapes(function: ca.Function, shared: Sequence[int], work: int) -> Iterator[str]:
    """What CasADi asks of a function besides its values."""
    name, inputs, outputs = function.name(), function.n_in(), function.n_out()
    patterns = {
        "in": [_of_points(function.sparsity_in(i), i in shared) for i in range(inputs)],
        "out": [_of_points(function.sparsity_out(i), False) for i in range(outputs)],
    }
    for side, each in patterns.items():
        yield f"long long {name}_n_{side}(void) {{ return {len(each)}; }}"
        yield f"const long long* {name}_sparsity_{side}(long long i) {{"
        for i, pattern in enumerate(each):
            entries = ", ".join(map(str, pattern.compress()))
            yield f"  static const long long s{i}[] = {{{entries}}};"
        chosen = "".join(f"i == {i} ? s{i} : " for i in range(len(each)))
        yield f"  return {chosen}0;\n}}"
    yield f"int {name}_work(long long* a, long long* r, long long* iw, long long* w) {{"
    yield f"  *a = {inputs}; *r = {outputs}; *iw = 0; *w = {work};\n  return 0;\n}}"


def _of_points(sparsity: ca.Sparsity, same: bool) -> ca.Sparsity:
    return sparsity if same else ca.repmat(sparsity, 1, POINTS)


def _loops(kinds: dict[str, int]) -> Iterator[str]:
    """The loops that all functions share, one for each kind of instruction."""
    yield "static void run(const int* r, const int* e, double* w) {"
    yield "  for (; r[0] >= 0; r += 2) switch (r[0]) {"
    for kind, number in kinds.items():
        # Wide registers are left before functions that know narrow ones only: with what is in
        # their other halves a logarithm takes ten times as long.
        single = kind in _SINGLE.values()
        type_, each, leave = ("double", "POINT", "LEAVE; ") if single else ("wide", "WIDE", "")
        read = len(set(re.findall(r"\bx\d+", kind)))
        names = ["to", *(f"x{k}" for k in range(read))]
        pointers = ", ".join(f"*{name} = ({type_}*)(w + e[{k}])" for k, name in enumerate(names))
        of_point = re.sub(r"\b(x\d+)", r"\1[k]", kind)
        yield f"  case {number}:"
        step = read + 1
        yield f"    {leave}for (const int* end = e + {step}L * r[1]; e < end; e += {step}) {{"
        yield f"      {type_} {pointers};"
        yield f"      EACH_{each} to[k] = {of_point};"
        yield "    }\n    break;"
    yield "  }\n}"
