/* A plant between its converters and the shipped controller, sample by sample.
 *
 * No controller: the one called here is the address of pz_step in the compiled runtime. The unit
 * of the plant for other simulators holds this file as well. One sample:
 *
 *     measured = converter(sensed + noise)                       at the sampling instant
 *     u = pz_step(reference, measured)                           held until the next one
 *     then, on `substeps` instants: v = before(u), w = response(v, disturbance), after(w)
 *
 * `before` sees a held input, `after` an input that is straight between its instants; both were
 * sampled exactly by whoever filled in the matrices.
 */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define PL_MAX_STATES 64

enum { PL_PLAYS = 0, PL_EXPONENTIAL = 1, PL_PLUGGED = 2 };
enum { PL_SOUND = 0, PL_FROZEN = 1, PL_DEAD = 2, PL_REVERSED = 3, PL_FULL = 4 };

/* x = A x + B_old w_old + B_new w_new;  outputs C x + D w_new. Row-major. */
typedef struct {
    size_t states;
    const double *A;
    const double *B_old;
    const double *B_new;
    const double *C; /* two rows: position, sensed */
    double D[2];
    double *x;
} pl_linear;

/* Piecewise linear, 0 at 0: knots increasing, one more slope than knots; knot[zero] is 0. */
typedef struct {
    size_t knots;
    const double *knot;
    const double *slope;
    size_t zero;
} pl_map;

typedef double (*pl_respond)(double drive);

typedef struct {
    size_t substeps;
    size_t late;    /* whole samples that a command waits before it reaches `before` */
    size_t waited;  /* place of the oldest of them */
    double *late_V; /* those commands */
    pl_linear before;
    pl_linear after;
    int64_t kind;
    size_t plays;
    const double *threshold_V;
    const double *weight;
    double *play_V;
    size_t edges; /* of functions of the plays, straight between evenly spaced ones; 0: weights */
    const double *edge_V;
    const double *value_m; /* play by play */
    pl_map envelope;
    pl_map zones;
    double low_V; /* the drive is clipped to these */
    double high_V;
    double activation_step; /* exp(-substep / tau) of the irreversible part; 0: at once */
    double activation_m;    /* lag beyond which it follows faster; 0: none is */
    double irreversible_m;  /* where that part is */
    size_t second_plays;    /* a second hysteresis: powers of plays of u - centre over reach */
    size_t second_powers;
    const double *second_threshold_V;
    const double *second_weight_m; /* power by power */
    double *second_play_V;
    double second_centre_V;
    double second_reach_V;
    size_t cyclic_orders; /* the reading is wrong by so many sines of the position */
    const double *cyclic_cosine_m;
    const double *cyclic_sine_m;
    double cyclic_per_m; /* 2 pi over the wavelength */
    double polarity;
    double voltage_offset_V;
    double displacement_offset_m;
    double current_A;     /* PL_EXPONENTIAL: at v - disturbance = 0 */
    double current_most;  /* PL_EXPONENTIAL: an amplifier that is full shows this; 0: any */
    pl_respond respond;   /* PL_PLUGGED */
    double slew_step;     /* of the amplifier's output in a substep; 0: any */
    double driven;        /* that output, as slow as it is */
    double w;             /* last response */
    double reading_zero;  /* what no current is read as */
    double reading_lsb;   /* of the measuring converter; 0: no rounding */
    double reading_least; /* and its ends */
    double reading_most;
} pl_plant;

typedef double (*pl_step_double)(void *state, const void *parameters, double reference,
                                 double measured);
typedef float (*pl_step_float)(void *state, const void *parameters, float reference,
                               float measured);

/* What is run: addresses of the controller, and arrays of one value per sample. */
typedef struct {
    pl_step_double step_double; /* one of the two is NULL */
    pl_step_float step_float;
    void *state;
    const void *parameters;
    size_t samples;
    const double *reference;
    const double *disturbance; /* one more than samples */
    const double *noise;
    const double *fault; /* NaN: the reading is NaN; else one of PL_SOUND... */
    void (*reset)(void *state);
    size_t reset_at; /* before this sample an operator resets the controller; samples: never */
    double *driven;  /* the farthest in a sample */
    double *position;
    double *measured;
    double *voltage_V;
    uint32_t *status;
} pl_run;

double pl_response(pl_plant *plant, double drive, double disturbance);
double pl_position(const pl_plant *plant);
double pl_reading(const pl_plant *plant, double fault, double noise, double last);
double pl_period(pl_plant *plant, double u, double from, double to);
void pl_loop(pl_plant *plant, const pl_run *run);

/* Of a NaN and a number the number, as fmax and fmin have it, where the NaN stands first. */
static double larger(double x, double y) {
    return x > y ? x : y;
}

static double smaller(double x, double y) {
    return x < y ? x : y;
}

static double dot(const double *row, const double *x, size_t count) {
    double sum = 0.0;
    for (size_t i = 0; i < count; ++i) {
        sum += row[i] * x[i];
    }
    return sum;
}

static void advance(const pl_linear *block, double old, double newer) {
    double next[PL_MAX_STATES];
    if (block->states == 0) {
        return;
    }
    for (size_t i = 0; i < block->states; ++i) {
        next[i] = dot(block->A + i * block->states, block->x, block->states) +
                  block->B_old[i] * old + block->B_new[i] * newer;
    }
    memcpy(block->x, next, block->states * sizeof(double));
}

static double output(const pl_linear *block, size_t row, double w) {
    return dot(block->C + row * block->states, block->x, block->states) + block->D[row] * w;
}

/* From the middle outwards, one straight piece after the other. */
static double mapped(double x, const pl_map *map) {
    double y = 0.0;
    double from = 0.0;
    if (x >= 0.0) {
        size_t next = map->zero + 1;
        for (; next < map->knots && x > map->knot[next]; ++next) {
            y += map->slope[next] * (map->knot[next] - from);
            from = map->knot[next];
        }
        return y + map->slope[next] * (x - from);
    }
    size_t left = map->zero;
    for (; left > 0 && x < map->knot[left - 1]; --left) {
        y += map->slope[left] * (map->knot[left - 1] - from);
        from = map->knot[left - 1];
    }
    return y + map->slope[left] * (x - from);
}

/* What is irreversible climbs its barriers by thermal activation, exactly for a held target:
 *     tanh(lag / 2s) decays by exp(-t / tau);   without s the lag itself does */
static double activated(pl_plant *plant, double target_m) {
    if (!(plant->activation_step > 0.0)) {
        return target_m;
    }
    const double lag = target_m - plant->irreversible_m;
    const double wide = 2.0 * plant->activation_m;
    double left = plant->activation_step * lag;
    if (wide > 0.0) {
        /* tanh is 1 to the last bit beyond 19 */
        const double part = plant->activation_step * tanh(fmax(-18.0, fmin(18.0, lag / wide)));
        left = 0.5 * wide * log((1.0 + part) / (1.0 - part));
    }
    plant->irreversible_m = target_m - left;
    return plant->irreversible_m;
}

static double second(pl_plant *plant, double voltage_V) {
    const double drive = voltage_V - plant->second_centre_V;
    double sum = 0.0;
    for (size_t i = 0; i < plant->second_plays; ++i) {
        const double r = plant->second_threshold_V[i];
        plant->second_play_V[i] = larger(drive - r, smaller(drive + r, plant->second_play_V[i]));
        const double z = plant->second_play_V[i] / plant->second_reach_V;
        double power = 1.0;
        for (size_t n = 0; n < plant->second_powers; ++n) {
            power *= z;
            sum += plant->second_weight_m[n * plant->second_plays + i] * power;
        }
    }
    return sum;
}

/* What play i adds: its outermost pieces go on for ever. */
static double moved_by(const pl_plant *plant, size_t i) {
    const double z = plant->play_V[i];
    if (plant->edges == 0) {
        return plant->weight[i] * z;
    }
    const double width = plant->edge_V[1] - plant->edge_V[0];
    const double place = (z - plant->edge_V[0]) / width;
    const size_t k = (size_t)larger(0.0, smaller(place, (double)(plant->edges - 2)));
    const double *const value = plant->value_m + i * plant->edges + k;
    return value[0] + (value[1] - value[0]) * (place - (double)k);
}

/* The first play has no threshold: its part is reversible, and there at once. */
static double plays(pl_plant *plant, double voltage_V) {
    const double clipped = larger(smaller(voltage_V, plant->high_V), plant->low_V);
    const double drive = mapped(clipped - plant->voltage_offset_V, &plant->envelope);
    const size_t count = plant->plays;
    const double *const r = plant->threshold_V;
    double *const play = plant->play_V;
    double irreversible = 0.0;
    for (size_t i = 0; i < count; ++i) {
        play[i] = larger(drive - r[i], smaller(drive + r[i], play[i]));
    }
    for (size_t i = 1; i < count; ++i) {
        irreversible += moved_by(plant, i);
    }
    const double sum = moved_by(plant, 0) + activated(plant, irreversible);
    const double moved = mapped(sum, &plant->zones) + second(plant, clipped);
    return plant->polarity * moved + plant->displacement_offset_m;
}

static double delayed(pl_plant *plant, double command) {
    if (plant->late == 0) {
        return command;
    }
    const double oldest = plant->late_V[plant->waited];
    plant->late_V[plant->waited] = command;
    plant->waited = (plant->waited + 1) % plant->late;
    return oldest;
}

static double slewed(pl_plant *plant, double wanted) {
    if (!(plant->slew_step > 0.0)) {
        return wanted;
    }
    const double away = wanted - plant->driven;
    plant->driven += fmax(-plant->slew_step, fmin(plant->slew_step, away));
    return plant->driven;
}

double pl_response(pl_plant *plant, double drive, double disturbance) {
    if (plant->kind == PL_EXPONENTIAL) {
        /* e^60 times any current is far beyond every converter, and finite. */
        const double current_A =
            plant->current_A * exp(fmax(-60.0, fmin(60.0, drive - disturbance)));
        return plant->current_most > 0.0 ? fmin(current_A, plant->current_most) : current_A;
    }
    return (plant->kind == PL_PLAYS ? plays(plant, drive) : plant->respond(drive)) + disturbance;
}

static double cyclic(const pl_plant *plant, double position_m) {
    double sum = position_m;
    for (size_t n = 1; n <= plant->cyclic_orders; ++n) {
        const double turn = (double)n * plant->cyclic_per_m * position_m;
        sum += plant->cyclic_cosine_m[n - 1] * cos(turn) + plant->cyclic_sine_m[n - 1] * sin(turn);
    }
    return sum;
}

static double converted(const pl_plant *plant, double sensed) {
    const double kept = fmax(plant->reading_least, fmin(plant->reading_most, sensed));
    return plant->reading_lsb > 0.0 ? plant->reading_lsb * nearbyint(kept / plant->reading_lsb)
                                    : kept;
}

/* What the sensor shows: itself, or what is left of it. */
static double shown(const pl_plant *plant, double fault, double sensed, double noise,
                    double last) {
    if (isnan(fault)) {
        return fault;
    }
    switch ((int)fault) {
    case PL_FROZEN:
        return last;
    case PL_DEAD:
        return converted(plant, plant->reading_zero + noise);
    case PL_REVERSED:
        return converted(plant, plant->reading_zero - sensed + noise);
    case PL_FULL:
        return converted(plant, plant->reading_most);
    default:
        return converted(plant, plant->reading_zero + sensed + noise);
    }
}

static double controlled(const pl_run *run, size_t k, double measured) {
    if (run->step_double != NULL) {
        return run->step_double(run->state, run->parameters, run->reference[k], measured);
    }
    return (double)run->step_float(run->state, run->parameters, (float)run->reference[k],
                                   (float)measured);
}

/* Where the stage is at the sampling instant, and what its sensor shows then. */
double pl_position(const pl_plant *plant) {
    return output(&plant->after, 0, plant->w);
}

double pl_reading(const pl_plant *plant, double fault, double noise, double last) {
    const double sensed = cyclic(plant, output(&plant->after, 1, plant->w));
    return shown(plant, fault, sensed, noise, last);
}

/* One period under a held command, disturbed in a straight line; returns the farthest drive. */
double pl_period(pl_plant *plant, double u, double from, double to) {
    double driven = 0.0;
    const double arrived = delayed(plant, u);
    const double slope = to - from;
    for (size_t j = 1; j <= plant->substeps; ++j) {
        const double part = (double)j / (double)plant->substeps;
        advance(&plant->before, arrived, arrived);
        const double v = slewed(plant, output(&plant->before, 0, arrived));
        driven = j == 1 ? v : fmax(driven, v);
        const double w = pl_response(plant, v, from + part * slope);
        advance(&plant->after, plant->w, w);
        plant->w = w;
    }
    return driven;
}

void pl_loop(pl_plant *plant, const pl_run *run) {
    double reading = 0.0;
    for (size_t k = 0; k < run->samples; ++k) {
        run->position[k] = pl_position(plant);
        run->measured[k] = pl_reading(plant, run->fault[k], run->noise[k], reading);
        reading = isnan(run->measured[k]) ? reading : run->measured[k];
        if (k == run->reset_at) {
            run->reset(run->state);
        }
        const double u = controlled(run, k, run->measured[k]);
        run->voltage_V[k] = u;
        run->status[k] = ((const uint32_t *)run->state)[1]; /* behind `ready` */
        run->driven[k] = pl_period(plant, u, run->disturbance[k], run->disturbance[k + 1]);
    }
}
