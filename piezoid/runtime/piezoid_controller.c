/* The flat interface of piezoid_controller.h around the runtime.
 *
 *     cc -std=c99 -O2 -ffp-contract=off -shared -fPIC -fvisibility=hidden piezoid_controller.c \
 *         -o libpiezoid_controller.so
 */
#include "piezoid_runtime.c"

#include "piezo_params.h"
#include "piezoid_controller.h"

/* A handle is its place and how often the place was given away, so that an old one stays shut. */
typedef struct {
    pz_state state;
    int32_t handle; /* 0: free */
    int32_t given;
    int32_t axis;
} place_of;

static place_of places[PZ_HANDLES];

#define MOST_GIVEN (INT32_MAX / PZ_HANDLES - 1)

static place_of *opened(int32_t handle) {
    place_of *const place = handle > 0 ? &places[handle % PZ_HANDLES] : NULL;
    return place != NULL && place->handle == handle ? place : NULL;
}

int32_t piezoid_axes(void) {
    return PIEZO_AXES;
}

double piezoid_rate_Hz(int32_t axis) {
    return axis >= 0 && axis < PIEZO_AXES ? (double)piezo_params[axis].sampling_rate_Hz : 0.0;
}

int32_t piezoid_open(int32_t axis, double voltage_V, double measured) {
    int32_t next = 0;
    if (axis < 0 || axis >= PIEZO_AXES) {
        return PZ_NO_AXIS;
    }
    while (next < PZ_HANDLES && places[next].handle != 0) {
        ++next;
    }
    if (next == PZ_HANDLES) {
        return PZ_NO_PLACE;
    }
    place_of *const place = &places[next];
    if (pz_start(&place->state, &piezo_params[axis], (pz_real)voltage_V, (pz_real)measured) !=
        PZ_OK) {
        return PZ_NO_PARAMETERS;
    }
    place->given = place->given < MOST_GIVEN ? place->given + 1 : 1;
    place->handle = place->given * PZ_HANDLES + next;
    place->axis = axis;
    return place->handle;
}

int32_t piezoid_step(int32_t handle, int32_t samples, const double *reference,
                     const double *measured, double *voltage_V, uint32_t *status) {
    place_of *const place = opened(handle);
    if (place == NULL) {
        return PZ_NO_HANDLE;
    }
    if (samples < 0 || reference == NULL || measured == NULL || voltage_V == NULL ||
        status == NULL) {
        return PZ_NO_ARRAY;
    }
    for (int32_t k = 0; k < samples; ++k) {
        voltage_V[k] = (double)pz_step(&place->state, &piezo_params[place->axis],
                                       (pz_real)reference[k], (pz_real)measured[k]);
        status[k] = place->state.status;
    }
    return samples;
}

int32_t piezoid_reset(int32_t handle) {
    place_of *const place = opened(handle);
    if (place == NULL) {
        return PZ_NO_HANDLE;
    }
    pz_reset(&place->state);
    return 0;
}

int32_t piezoid_close(int32_t handle) {
    place_of *const place = opened(handle);
    if (place == NULL) {
        return PZ_NO_HANDLE;
    }
    place->handle = 0;
    return 0;
}
