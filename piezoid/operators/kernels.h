/* The hot loops of plays, piecewise-linear maps and their inverses. Columns are column-major:
 * column i starts at i * stride.
 *
 * Every function carries its state in the arrays it is given, so a recording may be processed in
 * chunks of any length with the same result, bit for bit. Nothing is allocated, nothing is kept.
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
 * The output may be the input. */
void pk_play_sum(size_t samples, const double *input_V, size_t plays, const double *threshold_V,
                 const double *weight, double *state_V, double *output);

/* Continuous piecewise-linear map through the origin. Segments meet at knots; knot[zero] == 0.
 *   knot    (knots,)      strictly increasing, contains 0 at index `zero`
 *   slope   (knots + 1,)  slope below knot[0], between knots, above knot[knots - 1]
 *   output  (samples,)    value; may alias input
 *   local   (samples,)    slope at each sample, or NULL
 */
void pk_piecewise_linear(size_t samples, const double *input, size_t knots, const double *knot,
                         const double *slope, size_t zero, double *output, double *local);

/* A continuous piecewise-linear map through the origin, as in pk_piecewise_linear. */
typedef struct {
    size_t knots;
    const double *knot;
    const double *slope;
    size_t zero;
} pk_map;

/* Its value at x, and in *local its slope there. */
double pk_mapped(double x, const pk_map *map, double *local);

/* Plays between two maps: output = added + after(sum_i weight[i] z_i(before(input - taken))).
 *   before, after  NULL: nothing is mapped
 *   output         (samples,)  may be the input
 * The rest as in pk_play_sum. Forwards `before` is the envelope and `after` the dead zones; of the
 * inverse it is the other way round.
 */
void pk_mapped_plays(size_t samples, const double *input, double taken, const pk_map *before,
                     size_t plays, const double *threshold, const double *weight, double *state,
                     const pk_map *after, double added, double *output);

/* Inverse of a sum of rising functions of plays, halved until the input is known to the last bit.
 *   wanted      (samples,)
 *   step        half-width of play i is i times this
 *   edge, value (edges,), (plays, edges): functions straight between edges, the outermost going on
 *   state       (plays,)    in/out
 *   found       (samples,)  out
 */
void pk_valued_inverse(size_t samples, const double *wanted, size_t plays, double step,
                       size_t edges, const double *edge, const double *value, double *state,
                       double *found);

#endif
