"""From an identified axis to what its design starts from: plant families, bounds, a default.

    y = a (v + delta[v]) behind the declared poles and what was identified

    a = polarity (M + m) / 2

m and M are the ends of the hysteresis' slope sector. In the inverse form the same a turns the
linearised command v into metres, so that both forms speak of the same volt.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.design.chain import Chain, Section, family_from_chains
from piezoid.design.dynamics_chain import MeasuredChain, measured_chain
from piezoid.design.hysteresis_bounds import HysteresisBounds, affine_bounds, inverse_bounds
from piezoid.design.lateral import with_sector
from piezoid.design.plant import PlantFamily
from piezoid.design.replicates import draw_replicates
from piezoid.design.specification import Specification, default_specification
from piezoid.errors import DesignError
from piezoid.identification.model import AxisModel

FORMS = ("inverse", "affine")
NORMAL_95 = 1.959963984540054
DECLARED_SPREAD = 0.1  # a data sheet's bandwidth is a round number for a typical specimen
FEWEST_REPLICATES = 20
_LEAST_SHARE = 0.1  # of a lag whose interval reaches zero: a pole needs some time constant
_SLOWER_THAN_RATE = 5.0  # a pole beyond so many sampling rates is instantaneous


@dataclass(frozen=True, kw_only=True)
class LateralTask:
    """What the design of one lateral axis is given.

    families       by form, ``inverse`` and ``affine``
    bounds         of the hysteresis, by form; none where a bound is not known
    specification  default, to be overruled by what is asked
    """

    families: Mapping[str, PlantFamily]
    bounds: Mapping[str, HysteresisBounds]
    specification: Specification


def lateral_task(
    axis: AxisModel, sampling_rate_Hz: float, *, forms: Sequence[str] = FORMS, seed: int = 0
) -> LateralTask:
    """Return the families, bounds and default specification of one identified axis.

    axis              whose model class applies
    sampling_rate_Hz  of the controller
    forms             wanted
    seed              of the replicates drawn from the fit's covariance

    The family holds, besides the nominal plant, its four corners: the ends of the gain's 95 %
    interval with everything slow and everything fast, declared poles and what was identified.

    Raises ``DesignError`` where nothing is known that would limit the speed of a loop.
    """
    nominal = _nominal(axis, sampling_rate_Hz)
    inverse = family_from_chains(nominal.chain, _corners(nominal, axis))
    bounds = _bounds(axis, seed)
    families = {"inverse": inverse, "affine": with_sector(inverse, bounds["affine"])}
    return LateralTask(
        families={form: family for form, family in families.items() if form in forms},
        bounds=bounds,
        specification=default_specification(
            inverse.nominal,
            voltage_min_V=axis.voltage_V[0],
            voltage_max_V=axis.voltage_V[1],
            sensor_noise_rms=axis.quality.noise_rms_m,
            disturbance_rms=axis.quality.held_out_rms_m,
        ),
    )


def _nominal(axis: AxisModel, sampling_rate_Hz: float) -> MeasuredChain:
    """The chain of declared poles with the axis' dynamics, or else with its lag."""
    declared_Hz = [axis.rig.amplifier_bandwidth_Hz, axis.rig.sensor_bandwidth_Hz]
    least, greatest = axis.hysteresis.slope_sector_m_per_V
    declared = Chain(
        label="nominal",
        sampling_rate_Hz=sampling_rate_Hz,
        gain=axis.polarity * 0.5 * (least + greatest),
        output_unit="m",
        sections=tuple(Section(frequency_Hz=f) for f in declared_Hz if f is not None),
    )
    if axis.dynamics is None:
        found = MeasuredChain(chain=_with_lag(declared, axis), mode_half=0.0, gain_ratio=1.0)
    else:
        found = measured_chain(declared, axis.dynamics)
    slow_Hz = _SLOWER_THAN_RATE * sampling_rate_Hz
    if not any(section.frequency_Hz < slow_Hz for section in found.chain.sections):
        raise DesignError(
            f"axis {axis.axis}: no pole is declared and none was found, slow enough to matter at "
            f"{sampling_rate_Hz:g} Hz",
            needed="what limits the speed of the stage: without it any gain would look safe",
            remedy="Declare bandwidth_Hz of [amplifier] and [sensor] in lab.toml, or add a "
            "recording that excites the dynamics, and fit again.",
        )
    return found


def _with_lag(chain: Chain, axis: AxisModel) -> Chain:
    if axis.lag.kind == "first_order" and axis.lag.time_s > 0.0:
        pole = Section(frequency_Hz=1.0 / (2.0 * np.pi * axis.lag.time_s))
        return replace(chain, sections=(*chain.sections, pole))
    return replace(chain, delay_s=axis.lag.time_s if axis.lag.kind == "delay" else 0.0)


def _corners(nominal: MeasuredChain, axis: AxisModel) -> list[Chain]:
    """Every combination of low and high gain with slow and fast dynamics."""
    gain = max(relative_gain_half(axis), abs(nominal.gain_ratio - 1.0))
    return [
        replace(
            _slowed(nominal, axis, slower),
            label=f"{way} gain, {speed}",
            gain=nominal.chain.gain * (1.0 + sign * gain),
        )
        for way, sign in (("low", -1.0), ("high", 1.0))
        for speed, slower in (("slow", 1.0), ("fast", -1.0))
    ]


def _slowed(nominal: MeasuredChain, axis: AxisModel, slower: float) -> Chain:
    """The chain at the slow end (+1) or the fast end (-1) of what is known of it.

    A lag that was fitted moves to the end of its interval. One that was not still has an interval:
    its upper end becomes delay. The delay left by dynamics is taken to be as sure as a declared
    pole.
    """
    chain = nominal.chain
    lag_s = slower * lag_half_s(axis)
    is_lag = axis.dynamics is None and axis.lag.kind == "first_order"
    sections = []
    for section in chain.sections:
        time_s = 1.0 / (2.0 * np.pi * section.frequency_Hz)
        moved_s = time_s * (1.0 + slower * DECLARED_SPREAD)
        if section.damping is not None:
            moved_s = time_s * (1.0 + slower * nominal.mode_half)
        elif is_lag and np.isclose(time_s, axis.lag.time_s, rtol=1e-9):
            moved_s = time_s + lag_s
        moved_Hz = 1.0 / (2.0 * np.pi * max(moved_s, _LEAST_SHARE * time_s))
        sections.append(replace(section, frequency_Hz=float(moved_Hz)))
    delay_s = chain.delay_s + (0.0 if is_lag else lag_s)
    if axis.dynamics is not None:
        delay_s = chain.delay_s * (1.0 + slower * DECLARED_SPREAD)
    return replace(chain, sections=tuple(sections), delay_s=max(delay_s, 0.0))


def relative_gain_half(axis: AxisModel) -> float:
    """Return half the 95 % interval of the loading curve's end, relative to it."""
    found = axis.uncertainty
    return float(found.loading_half_m[-1] / abs(found.loading_m[-1]))


def lag_half_s(axis: AxisModel) -> float:
    """Return half the 95 % interval of the lag."""
    place = axis.uncertainty.names.index("lag_s")
    return float(NORMAL_95 * np.sqrt(axis.uncertainty.covariance[place, place]))


def _bounds(axis: AxisModel, seed: int) -> dict[str, HysteresisBounds]:
    """Bound both forms, the inverse one where enough draws of the fit have an inverse."""
    reach_V = axis.certificate.reach_V
    affine = affine_bounds(axis.hysteresis, reach_V, remainder_m=axis.certificate.bound_m)
    drawn = draw_replicates(axis, np.random.default_rng(seed))
    bounds = {"affine": affine}
    if len(drawn) >= FEWEST_REPLICATES:
        bounds["inverse"] = inverse_bounds(
            axis.hysteresis,
            drawn,
            reach_V,
            gain_m_per_V=affine.gain_m_per_V,
            remainder_m=axis.certificate.remainder_m,
        )
    return bounds


def assumptions_of(axis: AxisModel) -> tuple[str, ...]:
    """Return what the family takes for granted, beside what the recordings showed."""
    declared = [axis.rig.amplifier_bandwidth_Hz, axis.rig.sensor_bandwidth_Hz]
    poles = ", ".join(f"{pole_Hz:g} Hz" for pole_Hz in declared if pole_Hz is not None)
    known = (f"the declared poles ({poles}) are right to {100 * DECLARED_SPREAD:.0f} %",)
    return (
        *(known if poles else ()),
        "the stage has no mode within the band of the loop that the model does not know",
        f"the drive stays within {axis.voltage_V[0]:.4g} to {axis.voltage_V[1]:.4g} V, as in the "
        "recordings",
    )
