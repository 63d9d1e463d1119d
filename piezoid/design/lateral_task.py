"""Plant families, hysteresis bounds and the default specification of an identified axis.

    y = a (v + delta[v]) behind everything linear that fit and diagnosis found

    a = polarity (M + m) / 2 gain now

m and M are the ends of the hysteresis' slope sector. In the inverse form the same a turns the
linearised command v into metres, so that both forms speak of the same volt.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.design.certificate import Disturbances
from piezoid.design.hysteresis_bounds import (
    HysteresisBounds,
    affine_bounds,
    describe_command_range,
    draw_replicates,
    inverse_bounds,
)
from piezoid.design.lateral import with_sector
from piezoid.design.plant import Plant, PlantFamily
from piezoid.design.specification import Specification, default_specification
from piezoid.design.templates import Template
from piezoid.errors import DesignError
from piezoid.formatting import with_unit
from piezoid.identification.extensions.linear_mode import LinearMode
from piezoid.identification.loop_model import (
    DECLARED_SPREAD,
    INSTANTANEOUS,
    LoopModel,
    at_corner,
    loop_model,
    mode_half,
)
from piezoid.identification.model import AxisModel
from piezoid.numerics.frequency import decibel
from piezoid.numerics.zero_order_hold import fraction, sample
from piezoid.operators.linear import cascade, first_order

FORMS = ("inverse", "affine")
FEWEST_REPLICATES = 20
_SLOWER_THAN_RATE = 5.0  # a pole beyond so many sampling rates is instantaneous
# Among 950 stages of two strangers further modes added at most 1.95 times the gain at rest (1.5 in
# 99 %), and first modes had a quality of 5 to 60. With a limit of 1, two loops of 32 that damp
# their first mode swung at the second one, 3 um rms; without any, three of twelve were unstable.
FURTHER_MODE, FIRST_MODE = 2.0, 60.0
UNTOLD_Hz = 200.0
BEYOND = "control effort beyond what is known"  # name of the limit that guards against it
_MOST_BETWEEN = 7  # members between the ends of a mode's interval


@dataclass(frozen=True, kw_only=True)
class LateralTask:
    """Inputs of the design of one lateral axis.

    families       by form, ``inverse`` and ``affine``
    bounds         of the hysteresis, by form; none where a bound is not known
    specification  default, to be overruled by what is asked
    disturbances   what recordings showed beside drive and noise
    """

    families: Mapping[str, PlantFamily]
    bounds: Mapping[str, HysteresisBounds]
    specification: Specification
    disturbances: Disturbances


def lateral_task(
    axis: AxisModel, sampling_rate_Hz: float, *, forms: Sequence[str] = FORMS
) -> LateralTask:
    """Return the families, bounds and default specification of one identified axis.

    axis              whose model class applies
    sampling_rate_Hz  of the controller
    forms             wanted

    Raises ``DesignError`` where nothing is known that would limit the speed of a loop.
    """
    inverse = plant_family(axis, sampling_rate_Hz)
    bounds = _bounds(axis)
    families = {"inverse": inverse, "affine": with_sector(inverse, bounds["affine"])}
    loop = loop_model(axis, sampling_rate_Hz)
    low_V, high_V = loop.drive_range_V
    return LateralTask(
        families={form: family for form, family in families.items() if form in forms},
        # An error that was seen on nothing but the fit's own rows bounds no other.
        bounds=bounds if axis.quality.is_tested else {},
        specification=_careful(
            axis,
            inverse,
            default_specification(
                inverse,
                voltage_min_V=max(axis.voltage_V[0], low_V),
                voltage_max_V=min(axis.voltage_V[1], high_V),
                sensor_noise_rms=axis.quality.noise_rms_m,
                disturbance_rms=axis.quality.held_out_rms_m,
                voltage_slew_V_per_s=loop.slew_V_per_s if np.isfinite(loop.slew_V_per_s) else None,
            ),
        ),
        disturbances=Disturbances(
            motions=tuple((e.motion_m, e.motion_m_per_s) for e in loop.effects if e.motion_m > 0),
            readings=tuple((e.reading_Hz, e.reading_m) for e in loop.effects if e.reading_m > 0),
        ),
    )


_QUICK = 1.0  # sampling rates, of the pole that carries what answers at once behind a delay


@dataclass(frozen=True, kw_only=True)
class Unseen:
    """Unmeasured frequency range of the response of an axis, and possible modes in it.

    from_Hz  recordings show the response up to here, or a data sheet says that no mode is below
    peak     largest response of a mode from there on, over the gain at rest
    known    how that is known, a whole sentence
    """

    from_Hz: float
    peak: float
    known: str

    @property
    def fastest_Hz(self) -> float | None:
        """Fastest loop tried by default: an integrator's effort falls by 20 dB a decade."""
        return self.from_Hz / self.peak if self.peak > 1.0 else None


def unseen(axis: AxisModel) -> Unseen:
    """Return the frequency above which a mode of the axis would not have been detected."""
    modes_Hz = [e.frequency_Hz for e in axis.extensions if isinstance(e, LinearMode)]
    bandwidth = axis.bandwidth
    if axis.dynamics is not None or modes_Hz:
        seen_Hz = 0.0 if bandwidth is None else bandwidth.highest_Hz
        if axis.dynamics is not None:
            seen_Hz = axis.dynamics.band_Hz[1]
        from_Hz = max(seen_Hz, *modes_Hz) if modes_Hz else seen_Hz
        return Unseen(
            from_Hz=from_Hz,
            peak=FURTHER_MODE,
            known=f"above {with_unit(from_Hz, 'Hz')}, where recordings no longer show the "
            f"response, no mode adds more to it than {FURTHER_MODE:g} times the gain at rest",
        )
    lowest_Hz, reason = UNTOLD_Hz, "no recording shows it and no data sheet was declared"
    if bandwidth is not None and bandwidth.stated_Hz is not None:
        lowest_Hz = bandwidth.stated_Hz / (1.0 + DECLARED_SPREAD)
        stated = with_unit(bandwidth.stated_Hz, "Hz")
        reason = f"the data sheet states {stated}, and no recording shows it"
    if axis.unfitted_resonance_Hz is not None:
        lowest_Hz = min(lowest_Hz, axis.unfitted_resonance_Hz / (1.0 + DECLARED_SPREAD))
        resonance = with_unit(axis.unfitted_resonance_Hz, "Hz")
        reason = f"recordings show it near {resonance}, not fitted"
    return Unseen(
        from_Hz=lowest_Hz,
        peak=FIRST_MODE,
        known=f"the first mode lies above {with_unit(lowest_Hz, 'Hz')}, with at most "
        f"{FIRST_MODE:g} times the gain at rest: {reason}",
    )


def _careful(axis: AxisModel, family: PlantFamily, default: Specification) -> Specification:
    """Return the default with a limit of the control effort beyond what is known.

    Small gain: where |Sup| stays below 1 / (peak gain), a mode that adds at most so many times
    the gain at rest destabilises nothing.
    """
    beyond, nyquist_Hz = unseen(axis), 0.5 * family.nominal.sampling_rate_Hz
    if not beyond.from_Hz < nyquist_Hz:
        return default
    least_gain = min(abs(member.gain) for member in family.members)
    level_dB = -float(decibel(beyond.peak * least_gain))
    limit = Template(
        name=BEYOND,
        function="Sup",
        frequency_Hz=np.array([beyond.from_Hz, nyquist_Hz]),
        upper_dB=np.array([level_dB, level_dB]),
    )
    bandwidth_Hz = min(default.bandwidth_Hz, beyond.fastest_Hz or np.inf)
    return replace(
        default,
        templates=(*default.templates, limit),
        bandwidth_Hz=bandwidth_Hz,
        scan_frequency_Hz=min(default.scan_frequency_Hz, bandwidth_Hz / 10.0),
    )


def plant_family(axis: AxisModel, rate_Hz: float) -> PlantFamily:
    """Return the nominal plant of an axis and its uncertainty.

    Besides the nominal plant its corners: both ends of the gain's interval, with everything slow
    and everything fast, with modes at their least and at their most damping; where the interval
    of a mode's frequency is wider than the mode, members between its ends as well. What creeps
    over seconds, and what is irreversible and late, widens the interval of the gain.

    Raises ``DesignError`` where nothing is known that would limit the speed of a loop.
    """
    nominal = loop_model(axis, rate_Hz)
    _refuse_without_poles(axis, nominal, rate_Hz)
    gain = axis.polarity * 0.5 * sum(axis.operator.slope_sector_m_per_V)
    low, high = _gain_interval(axis, nominal)
    # label, lateness and sharpness of corners, and how many ends of the gain they have
    corners = [("slow", 1.0, 0.0, 2), ("fast", -1.0, 0.0, 2)]
    wide = mode_half(axis)
    if wide != 0.0:
        corners = [
            (f"{speed}, {sharp}", slower, sharper, 2)
            for speed, slower in (("slow", 1.0), ("fast", -1.0))
            for sharp, sharper in (("sharp", 1.0), ("damped", -1.0))
        ]
        between = min(
            int(wide), _MOST_BETWEEN
        )  # neighbours no farther apart than the mode is wide
        corners += [
            (f"slower by {slower:.2g}, sharp", slower, 1.0, 1)
            for slower in np.linspace(1.0, -1.0, between + 2)[1:-1].tolist()
        ]
    members = [_plant("nominal", nominal, gain * nominal.gain, rate_Hz)]
    for label, slower, sharper, n_gains in corners:
        corner = loop_model(at_corner(axis, slower, sharper), rate_Hz)
        for end, factor in (("low", low), ("high", high))[-n_gains:]:
            gain_m_per_V = gain * corner.gain * factor
            members.append(_plant(f"{end} gain, {label}", corner, gain_m_per_V, rate_Hz))
    return PlantFamily(members=tuple(members))


def _plant(label: str, loop: LoopModel, gain_m_per_V: float, rate_Hz: float) -> Plant:
    """Sample the fast dynamics of an axis behind the hold of its converter."""
    stage = cascade(loop.front, loop.behind)
    if stage.D.any():  # a sampled plant answers a sample late
        # Behind a delay the state of an instantaneous pole is the past command once more, which a
        # delay keeps already: neither could be moved without the other.
        quick = INSTANTANEOUS if loop.delay_s == 0.0 else _QUICK
        stage = cascade(stage, first_order(quick * rate_Hz))
    chain = cascade(stage, loop.sensor)
    system = sample(chain.A, chain.B[:, 0] * gain_m_per_V, chain.C[0], 1.0 / rate_Hz, loop.delay_s)
    numerator, denominator = fraction(system)
    position_row = np.concatenate([stage.C[0], np.zeros(len(loop.sensor.A))])
    position, _ = fraction(replace(system, C=position_row))
    return Plant(
        label=label,
        sampling_rate_Hz=rate_Hz,
        output_unit="m",
        state_matrix=system.A,
        input_taps=system.taps,
        output_vector=system.C,
        B=numerator,
        A=denominator,
        B_position=position,
    )


def has_pole(loop: LoopModel, rate_Hz: float) -> bool:
    """Tell whether a known pole matters at a sampling rate."""
    poles = np.linalg.eigvals(cascade(loop.front, loop.behind, loop.sensor).A)
    slow_Hz = _SLOWER_THAN_RATE * rate_Hz
    return bool((np.abs(poles) < 2.0 * np.pi * slow_Hz).any())


def _refuse_without_poles(axis: AxisModel, loop: LoopModel, rate_Hz: float) -> None:
    if has_pole(loop, rate_Hz):
        return
    stated_Hz = None if axis.bandwidth is None else axis.bandwidth.stated_Hz
    note = ""
    if axis.unfitted_resonance_Hz is not None:
        resonance = with_unit(axis.unfitted_resonance_Hz, "Hz")
        note = f"; the resonance near {resonance} could not be fitted"
    elif stated_Hz is not None:
        note = (
            f"; bandwidth_Hz = {stated_Hz:g} of [actuator] does not suffice, because "
            "it may be a pole or a resonance"
        )
    raise DesignError(
        f"axis {axis.axis}: no pole is declared and none could be fitted that is slow enough to "
        f"matter at {rate_Hz:g} Hz{note}",
        needed="what limits the speed of the stage: without it any gain would look safe",
        remedy="Declare bandwidth_Hz of [amplifier] or [sensor] in lab.toml, or add a recording "
        "that excites the dynamics (a small chirp at the controller's rate), and fit again.",
    )


def _gain_interval(axis: AxisModel, loop: LoopModel) -> tuple[float, float]:
    """Return the ends of the gain relative to the nominal one.

    Its 95 % interval, within the slopes that the hysteresis has at any state: where the end of its
    loading curve is not told by the recordings, the interval is wider than these and reaches
    beyond zero. Creep adds to it, and where the irreversible part is late, a quick loop feels the
    reversible slope alone.
    """
    half = relative_gain_half(axis)
    lowest, greatest = axis.operator.slope_sector_m_per_V
    middle = 0.5 * (lowest + greatest)
    reversible = lowest / middle if loop.activation[0] > 0.0 else 1.0
    low = max(1.0 - half, lowest / middle) * min(reversible, loop.quick_gain, 1.0)
    return low, min(1.0 + half, greatest / middle) * max(loop.slow_gain, loop.quick_gain)


def relative_gain_half(axis: AxisModel) -> float:
    """Return half the 95 % interval of the loading curve's end, relative to it."""
    uncertainty = axis.uncertainty
    return float(uncertainty.loading_half_m[-1] / abs(uncertainty.loading_m[-1]))


def _bounds(axis: AxisModel) -> dict[str, HysteresisBounds]:
    """Bound both forms, the inverse one where enough draws of the fit have an inverse."""
    reach_V = axis.certificate.reach_V
    second = axis.discrepancy
    steepest_m_per_V = 0.0 if second is None else second.steepest_m_per_V
    affine = affine_bounds(
        axis.operator,
        reach_V,
        remainder_m=axis.certificate.bound_m,
        remainder_m_per_V=steepest_m_per_V,
    )
    replicates = draw_replicates(axis, np.random.default_rng(0))
    bounds = {"affine": affine}
    if len(replicates) >= FEWEST_REPLICATES:
        bounds["inverse"] = inverse_bounds(
            axis.operator,
            replicates,
            reach_V,
            gain_m_per_V=affine.gain_m_per_V,
            remainder_m=axis.certificate.remainder_m,
            remainder_m_per_V=steepest_m_per_V,
        )
    return bounds


def assumptions_of(axis: AxisModel) -> tuple[str, ...]:
    """Return the assumptions on which the family rests, as sentences."""
    declared = [axis.rig.amplifier_bandwidth_Hz, axis.rig.sensor_bandwidth_Hz]
    poles = ", ".join(with_unit(pole_Hz, "Hz") for pole_Hz in declared if pole_Hz is not None)
    declared_poles = (f"the declared poles ({poles}) are right to {100 * DECLARED_SPREAD:.0f} %",)
    return (
        *(declared_poles if poles else ()),
        unseen(axis).known,
        describe_command_range(*axis.voltage_V),
    )
