/* The controllers of a stage as a shared library: plain numbers and arrays, no structure, no
 * callback. For LabVIEW's Call Library Function node, ctypes, loadlibrary, EPICS and Rust.
 *
 * The library contains piezoid_runtime.c, unchanged, in double precision. A call with a handle
 * that is not open is refused.
 *
 * Threads: piezoid_open and piezoid_close one at a time; piezoid_step of different handles at the
 * same time.
 */
#ifndef PIEZOID_CONTROLLER_H
#define PIEZOID_CONTROLLER_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#ifdef _WIN32
#define PZ_PUBLIC __declspec(dllexport)
#else
#define PZ_PUBLIC __attribute__((visibility("default")))
#endif

/* Largest number of open handles: sixteen stages of four axes in one process. */
#define PZ_HANDLES 64

/* Results below 0: nothing was done, no array was written. */
#define PZ_NO_AXIS (-1)       /* no axis of this number */
#define PZ_NO_PLACE (-2)      /* PZ_HANDLES are open: close one */
#define PZ_NO_HANDLE (-3)     /* this handle is not open */
#define PZ_NO_ARRAY (-4)      /* a null pointer, or fewer than 0 samples */
#define PZ_NO_PARAMETERS (-5) /* piezo_params.h was edited: export again */

/* Number of axes; they are numbered from 0 in the order of README.md. */
PZ_PUBLIC int32_t piezoid_axes(void);

/* Rate at which piezoid_step is called for one axis, Hz; 0 if there is no such axis. */
PZ_PUBLIC double piezoid_rate_Hz(int32_t axis);

/* Open the controller of an axis at rest. Returns a handle above 0.
 *   voltage_V  V       present output of the converter
 *   measured   m or A  present reading; A where the axis regulates a current */
PZ_PUBLIC int32_t piezoid_open(int32_t axis, double voltage_V, double measured);

/* Step one axis through `samples` samples: 1 in a loop, more for a recording. Returns `samples`.
 * Arrays of `samples` elements, as pz_step of piezoid_runtime.h takes and returns them:
 *   reference  m or A
 *   measured   m or A
 *   voltage_V  V       written
 *   status             written: 0, or the bits PZ_STATUS_... of piezoid_runtime.h */
PZ_PUBLIC int32_t piezoid_step(int32_t handle, int32_t samples, const double *reference,
                               const double *measured, double *voltage_V, uint32_t *status);

/* Continue after a latched fault, as pz_reset of piezoid_runtime.h. Returns 0. */
PZ_PUBLIC int32_t piezoid_reset(int32_t handle);

/* Close a handle. Returns 0. */
PZ_PUBLIC int32_t piezoid_close(int32_t handle);

#ifdef __cplusplus
}
#endif

#endif
