/* Plays behind an envelope, dead zones, a lag and a sensor, with the derivatives of what is read.
 *
 * Sample by sample, row by row: a row is computed only where somebody asks for it. As in kernels.h
 * all state is in arrays the caller holds, and chunks of any length give the same bits.
 */
#ifndef PIEZOID_CHAIN_H
#define PIEZOID_CHAIN_H

#include "kernels.h"

/* Rows written together. */
#define PK_CHAIN_TILE 32

/* y[k] = pole y[k-1] + b0 x[k] + b1 x[k-1], and how the three change with the time constant. */
typedef struct {
    double pole, b0, b1;
    double pole_by_s, b0_by_s, b1_by_s;
} pk_filter;

/*   threshold     (plays,)      of the moving plays; the play of threshold 0 comes in front
 *   weight        (plays + 1,)  that of threshold 0 first
 *   gap           (plays,)      between neighbouring thresholds
 *   memory_slope  (plays,)      of the memory before the first sample, per gap
 *   zones                       dead zones, as kinks and slopes
 *   bend          (bends,)      kinks of the envelope on either side of 0, outwards
 *   late                        0: no row needs that of the sample before
 *   share                       of the sample before in every row: the rest of a delay
 *   rate_Hz                     samples per second
 *   lag, sensor                 first-order filters behind everything, or NULL
 */
typedef struct {
    size_t plays;
    const double *threshold;
    const double *weight;
    const double *gap;
    const double *memory_slope;
    const pk_map *zones;
    size_t bends;
    const double *bend;
    int late;
    double share;
    double rate_Hz;
    const pk_filter *lag;
    const pk_filter *sensor;
} pk_chain;

/* Follow a drive and write [memory slopes | gaps | weights | zones | envelope | lag | reading] for
 * some samples; zones are below (gaps, slopes) and then above 0, the envelope likewise. The last
 * row of a chunk is always computed, for the one behind it.
 *   begun     0 for the first chunk of a piece
 *   drive     (samples,)  before the envelope; bent (samples,) behind it
 *   wanted    (rows,)     samples of this chunk, in order; one may come more than once
 *   carry     (4 plays + 5 columns,)  in/out: z, dz/dr, dz/dz(0) and the drive when last moved of
 *             every play; the row before; last inputs and outputs of the two filters
 *   tile      ((PK_CHAIN_TILE + 1) columns,)  for the kernel's own use
 *   memory    (plays, stride)            out: by the memory slopes
 *   column    (columns - plays, stride)  out: the others
 */
void pk_chain_rows(int begun, size_t samples, const double *drive, const double *bent,
                   const pk_chain *chain, size_t rows, const size_t *wanted, double *carry,
                   double *tile, size_t stride, double *memory, double *column);

#endif
