"""fit_dynamics: a frequency response -> modes, lags and delay; start values, then likelihood."""

from dataclasses import dataclass

import numpy as np

from piezoid.errors import IdentificationError
from piezoid.identification.dynamics.frequency_response import ComplexArray, FrequencyResponse
from piezoid.identification.dynamics.maximum_likelihood import ModalFit, maximise_likelihood
from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.identification.dynamics.modal_basis import Filter, Hold, Lines, Structure, basis
from piezoid.identification.dynamics.periodic_estimate import smoothed
from piezoid.identification.dynamics.vector_fitting import (
    start_poles,
    vector_fit,
    weighted_misfit,
)
from piezoid.numerics.arrays import Array

EXCHANGES = 3
GOOD_ENOUGH = 1.05  # cost over its expected value at which nothing is looked for
WORTH_IT = 1e-3  # relative fall of the cost below which exchanging ends
NEW_DAMPING = 0.015
LOCAL = 100  # the residual is averaged over so many-th parts of the band

START_LINES = 500  # delays are compared on no more lines than this
START_ROUNDS = 6
FULL_ROUNDS = 12


@dataclass(frozen=True, kw_only=True)
class Declaration:
    """What is known of the chain and not to be fitted.

    hold              ``zero_order`` when the drive column holds the numbers sent to the
                      converter, ``band_limited`` when it was measured through a filter
    filters           amplifier, sensor, anti-alias filter
    longest_delay_s   delays up to here are tried as starts; None means four samples
    """

    hold: Hold = "zero_order"
    filters: tuple[Filter, ...] = ()
    longest_delay_s: float | None = None


def fit_dynamics(
    measured: FrequencyResponse, structure: Structure, declaration: Declaration
) -> LinearDynamics:
    """Fit the modal form to a measured response by maximum likelihood.

        minimise sum |G_hat - G(theta)|^2 / variance                [Pintelon & Schoukens 2012]

    measured     with variances; rejected lines do not count
    structure    how many modes, lags, ... ; ``choose_structure`` finds it
    declaration  hold and known filters

    Start values come from vector fitting after several trial delays; modes it misplaced move to
    the largest residual. The stated covariance takes
    the variances of ``measured`` as they are, and widens where the residual is larger. Columns of
    inputs are weighted independently, exact for orthogonal multisines.
    """
    weight = measured.weights()
    _check_values(weight, structure)
    lines = Lines(
        frequency_Hz=measured.frequency_Hz,
        sampling_rate_Hz=measured.sampling_rate_Hz,
        hold=declaration.hold,
        declared=declaration.filters,
    )
    start = _start_shape(measured, weight, structure, declaration)
    first = maximise_likelihood(measured.response, weight, lines, structure, start)
    expected = _expected_cost(measured, structure, first)
    fit = exchange_modes(measured.response, weight, lines, structure, first, expected)
    return _record(measured, structure, declaration, fit)


def _check_values(weight: Array, structure: Structure) -> None:
    values = 2 * int((weight > 0).sum(axis=0).min())
    needed = structure.columns + structure.shapes
    if values < 2 * needed:
        raise IdentificationError(
            f"{values} usable real values in the poorest path, {needed} parameters",
            needed="at least twice as many values as parameters",
            remedy="Measure more lines, or take fewer modes.",
        )


def _start_shape(
    measured: FrequencyResponse, weight: Array, structure: Structure, declaration: Declaration
) -> Array:
    """Vector fitting for several trial delays; the best one again on all lines."""
    size = len(measured.frequency_Hz)
    scale = 2 * np.pi * measured.frequency_Hz[-1]
    s = 2j * np.pi * measured.frequency_Hz / scale
    flat, w = measured.response.reshape(size, -1), weight.reshape(size, -1)
    chain = declared_response(measured, declaration)
    poles = start_poles(s[0].imag, 1.0, structure.modes, structure.lags)
    few = slice(None, None, -(-size // START_LINES))
    trials = []
    for delay_s in _trial_delays(measured, declaration):
        known = (chain * np.exp(-s * scale * delay_s))[:, None]
        data, spread = flat / known, w * np.abs(known)
        found = vector_fit(s[few], data[few], spread[few], poles, rounds=START_ROUNDS)
        misfit = weighted_misfit(s[few], data[few], spread[few], found)
        trials.append((misfit, delay_s, found))
    _, delay_s, found = min(trials, key=lambda trial: trial[0])
    known = (chain * np.exp(-s * scale * delay_s))[:, None]
    found = vector_fit(s, flat / known, w * np.abs(known), found, rounds=FULL_ROUNDS)
    return np.append(_shape_of_poles(found * scale / (2 * np.pi), structure), delay_s)


def declared_response(measured: FrequencyResponse, declaration: Declaration) -> ComplexArray:
    """Return what is declared, (lines,); a hold is seen as the mean over its sample."""
    f = measured.frequency_Hz
    chain = np.ones(len(f), dtype=np.complex128)
    if declaration.hold == "zero_order":
        turn = f / measured.sampling_rate_Hz
        chain *= np.sinc(turn) * np.exp(-1j * np.pi * turn)
    for known in declaration.filters:
        chain *= known.system().response(f)[:, 0, 0]
    return chain


def _trial_delays(measured: FrequencyResponse, declaration: Declaration) -> Array:
    interval_s = 1.0 / measured.sampling_rate_Hz
    longest_s = declaration.longest_delay_s
    longest_s = 4.0 * interval_s if longest_s is None else longest_s
    count = min(round(longest_s / interval_s), 20) + 1
    return np.linspace(0.0, longest_s, count)


def _shape_of_poles(poles_Hz: ComplexArray, structure: Structure) -> Array:
    """Sort poles into the structure: pairs are modes, real ones lags; what is left pairs up."""
    pairs = list(poles_Hz[poles_Hz.imag > 0])
    real = sorted(np.abs(poles_Hz[poles_Hz.imag == 0].real))
    lags = [real.pop(0) for _ in range(min(structure.lags, len(real)))]
    modes = [(abs(p), -p.real / abs(p)) for p in pairs]
    modes += [
        (np.sqrt(a * b), (a + b) / (2 * np.sqrt(a * b)))
        for a, b in zip(real[::2], real[1::2], strict=False)
    ]
    while len(lags) < structure.lags:  # a broad pair stands in for two lags
        frequency_Hz, _ = modes.pop(int(np.argmax([damping for _, damping in modes])))
        lags += [0.7 * frequency_Hz, 1.4 * frequency_Hz][: structure.lags - len(lags)]
    modes = sorted(modes)[: structure.modes]
    frequency_Hz = np.array([f for f, _ in modes])
    damping = np.clip([z for _, z in modes], 1e-4, 10.0)
    return np.asarray(np.log(np.concatenate([frequency_Hz, damping, lags])), dtype=np.float64)


def _record(
    measured: FrequencyResponse, structure: Structure, declaration: Declaration, fit: ModalFit
) -> LinearDynamics:
    n, lags = structure.modes, structure.lags
    order = np.argsort(fit.shape[:n])
    lag_order = np.argsort(fit.shape[2 * n : 2 * n + lags])
    by_shape = np.concatenate([order, n + order, 2 * n + lag_order, [structure.shapes - 1]])
    shape = fit.shape[by_shape]
    by_column = np.moveaxis(fit.gains, 2, 0)
    rate = np.zeros((n, *by_column.shape[1:]))
    first = n
    if structure.rate_gains:
        rate = by_column[n : 2 * n][order] / (2 * np.pi * np.exp(shape[:n]))[:, None, None]
        first = 2 * n
    direct = by_column[-1] if structure.direct else np.zeros(by_column.shape[1:])
    return LinearDynamics(
        inputs=measured.inputs,
        outputs=measured.outputs,
        mode_frequency_Hz=np.exp(shape[:n]),
        mode_damping=np.exp(shape[n : 2 * n]),
        mode_gain_m_per_V=by_column[:n][order],
        mode_rate_gain_m_s_per_V=rate,
        lag_frequency_Hz=np.exp(shape[2 * n : 2 * n + lags]),
        lag_gain_m_per_V=by_column[first : first + lags][lag_order],
        direct_gain_m_per_V=direct,
        delay_s=float(shape[-1]),
        declared=declaration.filters,
        shape_covariance=fit.shape_covariance[np.ix_(by_shape, by_shape)],
        static_gain_std_m_per_V=fit.static_std,
        hold=declaration.hold,
        sampling_rate_Hz=measured.sampling_rate_Hz,
        band_Hz=(float(measured.frequency_Hz[0]), float(measured.frequency_Hz[-1])),
        drive_rms_V=measured.drive_rms_V,
        cost=fit.cost,
        expected_cost=_expected_cost(measured, structure, fit),
    )


def _expected_cost(measured: FrequencyResponse, structure: Structure, fit: ModalFit) -> float:
    """Values less half the real unknowns, times the mean of one over an estimated variance."""
    freedom = measured.variance_freedom
    inflation = freedom / (freedom - 1.0) if freedom > 2.0 else 2.0
    return (fit.values - (structure.shapes + fit.gains.size) / 2) * inflation


def exchange_modes(
    response: ComplexArray,
    weight: Array,
    lines: Lines,
    structure: Structure,
    fit: ModalFit,
    expected_cost: float,
) -> ModalFit:
    """Move modes while that lowers the cost, and return the best fit.

    Vector fitting from noisy data may leave two modes where one is, and none where another is;
    maximum likelihood cannot cross the valley between. The mode whose loss would cost least is
    put at the largest local residual, and everything is fitted again.

    response, weight, lines, structure  as for ``maximise_likelihood``
    expected_cost                       what the cost would be if the model were true
    """
    for _ in range(EXCHANGES if structure.modes > 1 else 0):
        if fit.cost <= GOOD_ENOUGH * expected_cost:
            break
        shape = _exchanged(response, weight, lines, structure, fit)
        try:
            found = maximise_likelihood(response, weight, lines, structure, shape)
        except IdentificationError:
            break  # the new place makes two terms alike; what we have stands
        if found.cost > fit.cost * (1 - WORTH_IT):
            break
        fit = found
    return fit


def _exchanged(
    response: ComplexArray, weight: Array, lines: Lines, structure: Structure, fit: ModalFit
) -> Array:
    columns = basis(lines, structure, fit.shape)
    model = np.einsum("kc,oic->koi", columns, fit.gains)
    left = (np.abs(weight * (response - model)) ** 2).sum(axis=(1, 2))
    width = max(len(left) // LOCAL // 2 * 2 + 1, 3)
    place = int(np.argmax(smoothed(left[:, None], width)[:, 0]))
    least = int(np.argmin(fit.mode_worth))
    shape = np.array(fit.shape)
    shape[least] = np.log(lines.frequency_Hz[place])
    shape[structure.modes + least] = np.log(NEW_DAMPING)
    return shape
