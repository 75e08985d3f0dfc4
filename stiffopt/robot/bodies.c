/* Inverse dynamics of an arm along a motion, a register of instants at once: recursion over the bodies about
   the origin of each joint in its own axes (Featherstone 2008, chapter 5). Rotations lie by rows. */
#include "../wide.h"

#define MOST 32 /* joints */

typedef long long whole __attribute__((vector_size(8 * LANES), aligned(8)));

/* Beyond this angle [rad] three parts of pi/2 are too few. */
#define FAR 1e5

/* Sine and cosine as of fdlibm: the rest of quarter turns, and polynomials of it. */
static void turned_by(wide angle, wide *sine, wide *cosine) {
  const double round = 0x1.8p52;
  wide turns = (angle * 6.36619772367581382433e-01 + round) - round;
  wide r = angle - turns * 1.57079632673412561417e+00;
  r = (r - turns * 6.07710050630396597660e-11) - turns * 2.02226624871116645580e-21;
  wide z = r * r;
  wide s = -2.50507602534068634195e-08 + z * 1.58969099521155010221e-10;
  s = 2.75573137070700676789e-06 + z * s;
  s = 8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + z * s);
  s = r + r * z * (-1.66666666666666324348e-01 + z * s);
  wide c = 2.08757232129817482790e-09 + z * -1.13596475577881948265e-11;
  c = 2.48015872894767294178e-05 + z * (-2.75573143513906633035e-07 + z * c);
  c = 4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 + z * c);
  c = 1.0 - (0.5 * z - z * z * c);
  whole quarter = __builtin_convertvector(turns, whole);
  wide odd = __builtin_convertvector(quarter & 1, wide), even = 1.0 - odd;
  wide back = __builtin_convertvector(1 - (quarter & 2), wide);
  wide left = __builtin_convertvector(1 - ((quarter + 1) & 2), wide);
  *sine = back * (even * s + odd * c);
  *cosine = left * (even * c + odd * s);
  for (int l = 0; l < LANES; l++)
    if (!(fabs(angle[l]) < FAR)) (*sine)[l] = sin(angle[l]), (*cosine)[l] = cos(angle[l]);
}

static inline void add_cross(const wide *a, const wide *b, wide *c) {
  c[0] += a[1] * b[2] - a[2] * b[1];
  c[1] += a[2] * b[0] - a[0] * b[2];
  c[2] += a[0] * b[1] - a[1] * b[0];
}

static inline void constant(const double *a, wide *b) {
  for (int i = 0; i < 3; i++) b[i] = (wide){0} + a[i];
}

typedef struct {
  long long n;
  const long long *parent, *slides;            /* parents from 1, 0 is the base */
  const double *axis, *rotation, *translation; /* of each joint in its parent's, at zero position */
  const double *inertial;                      /* (n, 10): m, m c, xx, xy, yy, xz, yz, zz */
  const double *gravity;
} Bodies;

typedef struct {
  wide r[9], origin[3];              /* seen from the parent */
  wide turning[3], rate[3], rising[3]; /* weight as if the base went up */
  wide force[3], moment[3];
} Moving;

/* A body's motion from that of its parent, and what it needs. */
static void moved(const Bodies *b, int j, const Moving *parent, Moving *own, wide q, wide v, wide a) {
  const double *e = b->rotation + 9 * j, *z = b->axis + 3 * j, *m = b->inertial + 10 * j;
  wide axis[3], shift[3], sine = {0}, cosine = (wide){0} + 1.0;
  constant(z, axis);
  constant(b->translation + 3 * j, own->origin);
  if (!b->slides[j]) turned_by(q, &sine, &cosine);
  for (int i = 0; i < 3; i++) {
    const double *row = e + 3 * i;
    double along = row[0] * z[0] + row[1] * z[1] + row[2] * z[2];
    double across[3] = {row[1] * z[2] - row[2] * z[1], row[2] * z[0] - row[0] * z[2],
                        row[0] * z[1] - row[1] * z[0]};
    for (int k = 0; k < 3; k++)
      own->r[3 * i + k] =
          along * z[k] + cosine * (row[k] - along * z[k]) + sine * across[k];
    if (b->slides[j]) own->origin[i] += along * q;
  }
  for (int i = 0; i < 3; i++) shift[i] = (wide){0};
  add_cross(parent->turning, own->origin, shift);
  wide rising[3] = {parent->rising[0], parent->rising[1], parent->rising[2]};
  add_cross(parent->rate, own->origin, rising);
  add_cross(parent->turning, shift, rising);
  for (int k = 0; k < 3; k++) {
    const wide *r = own->r + k;
    own->turning[k] = r[0] * parent->turning[0] + r[3] * parent->turning[1] + r[6] * parent->turning[2];
    own->rate[k] = r[0] * parent->rate[0] + r[3] * parent->rate[1] + r[6] * parent->rate[2];
    own->rising[k] = r[0] * rising[0] + r[3] * rising[1] + r[6] * rising[2];
  }
  wide speed[3] = {axis[0] * v, axis[1] * v, axis[2] * v};
  if (b->slides[j]) {
    wide twice[3] = {2.0 * speed[0], 2.0 * speed[1], 2.0 * speed[2]};
    add_cross(own->turning, twice, own->rising);
    for (int k = 0; k < 3; k++) own->rising[k] += axis[k] * a;
  } else {
    add_cross(own->turning, speed, own->rate);
    for (int k = 0; k < 3; k++) own->turning[k] += speed[k], own->rate[k] += axis[k] * a;
  }
  wide first[3], spin[3], drawn[3] = {{0}};
  constant(m + 1, first);
  add_cross(own->turning, first, drawn);
  for (int k = 0; k < 3; k++) own->force[k] = m[0] * own->rising[k];
  add_cross(own->rate, first, own->force);
  add_cross(own->turning, drawn, own->force);
  const double inertia[9] = {m[4], m[5], m[7], m[5], m[6], m[8], m[7], m[8], m[9]};
  for (int i = 0; i < 3; i++) {
    const double *row = inertia + 3 * i;
    own->moment[i] = row[0] * own->rate[0] + row[1] * own->rate[1] + row[2] * own->rate[2];
    spin[i] = row[0] * own->turning[0] + row[1] * own->turning[1] + row[2] * own->turning[2];
  }
  add_cross(own->turning, spin, own->moment);
  add_cross(first, own->rising, own->moment);
}

/* Torques (count, n) of positions, velocities and accelerations (count, n). */
HOT void inverse(const Bodies *b, long long count, const double *q, const double *v, const double *a,
             double *torque) {
  int n = b->n;
  Moving bodies[MOST + 1];
  memset(bodies, 0, sizeof *bodies);
  for (int k = 0; k < 3; k++) bodies[0].rising[k] = (wide){0} - b->gravity[k];
  for (long long first = 0; first < count; first += LANES) {
    long long at[LANES];
    for (int l = 0; l < LANES; l++) at[l] = (first + l < count ? first + l : count - 1) * n;
    for (int j = 0; j < n; j++) {
      wide position, speed, rate;
      for (int l = 0; l < LANES; l++)
        position[l] = q[at[l] + j], speed[l] = v[at[l] + j], rate[l] = a[at[l] + j];
      moved(b, j, bodies + b->parent[j], bodies + j + 1, position, speed, rate);
    }
    for (int j = n - 1; j >= 0; j--) {
      const Moving *own = bodies + j + 1;
      const wide *needs = b->slides[j] ? own->force : own->moment;
      const double *z = b->axis + 3 * j;
      wide along = z[0] * needs[0] + z[1] * needs[1] + z[2] * needs[2];
      for (int l = 0; l < LANES; l++) torque[at[l] + j] = along[l];
      if (!b->parent[j]) continue;
      Moving *parent = bodies + b->parent[j];
      wide force[3];
      for (int i = 0; i < 3; i++) {
        const wide *r = own->r + 3 * i;
        force[i] = r[0] * own->force[0] + r[1] * own->force[1] + r[2] * own->force[2];
        parent->force[i] += force[i];
        parent->moment[i] += r[0] * own->moment[0] + r[1] * own->moment[1] + r[2] * own->moment[2];
      }
      add_cross(own->origin, force, parent->moment);
    }
  }
}
