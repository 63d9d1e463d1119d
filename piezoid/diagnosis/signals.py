"""Helpers of effects: filters, lines, trends, other axes, and recordings with an effect added."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from piezoid.diagnosis.effect import Filter, Parameters, Trial
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.segments import Track
from piezoid.identification.extensions.extension import Extension
from piezoid.identification.hysteresis.pieces import where_of
from piezoid.numerics.arrays import Array
from piezoid.operators.linear import recursive_filter
from piezoid.operators.play import play_columns
from piezoid.records.recording import Quantity, Recording

GRIDS_Hz = (50.0, 60.0)
SHORTEST_SAMPLES = 0.5  # time constant of the fastest trial, in the fastest recording
GAPS = np.array([0.2, 0.5, 0.8])  # of another axis' half range: thresholds of its plays


def mode(signal: Array, frequency_Hz: float, quality: float, rate_Hz: float) -> Array:
    """Return a signal filtered by one mechanical mode; unchanged if the mode is too fast.

        x'' + (w / Q) x' + w^2 x = w^2 h,    bilinear transform, prewarped at the frequency w

    A recording with fewer than four samples in a period cannot show the mode.
    """
    if rate_Hz < 4.0 * frequency_Hz:
        return signal
    k = np.tan(np.pi * frequency_Hz / rate_Hz)
    a = np.array([1 + k / quality + k * k, 2 * (k * k - 1), 1 - k / quality + k * k])
    b = k * k * np.array([1.0, 2.0, 1.0])
    start = np.asarray(signal)[0]
    return np.asarray(recursive_filter(b, a, signal - start) + start)


def added_percent(
    columns: Callable[[View, Parameters], Array],
) -> Callable[[View, Parameters, Array], float]:
    """Return a function for the contribution of an effect, rms in percent of the stroke.

        s = max over tracks of 50 rms(c - mean c),   c = columns coefficient, in half strokes

    This is the size that a measurement at constant drive shows. The contribution beyond the
    nuisance class is smaller, because hysteresis absorbs a part of anything slow or periodic.
    """

    def size(view: View, parameters: Parameters, coefficient: Array) -> float:
        added, edges = columns(view, parameters) @ coefficient, view.nuisance.edges
        return 50.0 * max(
            float(np.std(part)) for part in np.split(added, edges[1:-1]) if len(part)
        )

    return size


def filtered_change(view: View, response_filter: Filter, parameters: Parameters) -> Array:
    """Return the change by a filter of the response at the rows, (rows, 1)."""

    def change(k: int, track: Track) -> Array:
        static = view.static[k]
        return response_filter(static, track.rate_Hz, parameters) - static

    return view.column(change)[:, None]


def delay_trials(
    view: View, response_filter: Filter, parameters: Sequence[tuple[str, float]]
) -> list[Trial]:
    """Return trials of a filter that delays by one parameter, each with its name and value."""
    view = replace(view, static_override=view.motion, path=None)
    return [
        Trial(
            columns=filtered_change(view, response_filter, {name: value}),
            parameters={name: value},
            needs_time=True,
            free={name: 1.5},
        )
        for name, value in parameters
    ]


def trial_times_s(view: View, longest_s: float, count: int) -> list[float]:
    """Return time constants from half a sample of the fastest recording on, log-spaced."""
    times_s = np.geomspace(SHORTEST_SAMPLES / view.fastest_Hz, longest_s, count)
    return [float(time_s) for time_s in times_s]


def drive_change(view: View, drive_filter: Filter, parameters: Parameters) -> Array:
    """Return the change by a filter of the command at the rows, (rows, 1)."""
    changes = []
    for k, track in enumerate(view.tracks):
        command = drive_filter(track.command, track.rate_Hz, parameters)
        if command is track.command or np.array_equal(command, track.command):
            changes.append(np.zeros(len(track.rows)))
            continue
        response = view.nuisance.static_rows(k, view.weight, track.read(command))
        changes.append(response - view.unfiltered[k][track.rows])
    return np.concatenate(changes)[:, None]


def with_displacement(
    recording: Recording, displacement_m: Array, axis: str | None = None
) -> Recording:
    """Return a recording with other readings of the displacement; ``axis``: default its own."""
    replaced = (Quantity.DISPLACEMENT, axis or recording.axis)
    channels = tuple(
        replace(channel, values=displacement_m)
        if (channel.quantity, channel.axis) == replaced
        else channel
        for channel in recording.channels
    )
    return replace(recording, channels=channels)


def with_extension(recording: Recording, part: Extension) -> Recording:
    """Return a recording with an extension of the model applied to its displacement.

    Extensions in front of the hysteresis cannot be applied to a recording.
    """
    where = where_of(recording, recording.axis, slice(0, recording.samples))
    moved_m = part.response(recording.displacement_m(), where)
    return with_displacement(recording, part.reading(moved_m + part.added(where), where))


def stroke_of(recording: Recording) -> float:
    """Return the range of a recording's displacement in m."""
    return float(np.ptp(recording.displacement_m()))


def with_added(recording: Recording, change_m: Array, share: float) -> Recording:
    """Return a recording with a change added, scaled to an rms that is a share of the stroke."""
    rms_m = float(np.sqrt(np.mean(change_m**2)))
    scale = share * stroke_of(recording) / rms_m if rms_m > 0 else 1.0
    return with_displacement(recording, recording.displacement_m() + change_m * scale)


def other_axis_columns(view: View, *, backwards: bool = False) -> Array:
    """Return the drive of each other axis, its square and its plays, (rows, columns).

    backwards  whether to reverse these drives in time, for a placebo
    """
    columns = [np.zeros((len(view.response), 0))]
    for axis in sorted({axis for track in view.tracks for axis in track.other_drives}):
        of_axis = np.zeros((len(view.response), 2 + len(GAPS)))
        for k, track in enumerate(view.tracks):
            if axis not in track.other_drives:
                continue
            drive = track.other_drives[axis][:: -1 if backwards else 1]
            plays, _ = play_columns(drive, GAPS, np.full(len(GAPS), drive[0]))
            of_axis[view.track_rows(k)] = np.column_stack([drive, drive**2, plays])[track.rows]
        columns.append(of_axis)
    return np.column_stack(columns)


def cubic(time_s: Array) -> Array:
    """Return a cubic of time, (rows, 3)."""
    unit = 2.0 * (time_s - time_s[0]) / max(float(np.ptp(time_s)), 1e-30) - 1.0
    return np.column_stack([unit, unit**2, unit**3])


def waves(time_s: Array, frequencies_Hz: Sequence[float]) -> Array:
    """Return cosine and sine of each frequency, about their means, (rows, 2 frequencies)."""
    angles_rad = [2.0 * np.pi * frequency_Hz * time_s for frequency_Hz in frequencies_Hz]
    columns = np.column_stack([wave(angle) for angle in angles_rad for wave in (np.cos, np.sin)])
    return np.asarray(columns - columns.mean(axis=0))


def peak_Hz(signal: Array, time_s: Array, near_Hz: float, reach_Hz: float) -> float:
    """Return the frequency of a line of a signal, at the vertex of its power.

    With a frequency error of an eighth of a period over the recording, a fifth of the line would
    remain and be reported as a second line.
    """
    frequencies = near_Hz + reach_Hz * np.linspace(-1.0, 1.0, 41)
    power = np.array(
        [abs(np.exp(-2j * np.pi * f * time_s) @ signal) for f in frequencies.tolist()]
    )
    peak = int(np.clip(np.argmax(power), 1, len(frequencies) - 2))
    left, centre, right = power[peak - 1 : peak + 2].tolist()
    curvature = 2.0 * centre - left - right
    offset = 0.5 * (right - left) / curvature if curvature > 0.0 else 0.0
    step_Hz = frequencies[1] - frequencies[0]
    return float(frequencies[peak] + step_Hz * np.clip(offset, -1.0, 1.0))
