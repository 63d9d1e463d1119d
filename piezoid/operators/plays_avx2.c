#include "plays_avx2.h"

#if PK_AVX2

#include <immintrin.h>
#include <string.h>

#define VECTORS 4
#define LANES (4 * VECTORS)
/* Samples of a sum: the states of all lanes fit into the first cache. */
#define CHUNK 128
#define GROUP 8
#define AVX2 __attribute__((target("avx2")))
#define INLINED static inline __attribute__((always_inline)) AVX2

int pk_has_avx2(void) {
    return __builtin_cpu_supports("avx2") != 0;
}

INLINED __m256d play_step(__m256d z, __m256d u, __m256d r) {
    return _mm256_min_pd(_mm256_max_pd(z, _mm256_sub_pd(u, r)), _mm256_add_pd(u, r));
}

/* Four plays over four samples: return their last states; of_play gets the four states of each. */
INLINED __m256d four_by_four(const double *input_V, __m256d r, __m256d z, __m256d of_play[4]) {
    const __m256d a = play_step(z, _mm256_broadcast_sd(input_V), r);
    const __m256d b = play_step(a, _mm256_broadcast_sd(input_V + 1), r);
    const __m256d c = play_step(b, _mm256_broadcast_sd(input_V + 2), r);
    const __m256d d = play_step(c, _mm256_broadcast_sd(input_V + 3), r);
    const __m256d ab_even = _mm256_unpacklo_pd(a, b), ab_odd = _mm256_unpackhi_pd(a, b);
    const __m256d cd_even = _mm256_unpacklo_pd(c, d), cd_odd = _mm256_unpackhi_pd(c, d);
    of_play[0] = _mm256_permute2f128_pd(ab_even, cd_even, 0x20);
    of_play[1] = _mm256_permute2f128_pd(ab_odd, cd_odd, 0x20);
    of_play[2] = _mm256_permute2f128_pd(ab_even, cd_even, 0x31);
    of_play[3] = _mm256_permute2f128_pd(ab_odd, cd_odd, 0x31);
    return d;
}

/* Compute some vectors of plays, each play into its column; samples is a multiple of four. */
INLINED void run_of_lanes(int vectors, size_t samples, const double *input_V,
                          const double *threshold_V, double *state_V, double *const *column_V) {
    __m256d z[VECTORS], r[VECTORS];
    for (int v = 0; v < vectors; ++v) {
        z[v] = _mm256_loadu_pd(state_V + 4 * v);
        r[v] = _mm256_loadu_pd(threshold_V + 4 * v);
    }
    for (size_t k = 0; k < samples; k += 4) {
        for (int v = 0; v < vectors; ++v) {
            __m256d of_play[4];
            z[v] = four_by_four(input_V + k, r[v], z[v], of_play);
            for (int i = 0; i < 4; ++i) {
                _mm256_storeu_pd(column_V[4 * v + i] + k, of_play[i]);
            }
        }
    }
    for (int v = 0; v < vectors; ++v) {
        _mm256_storeu_pd(state_V + 4 * v, z[v]);
    }
}

static inline double clamp(double value, double low, double high) {
    const double raised = value > low ? value : low;
    return raised < high ? raised : high;
}

/* Compute one play over the samples behind the last multiple of four. */
static void remaining_samples(size_t from, size_t samples, const double *input_V, double r,
                              double *z, double *column_V) {
    for (size_t k = from; k < samples; ++k) {
        column_V[k] = *z = clamp(*z, input_V[k] - r, input_V[k] + r);
    }
}

AVX2 void pk_play_columns_avx2(size_t samples, const double *input_V, size_t plays,
                               const double *threshold_V, double *state_V, size_t stride,
                               double *column_V) {
    const size_t fours = samples & ~(size_t)3;
    for (size_t first = 0; first < plays; first += LANES) {
        const size_t group = plays - first < LANES ? plays - first : LANES;
        double threshold[LANES], state[LANES], *column[LANES];
        for (size_t i = 0; i < LANES; ++i) {
            /* Lanes without a play repeat the last one, into the same column. */
            const size_t play = first + (i < group ? i : group - 1);
            threshold[i] = threshold_V[play];
            state[i] = state_V[play];
            column[i] = column_V + play * stride;
        }
        switch ((group + 3) / 4) {
        case 1:
            run_of_lanes(1, fours, input_V, threshold, state, column);
            break;
        case 2:
            run_of_lanes(2, fours, input_V, threshold, state, column);
            break;
        case 3:
            run_of_lanes(3, fours, input_V, threshold, state, column);
            break;
        default:
            run_of_lanes(VECTORS, fours, input_V, threshold, state, column);
        }
        for (size_t i = 0; i < group; ++i) {
            remaining_samples(fours, samples, input_V, threshold[i], state + i, column[i]);
        }
        memcpy(state_V + first, state, group * sizeof(double));
    }
}

/* Add the weighted states of eight plays to the sums, play after play; samples is a multiple of
 * four. */
AVX2 static void add_eight_plays(size_t samples, const double *input_V, const double *threshold_V,
                                 const double *weight, double *state_V, double *sum) {
    __m256d z[2], r[2];
    for (int v = 0; v < 2; ++v) {
        z[v] = _mm256_loadu_pd(state_V + 4 * v);
        r[v] = _mm256_loadu_pd(threshold_V + 4 * v);
    }
    for (size_t k = 0; k < samples; k += 4) {
        __m256d total = _mm256_loadu_pd(sum + k);
        for (int v = 0; v < 2; ++v) {
            __m256d of_play[4];
            z[v] = four_by_four(input_V + k, r[v], z[v], of_play);
            for (int i = 0; i < 4; ++i) {
                const __m256d w = _mm256_broadcast_sd(weight + 4 * v + i);
                total = _mm256_add_pd(total, _mm256_mul_pd(w, of_play[i]));
            }
        }
        _mm256_storeu_pd(sum + k, total);
    }
    for (int v = 0; v < 2; ++v) {
        _mm256_storeu_pd(state_V + 4 * v, z[v]);
    }
}

/* Add the weighted states of up to eight plays to the sums, over any samples of a chunk. */
AVX2 static void add_plays(size_t samples, const double *input_V, size_t plays,
                           const double *threshold_V, const double *weight, double *state_V,
                           double *sum) {
    double states[GROUP * CHUNK];
    pk_play_columns_avx2(samples, input_V, plays, threshold_V, state_V, CHUNK, states);
    for (size_t i = 0; i < plays; ++i) {
        for (size_t k = 0; k < samples; ++k) {
            sum[k] += weight[i] * states[i * CHUNK + k];
        }
    }
}

AVX2 void pk_play_sum_avx2(size_t samples, const double *input_V, size_t plays,
                           const double *threshold_V, const double *weight, double *state_V,
                           double *output) {
    for (size_t start = 0; start < samples; start += CHUNK) {
        const size_t count = samples - start < CHUNK ? samples - start : CHUNK;
        const double *input = input_V + start;
        double sum[CHUNK] = {0.0};
        size_t i = 0;
        if (plays > 0 && threshold_V[0] <= 0.0) {
            /* The state of a play of threshold 0 is its input, with positive zeros. */
            for (size_t k = 0; k < count; ++k) {
                sum[k] += weight[0] * (input[k] + 0.0);
            }
            state_V[0] = input[count - 1] + 0.0;
            i = 1;
        }
        for (; i < plays; i += GROUP) {
            const size_t group = plays - i < GROUP ? plays - i : GROUP;
            if (group == GROUP && count == CHUNK) {
                add_eight_plays(count, input, threshold_V + i, weight + i, state_V + i, sum);
            } else {
                add_plays(count, input, group, threshold_V + i, weight + i, state_V + i, sum);
            }
        }
        memcpy(output + start, sum, count * sizeof(double));
    }
}

#endif
