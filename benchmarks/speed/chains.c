#include <stddef.h>

#define PLAYS 16

/* What a bank of plays cannot go below: a maximum and a minimum that wait for those of the sample
 * before, for 16 plays in registers. Nothing is stored but the last states. */
void chains(size_t samples, const double *input, const double *threshold, double *state) {
    double z[PLAYS];
    for (size_t i = 0; i < PLAYS; ++i) {
        z[i] = state[i];
    }
    for (size_t k = 0; k < samples; ++k) {
        const double u = input[k];
        /* Unrolled first, the loop is no longer seen to be four vectors: four times slower. */
#pragma GCC unroll 1
        for (size_t i = 0; i < PLAYS; ++i) {
            const double low = u - threshold[i];
            const double high = u + threshold[i];
            const double raised = z[i] > low ? z[i] : low;
            z[i] = raised < high ? raised : high;
        }
    }
    for (size_t i = 0; i < PLAYS; ++i) {
        state[i] = z[i];
    }
}
