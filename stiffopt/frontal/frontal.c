/* Linear systems of an interior-point method whose unknowns follow one another in time.

IPOPT loads the functions at the end under the names of HSL_MA97. A matrix is analysed once, with its
first values (`frontal_analysis.c`), and factorised front by front,
L D L^T with pivots of one or two, which wait where they are too small (Duff and Reid 1983): a front
is the unknowns that what is eliminated meets. */

#include <limits.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#if defined __GNUC__ && !defined __clang__
#pragma GCC optimize("O3")
#endif
#if defined __x86_64__ && defined __gnu_linux__
/* Compiled for several processors, of which the loader chooses; what it calls is compiled with it. */
#define HOT __attribute__((target_clones("avx512f", "avx2", "default"), flatten))
#else
#define HOT
#endif
/* Neither aligned as a whole nor of a type of its own: they lie in arrays of double. */
#define LANES 8
typedef double wide __attribute__((vector_size(8 * LANES), aligned(8), may_alias));

/* Largest front over the one that no pivot is delayed in, and slack for small systems. Beyond, the
   matrix counts as singular, and IPOPT regularises it: delayed pivots would fill all fronts. */
#define MAX_FRONT_GROWTH 2
#define FRONT_SLACK 64

#include "frontal_analysis.c"

/* ------------------------------------------------------------------ what IPOPT hands over */

struct control {
  int f_arrays, action, nemin;
  double multiplier;
  int ordering, print_level, scaling;
  double small, u;
  int unit_diagnostics, unit_error, unit_warning;
  long factor_min;
  int solve_blas3;
  long solve_min;
  int solve_mf;
  double consist_tol;
  int ispare[5];
  double rspare[10];
};

struct info {
  int flag, flag68, flag77, matrix_dup, matrix_rank, matrix_outrange, matrix_missing_diag;
  int maxdepth, maxfront, num_delay;
  long num_factor, num_flops;
  int num_neg, num_sup, num_two, ordering, stat, maxsupernode;
  int ispare[4];
  double rspare[10];
};

enum { NO_MEMORY = -1, SINGULAR = -7 };

/* ------------------------------------------------------------------ factors */

typedef struct {
  double *inverse;            /* per pair: of leaf, coupling and row */
  double *rows;               /* values of the pairs' rows */
  int pivots, *first, *second; /* kept places; second is -1 for a pivot of one */
  double *d;                  /* three per pivot: inverse of its block */
  long *start;                /* per pivot: its entries, one column or two after another */
  int *place;
  double *l;
  long capacity;
  int negative, delayed, two, front;
  double *matrix, *work;
} Factors;

static void drop(Factors *f) {
  if (!f) return;
  free(f->inverse); free(f->rows); free(f->first); free(f->second); free(f->d); free(f->start);
  free(f->place); free(f->l); free(f->matrix); free(f->work);
  free(f);
}

static Factors *prepared(const Analysis *a) {
  Factors *f = room(1, sizeof(Factors));
  if (!f) return NULL;
  f->inverse = room(3 * (size_t)a->pairs, sizeof(double));
  f->rows = room(a->start[a->pairs], sizeof(double));
  f->first = room(a->kept, sizeof(int));
  f->second = room(a->kept, sizeof(int));
  f->d = room(3 * (size_t)a->kept, sizeof(double));
  f->start = room(a->kept + 1, sizeof(long));
  f->matrix = room(a->size + LANES, sizeof(double));
  f->work = room(a->kept + a->width + LANES, sizeof(double));
  f->capacity = (long)a->kept * (a->width + a->border) + 1024;
  f->place = malloc(f->capacity * sizeof(int));
  f->l = malloc(f->capacity * sizeof(double));
  if (!f->inverse || !f->rows || !f->first || !f->second || !f->d || !f->start || !f->matrix || !f->work ||
      !f->place || !f->l) {
    drop(f);
    return NULL;
  }
  return f;
}

/* The pairs are eliminated, K is what is left. */
static HOT int condensed(const Analysis *a, const double *value, Factors *f) {
  double *k = f->matrix, *dense = f->work;
  memset(k, 0, a->size * sizeof(double));
  for (int d = 0; d < a->direct; d++) k[a->to[d]] += value[a->from[d]];
  long line = a->width + a->border;
  for (int p = 0; p < a->pairs; p++) {
    double leaf = a->leaf_at[p] < 0 ? 0.0 : value[a->leaf_at[p]];
    double row = a->row_at[p] < 0 ? 0.0 : value[a->row_at[p]];
    double coupling = value[a->coupling_at[p]], det = leaf * row - coupling * coupling;
    if (det == 0.0 || !isfinite(det)) return 0;
    f->negative += det < 0.0 ? 1 : leaf < 0.0 ? 2 : 0;
    f->inverse[3 * p] = row / det;
    f->inverse[3 * p + 1] = -coupling / det;
    double own = f->inverse[3 * p + 2] = leaf / det;
    const int *place = a->place;
    int begin = a->start[p], end = a->start[p + 1], bulk = begin;
    for (int i = begin; i < end; i++) f->rows[i] = value[a->at[i]];
    if (own == 0.0 || begin == end) continue;
    while (bulk < end && place[bulk] < a->bulk) bulk++;
    int first = place[begin], span = bulk > begin ? place[bulk - 1] - first + 1 : 0;
    /* Gaps are computed too: in lanes they cost nothing. */
    int gaps = span > 4 * (bulk - begin);
    if (!gaps && span) {
      memset(dense, 0, span * sizeof(double));
      for (int i = begin; i < bulk; i++) dense[place[i] - first] = f->rows[i];
    }
    for (int i = begin; i < end; i++) {
      double factor = -own * f->rows[i];
      int q = place[i], j = i;
      if (i < bulk && !gaps) {
        double *to = k + q * line;
        const double *by = dense + (q - first);
        int left = first + span - q;
        for (int s = 0; s < left; s++) to[s] += factor * by[s];
        j = bulk;
      }
      for (; j < end; j++) k[where(a, q, place[j])] += factor * f->rows[j];
    }
  }
  return 1;
}

typedef struct {
  int line, used, free_count, bulk;
  double *f;                  /* symmetric, whole */
  int *place_at, *slot_of, *free_slots;
  int waiting, *wait;         /* slots whose unknowns all entries of are here */
} Front;

static int wider(Front *t) {
  int line = t->line * 2;
  double *f = room((size_t)line * line, sizeof(double));
  int *place_at = realloc(t->place_at, line * sizeof(int));
  if (place_at) t->place_at = place_at;
  int *slots = realloc(t->free_slots, line * sizeof(int));
  if (slots) t->free_slots = slots;
  int *wait = realloc(t->wait, line * sizeof(int));
  if (wait) t->wait = wait;
  if (!f || !place_at || !slots || !wait) { free(f); return 0; }
  for (int i = 0; i < t->used; i++) memcpy(f + (size_t)i * line, t->f + (size_t)i * t->line, t->used * sizeof(double));
  free(t->f);
  t->f = f, t->line = line;
  return 1;
}

static int slot(Front *t, int place) {
  if (t->slot_of[place] >= 0) return t->slot_of[place];
  int s = t->free_count ? t->free_slots[--t->free_count] : t->used;
  if (s == t->used) {
    if (t->used == t->line && !wider(t)) return -1;
    t->used++;
  }
  t->place_at[s] = place;
  return t->slot_of[place] = s;
}

/* Largest entry of a slot in the front but for two. Entries of the bulk with the border do not count:
   by its own scale one of the border, such as a duration, may be as large as it likes, and is
   eliminated later. Counted, it would delay the pivots of a whole phase. */
static double largest(const Front *t, int s, int but, int butter) {
  const double *line = t->f + (size_t)s * t->line;
  int end = t->place_at[s] < t->bulk ? t->bulk : INT_MAX;
  double most = 0.0;
  for (int i = 0; i < t->used; i++) {
    double size = fabs(line[i]);
    if (i != but && i != butter && size > most && t->place_at[i] < end) most = size;
  }
  return most;
}

/* Eliminate one slot, or two; their inverse is d. */
static int eliminate(Front *t, Factors *k, int s, int r, const double *d) {
  double *one = t->f + (size_t)s * t->line, *two = r < 0 ? NULL : t->f + (size_t)r * t->line;
  long begin = k->start[k->pivots], next = begin;
  int columns = two ? 2 : 1;
  if (begin + columns * (long)t->used > k->capacity) {
    long capacity = 2 * k->capacity + columns * (long)t->used;
    int *place = realloc(k->place, capacity * sizeof(int));
    if (place) k->place = place;
    double *l = realloc(k->l, capacity * sizeof(double));
    if (l) k->l = l;
    if (!place || !l) return 0;
    k->capacity = capacity;
  }
  int vectors = (t->used + LANES - 1) / LANES;
  for (int i = 0; i < t->used; i++) {
    if (i == s || i == r || (one[i] == 0.0 && (!two || two[i] == 0.0))) continue;
    double *line = t->f + (size_t)i * t->line;
    double first = d[0] * one[i] + (two ? d[1] * two[i] : 0.0);
    k->place[next] = t->place_at[i], k->l[next++] = first;
    if (two) {
      double second = d[1] * one[i] + d[2] * two[i];
      k->place[next] = t->place_at[i], k->l[next++] = second;
      for (int v = 0; v < vectors; v++) ((wide *)line)[v] -= first * ((wide *)one)[v] + second * ((wide *)two)[v];
    } else
      for (int v = 0; v < vectors; v++) ((wide *)line)[v] -= first * ((wide *)one)[v];
  }
  k->first[k->pivots] = t->place_at[s];
  k->second[k->pivots] = two ? t->place_at[r] : -1;
  memcpy(k->d + 3 * (size_t)k->pivots, d, 3 * sizeof(double));
  k->start[++k->pivots] = next;
  for (int gone = s, c = 0; c < columns; gone = r, c++) {
    double *line = t->f + (size_t)gone * t->line;
    for (int i = 0; i < t->used; i++) line[i] = 0.0, t->f[(size_t)i * t->line + gone] = 0.0;
    t->free_slots[t->free_count++] = gone;
  }
  return 1;
}

/* A pivot with the slot at `k` of those that wait; 1 done, 0 it is too small yet, -1 no memory. */
static int pivot(Front *t, Factors *f, int k, double u, double small) {
  int s = t->wait[k], best = -1;
  double own = t->f[(size_t)s * t->line + s], most = largest(t, s, s, s);
  if (fabs(own) > small && fabs(own) >= u * most) {
    double d[3] = {1.0 / own, 0.0, 0.0};
    f->negative += own < 0.0;
    t->wait[k] = t->wait[--t->waiting];
    return eliminate(t, f, s, -1, d) ? 1 : -1;
  }
  for (int i = 0; i < t->waiting; i++)
    if (i != k && (best < 0 || fabs(t->f[(size_t)s * t->line + t->wait[i]]) > fabs(t->f[(size_t)s * t->line + t->wait[best]])))
      best = i;
  if (best < 0) return 0;
  int r = t->wait[best];
  double b = t->f[(size_t)s * t->line + r], c = t->f[(size_t)r * t->line + r], det = own * c - b * b;
  double of_s = largest(t, s, s, r), of_r = largest(t, r, s, r);
  if (!(fabs(det) > small * small) || fabs(b) <= small) return 0;
  double growth = fmax(fabs(c) * of_s + fabs(b) * of_r, fabs(b) * of_s + fabs(own) * of_r);
  if (u * growth > fabs(det)) return 0;
  double d[3] = {c / det, -b / det, own / det};
  f->negative += det < 0.0 ? 1 : own < 0.0 ? 2 : 0;
  f->two++;
  int high = k > best ? k : best, low = k > best ? best : k;
  t->wait[high] = t->wait[--t->waiting];
  t->wait[low] = t->wait[--t->waiting];
  return eliminate(t, f, s, r, d) ? 1 : -1;
}

static HOT int factorised(const Analysis *a, Factors *f, double u, double small) {
  Front t = {.bulk = a->bulk};
  int failed = NO_MEMORY;
  long rest = a->width + a->border;
  t.line = (int)((rest + 2 * LANES) / LANES * LANES);
  t.f = room((size_t)t.line * t.line, sizeof(double));
  t.place_at = room(t.line, sizeof(int));
  t.free_slots = room(t.line, sizeof(int));
  t.wait = room(t.line, sizeof(int));
  t.slot_of = malloc((a->kept + 1) * sizeof(int));
  char *done = room(a->border, 1);
  if (!done || !t.f || !t.place_at || !t.free_slots || !t.wait || !t.slot_of) goto end;
  for (int p = 0; p < a->kept; p++) t.slot_of[p] = -1;
  for (int k = 0; k < a->kept; k++) {
    int p = a->turn[k], last = p + a->width < a->bulk ? p + a->width : a->bulk;
    for (int part = 0; part < 2; part++)
      for (int q = part ? a->bulk : p; q < (part ? a->kept : last); q++) {
        if (p >= a->bulk && done[q - a->bulk]) continue;
        double value = f->matrix[p < q ? where(a, p, q) : where(a, q, p)];
        if (value == 0.0 && q != p) continue;
        int s = slot(&t, p), r = slot(&t, q);
        if (s < 0 || r < 0) goto end;
        t.f[(size_t)s * t.line + r] += value;
        if (s != r) t.f[(size_t)r * t.line + s] += value;
      }
    if (p >= a->bulk) done[p - a->bulk] = 1;
    t.wait[t.waiting++] = t.slot_of[p];
    if (t.used > f->front) f->front = t.used;
    for (int w = t.waiting - 1; w >= 0; w--) {
      int eliminated = pivot(&t, f, w, u, small);
      if (eliminated < 0) goto end;
      /* What waited may do now. */
      if (eliminated) w = t.waiting;
    }
    if (t.used > MAX_FRONT_GROWTH * rest + FRONT_SLACK) {
      failed = SINGULAR;
      goto end;
    }
    f->delayed += t.waiting;
  }
  failed = t.waiting ? SINGULAR : 0;
end:
  free(t.f); free(t.place_at); free(t.free_slots); free(t.wait); free(t.slot_of); free(done);
  return failed;
}

static HOT void solved(const Analysis *a, const Factors *f, double *x, double *y) {
  for (int p = 0; p < a->pairs; p++) {
    double leaf = x[a->leaf[p]], row = x[a->row[p]];
    const double *d = f->inverse + 3 * p;
    double by = d[1] * leaf + d[2] * row;
    for (int i = a->start[p]; i < a->start[p + 1]; i++) x[a->unknown[a->place[i]]] -= f->rows[i] * by;
  }
  for (int k = 0; k < a->kept; k++) y[k] = x[a->unknown[k]];
  for (int k = 0; k < f->pivots; k++) {
    double one = y[f->first[k]];
    if (f->second[k] < 0)
      for (long i = f->start[k]; i < f->start[k + 1]; i++) y[f->place[i]] -= f->l[i] * one;
    else {
      double two = y[f->second[k]];
      for (long i = f->start[k]; i < f->start[k + 1]; i += 2) y[f->place[i]] -= f->l[i] * one + f->l[i + 1] * two;
    }
  }
  for (int k = f->pivots - 1; k >= 0; k--) {
    const double *d = f->d + 3 * (size_t)k;
    double one = y[f->first[k]];
    if (f->second[k] < 0) {
      one *= d[0];
      for (long i = f->start[k]; i < f->start[k + 1]; i++) one -= f->l[i] * y[f->place[i]];
      y[f->first[k]] = one;
    } else {
      double two = y[f->second[k]], first = d[0] * one + d[1] * two, second = d[1] * one + d[2] * two;
      for (long i = f->start[k]; i < f->start[k + 1]; i += 2) {
        first -= f->l[i] * y[f->place[i]];
        second -= f->l[i + 1] * y[f->place[i]];
      }
      y[f->first[k]] = first, y[f->second[k]] = second;
    }
  }
  for (int k = 0; k < a->kept; k++) x[a->unknown[k]] = y[k];
  for (int p = 0; p < a->pairs; p++) {
    const double *d = f->inverse + 3 * p;
    double leaf = x[a->leaf[p]], row = x[a->row[p]];
    for (int i = a->start[p]; i < a->start[p + 1]; i++) row -= f->rows[i] * x[a->unknown[a->place[i]]];
    x[a->leaf[p]] = d[0] * leaf + d[1] * row;
    x[a->row[p]] = d[1] * leaf + d[2] * row;
  }
}

/* ------------------------------------------------------------------ as IPOPT calls it */

void ma97_default_control_d(struct control *c) {
  memset(c, 0, sizeof *c);
  c->f_arrays = 1, c->u = 1e-8, c->small = 1e-20;
}

void ma97_free_akeep_d(void **akeep) {
  forget(*akeep);
  *akeep = NULL;
}

void ma97_finalise_d(void **akeep, void **fkeep) {
  ma97_free_akeep_d(akeep);
  drop(*fkeep);
  *fkeep = NULL;
}

void ma97_analyse_d(int check, int n, const int *ptr, const int *row, double *val, void **akeep,
                    const struct control *c, struct info *info, int *order) {
  (void)check, (void)ptr, (void)row, (void)val, (void)c, (void)order;
  memset(info, 0, sizeof *info);
  Analysis *a = room(1, sizeof(Analysis));
  if (a) a->n = n;
  else info->flag = NO_MEMORY;
  *akeep = a;
}

void ma97_factor_d(int type, const int *ptr, const int *row, const double *val, void **akeep, void **fkeep,
                   const struct control *c, struct info *info, double *scale) {
  (void)type, (void)scale;
  memset(info, 0, sizeof *info);
  Analysis *a = *akeep;
  if (!a->analysed) a->analysed = analyse(ptr, row, val, a) ? 1 : -1;
  if (a->analysed < 0) {
    info->flag = NO_MEMORY;
    return;
  }
  Factors *f = *fkeep ? *fkeep : prepared(a);
  *fkeep = f;
  if (!f) {
    info->flag = NO_MEMORY;
    return;
  }
  f->negative = f->delayed = f->two = f->front = f->pivots = 0;
  info->flag = condensed(a, val, f) ? factorised(a, f, c->u, c->small) : SINGULAR;
  info->num_neg = f->negative, info->num_delay = f->delayed, info->num_two = f->two;
  info->maxfront = f->front, info->num_factor = f->start[f->pivots];
}

void ma97_solve_d(int job, int nrhs, double *x, int ldx, void **akeep, void **fkeep, const struct control *c,
                  struct info *info) {
  (void)job, (void)c;
  /* IPOPT reads the inertia after this: without it, negative curvature passes for a singular matrix. */
  info->flag = 0;
  Factors *f = *fkeep;
  for (int k = 0; k < nrhs; k++) solved(*akeep, f, x + (long)k * ldx, f->work);
}

void ma97_factor_solve_d(int type, const int *ptr, const int *row, const double *val, int nrhs, double *x, int ldx,
                         void **akeep, void **fkeep, const struct control *c, struct info *info, double *scale) {
  ma97_factor_d(type, ptr, row, val, akeep, fkeep, c, info, scale);
  if (info->flag >= 0) ma97_solve_d(0, nrhs, x, ldx, akeep, fkeep, c, info);
}
