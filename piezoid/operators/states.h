/* Motions and states that follow a signal, and sums of polynomials of such states. Columns are
 * column-major: column i starts at i * stride.
 *
 * Nothing is allocated, nothing is kept. A function without a state among its arguments begins at
 * its first sample. Where the first sample is where a state already stands (pk_bouc_wen,
 * pk_friction), a signal may be cut with that sample in both parts; pk_first_order may be cut
 * anywhere.
 */
#ifndef PIEZOID_STATES_H
#define PIEZOID_STATES_H

#include <stddef.h>

/* First-order filters in place, one per column, all with the same coefficients:
 *   y[k] = pole y[k-1] + b0 x[k] + b1 x[k-1]
 *   previous_input, previous_output (columns,)  in/out
 */
void pk_first_order(size_t samples, size_t columns, size_t stride, double *values, double pole,
                    double b0, double b1, double *previous_input, double *previous_output);

/* The sum of first-order filters of one signal, each with its own coefficients.
 *   output[k] = sum_i y_i[k],   y_i[k] = pole_i y_i[k-1] + b0_i x[k] + b1_i x[k-1]
 *   state (rungs,)  y before the first sample, in/out; before it the signal was as it is there
 */
void pk_ladder(size_t samples, const double *input, size_t rungs, const double *pole,
               const double *b0, const double *b1, double *state, double *output);

/* A recursive filter in transposed direct form II, a[0] = 1:
 *   output[k] = sum_i b_i x[k-i] - sum_(i>0) a_i output[k-i],   i = 0 .. order
 *   memory (order + 1,)  in/out, the last one stays zero; output must not alias input
 */
void pk_filter(size_t samples, const double *input, size_t order, const double *b, const double *a,
               double *memory, double *output);

/* A signal that goes at most `step` from sample to sample; output must not alias input. */
void pk_slew(size_t samples, const double *input, double step, double *output);

/* A lag that thermal activation wears down: after every sample
 *   lag[k] = wide atanh(step tanh((lag[k-1] + x[k] - x[k-1]) / wide)),   output = x - lag */
void pk_activated(size_t samples, const double *input, double step, double wide, double *output);

/* Bouc-Wen states along an input, by midpoint steps of at most `longest`:
 *   dz/du = 1 - |z|^exponent (gamma + beta sgn(z du))
 *   law    (states, 3)        beta, gamma and exponent of each
 *   state  (states,)          in/out
 *   output (samples, states)  row by row
 */
void pk_bouc_wen(size_t samples, const double *input, size_t states, const double *law,
                 double longest, double *state, double *output);

/* Friction states, each with a reach r and a power n = 1, 2 or 3 of the input,
 *   dx = d(u^n) - |du| x / r;    over a straight part, s = sgn(du),
 *   x[k] = q(u[k]) + (x[k-1] - q(u[k-1])) exp(-|du| / r),
 *   q = s r,   2 s r u - 2 r^2,   3 s r u^2 - 6 r^2 u + 6 s r^3
 *   reach, power, state (states,)  those of one reach behind each other, to share the exponential
 *   place  (states,)         which column each becomes
 *   state                    in/out: at the first sample, then at the last one
 *   column (states, stride)  out
 */
void pk_friction(size_t samples, const double *input, size_t states, const double *reach,
                 const double *power, const double *place, double *state, size_t stride,
                 double *column);

/* Add a polynomial of every column, whose first coefficient goes with the input u:
 *   output += sum_i z (c_i1 + u a_i + u^2 b_i + z (c_i2 + z (c_i3 + z c_i4))),  z = column_i
 * scale_i power  (4, columns)   c bias   (2, columns)   a, b
 */
void pk_polynomials(size_t samples, const double *input, size_t columns, size_t stride,
                    const double *column, const double *scale, const double *power,
                    const double *bias, double *output);

#endif
