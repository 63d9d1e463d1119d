#include "chain.h"

#include <math.h>
#include <string.h>

/* Vectors of four doubles if the processor has them. Nothing is fused: the results are equal. */
#if defined(__GLIBC__) && defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) &&      \
    !defined(PK_PORTABLE)
#define WIDER __attribute__((target_clones("default", "avx2")))
#define WITHIN static inline __attribute__((always_inline)) /* else it is not vectorised */
#else
#define WIDER
#define WITHIN static
#endif

/* Smaller filter states are set to zero: denormal numbers are slow. */
#define TINY 1e-200

/* Pointers into the buffers of one call. */
typedef struct {
    const pk_chain *chain;
    size_t plays, zones, columns;
    /* Of every play: z, dz/dr, dz/dz(0), and the drive at which it last moved. */
    double *state, *by_threshold, *by_initial, *last_drive;
    double *previous;     /* static row of the previous sample */
    double *lag, *sensor; /* last inputs and outputs of the filters */
} workspace;

WITHIN void advance_plays(const workspace *w, double drive, double inner) {
    const double *restrict r = w->chain->threshold;
    double *restrict z = w->state;
    double *restrict s = w->by_threshold;
    double *restrict a = w->by_initial;
    double *restrict last = w->last_drive;
    for (size_t i = 0; i < w->plays; ++i) {
        const double low = inner - r[i];
        const double high = inner + r[i];
        const int below = z[i] < low;
        const int above = z[i] > high;
        s[i] = below ? -1.0 : (above ? 1.0 : s[i]);
        a[i] = below || above ? 0.0 : a[i];
        last[i] = below || above ? drive : last[i];
        z[i] = below ? low : (above ? high : z[i]);
    }
}

/* Derivatives by the dead zones on one side of 0, first by the gaps, then by the slopes. h
 * increases outwards; `knot` and `slope` point to the values at 0, further ones follow in steps of
 * direction. */
WITHIN void zone_derivatives(double h, size_t count, const double *knot, const double *slope,
                             ptrdiff_t direction, double *column) {
    const double sign = (double)direction;
    double slope_change = 0.0;
    for (size_t k = count; k-- > 0;) {
        const ptrdiff_t index = direction * (ptrdiff_t)k;
        const double beyond = h - sign * knot[index + direction];
        double inside = 0.0;
        if (beyond > 0.0) {
            const double width =
                k + 1 < count ? sign * (knot[index + 2 * direction] - knot[index + direction])
                              : beyond;
            slope_change += slope[index] - slope[index + direction];
            inside = beyond < width ? beyond : width;
        }
        column[k] = sign * slope_change;
        column[count + k] = sign * inside;
    }
}

/* Add weight times the part of x inside each segment of the envelope on the side of x. */
static void add_segments(const pk_chain *c, double weight, double x, double *below,
                         double *above) {
    const double distance = fabs(x);
    double *segment = x < 0.0 ? below : above;
    for (size_t k = 0; k < c->envelope_knots && distance > c->envelope_knot[k]; ++k) {
        const double beyond = distance - c->envelope_knot[k];
        const double width =
            k + 1 < c->envelope_knots ? c->envelope_knot[k + 1] - c->envelope_knot[k] : HUGE_VAL;
        segment[k] += weight * (beyond < width ? beyond : width);
    }
}

/* Derivatives by the slopes of the envelope; a play depends on the drive at which it last moved.
 */
static void envelope_derivatives(const workspace *w, double drive, double local_slope,
                                 double *column) {
    const pk_chain *c = w->chain;
    double *below = column;
    double *above = column + c->envelope_knots;
    memset(column, 0, 2 * c->envelope_knots * sizeof(double));
    add_segments(c, c->weight[0], drive, below, above);
    for (size_t i = 0; i < w->plays; ++i) {
        add_segments(c, c->weight[i + 1], w->last_drive[i], below, above);
    }
    for (size_t k = 0; k < c->envelope_knots; ++k) {
        below[k] *= -local_slope;
        above[k] *= local_slope;
    }
}

/* The reading and its derivatives previous any filter. */
WITHIN void static_row(const workspace *w, double drive, double inner, double *row) {
    const pk_chain *c = w->chain;
    const pk_map *map = c->zones;
    const size_t plays = w->plays;
    double *by_memory = row;
    double *by_gap = by_memory + plays;
    double *by_weight = by_gap + plays;
    double *by_zone = by_weight + plays + 1;
    double h = c->weight[0] * inner;
    for (size_t i = 0; i < plays; ++i) {
        h += c->weight[i + 1] * w->state[i];
    }
    double local_slope = 0.0;
    row[w->columns - 1] = pk_mapped(h, map, &local_slope);
    row[w->columns - 2] = 0.0;
    by_weight[0] = local_slope * inner;
    double memory = 0.0;
    double gap = 0.0;
    for (size_t i = plays; i-- > 0;) {
        const double weight = local_slope * c->weight[i + 1];
        memory += weight * w->by_initial[i];
        gap += weight * w->by_threshold[i];
        by_memory[i] = memory * c->gap[i];
        by_gap[i] = gap + memory * c->memory_slope[i];
        by_weight[i + 1] = local_slope * w->state[i];
    }
    const size_t below = map->zero;
    const size_t above = map->knots - below - 1;
    const double *central_knot = map->knot + below;
    const double *central_slope = map->slope + below;
    zone_derivatives(-h, below, central_knot, central_slope, -1, by_zone);
    zone_derivatives(h, above, central_knot, central_slope + 1, 1, by_zone + 2 * below);
    envelope_derivatives(w, drive, local_slope, by_zone + w->zones);
}

WITHIN double flush_tiny(double value) {
    return fabs(value) < TINY ? 0.0 : value;
}

/* Pass a row through a filter. The derivative by the lag is the last but one number; has_own_time
 * adds the derivative by the time constant of this filter to it. */
WITHIN void filter_row(const pk_filter *f, size_t columns, double *memory, double *row,
                       int has_own_time) {
    double *restrict x = memory;
    double *restrict y = memory + columns;
    double *restrict v = row;
    const size_t lag = columns - 2;
    const size_t out = columns - 1;
    const double by_lag =
        f->pole * y[lag] + f->pole_by_s * y[out] + f->b0_by_s * v[out] + f->b1_by_s * x[out];
    for (size_t i = 0; i < columns; ++i) {
        const double next = v[i];
        y[i] = flush_tiny(f->pole * y[i] + f->b0 * next + f->b1 * x[i]);
        x[i] = next;
        v[i] = y[i];
    }
    if (has_own_time) {
        y[lag] = v[lag] = by_lag;
    }
}

/* The row behind the fractional delay or the lag, and the sensor. */
WITHIN void output_row(const workspace *w, const double *current, const double *previous,
                       double *row) {
    const pk_chain *c = w->chain;
    const size_t out = w->columns - 1;
    const size_t lag = w->columns - 2;
    memcpy(row, current, w->columns * sizeof(double));
    if (c->has_delay != 0) {
        for (size_t i = 0; i < w->columns; ++i) {
            row[i] = (1.0 - c->share) * current[i] + c->share * previous[i];
        }
        row[lag] = (previous[out] - current[out]) * c->rate_Hz;
    }
    if (c->lag != NULL) {
        filter_row(c->lag, w->columns, w->lag, row, 1);
    }
    if (c->sensor != NULL) {
        filter_row(c->sensor, w->columns, w->sensor, row, 0);
    }
}

/* Start all filters at rest at the first sample. */
static void initialise(const workspace *w, const double *current) {
    const size_t columns = w->columns;
    memcpy(w->previous, current, columns * sizeof(double));
    for (size_t k = 0; k < 2; ++k) {
        memcpy(w->lag + k * columns, current, columns * sizeof(double));
        memcpy(w->sensor + k * columns, current, columns * sizeof(double));
    }
}

/* Transpose a tile of rows; the columns of the memory are written to a separate array. */
WITHIN void write_tile(const workspace *w, size_t rows, const double *tile, size_t stride,
                       double *memory, double *column) {
    for (size_t i = 0; i < w->columns; ++i) {
        double *target = i < w->plays ? memory + i * stride : column + (i - w->plays) * stride;
        for (size_t k = 0; k < rows; ++k) {
            target[k] = tile[k * w->columns + i];
        }
    }
}

static workspace lay_out(const pk_chain *chain, double *carry) {
    const size_t plays = chain->plays;
    const size_t zones = 2 * (chain->zones->knots - 1);
    const size_t columns = 3 * plays + 1 + zones + 2 * chain->envelope_knots + 2;
    double *rows = carry + 4 * plays;
    const workspace w = {.chain = chain,
                         .plays = plays,
                         .zones = zones,
                         .columns = columns,
                         .state = carry,
                         .by_threshold = carry + plays,
                         .by_initial = carry + 2 * plays,
                         .last_drive = carry + 3 * plays,
                         .previous = rows,
                         .lag = rows + columns,
                         .sensor = rows + 3 * columns};
    return w;
}

WIDER void pk_chain_rows(int is_started, size_t samples, const double *drive, const double *inner,
                         const pk_chain *chain, size_t rows, const size_t *requested,
                         double *carry, double *tile, size_t stride, double *memory,
                         double *column) {
    const workspace w = lay_out(chain, carry);
    const int has_filters = chain->lag != NULL || chain->sensor != NULL;
    double *current = tile + PK_CHAIN_TILE * w.columns;
    double *previous = w.previous;
    size_t next = 0;
    size_t written = 0;
    for (size_t k = 0; k < samples; ++k) {
        advance_plays(&w, drive[k], inner[k]);
        const int is_requested = next < rows && requested[next] == k;
        const int is_next = chain->has_delay != 0 && next < rows && requested[next] == k + 1;
        if (!(is_requested || is_next || has_filters || k + 1 == samples)) {
            continue;
        }
        static_row(&w, drive[k], inner[k], current);
        if (k == 0 && is_started == 0) {
            initialise(&w, current);
        }
        double *row = tile + (next - written) * w.columns;
        if (is_requested || has_filters) {
            output_row(&w, current, previous, row);
        }
        for (; next < rows && requested[next] == k; ++next) {
            double *copy = tile + (next - written) * w.columns;
            if (copy != row) {
                memcpy(copy, row, w.columns * sizeof(double));
            }
            if (next + 1 - written == PK_CHAIN_TILE) {
                write_tile(&w, PK_CHAIN_TILE, tile, stride, memory + written, column + written);
                written = next + 1;
            }
        }
        double *unused = previous;
        previous = current;
        current = unused;
    }
    if (previous != w.previous) {
        memcpy(w.previous, previous, w.columns * sizeof(double));
    }
    write_tile(&w, next - written, tile, stride, memory + written, column + written);
}
