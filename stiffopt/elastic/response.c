/* Steps of response.py in C: the same formulas, of a register of steps at once where they are taken. A state
   is displacements, then velocities over a typical rate. */

#include "../wide.h"

#define MAX_JOINTS 16 /* joints */
#define STATE (2 * MAX_JOINTS)

typedef double four __attribute__((vector_size(32), aligned(8)));

typedef struct {
  long long steps, n, rows; /* rows: those of a step, filled up to a multiple of four */
  double dt, unit;
  const double *mobility, *rate, *stiffness; /* (steps + 1, n, n) by rows */
  double *step;       /* (steps, 2 n, rows) by columns */
  double *soft, *lag; /* (steps, n, n) by columns */
} Response;

/* c = a b of s rows and columns, an even number. */
static void multiply(int s, const wide *a, const wide *b, wide *c) {
  for (int i = 0; i < s; i += 2)
    for (int j = 0; j < s; j += 2) {
      const wide *upper = a + i * s, *lower = upper + s, *right = b + j;
      wide ul = {0}, ur = {0}, ll = {0}, lr = {0};
      for (int k = 0; k < s; k++, right += s) {
        ul += upper[k] * right[0], ur += upper[k] * right[1];
        ll += lower[k] * right[0], lr += lower[k] * right[1];
      }
      c[i * s + j] = ul, c[i * s + j + 1] = ur, c[(i + 1) * s + j] = ll, c[(i + 1) * s + j + 1] = lr;
    }
}

/* c = a b of n rows and columns. */
static void smaller(int n, const wide *a, const wide *b, wide *c) {
  for (int i = 0; i < n; i++)
    for (int j = 0; j < n; j++) {
      wide sum = {0};
      for (int k = 0; k < n; k++) sum += a[i * n + k] * b[k * n + j];
      c[i * n + j] = sum;
    }
}

/* Inverse of what has large positive entries along its diagonal: without pivots. */
static void invert(int n, wide *a) {
  for (int c = 0; c < n; c++) {
    wide *own = a + c * n, pivot = 1.0 / own[c];
    own[c] = (wide){0} + 1.0;
    for (int j = 0; j < n; j++) own[j] *= pivot;
    for (int i = 0; i < n; i++) {
      if (i == c) continue;
      wide *row = a + i * n, factor = row[c];
      row[c] = (wide){0};
      for (int j = 0; j < n; j++) row[j] -= factor * own[j];
    }
  }
}

/* Exponential of matrices of s rows: the series of the scaled ones to the twelfth term, squared
   again. */
static void exponential(int s, wide *once, wide *found) {
  wide twice[STATE * STATE], thrice[STATE * STATE], other[STATE * STATE];
  double largest = 0.0, factorial[12] = {1.0};
  for (int j = 0; j < s; j++)
    for (int l = 0; l < LANES; l++) {
      double sum = 0.0;
      for (int i = 0; i < s; i++) sum += fabs(once[i * s + j][l]);
      largest = fmax(largest, sum);
    }
  int halvings = 0;
  while (halvings < 64 && ldexp(largest, -halvings) > 0.5) halvings++;
  for (int t = 1; t < 12; t++) factorial[t] = factorial[t - 1] * t;
  for (int i = 0; i < s * s; i++) once[i] *= ldexp(1.0, -halvings);
  multiply(s, once, once, twice);
  multiply(s, twice, once, thrice);
  for (int first = 9; first >= 0; first -= 3) {
    double c0 = 1.0 / factorial[first], c1 = 1.0 / factorial[first + 1];
    double c2 = 1.0 / factorial[first + 2];
    if (first < 9) multiply(s, found, thrice, other);
    for (int i = 0; i < s * s; i++) {
      found[i] = c1 * once[i] + c2 * twice[i] + (i % (s + 1) ? 0.0 : c0);
      if (first < 9) found[i] += other[i];
    }
  }
  for (int h = 0; h < halvings; h++) {
    multiply(s, found, found, other);
    memcpy(found, other, sizeof(wide) * s * s);
  }
}

/* Steps k[0] to k[7] with the mean matrices of both ends. */
static void take_eight(const Response *r, const long long *k) {
  int n = r->n, s = 2 * n, square = n * n;
  wide mobility[MAX_JOINTS * MAX_JOINTS], damping[MAX_JOINTS * MAX_JOINTS];
  wide springs[MAX_JOINTS * MAX_JOINTS], product[MAX_JOINTS * MAX_JOINTS];
  wide slope[STATE * STATE], found[STATE * STATE];
  for (int i = 0; i < square; i++)
    for (int l = 0; l < LANES; l++) {
      long long at = k[l] * square + i;
      mobility[i][l] = 0.5 * (r->mobility[at + square] + r->mobility[at]);
      damping[i][l] = 0.5 * (r->rate[at + square] + r->rate[at]);
      springs[i][l] = 0.5 * (r->stiffness[at + square] + r->stiffness[at]);
    }
  for (int i = 0; i < n; i++)
    for (int j = 0; j < n; j++) {
      slope[i * s + j] = (wide){0};
      slope[i * s + n + j] = (wide){0} + (i == j ? r->dt * r->unit : 0.0);
    }
  smaller(n, mobility, springs, product);
  for (int i = 0; i < n; i++)
    for (int j = 0; j < n; j++) slope[(n + i) * s + j] = -product[i * n + j] / r->unit * r->dt;
  smaller(n, mobility, damping, product);
  for (int i = 0; i < n; i++)
    for (int j = 0; j < n; j++) slope[(n + i) * s + n + j] = -product[i * n + j] * r->dt;
  exponential(s, slope, found);
  invert(n, springs);
  smaller(n, springs, damping, product);
  smaller(n, product, springs, damping);
  for (int l = 0; l < LANES; l++) {
    double *step = r->step + k[l] * s * r->rows;
    for (int j = 0; j < s; j++)
      for (int i = 0; i < s; i++) step[j * r->rows + i] = found[i * s + j][l];
    for (int j = 0; j < n; j++)
      for (int i = 0; i < n; i++) {
        r->soft[k[l] * square + j * n + i] = springs[i * n + j][l];
        r->lag[k[l] * square + j * n + i] = damping[i * n + j][l];
      }
  }
}

/* Steps from `first` on and before `last`. */
HOT void take(const Response *r, long long first, long long last) {
  for (long long begin = first; begin < last; begin += LANES) {
    long long k[LANES];
    for (int l = 0; l < LANES; l++) k[l] = begin + l < last ? begin + l : last - 1;
    take_eight(r, k);
  }
}

/* State after a step, from one that is shifted by what the torque at its begin holds. */
static inline __attribute__((always_inline)) void stepped(
    int fours, int s, const double *step, const double *shifted, double *state) {
  four sum[STATE / 4];
  #pragma GCC unroll 8
  for (int f = 0; f < fours; f++) sum[f] = (four){0};
  for (int j = 0; j < s; j++, step += 4 * fours)
    #pragma GCC unroll 8
    for (int f = 0; f < fours; f++) sum[f] += *(const four *)(step + 4 * f) * shifted[j];
  #pragma GCC unroll 8
  for (int f = 0; f < fours; f++) *(four *)(state + 4 * f) = sum[f];
}

static void any_stepped(int fours, int s, const double *step, const double *shifted, double *state) {
  switch (fours) {
  case 1: stepped(1, s, step, shifted, state); break;
  case 2: stepped(2, s, step, shifted, state); break;
  case 3: stepped(3, s, step, shifted, state); break;
  case 4: stepped(4, s, step, shifted, state); break;
  case 5: stepped(5, s, step, shifted, state); break;
  case 6: stepped(6, s, step, shifted, state); break;
  case 7: stepped(7, s, step, shifted, state); break;
  default: stepped(8, s, step, shifted, state);
  }
}

/* Mobility times what is left of a torque (n,) by damping and springs. */
static void accelerated(const Response *r, long long k, const double *z, const double *velocity,
                        double *torque, double *acceleration) {
  int n = r->n, square = n * n;
  const double *rate = r->rate + k * square, *stiffness = r->stiffness + k * square;
  const double *mobility = r->mobility + k * square;
  for (int i = 0; i < n; i++)
    for (int j = 0; j < n; j++)
      torque[i] -= rate[i * n + j] * velocity[j] + stiffness[i * n + j] * z[j];
  for (int i = 0; i < n; i++) {
    double sum = 0.0;
    for (int j = 0; j < n; j++) sum += mobility[i * n + j] * torque[j];
    acceleration[i] = sum;
  }
}

/* m swings (m, steps + 1, n) from states (m, 2 n): displacements, velocities and, where asked for,
   accelerations. Under torques (m, steps + 1, links), each on links of its own (m, links), and
   beside them, where given, others at begin and end of every step (m, steps, 2, links). */
HOT void march(const Response *r, long long m, long long links, const long long *link,
           const double *torque, const double *within, const double *begin, double *z,
           double *velocity, double *acceleration) {
  long long count = r->steps + 1;
  int n = r->n, s = 2 * n, fours = r->rows / 4;
  for (long long first = 0; first < m; first += LANES) {
    int many = m - first < LANES ? m - first : LANES, still[LANES];
    double states[LANES][STATE] = {{0.0}};
    for (int c = 0; c < many; c++) {
      still[c] = 1;
      for (int i = 0; i < s; i++) {
        states[c][i] = begin[(first + c) * s + i];
        still[c] &= states[c][i] == 0.0;
      }
    }
    for (long long k = 0; k < count; k++)
      for (int c = 0; c < many; c++) {
        double *state = states[c], shifted[STATE], end[STATE] = {0.0};
        const double *own = torque + ((first + c) * count + k) * links;
        const long long *on = link + (first + c) * links;
        long long at = ((first + c) * count + k) * n;
        for (int i = 0; i < n; i++) z[at + i] = state[i], velocity[at + i] = r->unit * state[n + i];
        if (acceleration) {
          double left[MAX_JOINTS] = {0.0};
          int none = still[c];
          for (long long q = 0; q < links; q++) left[on[q]] = own[q], none &= own[q] == 0.0;
          if (none)
            for (int i = 0; i < n; i++) acceleration[at + i] = 0.0;
          else accelerated(r, k, z + at, velocity + at, left, acceleration + at);
        }
        if (k == r->steps) continue;
        for (int i = 0; i < s; i++) shifted[i] = state[i];
        const double *beside = within ? within + ((first + c) * r->steps + k) * 2 * links : 0;
        for (long long q = 0; q < links; q++) {
          double now = own[q], next = own[links + q];
          if (beside) now += beside[q], next += beside[links + q];
          double ramp = (next - now) / r->dt;
          if (now == 0.0 && next == 0.0) continue;
          const double *soft = r->soft + (k * n + on[q]) * n;
          const double *lag = r->lag + (k * n + on[q]) * n;
          double over = ramp / r->unit;
          still[c] = 0;
          for (int i = 0; i < n; i++) {
            double late = lag[i] * ramp, speed = soft[i] * over;
            shifted[i] -= soft[i] * now - late, shifted[n + i] -= speed;
            end[i] += soft[i] * next - late, end[n + i] += speed;
          }
        }
        if (still[c]) continue;
        any_stepped(fours, s, r->step + k * s * r->rows, shifted, state);
        for (int i = 0; i < s; i++) state[i] += end[i];
      }
  }
}
