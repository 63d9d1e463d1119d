"""The identified plant of one axis between its converters."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.design.plant import Section
from piezoid.identification.extensions.periodic_error import PeriodicError
from piezoid.identification.loop_model import at_corner, loop_model
from piezoid.identification.model import AxisModel, Discrepancy
from piezoid.identification.tunnelling.junction_plant import DriveMode, JunctionPlant
from piezoid.numerics.arrays import Array
from piezoid.operators.linear import ContinuousSystem, cascade, recursive_filter
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.preisach_plays import PreisachPlays

Respond = Callable[[float], float]
Operator = ModifiedPrandtlIshlinskii | PreisachPlays


@dataclass(frozen=True, kw_only=True, eq=False)
class Hysteresis:
    """The identified operator as the response of a lateral axis.

    operator       rising with the drive
    history_V      turning points of the drive before every run; none: the axis is de-poled
    pasts_V        alternatives of that history, for comparison
    polarity       -1 where the displacement falls as the drive rises
    discrepancy    a second hysteresis beside it; None: the operator is all
    low_V, high_V  the drive is clipped to them
    activation_s, activation_m  with which time constant its irreversible part follows, and the lag
                   beyond which it follows faster; 0: at once
    """

    operator: Operator
    polarity: int = 1
    history_V: tuple[float, ...] = ()
    pasts_V: tuple[tuple[float, ...], ...] = ()
    discrepancy: Discrepancy | None = None
    low_V: float = -np.inf
    high_V: float = np.inf
    activation_s: float = 0.0
    activation_m: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Slow motion that the drive does not cause, with its largest range and speed in recordings.

    half_range_m     m, > 0
    fastest_m_per_s  its fastest change; 0: as fast as another axis is driven
    """

    half_range_m: float
    fastest_m_per_s: float


@dataclass(frozen=True, kw_only=True)
class Junction:
    """A tunnelling gap: i = current_A exp(gain (u - rest) - k height).

    current_A          at rest
    gain_nepers_per_V  > 0: positive drive extends the tip
    decay_per_m        k: what a metre of height takes from ln i
    most_A             at which the amplifier in front of the sensor's pole is full; None: never
    """

    current_A: float
    gain_nepers_per_V: float
    decay_per_m: float
    most_A: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class CustomResponse:
    """Any other response, for example a laboratory's truth.

    begin  called before every run with the voltage at which the axis rests; returns what answers
           each drive voltage, one after the other, with a displacement in metres
    """

    begin: Callable[[float], Respond]


Response = Hysteresis | Junction | CustomResponse


@dataclass(frozen=True, kw_only=True, eq=False)
class AxisPlant:
    """One axis from the drive's converter to the measuring one.

        u, held -> delay -> amplifier -> response -> mechanics -> position
        position -> sensor -> + noise -> converter -> measured

    axis              its name
    label             which plant this is: ``identified``, ``draw 3``, ...
    sampling_rate_Hz  of both converters
    rest_voltage_V    where every run begins, settled
    delay_s           converters and computation, >= 0, any fraction of a sample
    amplifier         sections in front of the response; none: as quick as a substep
    drive_modes       behind them, gain 1 at rest
    mechanics, sensor sections behind it
    measured          a system in place of mechanics. Only its shape counts, its gain at rest is
                      the response's; None: as the sections say
    measured_gain     by how much more it moves at rest than the response: what crept
    slew_V_per_s      fastest change of the amplifier's output; None: any
    noise_rms         of one reading, m (junction: A)
    noise_bandwidth_Hz   first-order bandwidth of that noise; None: white
    reading_zero      what nothing is read as: the offset of the sensor
    reading_step      of the measuring converter, 0 rounds nothing
    reading_range     its ends
    motions           further causes of motion
    hums              frequency in Hz and amplitude of lines in the reading
    cyclic            what the sensor says of a position; None: the position
    """

    axis: str
    label: str
    sampling_rate_Hz: float
    response: Response
    rest_voltage_V: float = 0.0
    delay_s: float = 0.0
    amplifier: tuple[Section, ...] = ()
    drive_modes: tuple[ContinuousSystem, ...] = ()
    mechanics: tuple[Section, ...] = ()
    sensor: tuple[Section, ...] = ()
    measured: ContinuousSystem | None = None
    measured_gain: float = 1.0
    slew_V_per_s: float | None = None
    noise_rms: float = 0.0
    noise_bandwidth_Hz: float | None = None
    reading_zero: float = 0.0
    reading_step: float = 0.0
    reading_range: tuple[float, float] = (-np.inf, np.inf)
    motions: tuple[Motion, ...] = ()
    hums: tuple[tuple[float, float], ...] = ()
    cyclic: PeriodicError | None = None

    def __post_init__(self) -> None:
        if not self.sampling_rate_Hz > 0 or not self.delay_s >= 0 or not self.noise_rms >= 0:
            raise ValueError(
                f"axis {self.axis}: rate {self.sampling_rate_Hz} Hz, delay {self.delay_s} s, "
                f"noise {self.noise_rms}; expected > 0, >= 0, >= 0"
            )
        if self.measured is not None and (self.mechanics or self.measured.delay_s):
            raise ValueError(
                f"axis {self.axis}: measured dynamics stand in place of mechanics, and their "
                "delay in delay_s"
            )

    def noise(self, samples: int, rng: np.random.Generator) -> Array:
        """Return the sensor's noise as its converter sees it, (samples,).

            n[k+1] = p n[k] + sqrt(1 - p^2) s e[k],   p = exp(-2 pi f / fs)

        First-order noise sampled exactly: all of its power is there, also what a sensor faster
        than half the sampling rate folds down.
        """
        white = rng.standard_normal(samples)
        time_s = np.arange(samples) / self.sampling_rate_Hz
        hum = np.zeros(samples)
        for frequency_Hz, amplitude in self.hums:
            phase = rng.uniform(0.0, 2.0 * np.pi)
            hum += amplitude * np.sin(2.0 * np.pi * frequency_Hz * time_s + phase)
        if self.noise_bandwidth_Hz is None:
            return np.asarray(self.noise_rms * white + hum)
        pole = float(np.exp(-2.0 * np.pi * self.noise_bandwidth_Hz / self.sampling_rate_Hz))
        kicks = np.sqrt(1.0 - pole**2) * white
        kicks[:1] = white[:1]
        return np.asarray(self.noise_rms * recursive_filter([1.0], [1.0, -pole], kicks) + hum)

    def motion_m(self, samples: int, other_drive: Array) -> Array:
        """Return the motion that the drive does not cause, (samples,).

        other_drive  (samples,)  drive of another axis, -1 to 1; motions without a speed follow it
        """
        time_s = np.arange(samples) / self.sampling_rate_Hz
        moved_m = np.zeros(samples)
        for motion in self.motions:
            far_m = motion.half_range_m
            if motion.fastest_m_per_s > 0.0:  # to and fro, as steep as it may be
                turn = motion.fastest_m_per_s / far_m * time_s
                moved_m += far_m * np.sin(turn)
            else:
                moved_m += far_m * other_drive
        return moved_m


def lateral_plant(model: AxisModel, *, sampling_rate_Hz: float) -> AxisPlant:
    """Return the identified plant of one lateral axis, resting in the middle of its model.

    Everything that fit and diagnosis put into the model: ``loop_model`` says where it acts. What
    stands behind the hysteresis is one system, so that the position is what a sensor without
    noise shows. The noise of the recordings is taken for that of every reading.
    """
    loop = loop_model(model, sampling_rate_Hz)
    front_Hz = _poles_Hz(loop.front)
    low_V, high_V = loop.drive_range_V
    time_s, strain_m = loop.activation
    # Two histories over the full range: one with a last turn a quarter below its upper end, and
    # one that comes to rest straight from there. A controller can infer one extreme from its first
    # reading, and not turns within turns; on a stage that starts from the state of the inverse the
    # error would be too small.
    least_V, most_V = model.voltage_V
    pasts_V = ((most_V, least_V, most_V - 0.25 * (most_V - least_V)), (least_V, most_V))
    readings = [e for e in model.extensions if isinstance(e, PeriodicError)]
    return AxisPlant(
        axis=model.axis,
        label="identified",
        sampling_rate_Hz=sampling_rate_Hz,
        response=Hysteresis(
            operator=model.operator,
            polarity=model.polarity,
            history_V=pasts_V[0],
            pasts_V=pasts_V,
            discrepancy=model.discrepancy,
            low_V=low_V,
            high_V=high_V,
            activation_s=time_s,
            activation_m=strain_m,
        ),
        rest_voltage_V=float(np.clip(model.operator.voltage_offset_V, low_V, high_V)),
        delay_s=loop.delay_s,
        amplifier=tuple(Section(frequency_Hz=f) for f in front_Hz),
        sensor=tuple(Section(frequency_Hz=f) for f in _poles_Hz(loop.sensor)),
        measured=cascade(loop.behind, loop.slow),
        measured_gain=loop.slow_gain * loop.gain,
        slew_V_per_s=loop.slew_V_per_s if np.isfinite(loop.slew_V_per_s) else None,
        noise_rms=model.quality.noise_rms_m,
        noise_bandwidth_Hz=model.rig.sensor_bandwidth_Hz,
        motions=tuple(
            Motion(half_range_m=e.motion_m, fastest_m_per_s=e.motion_m_per_s)
            for e in loop.effects
            if e.motion_m > 0.0
        ),
        hums=tuple((e.reading_Hz, e.reading_m) for e in loop.effects if e.reading_Hz > 0.0),
        cyclic=readings[0] if readings else None,
    )


def junction_axis_plant(
    plant: JunctionPlant,
    *,
    axis: str = "z",
    set_point_A: float,
    decay_per_m: float,
    noise_rms_A: float = 0.0,
    modes: Sequence[DriveMode] = (),
) -> AxisPlant:
    """Return the identified plant of a tunnelling axis, resting at its set point and 0 V.

    modes  of the drive; of several records that show the same one, one
    """
    return AxisPlant(
        axis=axis,
        label="identified",
        sampling_rate_Hz=plant.sampling_rate_Hz,
        response=Junction(
            current_A=set_point_A,
            gain_nepers_per_V=plant.gain_nepers_per_V,
            decay_per_m=decay_per_m,
        ),
        delay_s=plant.delay_s,
        amplifier=(Section(frequency_Hz=plant.amplifier_pole_Hz),),
        drive_modes=tuple(mode.system for mode in modes),
        sensor=(Section(frequency_Hz=plant.sensor_pole_Hz),),
        noise_rms=noise_rms_A,
        noise_bandwidth_Hz=plant.sensor_pole_Hz,
    )


def varied_plant(
    plant: AxisPlant, model: AxisModel, operator: Operator, *, slower: float, sharper: float
) -> AxisPlant:
    """Return a plant with another operator, its poles and modes elsewhere in their intervals.

    slower, sharper  from -1 to 1, as ``at_corner`` takes them
    """
    corner = at_corner(model, slower, sharper)
    varied = lateral_plant(corner, sampling_rate_Hz=plant.sampling_rate_Hz)
    assert isinstance(varied.response, Hysteresis)
    return replace(
        varied,
        response=replace(varied.response, operator=operator),
        reading_step=plant.reading_step,
        reading_range=plant.reading_range,
    )


def with_gain(plant: AxisPlant, factor: float, label: str) -> AxisPlant:
    """Return a plant that moves, or multiplies its current, by a factor more.

    Raises ``TypeError`` for a plugged response: its gain is its own.
    """
    response = plant.response
    if isinstance(response, Junction):
        changed: Response = replace(
            response, gain_nepers_per_V=response.gain_nepers_per_V * factor
        )
    elif isinstance(response, Hysteresis):
        changed = replace(response, operator=response.operator.multiplied(factor))
    else:
        raise TypeError("a plugged response has no gain to change")
    return replace(plant, response=changed, label=label)


def with_histories(plant: AxisPlant) -> tuple[AxisPlant, ...]:
    """Return the plant as each of its possible pasts left it; itself where it has but one."""
    response = plant.response
    if not isinstance(response, Hysteresis) or not response.pasts_V:
        return (plant,)
    return tuple(
        replace(plant, response=replace(response, history_V=past_V)) for past_V in response.pasts_V
    )


def _poles_Hz(declared: ContinuousSystem) -> tuple[float, ...]:
    return tuple(-float(pole) / (2.0 * np.pi) for pole in np.diag(declared.A))
