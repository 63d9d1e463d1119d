/* piezoid runtime: the controller of one axis of a piezo stage. Two files; nothing to configure.
 *
 * The loop, once per sample (X and Y; quantities relative to their offsets, displacements times
 * the polarity):
 *
 *     nu = y - C x,   x = x + L nu,   d = d + L_d nu                 correct      (observer)
 *     v  = N r - K x - d                                             feedback     [V, linearised]
 *     u  = Gamma^-1[a v - creep]      or  (a v - creep) / a          inverse      [V]
 *     u  = u + f                                                     feedforward, where given
 *     u_a = lsb round(clip(u) / lsb)                                 converter    [V]
 *     v_a = (Gamma[u_a] + creep) / a  or  u_a + creep / a            really applied, linearised
 *     x = A x + B (v_a + d)                                          predict      (observer)
 *
 * Gamma = Psi o H o gamma is the Modified Prandtl-Ishlinskii model (Kuhnen 2003): weighted plays
 * H, then one-sided dead zones Psi; an envelope gamma in front of the plays where the model has
 * one (Al Janaideh, Rakheja & Su 2011). Its inverse is solved from the forward memory, which
 * follows the voltage really applied; there is no second memory that rounding or clipping could
 * lead astray. creep = sum_i c_i x_i,  x_i = x_i + rate_i (Gamma[u_a] - x_i).
 *
 * Z, on the logarithm of the tunnelling current (Landau's letters: R acts on the measurement, S
 * on the output; Longchamp exchanges them; polynomials in q^-1, S and A_0 monic):
 *
 *     (1 - q^-1) S u = T ln(r / i_0) - R ln(max(i, i_floor) / i_0)
 *     and while the converter limits u: (1 - q^-1) S u_a + A_0 (u - u_a) = the same right side
 *
 * That equation holds near the set point only. While i < r exp(-c), c = contact_log, or after it
 * fell below r exp(-2 c), the tip approaches: u = u + approach_step_V, nothing is integrated. When
 * the current is there, the equation starts from rest at what it shows, and its reference climbs
 * by approach_log_step to r. Whatever cannot be believed retracts the tip; trip_limit retracts,
 * each within trip_samples of the last and twice as long, wait for pz_reset.
 *
 * Floating point: one type, pz_real: double, or float when PZ_REAL_FLOAT is defined. No call of
 * the mathematical library, no contraction needed: with -ffp-contract=off every IEEE machine gives
 * the same bits. Never compile this with -ffast-math (refused below).
 *
 * Ownership: the caller owns both structures; nothing is allocated, kept or printed here. Any
 * number of axes may run at the same time, each with its own state; parameters may be in ROM.
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

/* Constant while the loop runs. Unused places hold 0. Order and sizes are the schema's. */
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
    int32_t preview_samples;         /* the reference given is that of so many samples ahead */
    int32_t stuck_samples;           /* equal measurements that mean a stuck sensor; 0: off */
    int32_t blind_samples;           /* X, Y: unusable measurements in a row to fly on; 0: any */
    int32_t bad_samples;             /* Z: unusable currents in a row that mean retract */
    int32_t retract_samples;         /* Z: samples of a first retract; each in a row doubles */
    int32_t contact_samples;         /* Z: samples at the set point that make a contact */
    int32_t trip_limit;              /* Z: retracts that wait for pz_reset; 0: none does */
    int32_t trip_samples;            /* Z: a retract later than this counts as the first */
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

/* Schema index of every parameter, what pz_check answers with. */
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

/* Bits of the status words: what happened in a sample. 0: nothing. */
enum {
    PZ_STATUS_BAD_REFERENCE = 1,       /* NaN or infinite: the last one was kept */
    PZ_STATUS_REFERENCE_LIMITED = 2,   /* outside its range, or faster than its step */
    PZ_STATUS_BAD_MEASUREMENT = 4,     /* NaN or infinite: X, Y go on by the model; Z holds */
    PZ_STATUS_MEASUREMENT_LIMITED = 8, /* outside its range */
    PZ_STATUS_STUCK_SENSOR = 16,       /* unchanged although the voltage moved */
    PZ_STATUS_VOLTAGE_LIMITED = 32,    /* the converter's end was reached */
    PZ_STATUS_VOLTAGE_STEP = 64,       /* voltage_step_V was reached */
    PZ_STATUS_CURRENT_LOST = 128,      /* Z: current below its floor */
    PZ_STATUS_RETRACTED = 256,         /* Z: retracted */
    PZ_STATUS_RESTARTED = 512,         /* a number overflowed: voltage held, memory set to rest */
    PZ_STATUS_NOT_STARTED = 1024,      /* pz_start was not called, or refused */
    PZ_STATUS_APPROACHING = 2048,      /* Z: extending slowly until the current is there */
    PZ_STATUS_NO_CURRENT = 4096,       /* Z: none where the search or the drive ends */
    PZ_STATUS_WRONG_SIGN = 8192,       /* Z: the current flows the wrong way */
    PZ_STATUS_LATCHED = 16384,         /* waits for pz_reset; Z: the bits of the cause are set */
    PZ_STATUS_BLIND = 32768,           /* X, Y: held, no usable measurement for blind_samples */
    PZ_STATUS_UNCERTIFIED = 65536      /* X, Y: the reference is faster than its error bound's */
};

/* Everything that changes from one sample to the next. One per axis. Read it, never write it. */
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
    pz_real bias_m;        /* without feedback: what start found between model and stage */
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

/* What is known of a parameter; the same table as in the schema. */
typedef struct {
    const char *name;
    size_t offset_bytes;
    size_t count;    /* elements */
    int32_t is_real; /* 1: pz_real, 0: 32-bit integer */
    pz_real lower;   /* every element lies in [lower, upper] */
    pz_real upper;
} pz_field;

/* ---- background: any time, not from the interrupt ------------------------------------------ */

/* What is known of the parameter with this schema index; NULL outside 1 .. PZ_PARAMETER_END - 1.
 * The answer lives as long as the program. */
const pz_field *pz_describe(int32_t index);

/* CRC-32 (IEEE 802.3) of all bytes behind the member `checksum`. Eight shifts for
 * each of the 3180 (float) or 6264 (double) bytes. */
uint32_t pz_checksum(const pz_parameters *parameters);

/* PZ_OK, or the schema index of the first unusable parameter: other schema or size, changed bytes,
 * NaN, out of bounds, a model without inverse, an unstable filter, an observer whose static gains
 * disagree. That the loop is stable is the design's promise, not checked here. Any bytes may be
 * given. Cost: the checksum's, and all members once. */
int32_t pz_check(const pz_parameters *parameters);

/* Set `state` to rest so that the next step with reference == measured returns voltage_V (clipped
 * and rounded as the converter does). Checks first and answers as pz_check; a refused state makes
 * pz_step return the voltage nearest 0 inside the limits, and say NOT_STARTED.
 * Creep counts as having come to rest. The memory of the hysteresis is set so that the model rests
 * where the sensor shows: as if the stage had come straight from the one extreme, within the
 * limits of the voltage, that explains it. What no extreme explains is taken for a shift of the
 * sensor's zero: without feedback (none, mpi) references count from it. With NaN for `measured`
 * memory and references are the model's own.
 *   voltage_V  V       what the converter puts out now; not finite: nearest 0 inside the limits
 *   measured   m or A  what the sensor shows now; not finite: what the model says */
int32_t pz_start(pz_state *state, const pz_parameters *parameters, pz_real voltage_V,
                 pz_real measured);

/* Z: the plant's gain is now `ratio` times the one designed for; the controller's is divided by
 * it, without a bump. Kept inside the schedule limit; not finite: ignored. */
void pz_schedule(pz_state *state, const pz_parameters *parameters, pz_real ratio);

/* An operator has looked: what latched may go on with the next step. Z approaches from where it
 * was retracted to, as far as the drive reaches. X, Y start bumpless at the voltage held, from
 * what the sensor shows then. Also forgets retracts that are counted. One write, any time. */
void pz_reset(pz_state *state);

/* ---- real time: from the interrupt, once per sample ---------------------------------------- */

/* One sample: the voltage to put out now. Always finite and inside the limits, whatever comes in;
 * state->status says why when it is not what was asked for.
 *   reference  m  X, Y: wanted displacement.  A  Z: wanted current
 *   measured   m  X, Y: displacement.         A  Z: current, positive for the bias in use
 *   returned   V
 * Cost: linear in plays + knots + taps + (order + 1)^2; no loop depends on the data's values
 * except early exits. */
pz_real pz_step(pz_state *state, const pz_parameters *parameters, pz_real reference,
                pz_real measured);

/* The same with a table's value on top, for periodic motion: added to the voltage behind the
 * inverse and before the limits, so that memory and observer know what is really applied.
 *   feedforward_V  V  of this point of the period; 0 is pz_step, bit for bit. Not finite: counts
 *                     as 0, and the status says BAD_REFERENCE. Z: not used */
pz_real pz_step_feedforward(pz_state *state, const pz_parameters *parameters, pz_real reference,
                            pz_real measured, pz_real feedforward_V);

/* Natural logarithm of a positive number in [2^-120, 2^120], without the mathematical library.
 * Error below 1 unit in the last place of max(|ln x|, 1/2). */
pz_real pz_log(pz_real x);

#ifdef __cplusplus
}
#endif

#endif
