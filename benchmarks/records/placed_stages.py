"""Virtual stages with hysteresis before a mode, behind it, or inside; the fit shares none of it.

    python -m benchmarks.records.placed_stages [--first 1] [--stages 20] [--places before,inside]

Before and behind, the hysteresis is a ceramic of the virtual laboratory: Preisach by its Everett
function, Krasnoselskii-Pokrovskii, Duhem, Coleman-Hodgdon and others, none of them a sum of plays.
Inside, the force is a Bouc-Wen spring, or Duhem's with tanh for its anhysteretic curve, integrated
by scipy's LSODA. The fit knows neither the law nor the damping, nor the level of the noise.
"""

import argparse
import time
from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.signal import cont2discrete, lfilter, resample

import piezoid
from piezoid_datasets.virtual_lab.truths import ZOO

PLACES = ("before", "behind", "inside")
SAMPLES = 8192
FINER = 8
PER_PERIOD = 25  # samples of a recording in a period of the mode


def multisine(rng: np.random.Generator, highest: float) -> np.ndarray:
    """Draw one period of SAMPLES between -1 and 1, of lines up to a share of the sampling rate."""
    lines = np.arange(int(0.1 / PER_PERIOD * SAMPLES), int(highest * SAMPLES))
    spectrum = np.zeros(SAMPLES // 2 + 1, dtype=complex)
    spectrum[lines] = np.exp(2j * np.pi * rng.random(len(lines)))
    drive = np.fft.irfft(spectrum)
    return drive / np.abs(drive).max()


def mode_of(fine: np.ndarray, mode_Hz: float, damping: float, rate_Hz: float) -> np.ndarray:
    """Return what a mode of gain one makes of a signal between its samples."""
    w = 2.0 * np.pi * mode_Hz
    system = ([w**2], [1.0, 2.0 * damping * w, w**2])
    top, bottom, _ = cont2discrete(system, 1.0 / rate_Hz, method="foh")
    return lfilter(top.ravel(), bottom, fine)


def inside(
    rng: np.random.Generator, drive: np.ndarray, mode_Hz: float, damping: float, rate_Hz: float
) -> tuple[np.ndarray, str]:
    """Integrate w^-2 y'' + 2 d y'/w + (1 - p) y + p z = u for a law of z, and name it."""
    w, share = 2.0 * np.pi * mode_Hz, rng.uniform(0.25, 0.6)
    time_s = np.arange(len(drive)) / rate_Hz
    force = CubicSpline(time_s, drive)
    size = np.abs(mode_of(drive, mode_Hz, max(damping, 0.05), rate_Hz)).max()
    law = "bouc_wen" if rng.random() < 0.5 else "duhem"
    if law == "bouc_wen":
        beta, gamma, n = rng.uniform(0.3, 1.2), rng.uniform(-0.5, 0.3), rng.uniform(1.0, 2.0)

        def way(z: float, v: float, _: float) -> float:
            q = z / size
            return v * (1.0 - abs(q) ** n * (gamma + beta * np.sign(q * v)))
    else:
        pull, knee = rng.uniform(0.5, 1.5) / size, rng.uniform(0.4, 1.0) * size

        def way(z: float, v: float, y: float) -> float:
            return pull * abs(v) * (knee * np.tanh(y / knee) - z) + 0.5 * v

    def rate(t: float, x: np.ndarray) -> list[float]:
        y, v, z = x
        pushed = force(t) - (1.0 - share) * y - share * z - 2.0 * damping * v / w
        return [v, w**2 * pushed, way(z, v, y)]

    found = solve_ivp(
        rate, (0.0, time_s[-1]), [0.0, 0.0, 0.0], method="LSODA", t_eval=time_s,
        rtol=1e-6, atol=1e-9, max_step=2.0 / rate_Hz,
    )  # fmt: skip
    return found.y[0], law


def stage(place: str, seed: int) -> tuple[piezoid.Recording, str]:
    """Draw a stage and record it; return the recording and the name of its law."""
    rng = np.random.default_rng([PLACES.index(place), seed])
    mode_Hz, damping = np.exp(rng.uniform(np.log(40.0), np.log(900.0))), rng.uniform(0.01, 0.08)
    rate_Hz = PER_PERIOD * mode_Hz
    drive = multisine(rng, 2.5 / PER_PERIOD)
    if place == "inside":
        motion, law = inside(rng, drive, mode_Hz, damping, rate_Hz)
    else:
        truth = ZOO[int(rng.integers(len(ZOO)))]
        ceramic, law = truth.draw(rng), truth.name
        fine = resample(drive, FINER * SAMPLES)
        motion = cascade(place, fine, ceramic.respond, mode_Hz, damping, FINER * rate_Hz)[::FINER]
    motion = motion - motion[0]
    noise = rng.uniform(1e-3, 5e-3) * motion.std() * rng.standard_normal(len(motion))
    recording = piezoid.from_arrays(
        voltage_V=75.0 + 75.0 * drive, displacement_m=1e-5 * (motion + noise),
        sampling_rate_Hz=rate_Hz, name=f"{place}_{seed}",
    )  # fmt: skip
    return recording, law


def cascade(
    place: str,
    fine: np.ndarray,
    respond: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]],
    mode_Hz: float,
    damping: float,
    rate_Hz: float,
) -> np.ndarray:
    """Return ceramic and mode one behind the other."""
    if place == "before":
        strain = sum(respond(fine, np.array([0.0])))
        return mode_of(strain - strain[0], mode_Hz, damping, rate_Hz)
    moved = mode_of(fine, mode_Hz, damping, rate_Hz)
    return np.asarray(sum(respond(moved / np.abs(moved).max(), np.array([0.0]))))


def main() -> None:
    """Judge fresh stages of each kind and print what was said of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--stages", type=int, default=20)
    parser.add_argument("--places", default=",".join(PLACES))
    given = parser.parse_args()
    for place in given.places.split(","):
        said = []
        for seed in range(given.first, given.first + given.stages):
            recording, law = stage(place, seed)
            began = time.perf_counter()
            found = piezoid.place_hysteresis(recording, hold="band_limited")
            took_s = time.perf_counter() - began
            said.append(found.place)
            errors = ", ".join(f"{name} {rms:.2e}" for name, rms in found.left_out_rms_m.items())
            errors += f", without {found.without_rms_m or np.nan:.2e}"
            print(f"{place} {seed} {law}: {found.place}; {errors} m; {took_s:.1f} s", flush=True)
        told = {name: said.count(name) for name in (*PLACES, "not separable")}
        print(f"{place}: {told[place]} of {len(said)} right; {told}\n", flush=True)


if __name__ == "__main__":
    main()
