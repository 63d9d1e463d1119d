"""Plots for papers: one matplotlib axes for each record, with units in every label.

The plots show the content of records and compute no further results. Without ``ax`` a new figure
has the width of a journal column; the style sheet of the caller determines everything else.
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from piezoid.design.design import Design
from piezoid.design.sensitivity import sensitivities
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.experiment import Plan
from piezoid.errors import PictureError
from piezoid.formatting import scale_for, with_unit, words
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.loop_model import linear_part
from piezoid.identification.model import AxisModel
from piezoid.identification.simulation import Comparison, compare
from piezoid.numerics.arrays import Array
from piezoid.raw_counts import in_counts
from piezoid.records.recording import Quantity, Recording
from piezoid.runtime.schema import METHOD_NAMES
from piezoid.verification.tracking import LoopRecord
from piezoid.verification.verification import Verification

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH_inch, HEIGHT_inch = 5.0, 3.4
MEASURED, MODEL, THIRD, FAINT = "#404040", "#c1440e", "#1f6f8b", "#9a9a9a"
_POINTS = 20_000  # of a line: more than a printed page resolves
_LOOPS = (1.0, 0.6, 0.3)  # of the range of the drive
_SAMPLES = 400  # of half a loop
_DECADES = 4.0


Drawable = (
    Recording
    | ActuatorModel
    | AxisModel
    | Comparison
    | Diagnosis
    | Design
    | Verification
    | LoopRecord
    | Plan
)


def plot(
    record: Drawable,
    kind: str = "",
    *,
    axis: str | None = None,
    recording: Recording | None = None,
    ax: "Axes | None" = None,
) -> "Axes":
    """Draw a record in matplotlib and return the axes.

    record     Recording: displacement over drive (``loop``), or both over time (``time``).
               ActuatorModel, AxisModel: loops (``loop``) or linear ``response``; with a recording,
               measured and predicted ``loop``, or their ``error`` over time.
               Comparison: ``loop`` or ``error``.
               Diagnosis: size of each effect, or its upper bound.
               Design: output sensitivity of each loop over frequency.
               Verification: error over frequency by method (``comparison``), or all ``verdicts``.
               LoopRecord: reference and position over time (``path``), or the ``error``.
               Plan: drive of the next experiment over time.
    kind       default: the first kind in the list above
    axis       of a recording, stage or design with several axes
    recording  to compare with the prediction of the model
    ax         matplotlib axes to draw into; default: a new figure

    Raises ``PictureError`` for another kind or record, or for a missing axis.

    >>> piezoid.plot(recordings["sweep.csv"], "time").get_xlabel()
    'time (s)'
    >>> piezoid.plot(model, recording=recordings["check.csv"]).get_ylabel()
    'displacement of x (µm)'
    >>> piezoid.plot(shipping.verification, "verdicts").get_xlabel()
    'value / limit (1)'
    """
    if isinstance(record, ActuatorModel):
        record = record.one(axis or (recording.axis if recording is not None else None))
    if isinstance(record, AxisModel) and recording is not None:
        record = compare(record, recording)
    match record:
        case Recording():
            axes = _recording(record, _kind("recording", kind, "loop", "time"), axis, ax)
        case AxisModel():
            axes = _axis_model(record, _kind("model", kind, "loop", "response"), ax)
        case Comparison():
            axes = _comparison(record, _kind("comparison", kind, "loop", "error"), ax)
        case Diagnosis():
            axes = _diagnosis(record, ax)
        case Design():
            axes = _design(record, axis, ax)
        case Verification():
            axes = _verification(record, _kind("verification", kind, "comparison", "verdicts"), ax)
        case LoopRecord():
            axes = _closed_loop(record, _kind("closed loop", kind, "path", "error"), ax)
        case Plan():
            axes = _plan(record, ax)
        case _:
            raise PictureError(
                f"no plot of a {type(record).__name__}",
                needed="a recording, model, comparison, diagnosis, design, verification, loop "
                "record or plan",
                remedy="Pass one of those records.",
            )
    counted = getattr(record, "counted", ())
    for panel in axes.figure.axes if counted else ():
        for name in ("title", "xlabel", "ylabel"):
            panel.set(**{name: in_counts(getattr(panel, f"get_{name}")(), counted)})
    return axes


def _recording(recording: Recording, kind: str, axis: str | None, ax: "Axes | None") -> "Axes":
    axis = axis or recording.axis
    voltage_V, time_s = recording.voltage_V(axis), recording.time_s
    channel = recording.find(Quantity.DISPLACEMENT, axis)
    if kind == "loop":
        recording.displacement_m(axis)  # raises without a displacement
    axes = _axes(ax)
    if channel is not None:
        scale, unit = _scaled(channel.values, "m")
        across = voltage_V if kind == "loop" else time_s
        for piece in recording.pieces:
            displacement = scale * channel.values[piece]
            _line(axes, across[piece], displacement, color=MEASURED, linewidth=0.9)
        axes.set(ylabel=f"displacement of {axis} ({unit})")
    if kind == "loop":
        axes.set(xlabel=f"drive of {axis} (V)")
        return axes
    axes.set(xlabel="time (s)")
    drive = axes.twinx() if channel is not None else axes
    _line(drive, time_s, voltage_V, color=THIRD, linewidth=2.2, alpha=0.45)
    drive.set_ylabel(f"drive of {axis} (V)", color=THIRD)
    drive.set_xlabel("time (s)")
    drive.tick_params(axis="y", colors=THIRD)
    drive.spines["top"].set_visible(False)
    axes.set_zorder(drive.get_zorder() + 1)  # draw the displacement in front of the drive
    axes.patch.set_visible(False)
    return axes


def _comparison(comparison: Comparison, kind: str, ax: "Axes | None") -> "Axes":
    axes, axis, drive_V = _axes(ax), comparison.axis, comparison.voltage_V
    if kind == "error":
        unit = _error_line(axes, comparison.time_s, comparison.error_m, "m")
        axes.set(ylabel=f"measured minus predicted, {axis} ({unit})")
    else:
        scale, unit = _scaled(comparison.measured_m, "m")
        measured, predicted = scale * comparison.measured_m, scale * comparison.predicted_m
        _line(axes, drive_V, measured, color=FAINT, linewidth=2.4, label="measured")
        _line(axes, drive_V, predicted, color=MODEL, linewidth=0.8, label="predicted")
        axes.set(xlabel=f"drive of {axis} (V)", ylabel=f"displacement of {axis} ({unit})")
        axes.legend(frameon=False)
    rms, rms_unit = _scaled(np.array([comparison.rms_m]), "m")
    share = f"{comparison.rms_percent:.2f} % of the range"
    title = f"error {rms * comparison.rms_m:.3g} {rms_unit} rms, {share}"
    axes.set_title(title, fontsize="medium")
    return axes


def _axis_model(model: AxisModel, kind: str, ax: "Axes | None") -> "Axes":
    """Draw the loops of a model at three ranges of the drive, or the response of its linear part.

    The loops are quasi-static loops of the hysteresis after one full cycle. The band around the
    largest loop is the 95 % interval of the loading curve.
    """
    axes = _axes(ax)
    if kind == "response":
        system = linear_part(model, None)
        poles_Hz = np.ones(1)
        if len(system.A):
            poles_Hz = np.abs(np.linalg.eigvals(system.A)) / (2.0 * np.pi)
        middle = float(np.log10(np.median(poles_Hz)))
        top = max(float(np.log10(poles_Hz.max())) + 0.7, middle + 0.5 * _DECADES)
        bottom = min(float(np.log10(poles_Hz.min())) - 1.0, top - _DECADES)
        frequency_Hz = np.logspace(bottom, top, 1000)
        magnitude = np.abs(system.response(frequency_Hz)[:, 0, 0])
        scale, unit = _scaled(np.array([float(np.median(magnitude))]), "m")
        axes.loglog(frequency_Hz, scale * magnitude, color=MODEL, linewidth=1.0)
        axes.set(xlabel="frequency (Hz)", ylabel=f"response of {model.axis} ({unit}/V)")
        return axes
    # Closed loops over fractions of the range around its middle, falling first.
    low_V, high_V = model.voltage_V
    operator, loops = model.operator, []
    share_of = np.concatenate([np.linspace(1.0, -1.0, _SAMPLES), np.linspace(-1.0, 1.0, _SAMPLES)])
    for share in _LOOPS:
        half_V = 0.5 * share * (high_V - low_V)
        drive_V = 0.5 * (low_V + high_V) + half_V * share_of
        _, memory_V = operator.run(drive_V, operator.virgin_memory())
        output_m, _ = operator.run(drive_V, memory_V)
        moved_m = model.polarity * (output_m - operator.displacement_offset_m)
        loops.append((drive_V, model.zero_m + moved_m))
    scale, unit = _scaled(loops[0][1], "m")
    uncertainty, (voltage_V, moved_m) = model.uncertainty, loops[0]
    from_middle_V = np.abs(voltage_V - 0.5 * sum(model.voltage_V))
    half_m = np.interp(from_middle_V, uncertainty.reach_V, uncertainty.loading_half_m)
    low, high, half = scale * (moved_m - half_m), scale * (moved_m + half_m), len(voltage_V) // 2
    band: dict[str, Any] = {"color": MODEL, "alpha": 0.2, "linewidth": 0.0}
    axes.fill_between(voltage_V[:half], low[:half], high[:half], label="95 %", **band)
    axes.fill_between(voltage_V[half:], low[half:], high[half:], **band)
    for share, loop, color in zip(_LOOPS, loops, (MODEL, THIRD, MEASURED), strict=True):
        drive_V, displacement_m = loop
        label = f"{100 * share:.0f} % of the range"
        axes.plot(drive_V, scale * displacement_m, color=color, linewidth=1.0, label=label)
    axes.set(xlabel=f"drive of {model.axis} (V)", ylabel=f"displacement of {model.axis} ({unit})")
    axes.legend(frameon=False)
    return axes


def _diagnosis(diagnosis: Diagnosis, ax: "Axes | None") -> "Axes":
    """Draw the rms contribution of each effect: bars for findings, bounds for the others."""
    effects = [(f.effect, f.share * diagnosis.stroke_m) for f in diagnosis.findings]
    absent = [(n.effect, n.upper_bound_m) for n in diagnosis.not_detected if n.upper_bound_m]
    n_found, rows = len(effects), [*effects, *sorted(absent, key=lambda row: -row[1])]
    axes = _axes(ax, height_inch=1.6 + 0.24 * max(len(rows), 3))
    errors = diagnosis.baseline.rms_m, diagnosis.final.rms_m
    marks_m = [diagnosis.noise_floor_rms_m, *errors]
    scale, unit = _scaled(np.array([max(marks_m)]), "m")
    left_m = 0.5 * min(size for size in [*marks_m, *(s for _, s in rows)] if size > 0.0)
    bar: dict[str, Any] = {"left": scale * left_m, "height": 0.6, "color": MODEL}
    mark: dict[str, Any] = {"marker": "<", "color": MEASURED, "markerfacecolor": "white"}
    for index, (_, size_m) in enumerate(rows):
        if index < n_found:
            label = "found" if index == 0 else None
            axes.barh(index, scale * (size_m - left_m), label=label, **bar)
        else:
            label = "not found: upper bound" if index == n_found else None
            axes.plot(scale * size_m, index, label=label, linestyle="none", **mark)
    lines = (
        ("sensor noise", ":", FAINT),
        ("error without effects", "-", FAINT),
        ("error with effects", "--", THIRD),
    )
    for value_m, (label, style, shade) in zip(marks_m, lines, strict=True):
        axes.axvline(scale * value_m, linestyle=style, color=shade, linewidth=1.0, label=label)
    axes.set_xscale("log")
    axes.set_yticks(range(len(rows)), [words(effect) for effect, _ in rows])
    axes.invert_yaxis()
    axes.set(xlabel=f"contribution to the displacement of {diagnosis.axis}, rms ({unit})")
    axes.legend(
        frameon=False, fontsize="small", loc="lower center", bbox_to_anchor=(0.4, 1.0), ncols=3
    )
    return axes


def _design(design: Design, axis: str | None, ax: "Axes | None") -> "Axes":
    """Draw |S_yp| of the nominal plant with the band of the plant family."""
    names = [axis_design.axis for axis_design in design.axes]
    if axis is not None and axis not in names:
        raise PictureError(
            f"no axis {axis!r} in this design",
            needed=f"one of {', '.join(names)}",
            remedy="Name one of these axes.",
        )
    axes = _axes(ax)
    for index, axis_design in enumerate(design.axes if axis is None else (design.axis(axis),)):
        loop, color = axis_design.recommended, f"C{index}"
        nyquist = np.log10(0.5 * loop.members[0].sampling_rate_Hz)
        frequency_Hz = np.logspace(nyquist - _DECADES, nyquist, 600)
        sensitivity = np.stack(
            [np.abs(sensitivities(m, loop.R, loop.S, frequency_Hz).Syp) for m in loop.members]
        )
        level_dB = 20.0 * np.log10(np.maximum(sensitivity, 1e-6))
        label = (
            f"axis {axis_design.axis}, {METHOD_NAMES[loop.method]}, "
            f"bandwidth {with_unit(loop.bandwidth_Hz, 'Hz')}"
        )
        low_dB, high_dB = level_dB.min(axis=0), level_dB.max(axis=0)
        axes.fill_between(frequency_Hz, low_dB, high_dB, color=color, alpha=0.2, linewidth=0)
        axes.plot(frequency_Hz, level_dB[0], color=color, linewidth=1.2, label=label)
        axes.axvline(loop.bandwidth_Hz, color=color, linewidth=0.8, linestyle=":")
    axes.axhline(0.0, color=FAINT, linewidth=0.6)
    axes.set(
        xscale="log",
        xlabel="frequency (Hz)",
        ylabel=r"output sensitivity, $|S_{yp}|$ (dB)",
        ylim=(max(axes.get_ylim()[0], -80.0), axes.get_ylim()[1]),
    )
    axes.legend(frameon=False, fontsize="small")
    return axes


def _verification(verification: Verification, kind: str, ax: "Axes | None") -> "Axes":
    if kind == "verdicts" or not verification.comparison:
        verdicts = [v for v in verification.verdicts if v.limit > 0.0]
        height_inch = 0.9 + 0.2 * max(len(verdicts), 4)
        axes = _axes(ax, width_inch=1.6 * WIDTH_inch, height_inch=height_inch)
        shares = [max(v.value / v.limit, 1e-3) for v in verdicts]
        colors = [THIRD if v.passed else MODEL for v in verdicts]
        axes.barh(range(len(verdicts)), shares, height=0.6, color=colors)
        axes.axvline(1.0, color=MEASURED, linewidth=1.0)
        labels = [f"{v.name} ({v.scenario})" for v in verdicts]
        axes.set_yticks(range(len(verdicts)), labels, fontsize="x-small")
        axes.invert_yaxis()
        axes.set(xscale="log", xlabel="value / limit (1)")
        return axes
    axes = _axes(ax)
    scale, unit = _scaled(np.array([row.rms_m for row in verification.comparison]), "m")
    for index, method in enumerate(dict.fromkeys(row.method for row in verification.comparison)):
        rows = [row for row in verification.comparison if row.method == method]
        rows.sort(key=lambda row: row.frequency_Hz)
        ships = method in verification.methods.values()
        axes.plot(
            [row.frequency_Hz for row in rows],
            [scale * row.rms_m for row in rows],
            marker="o",
            markersize=4.0 if ships else 3.0,
            linewidth=1.8 if ships else 0.9,
            color=MODEL if ships else (MEASURED, THIRD, FAINT)[index % 3],
            label=METHOD_NAMES[method] + (", ships" if ships else ""),
        )
    axes.set(xscale="log", yscale="log", xlabel="turns of the spiral per second (Hz)")
    axes.set(ylabel=f"position error, rms ({unit})")
    axes.legend(frameon=False, fontsize="small")
    return axes


def _closed_loop(loop: LoopRecord, kind: str, ax: "Axes | None") -> "Axes":
    axes, quantity = _axes(ax), "current" if loop.unit == "A" else "position"
    if kind == "error":
        unit = _error_line(axes, loop.time_s, loop.error, loop.unit)
        axes.set(ylabel=f"reference minus {quantity}, {loop.axis} ({unit})")
        return axes
    scale, unit = _scaled(loop.reference, loop.unit)
    reference, position = scale * loop.reference, scale * loop.position
    _line(axes, loop.time_s, reference, color=FAINT, linewidth=2.4, label="reference")
    _line(axes, loop.time_s, position, color=MODEL, linewidth=0.8, label=quantity)
    axes.set(xlabel="time (s)", ylabel=f"{quantity} of {loop.axis} ({unit})")
    axes.legend(frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return axes


def _plan(plan: Plan, ax: "Axes | None") -> "Axes":
    axes, drive = _axes(ax), plan.drive
    time_s = np.arange(len(drive.voltage_V)) / drive.sampling_rate_Hz
    _line(axes, time_s, drive.voltage_V, color=MEASURED, linewidth=0.9)
    for end_V in (plan.limits.voltage_min_V, plan.limits.voltage_max_V):
        axes.axhline(end_V, color=FAINT, linewidth=0.8, linestyle=":")
    title = f"{drive.name}: {' against '.join(plan.question.effects)}"
    axes.set(xlabel="time (s)", ylabel=f"drive of {plan.axis} (V)", title=title)
    return axes


def _axes(
    ax: "Axes | None", *, width_inch: float = WIDTH_inch, height_inch: float = HEIGHT_inch
) -> "Axes":
    if ax is not None:
        from matplotlib.axes import Axes

        if not isinstance(ax, Axes):
            raise PictureError(
                f"ax is of type {type(ax).__name__}",
                needed="matplotlib axes",
                remedy="Pass one of the axes that matplotlib.pyplot.subplots returned.",
            )
        return ax
    import matplotlib.pyplot as plt

    _, axes = plt.subplots(figsize=(width_inch, height_inch), dpi=150, layout="constrained")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    return axes


def _kind(record: str, kind: str, *kinds: str) -> str:
    """Return the requested kind of plot, or the first kind of the record."""
    if kind and kind not in kinds:
        raise PictureError(
            f"{record}: kind {kind!r}",
            needed=f"one of {', '.join(kinds)}",
            remedy="Pass one of these kinds.",
        )
    return kind or kinds[0]


def _scaled(values: Array, base: str) -> tuple[float, str]:
    """Return the factor and the unit with the prefix that suits the largest value."""
    scale = scale_for(float(np.abs(values).max(initial=0.0)), base)
    return 1.0 / scale.factor, scale.unit


def _line(axes: "Axes", x: Array, y: Array, **style: Any) -> None:
    """Draw a curve with at most about ``_POINTS`` points."""
    step = max(1, len(x) // _POINTS)
    axes.plot(x[::step], y[::step], **style)


def _error_line(axes: "Axes", time_s: Array, error: Array, base: str) -> str:
    """Draw an error over time and return its unit."""
    scale, unit = _scaled(error, base)
    _line(axes, time_s, scale * error, color=MODEL, linewidth=0.8)
    axes.axhline(0.0, color=FAINT, linewidth=0.6)
    axes.set(xlabel="time (s)")
    return unit
