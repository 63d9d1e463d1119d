/* States along a signal: filters, a slew limit, thermal activation, Bouc-Wen and friction states;
 * and sums of polynomials of states. Columns are column-major: column i starts at i * stride.
 *
 * No memory is allocated. A function without a state among its arguments starts at its first
 * sample. The states of pk_bouc_wen and pk_friction are those at the first sample: to process a
 * signal in parts, the last sample of a part is the first of the next.
 */
#ifndef PIEZOID_STATES_H
#define PIEZOID_STATES_H

#include <stddef.h>

/* Sum of first-order filters of one signal.
 *   output[k] = sum_i y_i[k],   y_i[k] = pole_i y_i[k-1] + b0_i x[k] + b1_i x[k-1]
 *   state (rungs,)  in/out: y before the first sample; the input is constant before it
 */
void pk_ladder(size_t samples, const double *input, size_t rungs, const double *pole,
               const double *b0, const double *b1, double *state, double *output);

/* Limit the change from sample to sample to `step`; output must not alias input. */
void pk_slew(size_t samples, const double *input, double step, double *output);

/* Thermally activated motion:
 *   lag[k] = scale atanh(step tanh((lag[k-1] + x[k] - x[k-1]) / scale)),   output = x - lag */
void pk_activated(size_t samples, const double *input, double step, double scale, double *output);

/* Bouc-Wen states along an input, by midpoint steps of at most `max_step`:
 *   dz/du = 1 - |z|^exponent (gamma + beta sgn(z du))
 *   law    (states, 3)        beta, gamma and exponent of each
 *   state  (states,)          in/out
 *   output (samples, states)  row by row
 */
void pk_bouc_wen(size_t samples, const double *input, size_t states, const double *law,
                 double max_step, double *state, double *output);

/* Friction states, each with a reach r and a power n = 1, 2 or 3 of the input,
 *   dx = d(u^n) - |du| x / r;    between samples, with s = sgn(du),
 *   x[k] = q(u[k]) + (x[k-1] - q(u[k-1])) exp(-|du| / r),
 *   q = s r,   2 s r u - 2 r^2,   3 s r u^2 - 6 r^2 u + 6 s r^3
 *   reach, power  (states,)  states of equal reach are adjacent, to share the exponential
 *   column_index  (states,)  column of each state
 *   state         (states,)  in: at the first sample; out: at the last one
 *   column        (states, stride)  out
 */
void pk_friction(size_t samples, const double *input, size_t states, const double *reach,
                 const double *power, const double *column_index, double *state, size_t stride,
                 double *column);

/* Add a polynomial of every column, with first coefficients that depend on the input u:
 *   output += sum_i z (c_i1 + u a_i + u^2 b_i + z (c_i2 + u d_i + z (c_i3 + z c_i4))),
 *   z = column_i scale_i
 *   power  (4, columns)   c
 *   bias   (3, columns)   a, b, d
 */
void pk_polynomials(size_t samples, const double *input, size_t columns, size_t stride,
                    const double *column, const double *scale, const double *power,
                    const double *bias, double *output);

#endif
