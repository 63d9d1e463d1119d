/* The inner loops of plays, piecewise-linear maps and their inverses. Columns are column-major:
 * column i starts at i * stride.
 *
 * All state is in arrays of the caller, so that a recording may be processed in chunks of any
 * length with the same result, bit for bit. No memory is allocated.
 */
#ifndef PIEZOID_KERNELS_H
#define PIEZOID_KERNELS_H

#include <stddef.h>

/* Play states of a whole chunk: z = max(u - r, min(u + r, z)).
 *   input_V      (samples,)
 *   threshold_V  (plays,)            half-widths, >= 0
 *   state_V      (plays,)            in: memory before the chunk; out: after it
 *   column_V     (plays, stride)     out: the states after every sample
 */
void pk_play_columns(size_t samples, const double *input_V, size_t plays,
                     const double *threshold_V, double *state_V, size_t stride, double *column_V);

/* Weighted sum of plays, without writing the columns: output[k] = sum_i weight[i] z_i[k].
 * The output may alias the input. */
void pk_play_sum(size_t samples, const double *input_V, size_t plays, const double *threshold_V,
                 const double *weight, double *state_V, double *output);

/* Continuous piecewise-linear map through the origin. Segments meet at knots; knot[zero] == 0.
 *   knot    (knots,)      strictly increasing, contains 0 at index `zero`
 *   slope   (knots + 1,)  slope below knot[0], between knots, above knot[knots - 1]
 */
typedef struct {
    size_t knots;
    const double *knot;
    const double *slope;
    size_t zero;
} pk_map;

/* Apply a map to every sample.
 *   output  (samples,)  value; may alias input
 *   local   (samples,)  slope at each sample, or NULL
 */
void pk_piecewise_linear(size_t samples, const double *input, const pk_map *map, double *output,
                         double *local);

/* Return the value of a map at x, and in *local its slope at x. */
double pk_mapped(double x, const pk_map *map, double *local);

/* Plays between two maps:
 *   output = added + last_map(sum_i weight[i] z_i(first_map(input - subtracted)))
 *   first_map, last_map  NULL: the identity
 *   output               (samples,)  may alias the input
 * The other arguments are those of pk_play_sum. In the forward model `first_map` is the envelope
 * and `last_map` the dead zones, in the inverse the opposite.
 */
void pk_mapped_plays(size_t samples, const double *input, double subtracted,
                     const pk_map *first_map, size_t plays, const double *threshold,
                     const double *weight, double *state, const pk_map *last_map, double added,
                     double *output);

/* Inverse of a sum of rising functions of plays, by bisection to the last bit.
 *   desired     (samples,)  outputs of the sum
 *   step        half-width of play i is i times this
 *   edge, value (edges,), (plays, edges): functions linear between edges, and extrapolated
 *   state       (plays,)    in/out
 *   input       (samples,)  out
 */
void pk_valued_inverse(size_t samples, const double *desired, size_t plays, double step,
                       size_t edges, const double *edge, const double *value, double *state,
                       double *input);

#endif
