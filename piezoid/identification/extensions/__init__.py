"""Extensions of an axis model: creep, delay, drift, resonance, sensor error and so on.

``EXTENSIONS`` is the order in which a model applies them, upstream first. Start at extension.py.
To add an extension, add a file and a line below. An extension that only one effect uses may be
defined in the file of that effect instead, and acts behind all others.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from piezoid.identification.extensions.amplifier_limits import AmplifierLimits, SlewLimit
from piezoid.identification.extensions.creep_ladder import CreepLadder
from piezoid.identification.extensions.cross_axis import CrossAxis
from piezoid.identification.extensions.extension import Extension
from piezoid.identification.extensions.gain_change import GainChange
from piezoid.identification.extensions.lags import ConverterHold, Delay, FirstOrderLag
from piezoid.identification.extensions.linear_mode import LinearMode
from piezoid.identification.extensions.mains_lines import MainsLines
from piezoid.identification.extensions.periodic_error import PeriodicError
from piezoid.identification.extensions.rate_dependence import RateDependence
from piezoid.identification.extensions.thermal_drift import ThermalDrift
from piezoid.record_json import RecordLayout, fields_of, from_fields

EXTENSIONS: tuple[type[Extension], ...] = (
    SlewLimit,
    AmplifierLimits,
    RateDependence,
    CreepLadder,
    GainChange,
    LinearMode,
    FirstOrderLag,
    Delay,
    ConverterHold,
    CrossAxis,
    ThermalDrift,
    MainsLines,
    PeriodicError,
)


def in_order(extensions: Iterable[Extension]) -> tuple[Extension, ...]:
    """Return extensions in the order in which a model applies them."""
    order = {extension_type.kind: number for number, extension_type in enumerate(EXTENSIONS)}
    return tuple(sorted(extensions, key=lambda extension: order.get(extension.kind, len(order))))


def _extension(entry: Mapping[str, Any]) -> Extension:
    """Read one extension back by its kind; ``ValueError`` for an unknown kind."""
    kind = entry["kind"]
    for extension_type in (*EXTENSIONS, *Extension.__subclasses__()):
        if extension_type.kind == kind:
            return from_fields(extension_type, entry)
    raise ValueError(f"extension kind {kind!r}")


LAYOUT_OF_EXTENSIONS = RecordLayout(
    kind=Extension,
    write=lambda extension: {"kind": extension.kind, **fields_of(extension)},
    read=_extension,
)
