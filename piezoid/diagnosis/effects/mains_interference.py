"""Mains interference: the reading contains the mains frequency.

What you see
    A steady ripple of 50 or 60 Hz and its harmonics, the same whether the stage moves or not.
Why it happens
    Stray fields and ground loops couple the mains into sensor and amplifier.
How it is detected
    Lines near the mains frequency or twice or three times that, whose phase may wander, explain
    what static hysteresis cannot, and lines near six other frequencies, sought in the same way, do
    not. A recording in which the drive itself contains such a line is left out.
What the extension adds
    A note for the observer; the remedy is shielding.
Source
    Thomson (1982); grid statistics of ENTSO-E
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from piezoid.diagnosis.appearance import IN_SPECTRUM
from piezoid.diagnosis.drive_response import Driven
from piezoid.diagnosis.effect import (
    ConstantDriveData,
    Effect,
    Parameters,
    Tangent,
    Trial,
    without_part,
)
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.rest_columns import peak_Hz, waves
from piezoid.diagnosis.segments import Places
from piezoid.diagnosis.signals import GRIDS_Hz, added_percent, seconds_of, with_added
from piezoid.formatting import significant, with_unit
from piezoid.identification.extensions.mains_lines import MainsLines
from piezoid.numerics.arrays import Array
from piezoid.numerics.noise import white_noise_rms
from piezoid.records.recording import Recording

TWINS_Hz = (41.7, 46.3, 53.9, 56.1, 63.7, 66.9)
WANDER_s = 8.0  # how long the grid keeps a phase
MOST_KNOTS = 6
ROWS_PER_PERIOD = 2.2
HARMONICS = (1, 2, 3)
OFF_Hz, OFF_STEP_Hz = 0.3, 0.03  # how far a grid is off its nominal frequency
OFF_AT_REST_Hz = 0.5
NEAR_Hz = 6.0  # around a line, to compare it with
LINE = 8.0  # times what is around it
MISSED = 1.0  # of a line of the residual: a line of the static response that may be it
CLOCK_OFF = 2e-3  # of the nominal frequency: grids stay within 0.1 % for hours
PLANNED_Hz = (50.0, 60.0, 100.0, 120.0, 150.0, 180.0)


def _untestable(view: View) -> str:
    fastest_Hz = max(track.rate_Hz for track in view.tracks)
    if fastest_Hz > ROWS_PER_PERIOD * min(GRIDS_Hz):
        return ""
    return f"the fastest recording has {fastest_Hz:.4g} Hz; the grid needs more than 110 Hz"


@dataclass(frozen=True, kw_only=True, eq=False)
class Lines:
    """What the drive itself makes of lines.

    spectra        amplitudes of the waves of every track's static response
    resolution_Hz  their distance
    floor          what the sensor's noise is in such a spectrum
    residuals      (rows,) of every track, and their samples
    rates_Hz       of the tracks
    """

    spectra: tuple[Array, ...]
    resolution_Hz: tuple[float, ...]
    floor: tuple[float, ...]
    residuals: tuple[tuple[Array, Places], ...]
    rates_Hz: tuple[float, ...]

    @classmethod
    def of(cls, view: View) -> "Lines":
        """Return the lines of a view."""
        noise = [white_noise_rms(t.response) / np.sqrt(len(t.response)) for t in view.tracks]
        return cls(
            spectra=tuple(_spectrum(static) for static in view.static),
            resolution_Hz=tuple(t.rate_Hz / len(t.response) for t in view.tracks),
            floor=tuple(noise),
            residuals=tuple(
                (view.null.residual[a:b], track.place)
                for track, (a, b) in zip(view.tracks, pairwise(view.nuisance.edges), strict=True)
            ),
            rates_Hz=tuple(track.rate_Hz for track in view.tracks),
        )

    def driven(self, k: int, frequency_Hz: float) -> bool:
        """Tell whether the static response of a track has a line there that may be misfit.

        A class that misses a part of that line leaves less than the line itself.
        """
        spectrum, step_Hz = self.spectra[k], self.resolution_Hz[k]
        away_Hz = np.abs(np.arange(len(spectrum)) * step_Hz - frequency_Hz)
        here = away_Hz <= max(OFF_Hz, 2.0 * step_Hz)
        around = (away_Hz > max(1.0, 4.0 * step_Hz)) & (away_Hz < max(NEAR_Hz, 12.0 * step_Hz))
        if not here.any() or not around.any():
            return False
        # what lies below the sensor's noise is no line of anything
        least = max(float(np.median(spectrum[around])), self.floor[k])
        line = float(spectrum[here].max())
        return line > LINE * least and line > MISSED * self._residual_line(k, frequency_Hz)

    def _residual_line(self, k: int, frequency_Hz: float) -> float:
        """Return the largest amplitude of the residual of a track near a frequency."""
        residual, place = self.residuals[k]
        near_Hz = frequency_Hz + np.arange(-OFF_Hz, OFF_Hz + 1e-9, OFF_STEP_Hz)
        powers = _powers(residual, 2.0 * np.pi * near_Hz / self.rates_Hz[k], place)
        return 2.0 * float(np.sqrt(powers.max())) / len(residual)


def _spectrum(signal: Array) -> Array:
    wave = np.abs(np.fft.rfft((signal - signal.mean()) * np.hanning(len(signal))))
    return np.asarray(4.0 * wave / len(signal))


def _lines(view: View, lines: Lines, grid_Hz: float, harmonics: tuple[int, ...]) -> Array:
    columns = []
    for k, track in enumerate(view.tracks):
        time_s = track.place / track.rate_Hz
        knots = min(1 + int(track.duration_s / WANDER_s), MOST_KNOTS)
        place = time_s / max(track.duration_s, 1e-9) * (knots - 1)
        hats = np.maximum(1.0 - np.abs(place[:, None] - np.arange(knots)), 0.0)
        for n in harmonics:
            if track.rate_Hz < ROWS_PER_PERIOD * n * grid_Hz or lines.driven(k, n * grid_Hz):
                continue
            turn = 2 * np.pi * n * grid_Hz * time_s
            for wave in (np.cos(turn), np.sin(turn)):
                columns += [view.of_track(k, wave * hat) for hat in hats.T]
    return np.column_stack(columns) if columns else np.zeros((len(view.response), 0))


def _strongest(view: View, lines: Lines, nominal_Hz: float) -> tuple[float, int]:
    """Return the frequency and the harmonic at which the residual follows a line best."""
    tried = nominal_Hz + np.arange(-OFF_Hz, OFF_Hz + 1e-9, OFF_STEP_Hz)
    edges, best = view.nuisance.edges, (0.0, nominal_Hz, 1)
    for n in HARMONICS:
        power = np.zeros(len(tried))
        for k, track in enumerate(view.tracks):
            if track.rate_Hz < ROWS_PER_PERIOD * n * tried[-1] or lines.driven(k, n * nominal_Hz):
                continue
            residual = view.null.residual[edges[k] : edges[k + 1]]
            power += _powers(residual, 2 * np.pi * n * tried / track.rate_Hz, track.place)
        j = int(np.argmax(power))
        best = max(best, (float(power[j]), float(tried[j]), n))
    return best[1], best[2]


def _powers(signal: Array, step_rad: Array, place: Places) -> Array:
    """Return |sum_k s_k exp(i w k)|^2 for equally spaced angles w per sample, (angles,).

    The next wave is the last one times a slow one: a product instead of a sine for every sample.
    """
    wave = signal * np.exp(1j * step_rad[0] * place)
    slow = np.exp(1j * (step_rad[1] - step_rad[0]) * place)
    sums = [wave.sum()]
    for _ in step_rad[1:]:
        wave *= slow
        sums.append(wave.sum())
    return np.asarray(np.abs(sums) ** 2)


def _trials(view: View) -> list[Trial]:
    found, lines = [], Lines.of(view)
    for nominal_Hz in (*GRIDS_Hz, *TWINS_Hz):
        frequency_Hz, harmonic = _strongest(view, lines, nominal_Hz)
        columns = _lines(view, lines, frequency_Hz, (harmonic,))
        if columns.shape[1]:
            way = {"frequency_Hz": frequency_Hz}
            found.append(Trial(columns=columns, parameters=way, physical=nominal_Hz in GRIDS_Hz))
    return found


def _columns(view: View, parameters: Parameters) -> Array:
    return _lines(view, Lines.of(view), parameters["frequency_Hz"], HARMONICS)


def _tangent(drive: Driven, _: float) -> Array:
    heard = [f for f in PLANNED_Hz if f < 0.4 * drive.rate_Hz]
    angles_rad = [2 * np.pi * f * drive.time_s for f in heard]
    lines = [wave(angle_rad) for angle_rad in angles_rad for wave in (np.cos, np.sin)]
    return 1e-6 * np.column_stack(lines or [np.zeros(len(drive.voltage_V))])


def _at_rest(standing: ConstantDriveData) -> Array | str:
    """Return the lines of the grid that fits best, at its own frequency."""
    recording, time_s, calm_m = standing.recording, standing.time_s, standing.calm_m
    rate_Hz, span_s = recording.sampling_rate_Hz, float(np.ptp(time_s))
    if rate_Hz <= 2.0 * GRIDS_Hz[0] or span_s * OFF_AT_REST_Hz < 1.0:
        return (
            f"at {significant(rate_Hz)} Hz for {with_unit(recording.duration_s, 's')} no line of "
            "the grid can be told"
        )
    steps = np.arange(-OFF_AT_REST_Hz, OFF_AT_REST_Hz, 0.25 / span_s)
    tried = [f + step for f in GRIDS_Hz if rate_Hz > 2.0 * f for step in steps.tolist()]
    power = [abs(np.exp(-2j * np.pi * f * time_s) @ calm_m) for f in tried[:4000]]
    best = peak_Hz(calm_m, time_s, tried[int(np.argmax(power))], 0.25 / span_s)
    return waves(time_s, [n * best for n in HARMONICS if 2 * n * best < rate_Hz])


def _clock_note(parameters: Parameters) -> str:
    """Return what the frequency says about the clock of the file, if it is the grid's."""
    frequency_Hz = parameters["frequency_Hz"]
    nominal_Hz = min(GRIDS_Hz, key=lambda grid_Hz: abs(grid_Hz - frequency_Hz))
    off = frequency_Hz / nominal_Hz - 1.0
    if abs(off) < CLOCK_OFF:
        return f"The line stands at {frequency_Hz:.2f} Hz."
    return (
        f"The line stands at {frequency_Hz:.2f} Hz. If this is the mains, the clock of the file "
        f"is {100.0 * abs(off):.2f} % off."
    )


def inject(recording: Recording, share: float) -> Recording:
    """Let 50 Hz hum."""
    hum = np.sin(2 * np.pi * 50.0 * seconds_of(recording) + 1.0)
    return with_added(recording, hum, share)


EFFECT = Effect(
    name="mains_interference",
    explanation=__doc__ or "",
    unit="percent of the stroke, rms where most",
    experiment="Record one minute with the drive at rest at 1 kHz or more, then once more "
    "with the amplifier unplugged: a hum that remains comes from the sensor.",
    control="A controller with gain at this frequency makes the stage follow the hum. Repair "
    "the wiring before you raise the bandwidth.",
    shows=IN_SPECTRUM,
    tangent=Tangent(columns=_tangent, own=True),
    untestable=_untestable,
    trials=_trials,
    columns=_columns,
    size=added_percent(_columns),
    note=_clock_note,
    model_error=0.04,  # a phase that wanders between knots, and higher harmonics, are not in it
    at_rest=_at_rest,
    inject=inject,
    extend=lambda found, setting: (
        MainsLines.of(setting.pieces, found.parameters["frequency_Hz"]),
    ),
    without=without_part(MainsLines),
)
