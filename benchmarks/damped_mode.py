"""Bandwidths of several methods to damp a mode, for docs/theory/control.md.

    python -m benchmarks.damped_mode

The stage has a mode at 700 Hz of quality 40, 50 us of delay, 20 kHz, and a frequency known to
10 %. The sensitivity is -3 dB at the bandwidth and decreases by 20 dB per decade below. The
bandwidth is the largest one for which all thirteen members of the family meet the limits: a
modulus margin of 0.5, a delay margin of one sample and an effort of ten times the static drive.
One search tunes all methods, from the listed starts and from twenty random ones.
"""

from collections.abc import Callable

import numpy as np
from scipy.signal import bilinear

from benchmarks.varied_chains import Chain, family_from_chains, varied
from piezoid.design.loop_search import FamilyGrid, family_grid, magnitudes, search
from piezoid.design.observer import ObserverFrame, disturbance_model, feedback_polynomials
from piezoid.design.plant import PlantFamily, Section
from piezoid.design.rst import section_poles
from piezoid.design.specification import Specification, default_specification
from piezoid.errors import DesignError
from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import product, total

RATE_Hz, GAIN_m_per_V, MEMBERS, RANDOM_STARTS, EVALUATIONS, SEED = 20e3, 1e-7, 13, 20, 300, 1
ATTENUATION = 10.0 ** (-3.0 / 20.0)
INFEASIBLE = (1e3, 1e3)
Build = Callable[[Array], tuple[Array, Array]]
INTEGRATOR = np.array([1.0, -1.0])


def family(
    *,
    mode_Hz: float = 700.0,
    quality: float = 40.0,
    delay_s: float = 50e-6,
    spread: float = 0.1,
    lags_Hz: tuple[float, ...] = (),
) -> PlantFamily:
    """Return the nominal stage and members with other frequencies of the mode."""
    mode = Section(frequency_Hz=mode_Hz, damping=0.5 / quality)
    chain = Chain(
        label="nominal",
        sampling_rate_Hz=RATE_Hz,
        gain=GAIN_m_per_V,
        output_unit="m",
        sections=(mode, *(Section(frequency_Hz=f) for f in lags_Hz)),
        delay_s=delay_s,
    )
    factors = np.linspace(1.0 - spread, 1.0 + spread, MEMBERS if spread else 0).tolist()
    return family_from_chains(chain, [varied(chain, mode_factor=factor) for factor in factors])


def specification_of(plants: PlantFamily) -> Specification:
    """Return the default limits of a family."""
    return default_specification(
        plants,
        voltage_min_V=-50.0,
        voltage_max_V=50.0,
        sensor_noise_rms=1e-9,
        disturbance_rms=2e-8,
    )


def bandwidth_Hz(grid: FamilyGrid, R: Array, S: Array) -> tuple[float, float]:
    """Return the largest bandwidth within its template, and the excess of other limits [dB]."""
    functions, outside = magnitudes(grid, R, S)
    if outside:
        return 1.0, 60.0 * outside
    f, syp = grid.frequency_Hz, functions[0].max(axis=0)
    bandwidths_Hz = np.minimum.accumulate(ATTENUATION * f / syp)
    inside = np.flatnonzero(bandwidths_Hz >= f)
    limits = grid.limits.copy()
    limits[0] = 1.0 / grid.specification.modulus_margin
    excess_dB = 20.0 * np.log10((functions / limits[:, None, :]).max())
    return float(bandwidths_Hz[inside[-1]]) if len(inside) else 1.0, float(excess_dB)


def integrator(x: Array) -> tuple[Array, Array]:
    """Return k / s."""
    return np.array([x[0] / RATE_Hz / GAIN_m_per_V]), INTEGRATOR


def notch(x: Array) -> tuple[Array, Array]:
    """Return an integrator behind a notch of variable depth and width."""
    k, f, shallow, wide = x
    w = 2.0 * np.pi * f
    b, a = bilinear([1, 2 * shallow * w, w * w], [1, 2 * wide * w, w * w], RATE_Hz)
    return product([k / RATE_Hz / GAIN_m_per_V], b / a[0]), product(INTEGRATOR, a / a[0])


def positive_position(x: Array) -> tuple[Array, Array]:
    """Return an integrator around positive position feedback through a second-order filter."""
    k, gain, f, damping = x
    w = 2.0 * np.pi * f
    b, a = bilinear([gain * w * w], [1, 2 * damping * w, w * w], RATE_Hz)
    b, a = b / a[0], a / a[0]
    R = total(product([k / RATE_Hz], a), -product(b, INTEGRATOR)) / GAIN_m_per_V
    return R, product(INTEGRATOR, a)


def integral_resonant(x: Array) -> tuple[Array, Array]:
    """Return integral feedback of the reading plus feedthrough -d u, inside an integrator."""
    k, inner, through = x
    b, a = np.array([0.0, -inner / RATE_Hz]), INTEGRATOR
    R = -product(b, total([k / RATE_Hz], -INTEGRATOR)) / GAIN_m_per_V
    return R, product(total(a, -through * b), INTEGRATOR)


def observer_design(plants: PlantFamily, lags_Hz: tuple[float, ...]) -> Build:
    """Return the observer with state feedback, which piezoid designs."""
    plant = plants.nominal
    frame = ObserverFrame(plant=plant, disturbance=disturbance_model(RATE_Hz), form="affine")
    lags = np.exp(-2.0 * np.pi * np.array(lags_Hz) / RATE_Hz)

    def build(x: Array) -> tuple[Array, Array]:
        pairs = [Section(frequency_Hz=x[k], damping=x[k + 1]) for k in (0, 2)]
        feedback, error = (section_poles(pair, RATE_Hz) for pair in pairs)
        slow = [np.exp(-2.0 * np.pi * x[4] / RATE_Hz)]
        return feedback_polynomials(
            frame.placed(
                feedback_poles=np.concatenate([feedback, lags]),
                observer_poles=np.concatenate([error, slow, lags**1.05]),
            )
        )

    return build


def best_Hz(plants: PlantFamily, build: Build, lowest: list, highest: list, starts: list) -> float:
    """Return the largest bandwidth that the search finds."""
    grid = family_grid(plants, specification_of(plants))
    rng = np.random.default_rng(SEED)
    low, high = np.log(lowest), np.log(highest)

    def evaluate(x: Array) -> tuple[float, float]:
        try:
            f, excess_dB = bandwidth_Hz(grid, *build(np.exp(x)))
        except DesignError:
            return INFEASIBLE
        return -float(np.log(f)), excess_dB

    random_starts = [rng.uniform(low, high) for _ in range(RANDOM_STARTS)]
    optimum = search(
        evaluate,
        low,
        high,
        [*(np.log(start) for start in starts), *random_starts],
        evaluations=EVALUATIONS,
        reserve_dB=0.05,
    )
    cost, excess_dB = evaluate(optimum)
    return float(np.exp(-cost)) if excess_dB <= 0.0 else 0.0


def observer_Hz(lags_Hz: tuple[float, ...] = (), **changes: float) -> float:
    """Return the bandwidth of the observer on a family."""
    plants = family(lags_Hz=lags_Hz, **changes)
    f = changes.get("mode_Hz", 700.0)
    return best_Hz(
        plants,
        observer_design(plants, lags_Hz),
        [35.0, 0.01, 35.0, 0.01, 35.0],
        [2000.0, 1.6, 4000.0, 1.6, 4000.0],
        [
            [1.03 * f, 0.144, min(4.7 * f, 4e3), 0.83, min(3.1 * f, 4e3)],
            [f, 0.9, 1.9 * f, 0.8, f],
        ],
    )


def main() -> None:
    """Print both tables."""
    plants = family()
    methods = {
        "integrator": (integrator, [1], [1e4], [[30]]),
        "integral resonant control": (
            integral_resonant,
            [1, 10, 0.5],
            [1e4, 5e4, 20],
            [[300, 3000, 1.5], [5000, 300, 5]],
        ),
        "integrator and notch": (
            notch,
            [1, 300, 1e-3, 0.05],
            [1e4, 1500, 1, 20],
            [[600, 700, 0.02, 0.7], [1500, 700, 0.03, 2]],
        ),
        "positive position feedback": (
            positive_position,
            [1, 0.01, 300, 0.02],
            [1e4, 3, 3000, 3],
            [[300, 0.5, 800, 0.4], [1400, 0.7, 880, 1.2]],
        ),
    }
    for name, (build, *ranges) in methods.items():
        print(f"{name:32s} {best_Hz(plants, build, *ranges):6.0f} Hz", flush=True)
    print(f"{'observer and state feedback':32s} {observer_Hz():6.0f} Hz", flush=True)
    for name, values in (
        ("spread", (0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3)),
        ("delay_s", (0.0, 25e-6, 50e-6, 100e-6, 150e-6, 200e-6)),
        ("mode_Hz", (300.0, 500.0, 700.0, 1000.0, 1500.0)),
    ):
        for value in values:
            print(f"{name:8s} {value:8g} {observer_Hz(**{name: value}):6.0f} Hz", flush=True)
    filters = observer_Hz(lags_Hz=(4000.0, 8500.0))
    print(f"behind lags of 4 and 8.5 kHz {filters:6.0f} Hz", flush=True)


if __name__ == "__main__":
    main()
