"""The bundle: six files that a firmware engineer copies and compiles.

``golden.csv`` contains inputs for every axis and the outputs of the exported source. The firmware
must reproduce them before it drives a stage.
"""

from collections.abc import Mapping
from importlib.resources import files
from types import MappingProxyType

import numpy as np

from piezoid.digests import digest_of_bytes
from piezoid.export.bundle_readme import readme
from piezoid.export.c_header import c_header
from piezoid.export.parameter_file import AxisParameters, ParameterFile, digest_of
from piezoid.numerics.arrays import Array
from piezoid.runtime.controller import Controller
from piezoid.runtime.library import PRECISIONS

COLUMNS = (
    *("axis", "reference", "measured"),
    *("voltage_double_V", "status_double", "voltage_float_V", "status_float"),
)
SAMPLES = 1000

# Samples whose inputs are NaN: one lost reference, three lost measurements.
_LOST_REFERENCE = 601
_LOST_MEASUREMENT = slice(701, 704)

SHIPPED = ("piezoid_runtime.h", "piezoid_runtime.c", "example_main.c")


def runtime_source(name: str) -> bytes:
    """Return a file of the runtime as it was installed, byte for byte."""
    return files("piezoid.runtime").joinpath(name).read_bytes()


def source_digest() -> str:
    """Return the digest of the runtime's source, header first."""
    return digest_of_bytes(
        runtime_source("piezoid_runtime.h") + runtime_source("piezoid_runtime.c")
    )


def bundle(file: ParameterFile) -> Mapping[str, bytes]:
    """Return the files that firmware needs by name; the same input gives the same bytes."""
    digest = digest_of(file)
    texts = {
        "piezo_params.h": c_header(file, digest),
        "golden.csv": golden_csv(file),
        "README.md": readme(file, samples=SAMPLES, digest=digest, source=source_digest()),
    }
    content = {name: runtime_source(name) for name in SHIPPED}
    content.update({name: text.encode() for name, text in texts.items()})
    return MappingProxyType(content)


def golden_csv(file: ParameterFile) -> str:
    """Return the text of golden.csv: SAMPLES rows of each axis, from a start at 0 V.

    The initial reading is the first measurement.
    """
    lines = [",".join(COLUMNS)]
    for index, axis in enumerate(file.axes):
        reference, measured = golden_inputs(axis, np.random.default_rng(index))
        columns = [map(repr, reference.tolist()), map(repr, measured.tolist())]
        for precision in PRECISIONS:
            controller = Controller(axis.values, precision=precision)
            controller.start(0.0, float(measured[0]))
            run = controller.run(reference, measured)
            columns += [map(repr, run.voltage_V.tolist()), map(str, run.status.tolist())]
        lines += [",".join((str(index), *row)) for row in zip(*columns, strict=True)]
    return "\n".join(lines) + "\n"


def golden_inputs(axis: AxisParameters, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return references and measurements that execute every branch of ordinary operation.

    The reference is a sine of growing amplitude over nine tenths of the range. The measurement is
    the delayed reference with noise. Some samples of both are NaN.

    returned  (SAMPLES,) and (SAMPLES,)  m, or A if the axis regulates a current
    """
    swing = np.sin(np.linspace(0, 8 * np.pi, SAMPLES)) * np.linspace(0.1, 1.0, SAMPLES)
    delayed = np.r_[np.zeros(20), swing[:-20]] + rng.normal(0, 0.01, SAMPLES)
    values = axis.values
    if axis.is_tip:
        setpoint_A = float(values["current_reference_A"])
        reference, measured = setpoint_A * np.exp(0.1 * swing), setpoint_A * np.exp(0.2 * delayed)
    else:
        low, high = float(values["reference_minimum_m"]), float(values["reference_maximum_m"])
        centre, half = (low + high) / 2, 0.45 * (high - low)
        reference, measured = centre + half * swing, centre + half * delayed
    reference[_LOST_REFERENCE] = np.nan
    measured[_LOST_MEASUREMENT] = np.nan
    return reference, measured
