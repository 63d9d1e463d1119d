"""The identified plant of one axis between its converters."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.identification.extensions.periodic_error import PeriodicError
from piezoid.identification.loop_model import at_corner, loop_model
from piezoid.identification.model import AxisModel, Discrepancy
from piezoid.identification.tunnelling.junction_plant import DriveMode, JunctionPlant
from piezoid.numerics.arrays import Array
from piezoid.operators.linear import ContinuousSystem, cascade, first_order, recursive_filter
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.preisach_plays import PreisachPlays

Respond = Callable[[float], float]
Operator = ModifiedPrandtlIshlinskii | PreisachPlays


@dataclass(frozen=True, kw_only=True, eq=False)
class Hysteresis:
    """The identified operator as the response of a lateral axis.

    operator       rising with the drive
    history_V      turning points of the drive before every run; empty: the axis is de-poled
    histories_V    alternative histories, for comparison
    polarity       -1 if the displacement falls as the drive rises
    discrepancy    a second hysteresis that is added; None: none
    low_V, high_V  range to which the drive is clipped
    activation_s, activation_m  time constant of the irreversible part, and the lag above which it
                   follows faster; 0: without delay
    """

    operator: Operator
    polarity: int = 1
    history_V: tuple[float, ...] = ()
    histories_V: tuple[tuple[float, ...], ...] = ()
    discrepancy: Discrepancy | None = None
    low_V: float = -np.inf
    high_V: float = np.inf
    activation_s: float = 0.0
    activation_m: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Junction:
    """A tunnelling gap: i = current_A exp(gain (u - rest) - k height).

    current_A          at rest
    gain_nepers_per_V  > 0: positive drive extends the tip
    decay_per_m        k: decrease of ln i per metre of height
    saturation_A       of the amplifier in front of the sensor's pole; None: it does not saturate
    """

    current_A: float
    gain_nepers_per_V: float
    decay_per_m: float
    saturation_A: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class CustomResponse:
    """Any other response, for example of a simulated stage.

    begin  called before every run with the voltage at which the axis rests; returns the function
           from each successive drive voltage to a displacement in metres
    """

    begin: Callable[[float], Respond]


Response = Hysteresis | Junction | CustomResponse


@dataclass(frozen=True, kw_only=True, eq=False)
class AxisPlant:
    """One axis from the converter of the drive to the converter of the sensor.

        u, held -> delay -> front -> response -> measured -> position
        position -> sensor -> + noise -> converter -> measured

    axis              name
    label             of the plant: ``identified``, ``draw 3``, ...
    sampling_rate_Hz  of both converters
    rest_voltage_V    at which every run begins, settled
    delay_s           of converters and computation, >= 0, any fraction of a sample
    front             amplifier and modes of the drive in series, gain 1 at rest; empty:
                      instantaneous
    measured          dynamics behind the response; None: instantaneous
    measured_gain     gain at rest to which ``measured`` is normalised: 1 plus the creep
    sensor            systems in series between position and converter, gain 1 at rest
    slew_V_per_s      fastest change of the amplifier's output; None: any
    noise_rms         of one reading, m (junction: A)
    noise_bandwidth_Hz   first-order bandwidth of that noise; None: white
    reading_zero      offset of the sensor
    reading_step      of the sensor's converter; 0: no rounding
    reading_range     of the sensor's converter
    motions           half range in m and fastest change in m/s of each slow motion that the drive
                      does not cause, as in recordings; 0 m/s: as fast as another axis is driven
    hums              frequency in Hz and amplitude of lines in the reading
    cyclic            periodic error of the sensor; None: none
    """

    axis: str
    label: str
    sampling_rate_Hz: float
    response: Response
    rest_voltage_V: float = 0.0
    delay_s: float = 0.0
    front: tuple[ContinuousSystem, ...] = ()
    measured: ContinuousSystem | None = None
    measured_gain: float = 1.0
    sensor: tuple[ContinuousSystem, ...] = ()
    slew_V_per_s: float | None = None
    noise_rms: float = 0.0
    noise_bandwidth_Hz: float | None = None
    reading_zero: float = 0.0
    reading_step: float = 0.0
    reading_range: tuple[float, float] = (-np.inf, np.inf)
    motions: tuple[tuple[float, float], ...] = ()
    hums: tuple[tuple[float, float], ...] = ()
    cyclic: PeriodicError | None = None

    def __post_init__(self) -> None:
        if not self.sampling_rate_Hz > 0 or not self.delay_s >= 0 or not self.noise_rms >= 0:
            raise ValueError(
                f"axis {self.axis}: rate {self.sampling_rate_Hz} Hz, delay {self.delay_s} s, "
                f"noise {self.noise_rms}; expected > 0, >= 0, >= 0"
            )
        if self.measured is not None and self.measured.delay_s:
            raise ValueError(f"axis {self.axis}: delay_s includes the delay of ``measured``")

    def noise(self, samples: int, rng: np.random.Generator) -> Array:
        """Return the sensor's noise and hum at the input of its converter, (samples,).

            n[k+1] = p n[k] + sqrt(1 - p^2) s e[k],   p = exp(-2 pi f / fs)

        This is first-order noise sampled exactly: it has its whole power, with the aliases of
        frequencies above half the sampling rate.
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
        innovation = np.sqrt(1.0 - pole**2) * white
        innovation[:1] = white[:1]
        coloured = recursive_filter([1.0], [1.0, -pole], innovation)
        return np.asarray(self.noise_rms * coloured + hum)

    def motion_m(self, samples: int, other_drive: Array) -> Array:
        """Return the motion that the drive does not cause, (samples,).

        A motion with a speed is a sine of its largest range and speed.

        other_drive  (samples,)  drive of another axis, -1 to 1, which motions without a speed
                     follow
        """
        time_s = np.arange(samples) / self.sampling_rate_Hz
        motion_m = np.zeros(samples)
        for half_range_m, fastest_m_per_s in self.motions:
            if fastest_m_per_s > 0.0:
                motion_m += half_range_m * np.sin(fastest_m_per_s / half_range_m * time_s)
            else:
                motion_m += half_range_m * other_drive
        return motion_m


def lateral_plant(model: AxisModel, *, sampling_rate_Hz: float) -> AxisPlant:
    """Return the identified plant of one lateral axis, at rest in the middle of its model.

    The plant has all effects of the model at the points that ``loop_model`` defines. All dynamics
    behind the hysteresis are one system, so that the position is the reading of a sensor without
    noise. Every reading has the noise of the recordings.
    """
    loop = loop_model(model, sampling_rate_Hz)
    front, sensor = (
        tuple(first_order(-float(pole) / (2.0 * np.pi)) for pole in np.diag(lags.A))
        for lags in (loop.front, loop.sensor)
    )
    low_V, high_V = loop.drive_range_V
    time_s, strain_m = loop.activation
    # Two histories over the full range: one with a last turning point a quarter below its upper
    # end, and one that comes to rest directly from that end. A controller can infer one extreme
    # from its first reading, but not nested turning points. On a stage that starts from the state
    # of the inverse the error would be too small.
    start_V, end_V = model.voltage_V
    histories_V = ((end_V, start_V, end_V - 0.25 * (end_V - start_V)), (start_V, end_V))
    periodic_errors = [e for e in model.extensions if isinstance(e, PeriodicError)]
    return AxisPlant(
        axis=model.axis,
        label="identified",
        sampling_rate_Hz=sampling_rate_Hz,
        response=Hysteresis(
            operator=model.operator,
            polarity=model.polarity,
            history_V=histories_V[0],
            histories_V=histories_V,
            discrepancy=model.discrepancy,
            low_V=low_V,
            high_V=high_V,
            activation_s=time_s,
            activation_m=strain_m,
        ),
        rest_voltage_V=float(np.clip(model.operator.voltage_offset_V, low_V, high_V)),
        delay_s=loop.delay_s,
        front=front,
        sensor=sensor,
        measured=cascade(loop.behind, loop.slow),
        measured_gain=loop.slow_gain * loop.gain,
        slew_V_per_s=loop.slew_V_per_s if np.isfinite(loop.slew_V_per_s) else None,
        noise_rms=model.quality.noise_rms_m,
        noise_bandwidth_Hz=model.rig.sensor_bandwidth_Hz,
        motions=tuple((e.motion_m, e.motion_m_per_s) for e in loop.effects if e.motion_m > 0.0),
        hums=tuple((e.reading_Hz, e.reading_m) for e in loop.effects if e.reading_Hz > 0.0),
        cyclic=periodic_errors[0] if periodic_errors else None,
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
    """Return the identified plant of a tunnelling axis, at rest at its set point and 0 V.

    modes  of the drive, each once
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
        front=(first_order(plant.amplifier_pole_Hz), *(mode.system for mode in modes)),
        sensor=(first_order(plant.sensor_pole_Hz),),
        noise_rms=noise_rms_A,
        noise_bandwidth_Hz=plant.sensor_pole_Hz,
    )


def varied_plant(
    plant: AxisPlant, model: AxisModel, operator: Operator, *, slower: float, sharper: float
) -> AxisPlant:
    """Return a plant with another operator, and with poles and modes moved in their intervals.

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
    """Return a plant with the gain of its junction or hysteresis multiplied by a factor."""
    response = plant.response
    if isinstance(response, Junction):
        changed: Response = replace(
            response, gain_nepers_per_V=response.gain_nepers_per_V * factor
        )
    else:
        assert isinstance(response, Hysteresis)
        changed = replace(response, operator=response.operator.multiplied(factor))
    return replace(plant, response=changed, label=label)
