/* Linear systems of an interior-point method whose unknowns follow one another in time.

IPOPT loads the functions at the end under the names of HSL_MA97. A matrix is analysed once, with its
first values:

- A slack and its row are eliminated as a pair: [a b; b c] with b = -1 is a good pivot whatever its
  diagonal is. (Of a variable in one row only, b may be as small as it likes: it is no such pair.)
  What is left is the variables' own matrix K and the equations.
- What is left is put in an order in which only near ones meet, but for a border of those that meet
  most of the others: a peak, a duration.

It is then factorised front by front, L D L^T with pivots of one or two, which wait where they are
too small (Duff and Reid 1983): a front is the unknowns that what is eliminated meets. */

#pragma GCC optimize("O3")

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define LANES 8
typedef double wide __attribute__((vector_size(8 * LANES), aligned(8), may_alias));

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

/* ------------------------------------------------------------------ analysis */

typedef struct {
  int n, pairs, kept, bulk, border, width, direct;
  int *leaf, *row;            /* of each pair */
  int *leaf_at, *row_at, *coupling_at; /* their entries among the matrix's, -1 where there is none */
  int *start, *place, *at;    /* per pair: kept unknowns of its row in order, and entries */
  int *unknown;               /* of each kept place */
  long *to;                   /* entries between kept unknowns: where in K */
  int *from;                  /* and among the matrix's */
  long size;                  /* of K */
} Analysis;

/* Lists of different lengths, one after another. */
typedef struct { int count, *start, *item; } Lists;

static void *room(size_t count, size_t each) { return calloc(count ? count : 1, each); }

/* Where two kept unknowns, the earlier one first, stand in K: row by row of the bulk its band and
   its border, then the border's square. */
static long where(const Analysis *a, int p, int q) {
  long line = a->width + a->border;
  if (q < a->bulk) return p * line + (q - p);
  if (p < a->bulk) return p * line + a->width + (q - a->bulk);
  return a->bulk * line + (long)(p - a->bulk) * a->border + (q - a->bulk);
}

/* Lists by item of lists by owner. */
static int inverted(const Lists *lists, int items, Lists *of) {
  of->count = items;
  of->start = room(items + 2, sizeof(int));
  of->item = room(lists->start[lists->count], sizeof(int));
  if (!of->start || !of->item) return 0;
  for (int k = 0; k < lists->start[lists->count]; k++) of->start[lists->item[k] + 2]++;
  for (int i = 1; i < items + 2; i++) of->start[i] += of->start[i - 1];
  for (int i = 0; i < lists->count; i++)
    for (int k = lists->start[i]; k < lists->start[i + 1]; k++) of->item[of->start[lists->item[k] + 1]++] = i;
  return 1;
}

/* The groups are what meets: an unknown's neighbours are all of its groups. */
typedef struct {
  Lists groups, of;
  int *seen, stamp, *reach;
  char *out;                  /* belongs to the border */
} Meeting;

/* Neighbours of an unknown that have not been seen since the stamp; how many. */
static int neighbours(Meeting *m, int v, int *found) {
  int count = 0;
  for (int k = m->of.start[v]; k < m->of.start[v + 1]; k++) {
    int group = m->of.item[k];
    for (int i = m->groups.start[group]; i < m->groups.start[group + 1]; i++) {
      int w = m->groups.item[i];
      if (m->seen[w] == m->stamp || m->out[w]) continue;
      m->seen[w] = m->stamp;
      found[count++] = w;
    }
  }
  return count;
}

typedef struct { double key; int item; } Keyed;

static int by_key(const void *one, const void *two) {
  const Keyed *a = one, *b = two;
  return a->key != b->key ? (a->key < b->key ? -1 : 1) : (a->item > b->item) - (a->item < b->item);
}

static void sorted(int *items, int count, Keyed *by) {
  qsort(by, count, sizeof(Keyed), by_key);
  for (int k = 0; k < count; k++) items[k] = by[k].item;
}

/* Breadth first from an unknown (Cuthill and McKee 1969): order, and how many are reached. */
static int spread(Meeting *m, int from, int *order, Keyed *by) {
  int count = 1;
  m->stamp++;
  m->seen[order[0] = from] = m->stamp;
  for (int k = 0; k < count; k++) {
    int more = neighbours(m, order[k], order + count);
    for (int i = 0; i < more; i++) by[i] = (Keyed){m->reach[order[count + i]], order[count + i]};
    sorted(order + count, more, by);
    count += more;
  }
  return count;
}

/* How far apart unknowns of a group stand at most, and one. */
static int width_of(const Meeting *m, const int *position) {
  int width = 1;
  for (int g = 0; g < m->groups.count; g++) {
    int first = -1, last = -1;
    for (int i = m->groups.start[g]; i < m->groups.start[g + 1]; i++) {
      int w = m->groups.item[i];
      if (m->out[w]) continue;
      if (first < 0 || position[w] < first) first = position[w];
      if (position[w] > last) last = position[w];
    }
    if (last - first + 1 > width) width = last - first + 1;
  }
  return width;
}

/* An order of `count` unknowns that keeps groups together: breadth first from an end, then, as long
   as it helps, by the mean of the groups' means. Returns its width; 0 without memory. */
static int arranged(Meeting *m, int all, int *order, int count) {
  int *position = room(all, sizeof(int)), *trial = room(all, sizeof(int)), width = 0, placed = 0;
  double *time = room(all, sizeof(double)), *mean = room(m->groups.count, sizeof(double));
  char *done = room(all, 1);
  Keyed *by = room(all, sizeof(Keyed));
  if (!position || !trial || !time || !mean || !done || !by) goto end;
  for (int v = 0; v < all; v++) {
    if (done[v] || m->out[v]) continue;
    int reached = spread(m, v, trial, by);
    reached = spread(m, trial[reached - 1], trial, by);
    reached = spread(m, trial[reached - 1], trial, by);
    for (int k = 0; k < reached; k++) done[order[placed++] = trial[k]] = 1;
  }
  for (int k = 0; k < count; k++) time[order[k]] = position[order[k]] = k;
  width = width_of(m, position);
  memcpy(trial, order, count * sizeof(int));
  for (int sweep = 0; sweep < 12; sweep++) {
    for (int g = 0; g < m->groups.count; g++) {
      double sum = 0.0;
      int members = 0;
      for (int i = m->groups.start[g]; i < m->groups.start[g + 1]; i++)
        if (!m->out[m->groups.item[i]]) { sum += time[m->groups.item[i]]; members++; }
      mean[g] = members ? sum / members : 0.0;
    }
    for (int k = 0; k < count; k++) {
      int v = trial[k];
      double sum = 0.0;
      for (int i = m->of.start[v]; i < m->of.start[v + 1]; i++) sum += mean[m->of.item[i]];
      if (m->of.start[v + 1] > m->of.start[v]) time[v] = sum / (m->of.start[v + 1] - m->of.start[v]);
    }
    for (int k = 0; k < count; k++) by[k] = (Keyed){time[trial[k]], trial[k]};
    sorted(trial, count, by);
    for (int k = 0; k < count; k++) position[trial[k]] = k;
    int found = width_of(m, position);
    if (found < width) {
      width = found;
      memcpy(order, trial, count * sizeof(int));
    }
  }
end:
  free(position); free(trial); free(time); free(mean); free(done); free(by);
  return width;
}

static void forget(Analysis *a) {
  if (!a) return;
  free(a->leaf); free(a->row); free(a->leaf_at); free(a->row_at); free(a->coupling_at);
  free(a->start); free(a->place); free(a->at); free(a->unknown); free(a->to); free(a->from);
  free(a);
}

static int analyse(const int *ptr, const int *index, const double *value, Analysis *a) {
  int n = a->n, count = ptr[n] - 1, failed = NO_MEMORY;
  int *degree = room(n, sizeof(int)), *mate = room(n, sizeof(int)), *meets = room(n, sizeof(int));
  int *kept_of = room(n, sizeof(int)), *order = room(n, sizeof(int)), *pair_of = room(n, sizeof(int));
  Keyed *by = room(n, sizeof(Keyed));
  int *place_of = room(n, sizeof(int));
  char *slack = room(n, 1);     /* if it meets one only */
  Meeting m = {0};
  if (!degree || !mate || !meets || !kept_of || !order || !pair_of || !by || !place_of || !slack) goto end;
  for (int j = 0; j < n; j++)
    for (int k = ptr[j] - 1; k < ptr[j + 1] - 1; k++) {
      int i = index[k] - 1;
      if (i == j) continue;
      degree[i]++, degree[j]++;
      meets[i] = j, meets[j] = i;
      slack[i] = slack[j] = value[k] == -1.0;
    }
  int rows = 0;
  for (int v = 0; v < n; v++) {
    mate[v] = -1;
    if (degree[v] == 1) by[rows] = (Keyed){degree[meets[v]], rows}, rows++;
  }
  sorted(order, rows, by);
  /* A row of far more unknowns than others, such as an integral, stays: they would all meet. */
  double long_row = rows ? 4.0 * by[rows / 2].key + 32.0 : 0.0;
  for (int v = 0; v < n; v++) {
    int row = meets[v];
    if (degree[v] != 1 || !slack[v] || mate[v] >= 0 || mate[row] >= 0 || degree[row] > long_row) continue;
    mate[v] = row, mate[row] = v;
  }
  /* Rows of two pairs that meet could not be eliminated by themselves. */
  for (int j = 0; j < n; j++)
    for (int k = ptr[j] - 1; k < ptr[j + 1] - 1; k++) {
      int i = index[k] - 1;
      if (i == j || mate[i] < 0 || mate[j] < 0 || mate[i] == j) continue;
      mate[mate[i]] = -1, mate[i] = -1;
    }
  for (int v = 0; v < n; v++) {
    pair_of[v] = -1;
    if (mate[v] >= 0 && meets[mate[v]] == v && degree[mate[v]] == 1 && (degree[v] != 1 || v > mate[v])) pair_of[v] = a->pairs++;
  }
  for (int v = 0; v < n; v++) kept_of[v] = mate[v] < 0 ? a->kept++ : -1;
  a->leaf = room(a->pairs, sizeof(int));
  a->row = room(a->pairs, sizeof(int));
  a->leaf_at = room(a->pairs, sizeof(int));
  a->row_at = room(a->pairs, sizeof(int));
  a->coupling_at = room(a->pairs, sizeof(int));
  a->start = room(a->pairs + 2, sizeof(int));
  a->place = room(count, sizeof(int));
  a->at = room(count, sizeof(int));
  a->unknown = room(a->kept, sizeof(int));
  a->to = room(count, sizeof(long));
  a->from = room(count, sizeof(int));
  m.seen = room(a->kept, sizeof(int));
  m.reach = room(a->kept, sizeof(int));
  m.out = room(a->kept, 1);
  if (!a->leaf || !a->row || !a->leaf_at || !a->row_at || !a->coupling_at || !a->start || !a->place ||
      !a->at || !a->unknown || !a->to || !a->from || !m.seen || !m.reach || !m.out)
    goto end;
  for (int p = 0; p < a->pairs; p++) a->leaf_at[p] = a->row_at[p] = -1;
  for (int v = 0; v < n; v++)
    if (mate[v] >= 0 && pair_of[v] >= 0) a->row[pair_of[v]] = v, a->leaf[pair_of[v]] = mate[v];
  /* Entries of the pairs' rows, then between kept ones. */
  for (int pass = 0; pass < 2; pass++) {
    for (int j = 0; j < n; j++)
      for (int k = ptr[j] - 1; k < ptr[j + 1] - 1; k++) {
        int i = index[k] - 1, row, other;
        if (kept_of[i] >= 0 && kept_of[j] >= 0) {
          if (pass) a->from[a->direct++] = k;
          continue;
        }
        if (mate[i] >= 0 && mate[j] >= 0) {
          int p = pair_of[pair_of[i] >= 0 ? i : mate[i]];
          if (!pass) continue;
          if (i != j) a->coupling_at[p] = k;
          else if (pair_of[i] >= 0) a->row_at[p] = k;
          else a->leaf_at[p] = k;
          continue;
        }
        row = kept_of[i] < 0 ? i : j, other = kept_of[i] < 0 ? j : i;
        if (!pass) a->start[pair_of[row] + 2]++;
        else {
          int to = a->start[pair_of[row] + 1]++;
          a->place[to] = kept_of[other], a->at[to] = k;
        }
      }
    if (!pass) for (int p = 1; p < a->pairs + 2; p++) a->start[p] += a->start[p - 1];
  }
  /* Groups: the pairs' rows and the entries between two kept ones. */
  m.groups.count = a->pairs + a->direct;
  m.groups.start = room(m.groups.count + 1, sizeof(int));
  m.groups.item = room(a->start[a->pairs] + 2 * a->direct, sizeof(int));
  if (!m.groups.start || !m.groups.item) goto end;
  memcpy(m.groups.start, a->start, (a->pairs + 1) * sizeof(int));
  memcpy(m.groups.item, a->place, a->start[a->pairs] * sizeof(int));
  {
    int column = 0, next = a->start[a->pairs];
    for (int d = 0; d < a->direct; d++) {
      while (ptr[column + 1] - 1 <= a->from[d]) column++;
      m.groups.item[next++] = kept_of[column];
      int other = kept_of[index[a->from[d]] - 1];
      if (other != kept_of[column]) m.groups.item[next++] = other;
      m.groups.start[a->pairs + d + 1] = next;
    }
  }
  if (!inverted(&m.groups, a->kept, &m.of)) goto end;
  for (int v = 0; v < a->kept; v++) {
    m.stamp++;
    m.reach[v] = neighbours(&m, v, order);
    by[v] = (Keyed){m.reach[v], v};
  }
  sorted(order, a->kept, by);
  int usual = a->kept ? m.reach[order[a->kept / 2]] : 0;
  for (int v = 0; v < a->kept; v++)
    if (m.reach[v] > 3 * usual + 16) m.out[v] = 1, a->border++;
  a->bulk = a->kept - a->border;
  a->width = arranged(&m, a->kept, order, a->bulk);
  if (!a->width) goto end;
  {
    int next = a->bulk;
    for (int v = 0; v < a->kept; v++) if (m.out[v]) order[next++] = v;
    for (int k = 0; k < a->kept; k++) place_of[order[k]] = k;
    for (int v = 0; v < n; v++) if (kept_of[v] >= 0) a->unknown[place_of[kept_of[v]]] = v;
    for (int p = 0; p < a->pairs; p++) {
      /* Sorted by place, few at a time. */
      for (int k = a->start[p]; k < a->start[p + 1]; k++) {
        int place = place_of[a->place[k]], at = a->at[k], to = k;
        for (; to > a->start[p] && a->place[to - 1] > place; to--)
          a->place[to] = a->place[to - 1], a->at[to] = a->at[to - 1];
        a->place[to] = place, a->at[to] = at;
      }
    }
    int column = 0;
    for (int d = 0; d < a->direct; d++) {
      while (ptr[column + 1] - 1 <= a->from[d]) column++;
      int p = place_of[kept_of[column]], q = place_of[kept_of[index[a->from[d]] - 1]];
      a->to[d] = p < q ? where(a, p, q) : where(a, q, p);
    }
  }
  a->size = where(a, a->bulk, a->bulk) + (long)a->border * a->border;
  failed = 0;
end:
  free(degree); free(mate); free(meets); free(kept_of); free(order); free(pair_of); free(by); free(place_of);
  free(slack); free(m.seen); free(m.reach); free(m.out); free(m.groups.start); free(m.groups.item);
  free(m.of.start); free(m.of.item);
  return failed;
}

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
static int condensed(const Analysis *a, const double *value, Factors *f) {
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
  int line, used, free_count;
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

static double largest(const Front *t, int s, int but, int butter) {
  const double *line = t->f + (size_t)s * t->line;
  double most = 0.0;
  for (int i = 0; i < t->used; i++) {
    double size = fabs(line[i]);
    if (i != but && i != butter && size > most) most = size;
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

static int factorised(const Analysis *a, Factors *f, double u, double small) {
  Front t = {0};
  int failed = NO_MEMORY;
  long rest = a->width + a->border;
  t.line = (int)((rest + 2 * LANES) / LANES * LANES);
  t.f = room((size_t)t.line * t.line, sizeof(double));
  t.place_at = room(t.line, sizeof(int));
  t.free_slots = room(t.line, sizeof(int));
  t.wait = room(t.line, sizeof(int));
  t.slot_of = malloc((a->kept + 1) * sizeof(int));
  if (!t.f || !t.place_at || !t.free_slots || !t.wait || !t.slot_of) goto end;
  for (int p = 0; p < a->kept; p++) t.slot_of[p] = -1;
  for (int p = 0; p < a->kept; p++) {
    int last = p < a->bulk ? (p + a->width < a->bulk ? p + a->width : a->bulk) : a->bulk;
    for (int part = 0; part < 2; part++)
      for (int q = part ? (p > a->bulk ? p : a->bulk) : p; q < (part ? a->kept : last); q++) {
        double value = f->matrix[where(a, p, q)];
        if (value == 0.0 && q != p) continue;
        int s = slot(&t, p), r = slot(&t, q);
        if (s < 0 || r < 0) goto end;
        t.f[(size_t)s * t.line + r] += value;
        if (s != r) t.f[(size_t)r * t.line + s] += value;
      }
    t.wait[t.waiting++] = t.slot_of[p];
    if (t.used > f->front) f->front = t.used;
    for (int k = t.waiting - 1; k >= 0; k--) {
      int done = pivot(&t, f, k, u, small);
      if (done < 0) goto end;
      /* What waited may do now. */
      if (done) k = t.waiting;
    }
    f->delayed += t.waiting;
  }
  failed = t.waiting ? SINGULAR : 0;
end:
  free(t.f); free(t.place_at); free(t.free_slots); free(t.wait); free(t.slot_of);
  return failed;
}

static void solved(const Analysis *a, const Factors *f, double *x, double *y) {
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
  if (!a->unknown && (info->flag = analyse(ptr, row, val, a))) return;
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
  memset(info, 0, sizeof *info);
  Factors *f = *fkeep;
  for (int k = 0; k < nrhs; k++) solved(*akeep, f, x + (long)k * ldx, f->work);
}

void ma97_factor_solve_d(int type, const int *ptr, const int *row, const double *val, int nrhs, double *x, int ldx,
                         void **akeep, void **fkeep, const struct control *c, struct info *info, double *scale) {
  ma97_factor_d(type, ptr, row, val, akeep, fkeep, c, info, scale);
  if (info->flag >= 0) ma97_solve_d(0, nrhs, x, ldx, akeep, fkeep, c, info);
}
