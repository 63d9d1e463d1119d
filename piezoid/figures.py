"""Pictures for papers, one matplotlib axes for each record: units in every label, ``ax`` accepted.

Nothing is computed here that a record does not hold or say. Without ``ax`` a figure of its own is
made, as wide as a column of a journal; the caller's style sheet holds for everything else.
"""

from collections.abc import Collection
from typing import TYPE_CHECKING

import numpy as np

from piezoid.design.design import AxisDesign, Design, LoopDesign
from piezoid.design.sensitivity import sensitivities
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.experiment import Plan
from piezoid.errors import PictureError
from piezoid.formatting import with_unit, words
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.interchange import linear_part
from piezoid.identification.model import AxisModel
from piezoid.identification.prediction import Comparison, compare
from piezoid.numerics.arrays import Array
from piezoid.raw_counts import in_counts
from piezoid.records.recording import Quantity, Recording
from piezoid.verification.closed_loop import LoopRecord
from piezoid.verification.verification import Verification

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH_inch, HEIGHT_inch = 5.0, 3.4
MEASURED, MODEL, THIRD, FAINT = "#404040", "#c1440e", "#1f6f8b", "#9a9a9a"
_POINTS = 20_000  # of a line: more than any page resolves
_PREFIXES = ((1e-12, "p"), (1e-9, "n"), (1e-6, "µ"), (1e-3, "m"), (1.0, ""), (1e3, "k"))
_LOOPS = (1.0, 0.6, 0.3)  # of the range of the drive
_SAMPLES = 400  # of half a loop
_DECADES = 4.0
_METHODS = {
    "none": "static gain",
    "mpi": "inverse",
    "dob": "observer",
    "mpi_dob": "inverse and observer",
    "rst": "RST",
}


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
               Design: how much of a disturbance each loop leaves, over frequency.
               Verification: error over frequency by method (``comparison``), or all ``verdicts``.
               LoopRecord: reference and position over time (``path``), or the ``error``.
               Plan: drive of the next experiment over time.
    kind       default: the first that is named above
    axis       of a recording, a stage or a design with several
    recording  drawn beside what the model predicts
    ax         matplotlib axes to draw into; default: those of a new figure

    Raises ``PictureError`` for another kind or record, or for an axis that is not there.

    >>> piezoid.plot(recordings["sweep.csv"], "time").get_xlabel()
    'time (s)'
    >>> piezoid.plot(model, recording=recordings["check.csv"]).get_ylabel()
    'displacement of x (µm)'
    >>> piezoid.plot(shipping.verification, "verdicts").get_xlabel()
    'value / limit (1)'
    """
    match record:
        case Recording():
            return _recording(record, kind or "loop", axis=axis, ax=ax)
        case ActuatorModel() | AxisModel():
            return _model(record, kind or "loop", axis=axis, recording=recording, ax=ax)
        case Comparison():
            return _comparison(record, kind or "loop", ax=ax)
        case Diagnosis():
            return _diagnosis(record, ax=ax)
        case Design():
            return _design(record, axis=axis, ax=ax)
        case Verification():
            return _verification(record, kind or "comparison", ax=ax)
        case LoopRecord():
            return _closed_loop(record, kind or "path", ax=ax)
        case Plan():
            return _plan(record, ax=ax)
        case _:
            raise PictureError(
                f"no picture of a {type(record).__name__}",
                needed="a recording, model, comparison, diagnosis, design, verification, loop "
                "record or plan",
                remedy="Pass one of those records.",
            )


def _model(
    model: ActuatorModel | AxisModel,
    kind: str,
    *,
    axis: str | None,
    recording: Recording | None,
    ax: "Axes | None",
) -> "Axes":
    """Draw one axis of a model, beside a recording if there is one."""
    if isinstance(model, ActuatorModel):
        model = model.one(axis or (recording.axis if recording is not None else None))
    if recording is not None:
        return _comparison(compare(model, recording), kind, ax=ax)
    return _axis_model(model, kind, ax=ax)


def in_units_of(axes: "Axes", counted: Collection[str]) -> "Axes":
    """Return axes with counts in their labels, where metres or volts were recorded in counts."""
    for one in axes.figure.axes if counted else ():
        one.set(
            **{
                name: in_counts(getattr(one, f"get_{name}")(), counted)
                for name in ("title", "xlabel", "ylabel")
            }
        )
    return axes


def _recording(
    held: Recording, kind: str, *, axis: str | None, ax: "Axes | None" = None
) -> "Axes":
    """Draw a recording: displacement over drive, or both over time on two scales."""
    _check("recording", kind, ("loop", "time"))
    own = axis or held.axis
    voltage_V = held.voltage_V(own)
    channel = held.find(Quantity.DISPLACEMENT, own)
    if kind == "loop":
        response = held.displacement_m(own)
        axes = _axes(ax)
        scale, unit = _scaled(response, "m")
        for part in held.pieces:
            x, y = _thinned(voltage_V[part], scale * response[part])
            axes.plot(x, y, color=MEASURED, linewidth=0.9)
        axes.set(xlabel=f"drive of {own} (V)", ylabel=f"displacement of {own} ({unit})")
        return in_units_of(axes, held.counted)
    axes = _axes(ax)
    time_s = held.time_s
    if channel is not None:
        scale, unit = _scaled(channel.values, "m")
        for part in held.pieces:
            axes.plot(
                *_thinned(time_s[part], scale * channel.values[part]),
                color=MEASURED,
                linewidth=0.9,
            )
        axes.set(xlabel="time (s)", ylabel=f"displacement of {own} ({unit})")
    drive = axes.twinx() if channel is not None else axes
    drive.plot(*_thinned(time_s, voltage_V), color=THIRD, linewidth=2.2, alpha=0.45)
    drive.set_ylabel(f"drive of {own} (V)", color=THIRD)
    drive.set_xlabel("time (s)")
    drive.tick_params(axis="y", colors=THIRD)
    drive.spines["top"].set_visible(False)
    axes.set_zorder(drive.get_zorder() + 1)  # what was measured in front
    axes.patch.set_visible(False)
    return in_units_of(axes, held.counted)


def _comparison(held: Comparison, kind: str, *, ax: "Axes | None" = None) -> "Axes":
    """Draw a recording and what a model says of it over the drive, or the error over time."""
    _check("comparison", kind, ("loop", "error"))
    axes = _axes(ax)
    if kind == "error":
        scale, unit = _scaled(held.error_m, "m")
        axes.plot(*_thinned(held.time_s, scale * held.error_m), color=MODEL, linewidth=0.8)
        axes.axhline(0.0, color=FAINT, linewidth=0.6)
        axes.set(xlabel="time (s)", ylabel=f"measured less predicted, {held.axis} ({unit})")
    else:
        scale, unit = _scaled(held.measured_m, "m")
        axes.plot(
            *_thinned(held.voltage_V, scale * held.measured_m),
            color=FAINT,
            linewidth=2.4,
            label="measured",
        )
        axes.plot(
            *_thinned(held.voltage_V, scale * held.predicted_m),
            color=MODEL,
            linewidth=0.8,
            label="predicted",
        )
        axes.set(
            xlabel=f"drive of {held.axis} (V)", ylabel=f"displacement of {held.axis} ({unit})"
        )
        axes.legend(frameon=False)
    rms, rms_unit = _scaled(np.array([held.rms_m]), "m")
    axes.set_title(
        f"error {rms * held.rms_m:.3g} {rms_unit} rms, {held.rms_percent:.2f} % of the range",
        fontsize="medium",
    )
    return in_units_of(axes, held.counted)


def _axis_model(model: AxisModel, kind: str, *, ax: "Axes | None" = None) -> "Axes":
    """Draw the loops of a model at three ranges of the drive, or the response of its linear part.

    The loops are those of the hysteresis, as it is driven slowly, after a full cycle. The band is
    the 95 % interval of the loading curve, about the largest of them.
    """
    _check("model", kind, ("loop", "response"))
    if kind == "response":
        return in_units_of(_response(model, _axes(ax)), model.counted)
    axes = _axes(ax)
    loops = [_loop(model, share) for share in _LOOPS]
    scale, unit = _scaled(loops[0][1], "m")
    low_V, high_V = model.voltage_V
    found = model.uncertainty
    voltage_V, moved_m = loops[0]
    half_m = np.interp(
        np.abs(voltage_V - 0.5 * (low_V + high_V)), found.reach_V, found.loading_half_m
    )
    rises = slice(len(voltage_V) // 2, None)
    for branch, label in ((slice(None, rises.start), "95 %"), (rises, None)):
        axes.fill_between(
            voltage_V[branch],
            scale * (moved_m - half_m)[branch],
            scale * (moved_m + half_m)[branch],
            color=MODEL,
            alpha=0.2,
            linewidth=0.0,
            label=label,
        )
    for share, (drive_V, displacement_m), shade in zip(
        _LOOPS, loops, (MODEL, THIRD, MEASURED), strict=True
    ):
        axes.plot(
            drive_V,
            scale * displacement_m,
            color=shade,
            linewidth=1.0,
            label=f"{100 * share:.0f} % of the range",
        )
    axes.set(xlabel=f"drive of {model.axis} (V)", ylabel=f"displacement of {model.axis} ({unit})")
    axes.legend(frameon=False)
    return in_units_of(axes, model.counted)


def _diagnosis(held: Diagnosis, *, ax: "Axes | None" = None) -> "Axes":
    """Draw what every effect contributes, rms: found as bars, not found as what it is at most."""
    found = [(f.effect, f.share * held.stroke_m) for f in held.findings]
    absent = [(n.effect, n.upper_bound_m) for n in held.not_detected if n.upper_bound_m]
    rows = [*found, *sorted(absent, key=lambda row: -row[1])]
    axes = _axes(ax, height_inch=1.6 + 0.24 * max(len(rows), 3))
    marks_m = [held.noise_floor_rms_m, held.baseline.rms_m, held.final.rms_m]
    scale, unit = _scaled(np.array([max(marks_m)]), "m")
    least_m = 0.5 * min(size for size in [*marks_m, *(s for _, s in rows)] if size > 0.0)
    for place, (_, size_m) in enumerate(rows):
        if place < len(found):
            axes.barh(
                place,
                scale * (size_m - least_m),
                left=scale * least_m,
                height=0.6,
                color=MODEL,
                label="found" if place == 0 else None,
            )
        else:
            axes.plot(
                scale * size_m,
                place,
                marker="<",
                color=MEASURED,
                markerfacecolor="white",
                linestyle="none",
                label="not found, at most" if place == len(found) else None,
            )
    lines = (("sensor's noise", ":", FAINT), ("error before", "-", FAINT), ("after", "--", THIRD))
    for value_m, (label, style, shade) in zip(marks_m, lines, strict=True):
        axes.axvline(scale * value_m, linestyle=style, color=shade, linewidth=1.0, label=label)
    axes.set_xscale("log")
    axes.set_yticks(range(len(rows)), [words(effect) for effect, _ in rows])
    axes.invert_yaxis()
    axes.set(xlabel=f"contribution to the displacement of {held.axis}, rms ({unit})")
    axes.legend(
        frameon=False, fontsize="small", loc="lower center", bbox_to_anchor=(0.4, 1.0), ncols=3
    )
    return in_units_of(axes, held.counted)


def _design(held: Design, *, axis: str | None, ax: "Axes | None" = None) -> "Axes":
    """Draw |S_yp|, what a loop leaves of a disturbance: nominal, and the worst of its family."""
    chosen = held.axes if axis is None else (_axis_of(held, axis),)
    axes = _axes(ax)
    for place, one in enumerate(chosen):
        _sensitivity(one, one.recommended, f"C{place}", axes)
    axes.axhline(0.0, color=FAINT, linewidth=0.6)
    axes.set(
        xscale="log",
        xlabel="frequency (Hz)",
        ylabel=r"disturbance left, $|S_{yp}|$ (dB)",
        ylim=(max(axes.get_ylim()[0], -80.0), axes.get_ylim()[1]),
    )
    axes.legend(frameon=False, fontsize="small")
    return axes


def _verification(held: Verification, kind: str, *, ax: "Axes | None" = None) -> "Axes":
    """Draw the error of each method over frequency, or every verdict against its limit."""
    _check("verification", kind, ("comparison", "verdicts"))
    if kind == "verdicts" or not held.comparison:
        return _verdicts(held, ax)
    axes = _axes(ax)
    scale, unit = _scaled(np.array([row.rms_m for row in held.comparison]), "m")
    methods = list(dict.fromkeys(row.method for row in held.comparison))
    for place, method in enumerate(methods):
        rows = sorted(
            (row for row in held.comparison if row.method == method), key=lambda r: r.frequency_Hz
        )
        ships = method in held.methods.values()
        axes.plot(
            [row.frequency_Hz for row in rows],
            [scale * row.rms_m for row in rows],
            marker="o",
            markersize=4.0 if ships else 3.0,
            linewidth=1.8 if ships else 0.9,
            color=MODEL if ships else (MEASURED, THIRD, FAINT)[place % 3],
            label=_METHODS.get(method, method) + (", ships" if ships else ""),
        )
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="turns of the spiral a second (Hz)",
        ylabel=f"position error, rms ({unit})",
    )
    axes.legend(frameon=False, fontsize="small")
    return axes


def _closed_loop(held: LoopRecord, kind: str, *, ax: "Axes | None" = None) -> "Axes":
    """Draw reference and position of a closed loop over time, or the error."""
    _check("closed loop", kind, ("path", "error"))
    axes = _axes(ax)
    base, what = held.unit, "current" if held.unit == "A" else "position"
    if kind == "error":
        scale, unit = _scaled(held.error, base)
        axes.plot(*_thinned(held.time_s, scale * held.error), color=MODEL, linewidth=0.8)
        axes.axhline(0.0, color=FAINT, linewidth=0.6)
        axes.set(xlabel="time (s)", ylabel=f"reference less {what}, {held.axis} ({unit})")
        return axes
    scale, unit = _scaled(held.reference, base)
    for values, label, shade, width in (
        (held.reference, "reference", FAINT, 2.4),
        (held.position, what, MODEL, 0.8),
    ):
        axes.plot(
            *_thinned(held.time_s, scale * values), color=shade, linewidth=width, label=label
        )
    axes.set(xlabel="time (s)", ylabel=f"{what} of {held.axis} ({unit})")
    axes.legend(frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return axes


def _plan(held: Plan, *, ax: "Axes | None" = None) -> "Axes":
    """Draw the planned drive over time, with the limits it keeps."""
    axes = _axes(ax)
    drive_V = held.drive.voltage_V
    time_s = np.arange(len(drive_V)) / held.drive.sampling_rate_Hz
    axes.plot(*_thinned(time_s, drive_V), color=MEASURED, linewidth=0.9)
    for end_V in (held.limits.voltage_min_V, held.limits.voltage_max_V):
        axes.axhline(end_V, color=FAINT, linewidth=0.8, linestyle=":")
    axes.set(
        xlabel="time (s)",
        ylabel=f"drive of {held.axis} (V)",
        title=f"{held.drive.name}: {' against '.join(held.question.effects)}",
    )
    return axes


def _axes(
    ax: "Axes | None", *, width_inch: float = WIDTH_inch, height_inch: float = HEIGHT_inch
) -> "Axes":
    """Return the axes that were given, or those of a new figure."""
    if ax is not None:
        from matplotlib.axes import Axes

        if not isinstance(ax, Axes):
            raise PictureError(
                f"ax is of type {type(ax).__name__}",
                needed="matplotlib axes",
                remedy="Pass what matplotlib.pyplot.subplots returned, one axes at a time.",
            )
        return ax
    import matplotlib.pyplot as plt

    _, axes = plt.subplots(figsize=(width_inch, height_inch), dpi=150, layout="constrained")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    return axes


def _check(place: str, kind: str, known: tuple[str, ...]) -> None:
    if kind not in known:
        raise PictureError(
            f"{place}: kind {kind!r}",
            needed=f"one of {', '.join(known)}",
            remedy="Name one of those.",
        )


def _scaled(values: Array, base: str) -> tuple[float, str]:
    """Return the factor and the unit in which values are read most easily."""
    largest = float(np.abs(values).max(initial=0.0))
    fitting = [(1.0 / size, f"{prefix}{base}") for size, prefix in _PREFIXES if largest >= size]
    return fitting[-1] if fitting else (1.0, base)


def _thinned(x: Array, y: Array) -> tuple[Array, Array]:
    step = max(1, len(x) // _POINTS)
    return x[::step], y[::step]


def _loop(model: AxisModel, share: float) -> tuple[Array, Array]:
    """Return a closed loop over a share of the range, about its middle, falling first."""
    low_V, high_V = model.voltage_V
    middle_V, half_V = 0.5 * (low_V + high_V), 0.5 * share * (high_V - low_V)
    way = np.concatenate([np.linspace(1.0, -1.0, _SAMPLES), np.linspace(-1.0, 1.0, _SAMPLES)])
    drive_V = middle_V + half_V * way
    operator = model.operator
    _, memory_V = operator.run(drive_V, operator.virgin_memory())
    output_m, _ = operator.run(drive_V, memory_V)
    moved_m = model.polarity * (output_m - operator.displacement_offset_m)
    return drive_V, np.asarray(model.zero_m + moved_m)


def _response(model: AxisModel, axes: "Axes") -> "Axes":
    system = linear_part(model, None)
    poles_Hz = np.abs(np.linalg.eigvals(system.A)) / (2.0 * np.pi) if len(system.A) else np.ones(1)
    middle = float(np.log10(np.median(poles_Hz)))
    top = max(float(np.log10(poles_Hz.max())) + 0.7, middle + 0.5 * _DECADES)
    low = min(float(np.log10(poles_Hz.min())) - 1.0, top - _DECADES)
    frequency_Hz = np.logspace(low, top, 1000)
    magnitude = np.abs(system.response(frequency_Hz)[:, 0, 0])
    scale, unit = _scaled(np.array([float(np.median(magnitude))]), "m")
    axes.loglog(frequency_Hz, scale * magnitude, color=MODEL, linewidth=1.0)
    axes.set(xlabel="frequency (Hz)", ylabel=f"response of {model.axis} ({unit}/V)")
    return axes


def _axis_of(held: Design, axis: str) -> AxisDesign:
    names = [one.axis for one in held.axes]
    if axis not in names:
        raise PictureError(
            f"no axis {axis!r} in this design",
            needed=f"one of {', '.join(names)}",
            remedy="Name one of those.",
        )
    return held.axis(axis)


def _sensitivity(axis: AxisDesign, found: LoopDesign, color: str, axes: "Axes") -> None:
    rate_Hz = found.members[0].sampling_rate_Hz
    frequency_Hz = np.logspace(np.log10(0.5 * rate_Hz) - _DECADES, np.log10(0.5 * rate_Hz), 600)
    left = np.stack(
        [np.abs(sensitivities(m, found.R, found.S, frequency_Hz).Syp) for m in found.members]
    )
    left_dB = 20.0 * np.log10(np.maximum(left, 1e-6))
    name = (
        f"axis {axis.axis}, {_METHODS.get(found.method, found.method)}, "
        f"bandwidth {with_unit(found.bandwidth_Hz, 'Hz')}"
    )
    axes.fill_between(
        frequency_Hz, left_dB.min(axis=0), left_dB.max(axis=0), color=color, alpha=0.2, linewidth=0
    )
    axes.plot(frequency_Hz, left_dB[0], color=color, linewidth=1.2, label=name)
    axes.axvline(found.bandwidth_Hz, color=color, linewidth=0.8, linestyle=":")


def _verdicts(held: Verification, ax: "Axes | None") -> "Axes":
    """Draw value over limit of every verdict that has a limit above 0."""
    judged = [v for v in held.verdicts if v.limit > 0.0]
    axes = _axes(ax, width_inch=1.6 * WIDTH_inch, height_inch=0.9 + 0.2 * max(len(judged), 4))
    shares = [max(v.value / v.limit, 1e-3) for v in judged]
    colors = [THIRD if v.passed else MODEL for v in judged]
    axes.barh(range(len(judged)), shares, height=0.6, color=colors)
    axes.axvline(1.0, color=MEASURED, linewidth=1.0)
    axes.set_yticks(
        range(len(judged)), [f"{v.name} ({v.scenario})" for v in judged], fontsize="x-small"
    )
    axes.invert_yaxis()
    axes.set(xscale="log", xlabel="value / limit (1)")
    return axes
