"""What a recorded period says of the table that was played: its error, and the noise of that."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from piezoid.errors import RecordingError
from piezoid.formatting import with_unit
from piezoid.numerics.arrays import Array
from piezoid.numerics.frequency import Response
from piezoid.records.recording import Recording
from piezoid.runtime.controller import Controller, Status
from piezoid.runtime.library import Values
from piezoid.verification.closed_loop import run_law
from piezoid.verification.loop_plant import rest_position
from piezoid.verification.plant import AxisPlant
from piezoid.verification.start_position import approach_path

_SETTLED_s = 0.1  # before what is kept: ten time constants of a loop of 16 Hz
LIMITED = Status.VOLTAGE_LIMITED | Status.VOLTAGE_STEP | Status.REFERENCE_LIMITED

_CLOCK = 1e-3  # by how much two clocks of one rate may differ
# A period may miss what was wanted by this share of its size: on a stranger's stage whose third
# harmonic met a mode a true one missed by 0.58, and readings of nothing, or in a unit a thousand
# times too small, miss by 1. What fits twice as well elsewhere is refused from a fifth on: begun a
# twentieth of its length late, a sine misses by 0.3.
_MOST_MISSED, _ELSEWHERE, _CLEARLY_BETTER = 0.9, 0.2, 0.5
_CAREFUL = 4.0  # times the noise's power that a harmonic must show


@dataclass(frozen=True, kw_only=True, eq=False)
class Played:
    """What is kept of a table's playing, (periods, points) each.

    position_m  in front of the sensor
    measured_m  as the sensor's converter reads it
    voltage_V   put out
    status      of the controller over these periods, all bits
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
    """Play a table from rest until the motion has settled, and keep the periods after that.

    values  of the controller; None: the table is all of the voltage

    With a controller the stage is led to where the period begins, and the table fades in over the
    first period: so should a laboratory.
    """
    points = len(wanted_m)
    settling = 1 + int(np.ceil(_SETTLED_s * plant.sampling_rate_Hz / points))
    if values is None:
        drive = iter(np.tile(table_V, settling + periods).tolist())
        reference_m = np.zeros((settling + periods) * points)
        record = run_law(plant, lambda _reference, _measured: next(drive), reference_m, rng=rng)
        status = Status(0)
    else:
        led_m = approach_path(plant, float(wanted_m[0]))
        reference_m = np.concatenate([led_m, np.tile(wanted_m, settling + periods)])
        ahead = np.arange(len(reference_m)) + int(values["preview_samples"])
        is_after = ahead >= len(reference_m)
        ahead[is_after] -= points  # the path goes on after the record
        fed_V = np.tile(table_V, settling + periods)
        fed_V[:points] *= np.arange(points) / points
        controller = Controller(values)
        controller.start(plant.rest_voltage_V, rest_position_of(plant))
        step = _stepping(controller, np.concatenate([np.zeros(len(led_m)), fed_V]))
        record = run_law(plant, step, reference_m[ahead], rng=rng)
        status = controller.status_ever
    last_periods = (
        signal[-periods * points :].reshape(periods, points)
        for signal in (record.position, record.measured, record.voltage_V)
    )
    position_m, measured_m, voltage_V = last_periods
    return Played(position_m=position_m, measured_m=measured_m, voltage_V=voltage_V, status=status)


def rest_position_of(plant: AxisPlant) -> float:
    """Return what the sensor shows of a plant at rest, m."""
    return float(np.clip(rest_position(plant), *plant.reading_range))


def _stepping(controller: Controller, fed_V: Array) -> Callable[[float, float], float]:
    table = iter(fed_V.tolist())
    return lambda reference_m, measured_m: controller.step(reference_m, measured_m, next(table))


@dataclass(frozen=True, kw_only=True, eq=False)
class Period:
    """The mean of the recorded periods.

    periods      so many
    measured_m   (points,)
    noise_rms_m  of one reading of the mean
    """

    periods: int
    measured_m: Array
    noise_rms_m: float


def mean_period(
    recording: Recording,
    axis: str,
    expected_m: Array,
    *,
    sampling_rate_Hz: float,
    noise_rms_m: float,
) -> Period:
    """Return the mean of the whole periods in a recording, its first row being point 0.

    expected_m   (points,)  what the sensor shows where the stage moves as wanted
    noise_rms_m  of one reading, where there is one period only; several show it themselves

    Raises ``RecordingError`` for another rate, for less than a period, and for what is no period
    of this motion: with how far it misses, and from which row on it would fit better.
    """
    points, rate_Hz = len(expected_m), recording.sampling_rate_Hz
    if abs(rate_Hz / sampling_rate_Hz - 1.0) > _CLOCK:
        raise RecordingError(
            f"{recording.name}: it was recorded at {with_unit(rate_Hz, 'Hz', 6)}, and the table "
            f"is played at {with_unit(sampling_rate_Hz, 'Hz', 6)}",
            needed="one reading for each point of the table",
            remedy="Record at the rate of the controller.",
        )
    read_m = recording.displacement_m(axis)
    periods = len(read_m) // points
    if periods == 0:
        raise RecordingError(
            f"{recording.name}: {len(read_m)} samples, and a period has {points}",
            needed="one whole period or more, from point 0 of the table on",
            remedy="Record longer.",
        )
    each_m = read_m[: periods * points].reshape(periods, points)
    measured_m = each_m.mean(axis=0)
    _refuse_another(recording.name, measured_m, expected_m)
    if periods > 1:
        noise_rms_m = float(np.sqrt(np.mean(np.var(each_m, axis=0, ddof=1))))
    return Period(
        periods=periods,
        measured_m=np.asarray(measured_m),
        noise_rms_m=noise_rms_m / float(np.sqrt(periods)),
    )


def _refuse_another(name: str, measured_m: Array, expected_m: Array) -> None:
    moved_m, asked_m = measured_m - measured_m.mean(), expected_m - expected_m.mean()
    size_m = float(np.std(expected_m))
    missed_m = float(np.std(measured_m - expected_m))
    together = np.fft.irfft(np.fft.rfft(moved_m) * np.conj(np.fft.rfft(asked_m)), len(moved_m))
    shift = int(np.argmax(together))
    fits_m = float(np.std(np.roll(measured_m, -shift) - expected_m))
    elsewhere = missed_m > _ELSEWHERE * size_m and fits_m < _CLEARLY_BETTER * missed_m
    if missed_m <= _MOST_MISSED * size_m and not elsewhere:
        return
    raise RecordingError(
        f"{name}: it misses the period by {with_unit(missed_m, 'm')} rms, and the motion itself "
        f"has {with_unit(size_m, 'm')}; begun at its row {shift} it would miss by "
        f"{with_unit(fits_m, 'm')}",
        needed=f"the period of this table, missed by less than "
        f"{with_unit(_MOST_MISSED * size_m, 'm')}, its first row at point 0",
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
    return np.asarray(np.maximum(1.0 - _CAREFUL * points * noise_rms_m**2 / power, 0.0))
