"""Linear filters of the static response of a track, and the change by a changed drive."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from piezoid.diagnosis.effect import Filter, Parameters
from piezoid.diagnosis.residual_view import View
from piezoid.identification.extensions.extension import Extension
from piezoid.identification.simulation import where_of
from piezoid.numerics.arrays import Array
from piezoid.operators.linear import recursive_filter
from piezoid.operators.play import play_columns
from piezoid.records.recording import Quantity, Recording

GRIDS_Hz = (50.0, 60.0)
GAPS = np.array([0.2, 0.5, 0.8])  # of another axis' half range: thresholds of its plays


def rate_of(signal: Array, rate_Hz: float) -> Array:
    """Return the derivative of a signal by central differences."""
    return np.asarray(np.gradient(signal) * rate_Hz)


def mode(signal: Array, frequency_Hz: float, quality: float, rate_Hz: float) -> Array:
    """Return a signal filtered by one mechanical mode; unchanged if the mode is too fast.

        x'' + (w / Q) x' + w^2 x = w^2 h,    bilinear with the frequency kept

    A recording with fewer than four rows for a period cannot show the mode.
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
    """Return the contribution of an effect to the readings, rms in percent of the stroke.

        s = max over tracks of 100 rms(c - mean c),   c = columns coefficient

    It is what a person measures with the drive at rest, and not what is left of it beside a free
    hysteresis, which takes up a part of anything slow or periodic.
    """

    def size(view: View, parameters: Parameters, coefficient: Array) -> float:
        added, edges = columns(view, parameters) @ coefficient, view.nuisance.edges
        return 50.0 * max(
            float(np.std(part)) for part in np.split(added, edges[1:-1]) if len(part)
        )

    return size


def filtered_change(view: View, passed: Filter, parameters: Parameters) -> Array:
    """Return the change by a filter of the response at the rows, (rows, 1)."""
    return view.of(lambda k, t: passed(view.static[k], t.rate_Hz, parameters) - view.static[k])[
        :, None
    ]


def drive_change(view: View, passed: Filter, parameters: Parameters) -> Array:
    """Return the change by a filter of the command at the rows, (rows, 1)."""
    parts = []
    for k, track in enumerate(view.tracks):
        command = passed(track.command, track.rate_Hz, parameters)
        if command is track.command or np.array_equal(command, track.command):
            parts.append(np.zeros(len(track.rows)))
            continue
        changed = view.nuisance.static_rows(k, view.weight, track.read(command))
        parts.append(changed - view.static[k][track.rows])
    return np.concatenate(parts)[:, None]


def untested(view: View) -> Array:
    """Return zero columns for a trial that is evaluated without a tangent."""
    return np.zeros((len(view.response), 1))


def with_displacement(recording: Recording, displacement_m: Array) -> Recording:
    """Return a recording of which the displacement reads otherwise."""
    channels = tuple(
        replace(channel, values=displacement_m)
        if channel.quantity is Quantity.DISPLACEMENT and channel.axis == recording.axis
        else channel
        for channel in recording.channels
    )
    return replace(recording, channels=channels)


def through(recording: Recording, part: Extension) -> Recording:
    """Return a recording of which the displacement came about with this part of a model.

    Parts in front of the hysteresis have nothing to act on: a recording knows no ceramic.
    """
    where = where_of(recording, recording.axis, slice(0, recording.samples))
    moved_m = part.response(recording.displacement_m(), where)
    return with_displacement(recording, part.reading(moved_m + part.added(where), where))


def stroke_of(recording: Recording) -> float:
    """Return the range of a recording's displacement in m."""
    return float(np.ptp(recording.displacement_m()))


def seconds_of(recording: Recording) -> Array:
    """Return the time of every sample."""
    return np.arange(recording.samples) / recording.sampling_rate_Hz


def with_added(recording: Recording, change_m: Array, share: float) -> Recording:
    """Return a recording with a change added, of which the rms is a share of the stroke."""
    rms_m = float(np.sqrt(np.mean(change_m**2)))
    scale = share * stroke_of(recording) / rms_m if rms_m > 0 else 1.0
    return with_displacement(recording, recording.displacement_m() + change_m * scale)


def answers_of_others(view: View, *, backwards: bool = False) -> Array:
    """Return each other axis' drive, its square and its plays, (rows, columns).

    backwards  the same drives run backwards in time, which nothing can answer to
    """
    axes = sorted({axis for track in view.tracks for axis in track.other_drives})
    parts = [np.zeros((len(view.response), 0))]
    return np.column_stack([*parts, *(_answer(view, axis, backwards) for axis in axes)])


def _answer(view: View, axis: str, backwards: bool) -> Array:
    columns = np.zeros((len(view.response), 2 + len(GAPS)))
    edges = view.nuisance.edges
    for k, track in enumerate(view.tracks):
        if axis not in track.other_drives:
            continue
        drive = track.other_drives[axis][:: -1 if backwards else 1]
        plays, _ = play_columns(drive, GAPS, np.full(len(GAPS), drive[0]))
        part = np.column_stack([drive, drive**2, plays])[track.rows]
        columns[edges[k] : edges[k + 1]] = part
    return columns
