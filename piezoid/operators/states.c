#include "states.h"

#include <math.h>

/* Vectors of four doubles if the processor has them. Nothing is fused: the results are equal. */
#if defined(__GLIBC__) && defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) &&      \
    !defined(PK_PORTABLE)
#define WIDER __attribute__((target_clones("default", "avx2")))
#else
#define WIDER
#endif

enum { RUN = 1024 };

void pk_ladder(size_t samples, const double *input, size_t rungs, const double *pole,
               const double *b0, const double *b1, double *state, double *output) {
    double previous = samples > 0 ? input[0] : 0.0;
    for (size_t k = 0; k < samples; ++k) {
        const double current = input[k];
        for (size_t i = 0; i < rungs; ++i) {
            state[i] = pole[i] * state[i] + b0[i] * current + b1[i] * previous;
        }
        double total = 0.0;
        for (size_t i = 0; i < rungs; ++i) {
            total += state[i];
        }
        output[k] = total;
        previous = current;
    }
}

void pk_slew(size_t samples, const double *input, double step, double *output) {
    double value = samples > 0 ? input[0] : 0.0;
    for (size_t k = 0; k < samples; ++k) {
        const double difference = input[k] - value;
        value += difference > step ? step : (difference < -step ? -step : difference);
        output[k] = value;
    }
}

void pk_activated(size_t samples, const double *input, double step, double scale, double *output) {
    /* tanh(lag / scale): by the addition theorem no sample waits for exp or log of the last one.
     */
    double lag = 0.0;
    for (size_t k = 0; k < samples; ++k) {
        const double rise = k > 0 ? input[k] - input[k - 1] : 0.0;
        const double decay = exp(-2.0 * fabs(rise) / scale);
        const double change = copysign((1.0 - decay) / (1.0 + decay), rise);
        lag = step * (lag + change) / (1.0 + lag * change);
        output[k] = input[k] - 0.5 * scale * log((1.0 + lag) / (1.0 - lag));
    }
}

static inline int equals(double a, double b) {
    return !(a > b || a < b);
}

/* Return size^exponent; pow() takes as long as all other operations together. */
static inline double power_of(double size, double exponent) {
    if (equals(exponent, 1.0)) {
        return size;
    }
    if (equals(exponent, 1.5)) {
        return size * sqrt(size);
    }
    return equals(exponent, 2.0) ? size * size : pow(size, exponent);
}

static inline double bouc_wen_slope(double z, double change, const double *law) {
    const double coefficient = law[1] + (z * change > 0.0 ? law[0] : -law[0]);
    return 1.0 - coefficient * power_of(fabs(z), law[2]);
}

void pk_bouc_wen(size_t samples, const double *input, size_t states, const double *law,
                 double max_step, double *state, double *output) {
    for (size_t k = 0; k < samples; ++k) {
        const double change = k > 0 ? input[k] - input[k - 1] : 0.0;
        const double steps = ceil(fabs(change) / max_step);
        const double step = steps > 0.0 ? change / steps : 0.0;
        for (size_t i = 0; i < states; ++i) { /* independent of each other */
            double z = state[i];
            for (double part = 0.0; part < steps; part += 1.0) {
                const double middle = z + 0.5 * step * bouc_wen_slope(z, step, law + 3 * i);
                z += step * bouc_wen_slope(middle, step, law + 3 * i);
            }
            state[i] = z;
            output[k * states + i] = z;
        }
    }
}

/* Return the value at u that a friction state of u^n approaches during a motion in one direction.
 */
static double asymptote(int power, double u, double r, double sign) {
    switch (power) {
    case 1:
        return sign * r;
    case 2:
        return 2.0 * r * (sign * u - r);
    default:
        return 3.0 * r * (u * (sign * u - 2.0 * r) + 2.0 * sign * r * r);
    }
}

/* Compute the decay of friction states of one reach from each sample to the next. */
static void compute_decay(size_t samples, const double *input, double previous, double r,
                          double *decay) {
    for (size_t k = 0; k < samples; ++k) {
        decay[k] = exp(-fabs(input[k] - previous) / r);
        previous = input[k];
    }
}

/* Compute one friction state along some samples from its decay; return the last state. */
static double friction_state(size_t samples, const double *input, double previous, double r, int n,
                             double x, const double *decay, double *output) {
    for (size_t k = 0; k < samples; ++k) {
        const double change = input[k] - previous;
        if (change > 0.0 || change < 0.0) {
            const double sign = change > 0.0 ? 1.0 : -1.0;
            const double asymptote_before = asymptote(n, previous, r, sign);
            x = asymptote(n, input[k], r, sign) + (x - asymptote_before) * decay[k];
        }
        output[k] = x;
        previous = input[k];
    }
    return x;
}

void pk_friction(size_t samples, const double *input, size_t states, const double *reach,
                 const double *power, const double *column_index, double *state, size_t stride,
                 double *column) {
    double decay[RUN];
    for (size_t first = 0; first < samples; first += RUN) {
        const size_t count = samples - first < RUN ? samples - first : RUN;
        const double *chunk = input + first, previous = first > 0 ? input[first - 1] : input[0];
        for (size_t j = 0; j < states; ++j) {
            const double r = reach[j];
            if (j == 0 || r > reach[j - 1] || r < reach[j - 1]) {
                compute_decay(count, chunk, previous, r, decay);
            }
            double *output = column + (size_t)column_index[j] * stride + first;
            state[j] =
                friction_state(count, chunk, previous, r, (int)power[j], state[j], decay, output);
        }
    }
}

WIDER
void pk_polynomials(size_t samples, const double *input, size_t columns, size_t stride,
                    const double *column, const double *scale, const double *power,
                    const double *bias, double *output) {
    for (size_t first = 0; first < samples; first += RUN) {
        const size_t count = samples - first < RUN ? samples - first : RUN;
        const double *chunk = input + first;
        double *sum = output + first;
        for (size_t i = 0; i < columns; ++i) {
            const double *z = column + i * stride + first;
            const double c1 = power[i], c2 = power[columns + i], c3 = power[2 * columns + i];
            const double c4 = power[3 * columns + i], a = bias[i], b = bias[columns + i];
            const double d = bias[2 * columns + i], size = scale[i];
            for (size_t k = 0; k < count; ++k) {
                const double x = z[k] * size, u = chunk[k];
                sum[k] += x * (c1 + u * (a + u * b) + x * (c2 + u * d + x * (c3 + x * c4)));
            }
        }
    }
}
