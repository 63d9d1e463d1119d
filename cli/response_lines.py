"""What is said of a frequency response on the terminal."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from piezoid.records.inspection import Inspection
    from piezoid.records.response_summary import Coupling, PathSummary, Peak

_MOST_PEAKS = 8


def response_lines(inspection: "Inspection") -> list[str]:
    """Return the band, what was measured through, each axis, and how they couple."""
    from piezoid.readable import told

    found = inspection.response
    if found is None:
        return []
    through = " and ".join(found.includes) if found.includes else "neither amplifier nor sensor"
    band = f"{told(found.lowest_Hz, 'Hz')} to {told(found.highest_Hz, 'Hz')}"
    lines = [
        f"  a frequency response, {band}, {found.lines} lines, with the poles of {through} in it",
    ]
    lines += [_path(path, found.lines) for path in found.paths if path.output == path.drive]
    if not inspection.axis_is_named:
        lines.append("  nobody names the axis: x is our name for it")
    lines += [_coupling(coupling) for coupling in found.couplings]
    if found.couplings:
        lines.append("  each axis is fitted by its own response; coupling is told, not controlled")
    return lines


def _path(path: "PathSummary", lines: int) -> str:
    from piezoid.readable import told

    coherent = (
        f"{path.coherent} of {lines} lines coherent" if path.has_coherence else "no coherence"
    )
    if path.peaks:
        peaks = "looks like modes at " + ", ".join(map(_peak, path.peaks[:_MOST_PEAKS]))
        peaks += f" and {len(path.peaks) - _MOST_PEAKS} more" * (len(path.peaks) > _MOST_PEAKS)
    else:
        peaks = "no peak"
    gain = f"{told(path.gain_m_per_V, 'm')}/V at low frequency"
    return f"  axis {path.output}: {gain}, {coherent}, {peaks}"


def _peak(peak: "Peak") -> str:
    from piezoid.readable import significant, told

    quality = "" if peak.quality is None else f" (Q about {significant(peak.quality, 2)})"
    return f"{told(peak.frequency_Hz, 'Hz')}{quality}"


def _coupling(coupling: "Coupling") -> str:
    from piezoid.readable import significant

    low, drive = significant(100.0 * coupling.low, 2), coupling.drive
    text = (
        f"  {coupling.output} moves by {low} % of {drive} when {drive} is driven, at low frequency"
    )
    if coupling.at_mode is not None:
        at_mode = significant(100.0 * coupling.at_mode, 2)
        text += f", and {at_mode} % at the mode of {coupling.drive}"
    return text
