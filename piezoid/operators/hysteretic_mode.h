/* One mode whose spring is hysteretic: the memory stands inside the loop of the motion.
 *
 *   m y'' + c y' + k y + k2 y^2 + k3 y^3 + h s + sum_i w_i e_i = f
 *   s' = y' (1 - |s|^n (gamma + beta sgn(s y')))        Bouc-Wen state
 *   e_i = stop of y of half-width r_i                   Maxwell slip, Iwan's elements
 *
 * Nothing is allocated, nothing is kept.
 */
#ifndef PIEZOID_HYSTERETIC_MODE_H
#define PIEZOID_HYSTERETIC_MODE_H

#include <stddef.h>

/* Runge-Kutta steps of fourth order. A stop is followed from where its last step ended, so it is
 * exact for every step in which y does not turn.
 *   steps      per sample
 *   step_s     of one of them, s
 *   force      (2 steps (samples - 1) + 1,)  f at the ends and in the middle of every step
 *   held       the force jumps at each sample: the middle of a step is its end as well
 *   mass_to_cubic   m, c, k, k2, k3
 *   bouc_wen   h, beta, gamma, n
 *   limit      |y| beyond which the motion has left all bounds: the rest of y is infinite
 *   threshold_m, weight   (stops,)  r_i, w_i
 *   state      (3 + stops,)  y, y', s, e_i: in at the first sample, out at the last
 *   y_m        (samples,)  out
 */
void pk_hysteretic_mode(size_t samples, size_t steps, double step_s, int held, const double *force,
                        const double *mass_to_cubic, const double *bouc_wen, double limit,
                        size_t stops, const double *threshold_m, const double *weight,
                        double *state, double *y_m);

#endif
