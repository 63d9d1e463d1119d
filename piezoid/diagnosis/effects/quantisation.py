"""Quantisation: the steps of a converter are coarse.

What you see
    The reading takes few values, all multiples of one step, and rests on them; or it climbs in
    equal stairs while the drive in the file is smooth.
Why it happens
    A converter has too few bits, or its range is far wider than the signal.
How it is detected
    All readings are multiples of one step that is visible beside stroke and noise. For a drive,
    the residual is a sawtooth of the drive,

        e = -D w,   w = (u - v) / D - round((u - v) / D),

    whose fundamental has the height D / pi of its period and is in phase with its harmonics.
What the extension adds
    The quantised drive. Nothing for a reading: the remedy is a finer converter or a narrower
    range.
Source
    Widrow & Kollar (2008); Rayleigh (1880) on phases that point together
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezoid.diagnosis.appearance import OVER_TIME
from piezoid.diagnosis.effect import Effect, Fault, FaultTest
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.segments import Track
from piezoid.diagnosis.signals import stroke_of, with_displacement
from piezoid.numerics.arrays import Array
from piezoid.numerics.noise import white_noise_rms
from piezoid.records.recording import Recording
from piezoid.records.sample_statistics import step_size

COARSE = 1.2e-3  # of half the stroke: rms of a twelfth of its square is 0.02 % of the stroke
VISIBLE = 1.5  # times the noise
ALIKE = 0.02  # how far the steps of two recordings may differ
MOST_SAMPLES = 0.7  # of all that must lie on the lattice
FEWEST_STEPS, MOST_STEPS = 20.0, 300.0  # of a drive in half its range
CELLS = 16_384  # of the range, which waves are told apart by
RANGE = 4.0  # in half ranges of the drive: more than any track has
FINER = 4  # frequencies for every one that the range can tell
CLEAR = 30.0  # times the median power
NEAR = 0.4  # how far from one the saw's height may be
SURE = 3.0  # standard errors of it
BLOCKS = 20  # of rows, for these
DIGITS = 6  # of half the range that tell values of a drive apart
BETWEEN = 4.0  # values of a drive within a step, or the steps may be its own
LEAST_BETWEEN = 0.1  # of all rows

DIGITS_OF_READING = 9
MOST_STEPS_OF_READING = 2000  # of a range: finer ones are nobody's cause
ON = 0.1  # of a step: so near is on the lattice
UNEVEN = 0.02  # of a step: what its last digit may be off
PHASES = 20  # tried for every one that the range can tell
MOST_ON = 0.99  # of the samples: no more than the rest are spikes


def _fault(view: View) -> Fault | None:
    return _of_reading(view) or _of_drive(view)


def _of_reading(view: View) -> Fault | None:
    steps = np.array([_step(track.measured) for track in view.tracks])
    samples = np.array([len(track.response) for track in view.tracks])
    coarse = steps > 0.0
    # a range may be chosen for each recording, and its step with it
    if samples[coarse].sum() < MOST_SAMPLES * samples.sum():
        return None
    step = float(steps[int(np.argmax(np.where(coarse, samples, 0)))])
    shared = np.abs(steps - step) < ALIKE * step
    chance = sum(
        _evidence(track.measured, own)
        for track, own in zip(view.tracks, steps.tolist(), strict=True)
        if own
    )
    apart = float(np.max(np.abs(steps[coarse & ~shared] - step), initial=0.01 * step))
    return Fault(
        tracks=view.tracks,
        value=1e9 * view.stroke_m * step,
        spread=1e9 * view.stroke_m * apart,
        p_value=float(np.exp(-min(chance, 700.0))),
    )


def _step(response: Array) -> float:
    """Return the step of a reading's lattice, 0 where it is too fine to be seen."""
    step = lattice_step(response)
    return step if step > max(COARSE, VISIBLE * white_noise_rms(response)) else 0.0


def lattice_step(response: Array) -> float:
    """Return the step of a reading's lattice, 0 where it never rests on one.

    Spikes, and what was put in their place, are off the lattice: a step that nearly all samples
    are multiples of is looked for near the usual gap by the phases of all values, before it is
    asked which step all values are multiples of.
    """
    if not np.any(np.diff(response) == 0):
        return 0.0
    values, count = np.unique(np.round(response, DIGITS_OF_READING), return_counts=True)
    usual = float(np.median(np.diff(values))) if len(values) > 1 else 0.0
    if MOST_STEPS_OF_READING * usual > values[-1] - values[0]:
        step = _step_near(usual, values)
        place = (values - values[np.argmax(count)]) / step
        if count[np.abs(place - np.round(place)) < ON].sum() > MOST_ON * len(response):
            return step
    return step_size(np.round(response, DIGITS_OF_READING))


def _step_near(usual: float, values: Array) -> float:
    """Return the step near the usual one at which the phases of values point together most.

    Printed with few digits, steps are uneven by the last of them, and a mean of them is not fine
    enough to count hundreds by.
    """
    width = float(np.ptp(values)) / usual
    step_ratios = np.linspace(1.0 - UNEVEN, 1.0 + UNEVEN, int(2.0 * UNEVEN * width * PHASES) + 2)
    phase = np.exp(2j * np.pi * np.outer(step_ratios / usual, values))
    return usual / float(step_ratios[int(np.argmax(np.abs(phase.sum(axis=1))))])


def _evidence(response: Array, step: float) -> float:
    """Return n R^2, whose exponential is how rarely n free phases point together as these do.

    R = |mean exp(2 pi i y / step)|, over the rows at which the reading changed  [Rayleigh's test]
    """
    changed = response[1:][np.diff(response) != 0]
    together = abs(np.mean(np.exp(2j * np.pi * changed / step))) if len(changed) else 0.0
    return float(len(changed) * together**2)


@dataclass(frozen=True, kw_only=True)
class Saw:
    """Steps of a drive's converter: their size, where one of them is, and the chance of such."""

    step: float
    origin: float
    p_value: float

    def of(self, drive: Array) -> Array:
        """Return by how many steps the converter is off."""
        place = (drive - self.origin) / self.step
        return np.asarray(np.round(place) - place)


def drive_step(view: View) -> float:
    """Return what a step of a coarse drive moves, of half the stroke; 0 where it is fine."""
    fault = _of_drive(view)
    return 0.0 if fault is None else 1e-9 * fault.value / view.stroke_m


def _of_drive(view: View) -> Fault | None:
    drive, residual = view.rows([t.drive for t in view.tracks]), view.null.residual
    # a staircase rests on few values: it has no saw of its own, and dilutes that of the others
    fine = np.concatenate([_goes_between(t, 1.0 / MOST_STEPS) for t in view.tracks]) > 0.0
    told = fine if fine.any() else ~fine
    saw = _strongest(drive[told], residual[told])
    if saw is None:
        return None
    between = np.concatenate([_goes_between(t, saw.step) for t in view.tracks])
    if np.mean(between) < LEAST_BETWEEN:
        return None
    wave = view.null.without(saw.of(drive) * between)
    height, spread = _height(wave, residual)
    if abs(height / saw.step - 1.0) > NEAR or height < max(COARSE, SURE * spread):
        return None
    return Fault(
        tracks=tuple(replace(t, drive=t.drive + saw.step * saw.of(t.drive)) for t in view.tracks),
        value=1e9 * view.stroke_m * height,
        spread=1e9 * view.stroke_m * max(spread, 0.01 * height),
        p_value=saw.p_value,
    )


def _height(wave: Array, residual: Array) -> tuple[float, float]:
    """Return how high a wave stands in a residual, and its standard error by blocks of rows."""
    blocks = np.array_split(np.arange(len(wave)), BLOCKS)
    pull = np.array([wave[b] @ residual[b] for b in blocks])
    square = np.array([wave[b] @ wave[b] for b in blocks])
    height = float(pull.sum() / square.sum())
    off = pull - height * square
    return height, float(np.sqrt(off @ off * BLOCKS / (BLOCKS - 1)) / square.sum())


def _goes_between(track: Track, step: float) -> Array:
    """Return for every row whether its drive takes values between steps, 1 or 0.

    One that repeats itself after few samples has a lattice of its own, and so has any residual.
    """
    values = np.unique(np.round(track.drive, DIGITS))
    apart = float(np.median(np.diff(values))) if len(values) > 1 else np.inf
    return np.full(len(track.place), float(apart * BETWEEN < step))


def _strongest(drive: Array, residual: Array) -> Saw | None:
    """Return the saw whose first wave is clearest, if its height is what its period asks for."""
    frequency, wave = _waves(drive, residual)
    power = np.abs(wave) ** 2
    j, typical = int(np.argmax(power)), float(np.median(power)) + 1e-300
    found = float(frequency[j])
    height = 2.0 * float(np.sqrt(power[j])) / len(residual)
    if power[j] < CLEAR * typical or abs(np.pi * height * found - 1.0) > NEAR:
        return None
    # cells have their middle half a cell on; the transform counts from the range's lower end
    middle = RANGE / 2 - RANGE / CELLS / 2
    turn = float(np.angle(wave[j])) + 2.0 * np.pi * found * middle
    # powers beside the peak are exponential: the median is ln 2 of their mean
    chance = len(wave) * np.exp(-float(power[j]) * np.log(2.0) / typical)
    return Saw(
        step=1.0 / found,
        origin=(np.pi / 2 - turn) / (2.0 * np.pi * found),
        p_value=float(min(1.0, chance)),
    )


def _waves(drive: Array, residual: Array) -> tuple[Array, NDArray[np.complex128]]:
    """Return the waves of a residual along its drive: their frequencies, and what they are."""
    cell = np.clip(((drive + RANGE / 2) * (CELLS / RANGE)).astype(int), 0, CELLS - 1)
    wave = np.fft.rfft(np.bincount(cell, residual, CELLS), FINER * CELLS)
    frequency = np.arange(len(wave)) / (FINER * RANGE)
    within = (frequency > FEWEST_STEPS) & (frequency < MOST_STEPS)
    return frequency[within], wave[within]


def _bound(view: View) -> float:
    """Return the rms error of the coarsest converter that agrees with the data, of the stroke.

    A reading without a lattice has more values than rows it could repeat in; a saw along the drive
    lower than the clearest wave may be there.
    """
    reading = [lattice_step(y) or 2.0 * float(np.ptp(y)) / len(y) for y in _measured(view)]
    _, wave = _waves(view.rows([t.drive for t in view.tracks]), view.null.residual)
    typical = float(np.median(np.abs(wave) ** 2))
    saw = np.pi * 2.0 * np.sqrt(CLEAR * typical) / len(view.null.residual)
    return float(max(*reading, saw, COARSE) / np.sqrt(12.0) / 2.0)


def _measured(view: View) -> list[Array]:
    return [track.measured for track in view.tracks]


def inject(recording: Recording, share: float) -> Recording:
    """Round the reading to steps whose error has this rms."""
    step_m = np.sqrt(12.0) * share * stroke_of(recording)
    return with_displacement(recording, step_m * np.round(recording.displacement_m() / step_m))


EFFECT = Effect(
    name="quantisation",
    explanation=__doc__ or "",
    unit="nm, one step",
    experiment="Record the same sweep with the converter's range reduced to the signal, or with "
    "more bits; a step that shrinks with the range is the converter's.",
    control="The loop hunts between steps; a narrower converter range helps, filters do not.",
    shows=OVER_TIME,
    tangent="its remedy is a finer converter range, not another drive",
    fault=FaultTest(find=_fault, bound=_bound),
    inject=inject,
)
