#include <stddef.h>

/* Plays and model as one writes them by hand for this very machine: the plays innermost, one pass
 * over the samples. Compiled with -O3 -march=native -ffast-math. */

static inline double play(double z, double u, double r) {
    const double raised = z > u - r ? z : u - r;
    return raised < u + r ? raised : u + r;
}

static inline double zones(double h, size_t count, const double *knot, const double *weight,
                           size_t zero) {
    double y = weight[zero] * h;
    for (size_t i = 0; i < zero; ++i) {
        y += weight[i] * (h < knot[i] ? h - knot[i] : 0.0);
    }
    for (size_t i = zero + 1; i < count; ++i) {
        y += weight[i] * (h > knot[i] ? h - knot[i] : 0.0);
    }
    return y;
}

void bank(size_t samples, const double *restrict u, size_t plays, const double *restrict r,
          double *restrict z, double *restrict rows) {
    for (size_t k = 0; k < samples; ++k) {
        for (size_t i = 0; i < plays; ++i) {
            z[i] = play(z[i], u[k], r[i]);
            rows[k * plays + i] = z[i];
        }
    }
}

void forward(size_t samples, const double *restrict u, size_t plays, const double *restrict r,
             const double *restrict w, double *restrict z, size_t count,
             const double *restrict knot, const double *restrict weight, size_t zero,
             double *restrict y) {
    for (size_t k = 0; k < samples; ++k) {
        double h = 0.0;
        for (size_t i = 0; i < plays; ++i) {
            z[i] = play(z[i], u[k], r[i]);
            h += w[i] * z[i];
        }
        y[k] = zones(h, count, knot, weight, zero);
    }
}

void inverse(size_t samples, const double *restrict y, size_t plays, const double *restrict r,
             const double *restrict w, double *restrict z, size_t count,
             const double *restrict knot, const double *restrict weight, size_t zero,
             double *restrict u) {
    for (size_t k = 0; k < samples; ++k) {
        const double q = zones(y[k], count, knot, weight, zero);
        double sum = 0.0;
        for (size_t i = 0; i < plays; ++i) {
            z[i] = play(z[i], q, r[i]);
            sum += w[i] * z[i];
        }
        u[k] = sum;
    }
}
