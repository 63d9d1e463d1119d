"""Mains interference: the reading contains the mains frequency.

What you see
    A steady ripple of 50 or 60 Hz and its harmonics, the same whether the stage moves or not.
Why it happens
    Stray fields and ground loops couple the mains into sensor and amplifier.
How it is detected
    Lines near the mains frequency or twice, three or five times that, whose phase may wander,
    explain what static hysteresis cannot, and lines near six other frequencies, sought in the same
    way, do not. In a slow recording they are folded. A recording in which the drive itself
    contains such a line is left out.
What the extension adds
    A note for the observer; the remedy is shielding.
Source
    Thomson (1982); grid statistics of ENTSO-E
"""

from collections.abc import Callable

import numpy as np

from piezoid.diagnosis.drive_response import DriveResponse
from piezoid.diagnosis.effect import (
    IN_SPECTRUM,
    ConstantDriveData,
    Effect,
    Parameters,
    Tangent,
    Trial,
    without_part,
)
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.segments import Places
from piezoid.diagnosis.signals import GRIDS_Hz, added_percent, peak_Hz, waves, with_added
from piezoid.formatting import significant, with_unit
from piezoid.identification.extensions.mains_lines import (
    HARMONICS,
    ROWS_PER_PERIOD,
    MainsLines,
    folded_Hz,
    visible_harmonics,
)
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import white_noise_rms
from piezoid.records.recording import Recording

PLACEBOS_Hz = (41.7, 46.3, 53.9, 56.1, 63.7, 66.9)
PHASE_TIME_s = 8.0  # in which the phase of the grid is constant
MAX_KNOTS = 6  # of the phase in a track
OFFSET_Hz, OFFSET_STEP_Hz = 0.3, 0.03  # deviation of a grid from its nominal frequency
OFFSET_AT_REST_Hz = 0.5
AROUND_Hz = 6.0  # range of frequencies that a line is compared with
MIN_LINE_RATIO = 8.0  # amplitude of a line over that of the surrounding spectrum
MIN_DRIVEN_RATIO = 1.0  # line of the static response over a line of the residual that it may cause
CLOCK_ERROR = 2e-3  # of the nominal frequency: grids stay within 0.1 % for hours
PLANNED_Hz = (50.0, 60.0, 100.0, 120.0, 150.0, 180.0)
DrivenLines = Callable[[int, float], bool]  # (track, frequency_Hz) -> whether the stage moves so


def _driven_lines(view: View) -> DrivenLines:
    """Return a test for lines of the residual that may be misfit of the motion of the stage.

    Such a line of a track, at a frequency in Hz, is smaller than that of the motion itself, which
    stands out of the spectrum around it and of the noise of the sensor.
    """
    spectra, floors = [], []
    for track, static in zip(view.tracks, view.static, strict=True):
        samples = len(static)
        wave = np.abs(np.fft.rfft((static - static.mean()) * np.hanning(samples)))
        spectra.append(4.0 * wave / samples)
        floors.append(white_noise_rms(track.response) / np.sqrt(len(track.response)))

    def is_driven(k: int, frequency_Hz: float) -> bool:
        spectrum, track = spectra[k], view.tracks[k]
        step_Hz = track.rate_Hz / len(track.response)
        distance_Hz = np.abs(np.arange(len(spectrum)) * step_Hz - frequency_Hz)
        is_line = distance_Hz <= max(OFFSET_Hz, 2.0 * step_Hz)
        is_around = (distance_Hz > max(1.0, 4.0 * step_Hz)) & (
            distance_Hz < max(AROUND_Hz, 12.0 * step_Hz)
        )
        if not is_line.any() or not is_around.any():
            return False
        line = float(spectrum[is_line].max())
        if line <= MIN_LINE_RATIO * max(float(np.median(spectrum[is_around])), floors[k]):
            return False
        residual = view.null.residual[view.track_rows(k)]
        angles_rad = 2.0 * np.pi * _around(frequency_Hz) / track.rate_Hz
        power = float(_powers(residual, angles_rad, track.rows).max())
        return line > MIN_DRIVEN_RATIO * (2.0 * float(np.sqrt(power)) / len(residual))

    return is_driven


def _around(frequency_Hz: float) -> Array:
    return np.asarray(frequency_Hz + np.arange(-OFFSET_Hz, OFFSET_Hz + 1e-9, OFFSET_STEP_Hz))


def _line_columns(
    view: View, is_driven: DrivenLines, grid_Hz: float, harmonics: tuple[int, ...]
) -> Array:
    """Return columns of lines with a slowly changing phase, for tracks that do not move so."""
    columns = []
    for k, track in enumerate(view.tracks):
        time_s = track.rows / track.rate_Hz
        knots = min(1 + int(track.duration_s / PHASE_TIME_s), MAX_KNOTS)
        position = time_s / max(track.duration_s, 1e-9) * (knots - 1)
        splines = np.maximum(1.0 - np.abs(position[:, None] - np.arange(knots)), 0.0)
        for n in visible_harmonics(track.rate_Hz, grid_Hz, harmonics):
            if is_driven(k, folded_Hz(n * grid_Hz, track.rate_Hz)):
                continue
            phase = 2 * np.pi * n * grid_Hz * time_s
            for wave in (np.cos(phase), np.sin(phase)):
                columns += [view.track_column(k, wave * spline) for spline in splines.T]
    return np.column_stack(columns) if columns else np.zeros((len(view.response), 0))


def _powers(signal: Array, angles_rad: Array, samples: Places) -> Array:
    """Return |sum_k s_k exp(i w k)|^2 for equally spaced angles w per sample, (angles,).

    Each wave is the previous one times a step: a product instead of a sine for every sample.
    """
    wave = signal * np.exp(1j * angles_rad[0] * samples)
    step = np.exp(1j * (angles_rad[1] - angles_rad[0]) * samples)
    sums = [wave.sum()]
    for _ in angles_rad[1:]:
        wave *= step
        sums.append(wave.sum())
    return np.asarray(np.abs(sums) ** 2)


def _trials(view: View) -> list[Trial]:
    """Return the strongest line of the residual near each grid and placebo frequency."""
    trials, is_driven = [], _driven_lines(view)
    for nominal_Hz in (*GRIDS_Hz, *PLACEBOS_Hz):
        trials_Hz = _around(nominal_Hz)
        best = (0.0, nominal_Hz, 1)  # power, frequency and harmonic
        for n in HARMONICS:
            power = np.zeros(len(trials_Hz))
            for k, track in enumerate(view.tracks):
                is_visible = n in visible_harmonics(track.rate_Hz, nominal_Hz, HARMONICS)
                if not is_visible or is_driven(k, folded_Hz(n * nominal_Hz, track.rate_Hz)):
                    continue
                angles_rad = 2 * np.pi * n * trials_Hz / track.rate_Hz
                power += _powers(view.null.residual[view.track_rows(k)], angles_rad, track.rows)
            j = int(np.argmax(power))
            best = max(best, (float(power[j]), float(trials_Hz[j]), n))
        _, frequency_Hz, harmonic = best
        columns = _line_columns(view, is_driven, frequency_Hz, (harmonic,))
        if columns.shape[1]:
            parameters = {"frequency_Hz": frequency_Hz}
            is_grid = nominal_Hz in GRIDS_Hz
            trials.append(Trial(columns=columns, parameters=parameters, physical=is_grid))
    return trials


def _columns(view: View, parameters: Parameters) -> Array:
    return _line_columns(view, _driven_lines(view), parameters["frequency_Hz"], HARMONICS)


def _tangent(drive: DriveResponse, _: float) -> Array:
    lines_Hz = [f for f in PLANNED_Hz if f < 0.4 * drive.rate_Hz]
    phases_rad = [2 * np.pi * line_Hz * drive.time_s for line_Hz in lines_Hz]
    lines = [wave(phase_rad) for phase_rad in phases_rad for wave in (np.cos, np.sin)]
    return 1e-6 * np.column_stack(lines or [np.zeros(len(drive.voltage_V))])


def _at_rest(data: ConstantDriveData) -> Array | str:
    """Return the lines of the grid at the frequency that fits best."""
    recording, time_s, detrended_m = data.recording, data.time_s, data.detrended_m
    rate_Hz, span_s = recording.sampling_rate_Hz, float(np.ptp(time_s))
    if rate_Hz <= 2.0 * GRIDS_Hz[0] or span_s * OFFSET_AT_REST_Hz < 1.0:
        return (
            f"{with_unit(recording.duration_s, 's')} at {significant(rate_Hz)} Hz cannot show a "
            "line of the grid"
        )
    offsets_Hz = np.arange(-OFFSET_AT_REST_Hz, OFFSET_AT_REST_Hz, 0.25 / span_s).tolist()
    trials_Hz = [f + offset for f in GRIDS_Hz if rate_Hz > 2.0 * f for offset in offsets_Hz]
    power = [abs(np.exp(-2j * np.pi * f * time_s) @ detrended_m) for f in trials_Hz[:4000]]
    best_Hz = peak_Hz(detrended_m, time_s, trials_Hz[int(np.argmax(power))], 0.25 / span_s)
    return waves(time_s, [n * best_Hz for n in HARMONICS if 2 * n * best_Hz < rate_Hz])


def _clock_note(parameters: Parameters) -> str:
    """State the clock error of the file, if the line is that of the power grid."""
    frequency_Hz = parameters["frequency_Hz"]
    nominal_Hz = min(GRIDS_Hz, key=lambda grid_Hz: abs(grid_Hz - frequency_Hz))
    error = frequency_Hz / nominal_Hz - 1.0
    if abs(error) < CLOCK_ERROR:
        return f"The line is at {frequency_Hz:.2f} Hz."
    return (
        f"The line is at {frequency_Hz:.2f} Hz. If this is the mains, the clock of the file is "
        f"{100.0 * abs(error):.2f} % off."
    )


def inject(recording: Recording, share: float) -> Recording:
    """Add hum of 50 Hz."""
    hum = np.sin(2 * np.pi * 50.0 * recording.time_s + 1.0)
    return with_added(recording, hum, share)


EFFECT = Effect(
    name="mains_interference",
    explanation=__doc__ or "",
    unit="% of the stroke, largest rms",
    experiment="Record one minute with the drive at rest at 1 kHz or more, then once more "
    "with the amplifier unplugged: a hum that remains comes from the sensor.",
    control="A controller with gain at this frequency makes the stage follow the hum. Repair "
    "the wiring before you raise the bandwidth.",
    shows=IN_SPECTRUM,
    tangent=Tangent(columns=_tangent, per_drive=True, advised=("idle",)),
    untestable=lambda view: (
        ""
        if view.fastest_Hz > ROWS_PER_PERIOD * min(GRIDS_Hz)
        else f"the fastest recording has {view.fastest_Hz:.4g} Hz; the grid needs more than 110 Hz"
    ),
    trials=_trials,
    columns=_columns,
    size=added_percent(_columns),
    note=_clock_note,
    model_error=0.04,  # by changes of the phase between knots, and by higher harmonics
    at_rest=_at_rest,
    inject=inject,
    extend=lambda estimate, setting: (
        MainsLines.of(setting.pieces, estimate.parameters["frequency_Hz"]),
    ),
    without=without_part(MainsLines),
)
