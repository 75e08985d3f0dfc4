/* From the operations of a CasADi function to batches of instructions: included by `interpreter.c`.

- Each value is computed once, whatever operations repeat it.
- A sum of up to six terms, each a value or a product of two, is one instruction, added in the order of the
  operations, so with the same digits.
- Instructions of one kind that do not need one another are put in one batch: which kind comes next is asked once a
  batch. Values take the places of those that are no longer read. */

#define MAX_TERMS 6

/* A function's operations, by the numbers that CasADi has for them: of each its kind, what it reads (places; of an
   input its number and row) and where it writes (of an output: place read, number, row). */
typedef struct {
  long long count, places;
  const int *operation, *first, *second, *written;
  const double* numbers; /* of constants */
  const int* kinds;      /* of instructions, by operation */
  int input, output, constant, add, subtract, multiply;
} operations;

/* Values that are computed one after another; of constants `first` and `second` are the bits. */
typedef struct { int operation, first, second; } value;
typedef struct { int output, row, value; } result;
typedef struct { int value, kind, reads, read_at; } instruction;
typedef struct { int minus, factors, read[2], total; } term;

typedef struct {
  const operations* of;
  int values, results, instructions, reads, batches, places;
  value* value;
  result* result;
  int *uses, *producer, *place; /* of each value */
  char* inside;                 /* those that are nothing but a part of a sum */
  instruction* instruction;
  int *read, *order, *batch;    /* batches: kind and length of each */
  term* term;
} preparation;

static int is_given(const preparation* p, int v) {
  return p->value[v].operation == p->of->input || p->value[v].operation == p->of->constant;
}

static int is_sum(const preparation* p, int v) {
  return p->value[v].operation == p->of->add || p->value[v].operation == p->of->subtract;
}

static int is_unary(const preparation* p, int v) { return p->value[v].second < 0; }

/* Every value once: those of another order of factors or terms are the same. */
static int number_values(preparation* p) {
  const operations* o = p->of;
  size_t size = 1;
  while (size < 2 * (size_t)o->count) size *= 2;
  int *held = calloc(o->places + 1, sizeof(int)), *known = calloc(size, sizeof(int));
  int whole = held && known;
  for (long long k = 0; whole && k < o->count; k++) {
    value own = {o->operation[k], o->first[k], o->second[k]};
    if (own.operation == o->output) {
      p->result[p->results++] = (result){own.second, o->written[k], held[own.first]};
      continue;
    }
    if (own.operation == o->constant) {
      int bits[2];
      memcpy(bits, o->numbers + k, sizeof bits);
      own.first = bits[0], own.second = bits[1];
    } else if (own.operation != o->input) {
      own.first = held[own.first];
      if (own.second >= 0) own.second = held[own.second];
      if ((own.operation == o->add || own.operation == o->multiply) && own.first > own.second) {
        int other = own.first;
        own.first = own.second, own.second = other;
      }
    }
    unsigned hash = ((unsigned)own.operation * 2654435761u ^ (unsigned)own.first) * 2246822519u;
    hash = (hash ^ hash >> 15 ^ (unsigned)own.second) * 3266489917u;
    size_t at = (hash ^ hash >> 13) & (size - 1);
    while (known[at] && memcmp(p->value + known[at] - 1, &own, sizeof own)) at = (at + 1) & (size - 1);
    if (!known[at]) {
      p->value[p->values] = own;
      known[at] = ++p->values;
    }
    held[o->written[k]] = known[at] - 1;
  }
  free(held), free(known);
  for (int v = 0; v < p->values; v++) {
    if (is_given(p, v)) continue;
    p->uses[p->value[v].first]++;
    if (!is_unary(p, v)) p->uses[p->value[v].second]++;
  }
  for (int k = 0; k < p->results; k++) p->uses[p->result[k].value]++;
  return whole;
}

/* How well a sum goes on with a value: with another sum (2), else with a product (1), that is read nowhere else. */
static int rank_of(const preparation* p, int v) {
  return p->uses[v] != 1 ? 0 : is_sum(p, v) ? 2 : p->value[v].operation == p->of->multiply;
}

static term term_of(const preparation* p, int minus, int v, int total) {
  if (rank_of(p, v) != 1) return (term){minus, 1, {v, 0}, total};
  return (term){minus, 2, {p->value[v].first, p->value[v].second}, total};
}

/* Terms of the sum that ends with a value, the last one first; their number. */
static int terms_of(preparation* p, int total) {
  int count = 0;
  for (;;) {
    int first = p->value[total].first, last = p->value[total].second;
    int adds = p->value[total].operation == p->of->add;
    if (adds && rank_of(p, last) > rank_of(p, first)) {
      int other = first;
      first = last, last = other;
    }
    p->term[count++] = term_of(p, !adds, last, total);
    if (rank_of(p, last) == 1) p->inside[last] = 1;
    if (rank_of(p, first) < 2) {
      p->term[count++] = term_of(p, 0, first, first);
      if (rank_of(p, first) == 1) p->inside[first] = 1;
      return count;
    }
    p->inside[first] = 1;
    total = first;
  }
}

static void add_instruction(preparation* p, int v, int kind, int reads) {
  p->instruction[p->instructions] = (instruction){v, kind, reads, p->reads - reads};
  p->producer[v] = p->instructions++;
}

/* Instructions of a sum, each going on from the one before. */
static void add_sum(preparation* p, int v) {
  int last = terms_of(p, v) - 1;
  term total = p->term[last];
  while (last > 0) {
    int kind = -1, count = last + 1 < MAX_TERMS ? last + 1 : MAX_TERMS;
    for (; count >= 2; count--) {
      int form = first_form(total.factors);
      for (int k = 1; k < count; k++) form = next_form(form, p->term[last - k].minus, p->term[last - k].factors);
      if ((kind = kind_of_form[form]) >= 0) break;
    }
    int reads = 0;
    for (int k = 0; k < count; k++) {
      const term* own = k ? p->term + last - k : &total;
      for (int i = 0; i < own->factors; i++, reads++) p->read[p->reads++] = own->read[i];
    }
    last -= count - 1;
    add_instruction(p, p->term[last].total, kind, reads);
    total = (term){0, 1, {p->term[last].total, 0}, 0};
  }
}

static void make_instructions(preparation* p) {
  for (int v = p->values - 1; v >= 0; v--)
    if (is_sum(p, v) && !p->inside[v]) terms_of(p, v);
  for (int v = 0; v < p->values; v++) {
    if (is_given(p, v) || p->inside[v]) continue;
    if (is_sum(p, v)) {
      add_sum(p, v);
      continue;
    }
    p->read[p->reads++] = p->value[v].first;
    if (!is_unary(p, v)) p->read[p->reads++] = p->value[v].second;
    add_instruction(p, v, p->of->kinds[p->value[v].operation], 2 - is_unary(p, v));
  }
}

/* Batches, each as long as can be. */
static int make_batches(preparation* p) {
  int n = p->instructions, *first_reader = calloc(n + 2, sizeof(int)), *reader = calloc(p->reads + 1, sizeof(int));
  int *missing = calloc(n + 1, sizeof(int)), *next = calloc(n + 1, sizeof(int));
  int head[KIND_COUNT], tail[KIND_COUNT], ready[KIND_COUNT] = {0}, done = 0;
  int whole = first_reader && reader && missing && next;
  for (int pass = 0; whole && pass < 2; pass++) {
    for (int i = 0; i < n; i++)
      for (int k = 0; k < p->instruction[i].reads; k++) {
        int from = p->producer[p->read[p->instruction[i].read_at + k]];
        if (from < 0) continue;
        if (pass) reader[first_reader[from + 1]++] = i;
        else first_reader[from + 2]++, missing[i]++;
      }
    if (!pass) for (int i = 2; i < n + 2; i++) first_reader[i] += first_reader[i - 1];
  }
#define QUEUE(i) { \
    int kind = p->instruction[i].kind; \
    if (ready[kind]++) next[tail[kind]] = i; \
    else head[kind] = i; \
    tail[kind] = i; \
  }
  for (int i = 0; whole && i < n; i++) if (!missing[i]) QUEUE(i)
  while (whole && done < n) {
    int kind = 0, begin = done;
    for (int k = 1; k < KIND_COUNT; k++) if (ready[k] > ready[kind]) kind = k;
    /* Those that can follow in this batch do. */
    while (ready[kind]) {
      int i = head[kind];
      ready[kind]--;
      head[kind] = next[i];
      p->order[done++] = i;
      for (int k = first_reader[i]; k < first_reader[i + 1]; k++)
        if (!--missing[reader[k]]) QUEUE(reader[k])
    }
    p->batch[2 * p->batches] = kind, p->batch[2 * p->batches++ + 1] = done - begin;
  }
  free(first_reader), free(reader), free(missing), free(next);
  return whole;
}

/* Places of values, as few as there are values at a time. */
static int make_places(preparation* p) {
  int n = p->instructions, *last = calloc(p->values + 1, sizeof(int)), *unused = calloc(p->values + 1, sizeof(int));
  int count = 0, whole = last && unused;
  for (int v = 0; whole && v < p->values; v++) {
    last[v] = -1;
    if (is_given(p, v)) p->place[v] = p->places++;
  }
  for (int k = 0; whole && k < n; k++) {
    const instruction* own = p->instruction + p->order[k];
    last[own->value] = k;
    for (int i = 0; i < own->reads; i++) last[p->read[own->read_at + i]] = k;
  }
  for (int k = 0; whole && k < p->results; k++) last[p->result[k].value] = n;
  for (int k = 0; whole && k < n; k++) {
    const instruction* own = p->instruction + p->order[k];
    /* A value may take the place of one that it is computed from: lanes are read before. */
    for (int i = 0; i < own->reads; i++) {
      int v = p->read[own->read_at + i];
      if (last[v] == k) unused[count++] = p->place[v], last[v] = -1;
    }
    p->place[own->value] = count ? unused[--count] : p->places++;
    if (last[own->value] == k) unused[count++] = p->place[own->value];
  }
  free(last), free(unused);
  return whole;
}

static void end_preparation(preparation* p) {
  free(p->value), free(p->result), free(p->uses), free(p->producer), free(p->place), free(p->inside);
  free(p->instruction), free(p->read), free(p->order), free(p->batch), free(p->term);
}

/* 0 where there is no memory. */
static int prepare(preparation* p, const operations* o) {
  const size_t n = o->count + 1;
  *p = (preparation){
      .of = o,
      .value = calloc(n, sizeof(value)), .result = calloc(n, sizeof(result)), .uses = calloc(n, sizeof(int)),
      .producer = malloc(n * sizeof(int)), .place = calloc(n, sizeof(int)), .inside = calloc(n, 1),
      .instruction = calloc(n, sizeof(instruction)), .read = calloc(3 * n, sizeof(int)),
      .order = calloc(n, sizeof(int)), .batch = calloc(2 * n, sizeof(int)), .term = calloc(n + 1, sizeof(term))};
  if (!p->value || !p->result || !p->uses || !p->producer || !p->place || !p->inside || !p->instruction || !p->read ||
      !p->order || !p->batch || !p->term || !number_values(p)) return 0;
  memset(p->producer, -1, n * sizeof(int));
  make_instructions(p);
  return make_batches(p) && make_places(p);
}
