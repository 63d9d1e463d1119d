"""What is controlled, between the converters: one axis as it was identified."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from piezoid.design.chain import Section
from piezoid.identification.model import AxisModel
from piezoid.identification.tunnelling.junction_plant import JunctionPlant
from piezoid.numerics.arrays import Array
from piezoid.operators.linear import ContinuousSystem
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.recursive_filter import recursive_filter

Respond = Callable[[float], float]


@dataclass(frozen=True, kw_only=True, eq=False)
class Hysteresis:
    """The identified operator as the response of a lateral axis, de-poled before every run.

    operator  rising with the drive
    polarity  -1 where the displacement falls as the drive rises
    """

    operator: ModifiedPrandtlIshlinskii
    polarity: int = 1


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
class Plugged:
    """Any other response, for example a laboratory's truth.

    begin  called before every run with the voltage at which the axis rests; returns what answers
           each drive voltage, one after the other, with a displacement in metres
    """

    begin: Callable[[float], Respond]


Response = Hysteresis | Junction | Plugged


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
    mechanics, sensor sections behind it
    measured          identified from drive to reading, in place of mechanics and sensor: position
                      is then what a sensor without noise shows. Only its shape counts, its gain
                      at rest is the response's; None: as the sections say
    measured_gain     by how much more it moves at rest than the response: what crept
    slew_V_per_s      fastest change of the amplifier's output; None: any
    noise_rms         of one reading, m (junction: A)
    noise_bandwidth_Hz   first-order bandwidth of that noise; None: white
    reading_zero      what nothing is read as: the offset of the sensor
    reading_step      of the measuring converter, 0 rounds nothing
    reading_range     its ends
    """

    axis: str
    label: str
    sampling_rate_Hz: float
    response: Response
    rest_voltage_V: float = 0.0
    delay_s: float = 0.0
    amplifier: tuple[Section, ...] = ()
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

    def __post_init__(self) -> None:
        if not self.sampling_rate_Hz > 0 or not self.delay_s >= 0 or not self.noise_rms >= 0:
            raise ValueError(
                f"axis {self.axis}: rate {self.sampling_rate_Hz} Hz, delay {self.delay_s} s, "
                f"noise {self.noise_rms}; expected > 0, >= 0, >= 0"
            )
        if self.measured is not None and (self.mechanics or self.sensor or self.measured.delay_s):
            raise ValueError(
                f"axis {self.axis}: measured dynamics stand in place of sections, and their delay "
                "in delay_s"
            )

    def noise(self, samples: int, rng: np.random.Generator) -> Array:
        """Return the sensor's noise as its converter sees it, (samples,).

            n[k+1] = p n[k] + sqrt(1 - p^2) s e[k],   p = exp(-2 pi f / fs)

        First-order noise sampled exactly: all of its power is there, also what a sensor faster
        than half the sampling rate folds down.
        """
        white = rng.standard_normal(samples)
        if self.noise_bandwidth_Hz is None:
            return np.asarray(self.noise_rms * white)
        pole = float(np.exp(-2.0 * np.pi * self.noise_bandwidth_Hz / self.sampling_rate_Hz))
        kicks = np.sqrt(1.0 - pole**2) * white
        kicks[:1] = white[:1]
        return np.asarray(self.noise_rms * recursive_filter([1.0], [1.0, -pole], kicks))


def lateral_plant(
    model: AxisModel, *, sampling_rate_Hz: float, mechanics: tuple[Section, ...] = ()
) -> AxisPlant:
    """Return the identified plant of one lateral axis, resting in the middle of its model.

    mechanics  sections known from elsewhere, where the model has no dynamics of its own

    Dynamics that a recording excited stand behind the hysteresis as they were identified; where
    there are none, the declared poles and the fitted lag, a delay or a section. The noise of the
    recordings is taken for that of every reading.
    """
    plant = _with_declared_poles(model, sampling_rate_Hz, mechanics)
    if model.dynamics is None:
        return plant
    known = model.dynamics.path(model.axis, model.axis).realised()
    return replace(
        plant,
        amplifier=(),
        mechanics=(),
        sensor=(),
        delay_s=known.delay_s,
        measured=replace(known, delay_s=0.0),
    )


def _with_declared_poles(
    model: AxisModel, sampling_rate_Hz: float, mechanics: tuple[Section, ...]
) -> AxisPlant:
    lag = model.lag
    own = (_of_time(lag.time_s),) if lag.kind == "first_order" and lag.time_s > 0 else ()
    sensor_Hz = model.rig.sensor_bandwidth_Hz
    amplifier_Hz = model.rig.amplifier_bandwidth_Hz
    return AxisPlant(
        axis=model.axis,
        label="identified",
        sampling_rate_Hz=sampling_rate_Hz,
        response=Hysteresis(operator=model.hysteresis, polarity=model.polarity),
        rest_voltage_V=model.hysteresis.voltage_offset_V,
        delay_s=lag.time_s if lag.kind == "delay" else 0.0,
        amplifier=() if amplifier_Hz is None else (Section(frequency_Hz=amplifier_Hz),),
        mechanics=(*mechanics, *own),
        sensor=() if sensor_Hz is None else (Section(frequency_Hz=sensor_Hz),),
        noise_rms=model.quality.noise_rms_m,
        noise_bandwidth_Hz=sensor_Hz,
    )


def junction_axis_plant(
    plant: JunctionPlant,
    *,
    axis: str = "z",
    set_point_A: float,
    decay_per_m: float,
    noise_rms_A: float = 0.0,
) -> AxisPlant:
    """Return the identified plant of a tunnelling axis, resting at its set point and 0 V."""
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
        sensor=(Section(frequency_Hz=plant.sensor_pole_Hz),),
        noise_rms=noise_rms_A,
        noise_bandwidth_Hz=plant.sensor_pole_Hz,
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
        zones = response.operator.dead_zones
        scaled = replace(zones, weight=zones.weight * factor)
        changed = replace(response, operator=replace(response.operator, dead_zones=scaled))
    else:
        raise TypeError("a plugged response has no gain to change")
    return replace(plant, response=changed, label=label)


def _of_time(time_s: float) -> Section:
    return Section(frequency_Hz=1.0 / (2.0 * np.pi * time_s))
