"""Templates: frequency masks that bound sensitivity functions, and their violations."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from piezoid.design.plant import Fraction
from piezoid.design.sensitivity import margins, sensitivities
from piezoid.formatting import significant, with_unit
from piezoid.numerics.arrays import Array, freeze, same_length, strictly_increasing
from piezoid.numerics.polynomial import decibel, grid_Hz

FUNCTIONS = ("Syp", "Sup", "Syb", "Syv")


@dataclass(frozen=True, kw_only=True, eq=False)
class Template:
    """An upper limit of one sensitivity function.

    name          for messages, for example ``attenuation``
    function      one of Syp, Sup, Syb, Syv
    frequency_Hz  (knots,)  increasing; the limit is linear in dB over log f between knots, and
                  infinite outside
    upper_dB      (knots,)  relative to 1, V per output unit, 1, output unit per V
    """

    name: str
    function: str
    frequency_Hz: Array
    upper_dB: Array

    def __post_init__(self) -> None:
        if self.function not in FUNCTIONS:
            raise ValueError(f"template {self.name}: {self.function!r} is not one of {FUNCTIONS}")
        freeze(self, "frequency_Hz", "upper_dB")
        same_length([("frequency_Hz", self.frequency_Hz), ("upper_dB", self.upper_dB)])
        strictly_increasing(self.frequency_Hz, "frequency_Hz")
        if not len(self.frequency_Hz):
            raise ValueError(f"template {self.name}: it has no frequencies")
        if not self.frequency_Hz[0] > 0:
            raise ValueError(f"template {self.name}: frequencies must be > 0")

    def limit_dB(self, frequency_Hz: ArrayLike) -> Array:
        """Return the limit in dB, +inf outside of the knots, (frequencies,)."""
        f = np.asarray(frequency_Hz, dtype=np.float64)
        level = np.interp(np.log(f), np.log(self.frequency_Hz), self.upper_dB)
        inside = (f >= self.frequency_Hz[0]) & (f <= self.frequency_Hz[-1])
        return np.where(inside, level, np.inf)


@dataclass(frozen=True, kw_only=True)
class Violation:
    """Violation of one template by one member of the family, at its worst frequency.

    template      name of the template or margin
    member        label of the plant
    frequency_Hz  of the largest excess
    found, limit  in ``unit``: ``dB``, or ``s`` for the delay margin, ``1`` for the modulus margin
    excess_dB     20 log10 of the ratio to the limit, > 0
    """

    template: str
    member: str
    frequency_Hz: float
    found: float
    limit: float
    unit: str
    excess_dB: float

    @property
    def sentence(self) -> str:
        """The violation as a sentence."""
        at, limit = with_unit(self.frequency_Hz, "Hz"), significant(self.limit, 4)
        return (
            f"{self.template} of the member '{self.member}' is {significant(self.found, 4)} "
            f"{self.unit} at {at} where {limit} {self.unit} is the limit, missed by "
            f"{self.excess_dB:.2f} dB"
        )


def attenuation(bandwidth_Hz: float, level_dB: float) -> Template:
    """Return the template of an integrating loop: |Syp| rises by 20 dB/decade up to a level."""
    return Template(
        name="attenuation",
        function="Syp",
        frequency_Hz=np.array([bandwidth_Hz / 1000.0, bandwidth_Hz]),
        upper_dB=np.array([level_dB - 60.0, level_dB]),
    )


def delay_limit(frequency_Hz: Array, delay_s: float) -> Array:
    """Return the limit of |Syb| below which every additional delay up to tau preserves stability.

        1 / max over t <= tau of |1 - exp(-j w t)|:   1/(2 sin(w tau / 2)), 1/2 from w tau = pi on

    For tau of one sample this is Landau's template. Above one sample, delays less than tau
    determine the limit at high frequency, which the first expression alone would miss.
    """
    angle = np.minimum(np.pi * frequency_Hz * delay_s, 0.5 * np.pi)
    return np.asarray(0.5 / np.maximum(np.sin(angle), 1e-12))


def violations(
    members: Sequence[Fraction],
    R: ArrayLike,
    S: ArrayLike,
    *,
    templates: Sequence[Template],
    modulus_margin: float,
    delay_margin_s: float,
) -> tuple[Violation, ...]:
    """Return the violations of every limit by every member on a fine grid, worst first."""
    checks: list[Violation] = []
    for plant in members:
        m = margins(plant, R, S)
        limits = [("modulus margin", m.modulus_margin, modulus_margin, m.modulus_Hz, "1")]
        if m.delay_margin_s is not None:
            delay_Hz = m.delay_Hz or m.modulus_Hz
            limits.append(("delay margin", m.delay_margin_s, delay_margin_s, delay_Hz, "s"))
        checks += [
            Violation(
                template=name,
                member=plant.label,
                frequency_Hz=frequency_Hz,
                found=value,
                limit=limit,
                unit=unit,
                excess_dB=float(decibel(limit / max(value, 1e-6 * limit))),
            )
            for name, value, limit, frequency_Hz, unit in limits
        ]
        for template in templates:
            checks += _template_check(plant, R, S, template)
    violated = [check for check in checks if check.excess_dB > 0.0]
    return tuple(sorted(violated, key=lambda violation: -violation.excess_dB))


def _template_check(
    plant: Fraction, R: ArrayLike, S: ArrayLike, template: Template
) -> list[Violation]:
    """Return the largest excess of a plant over a template, which may be negative.

    Returns an empty list if no line of the grid lies within the template.
    """
    lowest_Hz = float(template.frequency_Hz[0])
    grid = grid_Hz(plant.sampling_rate_Hz, lowest_Hz=min(1.0, lowest_Hz), count=2000)
    knots_Hz = template.frequency_Hz[template.frequency_Hz < 0.5 * plant.sampling_rate_Hz]
    frequency_Hz = np.union1d(grid, knots_Hz)
    frequency_Hz = frequency_Hz[np.isfinite(template.limit_dB(frequency_Hz))]
    if not frequency_Hz.size:
        return []
    functions = sensitivities(plant, R, S, frequency_Hz)
    level_dB = decibel(np.abs(getattr(functions, template.function)))
    limit_dB = template.limit_dB(frequency_Hz)
    worst = int(np.argmax(level_dB - limit_dB))
    level, limit = float(level_dB[worst]), float(limit_dB[worst])
    return [
        Violation(
            template=template.name,
            member=plant.label,
            frequency_Hz=float(frequency_Hz[worst]),
            found=level,
            limit=limit,
            unit="dB",
            excess_dB=level - limit,
        )
    ]
