"""Linear dynamics behind the hysteresis: response with its band, coherence, poles."""

import numpy as np
from numpy.typing import NDArray

from piezoid.formatting import UNKNOWN
from piezoid.identification.dynamics.behind_hysteresis import measure_behind_hysteresis
from piezoid.identification.dynamics.excitation import excites_dynamics
from piezoid.identification.dynamics.fit_dynamics import resolved_modes
from piezoid.identification.dynamics.frequency_response import FrequencyResponse
from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.identification.dynamics.records import JointFit
from piezoid.identification.fit_statements import DYNAMICS
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.numerics.frequency import decibel
from piezoid.numerics.robust import NORMAL_95
from piezoid_reports.coupling_figures import coupling_parts
from piezoid_reports.page import Page
from piezoid_reports.parts import Figure, Part, Prose, Section, Table, axis_heading
from piezoid_reports.quantities import number, significant
from piezoid_reports.response_figures import (
    coherence_figure,
    distortion_parts,
    response_figure,
    response_parts,
)

WIDEST = 100.0  # an interval over more than two decades says that the number is not known


def render(page: Page) -> Section | None:
    """Return response and poles of every axis whose dynamics were excited."""
    parts: list[Part] = []
    for axis in page.axes:
        of_axis = _of_axis(page, axis)
        parts += [axis_heading(axis), *of_axis] if of_axis else []
    if page.model.coupled is not None:
        parts += coupling_parts(page, page.model.coupled)
    if not parts:
        return None
    return Section(
        anchor="dynamics",
        title="Dynamics",
        lead="Linear response between the output of the hysteresis and the displacement.",
        parts=tuple(parts),
    )


def _of_axis(page: Page, axis: AxisModel) -> list[Part]:
    parts: list[Part] = []
    if axis.dynamics is not None and axis.response is not None:
        parts += [*response_parts(page, axis, axis.dynamics, axis.response)]
        parts.append(_poles(axis, axis.dynamics))
    elif axis.dynamics is not None:
        parts += [*_figures(page, axis, axis.dynamics), _poles(axis, axis.dynamics)]
    notes = [fact for fact in page.statements if fact.quantity == DYNAMICS]
    parts += [Prose(text=fact.text) for fact in notes if fact.axis == axis.axis]
    parts += [] if axis.joint is None else [*_joint(axis.joint)]
    return parts + distortion_parts(page, axis)


def _figures(page: Page, axis: AxisModel, dynamics: LinearDynamics) -> list[Part]:
    excited = sorted(excites_dynamics(page.recordings, axis.axis), key=lambda pair: -pair[1])
    if not excited:
        return []
    measured = measure_behind_hysteresis(axis, excited[0][0])
    lines = np.flatnonzero(measured.frequency_Hz <= 2.0 * dynamics.band_Hz[1])
    measured = measured.at_lines(lines)
    return [
        _gain(axis, dynamics, measured),
        _phase(axis, dynamics, measured),
        coherence_figure(
            f"Axis {axis.axis}: coherence",
            f"{int((~measured.is_rejected).sum())} of {len(measured.frequency_Hz)} lines lie "
            f"above {significant(measured.least_coherence, 2)}, the least that is used.",
            np.log10(measured.frequency_Hz),
            measured.coherence[:, 0],
            measured.least_coherence,
        ),
    ]


def _gain(axis: AxisModel, dynamics: LinearDynamics, measured: FrequencyResponse) -> Figure:
    level = np.abs(measured.response[:, 0, 0])
    half = NORMAL_95 * np.sqrt(measured.variance[:, 0, 0] / 2.0)
    floor = 1e-3 * float(level[~measured.is_rejected[:, 0]].max())
    low_dB, high_dB, mid_dB = (
        decibel(np.maximum(values, floor)) for values in (level - half, level + half, level)
    )
    low_Hz, high_Hz = dynamics.band_Hz
    return response_figure(
        "gain",
        f"Axis {axis.axis}: gain from the hysteresis' output to the displacement",
        f"Fitted to coherent lines from {number(low_Hz, 'Hz')} to {number(high_Hz, 'Hz')}; "
        f"the cost is {significant(dynamics.cost_ratio)} times what noise alone would leave. The "
        "band is the measurement's 95 % interval.",
        np.log10(measured.frequency_Hz),
        (mid_dB, decibel(np.abs(_modelled(dynamics, measured)))),
        band=(low_dB, high_dB),
    )


def _phase(axis: AxisModel, dynamics: LinearDynamics, measured: FrequencyResponse) -> Figure:
    is_used = ~measured.is_rejected[:, 0]
    everywhere = np.ones(len(is_used), dtype=np.bool_)
    return response_figure(
        "phase",
        f"Axis {axis.axis}: phase",
        "Lines that are not coherent are left out.",
        np.log10(measured.frequency_Hz),
        (
            _degrees(measured.response[:, 0, 0], axis.polarity, is_used),
            _degrees(_modelled(dynamics, measured), axis.polarity, everywhere),
        ),
    )


def _modelled(dynamics: LinearDynamics, measured: FrequencyResponse) -> ComplexArray:
    response: ComplexArray = dynamics.response_as_measured(measured.frequency_Hz)
    return response


def _degrees(response: ComplexArray, polarity: int, is_kept: NDArray[np.bool_]) -> Array:
    """Unwrapped phase, degrees; NaN where a line is not kept."""
    degrees = np.full(len(response), np.nan)
    degrees[is_kept] = np.degrees(np.unwrap(np.angle(polarity * response[is_kept])))
    return degrees


def _poles(axis: AxisModel, dynamics: LinearDynamics) -> Table:
    resolved = resolved_modes(dynamics)
    modes = zip(
        dynamics.mode_frequency_Hz,
        dynamics.mode_frequency_interval_Hz(),
        dynamics.mode_damping,
        dynamics.mode_damping_interval(),
        resolved,
        strict=True,
    )
    rows = [
        (
            "mode" if is_resolved else "mode, standing for what lies outside the band",
            *_with_interval(frequency_Hz, interval_Hz, "Hz"),
            *_with_interval(damping, between, ""),
        )
        for frequency_Hz, interval_Hz, damping, between, is_resolved in modes
    ]
    rows += [
        ("lag", *_with_interval(frequency_Hz, interval_Hz, "Hz"), "", "")
        for frequency_Hz, interval_Hz in zip(
            dynamics.lag_frequency_Hz, dynamics.lag_frequency_interval_Hz(), strict=True
        )
    ]
    rows.append(
        ("delay", *_with_interval(dynamics.delay_s, dynamics.delay_interval_s(), "s"), "", "")
    )
    rows += [
        (f"{declared.name}, declared", number(declared.frequency_Hz, "Hz"), "", "", "")
        for declared in dynamics.declared
    ]
    return Table(
        caption=f"Axis {axis.axis}: poles, 95 % intervals for this structure.",
        columns=("what", "at", "from, to", "damping", "from, to"),
        rows=tuple(rows),
    )


def _joint(joint: JointFit) -> tuple[Part, ...]:
    pieces = zip(joint.recordings, joint.separate_rms_m, joint.joint_rms_m, strict=True)
    return (
        Prose(
            text="Poles and delay above are those of one fit of hysteresis and dynamics together, "
            "with plays as small as the drive that excites the modes; their intervals hold what "
            "leaving those out changes.",
        ),
        Table(
            caption="Residual of the displacement about its straight line, rms.",
            columns=("recording", "fitted separately", "fitted together"),
            rows=tuple((name, number(a, "m"), number(b, "m")) for name, a, b in pieces),
        ),
    )


def _with_interval(value: float, interval: Array, unit: str) -> tuple[str, str]:
    if 0.0 < interval[0] < interval[1] / WIDEST:
        return number(float(value), unit), UNKNOWN
    low, high = (number(float(end), unit) for end in interval)
    return number(float(value), unit), f"{low}, {high}"
