/* A controller or a plant as a co-simulation unit of the functional mock-up interface 3.0.
 *
 *     cc -std=c99 -O2 -ffp-contract=off -shared -fPIC -fvisibility=hidden \
 *         -DFMI3_OVERRIDE_FUNCTION_PREFIX fmu3.c -o MODEL_IDENTIFIER.so
 */
#include "fmu.h"

#include <stdbool.h>

#ifdef _WIN32
#define PUBLIC __declspec(dllexport)
#else
#define PUBLIC __attribute__((visibility("default")))
#endif
#ifdef FMI3_OVERRIDE_FUNCTION_PREFIX
#define FN(name) fmi3##name
#else
#define FN(name) FMU_PREFIXED(fmi3##name)
#endif

typedef enum { OK, WARNING, DISCARD, ERROR, FATAL } status3;
typedef fmu_unit *instance;
typedef uint32_t reference3;
typedef void (*log3)(void *, status3, const char *, const char *);
typedef void (*update3)(void *, double, bool, bool, bool, bool, bool *, double *);

/* Every simulator passes more than a sampled unit needs. */
#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

PUBLIC const char *FN(GetVersion)(void) {
    return "3.0";
}

PUBLIC status3 FN(SetDebugLogging)(instance c, bool on, size_t n, const char *const categories[]) {
    return OK;
}

PUBLIC instance FN(InstantiateCoSimulation)(const char *name, const char *token,
                                            const char *resources, bool visible, bool logging,
                                            bool event_mode, bool early_return,
                                            const reference3 intermediate[], size_t n,
                                            void *environment, log3 log, update3 update) {
    instance c = event_mode || n > 0 ? NULL : fmu_new(token);
    if (c == NULL && log != NULL) {
        log(environment, ERROR, "error",
            "modelDescription.xml is not that of this binary, or it was asked for what that does "
            "not offer; export again");
    }
    return c;
}

PUBLIC void FN(FreeInstance)(instance c) {
    free(c);
}

PUBLIC status3 FN(EnterInitializationMode)(instance c, bool tolerance_defined, double tolerance,
                                           double start_s, bool stop_defined, double stop_s) {
    c->clock.start_s = c->clock.now_s = start_s;
    return OK;
}

PUBLIC status3 FN(ExitInitializationMode)(instance c) {
    c->clock.running = unit_begin(c);
    return c->clock.running ? OK : ERROR;
}

PUBLIC status3 FN(Terminate)(instance c) {
    return OK;
}

PUBLIC status3 FN(Reset)(instance c) {
    fmu_as_new(c);
    return OK;
}

PUBLIC status3 FN(GetFloat64)(instance c, const reference3 r[], size_t n, double value[],
                              size_t values) {
    for (size_t i = 0; i < n; ++i) {
        if (i >= values || !unit_get(c, r[i], &value[i])) {
            return ERROR;
        }
    }
    return OK;
}

PUBLIC status3 FN(SetFloat64)(instance c, const reference3 r[], size_t n, const double value[],
                              size_t values) {
    for (size_t i = 0; i < n; ++i) {
        if (i >= values || !unit_set(c, r[i], value[i])) {
            return ERROR;
        }
    }
    return OK;
}

PUBLIC status3 FN(GetUInt32)(instance c, const reference3 r[], size_t n, uint32_t value[],
                             size_t values) {
    for (size_t i = 0; i < n; ++i) {
        if (i >= values || !unit_get_count(c, r[i], &value[i])) {
            return ERROR;
        }
    }
    return OK;
}

PUBLIC status3 FN(SetUInt32)(instance c, const reference3 r[], size_t n, const uint32_t value[],
                             size_t values) {
    for (size_t i = 0; i < n; ++i) {
        if (i >= values || !unit_set_count(c, r[i], value[i])) {
            return ERROR;
        }
    }
    return OK;
}

PUBLIC status3 FN(DoStep)(instance c, double now_s, double step_s, bool kept, bool *event,
                          bool *terminate, bool *early, double *last_s) {
    *event = *terminate = *early = false;
    const int done = fmu_step(c, now_s, step_s);
    *last_s = done ? now_s + step_s : now_s;
    return done ? OK : ERROR;
}

/* What modelDescription.xml does not offer: answered with an error unless nothing is asked. */
#define EMPTY_ACCESS(name, type)                                                                  \
    PUBLIC status3 FN(name)(instance c, const reference3 r[], size_t n, type value[],             \
                            size_t values) {                                                      \
        return n == 0 ? OK : ERROR;                                                               \
    }
#define EMPTY(name, type) EMPTY_ACCESS(Get##name, type) EMPTY_ACCESS(Set##name, const type)
EMPTY(Float32, float)
EMPTY(Int8, int8_t)
EMPTY(UInt8, uint8_t)
EMPTY(Int16, int16_t)
EMPTY(UInt16, uint16_t)
EMPTY(Int32, int32_t)
EMPTY(Int64, int64_t)
EMPTY(UInt64, uint64_t)
EMPTY(Boolean, bool)
EMPTY_ACCESS(GetString, const char *)
EMPTY_ACCESS(SetString, const char *const)

#define NOT_OFFERED(name, ...)                                                                    \
    PUBLIC status3 FN(name)(__VA_ARGS__) {                                                        \
        return ERROR;                                                                             \
    }
#define REFERENCES instance c, const reference3 r[], size_t n
NOT_OFFERED(GetBinary, REFERENCES, size_t size[], const uint8_t *value[], size_t values)
NOT_OFFERED(SetBinary, REFERENCES, const size_t size[], const uint8_t *const value[],
            size_t values)
NOT_OFFERED(GetClock, REFERENCES, bool value[])
NOT_OFFERED(SetClock, REFERENCES, const bool value[])
NOT_OFFERED(GetIntervalDecimal, REFERENCES, double interval[], int qualifier[])
NOT_OFFERED(SetIntervalDecimal, REFERENCES, const double interval[])
NOT_OFFERED(GetIntervalFraction, REFERENCES, uint64_t counter[], uint64_t resolution[],
            int qualifier[])
NOT_OFFERED(SetIntervalFraction, REFERENCES, const uint64_t counter[], const uint64_t resolution[])
NOT_OFFERED(GetShiftDecimal, REFERENCES, double shift[])
NOT_OFFERED(SetShiftDecimal, REFERENCES, const double shift[])
NOT_OFFERED(GetShiftFraction, REFERENCES, uint64_t counter[], uint64_t resolution[])
NOT_OFFERED(SetShiftFraction, REFERENCES, const uint64_t counter[], const uint64_t resolution[])
NOT_OFFERED(GetOutputDerivatives, REFERENCES, const int32_t order[], double value[], size_t values)
NOT_OFFERED(GetNumberOfVariableDependencies, instance c, reference3 r, size_t *n)
NOT_OFFERED(GetVariableDependencies, instance c, reference3 r, size_t dependent[],
            reference3 independent[], size_t element[], int kind[], size_t n)
NOT_OFFERED(GetFMUState, instance c, void **state)
NOT_OFFERED(SetFMUState, instance c, void *state)
NOT_OFFERED(FreeFMUState, instance c, void **state)
NOT_OFFERED(SerializedFMUStateSize, instance c, void *state, size_t *size)
NOT_OFFERED(SerializeFMUState, instance c, void *state, uint8_t bytes[], size_t size)
NOT_OFFERED(DeserializeFMUState, instance c, const uint8_t bytes[], size_t size, void **state)
#define DERIVATIVE                                                                                \
    instance c, const reference3 unknown[], size_t unknowns, const reference3 known[],            \
        size_t knowns, const double seed[], size_t seeds, double answer[], size_t answers
NOT_OFFERED(GetDirectionalDerivative, DERIVATIVE)
NOT_OFFERED(GetAdjointDerivative, DERIVATIVE)
NOT_OFFERED(EnterConfigurationMode, instance c)
NOT_OFFERED(ExitConfigurationMode, instance c)
NOT_OFFERED(EnterEventMode, instance c)
NOT_OFFERED(EnterStepMode, instance c)
NOT_OFFERED(EvaluateDiscreteStates, instance c)
NOT_OFFERED(UpdateDiscreteStates, instance c, bool *update, bool *terminate, bool *nominals,
            bool *values, bool *defined, double *next_s)
NOT_OFFERED(EnterContinuousTimeMode, instance c)
NOT_OFFERED(CompletedIntegratorStep, instance c, bool kept, bool *event, bool *terminate)
NOT_OFFERED(SetTime, instance c, double now_s)
NOT_OFFERED(SetContinuousStates, instance c, const double state[], size_t n)
NOT_OFFERED(GetContinuousStates, instance c, double state[], size_t n)
NOT_OFFERED(GetContinuousStateDerivatives, instance c, double derivative[], size_t n)
NOT_OFFERED(GetNominalsOfContinuousStates, instance c, double nominal[], size_t n)
NOT_OFFERED(GetEventIndicators, instance c, double indicator[], size_t n)
NOT_OFFERED(GetNumberOfEventIndicators, instance c, size_t *n)
NOT_OFFERED(GetNumberOfContinuousStates, instance c, size_t *n)
NOT_OFFERED(ActivateModelPartition, instance c, reference3 clock, double now_s)

PUBLIC instance FN(InstantiateModelExchange)(const char *name, const char *token,
                                             const char *resources, bool visible, bool logging,
                                             void *environment, log3 log) {
    return NULL;
}

PUBLIC instance FN(InstantiateScheduledExecution)(const char *name, const char *token,
                                                  const char *resources, bool visible,
                                                  bool logging, void *environment, log3 log,
                                                  void (*clock)(void *), void (*lock)(void),
                                                  void (*unlock)(void)) {
    return NULL;
}
