/* Test of a build: steps the controllers of the bundle through golden.csv and compares the
 * outputs. README.md states how it is compiled and run. power_up and on_sample are the calls of
 * firmware.
 */
#include <stdio.h>

#include "piezo_params.h"
#include "piezoid_runtime.h"

#define GOLDEN_SAMPLES 1000L /* of every axis in golden.csv */

/* One state per axis; the parameters stay in ROM. */
static pz_state state[PIEZO_AXES];

/* Power-up: start at the present voltage and reading, without a step. Returns NULL, or the name of
 * an invalid parameter. */
static const char *power_up(int axis, pz_real voltage_V, pz_real measured) {
    const int32_t unusable = pz_start(&state[axis], &piezo_params[axis], voltage_V, measured);
    return unusable == PZ_OK ? NULL : pz_describe(unusable)->name;
}

/* Interrupt: reading in, voltage out; finite and inside the limits for any input. */
static pz_real on_sample(int axis, pz_real reference, pz_real measured) {
    return pz_step(&state[axis], &piezo_params[axis], reference, measured);
}

int main(void) {
    int axis;
    long played[PIEZO_AXES] = {0};
    long samples = 0, differ = 0;
    double reference, measured, expected_V[2];
    unsigned status[2];
    const int precision = sizeof(pz_real) == sizeof(float) ? 1 : 0;
    if (scanf("%*[^\n]") != 0) { /* the line of names */
        fprintf(stderr, "golden.csv is missing: run ./example < golden.csv\n");
        return 2;
    }
    while (scanf("%d,%lf,%lf,%lf,%u,%lf,%u", &axis, &reference, &measured, &expected_V[0],
                 &status[0], &expected_V[1], &status[1]) == 7) {
        if (axis < 0 || axis >= PIEZO_AXES) {
            fprintf(stderr, "axis %d of the table is not in piezo_params.h\n", axis);
            return 2;
        }
        if (played[axis]++ == 0) {
            const char *const unusable = power_up(axis, (pz_real)0, (pz_real)measured);
            if (unusable != NULL) {
                fprintf(stderr, "invalid parameter: %s\n", unusable);
                return 1;
            }
        }
        const double voltage_V = (double)on_sample(axis, (pz_real)reference, (pz_real)measured);
        const double difference_V = voltage_V - expected_V[precision];
        ++samples;
        const int is_same = difference_V >= 0.0 && difference_V <= 0.0; /* not where it is NaN */
        if (!is_same || state[axis].status != status[precision]) {
            if (++differ <= 10) {
                fprintf(stderr,
                        "axis %d, sample %ld: %.17g V, status %lu; expected %.17g V, status %u\n",
                        axis, played[axis], voltage_V, (unsigned long)state[axis].status,
                        expected_V[precision], status[precision]);
            }
        }
    }
    if (!feof(stdin)) {
        fprintf(stderr, "line %ld of the table cannot be read\n", samples + 2);
        return 2;
    }
    for (axis = 0; axis < PIEZO_AXES; ++axis) {
        if (played[axis] != GOLDEN_SAMPLES) {
            fprintf(stderr, "axis %d: the table has %ld samples of %ld\n", axis, played[axis],
                    GOLDEN_SAMPLES);
            return 2;
        }
    }
    printf("%ld samples, %ld differ\n", samples, differ);
    return samples > 0 && differ == 0 ? 0 : 1;
}
