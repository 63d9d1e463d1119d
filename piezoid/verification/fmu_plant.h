/* The identified plant of an axis as the unit of fmu2.c: the plant that verification runs.
 *
 * plant_of_axis.h, written by piezoid, holds its numbers, settled at the voltage it rests at.
 */
#ifndef PIEZOID_FMU_PLANT_H
#define PIEZOID_FMU_PLANT_H

#include "plant_loop.c"

#include "plant_of_axis.h"

/* Value references, those of modelDescription.xml. */
enum { FMU_TIME, FMU_VOLTAGE, FMU_DISTURBANCE, FMU_MEASURED, FMU_POSITION, FMU_NOISE, FMU_SEED };

#define PLANT_TURN 6.283185307179586

typedef struct {
    fmu_clock clock;
    pl_plant plant;
    double late_V[PLANT_LATE];
    double before_x[PLANT_BEFORE_STATES];
    double after_x[PLANT_AFTER_STATES];
    double play_V[PLANT_PLAYS];
    double second_play_V[PLANT_SECOND_PLAYS];
    double voltage_V, disturbance, last_disturbance, measured, position;
    double noise_factor, noise; /* of the recordings' noise; what it is now, filtered */
    double phase[PLANT_HUMS];
    uint32_t seed;
    uint64_t random;
    double instant; /* samples since the start */
} fmu_unit;

static double unit_rate_Hz(void) {
    return PLANT_RATE_Hz;
}

/* splitmix64 [Steele et al. 2014]: evenly between 0 and 1, without either end. */
static double unit_even(fmu_unit *c) {
    uint64_t z = (c->random += UINT64_C(0x9e3779b97f4a7c15));
    z = (z ^ (z >> 30)) * UINT64_C(0xbf58476d1ce4e5b9);
    z = (z ^ (z >> 27)) * UINT64_C(0x94d049bb133111eb);
    z ^= z >> 31;
    return ((double)(z >> 11) + 0.5) * 0x1p-53;
}

/* Box and Muller's transform [1958]. */
static double unit_normal(fmu_unit *c) {
    const double far = sqrt(-2.0 * log(unit_even(c)));
    return far * cos(PLANT_TURN * unit_even(c));
}

/* The reading at this instant: noise of first order, sampled exactly, and lines. */
static void unit_read(fmu_unit *c) {
    const double kick = c->instant > 0.0 ? PLANT_NOISE_KICK : 1.0;
    c->noise = PLANT_NOISE_POLE * c->noise + kick * PLANT_NOISE_RMS * unit_normal(c);
    double all = c->noise;
    for (size_t i = 0; i < PLANT_HUMS; ++i) {
        const double turns = plant_hum_Hz[i] * c->instant / PLANT_RATE_Hz;
        all += plant_hum[i] * sin(PLANT_TURN * (turns + c->phase[i]));
    }
    c->position = pl_position(&c->plant);
    c->measured = pl_reading(&c->plant, (double)PL_SOUND, c->noise_factor * all, c->measured);
}

static double unit_disturbance(double given) {
    return PLANT_DISTURBANCE_AT_REST + PLANT_DISTURBANCE_FACTOR * given;
}

/* At rest under the disturbance that is there; what is linear follows its response. */
static int unit_begin(fmu_unit *c) {
    pl_plant *plant = &c->plant;
    *plant = plant_at_rest;
    plant->late_V = memcpy(c->late_V, plant_late_V, sizeof c->late_V);
    plant->before.x = memcpy(c->before_x, plant_before_x, sizeof c->before_x);
    plant->after.x = memcpy(c->after_x, plant_after_x, sizeof c->after_x);
    plant->play_V = memcpy(c->play_V, plant_play_V, sizeof c->play_V);
    plant->second_play_V = memcpy(c->second_play_V, plant_second_play_V, sizeof c->second_play_V);
    const double w = plant->w;
    c->last_disturbance = unit_disturbance(c->disturbance);
    plant->w = pl_response(plant, plant->driven, c->last_disturbance);
    for (size_t i = 0; i < PLANT_AFTER_STATES; ++i) {
        c->after_x[i] += plant_after_settled[i] * (plant->w - w);
    }
    c->random = c->seed;
    c->noise = c->measured = c->instant = 0.0;
    for (size_t i = 0; i < PLANT_HUMS; ++i) {
        c->phase[i] = unit_even(c);
    }
    unit_read(c);
    return 1;
}

/* At rest since its initialisation. */
static int unit_first(fmu_unit *c) {
    (void)c;
    return 1;
}

static void unit_as_new(fmu_unit *c) {
    c->voltage_V = PLANT_REST_V;
    c->noise_factor = 1.0;
    unit_begin(c);
}

static void unit_sample(fmu_unit *c) {
    const double next = unit_disturbance(c->disturbance);
    pl_period(&c->plant, c->voltage_V, c->last_disturbance, next);
    c->last_disturbance = next;
    c->instant += 1.0;
    unit_read(c);
}

static int unit_get(const fmu_unit *c, unsigned reference, double *value) {
    const double values[] = {c->clock.now_s, c->voltage_V, c->disturbance,
                             c->measured,    c->position,  c->noise_factor};
    if (reference > FMU_NOISE) {
        return 0;
    }
    *value = values[reference];
    return 1;
}

static int unit_set(fmu_unit *c, unsigned reference, double value) {
    if (!isfinite(value)) {
        return 0;
    }
    if (reference == FMU_VOLTAGE) {
        c->voltage_V = value;
    } else if (reference == FMU_DISTURBANCE) {
        c->disturbance = value;
    } else if (reference == FMU_NOISE && !c->clock.running) {
        c->noise_factor = value;
    } else {
        return 0;
    }
    return 1;
}

static int unit_get_count(const fmu_unit *c, unsigned reference, uint32_t *value) {
    *value = c->seed;
    return reference == FMU_SEED;
}

static int unit_set_count(fmu_unit *c, unsigned reference, uint32_t value) {
    if (reference != FMU_SEED || c->clock.running) {
        return 0;
    }
    c->seed = value;
    return 1;
}

#endif
