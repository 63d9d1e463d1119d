/* A controller or a plant as a co-simulation unit of the functional mock-up interface 2.0.
 *
 *     cc -std=c99 -O2 -ffp-contract=off -shared -fPIC -fvisibility=hidden \
 *         -DFMI2_OVERRIDE_FUNCTION_PREFIX fmu2.c -o MODEL_IDENTIFIER.so
 */
#include "fmu.h"

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
