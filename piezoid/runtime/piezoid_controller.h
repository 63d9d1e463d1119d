/* The controllers of a stage as a shared library: plain numbers and arrays, no structure, no
 * callback. For LabVIEW's Call Library Function node, ctypes, loadlibrary, EPICS and Rust.
 *
 * The code inside is piezoid_runtime.c, unchanged, in double precision. Handles are numbers, and
 * every call with one that is not open is refused, so that a wrong wire costs no process.
 *
 * Threads: pz_open and pz_close one at a time; pz_step of different handles at the same time.
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

/* So many controllers may be open at once: sixteen stages of four axes in one process. */
#define PZ_HANDLES 64

/* Answers below 0: nothing was done, no array was written. */
#define PZ_NO_AXIS (-1)       /* no axis of this number */
#define PZ_NO_PLACE (-2)      /* PZ_HANDLES are open: close one */
#define PZ_NO_HANDLE (-3)     /* this handle is not open */
#define PZ_NO_ARRAY (-4)      /* a null pointer, or fewer than 0 samples */
#define PZ_NO_PARAMETERS (-5) /* piezo_params.h was edited: export again */

/* How many axes there are; they are numbered from 0 in the order of the README. */
PZ_PUBLIC int32_t pz_axes(void);

/* How often pz_step must be called for one axis, Hz; 0 where there is no such axis. */
PZ_PUBLIC double pz_rate_Hz(int32_t axis);

/* Open the controller of an axis at rest where converter and sensor are: a handle above 0.
 *   voltage_V  V       what the converter puts out now
 *   measured   m or A  what the sensor shows now */
PZ_PUBLIC int32_t pz_open(int32_t axis, double voltage_V, double measured);

/* So many samples of one axis, one after the other: 1 in a loop, more against a recording.
 *   reference  m or A  (samples,)  wanted; A where the axis regulates a current
 *   measured   m or A  (samples,)  what the sensor shows
 *   voltage_V  V       (samples,)  written: what to put out, always finite and inside the limits
 *   status             (samples,)  written: 0, or the bits PZ_STATUS_... of piezoid_runtime.h
 * Answers with the number of samples. */
PZ_PUBLIC int32_t pz_step(int32_t handle, int32_t samples, const double *reference,
                          const double *measured, double *voltage_V, uint32_t *status);

/* An operator has looked: what latched may go on. Answers with 0. */
PZ_PUBLIC int32_t pz_reset(int32_t handle);

/* Give the place back. Answers with 0. */
PZ_PUBLIC int32_t pz_close(int32_t handle);

#ifdef __cplusplus
}
#endif

#endif
