/* What both versions of the functional mock-up interface share: one sampled unit and its clock.
 *
 * The unit is sampled: its samples fall on start + k / rate, whatever steps the simulator takes.
 * A communication step from t to t + h takes every sample in [t, t + h) with the inputs set
 * before it; the outputs are those after the last.
 *
 * fmu_of_axis.h, written by export, holds the token, the prefix of the names, and which header is
 * the unit: FMU_UNIT. That header has the type fmu_unit with a clock, and
 *
 *     unit_rate_Hz     how often it samples
 *     unit_as_new      its values before anything is set
 *     unit_begin       initialised; 0: not with these values
 *     unit_first       before the first sample, likewise
 *     unit_sample      one sample
 *     unit_get, _set   a real by its value reference; 0: there is none, or not now
 *     unit_get_count, unit_set_count   the same for whole numbers
 */
#ifndef PIEZOID_FMU_H
#define PIEZOID_FMU_H

#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    double start_s, now_s;
    double samples; /* taken since the start; exact up to 2^53 */
    int running;    /* initialised */
} fmu_clock;

#include "fmu_of_axis.h"

#include FMU_UNIT

/* A simulator's time is a rounded sum: a sample this part of a period before the end of a step
 * belongs to the next. Sums of periods were 4e-7 of a period off after 10 s at 20 kHz, 0.004 after
 * 1000 s, and 0.055 after 1000 s at 50 kHz. */
#define FMU_SLACK 0.1

static void fmu_as_new(fmu_unit *c) {
    memset(c, 0, sizeof *c);
    unit_as_new(c);
}

static fmu_unit *fmu_new(const char *token) {
    fmu_unit *c = NULL;
    if (token != NULL && strcmp(token, FMU_TOKEN) == 0) {
        c = (fmu_unit *)malloc(sizeof *c);
    }
    if (c != NULL) {
        fmu_as_new(c);
    }
    return c;
}

/* Answers with 0 where the step or the parameters cannot be used. */
static int fmu_step(fmu_unit *c, double from_s, double step_s) {
    fmu_clock *clock = &c->clock;
    const double end_s = from_s + step_s;
    if (!clock->running || !(step_s >= 0.0) || !(end_s - clock->start_s < 9e15 / unit_rate_Hz())) {
        return 0;
    }
    if (!(clock->samples > 0.0) && step_s > 0.0 && !unit_first(c)) {
        return 0;
    }
    while (clock->samples + FMU_SLACK < (end_s - clock->start_s) * unit_rate_Hz()) {
        unit_sample(c);
        clock->samples += 1.0;
    }
    clock->now_s = end_s;
    return 1;
}

#endif
