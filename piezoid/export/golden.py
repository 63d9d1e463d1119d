"""golden.csv: inputs for every axis, and what the shipped source answers to them.

A firmware engineer's own build must give the same numbers before it meets a stage.
"""

from collections.abc import Sequence

import numpy as np

from piezoid.export.parameter_file import AxisParameters, ParameterFile
from piezoid.numerics.arrays import Array
from piezoid.runtime.controller import Controller
from piezoid.runtime.library import PRECISIONS

COLUMNS = (
    *("axis", "reference", "measured"),
    *("voltage_double_V", "status_double", "voltage_float_V", "status_float"),
)
SAMPLES = 1000

# Where in the record the inputs are not numbers: one lost reference, three lost measurements.
_LOST_REFERENCE = 601
_LOST_MEASUREMENT = slice(701, 704)


def golden_csv(file: ParameterFile) -> str:
    """Return the table: per axis SAMPLES rows, from a start at 0 V and the first measurement.

    The reference swings over nine tenths of the range with growing amplitude, the measurement
    follows it late and with noise; some of either are no numbers.
    """
    lines = [",".join(COLUMNS)]
    for place, axis in enumerate(file.axes):
        reference, measured = inputs(axis, np.random.default_rng(place))
        answers = [_answers(axis, precision, reference, measured) for precision in PRECISIONS]
        rows = zip(reference, measured, *answers, strict=True)
        lines.extend(f"{place},{_row(row)}" for row in rows)
    return "\n".join(lines) + "\n"


def inputs(axis: AxisParameters, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return references and measurements that reach every branch a usual day reaches.

    returned  (SAMPLES,) and (SAMPLES,)  m, or A where the axis regulates a current
    """
    swing = np.sin(np.linspace(0, 8 * np.pi, SAMPLES)) * np.linspace(0.1, 1.0, SAMPLES)
    late = np.r_[np.zeros(20), swing[:-20]] + rng.normal(0, 0.01, SAMPLES)
    values = axis.values
    if axis.method == "rst":
        setpoint_A = float(values["current_reference_A"])
        reference, measured = setpoint_A * np.exp(0.1 * swing), setpoint_A * np.exp(0.2 * late)
    else:
        low, high = float(values["reference_minimum_m"]), float(values["reference_maximum_m"])
        centre, half = (low + high) / 2, 0.45 * (high - low)
        reference, measured = centre + half * swing, centre + half * late
    reference[_LOST_REFERENCE] = np.nan
    measured[_LOST_MEASUREMENT] = np.nan
    return reference, measured


def _answers(
    axis: AxisParameters, precision: str, reference: Array, measured: Array
) -> Sequence[tuple[float, int]]:
    controller = Controller(axis.values, precision=precision)
    controller.start(0.0, float(measured[0]))
    run = controller.run(reference, measured)
    return [(float(u), int(s)) for u, s in zip(run.voltage_V, run.status, strict=True)]


def _row(row: tuple[float, float, tuple[float, int], tuple[float, int]]) -> str:
    reference, measured, *answers = row
    answered = ",".join(f"{voltage!r},{status}" for voltage, status in answers)
    return f"{float(reference)!r},{float(measured)!r},{answered}"
