"""Plant families, hysteresis bounds and the default specification of an identified axis.

    y = a (v + delta[v]) with the linear dynamics that fit and diagnosis identified

    a = polarity (M + m) / 2 gain

m and M are the ends of the hysteresis' slope sector. In the inverse form the same a turns the
linearised command v into metres, so that both forms have the same unit of the command.
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
from piezoid.design.plant import Plant, PlantFamily, sampled_plant
from piezoid.design.sensitivity import constant_limit
from piezoid.design.specification import BEYOND, Specification, default_specification
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
from piezoid.numerics.polynomial import decibel
from piezoid.operators.linear import cascade, first_order

FORMS = ("inverse", "affine")
_MIN_REPLICATES = 20
_MAX_POLE = 5.0  # sampling rates, beyond which a pole is instantaneous
# Sampling rates, of the pole that carries an instantaneous response behind a delay.
_FAST_POLE = 1.0
# Among 950 stages of two independent simulators, higher modes added at most 1.95 times the gain at
# rest (1.5 in 99 %), and first modes had a quality factor of 5 to 60. With a limit of 1, two of 32
# loops that damp their first mode oscillated at the second, 3 um rms; without a limit, three of
# twelve were unstable.
_HIGHER_MODE, FIRST_MODE = 2.0, 60.0
_UNDECLARED_Hz = 200.0  # lowest first mode of a stage without data sheet or recorded dynamics
_MAX_INNER_MEMBERS = 7  # of the family, between the ends of a mode's interval


@dataclass(frozen=True, kw_only=True)
class LateralTask:
    """Inputs of the design of one lateral axis.

    families       by form, ``inverse`` and ``affine``
    bounds         of the hysteresis, by form; a form without a bound is missing
    specification  default, which a requested specification overrides
    disturbances   from the recordings
    """

    families: Mapping[str, PlantFamily]
    bounds: Mapping[str, HysteresisBounds]
    specification: Specification
    disturbances: Disturbances


def lateral_task(
    axis: AxisModel, sampling_rate_Hz: float, *, forms: Sequence[str] = FORMS
) -> LateralTask:
    """Return the families, bounds and default specification of one identified axis.

    axis              to which the model class applies
    sampling_rate_Hz  of the controller
    forms             of the families

    Raises ``DesignError`` if the model has no pole that limits the speed of a loop.
    """
    inverse = plant_family(axis, sampling_rate_Hz)
    # The inverse form has a bound only if enough draws of the fit have an inverse.
    affine = affine_bounds_of(axis)
    bounds = {"affine": affine}
    replicates = draw_replicates(axis, np.random.default_rng(0))
    if len(replicates) >= _MIN_REPLICATES:
        bounds["inverse"] = inverse_bounds(
            axis.operator,
            replicates,
            affine.reach_V,
            gain_m_per_V=affine.gain_m_per_V,
            remainder_m=axis.certificate.remainder_m,
            remainder_m_per_V=_steepest_remainder(axis),
        )
    families = {"inverse": inverse, "affine": with_sector(inverse, affine)}
    loop = loop_model(axis, sampling_rate_Hz)
    low_V, high_V = loop.drive_range_V
    specification = default_specification(
        inverse,
        voltage_min_V=max(axis.voltage_V[0], low_V),
        voltage_max_V=min(axis.voltage_V[1], high_V),
        sensor_noise_rms=axis.quality.noise_rms_m,
        disturbance_rms=axis.quality.held_out_rms_m,
        voltage_slew_V_per_s=loop.slew_V_per_s if np.isfinite(loop.slew_V_per_s) else None,
    )
    # Limit the control effort in the frequency range without recordings. Small gain: if |Sup| is
    # below 1 / (peak gain), no mode that adds at most peak times the gain at rest destabilises the
    # loop.
    unseen_modes, nyquist_Hz = unseen(axis), 0.5 * sampling_rate_Hz
    if unseen_modes.from_Hz < nyquist_Hz:
        min_gain = min(abs(member.gain) for member in inverse.members)
        level_dB = -float(decibel(unseen_modes.peak * min_gain))
        limit = constant_limit(BEYOND, "Sup", (unseen_modes.from_Hz, nyquist_Hz), level_dB)
        bandwidth_Hz = min(specification.bandwidth_Hz, unseen_modes.fastest_Hz or np.inf)
        specification = replace(
            specification,
            templates=(*specification.templates, limit),
            bandwidth_Hz=bandwidth_Hz,
            scan_frequency_Hz=min(specification.scan_frequency_Hz, bandwidth_Hz / 10.0),
        )
    return LateralTask(
        families={form: family for form, family in families.items() if form in forms},
        # The error on the rows of the fit alone bounds no other error.
        bounds=bounds if axis.quality.is_tested else {},
        specification=specification,
        disturbances=Disturbances(
            motions=tuple((e.motion_m, e.motion_m_per_s) for e in loop.effects if e.motion_m > 0),
            readings=tuple((e.reading_Hz, e.reading_m) for e in loop.effects if e.reading_m > 0),
        ),
    )


def affine_bounds_of(axis: AxisModel) -> HysteresisBounds:
    """Bound the hysteresis of an identified axis after an affine map."""
    return affine_bounds(
        axis.operator,
        axis.certificate.reach_V,
        remainder_m=axis.certificate.bound_m,
        remainder_m_per_V=_steepest_remainder(axis),
    )


def _steepest_remainder(axis: AxisModel) -> float:
    """Return the largest slope of the displacement that the model class cannot represent."""
    return 0.0 if axis.discrepancy is None else axis.discrepancy.steepest_m_per_V


@dataclass(frozen=True, kw_only=True)
class Unseen:
    """Unmeasured frequency range of the response of an axis, and possible modes in it.

    from_Hz     start of the range: the highest recorded frequency, or the first mode's lowest
                frequency by the data sheet
    peak        largest response of a mode in the range, over the gain at rest
    assumption  about these modes, with its reason, a sentence
    """

    from_Hz: float
    peak: float
    assumption: str

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
            peak=_HIGHER_MODE,
            assumption=f"above {with_unit(from_Hz, 'Hz')}, where recordings no longer show the "
            f"response, no mode adds more than {_HIGHER_MODE:g} times the static gain",
        )
    lowest_Hz, reason = _UNDECLARED_Hz, "no recording shows it and no data sheet was declared"
    if bandwidth is not None and bandwidth.stated_Hz is not None:
        lowest_Hz = bandwidth.stated_Hz / (1.0 + DECLARED_SPREAD)
        stated = with_unit(bandwidth.stated_Hz, "Hz")
        reason = (
            f"the data sheet states {stated}, taken as right to {100 * DECLARED_SPREAD:.0f} %, "
            "and no recording shows it"
        )
    if axis.unfitted_resonance_Hz is not None:
        lowest_Hz = min(lowest_Hz, axis.unfitted_resonance_Hz / (1.0 + DECLARED_SPREAD))
        resonance = with_unit(axis.unfitted_resonance_Hz, "Hz")
        reason = f"recordings show it near {resonance}, not fitted"
    return Unseen(
        from_Hz=lowest_Hz,
        peak=FIRST_MODE,
        assumption=f"the first mode lies above {with_unit(lowest_Hz, 'Hz')}, with at most "
        f"{FIRST_MODE:g} times the static gain, the sharpest of 950 simulated stages: {reason}",
    )


def plant_family(axis: AxisModel, rate_Hz: float) -> PlantFamily:
    """Return the nominal plant of an axis, and the corners of its uncertainty.

    The corners combine both ends of the gain's 95 % interval with the slow and the fast ends of
    all poles, and with the smallest and largest damping of the modes. If the interval of a mode's
    frequency is wider than the mode, members between its ends are added. Creep and a delayed
    irreversible part widen the interval of the gain.

    Raises ``DesignError`` if the model has no pole that limits the speed of a loop.
    """
    nominal = loop_model(axis, rate_Hz)
    if not has_pole(nominal, rate_Hz):
        raise _no_pole(axis, rate_Hz)
    gain = axis.polarity * axis.operator.middle_slope_m_per_V
    # The interval is limited to the slopes of the hysteresis at any state: if the recordings do
    # not determine the end of the loading curve, the interval exceeds these slopes and includes
    # zero. With a delayed irreversible part, a fast loop responds to the reversible slope alone.
    uncertainty = axis.uncertainty  # of the loading curve's end
    half = float(uncertainty.loading_half_m[-1] / abs(uncertainty.loading_m[-1]))
    lowest, greatest = axis.operator.slope_sector_m_per_V
    middle = 0.5 * (lowest + greatest)
    reversible = lowest / middle if nominal.activation[0] > 0.0 else 1.0
    low = max(1.0 - half, lowest / middle) * min(reversible, nominal.quick_gain, 1.0)
    high = min(1.0 + half, greatest / middle) * max(nominal.slow_gain, nominal.quick_gain)
    # label, ``slower`` and ``sharper`` of each corner, and its number of gains
    corners = [("slow", 1.0, 0.0, 2), ("fast", -1.0, 0.0, 2)]
    half_widths = mode_half(axis)
    if half_widths != 0.0:
        corners = [
            (f"{speed}, {sharp}", slower, sharper, 2)
            for speed, slower in (("slow", 1.0), ("fast", -1.0))
            for sharp, sharper in (("sharp", 1.0), ("damped", -1.0))
        ]
        # Adjacent members differ in frequency by at most the width of the mode.
        count = min(int(half_widths), _MAX_INNER_MEMBERS)
        corners += [
            (f"slower by {slower:.2g}, sharp", slower, 1.0, 1)
            for slower in np.linspace(1.0, -1.0, count + 2)[1:-1].tolist()
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
    if stage.D.any():  # a sampled plant responds one sample later
        # Behind a delay the state of an instantaneous pole equals the past command, which is also
        # a state of the delay: the two would not be controllable separately.
        pole = INSTANTANEOUS if loop.delay_s == 0.0 else _FAST_POLE
        stage = cascade(stage, first_order(pole * rate_Hz))
    chain = cascade(stage, loop.sensor)
    return sampled_plant(
        label,
        replace(chain, B=chain.B * gain_m_per_V, delay_s=loop.delay_s),
        rate_Hz,
        output_unit="m",
        position_row=np.concatenate([stage.C[0], np.zeros(len(loop.sensor.A))]),
    )


def has_pole(loop: LoopModel, rate_Hz: float) -> bool:
    """Whether the loop has a pole that is not instantaneous at a sampling rate."""
    poles = np.linalg.eigvals(cascade(loop.front, loop.behind, loop.sensor).A)
    max_pole_Hz = _MAX_POLE * rate_Hz
    return bool((np.abs(poles) < 2.0 * np.pi * max_pole_Hz).any())


def _no_pole(axis: AxisModel, rate_Hz: float) -> DesignError:
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
    rig = axis.rig
    is_declared = (rig.amplifier_bandwidth_Hz, rig.sensor_bandwidth_Hz) != (None, None)
    problem = "no pole is declared, and none was fitted"
    remedy = "Declare bandwidth_Hz of [amplifier] or [sensor] in lab.toml, or add a recording"
    if is_declared:
        problem = "the declared poles are too fast to matter, and no slower one was fitted"
        remedy = "Choose a higher rate, or add a recording"
    return DesignError(
        f"axis {axis.axis} at {rate_Hz:g} Hz: {problem}{note}",
        needed="a pole that limits the speed of the stage: without it any gain would look safe",
        remedy=f"{remedy} that excites the dynamics (a small chirp) and fit again.",
    )


def assumptions_of(axis: AxisModel) -> tuple[str, ...]:
    """Return the assumptions behind the family, as sentences."""
    declared = [axis.rig.amplifier_bandwidth_Hz, axis.rig.sensor_bandwidth_Hz]
    poles = ", ".join(with_unit(pole_Hz, "Hz") for pole_Hz in declared if pole_Hz is not None)
    declared_poles = (f"the declared poles ({poles}) are right to {100 * DECLARED_SPREAD:.0f} %",)
    return (
        *(declared_poles if poles else ()),
        unseen(axis).assumption,
        describe_command_range(*axis.voltage_V),
    )
