"""What may be sent to the converters, and what is: limits, and a drive as CSV."""

from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array, frozen


@dataclass(frozen=True, kw_only=True)
class DriveLimits:
    """What amplifier and actuator bear; every waveform is made to stay inside.

    voltage_min_V    lowest voltage
    voltage_max_V    highest voltage
    slew_V_per_s     largest rate of change, > 0
    """

    voltage_min_V: float
    voltage_max_V: float
    slew_V_per_s: float

    def __post_init__(self) -> None:
        if not (self.voltage_max_V > self.voltage_min_V and self.slew_V_per_s > 0):
            raise ValueError(f"limits must be ordered and the slew positive, found {self}")


@dataclass(frozen=True, kw_only=True, eq=False)
class Drive:
    """What to send to the converters, one column per axis.

    name              of the experiment
    why               one sentence: what it will show
    sampling_rate_Hz  > 0
    axes              names of the driven axes
    voltage_V         (samples, axes)
    period_samples    length of one period; 0 where nothing repeats
    periods           how many, the first of which is for settling
    """

    name: str
    why: str
    sampling_rate_Hz: float
    axes: tuple[str, ...]
    voltage_V: Array
    period_samples: int = 0
    periods: int = 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "voltage_V", frozen(self.voltage_V, "voltage_V", ndim=2))
        if self.voltage_V.shape[1] != len(self.axes):
            raise ValueError(f"{self.voltage_V.shape[1]} columns for axes {self.axes}")

    def to_csv(self) -> str:
        """Return the drive as text: a header with units, then one row per sample.

        Numbers come back exactly; ingest reads the header as it is.
        """
        header = ",".join(["time [s]", *(f"voltage_{axis} [V]" for axis in self.axes)])
        time_s = np.arange(len(self.voltage_V)) / self.sampling_rate_Hz
        rows = np.column_stack([time_s, self.voltage_V]).tolist()
        return "\n".join([header, *(",".join(map(repr, row)) for row in rows)]) + "\n"
