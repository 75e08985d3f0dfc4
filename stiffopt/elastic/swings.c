/* The loops of uncertain_arms.py and simulate.py in C: the same formulas, one of them for a register of arms at
   once. All matrices lie by rows. */
#include "../wide.h"

#define MOST 32 /* joints */

/* Springs on even grids of wind-ups (EvenSprings): tables (n, points), of joints without a spring
   zero. */
typedef struct {
  const double *torque, *rise, *scale;
  long long points;
} Springs;

/* One plan (ManyArms) and its members. */
typedef struct {
  long long first, count, flight, spans, n, arms, commands; /* steps from the first on */
  double step;
  const double *bodies;    /* (2, spans, n, 3 n): all bodies, the payload */
  const double *torques;   /* (2, flight, n) of the plan */
  const long long *span_of; /* (flight - 1,) which of the bodies, the last one at rest */
  const double *commanded; /* (count, commands, 4, n) */
  const long long *of;     /* (arms,) which command */
  const double *stiffness, *damping, *payload, *servo; /* (arms, n), (arms, n), (arms,), (arms,) */
  const long long *rigid;  /* (n,) */
  Springs springs;
  double *links; /* (count, arms, n), the first row given */
  double *rates; /* (arms, n), given at the first row, left at the last one */
} Plan;

static inline void spring(const Springs *s, int j, wide windup, wide *torque, wide *stiffness) {
  const double *value = s->torque + j * s->points, *rise = s->rise + j * s->points;
  long long last = s->points - 2;
  wide place = windup * s->scale[j] + 0.5 * (s->points - 1);
  for (int l = 0; l < LANES; l++) {
    /* Beyond the table the spring goes on straight. */
    long long cell = (long long)place[l];
    cell = cell < 0 ? 0 : cell > last ? last : cell;
    (*torque)[l] = value[cell] + (place[l] - cell) * rise[cell];
    (*stiffness)[l] = rise[cell] * s->scale[j];
  }
}

static void swing_lanes(const Plan *p, long long first) {
  int n = p->n, width = 3 * n;
  long long arm[LANES];
  for (int l = 0; l < LANES; l++) arm[l] = first + l < p->arms ? first + l : p->arms - 1;
  wide e[MOST], rate[MOST], turn[MOST], drive[MOST], stiffness[MOST], damping[MOST], payload, servo;
  wide left[MOST][MOST], right[MOST], torque, tangent;
  double step = p->step;
  for (int l = 0; l < LANES; l++) {
    payload[l] = p->payload[arm[l]];
    servo[l] = p->servo[arm[l]];
    for (int j = 0; j < n; j++) {
      e[j][l] = p->links[arm[l] * n + j];
      stiffness[j][l] = p->stiffness[arm[l] * n + j];
      damping[j][l] = p->damping[arm[l] * n + j];
      rate[j][l] = p->rates[arm[l] * n + j];
      const double *now = p->commanded + p->of[arm[l]] * 4 * n + j;
      turn[j][l] = now[0] + servo[l] * now[2 * n];
      drive[j][l] = now[n] + servo[l] * now[3 * n];
    }
  }
  for (long long k = 1; k < p->count; k++) {
    int flies = p->first + k < p->flight;
    long long at = (flies ? p->first + k : p->flight) - 1;
    long long span = flies ? p->span_of[at] : p->spans - 1;
    const double *own = p->bodies + span * n * width, *more = own + p->spans * n * width;
    const double *planned = p->torques + at * n, *heavier = planned + p->flight * n;
    for (int i = 0; i < n; i++, own += width, more += width) {
      wide sum = (wide){0} - planned[i], carried = (wide){0} - heavier[i];
      for (int j = 0; j < n; j++) {
        sum += own[n + j] * rate[j] + own[2 * n + j] * e[j];
        carried += more[n + j] * rate[j] + more[2 * n + j] * e[j];
        left[i][j] = own[j] + more[j] * payload;
      }
      spring(&p->springs, i, turn[i] - e[i], &torque, &tangent);
      right[i] = sum + payload * carried;
      right[i] += 0.5 * (stiffness[i] * torque + damping[i] * (drive[i] - rate[i]));
    }
    for (int i = 0; i < n; i++) {
      wide lag, late;
      for (int l = 0; l < LANES; l++) {
        const double *now = p->commanded + (k * p->commands + p->of[arm[l]]) * 4 * n + i;
        turn[i][l] = now[0], drive[i][l] = now[n], lag[l] = now[2 * n], late[l] = now[3 * n];
      }
      turn[i] += servo * lag, drive[i] += servo * late;
      /* The spring at the predicted place, straight from there to the end of the step. */
      spring(&p->springs, i, turn[i] - e[i] - step * rate[i], &torque, &tangent);
      torque *= stiffness[i], tangent *= stiffness[i];
      right[i] += 0.5 * (torque + 0.5 * step * tangent * rate[i] + damping[i] * drive[i]);
      left[i][i] += 0.5 * damping[i] + 0.25 * step * tangent;
      if (p->rigid[i]) {
        for (int j = 0; j < n; j++) left[i][j] = (wide){0};
        left[i][i] += 1.0, right[i] = drive[i];
      }
    }
    /* Inertia and stiffness prevail, which are positive definite: no pivot is needed. */
    for (int c = 0; c < n; c++) {
      wide pivot = 1.0 / left[c][c];
      for (int i = c + 1; i < n; i++) {
        wide factor = left[i][c] * pivot;
        for (int j = c + 1; j < n; j++) left[i][j] -= factor * left[c][j];
        right[i] -= factor * right[c];
      }
    }
    for (int i = n - 1; i >= 0; i--) {
      for (int j = i + 1; j < n; j++) right[i] -= left[i][j] * right[j];
      right[i] /= left[i][i];
    }
    for (int j = 0; j < n; j++) {
      e[j] += 0.5 * step * (rate[j] + right[j]);
      if (p->rigid[j]) e[j] = turn[j];
      rate[j] = right[j];
      for (int l = 0; l < LANES; l++) p->links[(k * p->arms + arm[l]) * n + j] = e[j][l];
    }
  }
  for (int j = 0; j < n; j++)
    for (int l = 0; l < LANES; l++) p->rates[arm[l] * n + j] = rate[j][l];
}

HOT void swing(const Plan *p) {
  for (long long first = 0; first < p->arms; first += LANES) swing_lanes(p, first);
}

/* One arm and the motion of its motors. */
typedef struct {
  long long n, loops; /* numbers of the state for hysteresis: n or 0 */
  const long long *parent, *slides, *rigid; /* parents from 1, 0 is the base */
  const double *axis, *rotation, *translation; /* of each joint in its parent's, at zero position */
  const double *mass, *centre, *inertia;       /* in the joint's axes, about the centre */
  double gravity[3], force[3], tool[3];
  long long carries_tool;                      /* joint, from 1 */
  const double *damping, *friction, *hysteresis;
  const long long *springs;           /* (n + 1,) first cubic of each joint */
  const double *windups, *cubics;     /* from each wind-up on, lowest power first (.., 4) */
  long long pieces;
  const double *times, *motion;       /* (pieces + 1,), (pieces, 4, 2 n) highest power first */
  const double *last;                 /* (n,) */
  double state[3 * MOST], slope[3 * MOST];
} Arm;

static void cross(const double *a, const double *b, double *c) {
  c[0] = a[1] * b[2] - a[2] * b[1];
  c[1] = a[2] * b[0] - a[0] * b[2];
  c[2] = a[0] * b[1] - a[1] * b[0];
}

static double dot(const double *a, const double *b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void turned(const double *r, const double *a, double *b) {
  for (int i = 0; i < 3; i++) b[i] = dot(r + 3 * i, a);
}

static void product(const double *a, const double *b, double *c) {
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++)
      c[3 * i + j] = a[3 * i] * b[j] + a[3 * i + 1] * b[3 + j] + a[3 * i + 2] * b[6 + j];
}

static void about(const double *z, double angle, double *r) {
  double c = cos(angle), s = sin(angle), d = 1.0 - c;
  for (int i = 0; i < 3; i++)
    for (int j = 0; j < 3; j++) r[3 * i + j] = d * z[i] * z[j] + (i == j ? c : 0.0);
  r[1] -= s * z[2], r[2] += s * z[1], r[3] += s * z[2];
  r[5] -= s * z[0], r[6] -= s * z[1], r[7] += s * z[0];
}

static double spring_torque(const Arm *arm, int j, double windup) {
  long long low = arm->springs[j], high = arm->springs[j + 1];
  if (low == high) return 0.0;
  double size = fabs(windup);
  /* A NaN goes on with the first cubic. */
  while (high - low > 1) {
    long long middle = (low + high) / 2;
    if (arm->windups[middle] <= size) low = middle;
    else high = middle;
  }
  const double *c = arm->cubics + 4 * low;
  double x = size - arm->windups[low];
  return copysign(c[0] + x * (c[1] + x * (c[2] + x * c[3])), windup);
}

/* Position, velocity and acceleration of the motors; behind the end of their motion they stand. */
static void motors(const Arm *arm, double t, double *q, double *v, double *a) {
  int n = arm->n;
  if (t > arm->times[arm->pieces]) {
    for (int j = 0; j < n; j++) q[j] = arm->last[j], v[j] = a[j] = 0.0;
    return;
  }
  long long low = 0, high = arm->pieces;
  while (high - low > 1) {
    long long middle = (low + high) / 2;
    if (arm->times[middle] <= t) low = middle;
    else high = middle;
  }
  const double *c = arm->motion + low * 8 * n;
  double x = t - arm->times[low];
  for (int j = 0; j < n; j++, c++) {
    q[j] = ((c[0] * x + c[2 * n]) * x + c[4 * n]) * x + c[6 * n];
    v[j] = (c[3 * n] * x + c[5 * n]) * x + c[7 * n];
    a[j] = 2.0 * c[3 * n] * x + c[5 * n];
  }
}

/* Inertia of the joints and the torque that the motion needs without acceleration, less that of the
   force. Vectors in base axes, moments about the origin of the last joint: small inertias at the
   arm's end are not lost in large ones. */
static void dynamics(const Arm *arm, const double *q, const double *v, double m[MOST][MOST],
                     double *bias) {
  int n = arm->n;
  double r[MOST][9], o[MOST][3], z[MOST][3], s[MOST][6], w[MOST][6], acc[MOST][6], f[MOST][6];
  double mass[MOST], h[MOST][3], inertia[MOST][9], one[9], two[9], c[3], d[6], away[3];
  for (int i = 0; i < n; i++) {
    int p = arm->parent[i] - 1;
    if (p < 0) {
      memcpy(one, arm->rotation + 9 * i, sizeof one);
      memcpy(o[i], arm->translation + 3 * i, sizeof o[i]);
    } else {
      product(r[p], arm->rotation + 9 * i, one);
      turned(r[p], arm->translation + 3 * i, o[i]);
      for (int k = 0; k < 3; k++) o[i][k] += o[p][k];
    }
    turned(one, arm->axis + 3 * i, z[i]);
    if (arm->slides[i]) {
      memcpy(r[i], one, sizeof one);
      for (int k = 0; k < 3; k++) o[i][k] += q[i] * z[i][k];
    } else {
      about(arm->axis + 3 * i, q[i], two);
      product(one, two, r[i]);
    }
  }
  double tool[3];
  int carries = arm->carries_tool - 1;
  if (carries < 0) memcpy(tool, arm->tool, sizeof tool);
  else {
    turned(r[carries], arm->tool, tool);
    for (int k = 0; k < 3; k++) tool[k] += o[carries][k];
  }
  memcpy(away, o[n - 1], sizeof away);
  for (int k = 0; k < 3; k++) tool[k] -= away[k];
  for (int i = 0; i < n; i++) {
    int p = arm->parent[i] - 1;
    for (int k = 0; k < 3; k++) o[i][k] -= away[k];
    /* The joint's unit motion: turning rate, speed at the origin of moments. */
    if (arm->slides[i]) {
      for (int k = 0; k < 3; k++) s[i][k] = 0.0, s[i][3 + k] = z[i][k];
    } else {
      memcpy(s[i], z[i], sizeof z[i]);
      cross(o[i], z[i], s[i] + 3);
    }
    for (int k = 0; k < 6; k++) w[i][k] = (p < 0 ? 0.0 : w[p][k]) + s[i][k] * v[i];
    cross(w[i], s[i], d);
    cross(w[i], s[i] + 3, d + 3);
    cross(w[i] + 3, s[i], c);
    for (int k = 0; k < 3; k++) d[3 + k] += c[k];
    for (int k = 0; k < 6; k++) {
      double before = p >= 0 ? acc[p][k] : k < 3 ? 0.0 : -arm->gravity[k - 3];
      acc[i][k] = before + d[k] * v[i];
    }
    /* Inertia about the origin of moments. */
    mass[i] = arm->mass[i];
    turned(r[i], arm->centre + 3 * i, c);
    for (int k = 0; k < 3; k++) c[k] += o[i][k], h[i][k] = mass[i] * c[k];
    product(r[i], arm->inertia + 9 * i, one);
    for (int a = 0; a < 3; a++)
      for (int b = 0; b < 3; b++)
        inertia[i][3 * a + b] = dot(one + 3 * a, r[i] + 3 * b) - h[i][a] * c[b] +
                                (a == b ? dot(h[i], c) : 0.0);
    /* Force of the motion: rate of change of the momentum. */
    double momentum[6], turning[3];
    for (int moving = 0; moving < 2; moving++) {
      const double *x = moving ? w[i] : acc[i];
      double *y = moving ? momentum : f[i];
      turned(inertia[i], x, y);
      cross(h[i], x + 3, c);
      cross(x, h[i], y + 3);
      for (int k = 0; k < 3; k++) y[k] += c[k], y[3 + k] += mass[i] * x[3 + k];
    }
    cross(w[i], momentum, turning);
    for (int k = 0; k < 3; k++) f[i][k] += turning[k];
    cross(w[i] + 3, momentum + 3, turning);
    for (int k = 0; k < 3; k++) f[i][k] += turning[k];
    cross(w[i], momentum + 3, turning);
    for (int k = 0; k < 3; k++) f[i][3 + k] += turning[k];
  }
  if (carries >= 0) {
    cross(tool, arm->force, c);
    for (int k = 0; k < 3; k++) f[carries][k] -= c[k], f[carries][3 + k] -= arm->force[k];
  }
  for (int i = n - 1; i >= 0; i--) {
    int p = arm->parent[i] - 1;
    bias[i] = dot(s[i], f[i]) + dot(s[i] + 3, f[i] + 3);
    turned(inertia[i], s[i], d);
    cross(h[i], s[i] + 3, c);
    cross(s[i], h[i], d + 3);
    for (int k = 0; k < 3; k++) d[k] += c[k], d[3 + k] += mass[i] * s[i][3 + k];
    for (int j = 0; j <= i; j++) m[i][j] = 0.0;
    for (int j = i; j >= 0; j = arm->parent[j] - 1)
      m[i][j] = dot(s[j], d) + dot(s[j] + 3, d + 3);
    if (p < 0) continue;
    mass[p] += mass[i];
    for (int k = 0; k < 3; k++) h[p][k] += h[i][k];
    for (int k = 0; k < 6; k++) f[p][k] += f[i][k];
    for (int k = 0; k < 9; k++) inertia[p][k] += inertia[i][k];
  }
  for (int i = 0; i < n; i++)
    for (int j = i + 1; j < n; j++) m[i][j] = m[j][i];
}

/* Accelerations of the joints that yield under their torques; the others' are given. */
static void accelerate(const Arm *arm, double m[MOST][MOST], const double *torque, double *a) {
  int n = arm->n;
  double x[MOST];
  for (int i = 0; i < n; i++) {
    if (arm->rigid[i]) {
      x[i] = a[i];
      continue;
    }
    x[i] = torque[i];
    for (int j = 0; j < n; j++)
      if (arm->rigid[j]) x[i] -= m[i][j] * a[j];
  }
  for (int i = 0; i < n; i++)
    if (arm->rigid[i])
      for (int j = 0; j < n; j++) m[i][j] = m[j][i] = i == j;
  /* Cholesky. */
  for (int i = 0; i < n; i++) {
    for (int j = 0; j <= i; j++) {
      double sum = m[i][j];
      for (int k = 0; k < j; k++) sum -= m[i][k] * m[j][k];
      m[i][j] = i == j ? sqrt(sum) : sum / m[j][j];
    }
    for (int k = 0; k < i; k++) x[i] -= m[i][k] * x[k];
    x[i] /= m[i][i];
  }
  for (int i = n - 1; i >= 0; i--) {
    for (int k = i + 1; k < n; k++) x[i] -= m[k][i] * x[k];
    x[i] /= m[i][i];
  }
  memcpy(a, x, n * sizeof *a);
}

/* Slope of the state at an instant: link positions, velocities, hysteresis where there is any. */
void slope(Arm *arm, double t) {
  int n = arm->n;
  double q[MOST], v[MOST], a[MOST], bias[MOST], torque[MOST], m[MOST][MOST];
  double *state = arm->state, *found = arm->slope;
  motors(arm, t, q, v, a);
  for (int j = 0; j < n; j++) {
    double motor = q[j], speed = v[j];
    if (!arm->rigid[j]) q[j] = state[j], v[j] = state[n + j];
    double rate = speed - v[j];
    torque[j] = spring_torque(arm, j, motor - q[j]) + arm->damping[j] * rate;
    if (arm->loops) {
      found[2 * n + j] = 0.0;
      if (arm->friction[j] > 0.0) {
        double loop = state[2 * n + j], turning = rate / arm->hysteresis[j];
        torque[j] += arm->friction[j] * loop;
        found[2 * n + j] = turning - loop * fabs(turning);
      }
    }
  }
  dynamics(arm, q, v, m, bias);
  for (int j = 0; j < n; j++) torque[j] -= bias[j];
  accelerate(arm, m, torque, a);
  memcpy(found, v, n * sizeof *v);
  memcpy(found + n, a, n * sizeof *a);
}
