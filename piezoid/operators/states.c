#include "states.h"

#include <math.h>

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

void pk_slew(size_t samples, const double *input, double step, double *output) {
    double held = samples > 0 ? input[0] : 0.0;
    for (size_t k = 0; k < samples; ++k) {
        const double away = input[k] - held;
        held += away > step ? step : (away < -step ? -step : away);
        output[k] = held;
    }
}

void pk_creep(size_t samples, const double *input, double part, double threshold, double *output) {
    double x = samples > 0 ? input[0] : 0.0;
    for (size_t k = 0; k < samples; ++k) {
        output[k] = x;
        const double away = input[k] - x;
        if (away > threshold) {
            x += part * (away - threshold);
        } else if (away < -threshold) {
            x += part * (away + threshold);
        }
    }
}

void pk_activated(size_t samples, const double *input, double step, double wide, double *output) {
    double lag = 0.0;
    for (size_t k = 0; k < samples; ++k) {
        const double rise = k > 0 ? input[k] - input[k - 1] : 0.0;
        lag = wide * atanh(step * tanh((lag + rise) / wide));
        output[k] = input[k] - lag;
    }
}

static inline double bouc_wen_slope(double z, double way, double beta, double gamma,
                                    double exponent) {
    const double grip = gamma + (z * way > 0.0 ? beta : -beta);
    return 1.0 - grip * pow(fabs(z), exponent);
}

void pk_bouc_wen(size_t samples, const double *input, double beta, double gamma, double exponent,
                 double longest, double *state, double *output) {
    double z = *state;
    for (size_t k = 0; k < samples; ++k) {
        const double way = k > 0 ? input[k] - input[k - 1] : 0.0;
        const double parts = ceil(fabs(way) / longest);
        const double step = parts > 0.0 ? way / parts : 0.0;
        for (double part = 0.0; part < parts; part += 1.0) {
            const double middle = z + 0.5 * step * bouc_wen_slope(z, step, beta, gamma, exponent);
            z += step * bouc_wen_slope(middle, step, beta, gamma, exponent);
        }
        output[k] = z;
    }
    *state = z;
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

void pk_friction(size_t samples, const double *input, size_t states, const double *reach,
                 const double *power, double *state, size_t stride, double *column) {
    for (size_t j = 0; j < states; ++j) {
        const double r = reach[j];
        const int n = (int)power[j];
        double x = state[j];
        double *own = column + j * stride;
        for (size_t k = 0; k < samples; ++k) {
            const double before = k > 0 ? input[k - 1] : input[k], way = input[k] - before;
            if (way > 0.0 || way < 0.0) {
                const double sign = way > 0.0 ? 1.0 : -1.0;
                const double start = followed(n, before, r, sign);
                x = followed(n, input[k], r, sign) + (x - start) * exp(-fabs(way) / r);
            }
            own[k] = x;
        }
        state[j] = x;
    }
}

void pk_polynomials(size_t samples, const double *input, size_t columns, size_t stride,
                    const double *column, const double *scale, const double *power,
                    const double *bias, double *output) {
    for (size_t i = 0; i < columns; ++i) {
        const double *z = column + i * stride;
        const double c1 = power[i], c2 = power[columns + i], c3 = power[2 * columns + i];
        const double c4 = power[3 * columns + i], a = bias[i], b = bias[columns + i];
        for (size_t k = 0; k < samples; ++k) {
            const double x = z[k] * scale[i], u = input[k];
            output[k] += x * (c1 + u * (a + u * b) + x * (c2 + x * (c3 + x * c4)));
        }
    }
}
