"""Forward model of envelope, plays, dead zones, lag and sensor, with all its derivatives.

y = Psi(h),  h = w_0 gamma(u) + sum_i w_i z_i,  sigma = Psi'(h),  a_i = dz_i/dz_i(0)

dy/ds_j     = sigma d_j sum_(i>=j) w_i a_i
dy/dd_j     = sigma sum_(i>=j) w_i (dz_i/dr_i + a_i s_j)
dy/dw_i     = sigma z_i
dy/dknot_k  = the change of slope at the knot if h is beyond it, else 0
dy/dslope_k = the part of h inside segment k
dy/dg_k     = sigma (w_0 c_k(u) + sum_i w_i c_k(u_i)), c_k the part of the drive inside segment k
              of gamma, u_i the drive at which play i last moved

Knots are parametrised by the gaps between them, outwards from 0: a gap moves all knots beyond it.
"""

import ctypes
from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array, Samples
from piezoid.operators.dead_zone import LINEAR, DeadZones
from piezoid.operators.filters import FirstOrder
from piezoid.operators.library import KERNELS, address, contiguous

TILE = 32  # PK_CHAIN_TILE of chain.h


class _Chain(ctypes.Structure):
    _fields_ = (
        ("plays", ctypes.c_size_t),
        *((name, ctypes.c_void_p) for name in ("threshold", "weight", "gap", "memory_slope")),
        ("zones", ctypes.c_void_p),
        ("envelope_knots", ctypes.c_size_t),
        ("envelope_knot", ctypes.c_void_p),
        ("has_delay", ctypes.c_int),
        ("share", ctypes.c_double),
        ("rate_Hz", ctypes.c_double),
        # To p, b0, b1 and their derivatives by the time constant.
        ("lag", ctypes.c_void_p),
        ("sensor", ctypes.c_void_p),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Chain:
    """Hysteresis, lag and sensor from the drive to the reading, in consistent units.

    gap           (plays,)      d: r_i = d_1 + ... + d_i are the thresholds of the moving plays
    weight        (plays + 1,)  w, beginning with the play of threshold 0
    memory_slope  (plays,)      s: z_i(0) = gamma(u(0)) + sum_(j<=i) d_j s_j
    zones         Psi
    envelope      gamma, in front of the plays, with knots symmetric about 0
    share         weight of the previous sample (fractional delay); None: no delay
    lag, sensor   first-order filters at the output, or None
    rate_Hz       samples per second
    """

    gap: Array
    weight: Array
    memory_slope: Array
    zones: DeadZones
    envelope: DeadZones = LINEAR
    share: float | None = None
    lag: FirstOrder | None = None
    sensor: FirstOrder | None = None
    rate_Hz: float = 1.0

    @property
    def plays(self) -> int:
        """Number of moving plays."""
        return len(self.gap)

    @property
    def columns(self) -> int:
        """Number of columns of ``Following.rows`` without the derivatives by the memory."""
        zones, knots = len(self.zones.threshold) - 1, self.envelope.zero
        return 2 * self.plays + 1 + 2 * zones + 2 * knots + 2


class Following:
    """State of a chain along one segment, advanced chunk by chunk."""

    def __init__(self, chain: Chain, first_drive: float) -> None:
        """Start at rest at the first drive, with the initial state of the chain."""
        plays, columns = chain.plays, chain.plays + chain.columns
        self.chain = chain
        self._carry = np.zeros(4 * plays + 5 * columns)
        self._carry[2 * plays : 3 * plays] = 1.0
        self._carry[3 * plays : 4 * plays] = first_drive
        inner = float(chain.envelope.run(np.array([first_drive]))[0])
        self._carry[:plays] = inner + np.cumsum(chain.gap * chain.memory_slope)
        self._tile = np.empty((TILE + 1) * columns)
        self._is_started = False
        # The kernel's view of the chain, and the arrays that it points to.
        arrays = [
            contiguous(values)
            for values in (np.cumsum(chain.gap), chain.weight, chain.gap, chain.memory_slope)
        ]
        knot = contiguous(chain.envelope.threshold[chain.envelope.zero + 1 :])
        zones = chain.zones.kernel_map()
        filters = [
            None if lag is None else np.array([*lag.coefficients, *lag.by_time])
            for lag in (chain.lag, chain.sensor)
        ]
        self._view = _Chain(
            chain.plays,
            *(address(values) for values in arrays),
            ctypes.addressof(zones),
            len(knot),
            address(knot),
            int(chain.share is not None),
            chain.share or 0.0,
            chain.rate_Hz,
            *(address(coefficients) for coefficients in filters),
        )
        self._referenced = (arrays, knot, zones, filters)

    def rows(self, drive: Array, samples: Samples, out: Array) -> None:
        """Write the reading and its derivatives at some samples, and advance the state.

        drive    (samples,)  next samples of the segment
        samples  (rows,)     indices of the rows to write, in order; may repeat
        out      (rows, >= plays + columns)  column-major; the first ``plays`` columns are the
                 derivatives by the memory slopes, the last ``columns`` those by gaps, weights,
                 zones, envelope and lag, and the reading; columns between them are not changed
        """
        chain = self.chain
        u = contiguous(drive)
        inner_drive = u if chain.envelope is LINEAR else chain.envelope.run(u)
        index = np.ascontiguousarray(samples, dtype=np.uintp)
        rows = len(index)
        if rows and (index[-1] >= len(u) or (index[1:] < index[:-1]).any()):
            raise TypeError("rows must be samples of this chunk, in order")
        if out.dtype != np.float64 or not out.flags.f_contiguous or len(out) != rows:
            raise TypeError("rows need float64 columns of as many rows")
        if out.shape[1] < chain.plays + chain.columns:
            raise TypeError(f"rows have {chain.plays + chain.columns} columns")
        first = out.ctypes.data
        KERNELS.pk_chain_rows(
            int(self._is_started),
            len(u),
            address(u),
            address(inner_drive),
            ctypes.addressof(self._view),
            rows,
            index.ctypes.data,
            address(self._carry),
            address(self._tile),
            rows,
            first,
            first + 8 * rows * (out.shape[1] - chain.columns),
        )
        self._is_started = True
