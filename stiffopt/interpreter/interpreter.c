/* Evaluation of formulas given as numbers: batches of instructions of one kind each, at POINTS points at once.

A loaded formula takes one of SLOTS sets of functions that `casadi.external` finds by name (batch_00, ..). CasADi
tells of every use that begins and ends; with the last one the formula is freed. Every lane of a register holds
another point and computes what the function of one point would, operation by operation, to the same bit. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* More points fetch an instruction less often, but values leave the near caches. */
#define POINTS 16
/* Calls that are recalled: those of 2048 points, as of 1000 intervals. */
#define CALLS 128

#define TRUE(a) ((wide)((mask)(a) & (mask)((wide){0} + 1.0)))
#define CHOSEN(m, a, b) ((wide)(((m) & (mask)(a)) | (~(m) & (mask)(b))))

/* All kinds of instructions: W of a register of points, S point by point, by the functions of math.h, each by the
   name of a CasADi operation; and sums of up to six terms, which are named by themselves. Of sums, all of two terms
   and the longer ones that are most frequent in stages of the UR10 and the ER3A (of more kinds batches are shorter);
   others are put together from them. */
#define KINDS(W, S, SUM) \
  W(ASSIGN, 1, x0) \
  W(MUL, 2, x0*x1) \
  W(DIV, 2, x0/x1) \
  W(NEG, 1, -x0) \
  W(SQ, 1, x0*x0) \
  W(TWICE, 1, 2.0*x0) \
  W(INV, 1, 1.0/x0) \
  W(LT, 2, TRUE(x0 < x1)) \
  W(LE, 2, TRUE(x0 <= x1)) \
  W(EQ, 2, TRUE(x0 == x1)) \
  W(NE, 2, TRUE(x0 != x1)) \
  W(NOT, 1, TRUE(x0 == 0.0)) \
  W(AND, 2, TRUE((x0 != 0.0) & (x1 != 0.0))) \
  W(OR, 2, TRUE((x0 != 0.0) | (x1 != 0.0))) \
  /* Of zero itself, and of what is no number. */ \
  W(SIGN, 1, CHOSEN((x0 < 0.0) | (x0 > 0.0), TRUE(x0 > 0.0) - TRUE(x0 < 0.0), x0)) \
  W(FABS, 1, (wide)((mask)x0 & 0x7fffffffffffffffLL)) \
  W(IF_ELSE_ZERO, 2, (wide)((x0 != 0.0) & (mask)x1)) \
  /* What is no number loses, as in math.h. */ \
  W(FMAX, 2, CHOSEN((x0 > x1) | (x1 != x1), x0, x1)) \
  W(FMIN, 2, CHOSEN((x0 < x1) | (x1 != x1), x0, x1)) \
  S(EXP, 1, exp(x0)) \
  S(LOG, 1, log(x0)) \
  S(SQRT, 1, sqrt(x0)) \
  S(SIN, 1, sin(x0)) \
  S(COS, 1, cos(x0)) \
  S(TAN, 1, tan(x0)) \
  S(ASIN, 1, asin(x0)) \
  S(ACOS, 1, acos(x0)) \
  S(ATAN, 1, atan(x0)) \
  S(SINH, 1, sinh(x0)) \
  S(COSH, 1, cosh(x0)) \
  S(TANH, 1, tanh(x0)) \
  S(ASINH, 1, asinh(x0)) \
  S(ACOSH, 1, acosh(x0)) \
  S(ATANH, 1, atanh(x0)) \
  S(FLOOR, 1, floor(x0)) \
  S(CEIL, 1, ceil(x0)) \
  S(ERF, 1, erf(x0)) \
  S(LOG1P, 1, log1p(x0)) \
  S(EXPM1, 1, expm1(x0)) \
  S(POW, 2, pow(x0, x1)) \
  S(CONSTPOW, 2, pow(x0, x1)) \
  S(FMOD, 2, fmod(x0, x1)) \
  S(REMAINDER, 2, remainder(x0, x1)) \
  S(ATAN2, 2, atan2(x0, x1)) \
  S(HYPOT, 2, hypot(x0, x1)) \
  S(COPYSIGN, 2, copysign(x0, x1)) \
  SUM(2, x0+x1) \
  SUM(2, x0-x1) \
  SUM(3, x0*x1+x2) \
  SUM(3, x0*x1-x2) \
  SUM(3, x0+x1*x2) \
  SUM(3, x0-x1*x2) \
  SUM(4, x0*x1+x2*x3) \
  SUM(4, x0*x1-x2*x3) \
  SUM(5, x0*x1+x2*x3+x4) \
  SUM(12, x0*x1+x2*x3+x4*x5+x6*x7+x8*x9+x10*x11) \
  SUM(5, x0*x1+x2*x3-x4) \
  SUM(6, x0*x1+x2*x3+x4-x5) \
  SUM(4, x0*x1-x2+x3) \
  SUM(11, x0+x1*x2+x3*x4+x5*x6+x7*x8+x9*x10) \
  SUM(4, x0*x1+x2+x3) \
  SUM(6, x0*x1+x2*x3+x4*x5) \
  SUM(7, x0*x1+x2*x3+x4+x5-x6) \
  SUM(8, x0*x1+x2*x3+x4*x5+x6*x7) \
  SUM(5, x0*x1-x2+x3*x4) \
  SUM(10, x0*x1+x2*x3+x4*x5+x6*x7+x8*x9) \
  SUM(5, x0*x1-x2*x3-x4) \
  SUM(6, x0+x1+x2+x3+x4+x5) \
  SUM(6, x0*x1+x2*x3+x4+x5) \
  SUM(11, x0*x1+x2*x3+x4*x5+x6*x7+x8*x9+x10) \
  SUM(5, x0*x1-x2*x3+x4) \
  SUM(7, x0*x1+x2*x3+x4+x5+x6) \
  SUM(6, x0*x1-x2*x3+x4*x5) \
  SUM(6, x0*x1+x2*x3-x4+x5) \
  SUM(8, x0*x1+x2*x3+x4+x5+x6+x7) \
  SUM(4, x0*x1-x2-x3) \
  SUM(9, x0*x1+x2*x3+x4*x5-x6+x7*x8) \
  SUM(6, x0*x1-x2*x3-x4*x5) \
  SUM(8, x0*x1+x2*x3+x4+x5-x6+x7) \
  SUM(4, x0+x1+x2+x3)

#define NAME(name, n, expression) #name,
#define SUM_NAME(n, expression) #expression,
static const char* names[] = {KINDS(NAME, NAME, SUM_NAME) 0};

/* Names of the kinds, in the order of their numbers; 0 ends them. */
const char* const* batch_kinds(void) { return names; }

#define COUNTED(...) +1
enum { KIND_COUNT = KINDS(COUNTED, COUNTED, COUNTED) };

/* Kinds of sums by a number of their signs and factors, -1 where there is none. */
static int kind_of_form[1 << 13];

static int next_form(int form, int minus, int factors) { return 4 * form + 2 * minus + (factors == 2); }

static int first_form(int factors) { return next_form(1, 0, factors); }

static __attribute__((constructor)) void read_forms(void) {
  memset(kind_of_form, -1, sizeof kind_of_form);
  for (int kind = 0; kind < KIND_COUNT; kind++) {
    if (names[kind][0] != 'x') continue;
    int form = 1, minus = 0, factors = 1;
    for (const char* c = names[kind]; *c; c++) {
      factors += *c == '*';
      if (*c != '+' && *c != '-') continue;
      form = next_form(form, minus, factors);
      minus = *c == '-', factors = 1;
    }
    kind_of_form[next_form(form, minus, factors)] = kind;
  }
}

#include "preparation.c"

/* ------------------------------------------------------------------ a formula */

/* What a call has been given and has found. */
typedef struct { double *given[CALLS], *found[CALLS]; int next; } memory;

/* Lists that end with -1. Of every input and output the numbers of a point (`widths`, 0 where all points share
   them; `sizes`) and of all points (`lengths`). */
typedef struct {
  const int *given, *constants, *batches, *read, *found, *widths, *lengths, *sizes, *patterns;
  const double* numbers;
  const long long* sparsity; /* of all inputs, then of all outputs, from `patterns` on */
  long long inputs, outputs, work, recalled;
  long users;
  char busy; /* what is recalled is being looked at */
  memory* own;
} formula;

#define x0 p0[k]
#define x1 p1[k]
#define x2 p2[k]
#define x3 p3[k]
#define x4 p4[k]
#define x5 p5[k]
#define x6 p6[k]
#define x7 p7[k]
#define x8 p8[k]
#define x9 p9[k]
#define x10 p10[k]
#define x11 p11[k]
#define READ1(type) type *p0 = (type*)(w + e[1]);
#define READ2(type) READ1(type) type *p1 = (type*)(w + e[2]);
#define READ3(type) READ2(type) type *p2 = (type*)(w + e[3]);
#define READ4(type) READ3(type) type *p3 = (type*)(w + e[4]);
#define READ5(type) READ4(type) type *p4 = (type*)(w + e[5]);
#define READ6(type) READ5(type) type *p5 = (type*)(w + e[6]);
#define READ7(type) READ6(type) type *p6 = (type*)(w + e[7]);
#define READ8(type) READ7(type) type *p7 = (type*)(w + e[8]);
#define READ9(type) READ8(type) type *p8 = (type*)(w + e[9]);
#define READ10(type) READ9(type) type *p9 = (type*)(w + e[10]);
#define READ11(type) READ10(type) type *p10 = (type*)(w + e[11]);
#define READ12(type) READ11(type) type *p11 = (type*)(w + e[12]);
#define EACH_POINT for (int k = 0; k < POINTS; k++)
#define EACH_WIDE _Pragma("GCC unroll 8") for (int k = 0; k < POINTS / LANES; k++)
#define LOOP(type, each, n, expression) \
  case __COUNTER__ - FIRST: \
    for (const int* end = e + (n + 1L) * b[1]; e < end; e += n + 1) { \
      type* to = (type*)(w + e[0]); \
      READ##n(type) \
      each to[k] = expression; \
    } \
    break;
#define W_LOOP(name, n, expression) LOOP(wide, EACH_WIDE, n, expression)
#define S_LOOP(name, n, expression) LOOP(double, EACH_POINT, n, expression)
#define SUM_LOOP(n, expression) LOOP(wide, EACH_WIDE, n, expression)
/* A batch after the other, on a processor with registers of so many numbers. The types of registers are neither
   aligned as a whole nor of types of their own: they lie in arrays of double. */
#define RUN(name, lanes, target) \
  static target void name(const int* b, const int* e, double* w) { \
    enum { LANES = lanes, FIRST = __COUNTER__ + 1 }; \
    typedef double wide __attribute__((vector_size(8 * LANES), aligned(8), may_alias)); \
    typedef long long mask __attribute__((vector_size(8 * LANES), aligned(8), may_alias)); \
    for (; b[0] >= 0; b += 2) switch (b[0]) { KINDS(W_LOOP, S_LOOP, SUM_LOOP) } \
  }
RUN(run_any, 2, )
static void (*run)(const int*, const int*, double*) = run_any;

#ifdef __x86_64__
RUN(run_avx2, 4, __attribute__((target("avx2"))))
RUN(run_avx512, 8, __attribute__((target("avx512f"))))

static __attribute__((constructor)) void choose(void) {
  __builtin_cpu_init();
  if (__builtin_cpu_supports("avx2")) run = run_avx2;
  if (__builtin_cpu_supports("avx512f")) run = run_avx512;
}
#endif

static void evaluate(const formula* f, const double** arg, double** res, double* w) {
  w += (64 - (size_t)w % 64) % 64 / sizeof *w;
  for (const int* g = f->given; g[0] >= 0; g += 3) {
    const double* from = arg[g[0]];
    EACH_POINT w[g[2] + k] = from ? from[g[1] + k * f->widths[g[0]]] : 0.0;
  }
  for (int i = 0; f->constants[i] >= 0; i++)
    EACH_POINT w[f->constants[i] + k] = f->numbers[i];
  run(f->batches, f->read, w);
  for (const int* g = f->found; g[0] >= 0; g += 3) {
    double* to = res[g[0]];
    if (to) EACH_POINT to[g[1] + k * f->sizes[g[0]]] = w[g[2] + k];
  }
}

/* As `evaluate`, of one output; with the inputs of one of the last calls what that has found. An optimiser asks for
   gradient, rows, slopes and curvatures at the same variables, and each of them needs the values again. */
static void recall(formula* f, const double** arg, double** res, double* w) {
  memory* m = f->own ? f->own : (f->own = calloc(1, sizeof(memory)));
  const size_t size = f->sizes[0] * POINTS * sizeof(double);
  size_t given = 0;
  int i, known = m != 0;
  for (i = 0; f->lengths[i] >= 0; i++) {
    given += f->lengths[i] * sizeof(double);
    known &= arg[i] != 0;
  }
  for (int k = 0; known && k < CALLS && m->given[k]; k++) {
    const double* from = m->given[k];
    for (i = 0; f->lengths[i] >= 0; from += f->lengths[i++])
      if (memcmp(from, arg[i], f->lengths[i] * sizeof(double))) break;
    if (f->lengths[i] < 0) {
      memcpy(res[0], m->found[k], size);
      return;
    }
  }
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
}

/* A formula in one piece of memory. */
static formula* laid_out(const preparation* p, const int* shape, const int* sides, const long long* sparsity,
                         long long sparsity_count) {
  const long long inputs = shape[0], outputs = shape[1];
  const long long most = 6LL * p->values + 2 * p->batches + p->reads + p->instructions + 3 * p->results + 4 * inputs +
                         3 * outputs + 16;
  formula* f = calloc(1, sizeof *f + sparsity_count * sizeof *sparsity + p->values * sizeof(double) +
                             most * sizeof(int));
  if (!f) return 0;
  f->inputs = inputs, f->outputs = outputs, f->work = POINTS * p->places + 8, f->recalled = shape[2];
  long long* patterns = (long long*)(f + 1);
  double* numbers = (double*)(patterns + sparsity_count);
  int* to = (int*)(numbers + p->values);
  memcpy(patterns, sparsity, sparsity_count * sizeof *sparsity);
  f->sparsity = patterns, f->numbers = numbers;
  f->given = to;
  for (int v = 0; v < p->values; v++)
    if (p->value[v].operation == p->of->input)
      *to++ = p->value[v].first, *to++ = p->value[v].second, *to++ = POINTS * p->place[v];
  *to++ = -1;
  f->constants = to;
  for (int v = 0; v < p->values; v++)
    if (p->value[v].operation == p->of->constant) {
      memcpy(numbers++, &p->value[v].first, sizeof *numbers);
      *to++ = POINTS * p->place[v];
    }
  *to++ = -1;
  f->batches = memcpy(to, p->batch, 2 * p->batches * sizeof(int));
  to += 2 * p->batches;
  *to++ = -1;
  f->read = to;
  for (int k = 0; k < p->instructions; k++) {
    const instruction* own = p->instruction + p->order[k];
    *to++ = POINTS * p->place[own->value];
    for (int i = 0; i < own->reads; i++) *to++ = POINTS * p->place[p->read[own->read_at + i]];
  }
  f->found = to;
  for (int k = 0; k < p->results; k++)
    *to++ = p->result[k].output, *to++ = p->result[k].row, *to++ = POINTS * p->place[p->result[k].value];
  *to++ = -1;
  const int** into[] = {&f->widths, &f->lengths, &f->sizes, &f->patterns};
  const long long counts[] = {inputs, inputs, outputs, inputs + outputs};
  for (int k = 0; k < 4; sides += counts[k++]) {
    *into[k] = memcpy(to, sides, counts[k] * sizeof(int));
    to += counts[k];
    *to++ = -1;
  }
  return f;
}

static int call(formula* f, const double** arg, double** res, double* w) {
  int wanted = 0;
  for (int i = 0; i < f->outputs; i++) wanted |= res[i] != 0;
  if (!wanted) return 0;
  /* A second thread does without. */
  if (!f->recalled || __atomic_test_and_set(&f->busy, __ATOMIC_ACQUIRE)) evaluate(f, arg, res, w);
  else {
    recall(f, arg, res, w);
    __atomic_clear(&f->busy, __ATOMIC_RELEASE);
  }
  return 0;
}

/* ------------------------------------------------------------------ slots */

#define SLOTS 512
static formula* slots[SLOTS];

static void hold(int slot) { __atomic_add_fetch(&slots[slot]->users, 1, __ATOMIC_SEQ_CST); }

static void leave(int slot) {
  formula* f = slots[slot];
  if (__atomic_sub_fetch(&f->users, 1, __ATOMIC_SEQ_CST)) return;
  for (int k = 0; f->own && k < CALLS; k++) free(f->own->given[k]), free(f->own->found[k]);
  free(f->own);
  __atomic_store_n(&slots[slot], 0, __ATOMIC_RELEASE);
  free(f);
}

/* Prepare a function of `operations`; `shape`: inputs, outputs, and if its last calls are recalled. `sides`: for all
   inputs the numbers of a point (0 where all points share them), for all inputs those of all points, for all outputs
   those of a point, for all inputs and outputs where their pattern begins in `sparsity`.
   Returns its slot, which the last use that ends frees; -1 where there is none, or no memory. */
int batch_load(const operations* o, const int* shape, const int* sides, const long long* sparsity,
               long long sparsity_count) {
  preparation p;
  formula* f = prepare(&p, o) ? laid_out(&p, shape, sides, sparsity, sparsity_count) : 0;
  end_preparation(&p);
  for (int slot = 0; f && slot < SLOTS; slot++) {
    formula* none = 0;
    if (__atomic_compare_exchange_n(&slots[slot], &none, f, 0, __ATOMIC_SEQ_CST, __ATOMIC_SEQ_CST)) return slot;
  }
  free(f);
  return -1;
}

/* The functions of a slot, as `casadi.external` asks for them. */
#define SLOT(k) \
  int batch_##k(const double** a, double** r, long long* i, double* w, int m) { return call(slots[0x##k], a, r, w); } \
  void batch_##k##_incref(void) { hold(0x##k); } \
  void batch_##k##_decref(void) { leave(0x##k); } \
  long long batch_##k##_n_in(void) { return slots[0x##k]->inputs; } \
  long long batch_##k##_n_out(void) { return slots[0x##k]->outputs; } \
  const long long* batch_##k##_sparsity_in(long long i) { return pattern(0x##k, i); } \
  const long long* batch_##k##_sparsity_out(long long i) { return pattern(0x##k, slots[0x##k]->inputs + i); } \
  int batch_##k##_work(long long* a, long long* r, long long* i, long long* w) { return sized(0x##k, a, r, i, w); }

static const long long* pattern(int slot, long long i) { return slots[slot]->sparsity + slots[slot]->patterns[i]; }

static int sized(int slot, long long* arg, long long* res, long long* iw, long long* w) {
  *arg = slots[slot]->inputs, *res = slots[slot]->outputs, *iw = 0, *w = slots[slot]->work;
  return 0;
}

#define SIXTEEN(p) \
  SLOT(p##0) SLOT(p##1) SLOT(p##2) SLOT(p##3) SLOT(p##4) SLOT(p##5) SLOT(p##6) SLOT(p##7) \
  SLOT(p##8) SLOT(p##9) SLOT(p##a) SLOT(p##b) SLOT(p##c) SLOT(p##d) SLOT(p##e) SLOT(p##f)
#define SQUARE(p) \
  SIXTEEN(p##0) SIXTEEN(p##1) SIXTEEN(p##2) SIXTEEN(p##3) SIXTEEN(p##4) SIXTEEN(p##5) SIXTEEN(p##6) SIXTEEN(p##7) \
  SIXTEEN(p##8) SIXTEEN(p##9) SIXTEEN(p##a) SIXTEEN(p##b) SIXTEEN(p##c) SIXTEEN(p##d) SIXTEEN(p##e) SIXTEEN(p##f)
SQUARE(0)
SQUARE(1)
