/* Forward model of envelope, plays, dead zones, lag and sensor, with the derivatives of the
 * reading.
 *
 * Only the requested rows are computed, where the filters allow it. As in kernels.h the caller
 * holds all state, and the results do not depend on the lengths of the chunks, bit for bit.
 */
#ifndef PIEZOID_CHAIN_H
#define PIEZOID_CHAIN_H

#include "kernels.h"

/* Number of rows that are written together. */
#define PK_CHAIN_TILE 32

/* y[k] = pole y[k-1] + b0 x[k] + b1 x[k-1], and the derivatives by the time constant. */
typedef struct {
    double pole, b0, b1;
    double pole_by_s, b0_by_s, b1_by_s;
} pk_filter;

/*   threshold       (plays,)      of the moving plays, without the play of threshold 0
 *   weight          (plays + 1,)  beginning with the play of threshold 0
 *   gap             (plays,)      between neighbouring thresholds
 *   memory_slope    (plays,)      of the memory before the first sample, per gap
 *   zones                         dead zones, as knots and slopes
 *   envelope_knot   (envelope_knots,)  knots of the envelope on either side of 0, outwards
 *   has_delay                     0: rows do not depend on the previous sample
 *   share                         weight of the previous sample: fractional delay
 *   rate_Hz                       samples per second
 *   lag, sensor                   first-order filters at the output, or NULL
 */
typedef struct {
    size_t plays;
    const double *threshold;
    const double *weight;
    const double *gap;
    const double *memory_slope;
    const pk_map *zones;
    size_t envelope_knots;
    const double *envelope_knot;
    int has_delay;
    double share;
    double rate_Hz;
    const pk_filter *lag;
    const pk_filter *sensor;
} pk_chain;

/* Follow a drive and write [memory slopes | gaps | weights | zones | envelope | lag | reading] for
 * some samples; zones are below (gaps, slopes) and then above 0, the envelope likewise. The last
 * row of a chunk is always computed, for the next chunk.
 *   is_started  0 for the first chunk of a piece
 *   drive       (samples,)  input of the envelope
 *   inner       (samples,)  output of the envelope
 *   requested   (rows,)     samples of this chunk, in order; may repeat
 *   carry       (4 plays + 5 columns,)  in/out: z, dz/dr, dz/dz(0) and the drive at the last
 * motion of every play; the previous row; last inputs and outputs of the two filters tile
 * ((PK_CHAIN_TILE + 1) columns,)  buffer memory      (plays, stride)            out: derivatives
 * by the memory slopes column      (columns - plays, stride)  out: the other columns
 */
void pk_chain_rows(int is_started, size_t samples, const double *drive, const double *inner,
                   const pk_chain *chain, size_t rows, const size_t *requested, double *carry,
                   double *tile, size_t stride, double *memory, double *column);

#endif
