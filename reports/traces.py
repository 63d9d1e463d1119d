"""Drive, measurement and simulation of each recording, sample by sample."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.identification.model import AxisModel
from piezoid.identification.simulation import simulate_fitted_rows, starts_of
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording

WIDE_SHARE = 0.5  # of the widest drive range: above, a recording shows the loop


@dataclass(frozen=True, kw_only=True, eq=False)
class Trace:
    """One recording of one axis and its simulation.

    recording   of this axis
    time_s      (samples,)  s, from the first sample
    voltage_V   (samples,)  V
    measured_m  (samples,)  m; NaN where no displacement was measured: a gap in every curve
    modelled_m  (samples,)  m; NaN in rows that the fit left out
    line_m      (samples,)  m; straight line with the common slope of all recordings of the axis
                and the zero of this one: the model without hysteresis. NaN where modelled_m is
    """

    recording: Recording
    time_s: Array
    voltage_V: Array
    measured_m: Array
    modelled_m: Array
    line_m: Array

    @property
    def used_samples(self) -> int:
        """Number of samples that the fit used."""
        return int(np.isfinite(self.modelled_m).sum())

    @property
    def range_m(self) -> float:
        """Range of the measured displacement."""
        return float(np.nanmax(self.measured_m) - np.nanmin(self.measured_m))

    @property
    def residual_m(self) -> Array:
        """Measured minus modelled, (samples,)."""
        return np.asarray(self.measured_m - self.modelled_m)

    @property
    def line_residual_m(self) -> Array:
        """Measured minus the straight line, (samples,)."""
        return np.asarray(self.measured_m - self.line_m)


def rms(values: Array) -> float:
    """Return the root mean square of the values that are not NaN."""
    return float(np.sqrt(np.nanmean(np.square(values))))


def traces_of(axis_model: AxisModel, recordings: Sequence[Recording]) -> tuple[Trace, ...]:
    """Return a trace for every recording of the axis in the fit, largest residual first.

    Recordings over less than half of the widest drive range come last: they show no full loop.
    """
    fitted = [r for r in recordings if starts_of(axis_model, r)]
    modelled = [simulate_fitted_rows(axis_model, recording) for recording in fitted]
    axis = axis_model.axis
    modelled_pairs = [
        (r.voltage_V(axis)[np.isfinite(m)], r.displacement_m(axis)[np.isfinite(m)])
        for r, m in zip(fitted, modelled, strict=True)
    ]
    covariance = sum(float(np.sum((u - u.mean()) * (y - y.mean()))) for u, y in modelled_pairs)
    variance = sum(float(np.sum((u - u.mean()) ** 2)) for u, _ in modelled_pairs)
    slope = covariance / variance if variance > 0.0 else 0.0
    traces = []
    for recording, modelled_m in zip(fitted, modelled, strict=True):
        voltage_V, measured_m = recording.voltage_V(axis), recording.displacement_m(axis).copy()
        measured_m[list(recording.bridged)] = np.nan
        is_modelled = np.isfinite(modelled_m)
        zero_m = float(np.nanmean((measured_m - slope * voltage_V)[is_modelled]))
        traces.append(
            Trace(
                recording=replace(recording, axis=axis),
                time_s=np.arange(recording.samples) / recording.sampling_rate_Hz,
                voltage_V=voltage_V,
                measured_m=measured_m,
                modelled_m=modelled_m,
                line_m=np.where(is_modelled, zero_m + slope * voltage_V, np.nan),
            )
        )
    ranges_V = {id(trace): float(np.ptp(trace.voltage_V)) for trace in traces}
    min_range_V = WIDE_SHARE * max(ranges_V.values(), default=0.0)
    return tuple(sorted(traces, key=lambda t: (ranges_V[id(t)] < min_range_V, -rms(t.residual_m))))
