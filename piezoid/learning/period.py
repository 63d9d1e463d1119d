"""Simulate a table, and average the recorded periods of a motion."""

from dataclasses import replace

import numpy as np

from piezoid.errors import RecordingError
from piezoid.formatting import with_unit
from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import Response
from piezoid.records.recording import Recording
from piezoid.runtime.controller import Controller, Status
from piezoid.runtime.library import Values
from piezoid.verification.closed_loop import approach_path, run_law
from piezoid.verification.loop_plant import SettledPlant
from piezoid.verification.plant import AxisPlant
from piezoid.verification.tracking import LoopRecord

_SETTLING_s = 0.1  # before the period that is returned: ten time constants of a loop of 16 Hz
LIMITED = Status.VOLTAGE_LIMITED | Status.VOLTAGE_STEP | Status.REFERENCE_LIMITED

MAX_CLOCK_ERROR = 1e-3  # relative difference of two clocks of the same rate
# Largest deviation of a period from the reference, relative to its size. With a third harmonic at
# a mode, a valid period deviated by 0.58; a dead sensor, or a unit a thousand times too small,
# deviates by 1.
_MAX_DEVIATION = 0.9
# A period is refused if it deviates by more than a fifth and fits twice as well from another row
# on: a sine that starts a twentieth of its length late deviates by 0.3.
_MIN_DEVIATION, _MAX_SHIFTED_RATIO = 0.2, 0.5
_MIN_POWER = 4.0  # of a harmonic, relative to its noise


def play(
    plant: AxisPlant,
    wanted_m: Array,
    table_V: Array,
    *,
    values: Values | None,
    rng: np.random.Generator,
) -> LoopRecord:
    """Simulate a table from rest, and return the last period, after the motion has settled.

    values  of the controller; None: the table is the whole voltage

    With a controller the stage first approaches the start of the period, and the table fades in
    over the first period, as recommended for the laboratory. The status contains the bits of the
    controller since its start.
    """
    points = len(wanted_m)
    periods = 2 + int(np.ceil(_SETTLING_s * plant.sampling_rate_Hz / points))
    if values is None:
        drive = iter(np.tile(table_V, periods).tolist())
        reference_m = np.zeros(periods * points)
        record = run_law(plant, lambda _reference, _measured: next(drive), reference_m, rng=rng)
        return record.after((periods - 1) * points)
    approach_m = approach_path(plant, float(wanted_m[0]))
    reference_m = np.concatenate([approach_m, np.tile(wanted_m, periods)])
    ahead = np.arange(len(reference_m)) + int(values["preview_samples"])
    is_after = ahead >= len(reference_m)
    ahead[is_after] -= points  # the motion continues after the record
    faded_V = np.tile(table_V, periods)
    faded_V[:points] *= np.arange(points) / points
    controller = Controller(values)
    rest_m = float(np.clip(SettledPlant(plant).rest_position, *plant.reading_range))
    controller.start(plant.rest_voltage_V, rest_m)
    table = iter(np.concatenate([np.zeros(len(approach_m)), faded_V]).tolist())

    def step(reference_m: float, measured_m: float) -> float:
        return controller.step(reference_m, measured_m, next(table))

    record = run_law(plant, step, reference_m[ahead], rng=rng)
    status = np.full(points, int(controller.status_ever), dtype=np.uint32)
    return replace(record.after(len(reference_m) - points), status=status)


def mean_period(
    recording: Recording,
    axis: str,
    expected_m: Array,
    *,
    sampling_rate_Hz: float,
    noise_rms_m: float,
) -> tuple[Array, float]:
    """Return the mean of the whole periods in a recording, and the noise of that mean, m rms.

    The first row of the recording is point 0.

    expected_m   (points,)  reading of a stage that follows the reference exactly
    noise_rms_m  of one reading, for a recording of a single period; several periods determine it

    Raises ``RecordingError`` for another rate, for less than a period, and for another motion,
    with its deviation and the row from which it would fit best.
    """
    points, rate_Hz = len(expected_m), recording.sampling_rate_Hz
    if abs(rate_Hz / sampling_rate_Hz - 1.0) > MAX_CLOCK_ERROR:
        raise RecordingError(
            f"{recording.name}: it was recorded at {with_unit(rate_Hz, 'Hz', 6)}, and the table "
            f"is played at {with_unit(sampling_rate_Hz, 'Hz', 6)}",
            needed="one reading for each point of the table",
            remedy="Record at the rate of the controller.",
        )
    displacement_m = recording.displacement_m(axis)
    count = len(displacement_m) // points
    if count == 0:
        raise RecordingError(
            f"{recording.name}: {len(displacement_m)} samples, and a period has {points}",
            needed="at least one whole period, from point 0 of the table",
            remedy="Record longer.",
        )
    periods_m = displacement_m[: count * points].reshape(count, points)
    measured_m = np.asarray(periods_m.mean(axis=0))
    # Another motion, or this one from another row on.
    size_m, deviation_m = float(np.std(expected_m)), float(np.std(measured_m - expected_m))
    spectra = [np.fft.rfft(values - values.mean()) for values in (measured_m, expected_m)]
    correlation = np.fft.irfft(spectra[0] * np.conj(spectra[1]), points)
    shift = int(np.argmax(correlation))
    shifted_m = float(np.std(np.roll(measured_m, -shift) - expected_m))
    fits_better = shifted_m < _MAX_SHIFTED_RATIO * deviation_m
    is_late = deviation_m > _MIN_DEVIATION * size_m and fits_better
    if not deviation_m <= _MAX_DEVIATION * size_m or is_late:
        raise RecordingError(
            f"{recording.name}: it deviates from the period by {with_unit(deviation_m, 'm')} rms, "
            f"and the motion itself has {with_unit(size_m, 'm')} rms; from its row {shift} on it "
            f"would deviate by {with_unit(shifted_m, 'm')}",
            needed="the period of this table from point 0, with a deviation of less than "
            f"{with_unit(_MAX_DEVIATION * size_m, 'm')}",
            remedy="Start the recording with point 0, or check reference, unit and axis.",
        )
    if count > 1:
        noise_rms_m = float(np.sqrt(np.mean(np.var(periods_m, axis=0, ddof=1))))
    return measured_m, noise_rms_m / float(np.sqrt(count))


def learning_shares(error: Response, points: int, noise_rms_m: float) -> Array:
    """Return the share of each harmonic of the error that is learnt, 0 to 1.

        gamma_h = max(0, 1 - 4 r / |E_h|^2),   r = N s^2 = E|noise_h|^2

    points       N, of a period
    noise_rms_m  s, of the mean period

    This is a Wiener filter with the error estimated from the period itself and four times the
    noise: a harmonic below twice its noise is not learnt, and noise alone exceeds this threshold
    in 1.8 % of the harmonics. A constant gain c would add c / (2 - c) of the noise's power to
    every later period [Bristow, Tharayil & Alleyne 2006; Norrlof & Gunnarsson 2002].
    """
    power = np.maximum(np.abs(error) ** 2, np.finfo(float).tiny)
    return np.asarray(np.maximum(1.0 - _MIN_POWER * points * noise_rms_m**2 / power, 0.0))
