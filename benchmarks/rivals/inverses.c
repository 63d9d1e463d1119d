/* Two hysteresis models without plays and their inverses, sample by sample.
 *
 * Preisach by table: T(a, b) is the increment of a rise from b to a, on a square grid of fields
 * with linear interpolation. The memory is the stack of turning points that are not wiped out
 * [Mayergoyz 1991]. The output of a branch is monotone, so the inverse steps over the nodes of the
 * branch and interpolates in the last interval.
 *
 * Bouc-Wen, inverse multiplicative: y = c + d u - h, so that u = (y - c + h) / d with the h of the
 * previous sample, and h follows u [Rakotondrabe 2011]. No inversion is needed.
 */
#include <math.h>
#include <stddef.h>
#include <stdint.h>

#ifdef SINGLE
typedef float real;
#define ABS fabsf
#define POW powf
#else
typedef double real;
#define ABS fabs
#define POW pow
#endif

#define NODES 21
#define DEEPEST 64

typedef struct {
    real table[NODES][NODES]; /* [a][b], 0 where a <= b */
    real low, step;           /* field of node 0, and between nodes */
} preisach;

typedef struct {
    int32_t depth; /* turning points on the stack; the first is the lower end of the range */
    int32_t rises; /* whether the field increased last */
    real field, output;
    real turn[DEEPEST], at[DEEPEST];
} preisach_state;

typedef struct {
    real c, d, gamma, beta, exponent, share;
} bouc_wen;

typedef struct {
    real field, z;
} bouc_wen_state;

void preisach_start(preisach_state *s, const preisach *p, real output);
real preisach_forward(preisach_state *s, const preisach *p, real field);
real preisach_inverse(preisach_state *s, const preisach *p, real displacement);
real bouc_wen_forward(bouc_wen_state *s, const bouc_wen *p, real field);
real bouc_wen_inverse(bouc_wen_state *s, const bouc_wen *p, real displacement);

static int32_t cell_of(const preisach *p, real field) {
    const int32_t i = (int32_t)((field - p->low) / p->step);
    return i < 0 ? 0 : (i > NODES - 2 ? NODES - 2 : i);
}

/* Increment of a rise; bilinear, or linear in the difference in a cell of the diagonal. */
static real increment(const preisach *p, real high, real low) {
    if (!(high > low)) {
        return 0;
    }
    const int32_t i = cell_of(p, high), j = cell_of(p, low);
    if (i == j) {
        return p->table[i + 1][i] * (high - low) / p->step;
    }
    const real x = (high - p->low) / p->step - (real)i, y = (low - p->low) / p->step - (real)j;
    const real below = p->table[i][j] + y * (p->table[i][j + 1] - p->table[i][j]);
    const real above = p->table[i + 1][j] + y * (p->table[i + 1][j + 1] - p->table[i + 1][j]);
    return below + x * (above - below);
}

void preisach_start(preisach_state *s, const preisach *p, real output) {
    s->depth = 1;
    s->rises = 1;
    s->turn[0] = s->field = p->low;
    s->at[0] = s->output = output;
}

/* Store the turning point if the direction changes. */
static void start_branch(preisach_state *s, int32_t rises) {
    if (rises != s->rises) {
        if (s->depth == DEEPEST) { /* drop the smallest loop */
            s->depth -= 2;
        }
        s->turn[s->depth] = s->field;
        s->at[s->depth] = s->output;
        s->depth += 1;
        s->rises = rises;
    }
}

static real branch_output(const preisach *p, const preisach_state *s, real field) {
    const real from = s->turn[s->depth - 1], base = s->at[s->depth - 1];
    return s->rises ? base + increment(p, field, from) : base - increment(p, from, field);
}

real preisach_forward(preisach_state *s, const preisach *p, real field) {
    if (field == s->field) {
        return s->output;
    }
    start_branch(s, field > s->field);
    while (s->depth > 1 &&
           (s->rises ? field >= s->turn[s->depth - 2] : field <= s->turn[s->depth - 2])) {
        s->depth = s->depth > 2 ? s->depth - 2 : 1;
        if (s->depth == 1) { /* beyond all turning points: the major loop, from its other end */
            break;
        }
    }
    s->field = field;
    s->output = branch_output(p, s, field);
    return s->output;
}

real preisach_inverse(preisach_state *s, const preisach *p, real displacement) {
    if (displacement == s->output) {
        return s->field;
    }
    const int32_t rises = displacement > s->output;
    start_branch(s, rises);
    while (s->depth > 2 &&
           (rises ? displacement >= s->at[s->depth - 2] : displacement <= s->at[s->depth - 2])) {
        s->field = s->turn[s->depth - 2];
        s->output = s->at[s->depth - 2];
        s->depth -= 2;
    }
    const real end = rises ? p->low + p->step * (real)(NODES - 1) : p->low;
    int32_t node = cell_of(p, s->field) + (rises ? 1 : 0);
    real from = s->field, previous = s->output;
    for (;;) {
        const real to = p->low + p->step * (real)node;
        const real next = branch_output(p, s, to);
        if ((rises ? next >= displacement : next <= displacement) || to == end) {
            const real share =
                next == previous ? 1 : (displacement - previous) / (next - previous);
            s->field = from + (to - from) * (share > 1 ? 1 : share);
            s->output = branch_output(p, s, s->field);
            return s->field;
        }
        from = to;
        previous = next;
        node += rises ? 1 : -1;
    }
}

static void follow(bouc_wen_state *s, const bouc_wen *p, real field) {
    const real du = field - s->field;
    const real loading = s->z * du >= 0 ? 1 : -1;
    s->z += du * (1 - POW(ABS(s->z), p->exponent) * (p->gamma + p->beta * loading));
    s->field = field;
}

real bouc_wen_forward(bouc_wen_state *s, const bouc_wen *p, real field) {
    follow(s, p, field);
    return p->c + p->d * field - p->share * s->z;
}

real bouc_wen_inverse(bouc_wen_state *s, const bouc_wen *p, real displacement) {
    follow(s, p, (displacement - p->c + p->share * s->z) / p->d);
    return s->field;
}

#ifdef BOARD
#include <stdio.h>

#include "numbers.h"
uint32_t board_instructions(void);

int main(void) {
    preisach_state s;
    bouc_wen_state b = {0, 0};
    uint32_t instructions[2] = {0, 0};
    volatile real result = 0;
    preisach_start(&s, &table, start);
    for (size_t k = 0; k < sizeof path / sizeof path[0]; ++k) {
        const uint32_t first = board_instructions();
        result = preisach_inverse(&s, &table, path[k]);
        const uint32_t second = board_instructions();
        result = bouc_wen_inverse(&b, &state, path[k]);
        const uint32_t third = board_instructions();
        const uint32_t counting = board_instructions() - third;
        instructions[0] += second - first - counting;
        instructions[1] += third - second - counting;
    }
    printf("%lu %lu\n", (unsigned long)instructions[0], (unsigned long)instructions[1]);
    return result > 1e30f;
}
#endif
