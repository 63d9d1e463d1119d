/* Inverses of two hysteresis models that are no play sums, a sample at a time.
 *
 * Preisach by table: T(a, b) is what a rise from b to a adds, on a square grid of fields and linear
 * between its nodes; the memory is the stack of turning points that nothing has wiped out
 * [Mayergoyz 1991]. Along a branch the output rises with the field, so that the inverse walks the
 * nodes of the branch and solves the last stretch.
 *
 * Bouc-Wen, inverse multiplicative: y = c + d u - h, so that u = (y - c + h) / d with the h of the
 * sample before, and h follows u [Rakotondrabe 2011]. Nothing is inverted.
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
    int32_t rises; /* whether the field went up last */
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
real preisach_inverse(preisach_state *s, const preisach *p, real wanted);
real bouc_wen_forward(bouc_wen_state *s, const bouc_wen *p, real field);
real bouc_wen_inverse(bouc_wen_state *s, const bouc_wen *p, real wanted);

static int32_t cell_of(const preisach *p, real field) {
    const int32_t i = (int32_t)((field - p->low) / p->step);
    return i < 0 ? 0 : (i > NODES - 2 ? NODES - 2 : i);
}

/* Linear in each field; in a cell of the diagonal, in their difference. */
static real added(const preisach *p, real high, real low) {
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

/* Where the way back begins. */
static void turned(preisach_state *s, int32_t rises) {
    if (rises != s->rises) {
        if (s->depth == DEEPEST) { /* the smallest loop of all is forgotten */
            s->depth -= 2;
        }
        s->turn[s->depth] = s->field;
        s->at[s->depth] = s->output;
        s->depth += 1;
        s->rises = rises;
    }
}

static real along(const preisach *p, const preisach_state *s, real field) {
    const real from = s->turn[s->depth - 1], base = s->at[s->depth - 1];
    return s->rises ? base + added(p, field, from) : base - added(p, from, field);
}

real preisach_forward(preisach_state *s, const preisach *p, real field) {
    if (field == s->field) {
        return s->output;
    }
    turned(s, field > s->field);
    while (s->depth > 1 && (s->rises ? field >= s->turn[s->depth - 2]
                                     : field <= s->turn[s->depth - 2])) {
        s->depth = s->depth > 2 ? s->depth - 2 : 1;
        if (s->depth == 1) { /* beyond every turning point: the major loop, from its other end */
            break;
        }
    }
    s->field = field;
    s->output = along(p, s, field);
    return s->output;
}

real preisach_inverse(preisach_state *s, const preisach *p, real wanted) {
    if (wanted == s->output) {
        return s->field;
    }
    const int32_t rises = wanted > s->output;
    turned(s, rises);
    while (s->depth > 2 &&
           (rises ? wanted >= s->at[s->depth - 2] : wanted <= s->at[s->depth - 2])) {
        s->field = s->turn[s->depth - 2];
        s->output = s->at[s->depth - 2];
        s->depth -= 2;
    }
    const real end = rises ? p->low + p->step * (real)(NODES - 1) : p->low;
    int32_t node = cell_of(p, s->field) + (rises ? 1 : 0);
    real from = s->field, left = s->output;
    for (;;) {
        const real to = p->low + p->step * (real)node;
        const real there = along(p, s, to);
        if ((rises ? there >= wanted : there <= wanted) || to == end) {
            const real share = there == left ? 1 : (wanted - left) / (there - left);
            s->field = from + (to - from) * (share > 1 ? 1 : share);
            s->output = along(p, s, s->field);
            return s->field;
        }
        from = to;
        left = there;
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

real bouc_wen_inverse(bouc_wen_state *s, const bouc_wen *p, real wanted) {
    follow(s, p, (wanted - p->c + p->share * s->z) / p->d);
    return s->field;
}

#ifdef BOARD
#include <stdio.h>

#include "numbers.h"
uint32_t board_instructions(void);

int main(void) {
    preisach_state s;
    bouc_wen_state b = {0, 0};
    uint32_t spent[2] = {0, 0};
    volatile real kept = 0;
    preisach_start(&s, &table, start);
    for (size_t k = 0; k < sizeof wanted / sizeof wanted[0]; ++k) {
        const uint32_t first = board_instructions();
        kept = preisach_inverse(&s, &table, wanted[k]);
        const uint32_t second = board_instructions();
        kept = bouc_wen_inverse(&b, &state, wanted[k]);
        const uint32_t third = board_instructions();
        const uint32_t counting = board_instructions() - third;
        spent[0] += second - first - counting;
        spent[1] += third - second - counting;
    }
    printf("%lu %lu\n", (unsigned long)spent[0], (unsigned long)spent[1]);
    return kept > 1e30f;
}
#endif
