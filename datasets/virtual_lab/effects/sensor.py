"""Effects of the sensor: periodic error, filters, delays and hum."""

import numpy as np

from piezoid_datasets.virtual_lab.effects.effect import (
    Bench,
    Fault,
    Place,
    Scene,
    Trace,
    bisected,
    effect,
    proportional,
)
from piezoid_datasets.virtual_lab.signals import Array, coloured_noise, first_order, shifted

PERIODS_m = (0.6e-6, 4e-6)  # of the periodic error
TIME_CONSTANTS_s = (1e-6, 0.1)  # of the lag
DELAYS_s = (1e-6, 0.1)
ROWS = (0.05, 200.0)
MISFIT = 0.25  # largest relative deviation from the size for an integer number of rows
HARMONICS = np.array([1.0, 2.0, 3.0, 5.0])  # of the mains
WANDER_Hz = 0.02
WANDER_CORNER_Hz = 0.05


@effect(0.06, shown_by=("sweep",))
def sensor_periodic_error(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Sensor periodic error: an error of the reading that is periodic in the displacement.

    If two beams of an interferometer mix, or the two phases of an encoder have unequal amplitudes,
    the reading has an error that is periodic in the displacement:

        y = x + a sin(2 pi x / p + phi) + b sin(4 pi x / p + psi)

    Draw the period and both phases, and scale the error.

    Source: Heydemann, Appl. Opt. 20 (1981); first and second order of the cyclic error.
    """
    period_m = float(np.exp(rng.uniform(*np.log(PERIODS_m))))
    second = float(rng.uniform(0.1, 0.4))
    phases = rng.uniform(0.0, 2.0 * np.pi, 2)

    def error(displacement_m: Array) -> Array:
        turn = 2.0 * np.pi * displacement_m / period_m
        return np.asarray(np.sin(turn + phases[0]) + second * np.sin(2.0 * turn + phases[1]))

    unit = [error(trace.displacement_m) for trace in bench.traces]
    amplitude_m = proportional(size_m, unit, why="no recording has a row")
    return Fault(
        Place.SENSOR,
        lambda reading_m, _scene, _: reading_m + amplitude_m * error(reading_m),
        {"period_m": period_m, "amplitude_m": amplitude_m, "second_order": second},
    )


@effect(0.25, shown_by=("rates", "chirp"))
def lag(size_m: float, bench: Bench, _: np.random.Generator) -> Fault:
    """Lag: an undeclared filter in the sensor.

        tau dy/dt = x - y

    Examples are an output filter with a lower corner, a servo that limits the bandwidth, or a
    demodulator. At low frequencies it is a delay of tau; at higher frequencies it also attenuates.

    Search for the time constant that gives the size.

    Source: capacitive sensor manuals: the bandwidth switch.
    """

    def change(trace: Trace, tau_s: float) -> Array:
        return filtered(trace.displacement_m, tau_s, trace.scene.rate_Hz) - trace.displacement_m

    tau_s = bisected(size_m, bench.traces, change, TIME_CONSTANTS_s)
    return Fault(
        Place.SENSOR,
        lambda reading_m, scene, _: filtered(reading_m, tau_s, scene.rate_Hz),
        {"time_constant_s": tau_s},
    )


def filtered(reading_m: Array, tau_s: float, rate_Hz: float) -> Array:
    """Return the output of the filter, which starts in the steady state."""
    return first_order(reading_m, tau_s, rate_Hz, float(reading_m[0]))


@effect(0.25, shown_by=("rates", "chirp"))
def delay(size_m: float, bench: Bench, rng: np.random.Generator) -> Fault:
    """Delay: the reading is late by a time or by a number of rows.

        y(t) = x(t - tau)

    A cable, a servo or a digital filter with its own clock delays by the same time in every
    recording. A converter that returns its result some conversions later delays by rows, which is
    another time in a recording of another rate.

    Delay by rows if drawn and if an integer number gives the size, otherwise by a time.

    Source: Devasia, Eleftheriou & Moheimani, IEEE TCST 15 (2007).
    """

    def change(trace: Trace, delay_s: float) -> Array:
        still_m = trace.displacement_m
        return shifted(still_m, delay_s, trace.scene.rate_Hz) - still_m

    def change_by_rows(trace: Trace, rows: float) -> Array:
        return change(trace, rows / trace.scene.record_rate_Hz)

    rows = bisected(size_m, bench.traces, change_by_rows, ROWS)
    n_rows = max(round(rows), 1)
    if rng.random() < 0.5 and abs(n_rows / rows - 1.0) < MISFIT:
        numbers = {"rows": float(n_rows)}
    else:
        numbers = {"delay_s": bisected(size_m, bench.traces, change, DELAYS_s)}

    def delayed(reading_m: Array, scene: Scene, _: np.random.Generator) -> Array:
        delay_s = numbers["delay_s"] if "delay_s" in numbers else n_rows / scene.record_rate_Hz
        return shifted(reading_m, delay_s, scene.rate_Hz)

    return Fault(Place.SENSOR, delayed, numbers)


@effect(0.1, shown_by=("rates", "chirp", "staircase"))
def mains_interference(size_m: float, _: Bench, rng: np.random.Generator) -> Fault:
    """Mains interference: hum in the sensor cable.

    A line at 50 or 60 Hz with harmonics, whose frequency varies by some hundredths of a hertz with
    the load of the grid, so that its phase drifts relative to any fixed sine:

        m(t) = sum_k a_k sin(k theta(t) + phi_k),     dtheta/dt = 2 pi (f + wander)

    Draw the mains frequency, the harmonics and their phases.

    Source: grid frequency statistics as published by ENTSO-E (standard deviation about 20 mHz).
    """
    grid_Hz = float(rng.choice([50.0, 60.0]))
    strength = np.array([1.0, 0.15, 0.35, 0.2]) * rng.uniform(0.3, 1.0, 4)
    strength[0] = 1.0
    strength *= np.sqrt(2.0) * size_m / np.sqrt(np.sum(strength**2))
    phases = rng.uniform(0.0, 2.0 * np.pi, 4)

    def hum(reading_m: Array, scene: Scene, rng: np.random.Generator) -> Array:
        wander = coloured_noise(len(reading_m), scene.rate_Hz, WANDER_CORNER_Hz, 0.0, rng)
        cycles = np.cumsum(grid_Hz + WANDER_Hz * wander) / scene.rate_Hz + rng.random()
        lines = zip(HARMONICS, strength, phases, strict=True)
        disturbed_m = reading_m.copy()
        for k, amplitude_m, phase in lines:
            disturbed_m += amplitude_m * np.sin(2.0 * np.pi * k * cycles + phase)
        return disturbed_m

    numbers: dict[str, float | str] = {"grid_Hz": grid_Hz}
    numbers |= {f"amplitude_{k:.0f}_m": float(a) for k, a in zip(HARMONICS, strength, strict=True)}
    return Fault(Place.SENSOR, hum, numbers)
