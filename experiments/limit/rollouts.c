/* How fast a machine can integrate a population of gaits at all, and an independent answer: written by hand for SIMD,
 * W gaits side by side in the innermost loops, a block of W for each thread. It shares no code with the library.
 *
 * As it is: spring struts with sinusoidal rest lengths, cables that only pull, damping of members and nodes, gravity,
 * penalty contact of Hunt and Crossley on z = 0, smoothed Coulomb friction; classical RK4.
 * With -DEXACT: rigid struts and complementarity contact, semi-implicit steps whose impulses are found by sweeps.
 *
 *   PROGRAM scene.txt [threads] [sweeps]
 *
 * scene.txt, separated by spaces, SI units:
 *   N_NODES N_STRUTS N_CABLES
 *   per node:   mass x y z            (initial position; initial velocity is zero)
 *   per strut:  i j K L0 c            (stiffness N/m, rest length m, damping N s/m)
 *   per cable:  i j K L0 c            (neither spring nor damping while l <= L0)
 *   g node_damping k_n alpha mu eps   (F_n = k_n pen max(1 - alpha v_z, 0); friction -mu F_n v_t/sqrt(|v_t|^2 + eps^2))
 *   delta omega t_on t_ramp           (L = L0 (1 - delta/2 r (1 + sin(omega t + phi))), r from 0 to 1)
 *   dt n_steps N_GAITS
 *   per gait:   phi_1 .. phi_N_STRUTS
 *   if wanted:  a delta for each strut, in place of the common one
 *   and then:   N_OVERTONES, and for each h = 2, 3 ..: size_1 .. size_N_STRUTS psi_1 .. psi_N_STRUTS
 *               (sin(a) + sum of size sin(h a + psi), over 1 + sum of size, in place of sin(a), a = omega t + phi)
 * With -DEXACT the struts' stiffness and damping, k_n, alpha and eps are read and not used.
 *
 * Output: a line per gait, "x y z" of the centre of mass at the end, then a line that starts with '#' and has the wall
 * time of the best of three runs.
 */
#include <math.h>
#include <omp.h>
#include <stdio.h>
#include <stdlib.h>

#ifndef REAL
#define REAL double
#endif
#define W 32
#define MAXN 128
#define MAXE 512
#define MAXH 16
typedef REAL T;
typedef T V[W] __attribute__((aligned(64)));
#define LANES for (int w = 0; w < W; w++)

static int nn, ns, ne, ei[MAXE], ej[MAXE];
static T mass[MAXN], x0[MAXN][3], K[MAXE], L0[MAXE], C[MAXE];
static T g, cn, kn, al, mu, eps, delta, om, t_on, t_ramp, dt;
static T amp[MAXE], size[MAXH][MAXE], psi[MAXH][MAXE], share[MAXE];
static int overtones, steps, gaits, sweeps = 8;

static inline T t_sqrt(T x) { return sizeof(T) == 4 ? sqrtf(x) : sqrt(x); }
static inline T t_sin(T x) { return sizeof(T) == 4 ? sinf(x) : sin(x); }
static inline T ramp(T t) {
  T r = (t - t_on) / t_ramp;
  return r < 0 ? 0 : r > 1 ? 1 : r;
}

/* s, from -1 to 1, of the wave of strut e at time t. */
static inline void wave(int e, T t, const T *restrict phi, T *restrict s) {
  LANES s[w] = t_sin(om * t + phi[w]);
  if (!overtones) return;
  for (int h = 0; h < overtones; h++) LANES s[w] += size[h][e] * t_sin((h + 2) * (om * t + phi[w]) + psi[h][e]);
  LANES s[w] *= share[e];
}

#ifndef EXACT

static inline void acc(T t, const V *restrict q, const V *restrict v, const V *restrict phi, V *restrict a) {
  const T r = ramp(t);
  for (int n = 0; n < nn; n++) {
    const T mg = mass[n] * g;
    LANES {
      T z = q[3 * n + 2][w], vx = v[3 * n][w], vy = v[3 * n + 1][w], vz = v[3 * n + 2][w];
      T pen = z < 0 ? -z : 0, d = 1 - al * vz;
      T N = kn * pen * (d > 0 ? d : 0);
      T s = mu * N / t_sqrt(vx * vx + vy * vy + eps * eps);
      a[3 * n][w] = -(cn + s) * vx;
      a[3 * n + 1][w] = -(cn + s) * vy;
      a[3 * n + 2][w] = -cn * vz - mg + N;
    }
  }
  for (int e = 0; e < ne; e++) {
    const int i = ei[e] * 3, j = ej[e] * 3;
    const T k = K[e], c = C[e];
    V L;
    if (e < ns) { V s; wave(e, t, phi[e], s); LANES L[w] = L0[e] * (1 - amp[e] * (T)0.5 * r * (1 + s[w])); }
    else { LANES L[w] = L0[e]; }
    const int slackable = e >= ns;
    LANES {
      T dx = q[i][w] - q[j][w], dy = q[i + 1][w] - q[j + 1][w], dz = q[i + 2][w] - q[j + 2][w];
      T ux = v[i][w] - v[j][w], uy = v[i + 1][w] - v[j + 1][w], uz = v[i + 2][w] - v[j + 2][w];
      T l2 = dx * dx + dy * dy + dz * dz, il = 1 / t_sqrt(l2), ext = l2 * il - L[w];
      T f = k * ext + c * (dx * ux + dy * uy + dz * uz) * il;
      if (slackable) f = ext > 0 ? f : 0;
      f *= il;
      dx *= f; dy *= f; dz *= f;
      a[i][w] -= dx; a[i + 1][w] -= dy; a[i + 2][w] -= dz;
      a[j][w] += dx; a[j + 1][w] += dy; a[j + 2][w] += dz;
    }
  }
  for (int n = 0; n < nn; n++) {
    const T im = 1 / mass[n];
    for (int d = 0; d < 3; d++) LANES a[3 * n + d][w] *= im;
  }
}

static void roll(const V *phi, V *q, V *v) {
  V q2[3 * MAXN], v2[3 * MAXN], v3[3 * MAXN], v4[3 * MAXN], a1[3 * MAXN], a2[3 * MAXN], a3[3 * MAXN], a4[3 * MAXN];
  const T h = dt;
  const int m = 3 * nn;
  for (int k = 0; k < steps; k++) {
    const T t = k * h;
    acc(t, q, v, phi, a1);
    for (int i = 0; i < m; i++) LANES { q2[i][w] = q[i][w] + h / 2 * v[i][w]; v2[i][w] = v[i][w] + h / 2 * a1[i][w]; }
    acc(t + h / 2, q2, v2, phi, a2);
    for (int i = 0; i < m; i++) LANES { q2[i][w] = q[i][w] + h / 2 * v2[i][w]; v3[i][w] = v[i][w] + h / 2 * a2[i][w]; }
    acc(t + h / 2, q2, v3, phi, a3);
    for (int i = 0; i < m; i++) LANES { q2[i][w] = q[i][w] + h * v3[i][w]; v4[i][w] = v[i][w] + h * a3[i][w]; }
    acc(t + h, q2, v4, phi, a4);
    for (int i = 0; i < m; i++) LANES {
      q[i][w] += h / 6 * (v[i][w] + 2 * v2[i][w] + 2 * v3[i][w] + v4[i][w]);
      v[i][w] += h / 6 * (a1[i][w] + 2 * a2[i][w] + 2 * a3[i][w] + a4[i][w]);
    }
  }
}

#else

/* Steps: forces of cables as they are at the start, then sweeps of strut impulses (length L(t + dt), linearised) and
 * projections of nodes (gap linearised over the step, Coulomb's cone); z are the velocities at the end. */
static void roll(const V *phi, V *q, V *v) {
  V z[3 * MAXN], pn[MAXN], pt[2 * MAXN], u[3 * MAXE], target[MAXE];
  const T h = dt;
  for (int k = 0; k < steps; k++) {
    const T t = (k + 1) * h;
    const T r = ramp(t);
    for (int n = 0; n < nn; n++) {
      const T d = 1 - h * cn / mass[n];
      for (int c = 0; c < 3; c++) LANES z[3 * n + c][w] = v[3 * n + c][w] * d - (c == 2 ? h * g : 0);
      LANES { pn[n][w] = 0; pt[2 * n][w] = 0; pt[2 * n + 1][w] = 0; }
    }
    for (int e = ns; e < ne; e++) {
      const int i = ei[e] * 3, j = ej[e] * 3;
      const T kk = K[e], c = C[e], l0 = L0[e], hi = h / mass[ei[e]], hj = h / mass[ej[e]];
      LANES {
        T dx = q[i][w] - q[j][w], dy = q[i + 1][w] - q[j + 1][w], dz = q[i + 2][w] - q[j + 2][w];
        T ux = v[i][w] - v[j][w], uy = v[i + 1][w] - v[j + 1][w], uz = v[i + 2][w] - v[j + 2][w];
        T l2 = dx * dx + dy * dy + dz * dz, il = 1 / t_sqrt(l2), ext = l2 * il - l0;
        T f = kk * ext + c * (dx * ux + dy * uy + dz * uz) * il;
        f = (ext > 0 ? f : 0) * il;
        dx *= f; dy *= f; dz *= f;
        z[i][w] -= hi * dx; z[i + 1][w] -= hi * dy; z[i + 2][w] -= hi * dz;
        z[j][w] += hj * dx; z[j + 1][w] += hj * dy; z[j + 2][w] += hj * dz;
      }
    }
    for (int e = 0; e < ns; e++) {
      const int i = ei[e] * 3, j = ej[e] * 3;
      V s;
      wave(e, t, phi[e], s);
      LANES {
        T dx = q[i][w] - q[j][w], dy = q[i + 1][w] - q[j + 1][w], dz = q[i + 2][w] - q[j + 2][w];
        T l2 = dx * dx + dy * dy + dz * dz, il = 1 / t_sqrt(l2);
        u[3 * e][w] = dx * il; u[3 * e + 1][w] = dy * il; u[3 * e + 2][w] = dz * il;
        T L = L0[e] * (1 - amp[e] * (T)0.5 * r * (1 + s[w]));
        target[e][w] = (L - l2 * il) / h;
      }
    }
    for (int s = 0; s < sweeps; s++) {
      for (int e = 0; e < ns; e++) {
        const int i = ei[e] * 3, j = ej[e] * 3;
        const T a = 1 / mass[ei[e]], b = 1 / mass[ej[e]], ab = 1 / (a + b);
        LANES {
          T rel = 0;
          for (int d = 0; d < 3; d++) rel += (z[i + d][w] - z[j + d][w]) * u[3 * e + d][w];
          const T p = (target[e][w] - rel) * ab;
          for (int d = 0; d < 3; d++) {
            z[i + d][w] += a * p * u[3 * e + d][w];
            z[j + d][w] -= b * p * u[3 * e + d][w];
          }
        }
      }
      for (int n = 0; n < nn; n++) LANES {
        T p1 = pn[n][w] - q[3 * n + 2][w] / h - z[3 * n + 2][w];
        p1 = p1 > 0 ? p1 : 0;
        z[3 * n + 2][w] += p1 - pn[n][w];
        pn[n][w] = p1;
        T sx = pt[2 * n][w] - z[3 * n][w], sy = pt[2 * n + 1][w] - z[3 * n + 1][w];
        T sc = mu * p1 / t_sqrt(sx * sx + sy * sy + (T)1e-20);
        sc = sc < 1 ? sc : 1;
        sx *= sc; sy *= sc;
        z[3 * n][w] += sx - pt[2 * n][w]; z[3 * n + 1][w] += sy - pt[2 * n + 1][w];
        pt[2 * n][w] = sx; pt[2 * n + 1][w] = sy;
      }
    }
    for (int i = 0; i < 3 * nn; i++) LANES { v[i][w] = z[i][w]; q[i][w] += h * z[i][w]; }
  }
}

#endif

static double next(FILE *f) {
  double x;
  if (fscanf(f, "%lf", &x) != 1) { fprintf(stderr, "scene file ends early\n"); exit(2); }
  return x;
}

int main(int argc, char **argv) {
  FILE *f = argc > 1 ? fopen(argv[1], "r") : NULL;
  if (!f) { fprintf(stderr, "usage: %s scene.txt [threads] [sweeps]\n", argv[0]); return 2; }
  if (argc > 2) omp_set_num_threads(atoi(argv[2]));
  if (argc > 3) sweeps = atoi(argv[3]);
  nn = next(f); ns = next(f); ne = ns + (int)next(f);
  if (nn > MAXN || ne > MAXE) { fprintf(stderr, "at most %d nodes, %d members\n", MAXN, MAXE); return 2; }
  for (int n = 0; n < nn; n++) { mass[n] = next(f); for (int d = 0; d < 3; d++) x0[n][d] = next(f); }
  for (int e = 0; e < ne; e++) { ei[e] = next(f); ej[e] = next(f); K[e] = next(f); L0[e] = next(f); C[e] = next(f); }
  g = next(f); cn = next(f); kn = next(f); al = next(f); mu = next(f); eps = next(f);
  delta = next(f); om = next(f); t_on = next(f); t_ramp = next(f);
  dt = next(f); steps = next(f); gaits = next(f);
  int nb = (gaits + W - 1) / W;
  V *phi = aligned_alloc(64, sizeof(V) * nb * ns);
  double (*com)[3] = malloc(sizeof(*com) * nb * W);
  for (int b = 0; b < nb * W; b++)
    for (int s = 0; s < ns; s++) phi[(b / W) * ns + s][b % W] = b < gaits ? next(f) : 0;
  for (int s = 0; s < ns; s++) { double x; amp[s] = fscanf(f, "%lf", &x) == 1 ? (T)x : delta; share[s] = 1; }
  double count;
  if (fscanf(f, "%lf", &count) == 1) overtones = count;
  if (overtones > MAXH) { fprintf(stderr, "at most %d overtones\n", MAXH); return 2; }
  for (int h = 0; h < overtones; h++) {
    for (int s = 0; s < ns; s++) { size[h][s] = next(f); share[s] += size[h][s]; }
    for (int s = 0; s < ns; s++) psi[h][s] = next(f);
  }
  for (int s = 0; s < ns; s++) share[s] = 1 / share[s];
  double best = 1e30, total = 0;
  for (int n = 0; n < nn; n++) total += mass[n];
  for (int rep = 0; rep < 3; rep++) {
    double t0 = omp_get_wtime();
#pragma omp parallel for schedule(dynamic)
    for (int b = 0; b < nb; b++) {
      V q[3 * MAXN], v[3 * MAXN];
      for (int n = 0; n < nn; n++)
        for (int d = 0; d < 3; d++) LANES { q[3 * n + d][w] = x0[n][d]; v[3 * n + d][w] = 0; }
      roll(phi + b * ns, q, v);
      LANES for (int d = 0; d < 3; d++) {
        double s = 0;
        for (int n = 0; n < nn; n++) s += (double)mass[n] * q[3 * n + d][w];
        com[b * W + w][d] = s / total;
      }
    }
    double t = omp_get_wtime() - t0;
    if (t < best) best = t;
  }
  for (int b = 0; b < gaits; b++) printf("%.9g %.9g %.9g\n", com[b][0], com[b][1], com[b][2]);
  printf("# %s threads=%d gaits=%d steps=%d seconds=%.9f us_per_step_and_gait=%.4f\n",
         sizeof(T) == 4 ? "float32" : "float64", omp_get_max_threads(), gaits, steps, best,
         best / gaits / steps * 1e6);
  return 0;
}
