#include "kernels.h"

#include <math.h>
#include <string.h>

/* Plays that are computed together: enough independent operations to keep a core busy, few enough
 * for their states to stay in registers. */
#define LANES 8
#define RUN 256
/* Samples that fit into the first cache from the first map to the last. */
#define CHUNK 1024

static inline double clamp(double value, double low, double high) {
    const double raised = value > low ? value : low;
    return raised < high ? raised : high;
}

/* Compute eight plays over a run of samples, each into its column. */
static void run_of_lanes(size_t samples, const double *restrict input_V,
                         const double *restrict threshold_V, double *restrict state_V,
                         double *const *column_V) {
    double z[LANES];
    double r[LANES];
    double *restrict out[LANES];
    for (size_t i = 0; i < LANES; ++i) {
        z[i] = state_V[i];
        r[i] = threshold_V[i];
        out[i] = column_V[i];
    }
    for (size_t k = 0; k < samples; ++k) {
        const double u = input_V[k];
        for (size_t i = 0; i < LANES; ++i) {
            z[i] = clamp(z[i], u - r[i], u + r[i]);
            out[i][k] = z[i];
        }
    }
    memcpy(state_V, z, sizeof z);
}

void pk_play_columns(size_t samples, const double *input_V, size_t plays,
                     const double *threshold_V, double *state_V, size_t stride, double *column_V) {
    double unused[LANES * RUN]; /* output of lanes without a play */
    for (size_t first = 0; first < plays; first += LANES) {
        const size_t group = plays - first < LANES ? plays - first : LANES;
        double state[LANES] = {0.0};
        double threshold[LANES] = {0.0};
        memcpy(state, state_V + first, group * sizeof(double));
        memcpy(threshold, threshold_V + first, group * sizeof(double));
        for (size_t start = 0; start < samples; start += RUN) {
            const size_t count = samples - start < RUN ? samples - start : RUN;
            double *column[LANES];
            for (size_t i = 0; i < LANES; ++i) {
                column[i] = i < group ? column_V + (first + i) * stride + start : unused + i * RUN;
            }
            run_of_lanes(count, input_V + start, threshold, state, column);
        }
        memcpy(state_V + first, state, group * sizeof(double));
    }
}

void pk_play_sum(size_t samples, const double *input_V, size_t plays, const double *threshold_V,
                 const double *weight, double *state_V, double *output) {
    for (size_t k = 0; k < samples; ++k) {
        const double u = input_V[k];
        double sum = 0.0;
        for (size_t i = 0; i < plays; ++i) {
            state_V[i] = clamp(state_V[i], u - threshold_V[i], u + threshold_V[i]);
            sum += weight[i] * state_V[i];
        }
        output[k] = sum;
    }
}

/* One segment of a map, with the values base + slope * (x - from). */
typedef struct {
    double low, high;
    double from, base, slope;
} segment;

/* The segment that contains x; its base is summed from 0 outwards. */
static segment segment_at(double x, const pk_map *map) {
    const double *knot = map->knot;
    const double *slope = map->slope;
    const size_t knots = map->knots;
    const size_t zero = map->zero;
    double from = 0.0;
    double base = 0.0;
    if (x >= 0.0) {
        size_t index = zero + 1;
        while (index < knots && x > knot[index]) {
            base += slope[index] * (knot[index] - from);
            from = knot[index];
            ++index;
        }
        const double high = index < knots ? knot[index] : (double)INFINITY;
        return (segment){from, high, from, base, slope[index]};
    }
    size_t index = zero;
    while (index > 0 && x < knot[index - 1]) {
        base += slope[index] * (knot[index - 1] - from);
        from = knot[index - 1];
        --index;
    }
    const double low = index > 0 ? knot[index - 1] : -(double)INFINITY;
    return (segment){low, from, from, base, slope[index]};
}

static inline double value_in(const segment *current, double x) {
    return current->base + current->slope * (x - current->from);
}

double pk_mapped(double x, const pk_map *map, double *local) {
    const segment current = segment_at(x, map);
    *local = current.slope;
    return value_in(&current, x);
}

void pk_piecewise_linear(size_t samples, const double *input, const pk_map *map, double *output,
                         double *local) {
    segment current = {.low = 0.0, .high = 0.0};
    for (size_t k = 0; k < samples; ++k) {
        const double x = input[k];
        /* Most samples lie in the segment of the previous one. */
        if (!(x > current.low && x < current.high)) {
            current = segment_at(x, map);
        }
        output[k] = value_in(&current, x);
        if (local != NULL) {
            local[k] = current.slope;
        }
    }
}

void pk_mapped_plays(size_t samples, const double *input, double subtracted,
                     const pk_map *first_map, size_t plays, const double *threshold,
                     const double *weight, double *state, const pk_map *last_map, double added,
                     double *output) {
    for (size_t start = 0; start < samples; start += CHUNK) {
        const size_t count = samples - start < CHUNK ? samples - start : CHUNK;
        double *values = output + start;
        for (size_t k = 0; k < count; ++k) {
            values[k] = input[start + k] - subtracted;
        }
        if (first_map != NULL) {
            pk_piecewise_linear(count, values, first_map, values, NULL);
        }
        pk_play_sum(count, values, plays, threshold, weight, state, values);
        if (last_map != NULL) {
            pk_piecewise_linear(count, values, last_map, values, NULL);
        }
        for (size_t k = 0; k < count; ++k) {
            values[k] += added;
        }
    }
}

static double play_at(double u, double r, double z) {
    return fmax(u - r, fmin(u + r, z));
}

static double sum_of_values(size_t plays, double step, size_t edges, const double *edge,
                            const double *value, const double *state, double u) {
    const double width = edge[1] - edge[0];
    double sum = 0.0;
    for (size_t i = 0; i < plays; ++i) {
        const double z = play_at(u, (double)i * step, state[i]);
        const double position = fmin(fmax((z - edge[0]) / width, 0.0), (double)(edges - 2));
        const size_t k = (size_t)position;
        const double *knot_value = value + i * edges + k;
        sum += knot_value[0] + (knot_value[1] - knot_value[0]) * ((z - edge[k]) / width);
    }
    return sum;
}

void pk_valued_inverse(size_t samples, const double *desired, size_t plays, double step,
                       size_t edges, const double *edge, const double *value, double *state,
                       double *input) {
    for (size_t n = 0; n < samples; ++n) {
        double low = state[0];
        double high = state[0];
        double distance = step;
        while (sum_of_values(plays, step, edges, edge, value, state, low) > desired[n]) {
            high = low;
            low -= distance;
            distance *= 2.0;
        }
        distance = step;
        while (sum_of_values(plays, step, edges, edge, value, state, high) < desired[n]) {
            low = high;
            high += distance;
            distance *= 2.0;
        }
        for (;;) {
            const double middle = 0.5 * low + 0.5 * high;
            if (!(middle > low && middle < high)) {
                break;
            }
            if (sum_of_values(plays, step, edges, edge, value, state, middle) < desired[n]) {
                low = middle;
            } else {
                high = middle;
            }
        }
        input[n] = 0.5 * low + 0.5 * high;
        for (size_t i = 0; i < plays; ++i) {
            state[i] = play_at(input[n], (double)i * step, state[i]);
        }
    }
}
