/* Plays with AVX2, 16 at a time. The results equal those of kernels.c, bit for bit.
 *
 * Nothing is fused, and the order of sums is the same; minimum and maximum are those of
 * `a < b ? a : b` and `a > b ? a : b`, also for zeros of both signs and NaN.
 * PK_PORTABLE disables these functions, for comparisons.
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

/* Return whether the processor supports AVX2. */
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
