#include "hysteretic_mode.h"

#include <math.h>

typedef struct {
    double m, c, k, quadratic, cubic;
    double h, beta, gamma, n;
    size_t stops;
    const double *threshold, *weight;
} mode;

typedef struct {
    double y, v, s;
} motion;

static double stopped(double e, double way, double r) {
    const double moved = e + way;
    return moved > r ? r : (moved < -r ? -r : moved);
}

/* The force of all stops once y has gone `way` from where they hold `e`. */
static double slip_force(const mode *of, const double *e, double way) {
    double force = 0.0;
    for (size_t i = 0; i < of->stops; ++i) {
        force += of->weight[i] * stopped(e[i], way, of->threshold[i]);
    }
    return force;
}

static double bouc_wen_rate(const mode *of, double s, double v) {
    const double size = fabs(s); /* pow() costs what all the rest does */
    const double power = of->n > 1.0 || of->n < 1.0 ? pow(size, of->n) : size;
    const double grip = of->gamma + (s * v > 0.0 ? of->beta : -of->beta);
    return v * (1.0 - power * grip);
}

static motion rate(const mode *of, motion at, double force, double slip) {
    const double bent = at.y * (of->k + at.y * (of->quadratic + at.y * of->cubic));
    const double spring = bent + of->h * at.s + slip;
    return (motion){at.v, (force - of->c * at.v - spring) / of->m, bouc_wen_rate(of, at.s, at.v)};
}

static motion along(motion from, motion by, double time) {
    return (motion){from.y + time * by.y, from.v + time * by.v, from.s + time * by.s};
}

/* One step under the force at its begin, in its middle and at its end. */
static motion stepped(const mode *of, motion from, const double force[3], const double *e,
                      double h) {
    const motion a = rate(of, from, force[0], slip_force(of, e, 0.0));
    motion at = along(from, a, 0.5 * h);
    const motion b = rate(of, at, force[1], slip_force(of, e, at.y - from.y));
    at = along(from, b, 0.5 * h);
    const motion c = rate(of, at, force[1], slip_force(of, e, at.y - from.y));
    at = along(from, c, h);
    const motion d = rate(of, at, force[2], slip_force(of, e, at.y - from.y));
    const motion mean = {(a.y + 2.0 * (b.y + c.y) + d.y) / 6.0,
                         (a.v + 2.0 * (b.v + c.v) + d.v) / 6.0,
                         (a.s + 2.0 * (b.s + c.s) + d.s) / 6.0};
    return along(from, mean, h);
}

void pk_hysteretic_mode(size_t samples, size_t steps, double step_s, int held, const double *force,
                        const double *mass_to_cubic, const double *bouc_wen, double limit,
                        size_t stops, const double *threshold_m, const double *weight,
                        double *state, double *y_m) {
    const mode of = {.m = mass_to_cubic[0],
                     .c = mass_to_cubic[1],
                     .k = mass_to_cubic[2],
                     .quadratic = mass_to_cubic[3],
                     .cubic = mass_to_cubic[4],
                     .h = bouc_wen[0],
                     .beta = bouc_wen[1],
                     .gamma = bouc_wen[2],
                     .n = bouc_wen[3],
                     .stops = stops,
                     .threshold = threshold_m,
                     .weight = weight};
    motion at = {state[0], state[1], state[2]};
    double *e = state + 3;
    for (size_t k = 0; k < samples; ++k) {
        y_m[k] = at.y;
        for (size_t i = 0; k + 1 < samples && i < steps; ++i) {
            const double *now = force + 2 * (k * steps + i);
            const double pushed[3] = {now[0], now[1], held ? now[1] : now[2]};
            const motion next = stepped(&of, at, pushed, e, step_s);
            for (size_t j = 0; j < stops; ++j) {
                e[j] = stopped(e[j], next.y - at.y, threshold_m[j]);
            }
            at = next;
        }
        if (!(fabs(at.y) <= limit)) {
            for (size_t rest = k + 1; rest < samples; ++rest) {
                y_m[rest] = (double)INFINITY;
            }
            break;
        }
    }
    state[0] = at.y;
    state[1] = at.v;
    state[2] = at.s;
}
