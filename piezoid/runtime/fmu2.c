/* A controller or a plant as a co-simulation unit of the functional mock-up interface 2.0.
 *
 *     cc -std=c99 -O2 -ffp-contract=off -shared -fPIC -fvisibility=hidden \
 *         -DFMI2_OVERRIDE_FUNCTION_PREFIX fmu2.c -o MODEL_IDENTIFIER.so
 *
 * The unit is sampled: its samples fall on start + k / rate, whatever steps the simulator takes.
 * A communication step from t to t + h takes every sample in [t, t + h) with the inputs set
 * before it; the outputs are those after the last.
 *
 * fmu_of_axis.h, written by export, holds the token, the prefix of the names, and the header of
 * the unit, FMU_UNIT. That header has the type fmu_unit with a clock, and
 *
 *     unit_rate_Hz     sampling rate
 *     unit_as_new      default values
 *     unit_begin       end of initialisation; 0: these values cannot be used
 *     unit_first       before the first sample, likewise
 *     unit_sample      one sample
 *     unit_get, _set   a real by its value reference; 0: unknown, or not now
 *     unit_get_count, unit_set_count   the same for integers
 */
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

#ifdef _WIN32
#define PUBLIC __declspec(dllexport)
#else
#define PUBLIC __attribute__((visibility("default")))
#endif
#ifdef FMI2_OVERRIDE_FUNCTION_PREFIX
#define FN(name) fmi2##name
#else
#define FN(name) FMU_PREFIXED(fmi2##name)
#endif

typedef enum { OK, WARNING, DISCARD, ERROR, FATAL, PENDING } status2;
typedef fmu_unit *component;
typedef unsigned int reference2;
typedef void (*logger2)(void *, const char *, status2, const char *, const char *, ...);
typedef struct {
    logger2 logger;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*step_finished)(void *, status2);
    void *environment;
} callbacks2;

#define UNUSED(name) (void)(name)

PUBLIC const char *FN(GetTypesPlatform)(void) {
    return "default";
}
PUBLIC const char *FN(GetVersion)(void) {
    return "2.0";
}

PUBLIC status2 FN(SetDebugLogging)(component c, int on, size_t n, const char *const categories[]) {
    UNUSED(c), UNUSED(on), UNUSED(n), UNUSED(categories);
    return OK;
}

PUBLIC component FN(Instantiate)(const char *name, int type, const char *guid,
                                 const char *resources, const callbacks2 *functions, int visible,
                                 int logging) {
    component c = type == 1 ? fmu_new(guid) : NULL; /* 1: co-simulation */
    UNUSED(resources), UNUSED(visible), UNUSED(logging);
    if (c == NULL && functions != NULL && functions->logger != NULL) {
        functions->logger(functions->environment, name, ERROR, "error",
                          "modelDescription.xml is not that of this binary, or no co-simulation "
                          "is wanted; export again");
    }
    return c;
}

PUBLIC void FN(FreeInstance)(component c) {
    free(c);
}

PUBLIC status2 FN(SetupExperiment)(component c, int tolerance_defined, double tolerance,
                                   double start_s, int stop_defined, double stop_s) {
    UNUSED(tolerance_defined), UNUSED(tolerance), UNUSED(stop_defined), UNUSED(stop_s);
    c->clock.start_s = c->clock.now_s = start_s;
    return OK;
}

PUBLIC status2 FN(EnterInitializationMode)(component c) {
    UNUSED(c);
    return OK;
}

PUBLIC status2 FN(ExitInitializationMode)(component c) {
    c->clock.running = unit_begin(c);
    return c->clock.running ? OK : ERROR;
}

PUBLIC status2 FN(Terminate)(component c) {
    UNUSED(c);
    return OK;
}

PUBLIC status2 FN(Reset)(component c) {
    fmu_as_new(c);
    return OK;
}

PUBLIC status2 FN(GetReal)(component c, const reference2 r[], size_t n, double value[]) {
    for (size_t i = 0; i < n; ++i) {
        if (!unit_get(c, r[i], &value[i])) {
            return ERROR;
        }
    }
    return OK;
}

PUBLIC status2 FN(SetReal)(component c, const reference2 r[], size_t n, const double value[]) {
    for (size_t i = 0; i < n; ++i) {
        if (!unit_set(c, r[i], value[i])) {
            return ERROR;
        }
    }
    return OK;
}

PUBLIC status2 FN(GetInteger)(component c, const reference2 r[], size_t n, int value[]) {
    for (size_t i = 0; i < n; ++i) {
        uint32_t count = 0;
        if (!unit_get_count(c, r[i], &count)) {
            return ERROR;
        }
        value[i] = (int)count;
    }
    return OK;
}

PUBLIC status2 FN(SetInteger)(component c, const reference2 r[], size_t n, const int value[]) {
    for (size_t i = 0; i < n; ++i) {
        if (value[i] < 0 || !unit_set_count(c, r[i], (uint32_t)value[i])) {
            return ERROR;
        }
    }
    return OK;
}

PUBLIC status2 FN(DoStep)(component c, double now_s, double step_s, int kept) {
    UNUSED(kept);
    return fmu_step(c, now_s, step_s) ? OK : ERROR;
}

/* What modelDescription.xml does not offer: answered with an error unless nothing is asked. */
#define EMPTY_ACCESS(name, type)                                                                  \
    PUBLIC status2 FN(name)(component c, const reference2 r[], size_t n, type value[]) {          \
        UNUSED(c), UNUSED(r), UNUSED(value);                                                      \
        return n == 0 ? OK : ERROR;                                                               \
    }
EMPTY_ACCESS(GetBoolean, int)
EMPTY_ACCESS(GetString, const char *)
EMPTY_ACCESS(SetBoolean, const int)
EMPTY_ACCESS(SetString, const char *const)

#define NO_STATE(name, ...)                                                                       \
    PUBLIC status2 FN(name)(__VA_ARGS__) {                                                        \
        return ERROR;                                                                             \
    }
#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif
NO_STATE(GetFMUstate, component c, void **state)
NO_STATE(SetFMUstate, component c, void *state)
NO_STATE(FreeFMUstate, component c, void **state)
NO_STATE(SerializedFMUstateSize, component c, void *state, size_t *size)
NO_STATE(SerializeFMUstate, component c, void *state, char bytes[], size_t size)
NO_STATE(DeSerializeFMUstate, component c, const char bytes[], size_t size, void **state)
NO_STATE(GetDirectionalDerivative, component c, const reference2 unknown[], size_t unknowns,
         const reference2 known[], size_t knowns, const double change[], double answer[])
NO_STATE(SetRealInputDerivatives, component c, const reference2 r[], size_t n, const int order[],
         const double value[])
NO_STATE(GetRealOutputDerivatives, component c, const reference2 r[], size_t n, const int order[],
         double value[])
NO_STATE(CancelStep, component c)
NO_STATE(GetStatus, component c, int kind, status2 *value)
NO_STATE(GetRealStatus, component c, int kind, double *value)
NO_STATE(GetIntegerStatus, component c, int kind, int *value)
NO_STATE(GetBooleanStatus, component c, int kind, int *value)
NO_STATE(GetStringStatus, component c, int kind, const char **value)
