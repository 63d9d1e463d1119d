#include "states.h"

#include <math.h>

/* Four lanes where the machine has them: nothing is fused, so the numbers stay the same. */
#if defined(__GLIBC__) && defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) &&      \
    !defined(PK_PORTABLE)
#define WIDER __attribute__((target_clones("default", "avx2")))
#else
#define WIDER
#endif

enum { RUN = 1024 };

void pk_first_order(size_t samples, size_t columns, size_t stride, double *values, double pole,
                    double b0, double b1, double *previous_input, double *previous_output) {
    for (size_t i = 0; i < columns; ++i) {
        double *column = values + i * stride;
        double x = previous_input[i];
        double y = previous_output[i];
        for (size_t k = 0; k < samples; ++k) {
            const double next = column[k];
            y = pole * y + b0 * next + b1 * x;
            x = next;
            column[k] = y;
        }
        previous_input[i] = x;
        previous_output[i] = y;
    }
}

void pk_ladder(size_t samples, const double *input, size_t rungs, const double *pole,
               const double *b0, const double *b1, double *state, double *output) {
    double before = samples > 0 ? input[0] : 0.0;
    for (size_t k = 0; k < samples; ++k) {
        const double now = input[k];
        for (size_t i = 0; i < rungs; ++i) {
            state[i] = pole[i] * state[i] + b0[i] * now + b1[i] * before;
        }
        double total = 0.0;
        for (size_t i = 0; i < rungs; ++i) {
            total += state[i];
        }
        output[k] = total;
        before = now;
    }
}

void pk_filter(size_t samples, const double *input, size_t order, const double *b, const double *a,
               double *memory, double *output) {
    if (order == 2) { /* modes: the memory stays in registers */
        double newer = memory[0], older = memory[1];
        for (size_t k = 0; k < samples; ++k) {
            const double x = input[k];
            const double y = newer + b[0] * x;
            newer = older + b[1] * x - a[1] * y;
            older = memory[2] + b[2] * x - a[2] * y;
            output[k] = y;
        }
        memory[0] = newer;
        memory[1] = older;
        return;
    }
    for (size_t k = 0; k < samples; ++k) {
        const double x = input[k];
        const double y = memory[0] + b[0] * x;
        for (size_t i = 1; i <= order; ++i) {
            memory[i - 1] = memory[i] + b[i] * x - a[i] * y;
        }
        output[k] = y;
    }
}

void pk_slew(size_t samples, const double *input, double step, double *output) {
    double held = samples > 0 ? input[0] : 0.0;
    for (size_t k = 0; k < samples; ++k) {
        const double away = input[k] - held;
        held += away > step ? step : (away < -step ? -step : away);
        output[k] = held;
    }
}

void pk_activated(size_t samples, const double *input, double step, double wide, double *output) {
    double worn = 0.0; /* tanh(lag / wide): by the law of sums no sample waits for a function */
    for (size_t k = 0; k < samples; ++k) {
        const double rise = k > 0 ? input[k] - input[k - 1] : 0.0;
        const double left = exp(-2.0 * fabs(rise) / wide);
        const double way = copysign((1.0 - left) / (1.0 + left), rise);
        worn = step * (worn + way) / (1.0 + worn * way);
        output[k] = input[k] - 0.5 * wide * log((1.0 + worn) / (1.0 - worn));
    }
}

static inline int equals(double a, double b) {
    return !(a > b || a < b);
}

/* size^exponent; pow() costs as much as everything else together. */
static inline double raised(double size, double exponent) {
    if (equals(exponent, 1.0)) {
        return size;
    }
    if (equals(exponent, 1.5)) {
        return size * sqrt(size);
    }
    return equals(exponent, 2.0) ? size * size : pow(size, exponent);
}

static inline double bouc_wen_slope(double z, double way, const double *law) {
    const double grip = law[1] + (z * way > 0.0 ? law[0] : -law[0]);
    return 1.0 - grip * raised(fabs(z), law[2]);
}

void pk_bouc_wen(size_t samples, const double *input, size_t states, const double *law,
                 double longest, double *state, double *output) {
    for (size_t k = 0; k < samples; ++k) {
        const double way = k > 0 ? input[k] - input[k - 1] : 0.0;
        const double parts = ceil(fabs(way) / longest);
        const double step = parts > 0.0 ? way / parts : 0.0;
        for (size_t i = 0; i < states; ++i) { /* states do not wait for each other */
            double z = state[i];
            for (double part = 0.0; part < parts; part += 1.0) {
                const double middle = z + 0.5 * step * bouc_wen_slope(z, step, law + 3 * i);
                z += step * bouc_wen_slope(middle, step, law + 3 * i);
            }
            state[i] = z;
            output[k * states + i] = z;
        }
    }
}

/* What a friction state of u^n follows on a straight way without end. */
static double followed(int power, double u, double r, double sign) {
    switch (power) {
    case 1:
        return sign * r;
    case 2:
        return 2.0 * r * (sign * u - r);
    default:
        return 3.0 * r * (u * (sign * u - 2.0 * r) + 2.0 * sign * r * r);
    }
}

/* What friction states of one reach forget on the way to each of some samples. */
static void forgetting(size_t samples, const double *input, double before, double r,
                       double *forget) {
    for (size_t k = 0; k < samples; ++k) {
        forget[k] = exp(-fabs(input[k] - before) / r);
        before = input[k];
    }
}

/* One friction state along some samples; the way to each is known to be forgotten by so much. */
static double rubbed(size_t samples, const double *input, double before, double r, int n, double x,
                     const double *forget, double *own) {
    for (size_t k = 0; k < samples; ++k) {
        const double way = input[k] - before;
        if (way > 0.0 || way < 0.0) {
            const double sign = way > 0.0 ? 1.0 : -1.0;
            const double start = followed(n, before, r, sign);
            x = followed(n, input[k], r, sign) + (x - start) * forget[k];
        }
        own[k] = x;
        before = input[k];
    }
    return x;
}

void pk_friction(size_t samples, const double *input, size_t states, const double *reach,
                 const double *power, const double *place, double *state, size_t stride,
                 double *column) {
    double forget[RUN];
    for (size_t first = 0; first < samples; first += RUN) {
        const size_t count = samples - first < RUN ? samples - first : RUN;
        const double *given = input + first, before = first > 0 ? input[first - 1] : input[0];
        for (size_t j = 0; j < states; ++j) {
            const double r = reach[j];
            if (j == 0 || r > reach[j - 1] || r < reach[j - 1]) {
                forgetting(count, given, before, r, forget);
            }
            double *own = column + (size_t)place[j] * stride + first;
            state[j] = rubbed(count, given, before, r, (int)power[j], state[j], forget, own);
        }
    }
}

WIDER
void pk_polynomials(size_t samples, const double *input, size_t columns, size_t stride,
                    const double *column, const double *scale, const double *power,
                    const double *bias, double *output) {
    for (size_t first = 0; first < samples; first += RUN) {
        const size_t count = samples - first < RUN ? samples - first : RUN;
        const double *given = input + first;
        double *sum = output + first;
        for (size_t i = 0; i < columns; ++i) {
            const double *z = column + i * stride + first;
            const double c1 = power[i], c2 = power[columns + i], c3 = power[2 * columns + i];
            const double c4 = power[3 * columns + i], a = bias[i], b = bias[columns + i];
            const double size = scale[i];
            for (size_t k = 0; k < count; ++k) {
                const double x = z[k] * size, u = given[k];
                sum[k] += x * (c1 + u * (a + u * b) + x * (c2 + x * (c3 + x * c4)));
            }
        }
    }
}
