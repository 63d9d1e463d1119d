/* What both versions of the functional mock-up interface share: one controller and its clock.
 *
 * The controller is sampled: its samples fall on start + k / rate, whatever steps the simulator
 * takes. A communication step from t to t + h takes every sample in [t, t + h) with the inputs
 * set before it; the outputs are those after the last.
 *
 * fmu_of_axis.h, written by export, holds the token, the axis and the prefix of the names.
 */
#ifndef PIEZOID_FMU_H
#define PIEZOID_FMU_H

#include "piezoid_runtime.c"

#include "fmu_of_axis.h"
#include "piezo_params.h"

#include <stdlib.h>

/* A simulator's time is a rounded sum: a sample this part of a period before the end of a step
 * belongs to the next. Sums of periods were 4e-7 of a period off after 10 s at 20 kHz, 0.004 after
 * 1000 s, and 0.055 after 1000 s at 50 kHz. */
#define FMU_SLACK 0.1

/* Value references, those of modelDescription.xml. */
enum { FMU_TIME, FMU_REFERENCE, FMU_MEASURED, FMU_VOLTAGE, FMU_STATUS, FMU_START_VOLTAGE };

typedef struct {
    pz_state state;
    double reference, measured, start_voltage_V;
    double start_s, now_s;
    double samples; /* taken since the start; exact up to 2^53 */
    int running;    /* initialised */
} fmu_controller;

static const pz_parameters *fmu_parameters(void) {
    return &piezo_params[FMU_AXIS];
}

static int fmu_begin(fmu_controller *c) {
    const pz_real voltage_V = (pz_real)c->start_voltage_V;
    return pz_start(&c->state, fmu_parameters(), voltage_V, (pz_real)c->measured) == PZ_OK;
}

static void fmu_as_new(fmu_controller *c) {
    memset(c, 0, sizeof *c);
    c->reference = c->measured = FMU_INPUT_AT_START;
}

static fmu_controller *fmu_new(const char *token) {
    fmu_controller *c = NULL;
    if (token != NULL && strcmp(token, FMU_TOKEN) == 0) {
        c = (fmu_controller *)malloc(sizeof *c);
    }
    if (c != NULL) {
        fmu_as_new(c);
    }
    return c;
}

/* Answers with 0 where the step or the parameters cannot be used. */
static int fmu_step(fmu_controller *c, double from_s, double step_s) {
    const double rate_Hz = (double)fmu_parameters()->sampling_rate_Hz;
    const double end_s = from_s + step_s;
    if (!c->running || !(step_s >= 0.0) || !(end_s - c->start_s < 9e15 / rate_Hz)) {
        return 0;
    }
    if (!(c->samples > 0.0) && step_s > 0.0 && !fmu_begin(c)) {
        return 0; /* again, now that a simulator has set what the sensor shows */
    }
    while (c->samples + FMU_SLACK < (end_s - c->start_s) * rate_Hz) {
        pz_step(&c->state, fmu_parameters(), (pz_real)c->reference, (pz_real)c->measured);
        c->samples += 1.0;
    }
    c->now_s = end_s;
    return 1;
}

static int fmu_get(const fmu_controller *c, unsigned reference, double *value) {
    const double values[] = {c->now_s, c->reference,      c->measured, (double)c->state.voltage_V,
                             0.0,      c->start_voltage_V};
    if (reference > FMU_START_VOLTAGE || reference == FMU_STATUS) {
        return 0;
    }
    *value = values[reference];
    return 1;
}

static int fmu_set(fmu_controller *c, unsigned reference, double value) {
    if (reference == FMU_REFERENCE) {
        c->reference = value;
    } else if (reference == FMU_MEASURED) {
        c->measured = value;
    } else if (reference == FMU_START_VOLTAGE && !c->running) {
        c->start_voltage_V = value;
    } else {
        return 0;
    }
    return 1;
}

#endif
