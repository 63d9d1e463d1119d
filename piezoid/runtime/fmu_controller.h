/* A controller as the unit of fmu2.c. */
#ifndef PIEZOID_FMU_CONTROLLER_H
#define PIEZOID_FMU_CONTROLLER_H

#include "piezoid_runtime.c"

#include "piezo_params.h"

/* Value references, those of modelDescription.xml. */
enum { FMU_TIME, FMU_REFERENCE, FMU_MEASURED, FMU_VOLTAGE, FMU_STATUS, FMU_START_VOLTAGE };

typedef struct {
    fmu_clock clock;
    pz_state state;
    double reference, measured, start_voltage_V;
} fmu_unit;

static const pz_parameters *unit_parameters(void) {
    return &piezo_params[FMU_AXIS];
}

static double unit_rate_Hz(void) {
    return (double)unit_parameters()->sampling_rate_Hz;
}

static int unit_begin(fmu_unit *c) {
    const pz_real voltage_V = (pz_real)c->start_voltage_V;
    return pz_start(&c->state, unit_parameters(), voltage_V, (pz_real)c->measured) == PZ_OK;
}

/* Simulators set what the sensor shows as late as before the first step. */
static int unit_first(fmu_unit *c) {
    return unit_begin(c);
}

static void unit_as_new(fmu_unit *c) {
    c->reference = c->measured = FMU_INPUT_AT_START;
}

static void unit_sample(fmu_unit *c) {
    pz_step(&c->state, unit_parameters(), (pz_real)c->reference, (pz_real)c->measured);
}

static int unit_get(const fmu_unit *c, unsigned reference, double *value) {
    const double values[] = {
        c->clock.now_s,    c->reference, c->measured, (double)c->state.voltage_V, 0.0,
        c->start_voltage_V};
    if (reference > FMU_START_VOLTAGE || reference == FMU_STATUS) {
        return 0;
    }
    *value = values[reference];
    return 1;
}

static int unit_set(fmu_unit *c, unsigned reference, double value) {
    if (reference == FMU_REFERENCE) {
        c->reference = value;
    } else if (reference == FMU_MEASURED) {
        c->measured = value;
    } else if (reference == FMU_START_VOLTAGE && !c->clock.running) {
        c->start_voltage_V = value;
    } else {
        return 0;
    }
    return 1;
}

static int unit_get_count(const fmu_unit *c, unsigned reference, uint32_t *value) {
    *value = c->state.status;
    return reference == FMU_STATUS;
}

static int unit_set_count(fmu_unit *c, unsigned reference, uint32_t value) {
    (void)c, (void)reference, (void)value;
    return 0;
}

#endif
