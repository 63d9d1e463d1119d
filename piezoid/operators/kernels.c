#include "kernels.h"
#include "plays_avx2.h"

#include <math.h>
#include <string.h>

/* Plays followed side by side: enough independent chains of min and max to keep a core busy, few
 * enough for their states to stay in registers. */
#define LANES 8
#define RUN 256
/* Samples that stay in the first cache from the first map to the last. */
#define STRETCH 1024

static inline double clamp(double value, double low, double high) {
    const double raised = value > low ? value : low;
    return raised < high ? raised : high;
}

/* Eight plays over a run of samples, each into its own column. */
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
#if PK_AVX2
    if (pk_has_avx2()) {
        pk_play_columns_avx2(samples, input_V, plays, threshold_V, state_V, stride, column_V);
        return;
    }
#endif
    double unused[LANES * RUN]; /* where lanes without a play write, each its own part */
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
#if PK_AVX2
    if (pk_has_avx2()) {
        pk_play_sum_avx2(samples, input_V, plays, threshold_V, weight, state_V, output);
        return;
    }
#endif
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

/* One segment of a map: within it, the value is base + slope * (x - from). */
typedef struct {
    double low, high;
    double from, base, slope;
} segment;

/* The segment x lies in; its base is added up from 0 outwards. */
static segment segment_at(double x, const pk_map *map) {
    const double *knot = map->knot;
    const double *slope = map->slope;
    const size_t knots = map->knots;
    const size_t zero = map->zero;
    double from = 0.0;
    double base = 0.0;
    if (x >= 0.0) {
        size_t place = zero + 1;
        while (place < knots && x > knot[place]) {
            base += slope[place] * (knot[place] - from);
            from = knot[place];
            ++place;
        }
        const double high = place < knots ? knot[place] : (double)INFINITY;
        return (segment){from, high, from, base, slope[place]};
    }
    size_t place = zero;
    while (place > 0 && x < knot[place - 1]) {
        base += slope[place] * (knot[place - 1] - from);
        from = knot[place - 1];
        --place;
    }
    const double low = place > 0 ? knot[place - 1] : -(double)INFINITY;
    return (segment){low, from, from, base, slope[place]};
}

static inline double value_in(const segment *here, double x) {
    return here->base + here->slope * (x - here->from);
}

double pk_mapped(double x, const pk_map *map, double *local) {
    const segment here = segment_at(x, map);
    *local = here.slope;
    return value_in(&here, x);
}

void pk_piecewise_linear(size_t samples, const double *input, size_t knots, const double *knot,
                         const double *slope, size_t zero, double *output, double *local) {
    const pk_map map = {.knots = knots, .knot = knot, .slope = slope, .zero = zero};
    segment here = {.low = 0.0, .high = 0.0};
    for (size_t k = 0; k < samples; ++k) {
        const double x = input[k];
        /* A sample mostly lies where the one before it did. */
        if (!(x > here.low && x < here.high)) {
            here = segment_at(x, &map);
        }
        output[k] = value_in(&here, x);
        if (local != NULL) {
            local[k] = here.slope;
        }
    }
}

void pk_mapped_plays(size_t samples, const double *input, double taken, const pk_map *before,
                     size_t plays, const double *threshold, const double *weight, double *state,
                     const pk_map *after, double added, double *output) {
    for (size_t start = 0; start < samples; start += STRETCH) {
        const size_t count = samples - start < STRETCH ? samples - start : STRETCH;
        double *made = output + start;
        for (size_t k = 0; k < count; ++k) {
            made[k] = input[start + k] - taken;
        }
        if (before != NULL) {
            pk_piecewise_linear(count, made, before->knots, before->knot, before->slope,
                                before->zero, made, NULL);
        }
        pk_play_sum(count, made, plays, threshold, weight, state, made);
        if (after != NULL) {
            pk_piecewise_linear(count, made, after->knots, after->knot, after->slope, after->zero,
                                made, NULL);
        }
        for (size_t k = 0; k < count; ++k) {
            made[k] += added;
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
        const double place = fmin(fmax((z - edge[0]) / width, 0.0), (double)(edges - 2));
        const size_t k = (size_t)place;
        const double *at = value + i * edges + k;
        sum += at[0] + (at[1] - at[0]) * ((z - edge[k]) / width);
    }
    return sum;
}

void pk_valued_inverse(size_t samples, const double *wanted, size_t plays, double step,
                       size_t edges, const double *edge, const double *value, double *state,
                       double *found) {
    for (size_t n = 0; n < samples; ++n) {
        double low = state[0];
        double high = state[0];
        double far = step;
        while (sum_of_values(plays, step, edges, edge, value, state, low) > wanted[n]) {
            high = low;
            low -= far;
            far *= 2.0;
        }
        far = step;
        while (sum_of_values(plays, step, edges, edge, value, state, high) < wanted[n]) {
            low = high;
            high += far;
            far *= 2.0;
        }
        for (;;) {
            const double middle = 0.5 * low + 0.5 * high;
            if (!(middle > low && middle < high)) {
                break;
            }
            if (sum_of_values(plays, step, edges, edge, value, state, middle) < wanted[n]) {
                low = middle;
            } else {
                high = middle;
            }
        }
        found[n] = 0.5 * low + 0.5 * high;
        for (size_t i = 0; i < plays; ++i) {
            state[i] = play_at(found[n], (double)i * step, state[i]);
        }
    }
}
