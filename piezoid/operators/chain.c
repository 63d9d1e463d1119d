#include "chain.h"

#include <math.h>
#include <string.h>

/* Four lanes where the machine has them: nothing is fused, so the numbers stay the same. */
#if defined(__GLIBC__) && defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) &&      \
    !defined(PK_PORTABLE)
#define WIDER __attribute__((target_clones("default", "avx2")))
#define WITHIN static inline __attribute__((always_inline)) /* or it stays narrow */
#else
#define WIDER
#define WITHIN static
#endif

/* Below this a filter's memory is none: numbers smaller still slow a processor down. */
#define NOTHING 1e-200

/* Where everything of one call lies. */
typedef struct {
    const pk_chain *chain;
    size_t plays, zones, columns;
    double *state, *slope, *alive, *last; /* of every play */
    double *before;                       /* row of the sample before */
    double *lag, *sensor;                 /* last inputs and outputs of the filters */
} work;

WITHIN void follow(const work *w, double raw, double bent) {
    const double *restrict r = w->chain->threshold;
    double *restrict z = w->state;
    double *restrict s = w->slope;
    double *restrict a = w->alive;
    double *restrict last = w->last;
    for (size_t i = 0; i < w->plays; ++i) {
        const double low = bent - r[i];
        const double high = bent + r[i];
        const int below = z[i] < low;
        const int above = z[i] > high;
        s[i] = below ? -1.0 : (above ? 1.0 : s[i]);
        a[i] = below || above ? 0.0 : a[i];
        last[i] = below || above ? raw : last[i];
        z[i] = below ? low : (above ? high : z[i]);
    }
}

/* One side of the dead zones, seen with h growing outwards: derivatives by gaps, then by slopes.
 * From the kink at 0 the others follow one way, and so do the slopes from that beside 0. */
WITHIN void side(double h, size_t count, const double *knot, const double *slope, ptrdiff_t way,
                 double *column) {
    const double sign = (double)way;
    double tail = 0.0;
    for (size_t k = count; k-- > 0;) {
        const ptrdiff_t here = way * (ptrdiff_t)k;
        const double beyond = h - sign * knot[here + way];
        double inside = 0.0;
        if (beyond > 0.0) {
            const double width =
                k + 1 < count ? sign * (knot[here + 2 * way] - knot[here + way]) : beyond;
            tail += slope[here] - slope[here + way];
            inside = beyond < width ? beyond : width;
        }
        column[k] = sign * tail;
        column[count + k] = sign * inside;
    }
}

/* Add weight times the part of x inside each segment of its side of the envelope. */
static void spread(const pk_chain *c, double weight, double x, double *below, double *above) {
    const double far = fabs(x);
    double *segment = x < 0.0 ? below : above;
    for (size_t k = 0; k < c->bends && far > c->bend[k]; ++k) {
        const double beyond = far - c->bend[k];
        const double width = k + 1 < c->bends ? c->bend[k + 1] - c->bend[k] : HUGE_VAL;
        segment[k] += weight * (beyond < width ? beyond : width);
    }
}

/* Derivatives by the slopes of the envelope: a play holds the drive at which it last moved. */
static void envelope(const work *w, double raw, double steep, double *column) {
    const pk_chain *c = w->chain;
    double *below = column;
    double *above = column + c->bends;
    memset(column, 0, 2 * c->bends * sizeof(double));
    spread(c, c->weight[0], raw, below, above);
    for (size_t i = 0; i < w->plays; ++i) {
        spread(c, c->weight[i + 1], w->last[i], below, above);
    }
    for (size_t k = 0; k < c->bends; ++k) {
        below[k] *= -steep;
        above[k] *= steep;
    }
}

/* The row before any filter. */
WITHIN void static_row(const work *w, double raw, double bent, double *row) {
    const pk_chain *c = w->chain;
    const pk_map *map = c->zones;
    const size_t plays = w->plays;
    double *by_memory = row;
    double *by_gap = by_memory + plays;
    double *by_weight = by_gap + plays;
    double *by_zone = by_weight + plays + 1;
    double h = c->weight[0] * bent;
    for (size_t i = 0; i < plays; ++i) {
        h += c->weight[i + 1] * w->state[i];
    }
    double steep = 0.0;
    row[w->columns - 1] = pk_mapped(h, map, &steep);
    row[w->columns - 2] = 0.0;
    by_weight[0] = steep * bent;
    double memory = 0.0;
    double gap = 0.0;
    for (size_t i = plays; i-- > 0;) {
        const double weight = steep * c->weight[i + 1];
        memory += weight * w->alive[i];
        gap += weight * w->slope[i];
        by_memory[i] = memory * c->gap[i];
        by_gap[i] = gap + memory * c->memory_slope[i];
        by_weight[i + 1] = steep * w->state[i];
    }
    const size_t below = map->zero;
    const size_t above = map->knots - below - 1;
    const double *middle = map->knot + below;
    const double *gentle = map->slope + below;
    side(-h, below, middle, gentle, -1, by_zone);
    side(h, above, middle, gentle + 1, 1, by_zone + 2 * below);
    envelope(w, raw, steep, by_zone + w->zones);
}

WITHIN double settled(double value) {
    return fabs(value) < NOTHING ? 0.0 : value;
}

/* Pass a row through a filter; its last but one number is the derivative by the lag. */
WITHIN void filtered(const pk_filter *f, size_t columns, double *memory, double *row, int own) {
    double *restrict x = memory;
    double *restrict y = memory + columns;
    double *restrict v = row;
    const size_t lag = columns - 2;
    const size_t out = columns - 1;
    const double grown =
        f->pole * y[lag] + f->pole_by_s * y[out] + f->b0_by_s * v[out] + f->b1_by_s * x[out];
    for (size_t i = 0; i < columns; ++i) {
        const double next = v[i];
        y[i] = settled(f->pole * y[i] + f->b0 * next + f->b1 * x[i]);
        x[i] = next;
        v[i] = y[i];
    }
    if (own) {
        y[lag] = v[lag] = grown;
    }
}

/* The row as it is read: behind the rest of a delay or the lag, and the sensor. */
WITHIN void read_row(const work *w, const double *fresh, const double *before, double *row) {
    const pk_chain *c = w->chain;
    const size_t out = w->columns - 1;
    const size_t lag = w->columns - 2;
    memcpy(row, fresh, w->columns * sizeof(double));
    if (c->late != 0) {
        for (size_t i = 0; i < w->columns; ++i) {
            row[i] = (1.0 - c->share) * fresh[i] + c->share * before[i];
        }
        row[lag] = (before[out] - fresh[out]) * c->rate_Hz;
    }
    if (c->lag != NULL) {
        filtered(c->lag, w->columns, w->lag, row, 1);
    }
    if (c->sensor != NULL) {
        filtered(c->sensor, w->columns, w->sensor, row, 0);
    }
}

/* Before the first sample everything has been as it is there. */
static void begin(const work *w, const double *fresh) {
    const size_t columns = w->columns;
    memcpy(w->before, fresh, columns * sizeof(double));
    for (size_t k = 0; k < 2; ++k) {
        memcpy(w->lag + k * columns, fresh, columns * sizeof(double));
        memcpy(w->sensor + k * columns, fresh, columns * sizeof(double));
    }
}

/* Turn a tile of rows into columns; what belongs to the memory has a place of its own. */
WITHIN void write_out(const work *w, size_t rows, const double *tile, size_t stride,
                      double *memory, double *column) {
    for (size_t i = 0; i < w->columns; ++i) {
        double *place = i < w->plays ? memory + i * stride : column + (i - w->plays) * stride;
        for (size_t k = 0; k < rows; ++k) {
            place[k] = tile[k * w->columns + i];
        }
    }
}

static work laid_out(const pk_chain *chain, double *carry) {
    const size_t plays = chain->plays;
    const size_t zones = 2 * (chain->zones->knots - 1);
    const size_t columns = 3 * plays + 1 + zones + 2 * chain->bends + 2;
    double *rows = carry + 4 * plays;
    const work w = {.chain = chain,
                    .plays = plays,
                    .zones = zones,
                    .columns = columns,
                    .state = carry,
                    .slope = carry + plays,
                    .alive = carry + 2 * plays,
                    .last = carry + 3 * plays,
                    .before = rows,
                    .lag = rows + columns,
                    .sensor = rows + 3 * columns};
    return w;
}

WIDER void pk_chain_rows(int begun, size_t samples, const double *drive, const double *bent,
                         const pk_chain *chain, size_t rows, const size_t *wanted, double *carry,
                         double *tile, size_t stride, double *memory, double *column) {
    const work w = laid_out(chain, carry);
    const int filters = chain->lag != NULL || chain->sensor != NULL;
    double *fresh = tile + PK_CHAIN_TILE * w.columns;
    double *before = w.before;
    size_t next = 0;
    size_t done = 0;
    for (size_t k = 0; k < samples; ++k) {
        follow(&w, drive[k], bent[k]);
        const int here = next < rows && wanted[next] == k;
        const int soon = chain->late != 0 && next < rows && wanted[next] == k + 1;
        if (!(here || soon || filters || k + 1 == samples)) {
            continue;
        }
        static_row(&w, drive[k], bent[k], fresh);
        if (k == 0 && begun == 0) {
            begin(&w, fresh);
        }
        double *made = tile + (next - done) * w.columns;
        if (here || filters) {
            read_row(&w, fresh, before, made);
        }
        for (; next < rows && wanted[next] == k; ++next) {
            double *again = tile + (next - done) * w.columns;
            if (again != made) {
                memcpy(again, made, w.columns * sizeof(double));
            }
            if (next + 1 - done == PK_CHAIN_TILE) {
                write_out(&w, PK_CHAIN_TILE, tile, stride, memory + done, column + done);
                done = next + 1;
            }
        }
        double *spent = before;
        before = fresh;
        fresh = spent;
    }
    if (before != w.before) {
        memcpy(w.before, before, w.columns * sizeof(double));
    }
    write_out(&w, next - done, tile, stride, memory + done, column + done);
}
