/* piezoid runtime: the controller of one axis of a piezo stage, in two files.
 *
 * Use: one pz_state per axis; the parameters come from piezo_params.h. At power-up call pz_start
 * with the present voltage and reading. Then call pz_step once per sample in the interrupt and
 * write the voltage that it returns to the converter. state.status states why the output differs
 * from the requested one. pz_reset continues after a fault that has latched. pz_check, pz_start,
 * pz_schedule and pz_describe belong in the background; pz_reset may be called at any time.
 *
 * The loop, once per sample (X and Y; quantities relative to their offsets, displacements times
 * the polarity):
 *
 *     nu = y - C x,   x = x + L nu,   d = d + L_d nu                 correct      (observer)
 *     v  = N r - K x - d                                             feedback     [V, linearised]
 *     u  = Gamma^-1[a v - creep]      or  (a v - creep) / a          inverse      [V]
 *     u  = u + f                                                     feedforward, where given
 *     u_a = lsb round(clip(u) / lsb)                                 converter    [V]
 *     v_a = (Gamma[u_a] + creep) / a  or  u_a + creep / a            applied, linearised
 *     x = A x + B (v_a + d)                                          predict      (observer)
 *
 * Gamma = Psi o H o gamma is the Modified Prandtl-Ishlinskii model (Kuhnen 2003): weighted plays
 * H, then one-sided dead zones Psi; an envelope gamma in front of the plays where the model has
 * one (Al Janaideh, Rakheja & Su 2011). Its inverse is solved from the forward memory, which
 * follows the applied voltage, after rounding and clipping.
 * creep = sum_i c_i x_i,  x_i = x_i + rate_i (Gamma[u_a] - x_i).
 *
 * Z, on the logarithm of the tunnelling current (Landau's letters: R acts on the measurement, S
 * on the output; Longchamp exchanges them; polynomials in q^-1, S and A_0 monic):
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
 * Floating point: one type, pz_real: double, or float if PZ_REAL_FLOAT is defined. The
 * mathematical library is not called. With -ffp-contract=off every IEEE machine gives the same
 * bits. -ffast-math is refused below.
 *
 * Ownership: the caller owns both structures; the runtime does not allocate, print or keep
 * anything. Any number of axes may run at the same time, each with its own state; parameters may
 * be in ROM.
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
    PZ_METHOD_RST = 4      /* Z: polynomial controller on the logarithm of the current */
};

/* Constant while the loop runs. Unused elements are 0. */
typedef struct {
    int32_t schema;                  /* PZ_SCHEMA_VERSION */
    int32_t size_bytes;              /* sizeof(pz_parameters) */
    uint32_t checksum;               /* pz_checksum of everything below */
    int32_t method;                  /* PZ_METHOD_... */
    int32_t polarity;                /* 1, or -1 where the displacement falls as the drive rises */
    int32_t play_count;              /* plays in use */
    int32_t knot_count;              /* dead zones in use; 0: Psi is the identity */
    int32_t envelope_count;          /* kinks of gamma in use; 0: gamma is the identity */
    int32_t edge_count;              /* of the functions of the plays; 0: phi_i(z) = w_i z */
    int32_t edge_steps;              /* of r_1 from edge to edge */
    int32_t relaxation_count;        /* creep elements in use; 0: no creep block */
    int32_t reference_section_count; /* biquads on the reference; 0: none */
    int32_t command_section_count;   /* biquads on the linearised command; 0: none */
    int32_t observer_order;          /* states of x, the disturbance not counted */
    int32_t preview_samples;         /* the reference is for this many samples ahead */
    int32_t stuck_samples;           /* equal measurements that mean a stuck sensor; 0: off */
    int32_t blind_samples;           /* X, Y: unusable readings before a hold; 0: no hold */
    int32_t bad_samples;             /* Z: unusable currents in a row that mean retract */
    int32_t retract_samples;         /* Z: samples of a first retract; each in a row doubles */
    int32_t contact_samples;         /* Z: samples at the set point that make a contact */
    int32_t trip_limit;              /* Z: retracts in a row before a latch; 0: no latch */
    int32_t trip_samples;            /* Z: samples after which a retract is a first one */
    int32_t rst_T_count;             /* coefficients of T */
    int32_t rst_R_count;             /* coefficients of R */
    int32_t rst_S_count;             /* coefficients of S, its integrator not counted */
    int32_t rst_A0_count;            /* coefficients of A_0 */

    pz_real sampling_rate_Hz;       /* how often pz_step is called */
    pz_real gain_m_per_V;           /* a: static gain of the affine model */
    pz_real voltage_offset_V;       /* centre of the model: u = voltage - offset */
    pz_real displacement_offset_m;  /* centre: y = polarity (displacement - offset) */
    pz_real voltage_minimum_V;      /* converter, lower end */
    pz_real voltage_maximum_V;      /* converter, upper end */
    pz_real voltage_step_V;         /* largest change in a sample; 0: any */
    pz_real lsb_V;                  /* converter step, codes at multiples; 0: no rounding */
    pz_real reference_minimum_m;    /* references below are raised to this */
    pz_real reference_maximum_m;    /* references above are lowered to this */
    pz_real reference_step_m;       /* largest change of the reference in a sample; 0: any */
    pz_real certified_step_m;       /* largest change for which the bound holds; 0: no bound */
    pz_real displacement_minimum_m; /* measurements below are raised to this */
    pz_real displacement_maximum_m; /* measurements above are lowered to this */
    pz_real stuck_voltage_V;        /* a sensor that ignores such a change may be stuck */

    pz_real play_threshold_V[PZ_MAX_PLAYS];    /* r_i, increasing from r_0 = 0 */
    pz_real play_weight_m_per_V[PZ_MAX_PLAYS]; /* w_i, all partial sums > 0 */
    pz_real play_memory_V[PZ_MAX_PLAYS];       /* z_i before the start, nested */
    pz_real knot_m[PZ_MAX_KNOTS];              /* dead-zone thresholds, increasing, one is 0 */
    pz_real knot_weight[PZ_MAX_KNOTS];         /* dead-zone weights, all slopes > 0 */
    pz_real envelope_knot_V[PZ_MAX_KNOTS];     /* kinks of gamma, increasing, one is 0 */
    pz_real envelope_weight[PZ_MAX_KNOTS];     /* changes of its slope, all slopes > 0 */
    pz_real edge_V;                            /* lowest edge of the functions */
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

    pz_real current_reference_A; /* i_0: the logarithm is 0 here */
    pz_real current_floor_A;     /* smaller currents count as this: bounds the approach */
    pz_real current_ceiling_A;   /* from here on retract at once */
    pz_real retract_voltage_V;   /* where retracting ends */
    pz_real retract_step_V;      /* how far a retract goes; 0: to its end at once */
    pz_real approach_step_V;     /* extension in a sample while there is no current */
    pz_real approach_log_step;   /* then the reference's way to the set point in a sample */
    pz_real contact_log;         /* c: so far below the set point the current is there */
    pz_real stuck_current_A;     /* smaller currents are not watched for being stuck */
    pz_real search_voltage_V;    /* extension beyond the last contact; 0: to the drive's end */
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

/* Bits of the status words: events of a sample. 0: none. */
enum {
    PZ_STATUS_BAD_REFERENCE = 1,       /* NaN or infinite: the last one is used */
    PZ_STATUS_REFERENCE_LIMITED = 2,   /* outside its range, or faster than its step */
    PZ_STATUS_BAD_MEASUREMENT = 4,     /* NaN or infinite: X, Y use the model; Z holds */
    PZ_STATUS_MEASUREMENT_LIMITED = 8, /* outside its range */
    PZ_STATUS_STUCK_SENSOR = 16,       /* unchanged although the voltage changed */
    PZ_STATUS_VOLTAGE_LIMITED = 32,    /* a limit of the converter was reached */
    PZ_STATUS_VOLTAGE_STEP = 64,       /* voltage_step_V was reached */
    PZ_STATUS_CURRENT_LOST = 128,      /* Z: current below its floor */
    PZ_STATUS_RETRACTED = 256,         /* Z: retracted */
    PZ_STATUS_RESTARTED = 512,         /* a number overflowed: voltage held, memory set to rest */
    PZ_STATUS_NOT_STARTED = 1024,      /* pz_start was not called, or refused */
    PZ_STATUS_APPROACHING = 2048,      /* Z: extending slowly until current flows */
    PZ_STATUS_NO_CURRENT = 4096,       /* Z: no current up to the end of the search or drive */
    PZ_STATUS_WRONG_SIGN = 8192,       /* Z: the current has the wrong sign */
    PZ_STATUS_LATCHED = 16384,         /* waits for pz_reset; Z: the bits of the cause are set */
    PZ_STATUS_BLIND = 32768,           /* X, Y: held, no usable measurement for blind_samples */
    PZ_STATUS_UNCERTIFIED = 65536      /* X, Y: reference faster than the error bound allows */
};

/* State of one axis. Read its members, never write them. */
typedef struct {
    uint32_t ready;
    uint32_t status;      /* PZ_STATUS_... of the last sample */
    uint32_t status_ever; /* of all samples since pz_start */
    int32_t unchanged;    /* samples since the measurement last changed */
    int32_t unusable;     /* unusable measurements in a row */
    int32_t retract_left; /* Z: samples until the next approach */
    int32_t moved;        /* 1: the voltage has moved since the measurement last changed */
    int32_t mode;         /* 0: controls, 1: approaches, 2: waits for pz_reset */
    int32_t reset_wanted; /* 1: pz_reset was called */
    int32_t contact;      /* Z: samples at the set point in a row, at most contact_samples */
    int32_t trips;        /* Z: retracts in a row */
    int32_t trip_age;     /* Z: samples since the last, at most trip_samples */
    uint32_t cause;       /* Z: status bits of the last retract */

    pz_real voltage_V;     /* u_a: the last returned */
    pz_real command_V;     /* clipped, before rounding */
    pz_real reference_m;   /* after range and step */
    pz_real bias_m;        /* without feedback: zero shift that pz_start found */
    pz_real measured;      /* the last usable, m or A */
    pz_real moved_V;       /* voltage when the measurement last changed */
    pz_real gain_ratio;    /* Z: set by pz_schedule */
    pz_real disturbance_V; /* d */
    pz_real contact_V;     /* Z: voltage when the surface was last there */
    pz_real climb;         /* Z: of the logarithm of the reference, what is left; <= 0 */

    pz_real play_V[PZ_MAX_PLAYS];                  /* z_i, forward memory, of gamma(u) */
    pz_real relaxation_m[PZ_MAX_RELAXATIONS];      /* x_i of the creep block */
    pz_real relaxation_rest_m[PZ_MAX_RELAXATIONS]; /* below their last bit */
    pz_real reference_filter[PZ_MAX_SECTIONS][2];
    pz_real command_filter[PZ_MAX_SECTIONS][2];
    pz_real observer[PZ_MAX_ORDER];     /* x */
    pz_real rst_reference[PZ_MAX_TAPS]; /* ln(r / i_0), newest first, as all below */
    pz_real rst_measured[PZ_MAX_TAPS];  /* ln(i / i_0) */
    pz_real rst_change_V[PZ_MAX_TAPS];  /* u_a[k] - u_a[k-1], before rounding */
    pz_real rst_excess_V[PZ_MAX_TAPS];  /* u_a - u: what the limits took */
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

/* ---- background: any time, not from the interrupt ------------------------------------------ */

/* Description of the parameter with this index; NULL outside 1 .. PZ_PARAMETER_END - 1. The result
 * is static. */
const pz_field *pz_describe(int32_t index);

/* CRC-32 (IEEE 802.3) of all bytes behind the member `checksum`. Eight shifts for
 * each of the 3180 (float) or 6264 (double) bytes. */
uint32_t pz_checksum(const pz_parameters *parameters);

/* PZ_OK, or the index of the first invalid parameter: other schema or size, changed bytes, NaN,
 * out of bounds, a model without inverse, an unstable filter, an observer with inconsistent static
 * gains. The stability of the loop is not checked. Any bytes may be passed. Cost: pz_checksum, and
 * one pass over all members. */
int32_t pz_check(const pz_parameters *parameters);

/* Set `state` to rest so that the next step with reference == measured returns voltage_V (clipped
 * and rounded as by the converter). Calls pz_check first and returns its result; after a refusal
 * pz_step returns the voltage nearest 0 inside the limits and sets NOT_STARTED.
 * Creep is assumed to be at rest. The memory of the hysteresis is set so that the model agrees
 * with the reading, as if the stage had come straight from one extreme voltage within the limits.
 * A reading that no extreme explains is treated as a shift of the sensor's zero; without feedback
 * (none, mpi) references are relative to it.
 *   voltage_V  V       present output of the converter; not finite: nearest 0 inside the limits
 *   measured   m or A  present reading; not finite: the reading that the model predicts */
int32_t pz_start(pz_state *state, const pz_parameters *parameters, pz_real voltage_V,
                 pz_real measured);

/* Z: the gain of the plant is now `ratio` times that of the design; the gain of the controller is
 * divided by it, without a step. Limited by schedule_limit; not finite: ignored. */
void pz_schedule(pz_state *state, const pz_parameters *parameters, pz_real ratio);

/* Continue after a latched fault, from the next step on. Z approaches again from where it was
 * retracted, up to the end of the drive. X, Y start without a step at the held voltage and the
 * present reading. Clears the count of retracts. One write; may be called at any time. */
void pz_reset(pz_state *state);

/* ---- real time: from the interrupt, once per sample ---------------------------------------- */

/* One sample: return the voltage for the converter. It is finite and inside the limits for any
 * input; state->status states why it differs from the requested one.
 *   reference  m  X, Y: position wanted preview_samples later.  A  Z: wanted current
 *   measured   m  X, Y: displacement.         A  Z: current, positive for the bias in use
 *   returned   V
 * Cost: linear in plays + knots + taps + (order + 1)^2; the data affect early exits only. */
pz_real pz_step(pz_state *state, const pz_parameters *parameters, pz_real reference,
                pz_real measured);

/* pz_step with a feedforward voltage for periodic motion, added behind the inverse and before the
 * limits, so that memory and observer follow the applied voltage.
 *   feedforward_V  V  for this point of the period; 0: pz_step, bit for bit. Not finite: counts as
 *                     0 and sets BAD_REFERENCE. Z: not used */
pz_real pz_step_feedforward(pz_state *state, const pz_parameters *parameters, pz_real reference,
                            pz_real measured, pz_real feedforward_V);

/* Natural logarithm of a positive number in [2^-120, 2^120], without the mathematical library.
 * Error below 1 unit in the last place of max(|ln x|, 1/2). */
pz_real pz_log(pz_real x);

#ifdef __cplusplus
}
#endif

#endif
