"""One mode with a Bouc-Wen spring, simulated by Runge-Kutta steps in C.

    m y'' + c y' + k y + k2 y^2 + k3 y^3 + h z = u - f0
    z' = y' (1 - |z|^n (gamma + beta sgn(z y')))              [Bouc 1967; Wen 1976]

Displacement and state are integrated in units of ``size_m``.
"""

import ctypes
import subprocess
import tempfile
from dataclasses import astuple, dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.signal import resample_poly

SIDE_SAMPLES = 32  # of the interpolating sinc, which passes 0.4 of the sampling rate to 1e-5
DIVERGED = 1e3  # times size_m
# Steps per period of the mode. The error of the true equations on the multisine of the benchmark
# is 10.4e-7 m with 43 steps, 3.5e-7 with 86, 2.5e-7 with 172, 2.4e-7 with 430.
STEPS_PER_PERIOD = 200
PERIODS = 5  # of a periodic drive, of which the last is returned


@dataclass(frozen=True, kw_only=True)
class BoucWenMode:
    """Parameters of the mode; beta and gamma are per ``size_m`` to the power n."""

    mass: float
    damping: float
    stiffness: float
    quadratic: float
    cubic: float
    spring_stiffness: float
    beta: float
    gamma: float
    exponent: float
    bias: float
    size_m: float

    def simulate(self, force: np.ndarray, rate_Hz: float, *, periodic: bool = False) -> np.ndarray:
        """Return the displacement, (samples,) m, from rest at k y = u - f0 and z = 0.

        force     (samples,) N, band-limited between the samples
        periodic  repeats the force five times and returns the last period
        """
        drive = np.tile(force, PERIODS) if periodic else force
        steps = self.steps(rate_Hz)
        start = np.array([(drive[0] - self.bias) / (self.stiffness * self.size_m), 0.0, 0.0])
        fine = band_limited(drive, 2 * steps)
        return self.size_m * integrate(self, fine, steps, rate_Hz, start)[-len(force) :]

    def steps(self, rate_Hz: float) -> int:
        """Return the integration steps per sample."""
        stiffness = max(self.stiffness + self.spring_stiffness, self.stiffness)
        natural_Hz = np.sqrt(stiffness / self.mass) / (2.0 * np.pi)
        return int(np.clip(np.ceil(STEPS_PER_PERIOD * natural_Hz / rate_Hz), 2, 64))


def band_limited(signal: np.ndarray, factor: int) -> np.ndarray:
    """Interpolate a signal without components above half its sampling rate.

    The signal is extended point-symmetrically. Returns (factor (samples - 1) + 1,) values.
    """
    head = 2.0 * signal[0] - signal[SIDE_SAMPLES:0:-1]
    tail = 2.0 * signal[-1] - signal[-2 : -SIDE_SAMPLES - 2 : -1]
    time = np.arange(-SIDE_SAMPLES * factor, SIDE_SAMPLES * factor + 1) / factor
    window = np.sinc(time) * np.kaiser(len(time), 10.0) / factor
    fine = resample_poly(np.concatenate([head, signal, tail]), factor, 1, window=window)
    first = SIDE_SAMPLES * factor
    return np.ascontiguousarray(fine[first : first + factor * (len(signal) - 1) + 1])


def integrate(
    mode: BoucWenMode, fine_force: np.ndarray, steps: int, rate_Hz: float, start: np.ndarray
) -> np.ndarray:
    """Return the displacement in units of ``size_m``, (samples,), or infinity if it diverges.

    fine_force  (2 steps (samples - 1) + 1,)  N
    start       (3,)  y and z in units of ``size_m``, y' in those per second
    """
    *rigid, spring, beta, gamma, exponent, bias, size = astuple(mode)
    scaled = np.array(rigid) * size ** np.array([1, 1, 1, 2, 3])
    parameters = np.array([*scaled, spring * size, beta, gamma, exponent])
    force = fine_force - bias
    displacement = np.empty((len(force) - 1) // (2 * steps) + 1)
    _library().simulate(
        len(displacement), steps, 1.0 / (rate_Hz * steps), force.ctypes.data,
        parameters.ctypes.data, DIVERGED, np.ascontiguousarray(start).ctypes.data,
        displacement.ctypes.data,
    )  # fmt: skip
    return displacement


def state_along(
    displacement: np.ndarray, beta: float, gamma: float, exponent: float
) -> np.ndarray:
    """Return z along a displacement, both of the order of one, (samples,)."""
    path, state = np.ascontiguousarray(displacement), np.empty(len(displacement))
    _library().follow(len(path), path.ctypes.data, beta, gamma, exponent, 0.01, state.ctypes.data)
    return state


@cache
def _library() -> ctypes.CDLL:
    source = Path(__file__).with_name("simulation.c")
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "simulation.so"
        flags = ("-std=c99", "-O3", "-ffp-contract=off", "-shared", "-fPIC")
        subprocess.run(["cc", *flags, str(source), "-o", str(target), "-lm"], check=True)
        library = ctypes.CDLL(str(target))
    size, real, pointer = ctypes.c_size_t, ctypes.c_double, ctypes.c_void_p
    library.simulate.argtypes = (size, size, real, pointer, pointer, real, pointer, pointer)
    library.follow.argtypes = (size, pointer, real, real, real, real, pointer)
    library.simulate.restype = library.follow.restype = None
    return library
