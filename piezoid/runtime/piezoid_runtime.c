/* SPDX-License-Identifier: MIT
 * Copyright (c) 2026 The piezoid developers; the licence is at the end of this file. */
#include "piezoid_runtime.h"

#include <float.h>
#include <string.h>

#ifdef PZ_REAL_FLOAT
#define REAL_MAX FLT_MAX
#define REAL_EPSILON FLT_EPSILON
#else
#define REAL_MAX DBL_MAX
#define REAL_EPSILON DBL_EPSILON
#endif

#define ZERO PZ_REAL(0)
#define ONE PZ_REAL(1)
#define MOST_DOUBLED 10   /* times that a retract's samples, at most 1e6, are doubled */
#define REPEATED 2        /* unchanged readings after which an extension learns nothing any more */
#define HALVINGS 64       /* of the drive's range: more than a double has bits */
#define READY 0x507A1D01u /* in state->ready: pz_start has accepted the parameters */

enum { CONTROLS = 0, APPROACHES = 1, LATCHED = 2 }; /* state->mode */

/* Comparisons only: NaN and infinity are on neither side. NaN also differs from itself, which adds
 * nothing here but is the one form from which a value analysis learns that x is a number. */
#ifdef __GNUC__
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wfloat-equal"
#endif
static int is_finite(pz_real x) {
    return x == x && x >= -REAL_MAX && x <= REAL_MAX;
}
#ifdef __GNUC__
#pragma GCC diagnostic pop
#endif

static pz_real magnitude(pz_real x) {
    return x < ZERO ? -x : x;
}

static pz_real clamp(pz_real x, pz_real low, pz_real high) {
    const pz_real raised = x > low ? x : low;
    return raised < high ? raised : high;
}

/* ---- operators ----------------------------------------------------------------------------- */

static pz_real edge_width(const pz_parameters *p) {
    return (pz_real)p->edge_steps * p->play_threshold_V[1];
}

/* phi_i(z), straight between its values at the edges; the outermost pieces go on for ever. */
static pz_real play_value(const pz_parameters *p, int32_t i, pz_real z, pz_real per_V) {
    const pz_real place = (z - p->edge_V) * per_V;
    const int32_t k = (int32_t)clamp(place, ZERO, (pz_real)(p->edge_count - 2));
    const pz_real *value = p->play_value_m[i] + k;
    return value[0] + (value[1] - value[0]) * (place - (pz_real)k);
}

/* H: sum of w_i z_i, or of phi_i(z_i), over the memory. */
static pz_real play_sum(const pz_parameters *p, const pz_real *z) {
    pz_real sum = ZERO;
    if (p->edge_count > 0) {
        const pz_real per_V = ONE / edge_width(p);
        for (int32_t i = 0; i < p->play_count; ++i) {
            sum += play_value(p, i, z[i], per_V);
        }
        return sum;
    }
    for (int32_t i = 0; i < p->play_count; ++i) {
        sum += p->play_weight_m_per_V[i] * z[i];
    }
    return sum;
}

/* The memory follows u: z_i = max(u - r_i, min(u + r_i, z_i)). */
static void play_follow(const pz_parameters *p, pz_real *z, pz_real u) {
    for (int32_t i = 0; i < p->play_count; ++i) {
        z[i] = clamp(z[i], u - p->play_threshold_V[i], u + p->play_threshold_V[i]);
    }
}

/* What phi_i rises over piece k; pieces are counted against u where it falls. */
static pz_real play_rise(const pz_parameters *p, int32_t i, int32_t k, int falls) {
    const pz_real *value = p->play_value_m[i] + (falls ? p->edge_count - 2 - k : k);
    return value[1] - value[0];
}

/* In which piece play i is where u lies between two marks, if it moves: it has passed the inner
 * edges k with k edge_steps + i < mark. */
static int32_t play_piece(const pz_parameters *p, int32_t i, int32_t mark) {
    const int32_t k = mark > i ? (mark - 1 - i) / p->edge_steps : 0;
    return k < p->edge_count - 2 ? k : p->edge_count - 2;
}

#define NOWHERE PZ_REAL(1e30) /* in volts: nothing is there */

/* H^-1 where plays have functions: outwards from z_0 as in play_inverse, from one place at which
 * the sum can bend to the next. Between two of them it is straight, and its slope is positive, as
 * phi_0 rises. Every play begins to move once; one that moves meets the inner edge k where u is at
 * edge_k + r_i. As r_i is i r_1 and edges lie edge_steps r_1 apart, those places are marks r_1
 * apart, number k edge_steps + i from the first edge on: with every play's start no more than
 * `count` places. Seen from where u goes: a way down is one up in a mirror. */
static pz_real value_inverse(const pz_parameters *p, const pz_real *z, pz_real wanted) {
    const pz_real rest = play_sum(p, z);
    const int falls = wanted < rest;
    const pz_real sign = falls ? -ONE : ONE;
    const pz_real way = sign * (wanted - rest) * edge_width(p);
    const pz_real step = p->play_threshold_V[1];
    const int32_t top = p->edge_count - 2;
    const int32_t marks = top * p->edge_steps + p->play_count;
    const int32_t count = marks + p->play_count;
    const pz_real first = sign * p->edge_V - (falls ? (pz_real)(top + 1) * edge_width(p) : ZERO);
    pz_real done = ZERO;
    pz_real u = sign * z[0];
    int32_t moving = 1;
    int32_t mark = (int32_t)clamp((u - first) / step + ONE, ZERO, (pz_real)marks);
    pz_real slope = play_rise(p, 0, play_piece(p, 0, mark), falls);
    /*@ loop unroll 0; */ /* for the proof: its cases, one by one, are too many */
    for (int32_t n = 0; n < count; ++n) {
        const pz_real bends = mark < marks ? first + (pz_real)mark * step : NOWHERE;
        const pz_real begins =
            moving < p->play_count ? sign * z[moving] + p->play_threshold_V[moving] : NOWHERE;
        const pz_real next = begins < bends ? begins : bends;
        if (!(next < NOWHERE) || done + slope * (next - u) >= way) {
            break;
        }
        if (next > u) {
            done += slope * (next - u);
            u = next;
        }
        if (begins < bends && moving < p->play_count) {
            slope += play_rise(p, moving, play_piece(p, moving, mark), falls);
            ++moving;
        } else if (mark < marks) {
            /*@ loop unroll 0; */
            for (int32_t i = mark % p->edge_steps; i < moving; i += p->edge_steps) {
                const int32_t k = (mark - i) / p->edge_steps;
                if (k >= 1 && k <= top) {
                    slope += play_rise(p, i, k, falls) - play_rise(p, i, k - 1, falls);
                }
            }
            ++mark;
        }
    }
    return sign * (u + (way - done) / slope);
}

/* H^-1 from the forward memory z: the u at which the sum of plays is `wanted`.
 *
 * From the present input z_0 outwards, in either direction, play i starts to move where u has gone
 * r_i beyond z_i. Admissible memory is nested (|z_i - z_{i-1}| <= r_i - r_{i-1}), so those places
 * come in the order of i, and between them the sum has the slope w_0 + ... + w_i > 0. */
static pz_real play_inverse(const pz_parameters *p, const pz_real *z, pz_real wanted) {
    if (p->edge_count > 0) {
        return value_inverse(p, z, wanted);
    }
    const pz_real rest = play_sum(p, z);
    const pz_real sign = wanted < rest ? -ONE : ONE;
    const pz_real way = sign * (wanted - rest);
    pz_real done = ZERO;
    pz_real u = sign * z[0];
    pz_real slope = p->play_weight_m_per_V[0];
    for (int32_t i = 1; i < p->play_count; ++i) {
        const pz_real next = sign * z[i] + p->play_threshold_V[i];
        if (next > u) {
            const pz_real rise = slope * (next - u);
            if (done + rise >= way) {
                break;
            }
            done += rise;
            u = next;
        }
        slope += p->play_weight_m_per_V[i];
    }
    return sign * (u + (way - done) / slope);
}

/* Psi, gamma, or the inverse of either: through the knots on the side of x, away from 0. */
static pz_real dead_zones(int32_t count, const pz_real *knot, const pz_real *weight, pz_real x,
                          int inverse) {
    int32_t i = 0;
    if (count == 0) {
        return x;
    }
    while (knot[i] < ZERO) {
        ++i;
    }
    const int32_t step = x < ZERO ? -1 : 1;
    const pz_real sign = x < ZERO ? -ONE : ONE;
    const pz_real way = sign * x;
    pz_real slope = weight[i];
    pz_real at = ZERO;  /* distance of the last knot from 0, before the map */
    pz_real out = ZERO; /* the same after it */
    for (i += step; i >= 0 && i < count; i += step) {
        const pz_real next = sign * knot[i];
        const pz_real next_out = out + slope * (next - at);
        if ((inverse ? next_out : next) >= way) {
            break;
        }
        at = next;
        out = next_out;
        slope += weight[i];
    }
    return sign * (inverse ? at + (way - out) / slope : out + slope * (way - at));
}

static pz_real psi(const pz_parameters *p, pz_real x, int inverse) {
    return dead_zones(p->knot_count, p->knot_m, p->knot_weight, x, inverse);
}

static pz_real envelope(const pz_parameters *p, pz_real x, int inverse) {
    return dead_zones(p->envelope_count, p->envelope_knot_V, p->envelope_weight, x, inverse);
}

/* The memory follows the voltage put out. */
static void remember(const pz_parameters *p, pz_state *s) {
    play_follow(p, s->play_V, envelope(p, s->voltage_V - p->voltage_offset_V, 0));
}

/* A displacement as the model sees it: rising with the drive, 0 at the centre. */
static pz_real centred(const pz_parameters *p, pz_real displacement_m) {
    return (pz_real)p->polarity * (displacement_m - p->displacement_offset_m);
}

static int has_plays(const pz_parameters *p) {
    return p->method == PZ_METHOD_MPI || p->method == PZ_METHOD_MPI_DOB;
}

static int has_observer(const pz_parameters *p) {
    return p->method == PZ_METHOD_DOB || p->method == PZ_METHOD_MPI_DOB;
}

/* The static model: displacement of the voltage the memory has just followed. */
static pz_real static_displacement(const pz_parameters *p, const pz_state *s) {
    const pz_real u = s->voltage_V - p->voltage_offset_V;
    return has_plays(p) ? psi(p, play_sum(p, s->play_V), 0) : p->gain_m_per_V * u;
}

/* Its inverse: the voltage for a displacement, not yet clipped. */
static pz_real static_voltage(const pz_parameters *p, const pz_state *s, pz_real y) {
    const pz_real u = has_plays(p) ? envelope(p, play_inverse(p, s->play_V, psi(p, y, 1)), 1)
                                   : y / p->gain_m_per_V;
    return u + p->voltage_offset_V;
}

static pz_real creep(const pz_parameters *p, const pz_state *s) {
    pz_real sum = ZERO;
    for (int32_t i = 0; i < p->relaxation_count; ++i) {
        sum += p->relaxation_share[i] * s->relaxation_m[i];
    }
    return sum;
}

/* Slow elements change by less than the last bit of x in a sample: what x cannot hold yet waits in
 * `rest` (compensated summation, Kahan 1965). */
static void relax(const pz_parameters *p, pz_state *s, pz_real y) {
    for (int32_t i = 0; i < p->relaxation_count; ++i) {
        const pz_real x = s->relaxation_m[i];
        const pz_real change = s->relaxation_rest_m[i] + p->relaxation_rate[i] * (y - x);
        s->relaxation_m[i] = x + change;
        s->relaxation_rest_m[i] = change - (s->relaxation_m[i] - x);
    }
}

/* Biquads in series, transposed direct form II: b0 b1 b2 a1 a2. */
static pz_real filter(const pz_real section[][5], int32_t count, pz_real memory[][2], pz_real x) {
    for (int32_t i = 0; i < count; ++i) {
        const pz_real *c = section[i];
        const pz_real y = c[0] * x + memory[i][0];
        memory[i][0] = c[1] * x - c[3] * y + memory[i][1];
        memory[i][1] = c[2] * x - c[4] * y;
        x = y;
    }
    return x;
}

/* Their memory after a long time at x; every section has unit gain at rest. */
static void filter_rest(const pz_real section[][5], int32_t count, pz_real memory[][2],
                        pz_real x) {
    for (int32_t i = 0; i < count; ++i) {
        const pz_real *c = section[i];
        memory[i][1] = (c[2] - c[4]) * x;
        memory[i][0] = (c[1] - c[3]) * x + memory[i][1];
    }
}

static pz_real dot(const pz_real *a, const pz_real *b, int32_t count) {
    pz_real sum = ZERO;
    for (int32_t i = 0; i < count; ++i) {
        sum += a[i] * b[i];
    }
    return sum;
}

pz_real pz_log(pz_real x) {
    static const pz_real power[7] = {PZ_REAL(18446744073709551616.0),
                                     PZ_REAL(4294967296.0),
                                     PZ_REAL(65536.0),
                                     PZ_REAL(256.0),
                                     PZ_REAL(16.0),
                                     PZ_REAL(4.0),
                                     PZ_REAL(2.0)};
    pz_real exponent = ZERO;
    pz_real step = PZ_REAL(64);
    /* x = m 2^exponent with m in [1, 2): all products are with powers of two, so exact. */
    for (int32_t i = 0; i < 7; ++i) {
        if (x >= power[i]) {
            x /= power[i];
            exponent += step;
        } else if (x * power[i] < PZ_REAL(2)) {
            x *= power[i];
            exponent -= step;
        }
        step *= PZ_REAL(0.5);
    }
    if (x > PZ_REAL(1.4142135623730951)) {
        x *= PZ_REAL(0.5);
        exponent += ONE;
    }
    /* ln m = 2 artanh((m - 1) / (m + 1)); the first term left out is below 1e-18 of the sum. */
    const pz_real s = (x - ONE) / (x + ONE);
    const pz_real square = s * s;
    pz_real series = ZERO;
    for (int32_t odd = 21; odd >= 3; odd -= 2) {
        series = square * (ONE / (pz_real)odd + series);
    }
    /* ln 2 = 355/512 - 2.12e-4: the first factor has few bits, its product is exact. */
    return exponent * PZ_REAL(0.693359375) +
           (PZ_REAL(2) * s +
            (PZ_REAL(2) * s * series - exponent * PZ_REAL(2.12194440054690583e-4)));
}

/* ---- background: the parameters ------------------------------------------------------------ */

#define COUNT(member, lower, upper)                                                               \
    {#member, offsetof(pz_parameters, member), 1, 0, PZ_REAL(lower), PZ_REAL(upper)}
#define REAL(member, lower, upper)                                                                \
    {#member,                                                                                     \
     offsetof(pz_parameters, member),                                                             \
     sizeof(((const pz_parameters *)0)->member) / sizeof(pz_real),                                \
     1,                                                                                           \
     PZ_REAL(lower),                                                                              \
     PZ_REAL(upper)}

static const pz_field fields[PZ_PARAMETER_END] = {
    [PZ_OK] = {"ok", 0, 0, 0, PZ_REAL(0), PZ_REAL(0)},
    [PZ_SCHEMA] = COUNT(schema, PZ_SCHEMA_VERSION, PZ_SCHEMA_VERSION),
    [PZ_SIZE_BYTES] = COUNT(size_bytes, sizeof(pz_parameters), sizeof(pz_parameters)),
    [PZ_CHECKSUM] = COUNT(checksum, 0, 4294967295.0),
    [PZ_METHOD] = COUNT(method, 0, 4),
    [PZ_POLARITY] = COUNT(polarity, -1, 1),
    [PZ_PLAY_COUNT] = COUNT(play_count, 0, PZ_MAX_PLAYS),
    [PZ_KNOT_COUNT] = COUNT(knot_count, 0, PZ_MAX_KNOTS),
    [PZ_ENVELOPE_COUNT] = COUNT(envelope_count, 0, PZ_MAX_KNOTS),
    [PZ_EDGE_COUNT] = COUNT(edge_count, 0, PZ_MAX_EDGES),
    [PZ_EDGE_STEPS] = COUNT(edge_steps, 0, PZ_MAX_PLAYS),
    [PZ_RELAXATION_COUNT] = COUNT(relaxation_count, 0, PZ_MAX_RELAXATIONS),
    [PZ_REFERENCE_SECTION_COUNT] = COUNT(reference_section_count, 0, PZ_MAX_SECTIONS),
    [PZ_COMMAND_SECTION_COUNT] = COUNT(command_section_count, 0, PZ_MAX_SECTIONS),
    [PZ_OBSERVER_ORDER] = COUNT(observer_order, 0, PZ_MAX_ORDER),
    [PZ_PREVIEW_SAMPLES] = COUNT(preview_samples, 0, 1e6),
    [PZ_STUCK_SAMPLES] = COUNT(stuck_samples, 0, 1e6),
    [PZ_BLIND_SAMPLES] = COUNT(blind_samples, 0, 1e6),
    [PZ_BAD_SAMPLES] = COUNT(bad_samples, 0, 1e6),
    [PZ_RETRACT_SAMPLES] = COUNT(retract_samples, 0, 1e6),
    [PZ_CONTACT_SAMPLES] = COUNT(contact_samples, 0, 1e6),
    [PZ_TRIP_LIMIT] = COUNT(trip_limit, 0, 1e6),
    [PZ_TRIP_SAMPLES] = COUNT(trip_samples, 0, 1e6),
    [PZ_RST_T_COUNT] = COUNT(rst_T_count, 0, PZ_MAX_TAPS),
    [PZ_RST_R_COUNT] = COUNT(rst_R_count, 0, PZ_MAX_TAPS),
    [PZ_RST_S_COUNT] = COUNT(rst_S_count, 0, PZ_MAX_TAPS),
    [PZ_RST_A0_COUNT] = COUNT(rst_A0_count, 0, PZ_MAX_TAPS),
    [PZ_SAMPLING_RATE] = REAL(sampling_rate_Hz, 1, 1e7),
    [PZ_GAIN] = REAL(gain_m_per_V, 0, 1e3),
    [PZ_VOLTAGE_OFFSET] = REAL(voltage_offset_V, -1e4, 1e4),
    [PZ_DISPLACEMENT_OFFSET] = REAL(displacement_offset_m, -1e3, 1e3),
    [PZ_VOLTAGE_MINIMUM] = REAL(voltage_minimum_V, -1e4, 1e4),
    [PZ_VOLTAGE_MAXIMUM] = REAL(voltage_maximum_V, -1e4, 1e4),
    [PZ_VOLTAGE_STEP] = REAL(voltage_step_V, 0, 1e5),
    [PZ_LSB] = REAL(lsb_V, 0, 1e3),
    [PZ_REFERENCE_MINIMUM] = REAL(reference_minimum_m, -1e3, 1e3),
    [PZ_REFERENCE_MAXIMUM] = REAL(reference_maximum_m, -1e3, 1e3),
    [PZ_REFERENCE_STEP] = REAL(reference_step_m, 0, 1e4),
    [PZ_CERTIFIED_STEP] = REAL(certified_step_m, 0, 1e4),
    [PZ_DISPLACEMENT_MINIMUM] = REAL(displacement_minimum_m, -1e3, 1e3),
    [PZ_DISPLACEMENT_MAXIMUM] = REAL(displacement_maximum_m, -1e3, 1e3),
    [PZ_STUCK_VOLTAGE] = REAL(stuck_voltage_V, 0, 1e5),
    [PZ_PLAY_THRESHOLD] = REAL(play_threshold_V, 0, 1e4),
    [PZ_PLAY_WEIGHT] = REAL(play_weight_m_per_V, -1e3, 1e3),
    [PZ_PLAY_MEMORY] = REAL(play_memory_V, -1e4, 1e4),
    [PZ_KNOT] = REAL(knot_m, -1e3, 1e3),
    [PZ_KNOT_WEIGHT] = REAL(knot_weight, -1e6, 1e6),
    [PZ_ENVELOPE_KNOT] = REAL(envelope_knot_V, -1e4, 1e4),
    [PZ_ENVELOPE_WEIGHT] = REAL(envelope_weight, -1e6, 1e6),
    [PZ_EDGE] = REAL(edge_V, -1e4, 1e4),
    [PZ_PLAY_VALUE] = REAL(play_value_m, -1e3, 1e3),
    [PZ_RELAXATION_RATE] = REAL(relaxation_rate, 0, 1),
    [PZ_RELAXATION_SHARE] = REAL(relaxation_share, -1, 1),
    [PZ_REFERENCE_SECTION] = REAL(reference_section, -1e9, 1e9),
    [PZ_COMMAND_SECTION] = REAL(command_section, -1e9, 1e9),
    [PZ_OBSERVER_A] = REAL(observer_A, -1e12, 1e12),
    [PZ_OBSERVER_B] = REAL(observer_B, -1e12, 1e12),
    [PZ_OBSERVER_C] = REAL(observer_C, -1e12, 1e12),
    [PZ_OBSERVER_L] = REAL(observer_L, -1e12, 1e12),
    [PZ_OBSERVER_DISTURBANCE_L] = REAL(observer_disturbance_L_V_per_m, -1e12, 1e12),
    [PZ_OBSERVER_REST] = REAL(observer_rest, -1e12, 1e12),
    [PZ_FEEDBACK_K] = REAL(feedback_K_V, -1e12, 1e12),
    [PZ_FEEDBACK_N] = REAL(feedback_N_V_per_m, -1e12, 1e12),
    [PZ_CURRENT_REFERENCE] = REAL(current_reference_A, 0, 1),
    [PZ_CURRENT_FLOOR] = REAL(current_floor_A, 0, 1),
    [PZ_CURRENT_CEILING] = REAL(current_ceiling_A, 0, 1),
    [PZ_RETRACT_VOLTAGE] = REAL(retract_voltage_V, -1e4, 1e4),
    [PZ_RETRACT_STEP] = REAL(retract_step_V, 0, 1e5),
    [PZ_APPROACH_STEP] = REAL(approach_step_V, 0, 1e5),
    [PZ_APPROACH_LOG_STEP] = REAL(approach_log_step, 0, 1e3),
    [PZ_CONTACT_LOG] = REAL(contact_log, 0, 1e3),
    [PZ_STUCK_CURRENT] = REAL(stuck_current_A, -1, 1),
    [PZ_SEARCH_VOLTAGE] = REAL(search_voltage_V, 0, 1e5),
    [PZ_SCHEDULE_LIMIT] = REAL(schedule_limit, 1, 1e3),
    [PZ_RST_T] = REAL(rst_T_V, -1e9, 1e9),
    [PZ_RST_R] = REAL(rst_R_V, -1e9, 1e9),
    [PZ_RST_S] = REAL(rst_S, -1e9, 1e9),
    [PZ_RST_A0] = REAL(rst_A0, -1e9, 1e9),
};

const pz_field *pz_describe(int32_t index) {
    return index > PZ_OK && index < PZ_PARAMETER_END ? &fields[index] : NULL;
}

uint32_t pz_checksum(const pz_parameters *parameters) {
    const unsigned char *byte = (const unsigned char *)parameters;
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = offsetof(pz_parameters, method); i < sizeof(pz_parameters); ++i) {
        crc ^= byte[i];
        for (int32_t bit = 0; bit < 8; ++bit) {
            crc = (crc >> 1) ^ ((crc & 1u) != 0u ? 0xEDB88320u : 0u);
        }
    }
    return ~crc;
}

static int in_bounds(const pz_parameters *p, const pz_field *field) {
    const unsigned char *place = (const unsigned char *)p + field->offset_bytes;
    if (field->is_real == 0) {
        const pz_real value = (pz_real) * (const int32_t *)(const void *)place;
        return value >= field->lower && value <= field->upper;
    }
    const pz_real *value = (const pz_real *)(const void *)place;
    for (size_t i = 0; i < field->count; ++i) {
        if (!(value[i] >= field->lower && value[i] <= field->upper)) {
            return 0;
        }
    }
    return 1;
}

/* Equal up to what rounding the coefficients to pz_real can do; `scale` sums the magnitudes. */
static int near(pz_real a, pz_real b, pz_real scale) {
    return magnitude(a - b) <= PZ_REAL(64) * REAL_EPSILON * scale;
}

static int32_t check_converter(const pz_parameters *p) {
    if (!(p->voltage_minimum_V < p->voltage_maximum_V)) {
        return PZ_VOLTAGE_MAXIMUM;
    }
    if (p->lsb_V > ZERO) {
        const pz_real window = p->voltage_maximum_V - p->voltage_minimum_V;
        const pz_real largest = magnitude(p->voltage_maximum_V) > magnitude(p->voltage_minimum_V)
                                    ? magnitude(p->voltage_maximum_V)
                                    : magnitude(p->voltage_minimum_V);
        /* A code inside the window must exist, and every code number be exact in a float. */
        if (window < PZ_REAL(2) * p->lsb_V || largest > PZ_REAL(8388608) * p->lsb_V) {
            return PZ_LSB;
        }
    }
    return PZ_OK;
}

/* Thresholds and edges lie on one lattice of r_1, which value_inverse walks along; functions do
 * not fall, and that of the play that always moves rises. */
static int32_t check_functions(const pz_parameters *p) {
    const pz_real *r = p->play_threshold_V;
    if (p->edge_count < 2) {
        return PZ_EDGE_COUNT;
    }
    if (p->play_count < 2) {
        return PZ_PLAY_COUNT;
    }
    for (int32_t i = 1; i < p->play_count; ++i) {
        if (!near(r[i], (pz_real)i * r[1], r[i])) {
            return PZ_PLAY_THRESHOLD;
        }
    }
    if (p->edge_steps < 1) {
        return PZ_EDGE_STEPS;
    }
    for (int32_t i = 0; i < p->play_count; ++i) {
        for (int32_t k = 1; k < p->edge_count; ++k) {
            const pz_real rise = p->play_value_m[i][k] - p->play_value_m[i][k - 1];
            if (!(i > 0 ? rise >= ZERO : rise > ZERO)) {
                return PZ_PLAY_VALUE;
            }
        }
    }
    return PZ_OK;
}

static int32_t check_plays(const pz_parameters *p) {
    const pz_real *r = p->play_threshold_V;
    const pz_real *z = p->play_memory_V;
    pz_real slope = ZERO;
    if (p->play_count < 1) {
        return PZ_PLAY_COUNT;
    }
    if (r[0] > ZERO) {
        return PZ_PLAY_THRESHOLD;
    }
    for (int32_t i = 0; i < p->play_count; ++i) {
        slope += p->play_weight_m_per_V[i];
        if (p->edge_count == 0 && !(slope > ZERO)) {
            return PZ_PLAY_WEIGHT;
        }
        if (i > 0 && !(r[i] > r[i - 1])) {
            return PZ_PLAY_THRESHOLD;
        }
        if (i > 0 && magnitude(z[i] - z[i - 1]) > r[i] - r[i - 1] &&
            !near(magnitude(z[i] - z[i - 1]), r[i] - r[i - 1],
                  r[i] + magnitude(z[i]) + magnitude(z[i - 1]))) {
            return PZ_PLAY_MEMORY;
        }
    }
    return p->edge_count == 0 ? PZ_OK : check_functions(p);
}

/* Knots increase and one is at 0; all slopes are positive. `place` is the index of the knots in
 * the schema; their weights follow. */
static int32_t check_map(int32_t count, const pz_real *knot, const pz_real *weight,
                         int32_t place) {
    int32_t zero = 0;
    for (int32_t i = 1; i < count; ++i) {
        if (!(knot[i] > knot[i - 1])) {
            return place;
        }
        zero = knot[i] > ZERO ? zero : i;
    }
    if (count > 0 && (knot[zero] < ZERO || knot[zero] > ZERO)) {
        return place;
    }
    for (int32_t step = -1; step <= 1; step += 2) {
        pz_real slope = ZERO;
        for (int32_t i = zero; i >= 0 && i < count; i += step) {
            slope += weight[i];
            if (!(slope > ZERO)) {
                return place + 1;
            }
        }
    }
    return PZ_OK;
}

/* Stable poles (Jury's conditions for two), and unit gain at rest. */
static int sections_usable(const pz_real section[][5], int32_t count) {
    for (int32_t i = 0; i < count; ++i) {
        const pz_real *c = section[i];
        const pz_real scale = ONE + magnitude(c[0]) + magnitude(c[1]) + magnitude(c[2]) +
                              magnitude(c[3]) + magnitude(c[4]);
        if (!(magnitude(c[4]) < ONE && magnitude(c[3]) < ONE + c[4])) {
            return 0;
        }
        if (!near(c[0] + c[1] + c[2], ONE + c[3] + c[4], scale)) {
            return 0;
        }
    }
    return 1;
}

/* The observer's model must be at rest where it says, and its static gains must agree: else the
 * start bumps and the reference is missed. */
static int32_t check_observer(const pz_parameters *p) {
    const int32_t n = p->observer_order;
    const pz_real *rest = p->observer_rest;
    pz_real gain_scale = p->gain_m_per_V;
    pz_real feedback_scale = ONE;
    if (n < 1) {
        return PZ_OBSERVER_ORDER;
    }
    for (int32_t i = 0; i < n; ++i) {
        pz_real scale = magnitude(rest[i]) + magnitude(p->observer_B[i]);
        for (int32_t j = 0; j < n; ++j) {
            scale += magnitude(p->observer_A[i][j] * rest[j]);
        }
        if (!near(dot(p->observer_A[i], rest, n) + p->observer_B[i], rest[i], scale)) {
            return PZ_OBSERVER_REST;
        }
        gain_scale += magnitude(p->observer_C[i] * rest[i]);
        feedback_scale += magnitude(p->feedback_K_V[i] * rest[i]);
    }
    if (!near(dot(p->observer_C, rest, n), p->gain_m_per_V, gain_scale)) {
        return PZ_OBSERVER_C;
    }
    if (!near(p->feedback_N_V_per_m * p->gain_m_per_V, ONE + dot(p->feedback_K_V, rest, n),
              feedback_scale)) {
        return PZ_FEEDBACK_N;
    }
    return PZ_OK;
}

static int32_t check_model(const pz_parameters *p) {
    const int32_t answer = check_plays(p);
    if (answer != PZ_OK) {
        return answer;
    }
    const int32_t zones = check_map(p->knot_count, p->knot_m, p->knot_weight, PZ_KNOT);
    if (zones != PZ_OK) {
        return zones;
    }
    return check_map(p->envelope_count, p->envelope_knot_V, p->envelope_weight, PZ_ENVELOPE_KNOT);
}

static int32_t check_lateral(const pz_parameters *p) {
    const int32_t answer = has_plays(p) ? check_model(p) : PZ_OK;
    if (answer != PZ_OK) {
        return answer;
    }
    if (p->polarity == 0) {
        return PZ_POLARITY;
    }
    if (!(p->gain_m_per_V > ZERO)) {
        return PZ_GAIN;
    }
    if (!(p->reference_minimum_m < p->reference_maximum_m)) {
        return PZ_REFERENCE_MAXIMUM;
    }
    if (!(p->displacement_minimum_m < p->displacement_maximum_m)) {
        return PZ_DISPLACEMENT_MAXIMUM;
    }
    for (int32_t i = 0; i < p->relaxation_count; ++i) {
        if (!(p->relaxation_rate[i] > ZERO)) {
            return PZ_RELAXATION_RATE;
        }
    }
    if (!sections_usable(p->command_section, p->command_section_count)) {
        return PZ_COMMAND_SECTION;
    }
    return has_observer(p) ? check_observer(p) : PZ_OK;
}

static int is_monic(const pz_real *polynomial, int32_t count) {
    return count >= 1 && !(polynomial[0] < ONE) && !(polynomial[0] > ONE);
}

static int32_t check_rst(const pz_parameters *p) {
    if (!(p->current_floor_A > ZERO)) {
        return PZ_CURRENT_FLOOR;
    }
    if (!(p->current_reference_A >= p->current_floor_A)) {
        return PZ_CURRENT_REFERENCE;
    }
    if (!(p->current_ceiling_A > p->current_reference_A) ||
        p->current_ceiling_A > PZ_REAL(1e12) * p->current_floor_A) {
        return PZ_CURRENT_CEILING;
    }
    if (p->retract_voltage_V < p->voltage_minimum_V ||
        p->retract_voltage_V > p->voltage_maximum_V) {
        return PZ_RETRACT_VOLTAGE;
    }
    if (p->retract_samples < 1) {
        return PZ_RETRACT_SAMPLES;
    }
    if (p->contact_samples < 1) {
        return PZ_CONTACT_SAMPLES;
    }
    if (!(p->approach_step_V > ZERO)) {
        return PZ_APPROACH_STEP;
    }
    if (!(p->approach_log_step > ZERO)) {
        return PZ_APPROACH_LOG_STEP;
    }
    if (!(p->contact_log > ZERO)) {
        return PZ_CONTACT_LOG;
    }
    if (p->rst_T_count < 1) {
        return PZ_RST_T_COUNT;
    }
    if (p->rst_R_count < 1) {
        return PZ_RST_R_COUNT;
    }
    if (!is_monic(p->rst_S, p->rst_S_count)) {
        return PZ_RST_S;
    }
    if (!is_monic(p->rst_A0, p->rst_A0_count)) {
        return PZ_RST_A0;
    }
    /* Both belong into R, S and T, where the margins were computed. */
    if (p->command_section_count != 0) {
        return PZ_COMMAND_SECTION_COUNT;
    }
    return p->relaxation_count != 0 ? PZ_RELAXATION_COUNT : PZ_OK;
}

int32_t pz_check(const pz_parameters *parameters) {
    for (int32_t i = PZ_SCHEMA; i <= PZ_SIZE_BYTES; ++i) {
        if (!in_bounds(parameters, &fields[i])) {
            return i;
        }
    }
    if (parameters->checksum != pz_checksum(parameters)) {
        return PZ_CHECKSUM;
    }
    for (int32_t i = PZ_METHOD; i < PZ_PARAMETER_END; ++i) {
        if (!in_bounds(parameters, &fields[i])) {
            return i;
        }
    }
    if (!sections_usable(parameters->reference_section, parameters->reference_section_count)) {
        return PZ_REFERENCE_SECTION;
    }
    const int32_t answer = check_converter(parameters);
    if (answer != PZ_OK) {
        return answer;
    }
    return parameters->method == PZ_METHOD_RST ? check_rst(parameters) : check_lateral(parameters);
}

/* ---- converter ----------------------------------------------------------------------------- */

/* To the nearest code; half codes go away from 0, and never out of the limits. */
static pz_real to_code(const pz_parameters *p, pz_real volts) {
    if (!(p->lsb_V > ZERO)) {
        return volts;
    }
    const pz_real half = volts < ZERO ? PZ_REAL(-0.5) : PZ_REAL(0.5);
    int32_t code = (int32_t)(volts / p->lsb_V + half);
    if ((pz_real)code * p->lsb_V > p->voltage_maximum_V) {
        --code;
    }
    if ((pz_real)code * p->lsb_V < p->voltage_minimum_V) {
        ++code;
    }
    return (pz_real)code * p->lsb_V;
}

/* Put out what can be put out of `wanted`; remembers it before and after rounding. */
static void convert(pz_state *s, const pz_parameters *p, pz_real wanted) {
    pz_real command = clamp(wanted, p->voltage_minimum_V, p->voltage_maximum_V);
    if (command < wanted || command > wanted) {
        s->status |= PZ_STATUS_VOLTAGE_LIMITED;
    }
    if (p->voltage_step_V > ZERO) {
        const pz_real near_enough =
            clamp(command, s->command_V - p->voltage_step_V, s->command_V + p->voltage_step_V);
        if (near_enough < command || near_enough > command) {
            s->status |= PZ_STATUS_VOLTAGE_STEP;
        }
        command = clamp(near_enough, p->voltage_minimum_V, p->voltage_maximum_V);
    }
    s->command_V = command;
    s->voltage_V = to_code(p, command);
}

/* ---- background: rest ---------------------------------------------------------------------- */

static void rest_rst(pz_state *s, const pz_parameters *p, pz_real measured_log) {
    for (int32_t i = 0; i < PZ_MAX_TAPS; ++i) {
        s->rst_reference[i] = measured_log;
        s->rst_measured[i] = measured_log;
        s->rst_change_V[i] = ZERO;
        s->rst_excess_V[i] = ZERO;
    }
    filter_rest(p->reference_section, p->reference_section_count, s->reference_filter,
                measured_log);
}

static pz_real log_current(const pz_parameters *p, pz_real current_A) {
    const pz_real kept = clamp(current_A, p->current_floor_A, p->current_ceiling_A);
    return pz_log(kept / p->current_reference_A);
}

/* Rest at s->voltage_V, with the memory of the plays as it is; `y` is relative to the offset. */
static void rest_lateral(pz_state *s, const pz_parameters *p, pz_real y) {
    const pz_real model = static_displacement(p, s);
    for (int32_t i = 0; i < p->relaxation_count; ++i) {
        s->relaxation_m[i] = model;
        s->relaxation_rest_m[i] = ZERO;
    }
    const pz_real moved = model + creep(p, s);
    s->bias_m = has_observer(p) ? ZERO : y - moved;
    s->disturbance_V = (y - moved) / p->gain_m_per_V;
    for (int32_t i = 0; i < p->observer_order; ++i) {
        s->observer[i] = p->observer_rest[i] * (y / p->gain_m_per_V);
    }
    filter_rest(p->reference_section, p->reference_section_count, s->reference_filter, y);
    filter_rest(p->command_section, p->command_section_count, s->command_filter, moved);
}

/* The memory of a stage that came to rest at `u` straight from `extreme`. */
static void recall(const pz_parameters *p, pz_real *z, pz_real extreme, pz_real u) {
    for (int32_t i = 0; i < p->play_count; ++i) {
        z[i] = p->play_memory_V[i];
    }
    play_follow(p, z, extreme);
    play_follow(p, z, u);
}

/* Of all extremes the drive reaches, the one from which the model comes to rest at y: the farther
 * it went, the more of the way stays. Halved until it is known to the last bit; a rest that no
 * extreme explains leaves the one nearest to it, and the difference to the bias. */
static void recall_rest(pz_state *s, const pz_parameters *p, pz_real u, pz_real y) {
    pz_real crept = ONE; /* over the static displacement */
    for (int32_t i = 0; i < p->relaxation_count; ++i) {
        crept += p->relaxation_share[i];
    }
    if (!(crept > ZERO)) {
        return;
    }
    const pz_real wanted = psi(p, y / crept, 1);
    const int above = wanted > play_sum(p, s->play_V);
    const pz_real end_V = above ? p->voltage_maximum_V : p->voltage_minimum_V;
    pz_real near_V = u;
    pz_real far_V = envelope(p, end_V - p->voltage_offset_V, 0);
    for (int32_t i = 0; i < HALVINGS; ++i) {
        const pz_real middle_V = PZ_REAL(0.5) * near_V + PZ_REAL(0.5) * far_V;
        recall(p, s->play_V, middle_V, u);
        if ((wanted > play_sum(p, s->play_V)) == above) {
            near_V = middle_V;
        } else {
            far_V = middle_V;
        }
    }
}

static void start_lateral(pz_state *s, const pz_parameters *p, pz_real measured) {
    const pz_real u = envelope(p, s->voltage_V - p->voltage_offset_V, 0);
    recall(p, s->play_V, u, u);
    if (is_finite(measured)) {
        s->measured = clamp(measured, p->displacement_minimum_m, p->displacement_maximum_m);
        if (has_plays(p)) {
            recall_rest(s, p, u, centred(p, s->measured));
        }
    } else {
        s->measured = (pz_real)p->polarity * static_displacement(p, s) + p->displacement_offset_m;
    }
    s->reference_m = clamp(s->measured, p->reference_minimum_m, p->reference_maximum_m);
    rest_lateral(s, p, centred(p, s->measured));
}

int32_t pz_start(pz_state *state, const pz_parameters *parameters, pz_real voltage_V,
                 pz_real measured) {
    const int32_t answer = pz_check(parameters);
    memset(state, 0, sizeof *state); /* all bits 0 is 0 in IEEE arithmetic */
    state->status = PZ_STATUS_NOT_STARTED;
    state->status_ever = PZ_STATUS_NOT_STARTED;
    if (answer != PZ_OK) {
        return answer;
    }
    state->status = 0;
    state->status_ever = 0;
    state->gain_ratio = ONE;
    state->command_V = clamp(is_finite(voltage_V) ? voltage_V : ZERO,
                             parameters->voltage_minimum_V, parameters->voltage_maximum_V);
    state->voltage_V = to_code(parameters, state->command_V);
    state->moved_V = state->voltage_V;
    if (parameters->method == PZ_METHOD_RST) {
        state->measured = is_finite(measured) ? measured : parameters->current_floor_A;
        state->reference_m = state->measured;
        rest_rst(state, parameters, log_current(parameters, state->measured));
    } else {
        start_lateral(state, parameters, measured);
    }
    state->ready = READY;
    return PZ_OK;
}

void pz_schedule(pz_state *state, const pz_parameters *parameters, pz_real ratio) {
    if (is_finite(ratio)) {
        state->gain_ratio =
            clamp(ratio, ONE / parameters->schedule_limit, parameters->schedule_limit);
    }
}

void pz_reset(pz_state *state) {
    state->reset_wanted = 1;
}

/* ---- real time: position axis -------------------------------------------------------------- */

/* The reference made usable, filtered, relative to the offset. */
static pz_real take_reference(pz_state *s, const pz_parameters *p, pz_real reference) {
    if (!is_finite(reference)) {
        s->status |= PZ_STATUS_BAD_REFERENCE;
        reference = s->reference_m;
    }
    pz_real kept = clamp(reference, p->reference_minimum_m, p->reference_maximum_m);
    if (p->reference_step_m > ZERO) {
        kept = clamp(kept, s->reference_m - p->reference_step_m,
                     s->reference_m + p->reference_step_m);
    }
    if (kept < reference || kept > reference) {
        s->status |= PZ_STATUS_REFERENCE_LIMITED;
    }
    if (p->certified_step_m > ZERO && magnitude(kept - s->reference_m) > p->certified_step_m) {
        s->status |= PZ_STATUS_UNCERTIFIED;
    }
    s->reference_m = kept;
    return filter(p->reference_section, p->reference_section_count, s->reference_filter,
                  centred(p, kept));
}

/* Whether the sensor has shown the same number for too long although the voltage moved. It stays
 * so until the number changes. */
static int is_stuck(pz_state *s, const pz_parameters *p, pz_real measured) {
    if (p->stuck_samples == 0) {
        return 0;
    }
    if (measured < s->measured || measured > s->measured) {
        s->unchanged = 0;
        s->moved = 0;
        s->moved_V = s->voltage_V;
        return 0;
    }
    if (s->unchanged < p->stuck_samples) {
        ++s->unchanged;
    }
    if (magnitude(s->voltage_V - s->moved_V) >= p->stuck_voltage_V) {
        s->moved = 1;
    }
    return s->moved == 1 && s->unchanged >= p->stuck_samples;
}

/* An unusable measurement: the model flies on alone, for as long as it may. */
static pz_real fly_blind(pz_state *s, const pz_parameters *p, uint32_t why) {
    s->status |= why;
    if (p->blind_samples > 0) {
        s->unusable += s->unusable < p->blind_samples ? 1 : 0;
        if (s->unusable >= p->blind_samples) {
            s->mode = LATCHED;
        }
    }
    return ZERO;
}

/* What the observer learns from the measurement; nothing from an unusable one. */
static pz_real take_innovation(pz_state *s, const pz_parameters *p, pz_real measured) {
    if (!is_finite(measured)) {
        return fly_blind(s, p, PZ_STATUS_BAD_MEASUREMENT);
    }
    const int stuck = is_stuck(s, p, measured);
    s->measured = measured;
    if (stuck) {
        return fly_blind(s, p, PZ_STATUS_STUCK_SENSOR);
    }
    s->unusable = 0;
    const pz_real kept = clamp(measured, p->displacement_minimum_m, p->displacement_maximum_m);
    if (kept < measured || kept > measured) {
        s->status |= PZ_STATUS_MEASUREMENT_LIMITED;
    }
    return centred(p, kept) - dot(p->observer_C, s->observer, p->observer_order);
}

static void correct(pz_state *s, const pz_parameters *p, pz_real innovation) {
    for (int32_t i = 0; i < p->observer_order; ++i) {
        s->observer[i] += p->observer_L[i] * innovation;
    }
    s->disturbance_V += p->observer_disturbance_L_V_per_m * innovation;
}

/* x = A x + B (v_a + d). */
static void predict(pz_state *s, const pz_parameters *p, pz_real applied_V) {
    const int32_t n = p->observer_order;
    const pz_real drive = applied_V + s->disturbance_V;
    pz_real next[PZ_MAX_ORDER];
    for (int32_t i = 0; i < n; ++i) {
        next[i] = dot(p->observer_A[i], s->observer, n) + p->observer_B[i] * drive;
    }
    for (int32_t i = 0; i < n; ++i) {
        s->observer[i] = next[i];
    }
}

/* A number overflowed, now or in the last prediction: the voltage and the memory of the plays
 * stay, everything else starts anew. */
static void restart_lateral(pz_state *s, const pz_parameters *p) {
    const pz_real y =
        centred(p, clamp(s->measured, p->displacement_minimum_m, p->displacement_maximum_m));
    s->status |= PZ_STATUS_RESTARTED;
    rest_lateral(s, p, y);
}

/* The voltage is held. 1: pz_reset was called; the loop starts at rest at the present reading,
 * from which the next change of the reference is counted. */
static int leaves_hold(pz_state *s, const pz_parameters *p, pz_real measured) {
    if (is_finite(measured)) {
        s->measured = measured;
    }
    if (s->reset_wanted == 0) {
        s->status |= PZ_STATUS_BLIND | PZ_STATUS_LATCHED;
        return 0;
    }
    s->mode = CONTROLS;
    s->reset_wanted = 0;
    s->unusable = 0;
    s->unchanged = 0;
    s->moved = 0;
    s->moved_V = s->voltage_V;
    s->reference_m = clamp(s->measured, p->reference_minimum_m, p->reference_maximum_m);
    rest_lateral(
        s, p,
        centred(p, clamp(s->measured, p->displacement_minimum_m, p->displacement_maximum_m)));
    return 1;
}

/* The voltage with a table's value on top. No table: the bits of `volts`, a negative zero too. */
static pz_real with_feedforward(pz_state *s, pz_real volts, pz_real feedforward_V) {
    if (!is_finite(feedforward_V)) {
        s->status |= PZ_STATUS_BAD_REFERENCE;
        return volts;
    }
    return magnitude(feedforward_V) > ZERO ? volts + feedforward_V : volts;
}

static void step_lateral(pz_state *s, const pz_parameters *p, pz_real reference, pz_real measured,
                         pz_real feedforward_V) {
    if (s->mode == LATCHED && !leaves_hold(s, p, measured)) {
        return;
    }
    const pz_real wanted = take_reference(s, p, reference);
    pz_real command = wanted - s->bias_m; /* a v: carried in metres, so that no gain rounds it */
    if (has_observer(p)) {
        const pz_real innovation = take_innovation(s, p, measured);
        if (s->mode == LATCHED) {
            s->reset_wanted = 0; /* a pz_reset before the fault does not clear it */
            s->status |= PZ_STATUS_BLIND | PZ_STATUS_LATCHED;
            return;
        }
        correct(s, p, innovation);
        const pz_real feedback = dot(p->feedback_K_V, s->observer, p->observer_order);
        command = p->gain_m_per_V * (p->feedback_N_V_per_m * wanted - feedback - s->disturbance_V);
    }
    command = filter(p->command_section, p->command_section_count, s->command_filter, command);
    const pz_real crept = creep(p, s);
    const pz_real volts =
        with_feedforward(s, static_voltage(p, s, command - crept), feedforward_V);
    if (!is_finite(volts) || !is_finite(command)) {
        restart_lateral(s, p);
        return;
    }
    convert(s, p, volts);
    if (has_plays(p)) {
        remember(p, s);
    }
    const pz_real moved = static_displacement(p, s);
    relax(p, s, moved);
    if (has_observer(p)) {
        predict(s, p, (moved + crept) / p->gain_m_per_V);
    }
}

/* ---- real time: tip axis ------------------------------------------------------------------- */

/* ln(r / i_0) of the reference made usable. */
static pz_real take_current_reference(pz_state *s, const pz_parameters *p, pz_real reference_A) {
    if (!is_finite(reference_A)) {
        s->status |= PZ_STATUS_BAD_REFERENCE;
        reference_A = s->reference_m;
    }
    const pz_real kept = clamp(reference_A, p->current_floor_A, p->current_ceiling_A);
    if (kept < reference_A || kept > reference_A) {
        s->status |= PZ_STATUS_REFERENCE_LIMITED;
    }
    s->reference_m = kept;
    return log_current(p, kept);
}

/* An unusable current is waited for, and the tip stands still: `why` from bad_samples on. */
static uint32_t wait_for_current(pz_state *s, const pz_parameters *p, uint32_t why) {
    s->status |= why;
    if (s->unusable < p->bad_samples) {
        ++s->unusable;
        return 0;
    }
    return why;
}

/* Why the tip must flee from this current, as status bits; 0: it need not. */
static uint32_t take_current(pz_state *s, const pz_parameters *p, pz_real wanted,
                             pz_real current_A) {
    if (!is_finite(current_A)) {
        return wait_for_current(s, p, PZ_STATUS_BAD_MEASUREMENT);
    }
    const int stuck = is_stuck(s, p, current_A) && current_A > p->stuck_current_A;
    s->measured = current_A;
    /* Less than this may be the offset of an amplifier that has no current to show. */
    if (current_A < -p->current_floor_A && log_current(p, -current_A) >= wanted - p->contact_log) {
        return wait_for_current(s, p, PZ_STATUS_WRONG_SIGN);
    }
    uint32_t why = 0;
    s->unusable = 0;
    if (stuck) {
        why |= PZ_STATUS_STUCK_SENSOR;
    }
    if (current_A >= p->current_ceiling_A) {
        why |= PZ_STATUS_MEASUREMENT_LIMITED;
    }
    s->status |= why;
    if (current_A < p->current_floor_A) {
        s->status |= PZ_STATUS_CURRENT_LOST;
    }
    return why;
}

/* Retract by a step, or, for a latch, to the end. The end of a tip behind retract_voltage_V is the
 * end of its drive. Every retract in a row waits twice as long as the last, so that a fault that
 * passes does not latch. */
static void retract(pz_state *s, const pz_parameters *p, uint32_t why, int for_good) {
    const pz_real end_V =
        s->command_V > p->retract_voltage_V ? p->retract_voltage_V : p->voltage_minimum_V;
    pz_real target_V = end_V;
    s->trip_age = 0;
    s->cause = why;
    s->status |= why | PZ_STATUS_RETRACTED;
    s->mode = APPROACHES;
    s->unusable = 0;
    s->retract_left =
        (p->retract_samples << (s->trips < MOST_DOUBLED ? s->trips : MOST_DOUBLED)) - 1;
    s->trips += s->trips < INT32_MAX ? 1 : 0;
    if (for_good || (p->trip_limit > 0 && s->trips >= p->trip_limit)) {
        s->mode = LATCHED;
        s->status |= PZ_STATUS_LATCHED;
    } else if (p->retract_step_V > ZERO && s->command_V - p->retract_step_V > end_V) {
        target_V = s->command_V - p->retract_step_V;
    }
    s->command_V = target_V;
    s->voltage_V = to_code(p, target_V);
}

/* Handle pz_reset and the count of retracts. 1: the tip stays retracted. */
static int stays_retracted(pz_state *s, const pz_parameters *p) {
    if (s->reset_wanted != 0) {
        s->reset_wanted = 0;
        s->trips = 0;
        if (s->mode == LATCHED) {
            s->mode = APPROACHES;
            s->retract_left = 0;
            s->contact = 0;
            s->unchanged = 0;
            s->moved = 0;
            s->moved_V = s->voltage_V;
        }
    }
    if (s->trip_age < p->trip_samples) {
        ++s->trip_age;
    } else {
        s->trips = 0;
    }
    if (s->mode == LATCHED) {
        s->status |= PZ_STATUS_RETRACTED | PZ_STATUS_LATCHED | s->cause;
        return 1;
    }
    if (s->retract_left > 0) {
        --s->retract_left;
        s->status |= PZ_STATUS_RETRACTED;
        return 1;
    }
    return 0;
}

/* The same number again says nothing of where the surface is now. */
static int is_repeated(const pz_state *s, const pz_parameters *p) {
    return p->stuck_samples > 0 && s->unchanged >= REPEATED;
}

/* Where the surface is. A tip that flees faster than it approaches has left it: the readings are
 * late. */
static void touch(pz_state *s, const pz_parameters *p) {
    const pz_real least_V = s->contact_V - p->approach_step_V;
    if (s->contact == 0) {
        s->contact_V = s->command_V;
    } else if (!is_repeated(s, p)) {
        s->contact_V = s->command_V < least_V ? least_V : s->command_V;
    }
    s->contact += s->contact < p->contact_samples ? 1 : 0;
}

/* From approach to control when the current is there, and back when it is gone. */
static void choose_mode(pz_state *s, const pz_parameters *p, pz_real wanted, pz_real shown,
                        int is_lost) {
    const int is_there = !is_lost && shown >= wanted - p->contact_log;
    if (s->mode == APPROACHES && is_there) {
        s->mode = CONTROLS;
        rest_rst(s, p, shown);
        s->climb = shown < wanted ? shown - wanted : ZERO;
    } else if (s->mode == CONTROLS &&
               (is_lost || shown < wanted + s->climb - PZ_REAL(2) * p->contact_log)) {
        s->mode = APPROACHES;
    }
    if (is_there) {
        touch(s, p);
    } else if (s->contact < p->contact_samples) {
        s->contact = 0;
    }
}

/* A lost surface is looked for no farther than it may be gone: one that stepped away and a
 * current that is not shown any more look the same. */
static int searched_enough(const pz_state *s, const pz_parameters *p) {
    if (s->mode == APPROACHES && s->command_V >= p->voltage_maximum_V) {
        return 1;
    }
    return p->search_voltage_V > ZERO && s->contact >= p->contact_samples &&
           s->command_V > s->contact_V + p->search_voltage_V;
}

static void shift_in(pz_real *history, int32_t count, pz_real newest) {
    for (int32_t i = count - 1; i > 0; --i) {
        history[i] = history[i - 1];
    }
    history[0] = newest;
}

static void control_current(pz_state *s, const pz_parameters *p, pz_real wanted, pz_real shown,
                            pz_real approach_V) {
    const pz_real before_V = s->command_V;
    s->climb = s->climb + p->approach_log_step < ZERO ? s->climb + p->approach_log_step : ZERO;
    shift_in(s->rst_measured, p->rst_R_count, shown);
    shift_in(s->rst_reference, p->rst_T_count,
             filter(p->reference_section, p->reference_section_count, s->reference_filter,
                    wanted + s->climb));
    const pz_real drive = (dot(p->rst_T_V, s->rst_reference, p->rst_T_count) -
                           dot(p->rst_R_V, s->rst_measured, p->rst_R_count)) /
                          s->gain_ratio;
    const pz_real change = drive - dot(p->rst_S + 1, s->rst_change_V, p->rst_S_count - 1) +
                           dot(p->rst_A0 + 1, s->rst_excess_V, p->rst_A0_count - 1);
    const pz_real asked = before_V + change;
    if (!is_finite(asked)) {
        s->status |= PZ_STATUS_RESTARTED;
        rest_rst(s, p, shown);
        return;
    }
    convert(s, p, is_repeated(s, p) && change > approach_V ? before_V + approach_V : asked);
    shift_in(s->rst_change_V, p->rst_S_count, s->command_V - before_V);
    shift_in(s->rst_excess_V, p->rst_A0_count, s->command_V - asked);
}

static void step_rst(pz_state *s, const pz_parameters *p, pz_real reference_A, pz_real current_A) {
    const pz_real wanted = take_current_reference(s, p, reference_A);
    const uint32_t why = take_current(s, p, wanted, current_A);
    if (stays_retracted(s, p)) {
        s->unusable = 0;
        return;
    }
    if (why != 0) {
        retract(s, p, why, 0);
        return;
    }
    if (s->unusable > 0) {
        return;
    }
    const pz_real shown = log_current(p, current_A);
    const pz_real approach_V = p->approach_step_V / s->gain_ratio;
    choose_mode(s, p, wanted, shown, current_A < p->current_floor_A);
    if (searched_enough(s, p)) {
        retract(s, p, PZ_STATUS_NO_CURRENT, s->command_V >= p->voltage_maximum_V);
    } else if (s->mode == APPROACHES) {
        s->status |= PZ_STATUS_APPROACHING;
        convert(s, p, s->command_V + approach_V);
    } else {
        control_current(s, p, wanted, shown, approach_V);
    }
}

/* ---- real time ----------------------------------------------------------------------------- */

/* Without usable parameters: the voltage nearest 0 that the limits allow, if they are limits. */
static pz_real idle_voltage(const pz_parameters *p) {
    const int usable = is_finite(p->voltage_minimum_V) && is_finite(p->voltage_maximum_V) &&
                       p->voltage_minimum_V < p->voltage_maximum_V;
    return usable ? clamp(ZERO, p->voltage_minimum_V, p->voltage_maximum_V) : ZERO;
}

pz_real pz_step_feedforward(pz_state *state, const pz_parameters *parameters, pz_real reference,
                            pz_real measured, pz_real feedforward_V) {
    if (state->ready != READY) {
        state->status = PZ_STATUS_NOT_STARTED;
        return idle_voltage(parameters);
    }
    state->status = 0;
    if (parameters->method == PZ_METHOD_RST) {
        step_rst(state, parameters, reference, measured);
    } else {
        step_lateral(state, parameters, reference, measured, feedforward_V);
    }
    state->status_ever |= state->status;
    return state->voltage_V;
}

pz_real pz_step(pz_state *state, const pz_parameters *parameters, pz_real reference,
                pz_real measured) {
    return pz_step_feedforward(state, parameters, reference, measured, ZERO);
}

/* MIT License
 *
 * Copyright (c) 2026 The piezoid developers
 *
 * Permission is hereby granted, free of charge, to any person obtaining a copy
 * of this software and associated documentation files (the "Software"), to deal
 * in the Software without restriction, including without limitation the rights
 * to use, copy, modify, merge, publish, distribute, sublicense, and/or sell
 * copies of the Software, and to permit persons to whom the Software is
 * furnished to do so, subject to the following conditions:
 *
 * The above copyright notice and this permission notice shall be included in all
 * copies or substantial portions of the Software.
 *
 * THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR
 * IMPLIED, INCLUDING BUT NOT LIMITED TO THE WARRANTIES OF MERCHANTABILITY,
 * FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE
 * AUTHORS OR COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER
 * LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR OTHERWISE, ARISING FROM,
 * OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE
 * SOFTWARE.
 */
