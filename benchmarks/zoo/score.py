"""One stage whose faults are known, and how the diagnosis did on it.

An effect that the laboratory could not put in (less than a tenth of the size it asked for) is not
counted as hidden. Counted strictly: an effect is named where it is among the findings; what a
finding says it cannot be told from counts for nothing. `something_else` is no name: on a healthy
stage it is an accusation, elsewhere it is counted apart.
"""

import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from math import sqrt
from pathlib import Path
from typing import Any

from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.diagnosis import Diagnosis, Finding
from piezoid.errors import PiezoidError
from piezoid.records.collection import collect
from piezoid.records.lab import Lab, read_lab
from piezoid.records.recording import Recording
from piezoid_datasets.virtual_lab.campaign import Campaign
from piezoid_datasets.virtual_lab.effects.effect import Measure
from piezoid_datasets.virtual_lab.rig import Rig
from piezoid_datasets.virtual_lab.write import write_campaign

PUT_IN = 0.1
ELSE = "something_else"
LOOPS = "loop_shape"  # a property of the class of model, true of most laws
PAST = "initial_state"
Numbers = Mapping[str, float | str]


def cut_off_percent(numbers: Numbers, rig: Rig) -> float:
    """Return the larger part of the drive's range, which every sweep covers, beyond a limit."""
    low_V, high_V = (rig.amplifier_gain_V_per_V * v for v in (rig.drive_min_V, rig.drive_max_V))
    above_V = high_V - float(numbers.get("high_V", high_V))
    below_V = float(numbers.get("low_V", low_V)) - low_V
    return 100.0 * max(above_V, below_V) / (high_V - low_V)


def delay_us(numbers: Numbers, campaign: Campaign) -> float:
    """Return a delay by a time, or by rows in the recording that was read fastest."""
    if "delay_s" in numbers:
        return 1e6 * float(numbers["delay_s"])
    fastest_Hz = max(1.0 / (rows.time_s[1] - rows.time_s[0]) for rows in campaign.recordings)
    return 1e6 * float(numbers["rows"]) / float(fastest_Hz)


def hum_percent(numbers: Numbers, rig: Rig) -> float:
    """Return the rms of the grid's lines: a recording too slow for them shows any part."""
    amplitude_m = [float(a) for key, a in numbers.items() if key.startswith("amplitude_")]
    return 100.0 * sqrt(sum(a * a for a in amplitude_m) / 2.0) / rig.stroke_m


# what the laboratory calls the size that a finding gives, in the finding's unit
TRUE_SIZE: dict[str, Callable[[Numbers, Campaign], float]] = {
    "creep": lambda n, _: 100.0 * float(n["creep_per_decade"]),
    "delay": delay_us,
    "lag": lambda n, _: 1e6 * float(n["time_constant_s"]),
    "resonance": lambda n, _: float(n["frequency_Hz"]),
    "slew_limit": lambda n, c: float(n["slew_V_per_s"]) / c.rig.amplifier_gain_V_per_V,
    "gain_change": lambda n, _: 100.0 * float(n["relative_change"]),
    "amplifier_saturation": lambda n, c: cut_off_percent(n, c.rig),
    "mains_interference": lambda n, c: hum_percent(n, c.rig),
    "sensor_periodic_error": lambda n, _: 1e9 * float(n["amplitude_m"]),
    "quantisation": lambda n, _: 1e9 * float(n["step_m"]),
}
# rms about its mean in the recording that it moves most, of the stroke
ADDED = ("thermal_drift", "cross_coupling", "rate_dependence")


@dataclass(frozen=True, kw_only=True)
class Said:
    """One finding: what was named, how surely, how large; ``truth`` where a size is known."""

    name: str
    p_value: float
    rms_percent: float
    value: float
    unit: str
    ci95: tuple[float, float]
    alike: tuple[str, ...] = ()
    truth: float | None = None

    @property
    def held(self) -> bool | None:
        """Whether the interval holds the laboratory's number; None where there is none."""
        if self.truth is None:
            return None
        return bool(self.ci95[0] <= self.truth <= self.ci95[1])


@dataclass(frozen=True, kw_only=True)
class Case:
    """One stage and what was said of it.

    kind         as on the command line: healthy, single, pair, triple
    size         of full size
    unexplained  p of what is left; None where the diagnosis does not say
    past_percent rms, of the stroke, of what the past of the records changes against one that
                 cycled until nothing moved, where it does most
    noise_percent  rms of the sensor's noise, of the stroke
    times_noise  what the widest class of hysteresis leaves, of the noise
    failed       what was said instead of a diagnosis
    """

    law: str
    kind: str
    size: float
    seed: int
    hidden: tuple[str, ...]
    said: tuple[Said, ...] = ()
    unexplained: float | None = None
    past_percent: float | None = None
    noise_percent: float = 0.0
    times_noise: float = 0.0
    samples: int = 0
    time_s: float = 0.0
    failed: str = ""

    @property
    def names(self) -> tuple[str, ...]:
        """Names from the catalogue."""
        return tuple(one.name for one in self.said if one.name != ELSE)

    @property
    def wrong(self) -> tuple[Said, ...]:
        """Names from the catalogue that are neither hidden nor a past that is there."""
        true = {*self.hidden, ELSE, *((PAST,) if self.past_shows else ())}
        return tuple(s for s in self.said if s.name not in true)

    @property
    def past_shows(self) -> bool:
        """Whether what the drive did before the records moves one by more than the noise.

        Laws that forget by and by show it, and a laboratory that lets its drive wander hides it.
        """
        return (self.past_percent or 0.0) > self.noise_percent

    @property
    def fair(self) -> bool:
        """Whether a healthy stage is told nothing but that its past is unknown, and rightly."""
        return bool(self.said) and self.past_shows and {s.name for s in self.said} == {PAST}

    def row(self) -> dict[str, Any]:
        """Return what a line of the file of results holds."""
        return asdict(self)


def case_of_row(row: Mapping[str, Any]) -> Case:
    """Read a line of the file of results."""
    said = tuple(
        Said(**{**one, "ci95": tuple(one["ci95"]), "alike": tuple(one["alike"])})
        for one in row["said"]
    )
    return Case(**{**row, "said": said, "hidden": tuple(row["hidden"])})


@dataclass(frozen=True, kw_only=True)
class Asked:
    """Which stage: its law, kind and seed, and the effects to hide at a part of full size."""

    law: str
    kind: str
    seed: int
    size: float = 1.0
    hidden: Mapping[str, float] = field(default_factory=dict)


def judged(asked: Asked, drawn: Callable[..., Campaign]) -> Case:
    """Make a stage, diagnose it, and hold the findings against the answer.

    drawn  (asked, settled=...) -> its campaign; settled: had the drive cycled for long before
    """
    known: dict[str, Any] = {
        "law": asked.law,
        "kind": asked.kind,
        "size": asked.size,
        "seed": asked.seed,
    }
    try:
        campaign = drawn(asked)
    except ValueError as error:  # its recordings cannot show the effect
        return Case(**known, hidden=(), failed=f"not made: {error}")
    known["hidden"] = tuple(
        effect.name
        for effect in campaign.answer.effects
        if effect.measured_percent > PUT_IN * effect.asked_percent
    )
    known["past_percent"] = _change_percent(campaign, drawn(asked, settled=True))
    known["noise_percent"] = 100.0 * campaign.rig.noise_rms_m / campaign.rig.stroke_m
    known["samples"] = sum(len(rows.time_s) for rows in campaign.recordings)
    try:
        found, time_s = diagnosed(campaign)
    except PiezoidError as error:
        return Case(**known, failed=str(error))
    return Case(
        **known,
        said=tuple(
            _said(finding, campaign, known["hidden"])
            for finding in found.findings
            if finding.effect != LOOPS
        ),
        unexplained=found.unexplained.p_value if found.unexplained else None,
        times_noise=found.envelope_rms_m / found.noise_floor_rms_m,
        time_s=time_s,
    )


def _change_percent(one: Campaign, other: Campaign) -> float:
    both = zip(one.recordings, other.recordings, strict=True)
    most_m = max(Measure.RMS.of(a.noise_free_m - b.noise_free_m) for a, b in both)
    return 100.0 * most_m / one.rig.stroke_m


def recorded(campaign: Campaign) -> tuple[tuple[Recording, ...], Lab]:
    """Write a campaign as a laboratory hands it over, and read it."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        write_campaign(campaign, place)
        lab = read_lab(place / "recordings/lab.toml")
        files = [place / f"recordings/{rows.run.name}.csv" for rows in campaign.recordings]
        return tuple(collect(files, lab).recordings), lab


def diagnosed(campaign: Campaign) -> tuple[Diagnosis, float]:
    """Return the diagnosis and its seconds of processor."""
    recordings, lab = recorded(campaign)
    begun = time.process_time()
    return diagnose(recordings, lab=lab), time.process_time() - begun


def _said(finding: Finding, campaign: Campaign, hidden: tuple[str, ...]) -> Said:
    truth = None
    if finding.effect in hidden:
        put_in = next(e for e in campaign.answer.effects if e.name == finding.effect)
        if finding.effect in TRUE_SIZE:
            truth = TRUE_SIZE[finding.effect](put_in.numbers, campaign)
        elif finding.effect in ADDED:
            truth = put_in.moving_percent
    return Said(
        name=finding.effect,
        p_value=float(finding.p_value),
        rms_percent=float(finding.rms_percent),
        value=float(finding.size.value),
        unit=finding.size.unit,
        ci95=(float(finding.size.ci95[0]), float(finding.size.ci95[1])),
        alike=finding.not_separable_from,
        truth=truth,
    )
