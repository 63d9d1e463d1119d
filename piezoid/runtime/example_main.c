/* How firmware uses the runtime: three calls at power-up, one in the 20 kHz interrupt.
 *
 * On a desk computer this program reads pairs from its input: first "voltage measured" as they are
 * at power-up, then "reference measured" for every sample; it writes "voltage status" for each, so
 * that your own build can be compared with golden.csv:
 *
 *     cc -std=c99 -ffp-contract=off example_main.c piezoid_runtime.c -o example
 *
 * Add -DPZ_REAL_FLOAT to try what a single-precision target will do.
 */
#include <stdio.h>

#include "piezo_params.h"
#include "piezoid_runtime.h"

/* One state per axis, yours; the parameters stay in ROM. */
static pz_state axis;

/* The interrupt: measure, step, put out. The voltage is finite and inside the limits always. */
static pz_real on_sample(pz_real reference, pz_real measured) {
    return pz_step(&axis, &piezo_params, reference, measured);
}

int main(void) {
    /* Power-up: refuse to run with parameters that are not what was designed. */
    const int32_t unusable = pz_check(&piezo_params);
    if (unusable != PZ_OK) {
        const pz_field *const field = pz_describe(unusable);
        fprintf(stderr, "unusable parameter: %s\n", field != NULL ? field->name : "?");
        return 1;
    }
    /* What the converter puts out and the sensor shows now, so that nothing jumps. */
    double voltage_V, reference, measured;
    if (scanf("%lf %lf", &voltage_V, &measured) != 2) {
        return 2;
    }
    if (pz_start(&axis, &piezo_params, (pz_real)voltage_V, (pz_real)measured) != PZ_OK) {
        return 1;
    }
    while (scanf("%lf %lf", &reference, &measured) == 2) {
        const pz_real answer_V = on_sample((pz_real)reference, (pz_real)measured);
        printf("%.17g %u\n", (double)answer_V, (unsigned)axis.status);
    }
    return 0;
}
