"""Noise of a tunnelling current: a variance that depends on the current.

    v(i) = floor^2 + 2 e |i| B + (rho i)^2

floor^2  Johnson noise of the feedback resistor, converter steps and what else a dark amplifier
         shows; never less than what is declared of the chain
2 e |i|  shot noise in the bandwidth B of the reading
rho      relative noise: a gap that jitters by sigma makes rho = k sigma

Floor and rho are estimated from the residuals by pseudo-likelihood [Carroll & Ruppert 1988]:
given the mean, they maximise a normal likelihood; given them, the mean is refitted.
"""

import math
from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.operators.tunnelling import BOLTZMANN_J_PER_K, ELEMENTARY_CHARGE_C

_ROUGHEST = 3.0  # largest relative noise considered: beyond it there is no signal
_SMOOTHEST = 1e-6


@dataclass(frozen=True, kw_only=True)
class CurrentChain:
    """Declared properties of the current amplifier and converter; None: not declared.

    bandwidth_Hz   of one reading: 1 / (2 integration time) for an averaged one
    feedback_ohm   resistor of the transimpedance stage
    temperature_K  of that resistor
    adc_step_A     one step of the converter, in current
    """

    bandwidth_Hz: float | None = None
    feedback_ohm: float | None = None
    temperature_K: float = 293.0
    adc_step_A: float | None = None

    @property
    def johnson_A(self) -> float:
        """Rms Johnson noise of one reading, sqrt(4 k T B / R); zero where not declared."""
        if self.bandwidth_Hz is None or self.feedback_ohm is None:
            return 0.0
        power = 4.0 * BOLTZMANN_J_PER_K * self.temperature_K * self.bandwidth_Hz
        return math.sqrt(power / self.feedback_ohm)

    @property
    def quantisation_A(self) -> float:
        """Rms of one converter step, step / sqrt(12); zero where not declared."""
        return 0.0 if self.adc_step_A is None else self.adc_step_A / math.sqrt(12.0)

    @property
    def declared_floor_A(self) -> float:
        """Lower bound of the rms noise without current, from the declared properties."""
        return math.hypot(self.johnson_A, self.quantisation_A)

    def shot_A(self, current_A: float) -> float:
        """Rms shot noise of one reading, sqrt(2 e |i| B); zero where B is not declared."""
        bandwidth_Hz = self.bandwidth_Hz or 0.0
        return math.sqrt(2.0 * ELEMENTARY_CHARGE_C * abs(current_A) * bandwidth_Hz)


@dataclass(frozen=True, kw_only=True)
class CurrentNoise:
    """The estimated noise of a current reading.

    floor_A   A, of no current at all; the declared floor included
    relative  1, the part proportional to the current
    chain     what was declared, for the shot noise
    """

    floor_A: float
    relative: float
    chain: CurrentChain

    def variance(self, mean_A: Array) -> Array:
        """Return v(i) of the module's equation, in A^2, for each mean current."""
        shot = 2.0 * ELEMENTARY_CHARGE_C * (self.chain.bandwidth_Hz or 0.0)
        variance: Array = self.floor_A**2 + shot * np.abs(mean_A) + (self.relative * mean_A) ** 2
        return variance


def estimate_noise(residual_A: Array, mean_A: Array, chain: CurrentChain) -> CurrentNoise:
    """Return floor and relative noise that make the residuals most likely.

        maximise  - sum ( ln v_j + r_j^2 / v_j )      over floor >= declared, rho >= 0

    r  residual_A  (points,)  A, measured minus mean; outliers already pulled in
    i  mean_A      (points,)  A

    A search in two logarithms, so that neither part can become negative.
    """
    from scipy.optimize import minimize

    typical_A = max(float(np.sqrt(np.mean(residual_A**2))), chain.declared_floor_A, 1e-30)
    scale_A = max(float(np.max(np.abs(mean_A))), typical_A)
    lowest = math.log(max(chain.declared_floor_A, 1e-6 * typical_A))
    bounds = [
        (lowest, math.log(10.0 * typical_A) + 1e-9),
        (math.log(_SMOOTHEST), math.log(_ROUGHEST)),
    ]

    def deviance(logs: Array) -> float:
        noise = CurrentNoise(floor_A=math.exp(logs[0]), relative=math.exp(logs[1]), chain=chain)
        variance = noise.variance(mean_A)
        return float(np.sum(np.log(variance) + residual_A**2 / variance))

    dark_A = float(np.median(np.abs(residual_A[np.abs(mean_A) <= np.median(np.abs(mean_A))])))
    starts = [
        (
            math.log(max(dark_A, 1e-6 * typical_A)),
            math.log(max(typical_A / scale_A, _SMOOTHEST)),
        ),
        (math.log(typical_A), math.log(_SMOOTHEST) / 2.0),
    ]
    minima = [
        minimize(
            deviance,
            np.clip(start, [b[0] for b in bounds], [b[1] for b in bounds]),
            method="Nelder-Mead",
            bounds=bounds,
            options={"xatol": 1e-4, "fatol": 1e-6, "maxiter": 400},
        )
        for start in starts
    ]
    best = min(minima, key=lambda result: float(result.fun)).x
    return CurrentNoise(
        floor_A=math.exp(float(best[0])), relative=math.exp(float(best[1])), chain=chain
    )
