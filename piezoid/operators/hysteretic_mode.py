"""A mode with a hysteretic restoring force: the memory stands inside the loop of the motion.

    m y'' + c y' + k y + k2 y^2 + k3 y^3 + z = f,    z = h s    or    z = sum_i w_i e_i
    s' = y' (1 - |s|^n (gamma + beta sgn(s y')))         Bouc-Wen
    e_i = stop of y of half-width r_i                    Maxwell slip

Source: Bouc (1967); Wen, J. Eng. Mech. 102 (1976); Iwan, J. Appl. Mech. 33 (1966). A drive of a
piezo stage stands for the force it makes, so m, c, k, h and w_i are per unit of the drive.

The Bouc-Wen state: one state that saturates smoothly and whose small loops do not close.

    dz/du = 1 - |z|^n (gamma + beta sgn(z du))

Source: Bouc (1967); Wen, J. Eng. Mech. 102 (1976).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.library import KERNELS, address, contiguous

LONGEST = 0.01  # step of the drive; the midpoint rule then errs by some 1e-5 of the state

Hold = Literal["band_limited", "zero_order"]

LIMIT = 1e3  # sizes of the motion: farther out the numbers are those of a spring that pushes


@dataclass(frozen=True, kw_only=True)
class BoucWenSpring:
    """z = h s: a spring whose force turns over smoothly.

    stiffness  h          drive unit / m
    beta       1 / size   loading against unloading
    gamma      1 / size   both ways; beta + gamma < 0 stiffens
    exponent   n          sharpness of the knee
    """

    stiffness: float
    beta: float
    gamma: float
    exponent: float


@dataclass(frozen=True, kw_only=True)
class MaxwellSlip:
    """z = sum_i w_i e_i: springs in parallel, each of which slips at its own threshold.

    threshold  (stops,)  r_i, in sizes
    stiffness  (stops,)  w_i, drive unit / m; a negative one lets the sum stiffen
    """

    threshold: tuple[float, ...]
    stiffness: tuple[float, ...]


Spring = BoucWenSpring | MaxwellSlip


@dataclass(frozen=True, kw_only=True)
class HystereticMode:
    """m y'' + c y' + k y + k2 y^2 + k3 y^3 + z = f.

    mass       m     drive unit s^2 / m
    damping    c     drive unit s / m
    stiffness  k     drive unit / m
    quadratic  k2    drive unit / m^2
    cubic      k3    drive unit / m^3
    spring     z
    size_m           of the motion: states and thresholds are counted in it
    """

    mass: float
    damping: float
    stiffness: float
    quadratic: float
    cubic: float
    spring: Spring
    size_m: float

    def simulated(self, drive: "FineDrive", start: Array) -> tuple[Array, Array]:
        """Return y, (samples,) m, and the state at the last sample.

        start  (3 + stops,)  y and s or e_i in sizes, y' in sizes per s; no stops: (3,)
        """
        state = np.array(start, dtype=np.float64)
        smooth, threshold, weight = np.array([0.0, 0.0, 0.0, 1.0]), np.empty(0), np.empty(0)
        if isinstance(self.spring, BoucWenSpring):
            of = self.spring
            smooth = np.array([of.stiffness, of.beta, of.gamma, of.exponent])
        else:
            threshold = np.array(self.spring.threshold)
            weight = np.array(self.spring.stiffness)
        smooth[0] *= self.size_m
        size = self.size_m ** np.array([1, 1, 1, 2, 3])
        rigid = [self.mass, self.damping, self.stiffness, self.quadratic, self.cubic]
        y = np.empty(drive.samples)
        KERNELS.pk_hysteretic_mode(
            len(y),
            drive.steps,
            drive.step_s,
            int(drive.hold == "zero_order"),
            address(drive.values),
            address(size * np.array(rigid)),
            address(smooth),
            LIMIT,
            len(threshold),
            address(threshold),
            address(self.size_m * weight),
            address(state),
            address(y),
        )
        return self.size_m * y, state


@dataclass(frozen=True, kw_only=True, eq=False)
class FineDrive:
    """A drive at the ends and in the middle of every step of the integration.

    values   (2 steps (samples - 1) + 1,)
    samples  of the recording
    steps    of the integration, per sample
    step_s   of one of them
    hold     zero_order: it jumps at each sample
    """

    values: Array
    samples: int
    steps: int
    step_s: float
    hold: Hold


TAPS = 32  # samples on each side: 0.4 of the sampling rate passes to 1e-5


def fine_drive(drive: Array, sampling_rate_Hz: float, steps: int, hold: Hold) -> FineDrive:
    """Return the drive between its samples.

    drive  (samples,)
    hold   zero_order: constant until the next sample, as a converter puts it out;
           band_limited: the one signal without frequencies above half the sampling rate

    A band-limited drive is unknown beyond its ends, where it is taken to be point-symmetric.
    """
    given, finer = contiguous(drive), 2 * steps
    if hold == "zero_order":
        values = np.concatenate([np.repeat(given[:-1], finer), given[-1:]])
    else:
        from scipy.signal import resample_poly

        pad = min(TAPS, len(given) - 1)
        before = 2.0 * given[0] - given[pad:0:-1]
        after = 2.0 * given[-1] - given[-2 : -pad - 2 : -1]
        longer = np.concatenate([before, given, after])
        place = np.arange(-TAPS * finer, TAPS * finer + 1) / finer
        weight = np.sinc(place) * np.kaiser(len(place), 10.0) / finer
        values = resample_poly(longer, finer, 1, window=weight)
        values = values[pad * finer : (pad + len(given) - 1) * finer + 1]
    step_s = 1.0 / (sampling_rate_Hz * steps)
    return FineDrive(
        values=contiguous(values), samples=len(given), steps=steps, step_s=step_s, hold=hold
    )


def bouc_wen_states(
    drive: Array, beta: float, gamma: float, exponent: float, start: float = 0.0
) -> Array:
    """Return the state along a drive.

    drive            (samples,)  of the order of one
    beta, gamma      scalars     loading and unloading; 1 / unit of the drive, to the power n
    exponent         scalar      n >= 1, sharpness of the knee
    start            scalar      z at the first sample
    returned         (samples,)  unit of the drive
    """
    given = contiguous(drive)
    found, state = np.empty_like(given), np.array([start])
    KERNELS.pk_bouc_wen(
        len(given), address(given), beta, gamma, exponent, LONGEST, address(state), address(found)
    )
    return found
