/* piezoid runtime: the controller of one axis of a piezo stage, in two files.
 *
 * SPDX-License-Identifier: MIT
 * Copyright (c) 2026 The piezoid developers; the licence is at the end of piezoid_runtime.c.
 *
 * Integration: one pz_state per axis; the parameters come from piezo_params.h. Call pz_start
 * before the interrupt is enabled, then pz_step in every interrupt. README.md of the bundle states
 * timing, units and the handling of bad readings; the comment of each function below states what
 * it does and when it may be called.
 *
 * An axis is a position axis, which controls a displacement in m, or a tip axis (PZ_METHOD_RST),
 * which controls a tunnelling current in A. The names of the axes do not matter: an axis named z
 * with a position sensor is a position axis. Members and bits for one type of axis say so.
 *
 * Position axis, once per sample. Voltages are relative to voltage_offset_V, and displacements to
 * displacement_offset_m, times the polarity (with edge_count 0, a de-poled stage reads
 * displacement_offset_m at voltage_offset_V). a is gain_m_per_V, x the state of the observer, d
 * its disturbance:
 *
 *     r  = F_r[step(clip(reference))]                            reference    [m]
 *     nu = clip(reading) - C x,  x = x + L nu,  d = d + L_d nu   correct      (observer)
 *     v  = N r - K x - d      or  (r - bias) / a                 feedback     [V, linearised]
 *     w  = F_c[a v]                                              filter       [m]
 *     u  = Gamma^-1[w - creep]  or  (w - creep) / a              inverse      [V]
 *     u  = u + f                                                 feedforward, where given
 *     u_a = lsb round(step(clip(u)) / lsb)                       converter    [V]
 *     v_a = (Gamma[u_a] + creep) / a  or  u_a + creep / a        applied, linearised
 *     x  = A x + B (v_a + d)                                     predict      (observer)
 *
 * The first alternative of v applies with an observer (dob, mpi_dob), the first of u and v_a with
 * plays (mpi, mpi_dob). clip is to reference_, displacement_ and voltage_minimum and _maximum;
 * step is to reference_step_m and voltage_step_V per sample. F_r and F_c are the biquads
 * reference_section and command_section. pz_step does not delay the reference: it is the position
 * wanted preview_samples later, and F_r was designed for this preview.
 *
 * Gamma = Psi o H o gamma is the Modified Prandtl-Ishlinskii model (Kuhnen 2003): weighted plays
 * H, then one-sided dead zones Psi; an envelope gamma in front of the plays where the model has
 * one (Al Janaideh, Rakheja & Su 2011). Its inverse is solved from the forward memory, which
 * follows the applied voltage, after rounding and clipping. With z_i the state of play i:
 *
 *     H = sum_i phi_i(z_i),  phi_i(z) = w_i z  or  piecewise linear between equidistant edges
 *     z_i = max(w - r_i, min(w + r_i, z_i)),  w = gamma(u_a)
 *     creep = sum_i c_i q_i,  q_i = q_i + rate_i (Gamma[u_a] - q_i)
 *
 * Tip axis, on the logarithm of the tunnelling current; skip this part and all members marked
 * `tip axis` if no axis has the method rst. Landau's letters: R acts on the measurement, S on the
 * output; Longchamp exchanges them; polynomials in q^-1, S and A_0 monic:
 *
 *     (1 - q^-1) S u = T ln(r / i_0) - R ln(max(i, i_floor) / i_0)
 *     and while the converter limits u: (1 - q^-1) S u_a + A_0 (u - u_a) = the same right side
 *
 * This equation applies near the set point only. At the start, and after the current has fallen
 * below r exp(-2 c) with c = contact_log, the tip approaches: u = u + approach_step_V, without
 * integration, until i >= r exp(-c). Then the equation starts from rest at the present current,
 * and its reference rises by approach_log_step per sample to r. An implausible current retracts
 * the tip. Each retract within trip_samples of the last takes twice as long; after trip_limit of
 * them the tip stays retracted until pz_reset.
 *
 * Floating point: one type, pz_real: double, or float if PZ_REAL_FLOAT is defined; there is no
 * fixed-point version. Without contraction of products and sums (-ffp-contract=off), flush to zero
 * and excess precision (x87), every IEEE machine gives the same bits. -ffast-math is refused.
 *
 * Ownership: the caller owns both structures; the runtime does not allocate, print or keep
 * anything. Of the C library it needs memset, memcpy and memmove. For a core without a
 * floating-point unit for pz_real, the compiler adds its own arithmetic routines. Any number of
 * axes may run at the same time, each with its own state; parameters may be in ROM.
 */
#ifndef PIEZOID_RUNTIME_H
#define PIEZOID_RUNTIME_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "piezoid: NaN must stay NaN; compile without -ffast-math and -ffinite-math-only"
#endif

#ifdef PZ_REAL_FLOAT
typedef float pz_real;
#else
typedef double pz_real;
#endif
/* A literal of that type: PZ_REAL(0.5). */
#define PZ_REAL(literal) ((pz_real)(literal))

/* Version and size of pz_parameters must both agree: use the header, the source and the parameters
 * of one bundle. */
#define PZ_SCHEMA_VERSION 2
#define PZ_MAX_PLAYS 32
#define PZ_MAX_KNOTS 32
#define PZ_MAX_EDGES 9
#define PZ_MAX_RELAXATIONS 8
#define PZ_MAX_SECTIONS 4
#define PZ_MAX_ORDER 16
#define PZ_MAX_TAPS 32

/* What pz_step does. */
enum {
    PZ_METHOD_NONE = 0,    /* static gain, no feedback */
    PZ_METHOD_MPI = 1,     /* inverse hysteresis model, no feedback */
    PZ_METHOD_DOB = 2,     /* disturbance observer on the affine model */
    PZ_METHOD_MPI_DOB = 3, /* disturbance observer on top of the inverse hysteresis model */
    PZ_METHOD_RST = 4      /* tip axis: polynomials on the logarithm of the current */
};

/* Constant while the loop runs. Unused elements are 0. */
typedef struct {
    int32_t schema;                  /* PZ_SCHEMA_VERSION */
    int32_t size_bytes;              /* sizeof(pz_parameters) */
    uint32_t checksum;               /* pz_checksum of everything below */
    int32_t method;                  /* PZ_METHOD_... */
    int32_t polarity;                /* 1, or -1 where the displacement falls as the drive rises */
    int32_t play_count;              /* plays in use, that of half-width 0 included */
    int32_t knot_count;              /* knots of Psi in use, that at 0 included; 0: identity */
    int32_t envelope_count;          /* knots of gamma in use, that at 0 included; 0: identity */
    int32_t edge_count;              /* edges of the play functions phi_i; 0: phi_i(z) = w_i z */
    int32_t edge_steps;              /* distance of the edges, as a multiple of r_1 */
    int32_t relaxation_count;        /* creep elements in use; 0: no creep block */
    int32_t reference_section_count; /* biquads on the reference; 0: none */
    int32_t command_section_count;   /* biquads on the linearised command; 0: none */
    int32_t observer_order;          /* states of x, the disturbance not counted */
    int32_t preview_samples;         /* samples by which the reference is given ahead */
    int32_t stuck_samples;           /* equal readings in a row before a sensor is stuck; 0: off */
    int32_t blind_samples;           /* position axis: unusable readings before a latch; 0: none */
    int32_t bad_samples;             /* tip axis: unusable currents before a retract */
    int32_t retract_samples;         /* tip axis: first retract; each further one doubles */
    int32_t contact_samples;         /* tip axis: samples at the set point before contact */
    int32_t trip_limit;              /* tip axis: retracts in a row before a latch; 0: none */
    int32_t trip_samples;            /* tip axis: samples without retract that clear the count */
    int32_t rst_T_count;             /* tip axis: coefficients of T */
    int32_t rst_R_count;             /* tip axis: coefficients of R */
    int32_t rst_S_count;             /* tip axis: coefficients of S, without its integrator */
    int32_t rst_A0_count;            /* tip axis: coefficients of A_0 */

    pz_real sampling_rate_Hz;       /* rate at which pz_step is called */
    pz_real gain_m_per_V;           /* a: static gain of the affine model */
    pz_real voltage_offset_V;       /* centre of the model: u = voltage - offset */
    pz_real displacement_offset_m;  /* centre: y = polarity (displacement - offset) */
    pz_real voltage_minimum_V;      /* lowest output */
    pz_real voltage_maximum_V;      /* highest output */
    pz_real voltage_step_V;         /* largest change in a sample; 0: unlimited */
    pz_real lsb_V;                  /* converter step; outputs are multiples; 0: no rounding */
    pz_real reference_minimum_m;    /* references below are raised to this */
    pz_real reference_maximum_m;    /* references above are lowered to this */
    pz_real reference_step_m;       /* largest change of the reference in a sample; 0: unlimited */
    pz_real certified_step_m;       /* largest change with a proven error limit; 0: none */
    pz_real displacement_minimum_m; /* measurements below are raised to this */
    pz_real displacement_maximum_m; /* measurements above are lowered to this */
    pz_real stuck_voltage_V;        /* voltage change that a working sensor shows */

    pz_real play_threshold_V[PZ_MAX_PLAYS];    /* r_i, increasing from r_0 = 0 */
    pz_real play_weight_m_per_V[PZ_MAX_PLAYS]; /* w_i, all partial sums > 0 */
    pz_real play_memory_V[PZ_MAX_PLAYS];       /* z_i from which pz_start begins; 0: de-poled */
    pz_real knot_m[PZ_MAX_KNOTS];              /* dead-zone thresholds, increasing, one is 0 */
    pz_real knot_weight[PZ_MAX_KNOTS];         /* slope at 0, then its changes; all slopes > 0 */
    pz_real envelope_knot_V[PZ_MAX_KNOTS];     /* knots of gamma, increasing, one is 0 */
    pz_real envelope_weight[PZ_MAX_KNOTS];     /* slope at 0, then its changes; all > 0 */
    pz_real edge_V;                            /* lowest edge of the play functions */
    pz_real play_value_m[PZ_MAX_PLAYS][PZ_MAX_EDGES]; /* phi_i at the edges, rising */
    pz_real relaxation_rate[PZ_MAX_RELAXATIONS];      /* 1 - exp(-T_s / tau_i) */
    pz_real relaxation_share[PZ_MAX_RELAXATIONS];     /* c_i, creep per displacement */

    pz_real reference_section[PZ_MAX_SECTIONS][5]; /* b0 b1 b2 a1 a2, unit gain at rest */
    pz_real command_section[PZ_MAX_SECTIONS][5];   /* b0 b1 b2 a1 a2, unit gain at rest */

    pz_real observer_A[PZ_MAX_ORDER][PZ_MAX_ORDER]; /* row-major */
    pz_real observer_B[PZ_MAX_ORDER];               /* per V */
    pz_real observer_C[PZ_MAX_ORDER];               /* m */
    pz_real observer_L[PZ_MAX_ORDER];               /* per m */
    pz_real observer_disturbance_L_V_per_m;         /* L_d */
    pz_real observer_rest[PZ_MAX_ORDER];            /* x at rest for 1 V: x = A x + B, C x = a */
    pz_real feedback_K_V[PZ_MAX_ORDER];             /* V */
    pz_real feedback_N_V_per_m;                     /* N = (1 + K x) / (C x) at rest */

    /* From here on: tip axis only. */
    pz_real current_reference_A; /* i_0, whose logarithm is 0 */
    pz_real current_floor_A;     /* lowest current in the logarithm: bounds the approach */
    pz_real current_ceiling_A;   /* the tip retracts at once at this current */
    pz_real retract_voltage_V;   /* a retract ends here */
    pz_real retract_step_V;      /* length of a retract; 0: to retract_voltage_V */
    pz_real approach_step_V;     /* extension per sample while there is no current */
    pz_real approach_log_step;   /* then the rise of ln(reference) per sample */
    pz_real contact_log;         /* c: contact if ln(i) is above ln(r) - c */
    pz_real stuck_current_A;     /* currents up to this are never stuck */
    pz_real search_voltage_V;    /* search range beyond the last contact; 0: to the end */
    pz_real schedule_limit;      /* gain ratios stay in [1 / limit, limit]; >= 1 */
    pz_real rst_T_V[PZ_MAX_TAPS];
    pz_real rst_R_V[PZ_MAX_TAPS];
    pz_real rst_S[PZ_MAX_TAPS];  /* monic, without the factor 1 - q^-1 */
    pz_real rst_A0[PZ_MAX_TAPS]; /* monic; 1 alone: shortest anti-windup */
} pz_parameters;

/* Index of every parameter, as pz_check returns it. */
enum {
    PZ_OK = 0,
    PZ_SCHEMA,
    PZ_SIZE_BYTES,
    PZ_CHECKSUM,
    PZ_METHOD,
    PZ_POLARITY,
    PZ_PLAY_COUNT,
    PZ_KNOT_COUNT,
    PZ_ENVELOPE_COUNT,
    PZ_EDGE_COUNT,
    PZ_EDGE_STEPS,
    PZ_RELAXATION_COUNT,
    PZ_REFERENCE_SECTION_COUNT,
    PZ_COMMAND_SECTION_COUNT,
    PZ_OBSERVER_ORDER,
    PZ_PREVIEW_SAMPLES,
    PZ_STUCK_SAMPLES,
    PZ_BLIND_SAMPLES,
    PZ_BAD_SAMPLES,
    PZ_RETRACT_SAMPLES,
    PZ_CONTACT_SAMPLES,
    PZ_TRIP_LIMIT,
    PZ_TRIP_SAMPLES,
    PZ_RST_T_COUNT,
    PZ_RST_R_COUNT,
    PZ_RST_S_COUNT,
    PZ_RST_A0_COUNT,
    PZ_SAMPLING_RATE,
    PZ_GAIN,
    PZ_VOLTAGE_OFFSET,
    PZ_DISPLACEMENT_OFFSET,
    PZ_VOLTAGE_MINIMUM,
    PZ_VOLTAGE_MAXIMUM,
    PZ_VOLTAGE_STEP,
    PZ_LSB,
    PZ_REFERENCE_MINIMUM,
    PZ_REFERENCE_MAXIMUM,
    PZ_REFERENCE_STEP,
    PZ_CERTIFIED_STEP,
    PZ_DISPLACEMENT_MINIMUM,
    PZ_DISPLACEMENT_MAXIMUM,
    PZ_STUCK_VOLTAGE,
    PZ_PLAY_THRESHOLD,
    PZ_PLAY_WEIGHT,
    PZ_PLAY_MEMORY,
    PZ_KNOT,
    PZ_KNOT_WEIGHT,
    PZ_ENVELOPE_KNOT,
    PZ_ENVELOPE_WEIGHT,
    PZ_EDGE,
    PZ_PLAY_VALUE,
    PZ_RELAXATION_RATE,
    PZ_RELAXATION_SHARE,
    PZ_REFERENCE_SECTION,
    PZ_COMMAND_SECTION,
    PZ_OBSERVER_A,
    PZ_OBSERVER_B,
    PZ_OBSERVER_C,
    PZ_OBSERVER_L,
    PZ_OBSERVER_DISTURBANCE_L,
    PZ_OBSERVER_REST,
    PZ_FEEDBACK_K,
    PZ_FEEDBACK_N,
    PZ_CURRENT_REFERENCE,
    PZ_CURRENT_FLOOR,
    PZ_CURRENT_CEILING,
    PZ_RETRACT_VOLTAGE,
    PZ_RETRACT_STEP,
    PZ_APPROACH_STEP,
    PZ_APPROACH_LOG_STEP,
    PZ_CONTACT_LOG,
    PZ_STUCK_CURRENT,
    PZ_SEARCH_VOLTAGE,
    PZ_SCHEDULE_LIMIT,
    PZ_RST_T,
    PZ_RST_R,
    PZ_RST_S,
    PZ_RST_A0,
    PZ_PARAMETER_END
};

/* Bits of the status words: what was limited, replaced or faulty in a sample. 0: nothing. */
enum {
    PZ_STATUS_BAD_REFERENCE = 1,       /* NaN or infinite: the last one is used */
    PZ_STATUS_REFERENCE_LIMITED = 2,   /* outside its range, or faster than its step */
    PZ_STATUS_BAD_MEASUREMENT = 4,     /* NaN or infinite: model alone; a tip waits */
    PZ_STATUS_MEASUREMENT_LIMITED = 8, /* out of range: its end is used; a tip retracts */
    PZ_STATUS_STUCK_SENSOR = 16,       /* frozen while the voltage moved: model; a tip retracts */
    PZ_STATUS_VOLTAGE_LIMITED = 32,    /* at voltage_minimum_V or voltage_maximum_V */
    PZ_STATUS_VOLTAGE_STEP = 64,       /* change limited to voltage_step_V */
    PZ_STATUS_CURRENT_LOST = 128,      /* tip axis: current below its floor */
    PZ_STATUS_RETRACTED = 256,         /* tip axis: retracted */
    PZ_STATUS_RESTARTED = 512,         /* overflow: voltage kept, filters start again at rest */
    PZ_STATUS_NOT_STARTED = 1024,      /* pz_start was not called, or refused the parameters */
    PZ_STATUS_APPROACHING = 2048,      /* tip axis: extending slowly until current flows */
    PZ_STATUS_NO_CURRENT = 4096,       /* tip axis: no current up to the end of search or drive */
    PZ_STATUS_WRONG_SIGN = 8192,       /* tip axis: the current has the wrong sign */
    PZ_STATUS_LATCHED = 16384,    /* until pz_reset; cause in status_ever, of a tip in status */
    PZ_STATUS_BLIND = 32768,      /* position axis: latched after blind_samples */
    PZ_STATUS_UNCERTIFIED = 65536 /* position axis: reference faster than certified_step_m */
};

/* State of one axis. Read its members, never write them. pz_step clears and sets `status` in the
 * interrupt; elsewhere read it once, *(const volatile uint32_t *)&state.status. */
typedef struct {
    uint32_t ready;
    uint32_t status;      /* PZ_STATUS_... of the last sample */
    uint32_t status_ever; /* of all samples; only pz_start clears it */
    int32_t unchanged;    /* samples since the measurement last changed */
    int32_t unusable;     /* unusable measurements in a row */
    int32_t retract_left; /* tip axis: samples until the next approach */
    int32_t moved;        /* 1: the voltage has moved since the measurement last changed */
    int32_t mode;         /* 0: controls, 1: approaches, 2: waits for pz_reset */
    int32_t reset_wanted; /* 1: pz_reset was called */
    int32_t contact;  /* tip axis: samples at the set point in a row, at most contact_samples */
    int32_t trips;    /* tip axis: retracts in a row */
    int32_t trip_age; /* tip axis: samples since the last retract, at most trip_samples */
    uint32_t cause;   /* tip axis: status bits of the last retract */

    pz_real voltage_V;     /* u_a: last output */
    pz_real command_V;     /* clipped, before rounding */
    pz_real reference_m;   /* reference in use, within its range and step; A of a tip */
    pz_real bias_m;        /* without feedback: zero shift that pz_start found */
    pz_real measured;      /* last usable reading, m or A */
    pz_real moved_V;       /* voltage when the measurement last changed */
    pz_real gain_ratio;    /* tip axis: set by pz_schedule */
    pz_real disturbance_V; /* d */
    pz_real contact_V;     /* tip axis: voltage of the last contact */
    pz_real climb;         /* tip axis: ln(present reference / set point); <= 0 */

    pz_real play_V[PZ_MAX_PLAYS];                  /* z_i, forward memory, of gamma(u) */
    pz_real relaxation_m[PZ_MAX_RELAXATIONS];      /* q_i of the creep block */
    pz_real relaxation_rest_m[PZ_MAX_RELAXATIONS]; /* their rounding errors */
    pz_real reference_filter[PZ_MAX_SECTIONS][2];
    pz_real command_filter[PZ_MAX_SECTIONS][2];
    pz_real observer[PZ_MAX_ORDER];     /* x */
    pz_real rst_reference[PZ_MAX_TAPS]; /* ln(r / i_0), newest first, as all below */
    pz_real rst_measured[PZ_MAX_TAPS];  /* ln(i / i_0) */
    pz_real rst_change_V[PZ_MAX_TAPS];  /* u_a[k] - u_a[k-1], before rounding */
    pz_real rst_excess_V[PZ_MAX_TAPS];  /* u_a - u: excess over the limits */
} pz_state;

/* The layout has no holes: the checksum covers every byte, and Python can mirror it. */
#define PZ_INTEGERS 26
#define PZ_REALS                                                                                  \
    (16 + 3 * PZ_MAX_PLAYS + PZ_MAX_PLAYS * PZ_MAX_EDGES + 4 * PZ_MAX_KNOTS +                     \
     2 * PZ_MAX_RELAXATIONS + 10 * PZ_MAX_SECTIONS + PZ_MAX_ORDER * PZ_MAX_ORDER +                \
     5 * PZ_MAX_ORDER + 2 + 11 + 4 * PZ_MAX_TAPS)
typedef char pz_parameters_have_no_holes
    [sizeof(pz_parameters) == PZ_INTEGERS * sizeof(int32_t) + PZ_REALS * sizeof(pz_real) ? 1 : -1];

/* Name, place and limits of a parameter. */
typedef struct {
    const char *name;
    size_t offset_bytes;
    size_t count;    /* elements */
    int32_t is_real; /* 1: pz_real, 0: 32-bit integer */
    pz_real lower;   /* every element lies in [lower, upper] */
    pz_real upper;
} pz_field;

/* ---- background: never from the interrupt -------------------------------------------------- */

/* Description of the parameter with this index; NULL outside 1 .. PZ_PARAMETER_END - 1. The result
 * is static. */
const pz_field *pz_describe(int32_t index);

/* CRC-32 (IEEE 802.3) of all bytes behind the member `checksum`: 4336 (float) or 8580 (double)
 * bytes of eight shifts each. */
uint32_t pz_checksum(const pz_parameters *parameters);

/* PZ_OK, or the index of the first invalid parameter: other schema or size, changed bytes, NaN,
 * out of bounds, limits in the wrong order, a model without inverse, an unstable filter, static
 * gains of the observer that contradict its matrices. Not noticed, once the checksum is renewed:
 * wider limits, another rate or converter step, other gains, an unstable loop. Any bytes may be
 * passed.
 * Cost: pz_checksum, and one pass over all members. */
int32_t pz_check(const pz_parameters *parameters);

/* Set `state` to rest. Calls pz_check first and returns its result; after a refusal pz_step
 * returns the voltage nearest 0 inside the limits and sets NOT_STARTED. Not while pz_step may be
 * called with this state: stop the interrupt, also for a second start.
 * The next step returns voltage_V, limited and rounded, if the reference equals the reading and
 * lies inside its range. Creep is assumed to be at rest. The memory of the hysteresis is set so
 * that the model agrees with the reading, as if the voltage had come monotonically from one
 * turning point. A reading that no turning point explains is treated as a shift of the sensor's
 * zero; without feedback (none, mpi) references are relative to it.
 * Both values are accepted as they are, and the result is PZ_OK: compare voltage_V with the
 * voltage limits, and the reading with reference_minimum_m and reference_maximum_m, before.
 *   voltage_V  V       present output of the converter; not finite: nearest 0 inside the limits;
 *                      beyond a limit: that limit
 *   measured   m or A  present reading; not finite: position axis, the reading that the model
 *                      predicts; tip axis, current_floor_A */
int32_t pz_start(pz_state *state, const pz_parameters *parameters, pz_real voltage_V,
                 pz_real measured);

/* Tip axis: the gain of the plant is now `ratio` times that of the design; the gain of the
 * controller is divided by it, without a step. Limited by schedule_limit: no effect if that is 1.
 * Not finite: ignored. Writes one pz_real: stop the interrupt where that takes more than one store
 * (double on a 32-bit core). */
void pz_schedule(pz_state *state, const pz_parameters *parameters, pz_real ratio);

/* ---- anywhere ------------------------------------------------------------------------------ */

/* Continue after a latched fault, from the next step on. Without a latched fault, only the count
 * of retracts is cleared. A tip approaches again from its retracted position, up to the end of the
 * drive. A position axis starts at the latched voltage and the present reading, without a step if
 * the reference is that reading. One write of 32 bits. */
void pz_reset(pz_state *state);

/* ---- real time: from the interrupt, once per sample ---------------------------------------- */

/* One sample: return the voltage for the converter, finite and inside the limits for any input;
 * state->status states what was limited, replaced or faulty. A sample that is left out, or another
 * rate than sampling_rate_Hz, cannot be detected.
 *   reference  m  position axis: wanted position preview_samples ahead
 *              A  tip axis: wanted current
 *   measured   m  position axis: displacement
 *              A  tip axis: current, positive at the bias in use
 *                 NaN where the reading cannot be trusted
 *   returned   V
 * Cost: linear in plays + knots + taps + (order + 1)^2; loops may end earlier for some inputs. */
pz_real pz_step(pz_state *state, const pz_parameters *parameters, pz_real reference,
                pz_real measured);

/* pz_step with a feedforward voltage for periodic motion, added behind the inverse and before the
 * limits, so that memory and observer follow the applied voltage.
 *   feedforward_V  V  for this point of the period; 0: pz_step, bit for bit. Not finite: counts as
 *                     0 and sets BAD_REFERENCE. Tip axis: not used */
pz_real pz_step_feedforward(pz_state *state, const pz_parameters *parameters, pz_real reference,
                            pz_real measured, pz_real feedforward_V);

/* Natural logarithm of a positive number in [2^-120, 2^120], without the mathematical library.
 * Error below 1 unit in the last place of max(|ln x|, 1/2). */
pz_real pz_log(pz_real x);

#ifdef __cplusplus
}
#endif

#endif
