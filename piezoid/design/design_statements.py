"""Statements about controllers: limits of their bandwidth, and bounds that are not useful."""

import numpy as np

from piezoid.design.certificate import error_parts_m, useful_bound_m
from piezoid.design.design import AxisDesign, Design
from piezoid.design.lateral_task import FIRST_MODE, unseen
from piezoid.design.specification import BEYOND
from piezoid.formatting import significant, with_unit
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.dynamics.bandwidth import CHIRP_AMPLITUDE, CHIRP_SAMPLES, CLEAR_PEAK
from piezoid.identification.loop_model import linear_part
from piezoid.identification.model import AxisModel
from piezoid.statement import Level, Statement, limit

_LINES = 1000
# Motion over the sensor noise at which a chirp is visible: a chirp of 6 s with 79 nm at rest,
# above a mode at 400 Hz and in noise of 2.2 nm, was coherent up to 1.2 kHz.
_VISIBLE = 4.0
_WIDER = 1.5  # a smaller gain of the band is not worth a recording


def design_statements(design: Design, model: ActuatorModel) -> tuple[Statement, ...]:
    """Return the statements about the controllers of a stage, most important first."""
    statements = [
        statement
        for axis_design in design.axes
        if (axis := model.axes.get(axis_design.axis)) is not None
        for statement in (*_bandwidth(axis_design, axis), *_error_bound(axis_design, axis))
    ]
    decoupling = "" if design.decoupling is None else design.decoupling.text
    for remark in design.remarks:
        level = Level.NOTE if remark == decoupling else Level.WARNING
        statements.append(limit(level, "design", remark))
    return tuple(sorted(statements, key=lambda statement: -statement.level))


def bandwidth_limit_Hz(design: AxisDesign, axis: AxisModel) -> float | None:
    """Return the largest bandwidth that is tried, or None without a limit by unseen modes."""
    is_guarded = any(template.name == BEYOND for template in design.specification.templates)
    return unseen(axis).fastest_Hz if is_guarded else None


def _bandwidth(design: AxisDesign, axis: AxisModel) -> list[Statement]:
    if bandwidth_limit_Hz(design, axis) is None:
        return []
    bandwidth_Hz = design.recommended.bandwidth_Hz
    rate_Hz, unseen_modes = design.sampling_rate_Hz, unseen(axis)
    chirp_Hz, level = rate_Hz / CHIRP_SAMPLES, Level.ACTION
    record = f"{_chirp(axis, chirp_Hz)}, less through a resonance."
    resonance_Hz = axis.unfitted_resonance_Hz
    stated_Hz = None if axis.bandwidth is None else axis.bandwidth.stated_Hz
    text = f"Bandwidth limited to {with_unit(bandwidth_Hz, 'Hz')}: "
    if unseen_modes.peak < FIRST_MODE:
        record = _chirp_above_modes(axis, chirp_Hz, unseen_modes.from_Hz)
        level = Level.ACTION if record else Level.NOTE
        text = (
            f"Designed for {with_unit(bandwidth_Hz, 'Hz')}; design.toml may request more "
            f"(bandwidth_Hz). Above {with_unit(unseen_modes.from_Hz, 'Hz')} no recorded response "
            "is coherent with its drive, which limits the control effort. "
            f"{record or 'The motion of a small chirp there is lost in the sensor noise.'}"
        )
    elif resonance_Hz is not None:
        text += f"the resonance near {with_unit(resonance_Hz, 'Hz', 3)} could not be fitted."
    elif stated_Hz is None:
        text += (
            f"no resonance was recorded. {record} Or state bandwidth_Hz under [actuator] in "
            "lab.toml."
        )
    else:
        if stated_Hz > chirp_Hz:
            record = (
                f"Its chirp cannot be sampled at {with_unit(rate_Hz, 'Hz', 3)}: use a faster "
                f"recorder, at {with_unit(CHIRP_SAMPLES * stated_Hz, 'Hz', 3)} or more."
            )
        text += f"the stated {with_unit(stated_Hz, 'Hz', 3)} was not recorded. {record}"
    return [limit(level, "bandwidth", text, axis=design.axis, value=bandwidth_Hz, unit="Hz")]


def _chirp(axis: AxisModel, end_Hz: float, start: str = "up ") -> str:
    """Return the chirp to record, up to a frequency, as a sentence without its full stop."""
    amplitude_V = CHIRP_AMPLITUDE * (axis.voltage_V[1] - axis.voltage_V[0])
    return (
        f"Record a small chirp {start}to {with_unit(end_Hz, 'Hz', 2)}, sampled at "
        f"{with_unit(CHIRP_SAMPLES * end_Hz, 'Hz', 2)} or faster, with an amplitude of about "
        f"{with_unit(amplitude_V, 'V', 2)}"
    )


def _chirp_above_modes(axis: AxisModel, chirp_Hz: float, seen_Hz: float) -> str:
    """Return the chirp that shows more of the response than recorded, a sentence, or ''.

    It begins above the modes, where its motion is that of a slow drive or less, and ends where its
    motion is no longer visible in the sensor noise.
    """
    frequency_Hz = np.geomspace(1.0, chirp_Hz, _LINES)
    gain_m_per_V = np.abs(linear_part(axis, None).response(frequency_Hz)[:, 0, 0])
    amplitude_V = CHIRP_AMPLITUDE * (axis.voltage_V[1] - axis.voltage_V[0])
    is_visible = amplitude_V * gain_m_per_V > _VISIBLE * axis.quality.noise_rms_m
    is_amplified = gain_m_per_V > CLEAR_PEAK * gain_m_per_V[0]
    end_Hz, start_Hz = (
        float(frequency_Hz.max(where=where, initial=0.0)) for where in (is_visible, is_amplified)
    )
    if end_Hz < _WIDER * max(seen_Hz, start_Hz):
        return ""
    start = f"from {with_unit(start_Hz, 'Hz', 2)} " if start_Hz else "up "
    return f"{_chirp(axis, end_Hz, start)}."


def _error_bound(design: AxisDesign, axis: AxisModel) -> list[Statement]:
    certificate = design.recommended.certificate
    if certificate is None:
        text = "The error of the loop has no bound, because no bound of the hysteresis is known."
        return [limit(Level.WARNING, "guaranteed_error", text, axis=design.axis)]
    if not certificate.is_guaranteed:
        gain = certificate.small_gain
        text = (
            f"Small gain is {significant(gain)}, not below 1: stability of the loop with "
            "hysteresis is not proven."
        )
        return [limit(Level.WARNING, "small_gain", text, axis=design.axis, value=gain, unit="1")]
    if useful_bound_m(certificate, axis) is not None:
        return []
    parts_m = error_parts_m(certificate)
    largest = max(parts_m, key=lambda name: parts_m[name])
    error_m = certificate.guaranteed_error_m
    text = (
        f"No useful bound of the error: the proven limit, {with_unit(error_m, 'm')}, exceeds a "
        f"tenth of the {with_unit(axis.quality.range_m, 'm')} range. Most of it, "
        f"{with_unit(parts_m[largest], 'm')}, comes from {largest}. It adds up worst cases; "
        "piezoid verify --bounds computes the probable error."
    )
    warning = Level.WARNING
    return [limit(warning, "guaranteed_error", text, axis=design.axis, value=error_m, unit="m")]
