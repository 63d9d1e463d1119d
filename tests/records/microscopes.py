"""Files of microscopes, written after their published formats."""

import struct
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

Rows = np.ndarray


def write_ibw(
    path: Path,
    values: Rows,
    *,
    labels: Sequence[str] = (),
    unit: str = "",
    step: float = 1.0,
    step_unit: str = "",
    note: str = "",
    order: str = "<",
) -> None:
    """Write a wave of version 5 [WaveMetrics, Technical Note 003]: doubles, column by column.

    labels  of the columns; the dimension precedes them without a label
    step    between rows, in ``step_unit``
    """
    data = np.asarray(values, dtype=f"{order}f8").tobytes(order="F")
    shape = (*values.shape, 0, 0, 0, 0)[:4]
    label_cells = [b"", *(name.encode() for name in labels)] if labels else []
    label_bytes = b"".join(name.ljust(32, b"\0") for name in label_cells)
    note_bytes = note.encode()
    wave = struct.pack(
        f"{order}iIIihh6xh32sii4i4d4d4s16shhddi4i4ii64xhhhccIihhii",
        *(0, 0, 0, values.size, 4, 0, 1, b"wave0", 0, 0, *shape),
        *(step, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0),
        unit.encode(),
        step_unit.encode().ljust(4, b"\0"),
        *(0, 0, 0.0, 0.0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, b"\0", b"\0", 0, 0, 0, 0, 0, 0),
    )
    sizes = {0: 320 + len(data), 2: len(note_bytes), 9: len(label_bytes)}
    head = struct.pack(f"{order}hh15i", 5, 0, *(sizes.get(k, 0) for k in range(15)))
    path.write_bytes(head + wave + data + note_bytes + label_bytes)


def write_jpk(path: Path, segments: Sequence[tuple[float, Rows, Rows]]) -> None:
    """Write a force curve as JPK does: zip, Java properties, big-endian integers, conversions.

    segments  duration in s, drive in V and measured height in m of each
    """
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("header.properties", "jpk-data-file=spm-forcefile\n")
        archive.writestr("segments/", "")
        for number, (duration_s, drive_V, height_m) in enumerate(segments):
            segment = f"segments/{number}/"
            archive.writestr(segment, "")
            archive.writestr(
                f"{segment}segment-header.properties",
                f"force-segment-header.duration={duration_s}\n"
                f"force-segment-header.num-points={len(drive_V)}\n"
                + _channel("height", "V", 1e-7, 0.0, "calibrated", 1e-6)
                + _channel("capacitiveSensorHeight", "V", 2e-9, 0.5, "nominal", 8e-6),
            )
            codes = np.round(drive_V / 1e-7).astype(">i4")
            archive.writestr(f"{segment}channels/height.dat", codes.tobytes())
            codes = np.round((height_m / 8e-6 - 0.5) / 2e-9).astype(">i4")
            archive.writestr(f"{segment}channels/capacitiveSensorHeight.dat", codes.tobytes())


def _channel(name: str, unit: str, step: float, offset: float, slot: str, m_per_V: float) -> str:
    encoder, conversion = f"channel.{name}.data.encoder", f"channel.{name}.conversion-set"
    return (
        f"{encoder}.type=signedinteger\n"
        f"{encoder}.scaling.offset={offset}\n{encoder}.scaling.multiplier={step}\n"
        f"{encoder}.scaling.unit.unit={unit}\n"
        f"{conversion}.conversions.base=volts\n{conversion}.conversion.volts.name=Volts\n"
        f"{conversion}.conversion.{slot}.name={slot.title()}\n"
        f"{conversion}.conversion.{slot}.base-calibration-slot=volts\n"
        f"{conversion}.conversion.{slot}.scaling.offset=0.0\n"
        f"{conversion}.conversion.{slot}.scaling.multiplier={m_per_V}\n"
        f"{conversion}.conversion.{slot}.scaling.unit.unit=m\n"
    )
