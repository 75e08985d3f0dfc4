/* The analysis of a linear system of an interior-point method: included by `frontal.c`.

- A slack and its row are eliminated as a pair: [a b; b c] with b = -1 is a good pivot whatever its
  diagonal is. (Of a variable in one row only, b may be as small as it likes: it is no such pair.)
  What is left is the variables' own matrix K and the equations.
- What is left is put in an order in which only near ones meet, but for a border of those that meet
  most of the others: a peak, a duration. */

typedef struct {
  int n, pairs, kept, bulk, border, width, direct;
  int *leaf, *row;            /* of each pair */
  int *leaf_at, *row_at, *coupling_at; /* their entries among the matrix's, -1 where there is none */
  int *start, *place, *at;    /* per pair: kept unknowns of its row in order, and entries */
  int *unknown;               /* of each kept place */
  int *turn;                  /* kept places in the order of elimination */
  long *to;                   /* entries between kept unknowns: where in K */
  int *from;                  /* and among the matrix's */
  long size;                  /* of K */
  int analysed;               /* -1 where there was no memory */
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
  free(a->start); free(a->place); free(a->at); free(a->unknown); free(a->turn); free(a->to); free(a->from);
  free(a);
}

/* What is known of the unknowns while a matrix is analysed, by their numbers in it. */
typedef struct {
  const int *ptr, *index;     /* the matrix's lower half, column by column, numbered from one */
  int *degree, *meets, *mate; /* how many others, the last of them, and the partner of a pair or -1 */
  int *pair_of;               /* of rows of pairs */
  int *kept_of;               /* numbers among the kept ones, -1 for those of pairs */
  int *order, *place_of;      /* of the kept ones */
  char *slack;                /* if it meets one only: by a coefficient of -1 */
  Keyed *by;
} Look;

static void looked(Look *s) {
  free(s->degree); free(s->meets); free(s->mate); free(s->pair_of); free(s->kept_of);
  free(s->order); free(s->place_of); free(s->slack); free(s->by);
}

static int begun(Look *s, int n) {
  int **each[] = {&s->degree, &s->meets, &s->mate, &s->pair_of, &s->kept_of, &s->order, &s->place_of};
  int whole = 1;
  for (int k = 0; k < 7; k++) whole &= (*each[k] = room(n, sizeof(int))) != NULL;
  s->slack = room(n, 1);
  s->by = room(n, sizeof(Keyed));
  return whole && s->slack && s->by;
}

/* Slacks and their rows. */
static void paired(Analysis *a, Look *s, const double *value) {
  int n = a->n, rows = 0, *mate = s->mate;
  for (int j = 0; j < n; j++)
    for (int k = s->ptr[j] - 1; k < s->ptr[j + 1] - 1; k++) {
      int i = s->index[k] - 1;
      if (i == j) continue;
      s->degree[i]++, s->degree[j]++;
      s->meets[i] = j, s->meets[j] = i;
      s->slack[i] = s->slack[j] = value[k] == -1.0;
    }
  for (int v = 0; v < n; v++) {
    mate[v] = -1;
    if (s->degree[v] == 1) s->by[rows] = (Keyed){s->degree[s->meets[v]], rows}, rows++;
  }
  sorted(s->order, rows, s->by);
  /* A row of far more unknowns than others, such as an integral, stays: they would all meet. */
  double longest = rows ? 4.0 * s->by[rows / 2].key + 32.0 : 0.0;
  for (int v = 0; v < n; v++) {
    int row = s->meets[v];
    if (s->degree[v] != 1 || !s->slack[v] || mate[v] >= 0 || mate[row] >= 0 || s->degree[row] > longest) continue;
    mate[v] = row, mate[row] = v;
  }
  /* Rows of two pairs that meet could not be eliminated by themselves. */
  for (int j = 0; j < n; j++)
    for (int k = s->ptr[j] - 1; k < s->ptr[j + 1] - 1; k++) {
      int i = s->index[k] - 1;
      if (i == j || mate[i] < 0 || mate[j] < 0 || mate[i] == j) continue;
      mate[mate[i]] = -1, mate[i] = -1;
    }
  for (int v = 0; v < n; v++) {
    int own = mate[v];
    int is_row = own >= 0 && s->degree[own] == 1 && (s->degree[v] != 1 || v > own);
    s->pair_of[v] = is_row ? a->pairs++ : -1;
    s->kept_of[v] = own < 0 ? a->kept++ : -1;
  }
}

static int with_room(Analysis *a, int count) {
  int **each[] = {&a->leaf, &a->row, &a->leaf_at, &a->row_at, &a->coupling_at};
  int whole = 1;
  for (int k = 0; k < 5; k++) whole &= (*each[k] = room(a->pairs, sizeof(int))) != NULL;
  a->start = room(a->pairs + 2, sizeof(int));
  a->place = room(count, sizeof(int));
  a->at = room(count, sizeof(int));
  a->unknown = room(a->kept, sizeof(int));
  a->turn = room(a->kept, sizeof(int));
  a->to = room(count, sizeof(long));
  a->from = room(count, sizeof(int));
  return whole && a->start && a->place && a->at && a->unknown && a->turn && a->to && a->from;
}

/* Where the pairs' entries are, those of their rows, then those between kept unknowns. */
static void listed(Analysis *a, const Look *s) {
  for (int p = 0; p < a->pairs; p++) a->leaf_at[p] = a->row_at[p] = -1;
  for (int v = 0; v < a->n; v++)
    if (s->pair_of[v] >= 0) a->row[s->pair_of[v]] = v, a->leaf[s->pair_of[v]] = s->mate[v];
  for (int pass = 0; pass < 2; pass++) {
    for (int j = 0; j < a->n; j++)
      for (int k = s->ptr[j] - 1; k < s->ptr[j + 1] - 1; k++) {
        int i = s->index[k] - 1;
        if (s->kept_of[i] >= 0 && s->kept_of[j] >= 0) {
          if (pass) a->from[a->direct++] = k;
        } else if (s->mate[i] >= 0 && s->mate[j] >= 0) {
          int p = s->pair_of[s->pair_of[i] >= 0 ? i : s->mate[i]];
          *(i != j ? &a->coupling_at[p] : s->pair_of[i] >= 0 ? &a->row_at[p] : &a->leaf_at[p]) = k;
        } else {
          int row = s->kept_of[i] < 0 ? i : j, other = s->kept_of[i] < 0 ? j : i;
          if (!pass) a->start[s->pair_of[row] + 2]++;
          else {
            int to = a->start[s->pair_of[row] + 1]++;
            a->place[to] = s->kept_of[other], a->at[to] = k;
          }
        }
      }
    if (!pass) for (int p = 1; p < a->pairs + 2; p++) a->start[p] += a->start[p - 1];
  }
}

/* The kept unknowns of each entry between two, in turn. */
static void ends_of(const Analysis *a, const Look *s, int d, int *column, int *p, int *q) {
  while (s->ptr[*column + 1] - 1 <= a->from[d]) (*column)++;
  *p = s->kept_of[*column], *q = s->kept_of[s->index[a->from[d]] - 1];
}

/* Groups: rows of pairs, each set of unknowns once (those of a point have the same), and entries
   between two. */
static int grouped(const Analysis *a, const Look *s, Meeting *m) {
  int size = 1, count = 0, next = 0, column = 0;
  while (size < 2 * a->pairs) size *= 2;
  int *known = room(size, sizeof(int)), *start = m->groups.start = room(a->pairs + a->direct + 1, sizeof(int));
  int *item = m->groups.item = room(a->start[a->pairs] + 2 * a->direct, sizeof(int));
  if (!known || !start || !item) {
    free(known);
    return 0;
  }
  for (int p = 0; p < a->pairs; p++) {
    const int *own = a->place + a->start[p];
    int length = a->start[p + 1] - a->start[p];
    unsigned hash = 2166136261u;
    for (int i = 0; i < length; i++) hash = (hash ^ (unsigned)own[i]) * 16777619u;
    int at = hash & (size - 1);
    for (; known[at]; at = (at + 1) & (size - 1)) {
      int g = known[at] - 1;
      if (start[g + 1] - start[g] == length && !memcmp(item + start[g], own, length * sizeof(int))) break;
    }
    if (known[at]) continue;
    known[at] = ++count;
    memcpy(item + next, own, length * sizeof(int));
    start[count] = next += length;
  }
  for (int d = 0; d < a->direct; d++) {
    int p, q;
    ends_of(a, s, d, &column, &p, &q);
    item[next++] = p;
    if (p != q) item[next++] = q;
    start[++count] = next;
  }
  free(known);
  m->groups.count = count;
  return inverted(&m->groups, a->kept, &m->of);
}

/* True where an unknown meets others, all of which belong to the border. */
static int beside_border(const Meeting *m, int v) {
  int others = 0;
  for (int k = m->of.start[v]; k < m->of.start[v + 1]; k++) {
    int group = m->of.item[k];
    for (int i = m->groups.start[group]; i < m->groups.start[group + 1]; i++) {
      int w = m->groups.item[i];
      if (w == v) continue;
      if (!m->out[w]) return 0;
      others = 1;
    }
  }
  return others;
}

/* Those of more reach than `most`, and those that meet only such, as the sum of durations: in the
   bulk these would bring the whole border into a front at once. */
static void set_apart(Analysis *a, Look *s, Meeting *m, double most) {
  a->border = 0;
  for (int v = 0; v < a->kept; v++) a->border += m->out[v] = m->reach[v] > most;
  for (int v = 0; v < a->kept; v++)
    if (!m->out[v]) s->place_of[v] = beside_border(m, v);
  for (int v = 0; v < a->kept; v++)
    if (!m->out[v] && s->place_of[v]) m->out[v] = 1, a->border++;
  a->bulk = a->kept - a->border;
}

/* Reach of the border over the usual one. A duration of a few intervals hardly meets more than
   others do; left in the bulk, the sum of durations keeps all phases in one front. */
static const double REACHES[] = {3.0, 2.0, 1.5};

/* The border and the order of least work, of these. */
static int bordered(Analysis *a, Look *s, Meeting *m) {
  Analysis best = *a;
  int *order = room(a->kept, sizeof(int)), whole = 1;
  char *out = room(a->kept, 1);
  double least = INFINITY;
  for (int v = 0; v < a->kept; v++) {
    m->stamp++;
    m->reach[v] = neighbours(m, v, s->order);
    s->by[v] = (Keyed){m->reach[v], v};
  }
  sorted(s->order, a->kept, s->by);
  int usual = a->kept ? m->reach[s->order[a->kept / 2]] : 0;
  for (int k = 0; k < 3 && order && out && whole; k++) {
    set_apart(a, s, m, REACHES[k] * usual + 16);
    a->width = arranged(m, a->kept, s->order, a->bulk);
    whole = a->width > 0;
    double line = a->width + a->border, work = a->kept * line * line;
    if (!whole || work >= least) continue;
    least = work, best = *a;
    memcpy(order, s->order, a->kept * sizeof(int));
    memcpy(out, m->out, a->kept);
  }
  whole = whole && order && out;
  if (whole) {
    *a = best;
    memcpy(s->order, order, a->kept * sizeof(int));
    memcpy(m->out, out, a->kept);
  }
  free(order); free(out);
  return whole;
}

/* One of the border is eliminated after the last of the bulk that it meets: a phase's duration with
   its phase, so that fronts do not grow with the number of phases. */
static int in_turn(Analysis *a) {
  int *last = room(a->border, sizeof(int)), *begin = room(a->bulk + 2, sizeof(int));
  if (!last || !begin) { free(last); free(begin); return 0; }
  for (int q = 0; q < a->border; q++) last[q] = -1;
  for (int p = 0; p < a->pairs; p++) {
    int end = a->start[p + 1], near = -1;
    for (int k = a->start[p]; k < end && a->place[k] < a->bulk; k++) near = a->place[k];
    for (int k = end - 1; k >= a->start[p] && a->place[k] >= a->bulk; k--)
      if (near > last[a->place[k] - a->bulk]) last[a->place[k] - a->bulk] = near;
  }
  long line = a->width + a->border, bands = a->bulk * line;
  for (int d = 0; d < a->direct; d++) {
    if (a->to[d] >= bands || a->to[d] % line < a->width) continue;
    int q = (int)(a->to[d] % line) - a->width, p = (int)(a->to[d] / line);
    if (p > last[q]) last[q] = p;
  }
  /* Those that meet none of the bulk are the last. */
  for (int q = 0; q < a->border; q++) if (last[q] < 0) last[q] = a->bulk;
  for (int q = 0; q < a->border; q++) begin[last[q] + 1]++;
  int next = 0;
  for (int p = 0; p <= a->bulk; p++) {
    if (p < a->bulk) a->turn[next++] = p;
    if (begin[p + 1])
      for (int q = 0; q < a->border; q++) if (last[q] == p) a->turn[next++] = a->bulk + q;
  }
  free(last); free(begin);
  return 1;
}

/* All by the places of the kept unknowns, of which the border's are the last. */
static void placed(Analysis *a, Look *s, const Meeting *m) {
  int next = a->bulk, column = 0;
  for (int v = 0; v < a->kept; v++) if (m->out[v]) s->order[next++] = v;
  for (int k = 0; k < a->kept; k++) s->place_of[s->order[k]] = k;
  for (int v = 0; v < a->n; v++) if (s->kept_of[v] >= 0) a->unknown[s->place_of[s->kept_of[v]]] = v;
  for (int p = 0; p < a->pairs; p++)
    /* Sorted by insertion: they are few. */
    for (int k = a->start[p]; k < a->start[p + 1]; k++) {
      int place = s->place_of[a->place[k]], at = a->at[k], to = k;
      for (; to > a->start[p] && a->place[to - 1] > place; to--)
        a->place[to] = a->place[to - 1], a->at[to] = a->at[to - 1];
      a->place[to] = place, a->at[to] = at;
    }
  for (int d = 0; d < a->direct; d++) {
    int p, q;
    ends_of(a, s, d, &column, &p, &q);
    p = s->place_of[p], q = s->place_of[q];
    a->to[d] = p < q ? where(a, p, q) : where(a, q, p);
  }
  a->size = where(a, a->bulk, a->bulk) + (long)a->border * a->border;
}

/* 0 where there is no memory. */
static int analyse(const int *ptr, const int *index, const double *value, Analysis *a) {
  Look s = {.ptr = ptr, .index = index};
  Meeting m = {0};
  int whole = begun(&s, a->n);
  if (whole) {
    paired(a, &s, value);
    whole = with_room(a, ptr[a->n] - 1);
  }
  m.seen = room(a->kept, sizeof(int));
  m.reach = room(a->kept, sizeof(int));
  m.out = room(a->kept, 1);
  whole = whole && m.seen && m.reach && m.out;
  if (whole) {
    listed(a, &s);
    whole = grouped(a, &s, &m);
  }
  whole = whole && bordered(a, &s, &m);
  if (whole) {
    placed(a, &s, &m);
    whole = in_turn(a);
  }
  looked(&s);
  free(m.seen); free(m.reach); free(m.out); free(m.groups.start); free(m.groups.item);
  free(m.of.start); free(m.of.item);
  return whole;
}
