/* Closed loop of a controller and a simulated plant, tick by tick. */
#include <stddef.h>
#include <stdint.h>

typedef double (*controller_step)(void *state, const void *parameters, double reference,
                                  double measured);
typedef void (*plant_step)(void *plant, double volts, double *measured, double *position);

typedef struct {
    controller_step step;
    void *state;
    const void *parameters;
    plant_step plant_step;
    void *plant;
    size_t ticks;
    const double *reference;
    double *position; /* at the end of each tick */
    double *measured;
    double *volts;
    uint32_t *status;
    double first_measured;
} outsider_run;

void outsider_loop(const outsider_run *run);

void outsider_loop(const outsider_run *run) {
    double measured = run->first_measured;
    for (size_t k = 0; k < run->ticks; ++k) {
        run->volts[k] = run->step(run->state, run->parameters, run->reference[k], measured);
        run->status[k] = ((const uint32_t *)run->state)[1]; /* behind `ready` */
        run->plant_step(run->plant, run->volts[k], &measured, &run->position[k]);
        run->measured[k] = measured;
    }
}
