/* Where the processor has AVX2: 16 plays side by side. The same numbers, bit for bit.
 *
 * Nothing is fused and nothing is added in another order; minimum and maximum are those of
 * `a < b ? a : b` and `a > b ? a : b`, for zeros of both signs and for no number as well.
 * PK_PORTABLE leaves both out, for whoever wants to compare.
 */
#ifndef PIEZOID_PLAYS_AVX2_H
#define PIEZOID_PLAYS_AVX2_H

#include <stddef.h>

#if defined(__x86_64__) && defined(__GNUC__) && !defined(PK_PORTABLE)
#define PK_AVX2 1
#else
#define PK_AVX2 0
#endif

#if PK_AVX2

/* Whether this processor has it. */
int pk_has_avx2(void);

/* As pk_play_columns. */
void pk_play_columns_avx2(size_t samples, const double *input_V, size_t plays,
                          const double *threshold_V, double *state_V, size_t stride,
                          double *column_V);

/* As pk_play_sum. */
void pk_play_sum_avx2(size_t samples, const double *input_V, size_t plays,
                      const double *threshold_V, const double *weight, double *state_V,
                      double *output);

#endif

#endif
