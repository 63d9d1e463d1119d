/* Second-order sections as the boxes compute them, called once a reading by the plant's loop.
 * Python lays the structures out again: section_boxes.py. */

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#define MOST_SECTIONS 14

enum { SINGLE = 0, PARALLEL = 1, CASCADE = 2 };

typedef struct {
    int64_t kind;
    int64_t sections;
    int64_t repeats; /* computations with the same reading */
    double coefficient[MOST_SECTIONS]
                      [5]; /* b0 b1 b2 a1 a2, y = b x + a y, as the box holds them */
    double input_step_m;
    double input_most; /* codes */
    double output_middle_V;
    double output_step_V;
    double output_least; /* codes */
    double output_most;
} sb_box;

typedef struct {
    uint32_t ready;
    uint32_t status;
    float single[MOST_SECTIONS][4]; /* x1 x2 y1 y2 */
    int64_t whole[MOST_SECTIONS][4];
} sb_state;

static double limited(double x, double least, double most) {
    return fmax(least, fmin(most, x));
}

static int64_t saturated(int64_t x, int bits) {
    const int64_t most = ((int64_t)1 << (bits - 1)) - 1;
    return x > most ? most : (x < -most - 1 ? -most - 1 : x);
}

/* x 2^-shift towards minus infinity, which C leaves open for >> of a negative number. */
static int64_t floored(int64_t x, int shift) {
    const int64_t unit = (int64_t)1 << shift;
    return x >= 0 ? x / unit : -((unit - 1 - x) / unit);
}

/* Direct form 1 in single precision, each section clamped before it is remembered; the last has
 * the limits of the output. The code is truncated towards 0. */
static double in_single(const sb_box *box, sb_state *state, double code) {
    float x = (float)code;
    for (int64_t i = 0; i < box->sections; ++i) {
        const double *c = box->coefficient[i];
        float *past = state->single[i];
        float y = (float)c[0] * x;
        y = y + (float)c[1] * past[0];
        y = y + (float)c[2] * past[1];
        y = y + (float)c[3] * past[2];
        y = y + (float)c[4] * past[3];
        const int is_last = i + 1 == box->sections;
        const float least = is_last ? (float)box->output_least : -32767.0F;
        const float most = is_last ? (float)box->output_most : 32767.0F;
        y = y < least ? least : (y > most ? most : y);
        past[1] = past[0];
        past[0] = x;
        past[3] = past[2];
        past[2] = y;
        x = y;
    }
    return trunc((double)x);
}

/* Sections side by side, 32 bits; coefficients with 29 bits behind the point, every product
 * rounded half up and saturated; signals with 17 bits behind the code's. */
static double in_parallel(const sb_box *box, sb_state *state, double code) {
    const int64_t x = (int64_t)code * 131072;
    int64_t sum = 0;
    for (int64_t i = 0; i < box->sections; ++i) {
        const double *c = box->coefficient[i];
        int64_t *past = state->whole[i];
        const int64_t factor[4] = {x, past[0], past[2], past[3]};
        const int64_t by[4] = {(int64_t)c[0], (int64_t)c[1], (int64_t)c[3], (int64_t)c[4]};
        int64_t y = 0;
        for (int k = 0; k < 4; ++k) {
            y += saturated(floored(factor[k] * by[k] + ((int64_t)1 << 28), 29), 32);
        }
        y = saturated(y, 32);
        past[0] = x;
        past[3] = past[2];
        past[2] = y;
        sum += y;
    }
    return (double)saturated(floored(sum, 17), 14);
}

/* Sections one behind the other, signals of 25 bits, 11 of them behind the code's; coefficients
 * with 16 bits behind the point. What is beyond 25 bits keeps the last output. */
static double in_cascade(const sb_box *box, sb_state *state, double code) {
    int64_t x = (int64_t)code * 2048;
    for (int64_t i = 0; i < box->sections; ++i) {
        const double *c = box->coefficient[i];
        int64_t *past = state->whole[i];
        int64_t sum = (int64_t)c[0] * x + (int64_t)c[1] * past[0] + (int64_t)c[2] * past[1];
        sum += (int64_t)c[3] * past[2] + (int64_t)c[4] * past[3];
        int64_t y = floored(sum, 16);
        y = y == saturated(y, 25) ? y : past[2];
        past[1] = past[0];
        past[0] = x;
        past[3] = past[2];
        past[2] = y;
        x = y;
    }
    return (double)floored(x, 11);
}

/* One reading: the difference is formed in front of the box's converter. */
double sb_step(sb_state *state, const sb_box *box, double reference_m, double measured_m) {
    const double asked = nearbyint((reference_m - measured_m) / box->input_step_m);
    const double code = limited(asked, -box->input_most - 1.0, box->input_most);
    double out = 0.0;
    for (int64_t k = 0; k < box->repeats; ++k) {
        out = box->kind == SINGLE     ? in_single(box, state, code)
              : box->kind == PARALLEL ? in_parallel(box, state, code)
                                      : in_cascade(box, state, code);
    }
    const double kept = limited(out, box->output_least, box->output_most);
    return box->output_middle_V + box->output_step_V * kept;
}
