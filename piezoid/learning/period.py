"""Play a table in simulation, and average the recorded periods of a motion."""

from dataclasses import dataclass

import numpy as np

from piezoid.errors import RecordingError
from piezoid.formatting import with_unit
from piezoid.numerics.arrays import Array
from piezoid.numerics.frequency import Response
from piezoid.records.recording import Recording
from piezoid.runtime.controller import Controller, Status
from piezoid.runtime.library import Values
from piezoid.verification.closed_loop import approach_path, run_law
from piezoid.verification.loop_plant import rest_position
from piezoid.verification.plant import AxisPlant

_SETTLED_s = 0.1  # before what is kept: ten time constants of a loop of 16 Hz
LIMITED = Status.VOLTAGE_LIMITED | Status.VOLTAGE_STEP | Status.REFERENCE_LIMITED

MAX_CLOCK_ERROR = 1e-3  # relative difference of two clocks of one rate
# A period may miss the reference by this share of its size: with a third harmonic at a mode, a
# true one missed by 0.58; readings of nothing, or in a unit a thousand times too small, miss by 1.
_MAX_MISSED = 0.9
# A period that fits twice as well from another row on is refused if it misses by more than a
# fifth: begun a twentieth of its length late, a sine misses by 0.3.
_SHIFTED, _CLEARLY_BETTER = 0.2, 0.5
_MIN_POWER = 4.0  # of a harmonic, in powers of its noise


@dataclass(frozen=True, kw_only=True, eq=False)
class Played:
    """Settled periods of a simulated table, (periods, points) each.

    position_m  in front of the sensor
    measured_m  as the converter of the sensor reads it
    voltage_V   output
    status      bits of the controller over these periods
    """

    position_m: Array
    measured_m: Array
    voltage_V: Array
    status: Status


def play(
    plant: AxisPlant,
    wanted_m: Array,
    table_V: Array,
    *,
    values: Values | None,
    periods: int = 1,
    rng: np.random.Generator,
) -> Played:
    """Play a table from rest until the motion has settled, and return the periods after that.

    values  of the controller; None: the table is the whole voltage

    With a controller the stage first approaches the beginning of the period, and the table fades
    in over the first period, as it should in the laboratory.
    """
    points = len(wanted_m)
    settling = 1 + int(np.ceil(_SETTLED_s * plant.sampling_rate_Hz / points))
    if values is None:
        drive = iter(np.tile(table_V, settling + periods).tolist())
        reference_m = np.zeros((settling + periods) * points)
        record = run_law(plant, lambda _reference, _measured: next(drive), reference_m, rng=rng)
        status = Status(0)
    else:
        approach_m = approach_path(plant, float(wanted_m[0]))
        reference_m = np.concatenate([approach_m, np.tile(wanted_m, settling + periods)])
        ahead = np.arange(len(reference_m)) + int(values["preview_samples"])
        is_after = ahead >= len(reference_m)
        ahead[is_after] -= points  # the motion goes on after the record
        fed_V = np.tile(table_V, settling + periods)
        fed_V[:points] *= np.arange(points) / points
        controller = Controller(values)
        rest_m = float(np.clip(rest_position(plant), *plant.reading_range))
        controller.start(plant.rest_voltage_V, rest_m)
        table = iter(np.concatenate([np.zeros(len(approach_m)), fed_V]).tolist())

        def step(reference_m: float, measured_m: float) -> float:
            return controller.step(reference_m, measured_m, next(table))

        record = run_law(plant, step, reference_m[ahead], rng=rng)
        status = controller.status_ever
    last_periods = (
        signal[-periods * points :].reshape(periods, points)
        for signal in (record.position, record.measured, record.voltage_V)
    )
    position_m, measured_m, voltage_V = last_periods
    return Played(position_m=position_m, measured_m=measured_m, voltage_V=voltage_V, status=status)


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

    expected_m   (points,)  reading of a stage that moves as wanted
    noise_rms_m  of one reading, if there is a single period; several periods show it themselves

    Raises ``RecordingError`` for another rate, for less than a period, and for another motion:
    with its error, and the row from which on it would fit better.
    """
    points, rate_Hz = len(expected_m), recording.sampling_rate_Hz
    if abs(rate_Hz / sampling_rate_Hz - 1.0) > MAX_CLOCK_ERROR:
        raise RecordingError(
            f"{recording.name}: it was recorded at {with_unit(rate_Hz, 'Hz', 6)}, and the table "
            f"is played at {with_unit(sampling_rate_Hz, 'Hz', 6)}",
            needed="one reading for each point of the table",
            remedy="Record at the rate of the controller.",
        )
    read_m = recording.displacement_m(axis)
    count = len(read_m) // points
    if count == 0:
        raise RecordingError(
            f"{recording.name}: {len(read_m)} samples, and a period has {points}",
            needed="one whole period or more, from point 0 of the table on",
            remedy="Record longer.",
        )
    periods_m = read_m[: count * points].reshape(count, points)
    measured_m = np.asarray(periods_m.mean(axis=0))
    _refuse_other_motion(recording.name, measured_m, expected_m)
    if count > 1:
        noise_rms_m = float(np.sqrt(np.mean(np.var(periods_m, axis=0, ddof=1))))
    return measured_m, noise_rms_m / float(np.sqrt(count))


def _refuse_other_motion(name: str, measured_m: Array, expected_m: Array) -> None:
    """Refuse a recording that misses the period, or fits much better from another row on."""
    size_m = float(np.std(expected_m))
    missed_m = float(np.std(measured_m - expected_m))
    spectra = [np.fft.rfft(values - values.mean()) for values in (measured_m, expected_m)]
    correlation = np.fft.irfft(spectra[0] * np.conj(spectra[1]), len(measured_m))
    shift = int(np.argmax(correlation))
    shifted_m = float(np.std(np.roll(measured_m, -shift) - expected_m))
    is_shifted = missed_m > _SHIFTED * size_m and shifted_m < _CLEARLY_BETTER * missed_m
    if missed_m <= _MAX_MISSED * size_m and not is_shifted:
        return
    raise RecordingError(
        f"{name}: it misses the period by {with_unit(missed_m, 'm')} rms, and the motion itself "
        f"has {with_unit(size_m, 'm')}; begun at its row {shift} it would miss by "
        f"{with_unit(shifted_m, 'm')}",
        needed=f"the period of this table, missed by less than "
        f"{with_unit(_MAX_MISSED * size_m, 'm')}, its first row at point 0",
        remedy="Start the recording with point 0, or check reference, unit and axis.",
    )


def learning_shares(error: Response, points: int, noise_rms_m: float) -> Array:
    """Return the share of each harmonic of the error that is to be learnt, 0 to 1.

        gamma_h = max(0, 1 - 4 r / |E_h|^2),   r = N s^2 = E|noise_h|^2

    points       N, of a period
    noise_rms_m  s, of the mean period. The share is a Wiener filter's with the error
    estimated from the period itself, four times as careful: a harmonic that shows less than twice
    its noise is left as it is, so what noise alone moves is 1.8 % of the harmonics. A constant
    gain c would let c / (2 - c) of the noise's power into every later period
    [Bristow, Tharayil & Alleyne 2006; Norrlof & Gunnarsson 2002].
    """
    power = np.maximum(np.abs(error) ** 2, np.finfo(float).tiny)
    return np.asarray(np.maximum(1.0 - _MIN_POWER * points * noise_rms_m**2 / power, 0.0))
