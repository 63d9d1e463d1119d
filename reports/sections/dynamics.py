"""Linear dynamics: frequency response with its uncertainty, poles, and coupling of the axes."""

import numpy as np
from numpy.typing import NDArray

from piezoid.formatting import UNKNOWN, interval_digits
from piezoid.identification.coupled.coupled_stage import CoupledStage
from piezoid.identification.dynamics.behind_hysteresis import (
    excites_dynamics,
    measure_response,
    voltage_behind_hysteresis,
)
from piezoid.identification.dynamics.fit_dynamics import resolved_modes
from piezoid.identification.dynamics.frequency_response import FrequencyResponse
from piezoid.identification.dynamics.modal import LinearDynamics, ResponseFit
from piezoid.identification.dynamics.response_fit import measured_response
from piezoid.identification.fit_statements import DYNAMICS
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.numerics.polynomial import decibel
from piezoid.numerics.robust import NORMAL_95
from piezoid.records.frequency_response import MIN_COHERENCE
from piezoid_reports.chart import Canvas, Layer, axis_over, decades_over
from piezoid_reports.page import Page
from piezoid_reports.parts import Figure, Heading, Part, Prose, Section, Table, axis_heading
from piezoid_reports.quantities import MINUS, number, percent, significant

MAX_INTERVAL_RATIO = 100.0  # a wider interval is shown as unknown
OVERESTIMATED = 0.5  # squared residual over that of the noise: less is no agreement with the noise
N_GAINS = 3  # frequencies at which the change of the gain is reported
KINDS = {  # label of the axis, height of the figure in pixels, guide
    "gain": (
        "gain [dB re 1 m/V]",
        Canvas.height,
        "Good: the model has the shape of the measured band. Bad: peaks that the model misses.",
    ),
    "phase": (
        "phase [degrees]",
        260,
        "Good: both fall together. Bad: they part at high frequency, by more than the scatter of "
        "the measured lines (a delay or a declared pole is wrong).",
    ),
}


def render(page: Page) -> Section | None:
    """Return response and poles of every axis with fitted dynamics, and the coupling."""
    parts: list[Part] = []
    for axis in page.axes:
        of_axis: list[Part] = []
        if axis.dynamics is not None:
            of_axis += _response_of(page, axis, axis.dynamics)
            of_axis.append(_poles(axis, axis.dynamics))
        notes = [fact for fact in page.statements if fact.quantity == DYNAMICS]
        of_axis += [Prose(text=fact.text) for fact in notes if fact.axis == axis.axis]
        if axis.joint is not None:
            text = (
                "Poles and delay above are from one fit of hysteresis and dynamics together, with "
                "plays as small as the drive that excites the modes. Their intervals include the "
                "change without those plays, but no fault of the recordings, such as a jump."
            )
            joint = axis.joint
            pieces = zip(joint.recordings, joint.separate_rms_m, joint.joint_rms_m, strict=True)
            residuals = Table(
                caption="Test of this fit, before effects and loop shape are added: residual of "
                "the displacement, each recording about its straight line, rms. The final model "
                "has the residual under Loops.",
                columns=("recording", "fitted separately", "fitted together"),
                rows=tuple((name, number(a, "m"), number(b, "m")) for name, a, b in pieces),
            )
            of_axis += [Prose(text=text), residuals]
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


def _response_of(page: Page, axis: AxisModel, dynamics: LinearDynamics) -> list[Part]:
    """Return gain, phase and coherence of the response to which the dynamics were fitted."""
    if axis.response is not None:
        return response_parts(page, axis, dynamics, axis.response)
    excited = sorted(excites_dynamics(page.recordings, axis.axis), key=lambda pair: -pair[1])
    if not excited:
        return []
    recording, _ = excited[0]
    low_Hz, high_Hz = dynamics.band_Hz
    drive_V = voltage_behind_hysteresis(axis, recording)
    measured = measure_response(drive_V, recording, axis.axis)
    measured = measured.at_lines(np.flatnonzero(measured.frequency_Hz <= 2.0 * high_Hz))
    decades, response = np.log10(measured.frequency_Hz), measured.response
    is_used = ~measured.is_rejected
    modelled = dynamics.response_as_measured(measured.frequency_Hz)
    level, half = np.abs(response), NORMAL_95 * np.sqrt(measured.variance / 2.0)
    floor = 1e-3 * float(level[is_used].max())
    judgement = "good: near 1"
    if dynamics.cost_ratio < OVERESTIMATED:
        judgement = "the noise of the lines is overestimated: a misfit may hide in it"
    low_dB, high_dB, mid_dB = (
        decibel(np.maximum(values, floor)) for values in (level - half, level + half, level)
    )
    return [
        response_figure(
            "gain",
            f"Axis {axis.axis}: gain from the output of the hysteresis to the displacement",
            f"Fitted to coherent lines from {number(low_Hz, 'Hz')} to {number(high_Hz, 'Hz')}; "
            f"the squared residual is {significant(dynamics.cost_ratio)} times that of noise "
            f"alone ({judgement}). Band: 95 % interval of the measurement."
            f"{_content(axis, dynamics)}",
            decades,
            (mid_dB, decibel(np.abs(modelled))),
            band=(low_dB, high_dB),
        ),
        response_figure(
            "phase",
            f"Axis {axis.axis}: phase",
            f"Incoherent lines are left out.{_largest_difference(dynamics, measured)}"
            f"{_content(axis, dynamics)}",
            decades,
            (
                _degrees(response, axis.polarity, is_used),
                _degrees(modelled, axis.polarity, np.ones(len(is_used), dtype=np.bool_)),
            ),
        ),
        coherence_figure(
            f"Axis {axis.axis}: coherence",
            f"{int(is_used.sum())} of {len(measured.frequency_Hz)} lines lie "
            f"above the minimum of {significant(measured.least_coherence, 2)}.",
            decades,
            measured.coherence,
            measured.least_coherence,
        ),
    ]


def _largest_difference(dynamics: LinearDynamics, measured: FrequencyResponse) -> str:
    """Return the largest difference in phase between measurement and model, as a sentence."""
    low_Hz, high_Hz = dynamics.band_Hz
    f = measured.frequency_Hz
    lines = np.flatnonzero(~measured.is_rejected & (f >= low_Hz) & (f <= high_Hz))
    if not len(lines):
        return ""
    ratio = measured.response[lines] / dynamics.response_as_measured(f[lines])
    angles_deg = np.degrees(np.abs(np.angle(ratio)))
    worst = int(angles_deg.argmax())
    return (
        f" Largest difference of the fitted lines: {significant(angles_deg[worst], 2)}° at "
        f"{number(float(f[lines][worst]), 'Hz')}."
    )


def _content(axis: AxisModel, dynamics: LinearDynamics) -> str:
    """Return which declared poles the curve of the model contains."""
    names = [declared.name for declared in dynamics.declared]
    if not names:
        return ""
    poles = "poles" if len(names) > 1 else "pole"
    text = f" The curve of the model contains the declared {poles} of {' and '.join(names)}"
    has_text = axis.bandwidth is not None and axis.bandwidth.fallen_Hz is not None
    return f"{text}; the frequency of {MINUS}3 dB below does not." if has_text else f"{text}."


def _degrees(response: ComplexArray, polarity: int, is_kept: NDArray[np.bool_]) -> Array:
    """Return the unwrapped phase in degrees, NaN for the lines that are left out."""
    degrees = np.full(len(response), np.nan)
    degrees[is_kept] = np.degrees(np.unwrap(np.angle(polarity * response[is_kept])))
    return degrees


def response_parts(
    page: Page, axis: AxisModel, dynamics: LinearDynamics, fit: ResponseFit
) -> list[Part]:
    """Return gain, phase and coherence of a measured response, if its file is available."""
    record = next((r for r in page.responses if r.name == fit.name), None)
    if record is None:
        return []
    record = record if record.axis_is_named else record.renamed(axis.axis)
    path = record.path(axis.axis, axis.axis)
    if path is None:
        return []
    f = record.frequency_Hz
    is_used = path.is_coherent & ~np.isin(f, fit.left_out_Hz)
    measured = fit.factor * measured_response(record, axis.axis, dynamics.declared)
    model = dynamics.response(f)
    if fit.slow is not None:
        model = model * fit.slow.response(f)
    decades = np.log10(f)
    model_deg = np.degrees(np.unwrap(np.angle(axis.polarity * model)))
    # Unwrap the measured phase with the model: lines may be too far apart to unwrap it directly.
    measured_deg = model_deg + np.degrees(np.angle(measured / model))
    parts: list[Part] = [
        response_figure(
            "gain",
            f"Axis {axis.axis}: gain as measured, {record.name}",
            f"{fit.used} of {fit.lines} lines are fitted; largest residual "
            f"{significant(100.0 * fit.left_relative, 2)} % at {number(fit.left_Hz, 'Hz')}.",
            decades,
            (decibel(np.abs(measured)), decibel(np.abs(model))),
            is_used=is_used,
        ),
        response_figure(
            "phase",
            f"Axis {axis.axis}: phase as measured",
            "Lines outside the fit are grey.",
            decades,
            (measured_deg, model_deg),
            is_used=is_used,
        ),
    ]
    if path.coherence is not None:
        title = f"Axis {axis.axis}: coherence as measured"
        numbers = (
            f"{int(is_used.sum())} of {len(f)} lines are used; minimum coherence "
            f"{significant(MIN_COHERENCE, 2)}."
        )
        parts.append(coherence_figure(title, numbers, decades, path.coherence, MIN_COHERENCE))
    return parts


def response_figure(
    kind: str,
    title: str,
    numbers: str,
    decades: Array,
    curves: tuple[Array, Array],
    *,
    is_used: NDArray[np.bool_] | None = None,
    band: tuple[Array, Array] | None = None,
) -> Figure:
    """Draw a measured response and the model over decades of frequency.

    kind     ``gain`` or ``phase``
    curves   measured and modelled, (lines,) each
    is_used  lines that are fitted, None for all; other lines are grey dots
    band     95 % interval of the measurement
    """
    label, height, guide = KINDS[kind]
    measured, model = curves
    x = decades_over("frequency", [decades], "Hz")
    canvas = Canvas(x=x, y=axis_over(label, [*(band or curves[:1]), model], ""), height=height)
    layers: list[Layer] = []
    if band is not None:
        layers.append(canvas.band("rising-band", "measured, 95 %", decades, *band))
    if is_used is not None and not is_used.all():
        layers.append(canvas.dots("left-out", "not fitted", decades[~is_used], measured[~is_used]))
    fitted_points = measured if is_used is None else np.where(is_used, measured, np.nan)
    layers.append(canvas.line("measured", "measured", decades, fitted_points))
    layers.append(canvas.line("model", "model", decades, model))
    return Figure(title=title, caption=numbers, guide=guide, canvas=canvas, layers=tuple(layers))


def coherence_figure(
    title: str, numbers: str, decades: Array, coherence: Array, min_coherence: float
) -> Figure:
    """Draw coherence over decades of frequency, with the minimum for the fit."""
    x = decades_over("frequency", [decades], "Hz")
    canvas = Canvas(x=x, y=axis_over("coherence", [np.array([0.0, 1.0])], ""), height=200)
    return Figure(
        title=title,
        caption=numbers,
        guide="Good: near 1 over the fitted band. Bad: holes (noise, interference, nonlinearity).",
        canvas=canvas,
        layers=(
            canvas.line("measured", "coherence", decades, coherence),
            canvas.line("limit", "minimum", decades[[0, -1]], np.full(2, min_coherence)),
        ),
    )


def _poles(axis: AxisModel, dynamics: LinearDynamics) -> Table:
    modes = zip(
        dynamics.mode_frequency_Hz,
        dynamics.mode_frequency_interval_Hz(),
        dynamics.mode_damping,
        dynamics.mode_damping_interval(),
        resolved_modes(dynamics),
        strict=True,
    )
    rows = [
        (
            "mode" if is_resolved else "mode that represents dynamics outside the band",
            *_with_interval(frequency_Hz, interval_Hz, "Hz", 4),
            *_with_interval(damping, between, ""),
        )
        for frequency_Hz, interval_Hz, damping, between, is_resolved in modes
    ]
    lags = zip(dynamics.lag_frequency_Hz, dynamics.lag_frequency_interval_Hz(), strict=True)
    rows += [("lag", *_with_interval(lag_Hz, between, "Hz"), "", "") for lag_Hz, between in lags]
    delay = _with_interval(dynamics.delay_s, dynamics.delay_interval_s(), "s")
    rows.append(("delay", *delay, "", ""))
    rows += [
        (f"{declared.name}, declared", number(declared.frequency_Hz, "Hz"), "", "", "")
        for declared in dynamics.declared
    ]
    return Table(
        caption=f"Axis {axis.axis}: poles of the linear response, with 95 % intervals for this "
        "number of poles. Controllers use these modes and this delay; a lag far below the modes "
        "represents hysteresis and is left out.",
        columns=("type", "value", "from, to", "damping", "from, to"),
        rows=tuple(rows),
    )


def _with_interval(
    value: float, interval: Array, unit: str, min_digits: int = 3
) -> tuple[str, str]:
    if 0.0 < interval[0] < interval[1] / MAX_INTERVAL_RATIO:
        return number(float(value), unit), UNKNOWN
    digits = max(min_digits, interval_digits(float(interval[0]), float(interval[1])))
    low, high = (number(float(end), unit, digits) for end in interval)
    return number(float(value), unit, digits), f"{low}, {high}"


def coupling_parts(page: Page, coupled: CoupledStage) -> list[Part]:
    """Return the parts of the section about coupled axes."""
    parts: list[Part] = [
        Heading(text="Coupled axes"),
        Prose(
            text="Every drive moves every displacement. After multiplication by the inverse "
            "matrix, each axis responds to its own drive. The other sections show decoupled "
            "displacements."
        ),
        Table(
            caption="Which drive moves which displacement. Displacement per volt of each drive, "
            "and the decoupling matrix, by which references and measurements are multiplied "
            "before the controllers.",
            columns=(
                "displacement",
                *(f"per volt of {name}" for name in coupled.inputs),
                *(f"of {name}" for name in coupled.outputs),
            ),
            rows=tuple(
                (
                    name,
                    *(number(float(v), "m/V") for v in gain),
                    *(significant(float(v), 4) for v in row),
                )
                for name, gain, row in zip(
                    coupled.outputs, coupled.coupling_m_per_V, coupled.decoupling, strict=True
                )
            ),
        ),
        _errors(coupled),
        _modes(coupled),
    ]
    if len(coupled.levels_V) > 1:
        first_Hz = float(coupled.mode_frequency_Hz(float(coupled.levels_V[0])).min())
        f = np.geomspace(coupled.band_Hz[0], 0.5 * first_Hz, N_GAINS)
        changes = [
            f"by {_signed(change)} at {number(float(frequency_Hz), 'Hz')}"
            for frequency_Hz, change in zip(f, coupled.gain_change(f), strict=True)
        ]
        text = f"From the lowest level to the highest the gain changes {', '.join(changes)}."
        parts.append(Prose(text=text))
    if page.verification is not None and (rows := page.verification.coupling):
        parts.append(
            Table(
                caption=f"Compiled controllers at {number(rows[0].frequency_Hz, 'Hz')}: amplitude "
                "of an axis with constant reference, relative to the moving axis.",
                columns=("moving", "constant", "with the matrix", "without it"),
                rows=tuple(
                    (
                        row.moved,
                        row.answers,
                        *(
                            "does not settle" if value is None else f"{significant(value)} %"
                            for value in (row.percent, row.without_percent)
                        ),
                    )
                    for row in rows
                ),
            )
        )
    return parts


def _errors(coupled: CoupledStage) -> Table:
    evaluation = (
        "each realisation left out of the fit once"
        if coupled.error_is_left_out
        else "in sample, because the realisations are too few for leaving one out"
    )
    rows = [
        (
            number(float(level), "V"),
            name,
            percent(float(coupled.error_rms_m[k, i] / coupled.moved_rms_m[k, i])),
            number(float(coupled.error_rms_m[k, i]), "m"),
            percent(float(coupled.noise_rms_m[k, i] / coupled.moved_rms_m[k, i])),
        )
        for k, level in enumerate(coupled.levels_V)
        for i, name in enumerate(coupled.outputs)
    ]
    return Table(
        caption=f"Error of the model at each level of the drive, {evaluation}. Means over the "
        "periods, simulated from the drives alone; the noise is for one period.",
        columns=("level, rms", "displacement", "error", "rms", "noise"),
        rows=tuple(rows),
    )


def _modes(coupled: CoupledStage) -> Table:
    low, high = float(coupled.levels_V[0]), float(coupled.levels_V[-1])
    rows = [
        (
            number(float(low_Hz), "Hz", 4),
            number(float(high_Hz), "Hz", 4),
            ", ".join(number(float(end), "Hz", 4) for end in interval)
            if np.isfinite(interval).all()
            else "",
            significant(float(low_damping)),
            significant(float(high_damping)),
            _signed(change[0]),
            ", ".join(map(_signed, change[1:])) if np.isfinite(change).all() else "",
        )
        for low_Hz, high_Hz, interval, low_damping, high_damping, change in zip(
            coupled.mode_frequency_Hz(low),
            coupled.mode_frequency_Hz(high),
            coupled.mode_frequency_interval_Hz(high),
            coupled.mode_damping(low),
            coupled.mode_damping(high),
            coupled.frequency_change(),
            strict=True,
        )
    ]
    return Table(
        caption=f"Modes at {number(low, 'V')} and {number(high, 'V')} rms, with 95 % intervals.",
        columns=(
            *("at the lowest level", "at the highest", "from, to", "damping", "damping"),
            *("change", "from, to"),
        ),
        rows=tuple(rows),
    )


def _signed(share: float) -> str:
    sign = "+" if share >= 0.0 else MINUS
    return f"{sign}{significant(abs(100.0 * float(share)), 2)} %"
