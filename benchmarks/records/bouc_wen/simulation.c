/* A mode with a Bouc-Wen spring, and the Bouc-Wen state along a given displacement.
 *
 *   m y'' + c y' + k y + k2 y^2 + k3 y^3 + h z = f,   z' = y' (1 - |z|^n (gamma + beta sgn(z y')))
 */
#include <math.h>
#include <stddef.h>

/* dz / dy while y moves in the direction of `direction`. */
static double state_slope(double z, double direction, double beta, double gamma, double n) {
    const double power = n > 1.0 || n < 1.0 ? pow(fabs(z), n) : fabs(z);
    return 1.0 - power * (gamma + (z * direction > 0.0 ? beta : -beta));
}

/* parameter: m, c, k, k2, k3, h, beta, gamma, n; rate: d/dt of (y, y', z) */
static void derivative(const double *parameter, const double *at, double force, double *rate) {
    const double *p = parameter, y = at[0], v = at[1], z = at[2];
    const double spring = y * (p[2] + y * (p[3] + y * p[4])) + p[5] * z;
    rate[0] = v;
    rate[1] = (force - p[1] * v - spring) / p[0];
    rate[2] = v * state_slope(z, v, p[6], p[7], p[8]);
}

static void advance(const double *from, const double *rate, double time_s, double *to) {
    for (size_t i = 0; i < 3; ++i) {
        to[i] = from[i] + time_s * rate[i];
    }
}

/* Classical Runge-Kutta integration with `steps` steps per sample.
 *   force  (2 steps (samples - 1) + 1,)  at both ends and the middle of each step
 *   state  (3,)  y, y', z at the first sample
 *   y      (samples,)  out; infinite from where |y| exceeds `limit` on */
void simulate(size_t samples, size_t steps, double step_s, const double *force,
              const double *parameter, double limit, const double *state, double *y) {
    double at[3] = {state[0], state[1], state[2]}, next[3], a[3], b[3], c[3], d[3];
    for (size_t k = 0; k < samples; ++k) {
        y[k] = fabs(at[0]) <= limit ? at[0] : (double)INFINITY;
        for (size_t i = 0; k + 1 < samples && i < steps; ++i, force += 2) {
            derivative(parameter, at, force[0], a);
            advance(at, a, 0.5 * step_s, next);
            derivative(parameter, next, force[1], b);
            advance(at, b, 0.5 * step_s, next);
            derivative(parameter, next, force[1], c);
            advance(at, c, step_s, next);
            derivative(parameter, next, force[2], d);
            for (size_t j = 0; j < 3; ++j) {
                at[j] += step_s * (a[j] + 2.0 * (b[j] + c[j]) + d[j]) / 6.0;
            }
        }
    }
}

/* The state along a displacement, z = 0 at the first sample, by midpoint steps of at most
 * `longest`. */
void follow(size_t samples, const double *y, double beta, double gamma, double n, double longest,
            double *state) {
    double z = 0.0;
    state[0] = z;
    for (size_t k = 1; k < samples; ++k) {
        const double travel = y[k] - y[k - 1], parts = ceil(fabs(travel) / longest);
        for (double part = 0.0; part < parts; part += 1.0) {
            const double step = travel / parts;
            const double middle = z + 0.5 * step * state_slope(z, step, beta, gamma, n);
            z += step * state_slope(middle, step, beta, gamma, n);
        }
        state[k] = z;
    }
}
